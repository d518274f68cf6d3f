"""Reasons to doubt a fit: each is named where it is built in, and lowers the verdict as it says."""

import dataclasses
import re
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.lab.elasticity import ElasticBox
from deformscope.pictures.messages import estimate_rows
from deformscope.stages.fit import doubts
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation, calibrate
from deformscope.stages.fit.estimate import Doubt, Estimate, Identifiability, Verdict, limited
from deformscope.stages.fit.two_materials import INCLUSIONS, LEFT, LEFT_SURE, splits
from deformscope.stages.materials.anisotropy import fit_axes
from deformscope.stages.materials.plasticity import YieldOptions, fit_yield
from deformscope.stages.msm.materials import Plasticity
from deformscope.stages.msm.plastic import PlasticMsm
from studies.reproduce.pressed_cubes import thesis_cubes
from tests.cases import each_once, slow
from tests.stages.bodies import lattice, pushed
from tests.stages.materials.test_plasticity import BETA, pressed

BOUNDS = (0.0, 0.99)
NOISE_M = 1e-4


def seen_sheet(beta: float | tuple[float, float], seed: int = 5, noise: float = NOISE_M) -> Observation:
    """A sheet of one beta, or of two at low and high y, pushed at its far side, with noise that is stated."""
    body = pushed((7, 8), np.random.default_rng(seed))
    rng = np.random.default_rng(seed + 100)
    count = len(body.rest)
    still = Observation(
        body.rest,
        body.rest,
        body.held,
        np.ones(count, dtype=bool),
        noise=np.full(count, noise),
        shape=body.shape,
        cell=np.arange(count),
        held_measured=False,
    )
    each: FloatArray | float = np.asarray(beta)
    if isinstance(beta, tuple):
        across = next(way for way in splits(still, Model().grouping(still)) if way.names[0].endswith("y"))
        each = np.where(across.first, *beta)[None]
    deformed = Model().body(still).relax(body.held_position, each).position[0]
    shaken = deformed + rng.normal(0.0, noise, deformed.shape)
    shaken[body.held] = body.held_position
    return dataclasses.replace(still, deformed=shaken)


def fitted(seen: Observation, model: Model | None = None) -> Estimate:
    return calibrate([seen], FitOptions(model or Model(), BOUNDS, candidates=40)).estimate


def codes(reasons: tuple[Doubt, ...]) -> list[str]:
    return [one.code for one in reasons]


def swapped(seen: Observation) -> Observation:
    """Displacements with their columns in the wrong order, as of a flow (row, column)."""
    return dataclasses.replace(seen, deformed=seen.rest + (seen.deformed - seen.rest)[:, ::-1])


@pytest.mark.parametrize(
    ("found", "allows", "left"),
    [
        ("identified", (None,), "identified"),
        ("identified", (None, "weak"), "weak"),
        ("weak", ("weak",), "weak"),
        ("at-bound", ("weak",), "at-bound"),
        ("at-bound", ("weak", "unidentified"), "unidentified"),
        ("identified", (), "identified"),
    ],
)
def test_a_verdict_is_no_better_than_its_reasons_allow(
    found: Verdict, allows: tuple[Verdict | None, ...], left: Verdict
) -> None:
    assert limited(found, [Doubt("setting", "", one) for one in allows]) == left


def test_reasons_that_lower_most_come_first_and_causes_before_effects() -> None:
    reasons = doubts.ordered(
        [
            Doubt("noise-contradicted", ""),
            Doubt("aee-outside-interval", "", "weak"),
            Doubt("little-explained", "", "unidentified"),
            Doubt("axes-swapped", "", "unidentified"),
        ]
    )
    assert codes(reasons) == ["axes-swapped", "little-explained", "aee-outside-interval", "noise-contradicted"]


@pytest.mark.parametrize(
    ("share", "allows"), [(0.9, None), (0.7, "weak"), (0.2, "unidentified"), (-3.0, "unidentified")]
)
def test_half_of_the_motion_left_is_no_identification(share: float, allows: Verdict | None) -> None:
    assert [one.allows for one in doubts.little_explained(share)] == ([] if allows is None else [allows])


def test_what_only_trembles_did_not_move() -> None:
    moved = seen_sheet(0.6)
    noise = np.random.default_rng(1).normal(0.0, NOISE_M, moved.rest.shape)
    for still in (
        dataclasses.replace(moved, deformed=moved.rest + noise),
        dataclasses.replace(moved, deformed=moved.rest, noise=None),
    ):
        found = fitted(still)
        assert (found.verdict, codes(found.reasons)[0]) == ("unidentified", "nothing-moved")
        assert "unidentified: nothing moved: the held particles by" in found.verdict_text()
    (reason,) = doubts.little_explained(0.2, seen=[moved])
    assert reason.code == "little-explained"


