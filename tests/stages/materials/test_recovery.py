"""What relaxes, how fast, and what is kept, from a push and its end: known solids are found again."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.materials import recovery
from deformscope.stages.materials.recovery import RecoveryEstimate, fit_recovery

FINE = 40


def pushed(
    time_s: FloatArray, shares: list[float], times_s: list[float], kept: float, ramp_s: float, hold_s: float
) -> tuple[FloatArray, FloatArray]:
    """Shares (T,) of the push and forces (T,) over those of its dent at once, of a generalised Maxwell solid: stresses
    q_i that relax, not the creep that the fit knows. kept: of the push, for good."""
    fine = np.linspace(0.0, time_s[-1], FINE * (len(time_s) - 1) + 1)
    step_s = fine[1]
    share, relax_s = np.array(shares), np.array(times_s)
    left, middle = np.exp(-step_s / relax_s), share * np.exp(-0.5 * step_s / relax_s)
    strain, stress = np.zeros(len(fine)), np.zeros(len(fine))
    branch = np.zeros(len(share))
    for i in range(1, len(fine)):
        branch = branch * left
        if fine[i] <= ramp_s + hold_s:
            strain[i] = (1.0 - kept) * min(fine[i] / ramp_s, 1.0)
        else:  # nothing touches it: all stresses cancel
            strain[i] = (middle.sum() * strain[i - 1] - branch.sum()) / (1.0 - share.sum() + middle.sum())
        branch = branch + middle * (strain[i] - strain[i - 1])
        stress[i] = (1.0 - share.sum()) * strain[i] + branch.sum()
    amplitude = strain + kept * np.minimum(fine / ramp_s, 1.0)
    return amplitude[::FINE], stress[::FINE]


def fitted(
    shares: list[float], times_s: list[float], kept: float, seed: int = 0, *, force: bool = False, watch_s: float = 5.0
) -> RecoveryEstimate:
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, 2.0 + watch_s, 1.0 / 12.0)
    amplitude, force_n = pushed(time_s, shares, times_s, kept, 0.5, 1.54)
    amplitude = amplitude + random.normal(0.0, 0.003, len(time_s))
    force_n = 3.0 * force_n + random.normal(0.0, 0.02, len(time_s))
    given = {"force_n": force_n, "force_sd_n": 0.02, "released": 25} if force else {}
    return fit_recovery(time_s, amplitude, loaded=24, largest=4.0, seed=seed, **given)  # type: ignore[arg-type]


def test_a_known_solid_is_found_again() -> None:
    found = fitted([0.3], [1.0], 0.0)
    assert found.verdict == "viscous"
    assert 25 <= found.released <= 26
    assert found.share.value == pytest.approx(0.3, abs=0.02)
    assert found.share.interval[0] < 0.3 < found.share.interval[1]
    assert found.time_s.interval[0] < 1.0 < found.time_s.interval[1]
    assert found.instant is None
    assert found.observed[found.released :] == pytest.approx(found.simulated[found.released :], abs=0.015)


@pytest.mark.slow
def test_a_force_shows_the_stiffness_at_once_and_relaxed() -> None:
    found = fitted([0.3], [1.0], 0.0, force=True, watch_s=1.0)
    assert found.instant.value == pytest.approx(3.0 / 4.0, rel=0.03)
    assert found.relaxed.value == pytest.approx(0.7 * 3.0 / 4.0, rel=0.08)
    assert found.as_json()["instant_n_per_m"] is not None


@pytest.mark.parametrize(
    ("shares", "times_s", "kept", "verdict"),
    [
        ([], [], 0.2, "plastic"),
        pytest.param([], [], 0.0, "elastic", marks=pytest.mark.slow),
        pytest.param([0.3], [1.0], 0.1, "viscoplastic", marks=pytest.mark.slow),
    ],
)
def test_what_is_kept_and_what_recovers_are_told_apart(
    shares: list[float], times_s: list[float], kept: float, verdict: str
) -> None:
    found = fitted(shares, times_s, kept)
    assert found.verdict == verdict
    assert found.set.value == pytest.approx(kept, abs=0.02)


@pytest.mark.parametrize(("share", "time_s", "watch_s"), [(0.3, 20.0, 3.0), (0.3, 30.0, 5.0)])
def test_a_recovery_that_outlasts_the_record_is_named_and_bounded(share: float, time_s: float, watch_s: float) -> None:
    found = fitted([share], [time_s], 0.0, watch_s=watch_s)
    assert [one.code for one in found.reasons] == ["short-record"]
    assert found.share.value == found.share.interval[0] < share
    assert found.share.interval[1] == 1.0
    assert found.time_s.interval[0] < time_s
    assert found.time_s.interval[1] == np.inf
    for one in found.force_kept:
        assert one.after_s <= max(watch_s, 2.0)
        assert one.interval[0] <= one.share <= one.interval[1]


def test_an_end_that_may_be_unseen_opens_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    now = fitted([0.15, 0.15], [0.3, 2.0], 0.0, watch_s=3.0)
    monkeypatch.setattr(recovery, "OPEN_RECOVERY", 1.0)
    closed = fitted([0.15, 0.15], [0.3, 2.0], 0.0, watch_s=3.0)
    assert (now.reasons, closed.reasons) == ((), ())
    assert now.share.interval[1] == 1.0
    assert now.time_s == dataclasses.replace(closed.time_s, interval=(closed.time_s.interval[0], np.inf))
    assert closed.share.interval[1] < 0.5
    assert closed.time_s.interval[1] < 3.0


def test_a_set_that_a_slow_branch_may_explain_leaves_share_and_time_open() -> None:
    now = fitted([0.2], [20.0], 0.1)
    assert now.verdict == "plastic"
    assert now.share.interval[0] < 0.2 < now.share.interval[1] == 1.0
    assert now.time_s.interval == (now.time_s.interval[0], np.inf)
    assert now.set.interval[0] < 0.1 < now.set.interval[1]


def test_a_record_that_saw_the_end_says_how_much_force_is_kept() -> None:
    found = fitted([0.3], [1.0], 0.0)
    assert found.reasons == ()
    grown = (np.arange(1000) + 0.5) / 1000.0 * 0.5  # a ramp of half a second
    left = [float(np.mean(0.7 + 0.3 * np.exp(-(at + grown)))) for at in (0.0, 1.0)]
    said = next(one for one in found.force_kept if one.after_s == 1.0)
    assert said.share == pytest.approx(left[1] / left[0], abs=0.01)
    assert said.interval[0] < left[1] / left[0] < said.interval[1]


def test_a_short_record_leaves_open_what_is_slow_and_what_is_kept() -> None:
    found = fitted([0.2], [6.0], 0.0, watch_s=0.6)
    assert found.set.interval[0] < 0.01 < 0.05 < found.set.interval[1]
    with pytest.raises(InputError, match="4 frames or more after the release"):
        fit_recovery(np.arange(6.0), np.array([0, 0.5, 1, 1, 0.2, 0.1]), loaded=3, released=4)


@pytest.mark.slow
def test_intervals_hold_the_truth() -> None:
    held = []
    for seed in range(30):
        random = np.random.default_rng([seed, 7])
        share, time_s = random.uniform(0.1, 0.4), float(np.exp(random.uniform(np.log(0.3), np.log(3.0))))
        kept = float(random.choice([0.0, 0.1]))
        found = fitted([share], [time_s], kept, seed)
        pairs = ((found.share, share), (found.time_s, time_s), (found.set, kept))
        held.append([one.interval[0] - 1e-9 <= truth <= one.interval[1] + 1e-9 for one, truth in pairs])
    assert (np.mean(held, axis=0) >= 0.75).all(), np.mean(held, axis=0)
