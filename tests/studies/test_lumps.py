"""How searches for lumps are counted."""

import pytest

from studies import lumps
from studies.lumps import LumpAfter, LumpCase, LumpOutcome, foam_rows, lump_rows

LUMP = (0.1, 0.1, 0.02, 0.012)


def outcome(foam_sd: float, *, lump: bool = True, off_m: float | None = None) -> LumpOutcome:
    """Two touches, after the second of which one lump was found, `off_m` from the true one, or none."""
    after = (LumpAfter(1, 0, None, 0.5), LumpAfter(2, int(off_m is not None), off_m, 0.2))
    case = LumpCase("buried" if lump else "empty", 1000, touches=2)
    truth = LUMP if lump else None
    return LumpOutcome(case, truth, after, "budget", 0.02, (0.01, 0.03), 0.01, "", foam_sd, 0.05, (), (), (), 1.0)


def test_fields_are_counted_by_the_foam_s_scatter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lumps, "limit", lambda scatter_sd: scatter_sd)
    some = [outcome(0.03, off_m=0.01), outcome(0.03), outcome(0.03, lump=False), outcome(0.08, off_m=0.03)]
    little, much = foam_rows(some)
    assert (little["scatter"], little["found"].hits, little["found"].cases) == ((0.02, 0.04), 1, 2)
    assert (little["alarms"].hits, little["alarms"].cases) == (0, 3)
    assert (much["found"].hits, much["alarms"].hits) == (0, 1)  # farther off than its radius
    assert 0.02 < little["limit"] < 0.04 < 0.07 < much["limit"] < 0.1
    assert foam_rows([outcome(0.0)]) == []


def test_what_was_missed_counts_of_all_fields() -> None:
    (last,) = lump_rows([outcome(0.03, off_m=0.01), outcome(0.03), outcome(0.03, lump=False)])
    assert (last["touches"], last["found"].hits, last["missed"].hits, last["missed"].cases) == (2, 1, 1, 3)
    assert last["missed_said"] == pytest.approx(0.2)
