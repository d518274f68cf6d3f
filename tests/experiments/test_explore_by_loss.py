"""Regions by the energy that a touch loses: two foams that feel alike, one of which relaxes, integrated here."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore import AtOnce, Exploration, ExploringRobot, RecordedRobot, explore, within_loop
from deformscope.experiments.explorer import ExplorationStages, UnseenSurface
from deformscope.experiments.options import ExploreOptions
from deformscope.experiments.robot_geometry import AsMeasured, Touch
from deformscope.log.exploration.summary import summary
from deformscope.pictures.exploration import draw_map
from deformscope.robot.setup import Truth
from deformscope.rows import to_components
from deformscope.session import Step, run
from deformscope.stages.map.exploration import MapEstimate, StageFailure, TouchEstimate
from deformscope.stages.map.loss import LEAST_LOSS, loss_sample
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement
from deformscope.stages.poke.contact import ArmCompliance

SIZE_M, BORDER_M, UP = (0.6, 0.4), 0.3, np.array([0.0, 0.0, 1.0])
ARM = ArmCompliance(1e-4, 1e-6)
SET_N, SPEED_M_S, STEP_S, EXPONENT = 3.0, 0.01, 0.01, 1.45
OPTIONS = ExploreOptions(budget=4, beta_model="none", hold_s=2.0, feel="loss", go_on=True)
RELAXES, TIME_S = 0.4, 1.0
"""Of the foam on the right; the one on the left is elastic."""


@dataclass
class TwoFoams:
    """Its touches are displacements at one speed until the set force, that force for the hold, and the way back.

    loss: what the foam on the right truly lost in each touch of it
    """

    times_alike: float
    loss: list[float] = field(default_factory=list)
    random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def look(self) -> SurfaceMeasurement:
        places = self.random.uniform((0.0, 0.0), SIZE_M, (2000, 2))
        heights = 0.05 + 1e-3 * self.random.standard_normal(2000)
        return SurfaceMeasurement(np.column_stack([places, heights]), np.full(2000, 1e-3))

    def touch(self, command: Touch) -> TouchMeasurement:
        creeps = bool(command.xy_m[0] > BORDER_M)
        depth, force, loading, held = _cycle(RELAXES if creeps else 0.0, self.times_alike if creeps else 1.0)
        if creeps:
            work = 0.5 * (force[1:] + force[:-1]) * np.diff(depth)
            self.loss.append(float(work.sum() / work[: held - 1].sum()))
        noise = self.random.standard_normal
        z = depth + ARM.compliance_m_per_n * force + 5e-5 * noise(len(depth))
        position = np.append(command.xy_m, command.height_m + 0.01) - z[:, None] * UP
        felt = force[:, None] * UP + 0.01 * noise((len(force), 3))
        time = STEP_S * np.arange(len(depth))
        none = np.zeros((0, 3))
        return TouchMeasurement(command.xy_m, UP, time, position, felt, none, True, loading=loading, held=held)


def _cycle(relaxes: float, times: float) -> tuple[FloatArray, FloatArray, int, int]:
    """Depth (n,) [m] and force (n,) [N] of a whole touch, samples to the set force, samples until the way back.

    F = (1 - g) w + q, q' = g w' - q / tau, w = times K depth^p, implicit steps."""
    left = 1.0 / (1.0 + STEP_S / TIME_S)
    stiff = times * SET_N / 0.006**EXPONENT
    share = (1.0 - relaxes) + left * relaxes
    depth, force = list(np.linspace(-0.005, 0.0, 51)), [0.0] * 51
    w = q = 0.0
    loading = held = 0
    while True:
        carried = left * (q - relaxes * w)
        if not held and loading and len(depth) >= loading + round(OPTIONS.hold_s / STEP_S):
            held = len(depth)
        if loading and not held:  # at the set force
            now_n = SET_N
            now_w = (now_n - carried) / share
            now_m = (now_w / stiff) ** (1.0 / EXPONENT)
        else:
            now_m = depth[-1] + (-1.0 if held else 1.0) * SPEED_M_S * STEP_S
            now_w = stiff * max(now_m, 0.0) ** EXPONENT
            now_n = max(share * now_w + carried, 0.0)
        if held and now_n == 0.0:
            break
        q, w = left * (q + relaxes * (now_w - w)), now_w
        depth.append(now_m)
        force.append(now_n)
        if not loading and now_n >= SET_N:
            loading = len(depth)
    depth += list(depth[-1] - SPEED_M_S * STEP_S * np.arange(1, 101))
    return np.array(depth), np.array(force + [0.0] * 100), loading, held


def as_stiff() -> float:
    """How many times as stiff the foam that relaxes has to be to sink in as far."""
    low, high = 1.0, 2.0
    for _ in range(20):
        times = 0.5 * (low + high)
        depth, _, loading, _ = _cycle(RELAXES, times)
        low, high = (times, high) if depth[loading - 1] > 0.006 else (low, times)
    return low


class _Heard:
    def __init__(self) -> None:
        self.results: list[object] = []

    def write(self, items: object) -> None:
        if isinstance(items, Step):
            self.results += items.results


def explored(robot: ExploringRobot, options: ExploreOptions) -> list[object]:
    heard = _Heard()
    columns = (np.arange(120) + 0.5) * 0.005 > BORDER_M
    truth = Truth(np.broadcast_to(columns, (80, 120)).astype(np.int64))
    stages = ExplorationStages(UnseenSurface(SIZE_M, options, ARM, truth), AsMeasured(SIZE_M))
    run([], explore(lambda: 0, within_loop(stages), Exploration()), heard, AtOnce(robot))
    return heard.results


@pytest.fixture(scope="module")
def by_loss() -> tuple[TwoFoams, list[object]]:
    robot = TwoFoams(as_stiff())
    return robot, explored(robot, OPTIONS)


def _last(results: list[object]) -> MapEstimate:
    return [one for one in results if isinstance(one, MapEstimate)][-1]


def test_two_foams_that_feel_alike_are_two_regions_by_loss(by_loss: tuple[TwoFoams, list[object]]) -> None:
    robot, results = by_loss
    last = _last(results)
    assert not [one for one in results if isinstance(one, StageFailure)]
    assert (last.region_count, last.mapped) == (2, "energy loss")
    assert last.iou is not None
    assert last.iou > 0.7
    assert last.loss is not None
    assert last.level_loss is not None
    assert last.level_loss_interval is not None
    truth = float(np.mean(robot.loss))
    assert 0.1 < truth < 0.6
    assert last.level_loss[1] == pytest.approx(truth, rel=0.1)
    assert last.level_loss_interval[1, 0] < truth < last.level_loss_interval[1, 1]
    assert last.level_loss[0] < 0.15 * truth  # of a share that hardly differs from none little is known
    assert last.level_loss_interval[0, 0] < LEAST_LOSS
    assert last.level_n_per_mm[1] == pytest.approx(last.level_n_per_mm[0], rel=0.08)
    assert np.log(last.stiffness_n_per_mm).std() < 0.05 < np.log(last.loss).std()


@pytest.mark.slow
def test_a_replay_is_the_same_and_by_stiffness_the_same_touches_are_one_region(
    by_loss: tuple[TwoFoams, list[object]],
) -> None:
    _, results = by_loss
    given = [one for one in results if isinstance(one, SurfaceMeasurement | TouchMeasurement)]
    again = explored(RecordedRobot(list(given)), OPTIONS)
    for kind in (TouchEstimate, MapEstimate):
        for one, other in zip(*([x for x in some if isinstance(x, kind)] for some in (results, again)), strict=True):
            first, second = to_components(one), to_components(other)
            assert first.keys() == second.keys()
            assert all(
                np.array_equal(first[name], second[name], equal_nan=first[name].dtype.kind == "f") for name in first
            )
    apparent = _last(explored(RecordedRobot(list(given)), dataclasses.replace(OPTIONS, feel="apparent")))
    assert apparent.region_count == 1
    assert (apparent.loss, apparent.mapped) == (None, "stiffness")


def test_pictures_and_words_say_that_it_is_a_loss(by_loss: tuple[TwoFoams, list[object]]) -> None:
    last = _last(by_loss[1])
    assert "of a touch's energy it | stiffness [N/mm]" in summary(last)
    assert last.level_loss is not None
    assert f"loses {last.level_loss[1]:.0%}" in summary(last)
    assert draw_map("stiffness", last).png != draw_map("stiffness", dataclasses.replace(last, loss=None)).png


def test_something_rigid_loses_nothing_and_a_touch_without_its_way_back_says_nothing() -> None:
    at = np.array([0.1, 0.1])
    assert loss_sample(at, None, rigid=True).log_stiffness == pytest.approx(np.log(LEAST_LOSS))
    with pytest.raises(InputError, match="returned to zero"):
        loss_sample(at, None, rigid=False)
    with pytest.raises(InputError, match="energy loss is measured"):
        ExploreOptions(feel="loss")
    with pytest.raises(InputError, match="regions are not those of beta"):
        ExploreOptions(feel="loss", hold_s=2.0, planner="thesis", beta_model="thesis")