@pytest.mark.parametrize(("noise_m", "known"), each_once([0.0, NOISE_M], [False, True]))
def test_a_body_that_only_moves_as_a_whole_is_not_asked_for_its_units(noise_m: float, known: bool) -> None:
    moved = seen_sheet(0.6)
    noise = np.random.default_rng(1).normal(0.0, noise_m, moved.rest.shape) if noise_m else 0.0
    turn = Rotation.from_euler("z", 25.0, degrees=True).as_matrix()[: moved.rest.shape[1], : moved.rest.shape[1]]
    for rigid in (moved.rest + 0.01, (moved.rest - moved.rest.mean(axis=0)) @ turn.T):
        given = dataclasses.replace(moved, deformed=rigid + noise)
        found = fitted(given if known else dataclasses.replace(given, noise=None))
        assert (found.verdict, codes(found.reasons)[0]) == ("unidentified", "rigid-motion")
        assert not {"axes-swapped", "units", "little-explained"} & set(codes(found.reasons))
        assert "a rigid motion: a shift and turn of the whole body are" in found.verdict_text()
        (explained,) = (row[1] for row in estimate_rows(found) if row[0] == "explained")
        assert "units" not in explained
    bent = dataclasses.replace(moved, deformed=moved.deformed + 0.01)
    assert "rigid-motion" not in codes(doubts.little_explained(0.2, seen=[bent]))


def test_particles_of_images_that_stay_are_named_with_the_flag_that_leaves_them_out() -> None:
    seen = seen_sheet(0.6)
    stays = seen.rest[:, 0] < np.quantile(seen.rest[:, 0], 0.5)
    half = dataclasses.replace(seen, deformed=np.where(stays[:, None], seen.rest, seen.rest + 0.05), unit="px")
    (reason,) = doubts.little_explained(0.5, seen=[half])
    assert re.search(r"; \d\d% of the particles do not move: --roi or --mask leaves out a background$", reason.text)
    for other in (dataclasses.replace(half, unit="m"), dataclasses.replace(half, deformed=seen.rest + 0.05)):
        (reason,) = doubts.little_explained(0.5, seen=[other])
        assert "--roi" not in reason.text


def test_what_noise_leaves_is_no_misfit() -> None:
    assert not list(doubts.little_explained(0.6, left_is_noise=True))
    assert [one.allows for one in doubts.little_explained(0.2, left_is_noise=True)] == ["unidentified"]


@pytest.mark.parametrize(
    ("low", "least", "rank", "named"),
    [(0.7, 0.85, 0.999, True), (0.7, 0.85, 0.98, False), (0.7, 0.75, 0.0, False), (0.5, 0.85, 1.0, False)],
)
def test_a_least_mean_distance_outside_of_a_narrow_interval_lowers_the_verdict(
    low: float, least: float, rank: float, named: bool
) -> None:
    """In the tails only, and not where the interval is wide: there it is one of many values that fit."""
    known = Identifiability(rise=9.0, explained=1.0, deviation=0.1, misfit=0.0)
    found = doubts.found_in_numbers("beta", (low, 0.8), known, converged=True, least_aee=(least, rank))
    assert [(one.code, one.allows) for one in found] == [("aee-outside-interval", "weak")] * named
    assert all("beta of least mean distance (AEE), 0.85" in one.text for one in found)


@pytest.mark.parametrize(
    ("ratio", "allows"), [(None, ()), (1.4, ()), (0.4, ()), (5.0, (None,)), (20.0, ("weak",)), (0.05, (None,))]
)
def test_noise_that_is_contradicted_is_named(ratio: float | None, allows: tuple[Verdict | None, ...]) -> None:
    assert tuple(one.allows for one in doubts.noise_contradicted(ratio, "given")) == allows


def test_a_contradicted_noise_is_named_by_its_source() -> None:
    """Nobody stated the noise of particles that optical flow followed."""
    (given,), (flow,) = doubts.noise_contradicted(46.7, "given"), doubts.noise_contradicted(46.7, "flow")
    assert "47 times the given noise" in given.text
    assert "47 times the noise estimated from the optical flow" in flow.text
    seen = seen_sheet(0.6)
    assert doubts.noise_source([seen]) == "given"
    assert doubts.noise_source([seen, dataclasses.replace(seen, noise=None)]) == "residuals"


