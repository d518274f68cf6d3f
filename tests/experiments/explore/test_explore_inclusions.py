"""`explore` for lumps: touches of a made-up field, what comes of them, recorded and computed again."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.experiments.explore.explore import AtOnce, Exploration, RecordedRobot, explore, within_loop
from deformscope.experiments.explore.explorer import ExplorationStages, UnseenSurface
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import AsMeasured, Touch
from deformscope.robot.setup import Truth
from deformscope.rows import differing, from_components, to_components
from deformscope.session import run
from deformscope.stages.map import inclusion_posterior
from deformscope.stages.map.exploration import InclusionsResult, MapEstimate, PlannedTouch
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement
from deformscope.stages.poke.contact import ArmCompliance

SIZE_M = (0.2, 0.2)
LUMP_M, RADIUS_M, MORE = np.array([0.13, 0.06]), 0.02, 0.2
OPTIONS = ExploreOptions(
    goal="inclusions", budget=30, inclusion_m=0.02, set_force_n=5.0, beta_model="none", thickness_m=0.07, cell_m=0.01
)


@dataclass
class BumpRobot:
    """Feels F = K d^1.5, stiffer over a lump by a bump of 2.4 cm; the sensors' noise is that of the laboratory."""

    given: list[object] = field(default_factory=list)

    def look(self) -> SurfaceMeasurement:
        random = np.random.default_rng(1)
        side = np.arange(0.005, 0.2, 0.01)
        xy = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        height = 0.07 + 2e-4 * random.standard_normal(len(xy))
        self.given.append(SurfaceMeasurement(np.column_stack([xy, height]), np.full(len(xy), 2e-4)))
        return self.given[-1]  # type: ignore[return-value]

    def touch(self, command: Touch) -> TouchMeasurement:
        random = np.random.default_rng(len(self.given))
        bump = MORE * np.exp(-0.5 * float(((command.xy_m - LUMP_M) ** 2).sum()) / 0.012**2)
        deepest_m = 0.0097 * np.exp(-bump)
        sunk = np.arange(-0.004, deepest_m, 1e-4)
        force = 5.0 * (np.maximum(sunk, 0.0) / deepest_m) ** 1.5
        position = np.array([*command.xy_m, 0.08]) - sunk[:, None] * [0.0, 0.0, 1.0]
        position += 1e-4 * random.standard_normal(position.shape)
        felt = force[:, None] * [0.0, 0.0, 1.0] + 0.02 * random.standard_normal(position.shape)
        up = np.array([0.0, 0.0, 1.0])
        made = TouchMeasurement(command.xy_m, up, 0.01 * np.arange(len(sunk)), position, felt, np.zeros((0, 3)), True)
        self.given.append(made)
        return made


class Heard:
    def __init__(self) -> None:
        self.results: list[object] = []

    def write(self, items: object) -> None:
        self.results += getattr(items, "results", ())


def explored(robot: BumpRobot | RecordedRobot) -> tuple[Exploration, list[object]]:
    truth = Truth(None, np.array([[*LUMP_M, RADIUS_M, 0.015]]))
    stages = ExplorationStages(UnseenSurface(SIZE_M, OPTIONS, ArmCompliance(), truth), AsMeasured(SIZE_M))
    found, heard = Exploration(), Heard()
    run([], explore(lambda: 0, within_loop(stages), found), heard, AtOnce(robot))
    assert not stages.explorer.failures
    return found, heard.results


@pytest.fixture(scope="module", autouse=True)
def few_guesses() -> Iterator[None]:
    """A tenth of the lumps that are thought of: quick, and enough for a bump like this one."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("MOST_CENTRES", 250), ("DEPTHS_M", (0.01, 0.02)), ("TIMES", (4.0, 50.0))):
            patch.setattr(inclusion_posterior, name, value)
        yield


@pytest.fixture(scope="module")
def first(few_guesses: None) -> tuple[BumpRobot, Exploration, list[object]]:
    robot = BumpRobot()
    return robot, *explored(robot)


def test_the_lump_is_found_and_it_stops_by_itself(first: tuple[BumpRobot, Exploration, list[object]]) -> None:
    _, found, results = first
    inclusions = found.inclusions
    assert found.stop_reason == "no lump missed"
    assert inclusions.stiff.tolist() == [True]
    assert np.hypot(*(inclusions.centre_m[0] - LUMP_M)) < RADIUS_M
    assert inclusions.missed_smallest < 0.05
    assert len(found.touches) == len(inclusions.contacts_m)
    (last,) = [one for one in results if isinstance(one, MapEstimate)][-1:]
    assert (last.region_count, last.labels.max()) == (2, 1)
    plans = [one for one in results if isinstance(one, PlannedTouch)]
    assert any("locates an inclusion best" in one.reason for one in plans)


@pytest.mark.slow  # `test_explore` has it of the other goal
def test_the_recorded_touches_give_the_same_to_the_last_bit(first: tuple[BumpRobot, Exploration, list[object]]) -> None:
    robot, _, results = first
    _, again = explored(RecordedRobot(list(robot.given)))
    kinds = (InclusionsResult, PlannedTouch, MapEstimate)
    before, now = ([one for one in some if isinstance(one, kinds)] for some in (results, again))
    assert len(before) == len(now) > 10
    assert all(differing(one, other) is None for one, other in zip(before, now, strict=True))


def test_what_was_found_is_recorded_without_loss(first: tuple[BumpRobot, Exploration, list[object]]) -> None:
    _, found, _ = first
    inclusions = found.inclusions
    assert inclusions is not None
    assert differing(inclusions, from_components(InclusionsResult, to_components(inclusions))) is None


def test_an_edge_is_no_soft_lump(first: tuple[BumpRobot, Exploration, list[object]]) -> None:
    """Touches near the edge count as those of wide foam: stiffer than felt."""
    _, found, _ = first
    places: FloatArray = np.array([one.xyz_m[:2] for one in found.touches])
    near = np.minimum(places, np.array(SIZE_M) - places).min(axis=1)
    raised = np.array([(one.level_n_per_mm or np.nan) / one.stiffness_n_per_mm for one in found.touches])
    assert raised[near < 0.04].min(initial=2.0) > 1.01
    assert raised[near > 0.06].max(initial=0.0) < 1.01
