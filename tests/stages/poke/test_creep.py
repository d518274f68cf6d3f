"""What a held touch says of a foam's creep, against touches that are integrated here by another method."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.relaxation import DOUBTED, OPEN, RelaxationDraws
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.poke.creep import CreepFit, cycle_loss, fit_creep

UP = np.array([0.0, 0.0, 1.0])
RATE_HZ, LOAD_S, SET_N, DEPTH_M, EXPONENT = 100.0, 0.8, 3.0, 0.006, 1.5


def touch(
    shares: tuple[float, ...],
    times_s: tuple[float, ...],
    hold_s: float,
    noise_m: float = 0.0,
    load_s: float = LOAD_S,
    drift_n: float = 0.0,
    air_after: bool = False,
    off_n: float = 0.0,
) -> CreepFit:
    """A ball pressed with a force that rises and stays, on E(t) / E0 = 1 - sum g + sum g exp(-t / tau), by a Volterra
    equation in steps of 1 ms: F(t) = integral of E(t - s) d(c y(s)), y = depth^p. drift_n: even drift of the sensor
    from the first sample to the end of the hold; air_after: the tip leaves 1 mm a sample, and stays away"""
    step = 1e-3
    time = np.arange(round((load_s + hold_s) / step) + 1) * step
    force = SET_N * np.minimum(time / load_s, 1.0)
    shares_, times_ = np.array(shares), np.array(times_s)
    elastic, memory, done = 0.0, np.zeros(len(shares)), np.zeros(len(time))
    for i in range(1, len(time)):
        # implicit Euler of each Maxwell branch q' = g w' - q / tau, whose forces add to (1 - sum g) w
        left = 1.0 / (1.0 + step / times_)
        carried = float((left * (memory - shares_ * elastic)).sum())
        now = (force[i] - carried) / (1.0 - shares_.sum() + float((left * shares_).sum()))
        memory = left * (memory + shares_ * (now - elastic))
        elastic, done[i] = now, now
    depth = DEPTH_M * (done / SET_N) ** (1.0 / EXPONENT)
    before = np.arange(30) / RATE_HZ - 30 / RATE_HZ
    at = slice(None, None, round(1.0 / RATE_HZ / step))
    time, force, depth = (
        np.concatenate([first, rest[at]])
        for first, rest in ((before, time), (0.0 * before, force), (0.01 * before, depth))
    )
    random = np.random.default_rng(1)
    z = depth + 1e-4 * force + noise_m * random.standard_normal(len(depth))
    felt = force + 0.01 * random.standard_normal(len(force))
    loading, held = 30 + round(load_s * RATE_HZ) + 1, len(time)
    if air_after:
        gone = np.arange(1, 41)
        time = np.append(time, time[-1] + gone / RATE_HZ)
        z = np.append(z, np.maximum(z[-1] - 1e-3 * gone, -5e-3))
        left = np.maximum(1.0 - gone / 4.0, 0.0) * SET_N  # it loses contact sooner than it had touched
        felt = np.append(felt, left + 0.01 * random.standard_normal(len(gone)))
    felt = felt + drift_n * (time - time[0]) / (time[held - 1] - time[0])
    arm = ArmCompliance(1e-4, 1e-6)
    places, forces = -z[:, None] * UP, felt[:, None] * UP
    return fit_creep(time, places, forces, UP, loading=loading, held=held, arm=arm, off_n=off_n)


@pytest.mark.parametrize("drift_n", [0.2, -0.2])
def test_free_air_after_a_touch_shows_that_the_force_drifts(drift_n: float) -> None:
    """An elastic foam stays elastic, and a branch is found, with the drift named; without that air both look alike."""
    elastic = touch((), (), 9.0, noise_m=5e-5, drift_n=drift_n, air_after=True)
    assert elastic.verdict == "elastic"
    assert [one.code for one in elastic.reasons] == ["force-drift"]
    assert f"drifted by {drift_n / 10.1:+.2g} N/s" in elastic.text
    assert elastic.instant_n_per_mm == pytest.approx(1e-3 * SET_N / DEPTH_M, rel=0.03)
    branch = touch((0.3,), (1.0,), 9.0, noise_m=5e-5, drift_n=drift_n, air_after=True)
    assert [one.code for one in branch.reasons] == ["force-drift"]
    assert branch.share_interval[0] < 0.3 < branch.share_interval[1]
    assert branch.time_interval[0] < 1.0 < branch.time_interval[1]
    assert branch.relaxed_n_per_mm is not None
    assert "at least" not in branch.brief


def test_a_force_that_does_not_drift_names_nothing_after_a_touch() -> None:
    fit = touch((0.3,), (1.0,), 9.0, noise_m=5e-5, air_after=True)
    assert fit.reasons == ()
    assert fit.share == pytest.approx(0.3, abs=0.06)


@pytest.mark.parametrize(
    ("shares", "times_s"), [((0.3,), (1.0,)), ((0.4,), (3.0,)), ((0.15, 0.15), (0.2, 1.5)), ((0.15,), (0.5,))]
)
def test_stiffness_at_once_and_relaxed_and_the_share_that_relaxes_are_found(
    shares: tuple[float, ...], times_s: tuple[float, ...]
) -> None:
    fit = touch(shares, times_s, 8.0, noise_m=5e-5)
    relaxes = sum(shares)
    at_once = 1e-3 * SET_N / DEPTH_M
    relaxed = at_once * (1.0 - relaxes) ** (1.0 / EXPONENT)
    assert fit.verdict == "viscous"
    assert fit.instant_n_per_mm == pytest.approx(at_once, rel=0.1)
    assert fit.relaxed_n_per_mm == pytest.approx(relaxed, rel=0.03)
    assert fit.relaxed_interval[0] < relaxed < fit.relaxed_interval[1]
    assert fit.share == pytest.approx(relaxes, abs=0.06)
    mean_s = float(np.dot(shares, times_s)) / relaxes
    assert fit.time_s == pytest.approx(mean_s, rel=0.4)
    assert fit.held_s == pytest.approx(8.0, abs=0.05)


def test_a_force_with_an_offset_opens_both_stiffnesses_and_neither_share_nor_time() -> None:
    """0.3 N of 3 N: a tenth in log stiffness, 1.64 deviations either side in 90 %."""
    sensor, arm = (touch((0.3,), (1.0,), 8.0, noise_m=5e-5, off_n=off_n) for off_n in (0.0, 0.3))
    for one, other in (
        (sensor.instant_interval, arm.instant_interval),
        (sensor.relaxed_interval, arm.relaxed_interval),
    ):
        before, now = (np.diff(np.log(ends))[0] / (2.0 * 1.645) for ends in (one, other))
        assert now == pytest.approx(np.hypot(before, 0.1), rel=0.15)
    assert arm.relaxed_log_sd == pytest.approx(np.hypot(sensor.relaxed_log_sd, 0.1), rel=0.1)
    assert (arm.share_interval, arm.time_interval) == (sensor.share_interval, sensor.time_interval)
    assert arm.instant_n_per_mm == pytest.approx(sensor.instant_n_per_mm, rel=0.02)


def test_an_elastic_foam_is_called_elastic_and_has_one_stiffness() -> None:
    fit = touch((), (), 4.0, noise_m=5e-5)
    assert fit.verdict == "elastic"
    assert fit.relaxed_n_per_mm == pytest.approx(fit.instant_n_per_mm, rel=0.01)
    assert fit.instant_n_per_mm == pytest.approx(1e-3 * SET_N / DEPTH_M, rel=0.03)
    assert fit.loss is None
    assert fit.loss_interval is None


def kept(shares: tuple[float, ...], times_s: tuple[float, ...], after_s: float) -> float:
    """Share of the force at the end of an even approach that is left, held in place: the integral of E as it stands."""
    gone = (np.arange(4000) + 0.5) / 4000.0
    growth = gone ** (EXPONENT - 1.0)
    before = LOAD_S * (1.0 - gone[:, None])

    def force(since_s: float) -> float:
        left = 1.0 - sum(shares) + (np.array(shares) * np.exp(-(since_s + before) / np.array(times_s))).sum(axis=1)
        return float(growth @ left)

    return force(after_s) / force(0.0)


@pytest.mark.parametrize(
    ("shares", "times_s", "hold_s", "reason"),
    [
        ((0.3,), (1.0,), 8.0, ""),
        ((0.4,), (2.0,), 1.0, "short-record"),
        ((0.3,), (30.0,), 8.0, "short-record"),
        # a decade apart and alike, branches look as creep without end does
        ((0.15, 0.15), (0.4, 4.0), 8.0, "no-plateau"),
    ],
)
def test_a_hold_says_only_what_it_saw_and_always_the_force_that_is_kept(
    shares: tuple[float, ...], times_s: tuple[float, ...], hold_s: float, reason: str
) -> None:
    fit = touch(shares, times_s, hold_s, noise_m=5e-5)
    assert [one.code for one in fit.reasons] == [reason] * bool(reason)
    assert [one.after_s for one in fit.force_kept] == pytest.approx(
        [after for after in (0.5, 1.0, 2.0, 5.0) if after < 0.95 * hold_s] + [hold_s]
    )
    for one in fit.force_kept:
        assert one.share == pytest.approx(kept(shares, times_s, one.after_s), abs=0.02)
        assert one.interval[0] < one.share < one.interval[1]
    relaxes = sum(shares)
    if not reason:
        assert fit.relaxed_n_per_mm is not None
        assert fit.share_interval[1] < 1.0
        return
    assert (fit.relaxed_n_per_mm, fit.relaxed_interval, fit.relaxed_log_sd) == (None, None, None)
    assert fit.share == fit.share_interval[0] < relaxes
    assert fit.share_interval[1] == 1.0
    assert fit.time_interval is None or fit.time_interval[1] == np.inf
    assert reason in fit.text
    assert reason in fit.brief


def test_intervals_open_where_the_relaxed_state_may_be_unseen(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = touch((0.3,), (1.0,), 3.0, noise_m=5e-5)
    seen = RelaxationDraws.seen
    monkeypatch.setattr(RelaxationDraws, "seen", lambda draws, record_s: seen(draws, record_s, open_from=1.0))
    before = touch((0.3,), (1.0,), 3.0, noise_m=5e-5)
    assert OPEN < opened.short_record + opened.no_plateau < DOUBTED
    assert (opened.reasons, before.reasons) == ((), ())
    assert before.relaxed_interval[0] > 0.0
    assert max(before.share_interval[1], before.time_interval[1]) < np.inf
    wider = {
        "relaxed_interval": (0.0, before.relaxed_interval[1]),
        "share_interval": (before.share_interval[0], 1.0),
        "time_interval": (before.time_interval[0], np.inf),
    }
    assert opened == dataclasses.replace(before, **wider)  # type: ignore[arg-type]
    assert opened.text.count("or more") - before.text.count("or more") == 1


def test_a_law_without_an_end_is_told_from_branches() -> None:
    """A compliance that grows with the log of time: 40 branches, evenly over it."""
    times_s = np.geomspace(0.01, 1000.0, 40)
    fit = touch(tuple(np.full(40, 0.5 / 40).tolist()), tuple(times_s.tolist()), 8.0, noise_m=5e-5)
    assert [one.code for one in fit.reasons] == ["no-plateau"]
    assert fit.no_plateau > 0.9
    assert fit.share_interval[0] < 0.5
    assert fit.instant_interval[1] == np.inf, "what is faster than the approach is not seen"


def test_stiffness_felt_at_two_speeds_is_one_at_the_reference_speed() -> None:
    quick, slow = (touch((0.3,), (1.0,), 6.0, noise_m=5e-5, load_s=load_s) for load_s in (0.4, 2.4))
    assert quick.speed_m_s > 4.0 * slow.speed_m_s

    def apparent(fit: CreepFit, load_s: float) -> float:
        """log of force over depth when it is reached: a third of the branch's strength, and what has followed of it."""
        late = float(np.exp(-load_s * 0.7) * -1.0 + 1.0) / (load_s * 0.7)  # retardation time 1 / 0.7 s, an even ramp
        return -float(np.log1p(0.3 / 0.7 * (1.0 - late))) / EXPONENT

    before = apparent(quick, 0.4) - apparent(slow, 2.4)
    after = before + quick.log_at_reference - slow.log_at_reference
    assert before > 0.08
    assert abs(after) < 0.3 * before


