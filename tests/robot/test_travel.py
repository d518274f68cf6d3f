"""Ways above the surface: never lower than told, and no higher than needed."""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from deformscope.lab.scene_lab import BOX_HIGH_M, BOX_LOW_M
from deformscope.rig.rig_file import Tool
from deformscope.robot import travel
from deformscope.robot.clearance import ArmClearance
from deformscope.robot.placement import Placement, best_joints, towards
from deformscope.robot.readings import RobotObservation
from deformscope.robot.setup import T_BASE_SURFACE
from deformscope.robot.supervisor import Limits, SafetyDecision
from deformscope.robot.touch import Phase, TouchPlan, run_touch
from deformscope.robot.travel import PASSED_M, REACHED_M, NotThere, TravelWay, find_way, to_above
from deformscope_drivers.jaco.chains import J2N6S300
from studies.fault_study import FaultScene, make_scene
from tests.cases import slow
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

    def watch(seen: RobotObservation, verdict: SafetyDecision) -> None:
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
    monkeypatch.setattr(travel, "follow", lambda *_, **__: np.array([True, False, True, True]))
    monkeypatch.setattr(travel, "best_joints", lambda *_: low)
    across = scene.robot.center_m[:2]
    with pytest.raises(NotThere, match="a path that the arm can follow"):
        to_above(scene.robot, normal=normal, **way)
    assert np.linalg.norm(scene.robot.center_m[:2] - across) < 2 * PASSED_M


PLACEMENT = Placement(T_BASE_SURFACE, Tool(radius_m=0.01))
UP = np.array([0.0, 0.0, 1.0])


def _start_deg(center_m: np.ndarray, normal: np.ndarray) -> np.ndarray | None:
    """Joint angles with which an exploration stands above a place: led there from above the middle, upright."""
    middle = best_joints(J2N6S300, [PLACEMENT.T_base_ee(np.array([0.3, 0.2, 0.19]), UP)])
    found, reached = J2N6S300.inverse_near(PLACEMENT.T_base_ee(center_m, normal)[None], middle[None])
    return np.asarray(found[0]) if reached[0] else None


def _track_m(start_deg: np.ndarray, way: TravelWay, center_m: np.ndarray, deepest_m: np.ndarray) -> np.ndarray:
    """(n, 3) tip's centres of a way in the base frame, down as far as the touch may go and back."""
    here_m = PLACEMENT.T_surface_center(J2N6S300.end_effector(start_deg))[:3, 3]
    legs = [here_m, *([] if way.up_m is None else [way.up_m]), way.over_m, center_m, deepest_m, center_m]
    straight = [a + share * (b - a) for a, b in itertools.pairwise(legs) for share in np.linspace(0.0, 1.0, 20)]
    places = [PLACEMENT.point_in_base_m(place) for place in straight]
    if way.joints_deg is not None:
        turn = towards(start_deg.tolist(), way.joints_deg, ~np.isfinite(J2N6S300.upper_deg))
        poses = J2N6S300.forward(start_deg + np.linspace(0.0, 1.0, 200)[:, None] * turn)[:, -1]
        places += list((poses @ PLACEMENT.T_ee_center)[:, :3, 3])
    return np.array(places)


def test_a_large_turn_between_two_slopes_goes_straight() -> None:
    """Of an egg-crate: turned joint by joint the tip left the box, 15 cm beside the surface."""
    tilted = np.array([-0.147, -0.307, 0.94]), np.array([0.355, 0.238, 0.904])
    normals = [one / np.linalg.norm(one) for one in tilted]
    start_deg = _start_deg(np.array([0.481, 0.292, 0.103]), normals[0])
    assert start_deg is not None
    at = np.array([0.051, 0.104, 0.105])
    limits = Limits(low_m=BOX_LOW_M, high_m=BOX_HIGH_M)
    deepest_m = at - 0.085 * normals[1]
    way = find_way(J2N6S300, PLACEMENT, limits, start_deg, at, normals[1], height_m=0.114, deepest_m=deepest_m)
    assert way.joints_deg is None


@pytest.mark.parametrize("shrunk_m", [slow(0.0), 0.12, slow(0.25)])
def test_no_way_leaves_the_box(shrunk_m: float) -> None:
    """Between touches on random slopes, in boxes as wide as the laboratory's and narrower: by the supervisor's margins,
    or there is none."""
    random = np.random.default_rng([90417, round(1e3 * shrunk_m)])
    shrink = np.array([shrunk_m, 0.0, 0.0])
    low_m, high_m = np.array(BOX_LOW_M) + shrink, np.array(BOX_HIGH_M) - shrink
    limits = Limits(low_m=tuple(low_m), high_m=tuple(high_m))
    margin_m = limits.look_ahead_s * 0.5 * limits.speed_m_s
    clearance = ArmClearance(PLACEMENT, J2N6S300.forward(J2N6S300.home_deg))
    made = refused = 0
    for _ in range(16):
        tilts = random.uniform(-0.5, 0.5, (2, 2))
        normals = [np.append(tilt, 1.0) / np.linalg.norm(np.append(tilt, 1.0)) for tilt in tilts]
        xy_m = random.uniform([0.05, 0.05], [0.55, 0.35], (2, 2))
        centers_m = [np.append(xy, 0.06) + 0.05 * normal for xy, normal in zip(xy_m, normals, strict=True)]
        start_deg = _start_deg(centers_m[0], normals[0])
        inside = PLACEMENT.point_in_base_m(centers_m[0])
        if start_deg is None or not np.all((inside > low_m + margin_m) & (inside < high_m - margin_m)):
            continue
        deepest_m = centers_m[1] - 0.085 * normals[1]
        try:
            way = find_way(
                *(J2N6S300, PLACEMENT, limits, start_deg, centers_m[1], normals[1]),
                height_m=0.12,
                deepest_m=deepest_m,
                clearance=clearance,
            )
        except NotThere:
            refused += 1
            continue
        made += 1
        track_m = _track_m(start_deg, way, centers_m[1], deepest_m)
        assert np.all((track_m > low_m + margin_m - 1e-6) & (track_m < high_m - margin_m + 1e-6))
    print(f"{made} ways, {refused} places without one")
    assert made > 2
    assert refused > 0 or shrunk_m < 0.2
