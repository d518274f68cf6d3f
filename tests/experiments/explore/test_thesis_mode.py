"""`--planner thesis` has the thesis's grid and sweep unless others are asked for."""

import dataclasses
from typing import Literal

import numpy as np
import pytest

from deformscope.config import ExploreConfig
from deformscope.config.explore import ExploreFlags
from deformscope.errors import InputError
from deformscope.experiments.explore import beta_fit
from deformscope.experiments.explore.explorer import UnseenSurface
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import Touch
from deformscope.experiments.explore.search import ThesisSearch
from deformscope.lab.scenes import built_in
from deformscope.runs.opened_devices import setup_of
from deformscope.stages.map.thesis import swept_betas
from deformscope.stages.regions.touch_error import TouchErrorModel
from deformscope.stages.regions.touches import MapGrid
from studies.reproduce.surface_robot import LabRobot
from studies.reproduce.thesis_rules import OWN


def options_of(**asked: object) -> ExploreOptions:
    """As the command makes them."""
    config = ExploreConfig.of(rig="lab:two-60-150", planner="thesis", **asked)
    return ExploreOptions(**{one.name: getattr(config, one.name) for one in dataclasses.fields(ExploreFlags)})


def field_width(options: ExploreOptions) -> float:
    search = options.search(MapGrid((0.6, 0.4)), TouchErrorModel())
    assert isinstance(search, ThesisSearch)
    return search.thesis.width_m


def test_grid_sweep_and_places_are_the_thesiss_by_default() -> None:
    options = options_of()
    assert options.beta_model == "thesis"
    assert options.thesis.beta_grid_m == options.planning.cell_m == 0.005
    np.testing.assert_allclose(swept_betas(options.thesis.beta_step), np.arange(100) / 100.0)
    assert field_width(options) == 0.5
    assert OWN.thesis == options.thesis


def test_others_are_taken_where_they_are_asked_for() -> None:
    options = options_of(beta_grid_m=0.01, beta_step=0.25, sigma_w_m=0.7)
    assert options.planning.cell_m == 0.01
    assert swept_betas(options.thesis.beta_step).tolist() == [0.0, 0.25, 0.5, 0.75]
    assert field_width(options) == 0.7
    for wrong in ({"beta_grid_m": 0.0005}, {"beta_step": 0.0}, {"sigma_w_m": 0.0}):
        with pytest.raises(InputError):
            options_of(**wrong)


@pytest.mark.parametrize(
    ("planner", "asked", "is_now"),
    [("thesis", None, "free"), ("thesis", "held", "held"), ("regions", None, "held"), ("regions", "free", "free")],
)
def test_a_simulated_scene_leaves_the_tangent_free_where_it_is_asked_for(
    planner: Literal["thesis", "regions"], asked: Literal["held", "free"] | None, is_now: str
) -> None:
    options = ExploreOptions(planner=planner, beta_model="volume")
    assert setup_of("lab:homogeneous-60", options, None, trusted=True, tangential=asked).options.tangential == is_now


@pytest.mark.slow
def test_a_touch_is_swept_on_that_grid_in_those_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The dent that the sweep is given, and the step."""
    given = []

    def swept(dent: object, **options: object) -> None:
        given.append((dent, options))
        raise InputError("what was given", "enough")

    monkeypatch.setattr(beta_fit, "thesis_beta", swept)
    scene = built_in("homogeneous-60", 0)
    options = dataclasses.replace(options_of(), thickness_m=scene.thickness_m)
    robot = LabRobot(scene, options)
    explorer = UnseenSurface(scene.size_m, options, robot.arm, robot.truth).look(robot.look())
    at = 0.5 * np.asarray(scene.size_m)
    explorer.touch(robot.touch(Touch(at, *explorer.surface.aim(at))))
    ((dent, how),) = given
    assert how == {"step": 0.01}
    assert dent.shape == (30, 30)
    np.testing.assert_allclose(np.diff(np.unique(dent.before[:, 0])), 0.005)
