"""The thesis's beta of a dent, its field beside scikit-learn's, its isopleths, and the plan that it ends."""

import dataclasses

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore.robot_geometry import Touch
from deformscope.lab.scenes import built_in
from deformscope.stages.map.field import FieldMap
from deformscope.stages.map.plan import PlanOptions
from deformscope.stages.map.surface import HeightProcess
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import MapGrid, TouchErrorModel
from deformscope.stages.see.cloud import contact_radius_m
from studies.reproduce import thesis_map
from studies.reproduce.surface_robot import LabRobot
from studies.reproduce.thesis_dent import TACTILE_NOISE_M, SeenDent, dent_of, tactile_points, with_tactile
from studies.reproduce.thesis_map import (
    SIGMA_E,
    SIGMA_N,
    SIGMA_W_M,
    THESIS_NOTE,
    ThesisField,
    ThesisFlags,
    ThesisOptions,
    ThesisSurface,
    contoured,
    plan_thesis_touch,
    swept_betas,
    thesis_beta,
)
from studies.reproduce.thesis_rules import OWN, ScenarioCase, explore_scenario
from tests.stages.map.test_surface import SIZE, exact, with_a_hole
from tests.stages.map.test_touch_beta import AT, RADIUS, THICKNESS, level, of_our_own

__all__ = ["level"]

GRID = MapGrid((0.6, 0.4), 0.02)
DENT = MapGrid((0.04, 0.04), 0.01).centres_m


def touched(*touches: tuple[float, float, float]) -> ThesisField:
    """After touches at (x, y) with beta, each of which dented 4 x 4 cm."""
    field = ThesisField()
    for x, y, beta in touches:
        field = field.with_touch(DENT + np.array([x - 0.02, y - 0.02]), beta)
    return field


def test_mean_and_deviation_are_those_of_another_gaussian_process() -> None:
    field = touched((0.15, 0.2, 0.7), (0.4, 0.1, 0.2))
    length = SIGMA_W_M / np.sqrt(2.0)
    kernel = ConstantKernel(SIGMA_E**2, "fixed") * RBF(length, "fixed")
    other = GaussianProcessRegressor(kernel, alpha=SIGMA_N**2, optimizer=None).fit(field.places_m, field.beta)
    mean, deviation = other.predict(GRID.centres_m, return_std=True)
    found = field.on(GRID)
    assert found.mean.ravel() == pytest.approx(mean, abs=1e-9)
    assert found.deviation.ravel() == pytest.approx(deviation, abs=1e-6)


def test_before_any_touch_nothing_is_known() -> None:
    found = ThesisField().on(GRID)
    assert (found.mean == 0.0).all()
    assert (found.deviation == SIGMA_E).all()
    assert not len(ThesisField().isopleths)


def test_isopleths_run_halfway_between_touches_that_are_apart() -> None:
    field = touched((0.1, 0.1, 0.5), (0.2, 0.2, 0.0), (0.3, 0.3, 0.55), (0.4, 0.3, 0.9))
    assert field.isopleths == pytest.approx([0.25, 0.725])


def test_a_field_is_cut_into_the_bands_that_it_has() -> None:
    mean = np.array([[0.9, 0.5, 0.1], [0.8, 0.6, 0.0]])
    found = contoured(FieldMap(MapGrid((0.03, 0.02), 0.01), mean, np.full((2, 3), 0.1)), np.array([0.3, 0.7, 2.0]))
    assert found.labels.tolist() == [[0, 1, 2], [0, 1, 2]]
    assert found.probability[0, 1] == pytest.approx(0.9545, abs=1e-4)  # two deviations on either side
    assert found.probability[0, 0] == pytest.approx(0.9772, abs=1e-4)


def test_a_dent_is_all_that_sank_by_a_tenth_of_the_deepest() -> None:
    places = MapGrid((0.03, 0.02), 0.01).centres_m
    before = np.column_stack([places, np.full(6, 0.05)])
    after = before - np.outer([0.0, 0.009, 0.011, 0.1, -0.02, 0.05], [0.0, 0.0, 1.0])
    assert SeenDent(before, after, (2, 3)).dented_m.tolist() == places[[2, 3, 5]].tolist()