def test_a_dent_that_stays_is_told_from_one_that_recovers() -> None:
    gone = np.linspace(0.0, 1.0, 21)
    for keeps, expected in ((0.0, "elastic"), (0.3, "plastic")):
        dent = np.concatenate([np.zeros(30), np.linspace(0.0, 1.0, 81), np.ones(200), 1.0 - gone, np.full(20, -0.1)])
        force = SET_N * np.concatenate(
            [(dent[:311].clip(0.0)) ** EXPONENT, ((dent[311:] - keeps) / (1.0 - keeps)).clip(0.0) ** EXPONENT]
        )
        random = np.random.default_rng(2)
        z = DEPTH_M * dent + 5e-5 * random.standard_normal(len(dent))
        felt = force + 0.01 * random.standard_normal(len(force))
        fit = fit_creep(
            0.01 * np.arange(len(z)), -z[:, None] * UP, felt[:, None] * UP, UP, loading=111, held=311,
        )  # fmt: skip
        assert fit.verdict == expected
        assert fit.kept is not None
        assert fit.kept == pytest.approx(keeps, abs=0.06)
        assert fit.slipping < 0.5


def cycle(back: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, place and force: in to 5 mm and 2 N, and back along another line."""
    free = np.zeros(30)
    way_in = np.linspace(0.0, 1.0, 81)
    z = np.concatenate([free, 5e-3 * way_in, 5e-3 * (1.0 - np.linspace(0.0, 1.0, len(back)))])
    force = np.concatenate([free, 2.0 * way_in, 2.0 * back])
    return 0.01 * np.arange(len(z)), z, force


def test_a_cycle_loses_the_area_between_way_in_and_way_out() -> None:
    gone = np.linspace(0.0, 1.0, 81)
    time, z, force = cycle((1.0 - gone) ** 2)  # 1/3 of 5 mm x 2 N comes back of the 1/2 that went in
    fit = fit_creep(time, -z[:, None] * UP, force[:, None] * UP, UP, loading=110, held=112, set_force_n=2.0)
    assert fit.loss == pytest.approx(1.0 / 3.0, abs=0.005)
    assert fit.loss_interval[0] < fit.loss < fit.loss_interval[1]


def test_samples_that_do_not_fit_are_refused() -> None:
    time, z, force = cycle(np.zeros(0))
    with pytest.raises(InputError, match="loading < held"):
        fit_creep(time, -z[:, None] * UP, force[:, None] * UP, UP, loading=90, held=90)


def test_the_doubt_about_an_energy_loss_holds_clocks_that_are_apart() -> None:
    """By as much as forces shifted by the samples say themselves; without a memory nothing is lost."""
    depth_m = np.concatenate([np.linspace(0.0, 0.006, 61), np.full(100, 0.006), np.linspace(0.006, -0.001, 71)])
    force_n = SET_N * (depth_m.clip(0.0) / 0.006) ** EXPONENT
    none = ArmCompliance(0.0, 0.0, 0.0)
    exact, _ = cycle_loss(depth_m, force_n, 161, none, 1e-6)
    late, _ = cycle_loss(depth_m, np.append(force_n[0], force_n[:-1]), 161, none, 1e-6)
    loss, interval = cycle_loss(depth_m, force_n, 161, none, 1e-6, clock_sd=1.0)
    assert exact == loss == pytest.approx(0.0, abs=2e-3)  # trapezia of a tenth of a millimetre
    assert loss is not None
    assert late < -0.02
    assert interval[1] - loss == pytest.approx(1.645 * abs(late - loss), rel=0.1)