def test_outliers_do_not_contradict_the_noise() -> None:
    seen = seen_sheet(0.6)
    rng = np.random.default_rng(1)
    residual = rng.normal(0.0, NOISE_M, seen.rest.shape)
    residual[rng.permutation(len(residual))[:5]] *= 100.0
    assert 0.7 < doubts.residual_ratio([seen], [seen.deformed - residual], 1e-9) < 1.4


def test_units_are_doubted() -> None:
    seen = seen_sheet(0.6)
    assert not list(doubts.implausible_lengths([seen]))
    for factor, words in ((40.0, "2.8 m large"), (1e-3, "7e-05 m large")):
        (large,) = doubts.implausible_lengths(
            [dataclasses.replace(seen, rest=factor * seen.rest, deformed=factor * seen.deformed)]
        )
        assert words in large.text
        assert large.allows is None
        assert [one.allows for one in doubts.of_stiffness([large])] == ["weak"]
    (other,) = doubts.implausible_lengths([dataclasses.replace(seen, deformed=0.1 * seen.deformed)])
    assert other.allows == "unidentified"
    assert "two units" in other.text


def test_a_mirrored_shape_is_named_and_a_turned_one_is_not() -> None:
    seen = seen_sheet(0.6)
    known = np.ones(len(seen.rest), dtype=bool)
    (reason,) = doubts.mirrored(seen.rest, seen.deformed[:, ::-1], known)
    assert reason.code == "axes-swapped"
    assert not list(doubts.mirrored(seen.rest, seen.deformed @ np.array([[0.0, 1.0], [-1.0, 0.0]]), known))
    assert not list(doubts.mirrored(seen.rest, seen.rest[:, ::-1] * [1.0, -1.0], known))


@pytest.mark.parametrize("dim", [2, 3])
def test_each_turn_of_the_columns_is_another_one(dim: int) -> None:
    """Also but for the sign of all, which small motions do not show."""
    every = [sign * matrix for _, matrix in doubts.turns(dim) for sign in (1.0, -1.0)] + [np.eye(dim), -np.eye(dim)]
    assert all(np.abs(a - b).max() > 0.5 for i, a in enumerate(every) for b in every[i + 1 :])
    assert all(np.allclose(matrix @ matrix.T, np.eye(dim)) for matrix in every)


def test_one_material_raises_no_reason() -> None:
    found = fitted(seen_sheet(0.6))
    assert found.reasons == ()
    assert found.verdict == "identified"
    assert found.as_json()["reasons"] == []


def test_two_materials_are_named_and_no_beta_is_identified() -> None:
    found = fitted(seen_sheet((0.2, 0.8)))
    assert codes(found.reasons)[0] == "two-materials"
    assert found.verdict == "unidentified"
    assert found.verdict_text().startswith("unidentified: residuals show two materials or thicknesses: beta 0.2")
    shown = found.as_json()["reasons"]
    assert shown[0]["code"] == "two-materials"  # type: ignore[index]
    assert shown[0]["allows"] == "unidentified"  # type: ignore[index]


@pytest.mark.parametrize("what", ["swapped", "sign", "mirrored"])
def test_columns_in_the_wrong_order_are_named(what: str) -> None:
    seen = seen_sheet(0.6)
    moved = (seen.deformed - seen.rest) * [1.0, -1.0]
    wrong = {
        "swapped": swapped(seen),
        "sign": dataclasses.replace(seen, deformed=seen.rest + moved),
        "mirrored": dataclasses.replace(seen, deformed=seen.deformed[:, ::-1]),
    }[what]
    found = fitted(wrong)
    assert codes(found.reasons)[0] == "axes-swapped"
    assert found.verdict == "unidentified"


def test_columns_of_images_are_in_order() -> None:
    """Plates of a low Poisson's ratio looked exchanged."""
    seen = swapped(seen_sheet(0.6))
    filmed = dataclasses.replace(
        seen, unit="px", metres_per_unit=1e-4, rest=1e4 * seen.rest, deformed=1e4 * seen.deformed
    )
    assert "axes-swapped" in codes(fitted(seen).reasons)
    assert "axes-swapped" not in codes(fitted(filmed).reasons)


def test_noise_stated_far_too_small_is_not_identified() -> None:
    seen = seen_sheet(0.6, noise=5e-4)
    assert seen.noise is not None
    found = fitted(dataclasses.replace(seen, noise=seen.noise / 20.0))
    assert "noise-contradicted" in codes(found.reasons)
    assert found.verdict != "identified"