def test_the_plan_goes_where_the_field_is_unknown_and_ends_with_its_variance_alone() -> None:
    posterior = RegionPosterior.before_touches(MapGrid((0.6, 0.4)), seed=0)
    options = PlanOptions(budget=12)
    field, seen = touched((0.15, 0.2, 0.7)), set()
    for seed in range(8):
        plan = plan_thesis_touch(field, posterior, options, seed=seed)
        assert plan.stop is None
        assert float(field.at(plan.target_m[None]).deviation[0]) ** 2 > options.threshold * SIGMA_E**2
        seen.add(tuple(plan.target_m))
    assert len(seen) > 4
    plan = plan_thesis_touch(touched(*((x, y, 0.5) for x in (0.1, 0.3, 0.5) for y in (0.1, 0.3))), posterior, options)
    assert plan.stop == "nothing above the threshold"


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [0.3, -0.2, 0.9]])
def test_tactile_points_lie_on_the_ball_where_it_touches(normal: list[float]) -> None:
    up = np.array(normal) / np.linalg.norm(normal)
    lowest, radius, depth = np.array([0.3, 0.2, 0.045]), 0.01, 0.004
    points = tactile_points(lowest, radius, depth, normal=up)
    assert points.shape == (10, 3)
    np.testing.assert_allclose(np.linalg.norm(points - lowest - radius * up, axis=1), radius, rtol=1e-9)
    np.testing.assert_allclose(points[0], lowest)
    aside = np.linalg.norm(points - lowest - np.outer((points - lowest) @ up, up), axis=1)
    assert aside.max() == pytest.approx(contact_radius_m(radius, depth))
    assert contact_radius_m(radius, depth) == pytest.approx(np.sqrt(radius * depth))
    assert contact_radius_m(radius, 0.02) == radius


# By its options ------------------------------------------------------------------------------------------------------


def test_grid_sweep_and_places_are_the_thesiss_by_default() -> None:
    assert OWN.thesis.beta_grid_m == OWN.planning.cell_m == 0.005
    np.testing.assert_allclose(swept_betas(OWN.thesis.beta_step), np.arange(100) / 100.0)
    assert OWN.search(GRID, TouchErrorModel()).thesis.width_m == 0.5


def test_others_are_taken_where_they_are_asked_for() -> None:
    options = ThesisOptions(beta_model="none", thesis=ThesisFlags(beta_grid_m=0.01, beta_step=0.25, sigma_w_m=0.7))
    assert options.planning.cell_m == 0.01
    assert swept_betas(options.thesis.beta_step).tolist() == [0.0, 0.25, 0.5, 0.75]
    assert options.search(GRID, TouchErrorModel()).thesis.width_m == 0.7
    for wrong in ({"beta_grid_m": 0.0005}, {"beta_step": 0.0}, {"sigma_w_m": 0.0}):
        with pytest.raises(InputError):
            ThesisFlags(**wrong)


