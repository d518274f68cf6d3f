"""Ways above the surface: never lower than told, and no higher than needed."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from deformscope.robot import travel
from deformscope.robot.placement import best_joints
from deformscope.robot.readings import RobotObservation
from deformscope.robot.supervisor import SafetyVerdict
from deformscope.robot.touch import Phase, TouchPlan, run_touch
from deformscope.robot.travel import PASSED_M, REACHED_M, NotThere, lowest_m, to_above
from deformscope.studies.fault_study import FaultScene, make_scene
from tests.robot.quick_touch import quick_scene

STANDOFF_M = 0.05


@pytest.fixture(scope="module")
def scene() -> FaultScene:
    """After a first touch, the tip stands above it."""
    scene = quick_scene(3)
    run_touch(scene.robot, scene.plan)
    return scene


@pytest.mark.parametrize("above_m", [0.01, *(pytest.param(above_m, marks=pytest.mark.slow) for above_m in (0.0, 0.06))])
def test_it_crosses_no_lower_than_told_and_hardly_higher(scene: FaultScene, above_m: float) -> None:
    robot, offset_m = scene.robot, scene.robot.placement.center_offset_m
    start_m = robot.center_m
    side = 1.0 if start_m[0] < 0.3 else -1.0
    point_m = np.array([start_m[0] + side * 0.1, start_m[1], scene.plan.point_m[2]])
    height_m = point_m[2] + STANDOFF_M + offset_m + above_m
    plan = dataclasses.replace(scene.plan, point_m=point_m, travel_height_m=height_m, miss_m=0.03)
    phases: list[tuple[Phase, int]] = []
    track: list[np.ndarray] = []

    def watch(seen: RobotObservation, verdict: SafetyVerdict) -> None:
        if phases and phases[-1][0] is Phase.TRAVEL:
            track.append(robot.center_m)

    robot.watch = watch
    record = run_touch(robot, plan, on_phase=lambda phase, time_ns: phases.append((phase, time_ns)))
    places_m = np.array(track)
    crossing = np.abs(places_m[:, 0] - start_m[0]) > PASSED_M
    crossing &= np.abs(places_m[:, 0] - point_m[0]) > PASSED_M

    assert crossing.sum() > 50
    assert places_m[crossing, 2].min() > height_m - 2 * REACHED_M
    assert places_m[:, 2].max() < height_m + 2 * PASSED_M
    assert [phase for phase, _ in phases] == [span.phase for span in record.phases]
    for (_, told_ns), span in zip(phases, record.phases, strict=True):
        assert told_ns / 1e9 == pytest.approx(span.start_s)


@pytest.mark.slow  # a whole touch; the crossing above sees its phases
def test_phases_are_told_as_they_begin() -> None:
    scene = make_scene(5, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    told: list[tuple[Phase, int, int]] = []

    run_touch(scene.robot, scene.plan, on_phase=lambda phase, at: told.append((phase, at, scene.lab.clock())))
    scene.lab.close()

    assert [phase for phase, *_ in told] == [
        *(Phase.TRAVEL, Phase.TARE, Phase.APPROACH, Phase.PRESS, Phase.DWELL, Phase.RETREAT)
    ]
    assert all(heard_ns == began_ns for _, began_ns, heard_ns in told)


def test_a_plan_crosses_at_its_height_or_above_the_point() -> None:
    up = np.array([0.0, 0.0, 1.0])
    low, high = (TouchPlan(np.array([0.3, 0.2, 0.05]), up, travel_height_m=height_m) for height_m in (0.02, 0.2))

    assert low.places_m(0.01)[0] == pytest.approx([0.3, 0.2, 0.11])
    assert high.places_m(0.01)[0] == pytest.approx([0.3, 0.2, 0.2])


def _above(scene: FaultScene) -> tuple[np.ndarray, dict[str, Any]]:
    """A place beside where the tip stands, and how to go there."""
    robot, up = scene.robot, np.array([0.0, 0.0, 1.0])
    side = 1.0 if robot.center_m[0] < 0.3 else -1.0
    at = np.array([robot.center_m[0] + 0.08 * side, robot.center_m[1], scene.plan.point_m[2] + 0.06])
    return up, {"center_m": at, "height_m": at[2] + 0.02, "deepest_m": at - 0.05 * up, "speed_m_s": 0.05}


def test_where_no_straight_way_leads_it_turns_its_joints_above_the_surface(
    scene: FaultScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    normal, way = _above(scene)
    monkeypatch.setattr(travel, "follow", lambda *_, **__: np.array([True, False, True, True]))
    lows: list[float] = []
    scene.robot.watch = lambda seen, verdict: lows.append(scene.robot.center_m[2])
    to_above(scene.robot, normal=normal, **way)
    scene.robot.watch = None

    assert np.linalg.norm(scene.robot.center_m - way["center_m"]) < 2 * REACHED_M
    begin = next(index for index, z in enumerate(lows) if z > way["height_m"])
    assert min(lows[begin:]) > way["center_m"][2] - 2 * REACHED_M


def test_joints_that_would_sink_on_their_way_are_not_turned(scene: FaultScene, monkeypatch: pytest.MonkeyPatch) -> None:
    normal, way = _above(scene)
    low = best_joints(scene.robot.arm.chain, [scene.robot.placement.T_base_ee(way["deepest_m"], normal)])
    assert low is not None
    assert lowest_m(scene.robot, scene.robot.pose.joints_deg) == pytest.approx(scene.robot.center_m[2], abs=1e-6)
    assert lowest_m(scene.robot, low) <= way["deepest_m"][2] + 1e-3
    monkeypatch.setattr(travel, "follow", lambda *_, **__: np.array([True, False, True, True]))
    monkeypatch.setattr(travel, "best_joints", lambda *_: low)
    across = scene.robot.center_m[:2]

    with pytest.raises(NotThere, match="a way that the arm can follow"):
        to_above(scene.robot, normal=normal, **way)

    assert np.linalg.norm(scene.robot.center_m[:2] - across) < 2 * PASSED_M