def test_two_betas_that_noise_mostly_hides_are_named_by_the_likelihood_alone() -> None:
    """Noise of a quarter of a spacing, stated: two betas leave more of the error than misfits may."""
    found = fitted(seen_sheet((0.2, 0.8), 6, 2.5e-3))
    (text,) = (one.text for one in found.reasons if one.code == "two-materials")
    assert LEFT < float(text.split("leave ")[1].split("%")[0]) / 100.0 < LEFT_SURE
    assert found.verdict == "unidentified"
    assert "two-materials" not in codes(fitted(seen_sheet(0.6, 6, 2.5e-3)).reasons)


def test_theta_gives_its_setting_and_is_not_identified_where_the_model_misfits() -> None:
    """Thesis 3.A: finite element cubes of one Poisson's ratio, whose theta falls with the depth."""
    cubes, _ = thesis_cubes((0.4,), (6,), (0.01, 0.03))
    model = Model("theta", "quadratic", None)
    found = [calibrate([cube.seen], FitOptions(model, (0.0, 1.0))).estimate for cube in cubes]
    assert found[0].value > found[1].value + 0.1
    for one, share in zip(found, ("10%", "30%"), strict=True):
        assert one.verdict == "weak"
        assert "setting" in codes(one.reasons)
        text = next(reason.text for reason in one.reasons if reason.code == "setting")
        assert f"a push of {share} of the body's size, 216 particles in one quadratic cluster, beta 0.99" in text
    exact = cubes[0].seen
    state = model.body(exact).relax(exact.deformed[exact.held], 0.99, 0.5).position[0]
    same = calibrate([dataclasses.replace(exact, deformed=state)], FitOptions(model, (0.0, 1.0))).estimate
    assert same.verdict == "identified"
    assert codes(same.reasons) == ["setting"]


@pytest.mark.parametrize("kind", ["two-materials", slow("axes-swapped")])
def test_axes_name_what_one_beta_does(kind: str) -> None:
    seen = seen_sheet((0.2, 0.8)) if kind == "two-materials" else swapped(seen_sheet(0.6))
    found = fit_axes([seen], Model())
    for reasons, verdict in zip(found.reasons, found.verdict, strict=True):
        assert kind in codes(reasons)
        assert verdict == "unidentified"
    assert not [one for reasons in fit_axes([seen_sheet(0.6)], Model()).reasons for one in reasons]


def test_yielding_names_what_one_beta_does() -> None:
    motion = pressed((5, 4), 0.07, frames=2)
    options = YieldOptions(beta=BETA)
    other = dataclasses.replace(motion, position=motion.rest + (motion.position - motion.rest)[:, :, ::-1])
    found = fit_yield(other, options)
    assert "axes-swapped" in codes(found.reasons)
    assert found.verdict == "unidentified"
    assert found.as_json()["reasons"][0]["code"] == "axes-swapped"  # type: ignore[index]


@pytest.mark.slow
def test_yielding_names_nothing_on_one_material() -> None:
    assert fit_yield(pressed((6, 4), 0.07), YieldOptions(beta=BETA)).reasons == ()


@pytest.mark.slow
def test_yielding_names_two_materials() -> None:
    motion = pressed((6, 6), 0.07)
    still = Observation(
        motion.rest,
        motion.rest,
        np.flatnonzero(motion.held[0]),
        np.ones(len(motion.rest), dtype=bool),
        shape=motion.shape,
        cell=motion.cell,
    )
    model = Model(volume="project")
    beta = np.where(splits(still, model.grouping(still))[0].first, 0.2, 0.9)[None]
    body = PlasticMsm(model.body(still), Plasticity(0.07))
    states = []
    for position, held in zip(motion.position, motion.held, strict=True):
        body.hold(np.flatnonzero(held))
        states.append(body.load(position[held], beta).position[0])
    found = fit_yield(dataclasses.replace(motion, position=np.array(states)), YieldOptions())
    assert "two-materials" in codes(found.reasons)
    assert found.verdict == "unidentified"


def test_splits_take_a_body_as_two_halves_or_a_lump_and_the_rest() -> None:
    seen = seen_sheet(0.6)
    grouped = Model().grouping(seen)
    for way in splits(seen, grouped):
        assert 0.25 <= way.first.mean() <= 0.5
    names = [way.names[0] for way in splits(seen, grouped)]
    assert names[:3] == ["at low x", "at low y", "near the push"]
    assert len(names) == 3 + INCLUSIONS
    assert all(name.startswith("around (0.0") for name in names[3:])
    assert all(a != b for a, b in pairwise(way.first.tobytes() for way in splits(seen, grouped)))