@pytest.mark.slow
def test_a_touch_is_swept_on_that_grid_in_those_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The dent that the sweep is given, and the step."""
    given = []

    def swept(dent: SeenDent, *, step: float) -> None:
        given.append((dent, step))
        raise InputError("what was given", "enough")

    monkeypatch.setattr(thesis_map, "thesis_beta", swept)
    scene = built_in("homogeneous-60", 0)
    options = dataclasses.replace(OWN, thickness_m=scene.thickness_m)
    robot = LabRobot(scene, options)
    explorer = ThesisSurface(scene.size_m, options, robot.arm, robot.truth).look(robot.look())
    at = 0.5 * np.asarray(scene.size_m)
    explorer.touch(robot.touch(Touch(at, *explorer.surface.aim(at))))
    ((dent, step),) = given
    assert step == 0.01
    assert dent.shape == (30, 30)
    np.testing.assert_allclose(np.diff(np.unique(dent.before[:, 0])), 0.005)
    assert not explorer.dents
    assert explorer.search.planner().keywords["seed"] == 1  # a touch without a beta counts


@pytest.mark.slow  # several whole touches
def test_it_starts_at_its_place_ends_by_its_variance_and_cuts_along_isopleths() -> None:
    """Of foam and something rigid, by layers: a single layer finds a beta of 0 in either."""
    found = explore_scenario(ScenarioCase("two-150-rigid", 1000))
    layers = found.fields["layers"]
    assert found.contacts_m[0] == pytest.approx([0.15, 0.2])
    assert found.stop_reason == "nothing above the threshold"
    assert 3 <= len(found.contacts_m) <= 6
    assert [beta == 0.0 for beta in layers.touches] == found.rigid.tolist()
    assert layers.regions == 2
    assert layers.iou > 0.6


def test_tactile_points_are_believed_as_they_are_and_do_not_scale_with_the_cameras_noise() -> None:
    rng = np.random.default_rng(6)
    points = np.column_stack([with_a_hole(rng, 600), rng.normal(size=600) * 2e-3])
    dent = np.array([[0.35, 0.2, -0.006], [0.352, 0.2, -0.0059]])
    surface = with_tactile(points, dent)
    np.testing.assert_allclose(surface.noise_m[:600], 2e-3, rtol=0.1)
    np.testing.assert_allclose(surface.noise_m[600:], TACTILE_NOISE_M, rtol=0.01)
    at = surface.at(np.array([[0.35, 0.2]]))
    assert at.mean[0] == pytest.approx(-0.006, abs=6e-4)
    assert at.deviation[0] < 1.1 * TACTILE_NOISE_M
    asked = rng.uniform(size=(40, 2)) * SIZE
    mean, deviation = exact(surface, np.concatenate([points, dent]), surface.noise_m, asked)
    np.testing.assert_allclose(surface.at(asked).mean, mean, atol=1e-6)
    np.testing.assert_allclose(surface.at(asked).deviation, deviation, rtol=2e-3)


# Its model of a dent -------------------------------------------------------------------------------------------------


@pytest.mark.slow  # kernels of lists in single precision
def test_the_thesiss_model_holds_its_lowest_point_and_says_what_its_trend_is(level: HeightProcess) -> None:
    depth = 0.006
    after = of_our_own(0.0, depth, 1e-4)
    tactile = tactile_points(np.array([*AT, THICKNESS - depth]), RADIUS, depth)
    touched = with_tactile(after, tactile)
    found = thesis_beta(dent_of(level, touched, AT))
    assert 0.0 <= found.beta <= found.curve.parameter[-1]
    assert len(found.simulated_m) == 15 * 15
    assert (found.simulated_m[:, 2] - THICKNESS).min() == pytest.approx(-found.depth_m, abs=1e-5)
    assert found.depth_m == pytest.approx(depth, rel=0.25)
    assert found.error_m == found.curve.aee[np.flatnonzero(found.curve.parameter == found.beta)[0]]
    assert found.note == THESIS_NOTE
    assert "patch" in found.note


@pytest.mark.slow  # kernels of lists in single precision
def test_the_thesiss_model_finds_its_own_beta(level: HeightProcess) -> None:
    """A surface made by that very model, deep enough for a single layer to feel beta."""
    from deformscope.stages.gaussian_process import ProcessPrediction
    from deformscope.stages.msm import clusters
    from deformscope.stages.msm.solver import Msm
    from deformscope.stages.regions.touches import MapGrid

    grid = MapGrid((0.15, 0.15), 0.01)
    rest = np.column_stack([0.025 + grid.centres_m, np.full(225, THICKNESS)])
    row, column = np.unravel_index(np.arange(225), grid.shape)
    held = np.append(np.flatnonzero((row % 14 == 0) | (column % 14 == 0)), 7 * 15 + 7)
    at = rest[held].copy()
    at[-1, 2] -= 0.03
    body = Msm(rest, clusters.lattice(rest, grid.shape, np.arange(225), 3), held, basis="linear", precision="float64")
    heights = body.relax(at[None], np.array([0.8]), np.array([0.0])).position[0, :, 2]

    class Made:
        def at(self, places: FloatArray) -> ProcessPrediction:
            return ProcessPrediction(heights, np.zeros(225))

    assert thesis_beta(dent_of(level, Made(), AT)).beta == pytest.approx(0.8, abs=0.12)
