"""Stiffness from an approach, against laws that are known in closed form."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.poke.contact import (
    ArmCompliance,
    TipKind,
    calibrate_compliance,
    fit_approach,
    layer_modulus,
    peak_rate,
)
from tests.cases import slow

NORMAL = np.array([0.3, -0.2, 1.2])
EXPONENT = {"sphere": 1.5, "disc": 1.0, "flat": 1.0}

Approach = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def approach(
    seed: int,
    depth_m: float,
    tip: TipKind = "sphere",
    *,
    arm_m_per_n: float = 0.0,
    position_sd_m: float = 1e-4,
    force_sd_n: float = 0.02,
    slack_m: float = 0.008,
    peak_n: float = 3.1,
) -> Approach:
    """100 Hz at 10 mm/s along a tilted normal, to `peak_n`; the dent is `depth_m` at 3 N. Force is made first and the
    arm's way from it: no equation to solve, and nothing shared with the fit."""
    rng = np.random.default_rng(seed)
    fine = np.linspace(0.0, peak_n, 40001)
    way = depth_m * (fine / 3.0) ** (1.0 / EXPONENT[tip]) + arm_m_per_n * fine + slack_m
    time = np.arange(0.0, way[-1] / 0.01, 0.01)
    force = np.interp(0.01 * time, way, fine, left=0.0)
    out = NORMAL / np.linalg.norm(NORMAL)
    side = np.array([0.02, -0.03, 0.01])  # tangential motion adds nothing
    along = 0.01 * time - position_sd_m * rng.standard_normal(len(time))
    position = np.array([0.4, 0.1, 0.3]) - along[:, None] * out + np.cross(out, side) * time[:, None]
    noise = force_sd_n * rng.standard_normal((len(time), 3))
    return time, position, force[:, None] * out + noise + 0.04 * out, NORMAL  # an offset that the tare left


def threshold_stiffness(time_s: FloatArray, position_m: FloatArray, force_n: FloatArray, normal: FloatArray) -> float:
    """Force over depth [N/mm] with contact taken where the force first passes 0.15 N."""
    out = normal / np.linalg.norm(normal)
    depth, force = -position_m @ out, force_n @ out
    force = force - np.median(force[time_s < 0.5])
    first, last = int(np.argmax(force > 0.15)), int(np.argmax(force >= 3.0))
    return float(1e-3 * force[last] / (depth[last] - depth[first]))


@pytest.mark.parametrize(("tip", "depth_m", "spread"), [("sphere", 0.0066, 0.025), ("flat", 0.004, 0.02)])
def test_stiffness_is_right_and_its_interval_holds_the_truth(tip: TipKind, depth_m: float, spread: float) -> None:
    fits = [fit_approach(*approach(seed, depth_m, tip), tip=tip) for seed in range(60)]
    truth = 3e-3 / depth_m
    errors = np.array([fit.log_stiffness - np.log(truth) for fit in fits])
    assert abs(errors.mean()) < 0.006
    assert errors.std() < spread, errors.std()
    inside = np.mean([fit.interval_n_per_mm[0] <= truth <= fit.interval_n_per_mm[1] for fit in fits])
    assert inside >= 0.8  # of 90 %, in 60
    assert all(fit.at_force_n == 3.0 and not fit.rigid for fit in fits)
    assert fits[0].contact_m - fits[1].contact_m == pytest.approx(0.0, abs=5e-4)


def test_a_threshold_for_contact_makes_a_sphere_look_15_to_20_percent_stiffer_and_the_fit_does_not() -> None:
    depth = 0.0066
    truth = 3e-3 / depth
    taken = [threshold_stiffness(*approach(seed, depth)) / truth - 1.0 for seed in range(60)]
    fitted = [fit_approach(*approach(seed, depth)).stiffness_n_per_mm / truth - 1.0 for seed in range(60)]
    assert 0.15 <= np.mean(taken) <= 0.20
    assert abs(np.mean(fitted)) < 0.01


@pytest.mark.parametrize("force_sd_n", [slow(0.005), slow(0.02), 0.05])
def test_the_peak_rate_of_a_ramp_is_its_slope_and_its_interval_holds_it_in_90_percent(force_sd_n: float) -> None:
    # a flat tip at 10 mm/s into what dents by 4 mm at 3 N
    fits = [fit_approach(*approach(seed, 0.004, "flat", force_sd_n=force_sd_n), tip="flat") for seed in range(300)]
    rates, ends = [fit.peak_rate_n_per_s for fit in fits], [fit.peak_rate_interval_n_per_s for fit in fits]
    assert np.mean(np.array(rates, float)) == pytest.approx(7.5, rel=0.015)
    inside = np.mean([end is not None and end[0] <= 7.5 <= end[1] for end in ends])
    assert 0.85 <= inside <= 0.95  # three deviations of a share of 0.9 in 300


def test_the_peak_rate_is_taken_where_the_force_rises_fastest_and_not_from_too_few_samples() -> None:
    time = np.cumsum(np.where(np.arange(120) % 3, 0.01, 0.02))  # samples need not be evenly spaced
    force = np.interp(time, [0.5, 1.0, 1.2], [0.0, 1.0, 3.0])
    rate, interval = peak_rate(time, force, 0.01)
    assert rate == pytest.approx(10.0)
    assert interval[0] < 10.0 < interval[1]
    assert peak_rate(time[:10], force[:10], 0.01)[0] == 0.0
    assert peak_rate(time[:9], force[:9], 0.01) == (None, None)


def test_times_that_repeat_tell_no_peak_rate_and_hide_no_other() -> None:
    time = 0.01 * np.arange(40.0)
    force = 3.0 * time
    stalled = np.concatenate([np.full(20, time[0]), time])
    rate, interval = peak_rate(stalled, np.concatenate([np.zeros(20), force]), 0.001)
    assert rate == pytest.approx(3.0, rel=1e-3)
    assert interval is not None
    assert peak_rate(np.zeros(20), np.zeros(20), 0.001) == (None, None)