def test_the_setting_counts_for_nothing_where_noise_outweighs_the_misfit() -> None:
    seen = seen_sheet(0.6)
    for misfit, noise, allows in ((4e-5, 1e-4, None), (6e-5, 1e-4, "weak"), (1e-4, 1e-5, "weak")):
        assert [one.allows for one in doubts.setting([seen], Model("theta"), misfit, noise)] == [allows]
    # what is left is the solver's
    assert [one.allows for one in doubts.setting([seen], Model("theta"), 1e-7, 1e-9)] == [None]


def plates(slide_m: float, noise_m: float, seed: int = 0, turn_deg: float = 0.0) -> Observation:
    """A cube of 10 cm between plates, pressed by 1 cm, whose top slides outwards by `slide_m` at its edges."""
    rest = lattice((6, 6, 6), 0.02)
    at = rest - rest.mean(axis=0)
    bottom, top = (np.flatnonzero(np.isclose(rest[:, 2], z)) for z in (rest[:, 2].min(), rest[:, 2].max()))
    strain = slide_m / 0.05
    deformed = rest.copy()
    deformed[:, 2] -= 0.01 * (at[:, 2] + 0.05) / 0.1
    deformed[:, :2] += at[:, :2] * (strain * (at[:, 2:] + 0.05) / 0.1)
    turn = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    deformed[top] = (deformed[top] - deformed[top].mean(axis=0)) @ turn.T + deformed[top].mean(axis=0)
    deformed += np.random.default_rng(seed).normal(0.0, noise_m, rest.shape)
    noise = np.full(len(rest), max(noise_m, 1e-6))
    return Observation(rest, deformed, np.append(bottom, top), np.ones(len(rest), dtype=bool), noise=noise)


@pytest.mark.parametrize(("slide_m", "noise_m"), [(4e-4, 0.0), (-4e-4, 5e-5), (1.2e-3, 2e-4)])
def test_plates_that_slide_are_named_in_the_setting_of_theta(slide_m: float, noise_m: float) -> None:
    slides, here = doubts.setting([plates(slide_m, noise_m)], Model("theta"), 0.0, max(noise_m, 1e-6))
    assert (slides.code, slides.allows, here.code) == ("held-slides", "weak", "setting")
    edge = float(re.search(r"slide by up to (\S+) m", here.text)[1])
    assert edge == pytest.approx(np.sqrt(2.0) * abs(slide_m), rel=0.3)
    assert "friction" in slides.text


@pytest.mark.parametrize("slides", [False, True])
def test_a_cube_whose_plate_slides_has_a_theta_of_its_own_that_is_not_identified(slides: bool) -> None:
    """Finite elements without friction at the top: the setting is named, whatever the interval."""
    axis = np.linspace(0.0, 0.1, 5)
    box = ElasticBox(axis, axis, axis, young=5e4, poisson=0.33)
    bottom, top = box.plane(2, 0.0), box.plane(2, 0.1)
    fixed = np.repeat((bottom | top)[:, None], 3, axis=1)
    fixed[top, :2] = not slides
    fixed[top & (np.abs(box.nodes[:, :2] - 0.05).max(axis=1) < 1e-9)] = True
    pressed = np.zeros(box.nodes.shape)
    pressed[top, 2] = -0.01
    rest, moved = box.nodes[box.corners], box.hold(fixed).solve(pressed).displacement[box.corners]
    held = np.flatnonzero((bottom | top)[box.corners])
    noise = np.random.default_rng(5).normal(0.0, 4e-4, rest.shape)
    noise[held] *= 0.1
    sd = np.where(np.isin(np.arange(len(rest)), held), 4e-5, 4e-4)
    seen = Observation(rest, rest + moved + noise, held, np.ones(len(rest), dtype=bool), noise=sd, held_measured=True)
    model = Model("theta", cluster_size=None, basis="quadratic", beta=0.99)
    found = calibrate([seen], FitOptions(model, (0.0, 1.0))).estimate
    assert ("held-slides" in codes(found.reasons)) is slides
    assert found.verdict != "identified" or not slides


@pytest.mark.parametrize("turn_deg", [0.0, 3.0])
@pytest.mark.parametrize("noise_m", [0.0, 5e-4])
def test_plates_that_hold_a_body_are_named_too(noise_m: float, turn_deg: float) -> None:
    """By noise of .5 mm in a push of 1 cm, or as the plate turns, nothing slides."""
    for seed in range(200 if noise_m else 1):
        (here,) = doubts.setting([plates(0.0, noise_m, seed, turn_deg)], Model("theta"), 0.0, max(noise_m, 1e-6))
        assert "held particles that do not slide" in here.text
