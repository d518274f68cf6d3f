"""A stiffness for each place: bodies of finite elements that are not the fitted ones, and data that tell nothing."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.distance import cdist
from scipy.stats import multivariate_normal, norm

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.model import Observation
from deformscope.stages.materials.field import fit_field
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.field_fit import (
    SPREAD,
    FieldFit,
    NoiseModel,
    StiffnessPrior,
    in_whole_cells,
    likeliest_noise,
)
from deformscope.stages.materials.field_levels import border_cells, border_length, cuts, gain, neighbours, sharpened
from studies.field_bodies import SPACING_M, elastic_pair
from studies.independent.orthotropic_elements import OrthotropicLaw, PlateWay, isotropic, plate
from tests.cases import slow

SMALL = (11, 8)


def halves(places: FloatArray) -> FloatArray:
    return np.asarray(np.where(places[:, 0] < 0.05, 10e3, 40e3))


def found(seen: Observation) -> FieldEstimate:
    return fit_field(seen)[0]


def held_share(estimate: FieldEstimate, young: FloatArray) -> float:
    """Share of the places whose interval holds the truth."""
    true = young / np.exp(np.log(young).mean())
    low, high = estimate.interval.T
    return float(np.mean((low <= true) & (true <= high)))


def test_two_materials_their_border_and_their_ratio() -> None:
    estimate = found(elastic_pair(SMALL, halves))
    assert estimate.verdict == "materials"
    assert estimate.materials == 2
    assert abs(estimate.ratio / 4.0 - 1.0) < 0.15
    assert estimate.ratio_interval[0] < 4.0 < estimate.ratio_interval[1]
    stiff = estimate.material == 1
    sure = np.abs(estimate.place[:, 0] - 0.05) > SPACING_M
    assert np.array_equal(stiff[sure], estimate.place[sure, 0] > 0.05)
    assert held_share(estimate, halves(estimate.place)) > 0.85
    # softer is the larger beta, and the force tells the moduli: of a plate 2 mm thick
    assert estimate.beta[stiff].max() < estimate.beta[~stiff].min()
    assert estimate.absolute is not None
    assert np.allclose(estimate.absolute, halves(estimate.place) * 0.002, rtol=0.1)
    places = estimate.as_json()["places"]
    assert isinstance(places, dict)
    assert len(places["at_m"]) == 70


@pytest.mark.parametrize("seed", [4, 9])
def test_the_ratio_of_a_smooth_border_is_within_its_interval(seed: int) -> None:
    """10 to 90 % of the change are within 3.3 spacings: of other elements, and their noise."""

    def young(places: FloatArray) -> FloatArray:
        return np.asarray(1.0 + 1.5 * (1.0 + np.tanh((places[:, 0] - 0.06) / 0.015)))

    shape = (13, 8)
    seen = plate(shape, isotropic(0.3), young, way="shear", camera=False, rng=np.random.default_rng([seed, 5]))
    everyone = np.ones(len(seen.rest), dtype=bool)
    estimate = found(
        Observation(seen.rest, seen.deformed, seen.held, everyone, shape=shape, cell=np.arange(len(seen.rest)))
    )
    true = float(np.ptp(np.log(young(estimate.place))))
    low, high = np.log(estimate.ratio_interval)
    assert low < true < high
    assert abs(np.log(estimate.ratio) - true) < 0.3
    assert held_share(estimate, young(estimate.place)) > 0.8


def test_wide_borders_are_normal_distribution_functions_that_may_lie_elsewhere() -> None:
    fit = FieldFit(elastic_pair((21, 3), halves), "elastic")
    width, level, at = 1.7, np.array([0.2, 0.8]), fit.place[:, 0] / fit.spacing - 10.0
    prior = fit.wide_levels((at > 0.0).astype(np.int64), level, width)
    soft, stiff, shift = prior.root[: len(at), :3].T
    near = np.abs(at) < 8.0
    assert soft + stiff == pytest.approx(np.full(len(at), 2.0 * SPREAD))
    assert stiff[near] / (2.0 * SPREAD) == pytest.approx(norm.cdf(at[near] / width), abs=0.01)
    ahead, behind = (norm.cdf((at + sign * 0.1) / width) for sign in (1.0, -1.0))
    assert shift[near] == pytest.approx(0.6 * (ahead - behind)[near] / 0.2, abs=0.01)


def own_plate(law: OrthotropicLaw, way: PlateWay, *, camera: bool = False, seed: int = 0) -> Observation:
    """One material of other elements, and its noise."""
    rng = np.random.default_rng(seed)
    seen = plate(SMALL, law, lambda place: np.ones(len(place)), way=way, camera=camera, rng=rng)
    everyone = np.ones(len(seen.rest), dtype=bool)
    return Observation(seen.rest, seen.deformed, seen.held, everyone, shape=SMALL, cell=np.arange(len(seen.rest)))


def test_one_material_that_is_stiffer_along_a_direction_is_one_material() -> None:
    law = OrthotropicLaw(stiff=2.5, soft=1.0, nu=0.3, shear=0.6, angle=0.3)
    estimate = found(own_plate(law, "shear"))
    assert estimate.verdict == "anisotropic"
    assert estimate.ratio == pytest.approx(1.0)
    assert estimate.ratio_interval[1] < 2.5
    true = law.modulus(estimate.directions.stiffest) / law.modulus(estimate.directions.softest)
    assert estimate.directions.ratio == pytest.approx(true, rel=0.3)
    json = estimate.as_json()
    assert isinstance(json["directions"], dict)
    assert json["directions"]["ratio"] == estimate.directions.ratio
    assert dict(zip(estimate.tried, estimate.plausible, strict=True))["one material, anisotropic"]


@pytest.mark.slow
def test_a_camera_that_drifts_makes_no_field() -> None:
    estimate = found(own_plate(isotropic(0.3), "shear", camera=True, seed=2))
    assert estimate.verdict in ("uniform", "unidentified")
    assert "smooth-error" in [one.code for one in estimate.reasons]
    assert "identified" not in estimate.verdicts


def test_smooth_errors_of_what_is_held_move_the_rest() -> None:
    """Their derivatives beside differences: held particles are where they were seen, less the error."""
    fit = FieldFit(elastic_pair((6, 5), halves), "elastic", "smooth error")
    prior = fit.levels(np.zeros(len(fit.cells), dtype=np.int64))
    at = prior.mean + prior.root @ np.random.default_rng(0).standard_normal(prior.root.shape[1])
    _, _, slope = fit.state(at)
    for number in (len(fit.cells), len(fit.cells) + 1, len(at) - 1):
        change = 1e-5 * (np.arange(len(at)) == number)
        ahead, behind = (fit.state(at + sign * change)[1] for sign in (1.0, -1.0))
        assert slope[:, number] == pytest.approx((ahead - behind) / 2e-5, abs=1e-6)


@pytest.mark.parametrize("kind", ["rigid", slow("nothing"), slow("noise")])
def test_data_that_tell_nothing_are_unidentified(kind: str) -> None:
    seen = elastic_pair(SMALL, halves)
    errors = 1e-4 * np.random.default_rng(1).standard_normal(seen.rest.shape)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    deformed = {
        "nothing": seen.rest + errors,
        "rigid": seen.rest @ turn.T + 0.1,
        "noise": seen.rest + (seen.deformed - seen.rest) / 40.0 + 5.0 * errors,
    }[kind]
    estimate = found(dataclasses.replace(seen, deformed=deformed, force_n=None))
    assert estimate.verdict == "unidentified"
    assert estimate.determined < 0.2


def test_what_strains_alike_is_not_told_apart() -> None:
    """In a uniform stretch layers along it strain alike, whatever their moduli: that all look the same says nothing."""
    seen = elastic_pair(SMALL, halves)
    errors = 1e-4 * np.random.default_rng(1).standard_normal(seen.rest.shape)
    stretched = seen.rest * np.array([1.05, 1.0 - 0.3 * 0.05]) + errors
    estimate = found(dataclasses.replace(seen, deformed=stretched, force_n=None))
    assert estimate.materials < 2
    assert estimate.ratio_interval[1] > 4.0
    assert estimate.verdict == "unidentified"


def test_a_tool_on_a_part_of_a_face_is_unidentified() -> None:
    seen = elastic_pair(SMALL, halves)
    part = np.delete(seen.held, [8, 9, 10])  # of the end that was moved
    estimate = found(dataclasses.replace(seen, held=part, force_n=None))
    assert estimate.verdict == "unidentified"
    assert set(estimate.verdicts) == {"unidentified"}
    assert "setting" in [one.code for one in estimate.reasons]


def test_evidence_is_the_density_of_what_was_seen() -> None:
    fit = FieldFit(elastic_pair((6, 5), halves), "elastic")
    prior = fit.levels((fit.place[:, 0] > 0.03).astype(np.int64), np.array([2, 3]))
    point = fit.fit(prior, NoiseModel(1.0, 0.02))
    noise, evidence = likeliest_noise(fit, prior, point)
    root = fit.noise_root(noise, point.state.response)
    spread = point.slope @ prior.root
    seen = multivariate_normal(point.slope @ prior.mean, root @ root.T + spread @ spread.T)
    expected = seen.logpdf(point.linear(fit.target)) + 0.5 * len(fit.target) * np.log(2.0 * np.pi)
    assert evidence == pytest.approx(expected, abs=1e-6)


def test_borders_move_in_patches_where_single_cells_do_not() -> None:
    """A patch of nine that was given to the wrong material: every single cell of it would cost more border."""
    rng = np.random.default_rng(0)
    place = np.stack(np.meshgrid(np.arange(12.0), np.arange(9.0), indexing="ij"), axis=-1).reshape(-1, 2)
    true = (place[:, 0] > 5.5).astype(np.int64)
    edges = neighbours(place, 1.0)
    smoothed = np.exp(-0.5 * cdist(place, place) ** 2)  # what is seen is blurred over some cells
    y = smoothed @ (np.log(4.0) * true - 0.5 * np.log(4.0)) + 0.5 * rng.standard_normal(len(true))

    def levels(label: IntArray) -> StiffnessPrior:
        root = np.zeros((len(label) + 1, label.max() + 2))
        root[:-1, :-1], root[-1, -1] = 2.0 * np.eye(label.max() + 1)[label], 1.0
        return StiffnessPrior(np.zeros(len(label) + 1), root)

    wrong = true.copy()
    wrong[(place[:, 0] > 5.5) & (place[:, 0] < 8.5) & (place[:, 1] > 2.5) & (place[:, 1] < 5.5)] = 0
    found_label = sharpened(wrong, levels, edges, y, np.column_stack([smoothed, np.zeros(len(true))]))
    assert np.array_equal(found_label, true)
    assert border_length(found_label, edges) == 9
    assert np.array_equal(np.unique(place[border_cells(found_label, edges), 0]), [5.0, 6.0])


def test_a_material_is_cut_where_the_data_want_it() -> None:
    """Of two materials found, one is two in truth: the cut that lowers chi2 most is the border between them."""
    rng = np.random.default_rng(1)
    place = np.stack(np.meshgrid(np.arange(12.0), np.arange(9.0), indexing="ij"), axis=-1).reshape(-1, 2)
    found_label, true = ((place[:, 0] > 3.5) * 1, (place[:, 0] > 3.5) * 1 + (place[:, 0] > 7.5) * 1)
    smoothed = np.column_stack([np.exp(-0.5 * cdist(place, place) ** 2 / 4.0), np.zeros(len(place))])
    y = smoothed @ np.append(np.array([-1.0, 1.0, 0.2])[true], 0.0) + 0.5 * rng.standard_normal(len(place))

    def gained(label: IntArray) -> float:
        root = np.zeros((len(label) + 1, label.max() + 2))
        root[:-1, :-1], root[-1, -1] = 2.0 * np.eye(label.max() + 1)[label], 1.0
        return gain(StiffnessPrior(np.zeros(len(label) + 1), root), smoothed.T @ smoothed, smoothed.T @ y)

    across_x, across_y = cuts(found_label, place, 1.0)
    best = max(across_x, key=gained)
    assert np.array_equal(np.unique(true, return_inverse=True)[1], best)
    assert gained(best) > max(map(gained, across_y)) + 10.0
    assert (len(across_x), len(across_y)) == (3 + 7, 2 * 8)
    assert {int(one.max()) for one in across_x + across_y} == {2}


def test_errors_are_as_large_as_is_likeliest() -> None:
    """To within a few hundredths, as another search has it: off by an eighth, 154 numbers are 5 nats less likely, which
    decides between descriptions."""
    fit = FieldFit(elastic_pair(SMALL, halves, noise_m=0.0153 * SPACING_M, reach=1.4, seed=4), "elastic")
    prior = fit.levels((fit.place[:, 0] > 0.05).astype(np.int64))
    point = fit.fit(prior, NoiseModel(1.0, 0.02))
    noise, _ = likeliest_noise(fit, prior, point)
    shared = fit.noise_root(dataclasses.replace(noise, size=1.0), point.state.response)
    spread = point.slope @ prior.root

    def unlikely(log_size: float) -> float:
        covariance = np.exp(2.0 * log_size) * shared @ shared.T + spread @ spread.T
        return -float(multivariate_normal(point.slope @ prior.mean, covariance).logpdf(point.linear(fit.target)))

    likeliest = minimize_scalar(unlikely, bounds=(np.log(0.001), np.log(0.1)), method="bounded")
    assert (noise.reach, noise.smooth) == (1.4, False)
    assert noise.size == pytest.approx(np.exp(likeliest.x), rel=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_errors_may_be_as_smooth_as_filtered_images(seed: int) -> None:
    seen = elastic_pair(SMALL, halves, noise_m=0.0)
    gap = cdist(seen.rest, seen.rest) / SPACING_M
    root = np.linalg.cholesky(np.exp(-0.5 * (gap / 2.0) ** 2) + 0.002 * np.eye(len(gap)))
    errors = 0.02 * SPACING_M * root @ np.random.default_rng(seed).standard_normal(seen.rest.shape)
    fit = FieldFit(dataclasses.replace(seen, deformed=seen.deformed + errors), "elastic")
    prior = fit.levels((fit.place[:, 0] > 0.05).astype(np.int64))
    point = fit.fit(prior, NoiseModel(1.0, 0.02))
    noise, _ = likeliest_noise(fit, prior, point)
    assert (noise.reach, noise.smooth) == (2.0, True)
    assert noise.size == pytest.approx(0.02, rel=0.4)
    again, _ = likeliest_noise(fit, prior, point, near=NoiseModel(1.4, 0.02))
    assert again == noise


def test_particles_of_no_whole_cell_are_left_out() -> None:
    seen = elastic_pair(SMALL, halves)
    rows = np.flatnonzero(np.arange(len(seen.rest)) != 81)  # beside a corner of the lattice, held
    held = np.searchsorted(rows, seen.held[seen.held != 81])
    ragged = dataclasses.replace(
        seen, rest=seen.rest[rows], deformed=seen.deformed[rows], held=held, observed=seen.observed[rows], cell=rows
    )
    whole = in_whole_cells(ragged)
    assert len(whole.rest) == len(seen.rest) - 2
    assert np.isin(whole.rest[whole.held, 0], [0.0, 0.1]).all()
    assert len(whole.held) == len(seen.held) - 2


def test_a_surface_without_depth_and_points_without_a_lattice_are_refused() -> None:
    seen = elastic_pair(SMALL, halves)
    with pytest.raises(InputError, match="particles on a lattice"):
        fit_field(dataclasses.replace(seen, shape=None))
    space = [np.column_stack([points, np.zeros(len(points))]) for points in (seen.rest, seen.deformed)]
    with pytest.raises(InputError, match="fills the plane, or space"):
        fit_field(dataclasses.replace(seen, rest=space[0], deformed=space[1]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_gradual_and_uniform_bodies_and_three_materials(seed: int) -> None:
    shape = (17, 13)

    def gradual(places: FloatArray) -> FloatArray:
        return np.asarray(10e3 * 4.0 ** (places[:, 0] / 0.16))

    def three(places: FloatArray) -> FloatArray:
        return np.asarray(np.select([places[:, 0] < 0.06, places[:, 0] < 0.11], [10e3, 60e3], 20e3))

    smooth = found(elastic_pair(shape, gradual, seed=seed))
    assert smooth.verdict == "gradual"
    # of each place over the geometric mean of all, which is 20 kPa
    assert np.sqrt(np.mean(np.log(smooth.stiffness * 20e3 / gradual(smooth.place)) ** 2)) < 0.2
    assert found(elastic_pair(shape, lambda places: np.full(len(places), 20e3), seed=seed)).verdict == "uniform"
    several = found(elastic_pair(shape, three, seed=seed))
    assert several.materials == 3
    assert abs(several.ratio / 6.0 - 1.0) < 0.2


@pytest.mark.slow
def test_a_slab_in_space() -> None:
    estimate = found(elastic_pair((11, 6, 4), halves, noise_m=5e-5))
    assert estimate.verdict == "materials"
    assert abs(estimate.ratio / 4.0 - 1.0) < 0.15
    assert estimate.absolute is not None
    assert np.allclose(estimate.absolute, halves(estimate.place) * SPACING_M, rtol=0.15)