def test_slack_before_contact_changes_nothing() -> None:
    short, long = (fit_approach(*approach(3, 0.0066, slack_m=slack)) for slack in (0.002, 0.04))
    assert short.log_stiffness == pytest.approx(long.log_stiffness, abs=3.0 * np.hypot(short.log_sd, long.log_sd))


def test_what_follows_the_peak_is_left_out() -> None:
    time, position, force, normal = approach(4, 0.0066)
    back = np.arange(1, 50)
    again = fit_approach(
        np.append(time, time[-1] + 0.01 * back),
        np.vstack([position, position[::-1][:49]]),
        np.vstack([force, 0.2 * force[::-1][:49]]),
        normal,
    )
    # the last samples are smoothed with what follows, so one more or less may be fitted
    assert again.log_stiffness == pytest.approx(fit_approach(time, position, force, normal).log_stiffness, abs=0.02)


def test_outliers_of_the_arm_are_borne() -> None:
    time, position, force, normal = approach(5, 0.0066)
    position = position.copy()
    position[::9] += 0.002 * normal / np.linalg.norm(normal)
    assert fit_approach(time, position, force, normal).stiffness_n_per_mm == pytest.approx(3e-3 / 0.0066, rel=0.08)


def test_the_arm_s_own_compliance_is_calibrated_on_a_rigid_block_and_taken_off() -> None:
    true = 2e-4  # 5 N/mm
    block = approach(6, 0.0, arm_m_per_n=true, slack_m=0.004, position_sd_m=5e-5)
    # a slow approach is what a calibration is made with
    slow = (block[0] * 8.0, *block[1:])
    arm = calibrate_compliance(*slow)
    assert abs(arm.compliance_m_per_n - true) < 4.0 * arm.compliance_sd
    reported = ArmCompliance(true, 1e-5)
    soft = [fit_approach(*approach(seed, 0.004, arm_m_per_n=true), arm=reported) for seed in range(30)]
    bare = [fit_approach(*approach(seed, 0.004, arm_m_per_n=true)) for seed in range(30)]
    assert np.mean([fit.depth_m for fit in soft]) == pytest.approx(0.004, rel=0.01)
    assert np.mean([fit.depth_m for fit in bare]) > 1.1 * 0.004  # without it the arm's share is taken for a dent
    assert all(fit.depth_sd_m > 3e-5 for fit in soft)


def test_a_rigid_place_is_stiffer_than_a_bound() -> None:
    arm = ArmCompliance(2e-4, 1e-5)
    for seed in range(20):
        fit = fit_approach(*approach(seed, 0.0, arm_m_per_n=2e-4, slack_m=0.004), arm=arm)
        assert fit.rigid
        assert fit.interval_n_per_mm == (fit.stiffness_n_per_mm, np.inf)
        assert fit.stiffness_n_per_mm == pytest.approx(1e-3 * fit.at_force_n / (3.0 * arm.depth_sd_m(fit.at_force_n)))


def test_touches_that_end_before_the_set_force_compare_with_those_that_reach_it() -> None:
    """At half the force a ball meets 21 % less stiffness; the law takes it to the set force, less certain."""
    truth = 3e-3 / 0.015
    for peak_n in (1.5, 2.0):
        fits = [fit_approach(*approach(seed, 0.015, peak_n=peak_n)) for seed in range(20)]
        whole = fit_approach(*approach(0, 0.015))
        assert all(fit.at_force_n == 3.0 and fit.log_sd > whole.log_sd for fit in fits)
        assert np.mean([fit.log_stiffness for fit in fits]) == pytest.approx(np.log(truth), abs=0.02)
        inside = [fit.interval_n_per_mm[0] < truth < fit.interval_n_per_mm[1] for fit in fits]
        assert np.mean(inside) >= 0.8
        pressed = np.mean([fit.dent_m(peak_n) for fit in fits])
        assert pressed == pytest.approx(0.015 * (peak_n / 3.0) ** (2.0 / 3.0), rel=0.01)


def test_the_modulus_is_hertz_on_a_thick_layer_and_less_than_hertz_says_on_a_thin_one() -> None:
    radius, depth, modulus = 0.01, 0.001, 40e3
    hertz = 4.0 / 3.0 * modulus / (1.0 - 0.3**2) * np.sqrt(radius) * depth**1.5
    assert layer_modulus(depth, hertz, thickness_m=100.0) == pytest.approx(modulus, rel=1e-4)
    # Dimitriadis et al. 2002, eq. 13: the printed coefficients of an incompressible layer
    chi = np.sqrt(radius * depth) / 0.02
    incompressible = 16.0 / 9.0 * modulus * np.sqrt(radius) * depth**1.5
    force = incompressible * (1.0 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3)
    assert layer_modulus(depth, force, thickness_m=0.02, poisson=0.5) == pytest.approx(modulus, rel=2e-3)


def test_what_cannot_be_fitted_is_refused() -> None:
    time, position, force, normal = approach(8, 0.0066)
    with pytest.raises(InputError, match="check the normal's sign"):
        fit_approach(time, position, -np.abs(force), np.abs(normal))
    with pytest.raises(InputError, match="approach more slowly"):
        fit_approach(time[::20], position[::20], force[::20], normal)
    with pytest.raises(InputError, match="finite"):
        fit_approach(time, position * np.nan, force, normal)
    with pytest.raises(InputError, match="times that rise"):
        fit_approach(time[::-1], position, force, normal)
    with pytest.raises(InputError, match="positions and forces"):
        fit_approach(time, position[:-1], force, normal)
