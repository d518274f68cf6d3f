"""Motions of known materials: recovered as their law says, the same for the same seed, and held by what is fitted."""

import json

import numpy as np
import pytest

from studies.__main__ import main
from studies.materials import HELD_S, PARAMETERS, RAMP_S, RELAXES, MotionKind, recovering, try_motion
from studies.quantities import interval_rows
from tests.cases import slow


def test_a_solid_that_was_held_for_long_recovers_by_its_share_in_its_retardation_time() -> None:
    """Let go, a standard linear solid jumps back by 1 - g, and creeps back the rest with the time tau / (1 - g)."""
    share, relax_s = 0.3, 0.3
    time_s = np.arange(0.0, RAMP_S + HELD_S + 3.0, 0.01)
    size = recovering(time_s, share, relax_s, 0.0)
    gone_s = time_s - RAMP_S - HELD_S
    free = gone_s > 0.02
    expected = share * np.exp(-gone_s[free] * (1.0 - share) / relax_s)
    np.testing.assert_allclose(size[free], expected, atol=0.01)  # 1.5 s are five relaxation times: 0.7 % is left
    assert recovering(time_s, share, relax_s, 0.1)[-1] == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize("kind", ["axes", slow("yield"), "viscous", slow("slow")])
def test_a_known_material_is_found_and_its_intervals_are_about_it(kind: MotionKind) -> None:
    found = try_motion((kind, 1001))
    assert found == try_motion((kind, 1001))
    assert len(found.truth) == len(PARAMETERS[kind])
    for true, value, low, high in zip(found.truth, found.value, found.low, found.high, strict=True):
        assert low <= value <= high
        assert low - (high - low) <= true <= high + (high - low)
    if kind == "viscous":
        assert RELAXES[0] <= found.truth[0] <= RELAXES[1]


@pytest.mark.slow
def test_rows_count_what_intervals_hold(capsys: pytest.CaptureFixture[str]) -> None:
    main(["materials", "--kinds", "viscous", "--objects", "3", "--jobs", "1", "--json", "-"])
    found = json.loads(capsys.readouterr().out)
    tried = [try_motion(("viscous", seed)) for seed in range(3)]
    rows = interval_rows(tried, PARAMETERS["viscous"])
    assert [row["quantity"] for row in found["viscous"]["rows"]] == [row["quantity"] for row in rows]
    held = sum(one.low[0] <= one.truth[0] <= one.high[0] for one in tried)
    assert found["viscous"]["rows"][0]["held"]["hits"] == held
    assert found["viscous"]["rows"][0]["error"] == pytest.approx(
        float(np.sqrt(np.mean([(one.value[0] / one.truth[0] - 1.0) ** 2 for one in tried])))
    )
    assert sum(found["viscous"]["verdicts"].values()) == 3
