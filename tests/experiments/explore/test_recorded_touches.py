"""Touches that are found in what another robot recorded: with gaps, lost poses, and ends that come too early."""

import dataclasses
import threading
from collections import defaultdict
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.experiments.explore.explore import AT_END, ExplorationStopped
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.recorded_touches import RecordedTouches, find_touches
from deformscope.experiments.explore.robot_geometry import Touch
from deformscope.experiments.measured import FrameData, SetupGeometry, Touched
from deformscope.frames import ArmFrame, DepthFrame, Frame, WrenchFrame
from deformscope.rig.rig_file import Tool
from deformscope.robot.placement import Placement
from deformscope.stages.map.measured import LookFrames
from deformscope_drivers.clock import Stamp
from tests.imports import touched_bag

PLACES_M = [(0.05, 0.05), (0.19, 0.11)]
DEVICES = "arm", "wrench", "depth"
NAN = np.full(3, np.nan)
Change = Callable[[Frame, float], Frame | None]


def setup() -> SetupGeometry:
    T_base_surface = np.eye(4)
    T_base_surface[:3, 3] = touched_bag.CORNER_M
    turn = (-1, 0, 0), (0, -1, 0), (0, 0, -1)
    tool = Tool(
        length_m=touched_bag.LENGTH_M,
        radius_m=touched_bag.RADIUS_M,
        compliance_m_per_n=touched_bag.COMPLIANCE,
        R_tip_force=turn,
    )
    camera = SimpleNamespace(focal_px=None, center_px=None)
    of = {"size_m": touched_bag.SIZE_M, "placement": Placement(T_base_surface, tool), "camera": camera}
    return cast("SetupGeometry", SimpleNamespace(**of))


def frames(places_m: Sequence[tuple[float, float]]) -> list[Frame]:
    """As `touched_bag` writes them, without noise."""
    moments = touched_bag.Moments.of(list(places_m))
    found: list[Frame] = []
    for at in range(len(moments.t)):
        stamp = Stamp(touched_bag.START_NS + at * 10**6)
        if at % (1000 // touched_bag.ARM_HZ) == 0:
            end_m = (
                np.array([*moments.place[at], touched_bag.THICKNESS_M - moments.dent[at] + touched_bag.LENGTH_M])
                + touched_bag.CORNER_M
            )
            none = np.zeros(0)
            down = np.array([np.pi, 0.0, 0.0])
            found.append(ArmFrame(stamp, at, none, none, none, end_m, down, NAN, NAN, none, device="arm"))
        if at % (1000 // touched_bag.WRENCH_HZ) == 0:
            felt = np.array([[0.3, -0.2, 1.1 - moments.force[at]]])
            found.append(WrenchFrame(stamp, at, np.zeros(3, np.int64), felt, device="wrench"))
        if at % (1000 // touched_bag.DEPTH_HZ) == 0:
            found.append(DepthFrame(stamp, at, np.zeros((2, 2), np.uint16), 1e-3, device="depth"))
    return found


WHOLE = frames(PLACES_M)
END_S = (WHOLE[-1].stamp.host_ns - touched_bag.START_NS) / 1e9


def contact_s() -> float:
    """When the first force is met."""
    moments = touched_bag.Moments.of(PLACES_M[:1])
    return float(moments.t[np.flatnonzero(moments.force > 0.5)[0]])


def found_in(change: Change = lambda frame, at_s: frame) -> tuple[list[Any], list[str]]:
    """The touches where recorded frames are changed, or left out."""
    changed = (change(one, (one.stamp.host_ns - touched_bag.START_NS) / 1e9) for one in WHOLE)
    kept = (one for one in changed if one is not None)
    found, left_out = find_touches(kept, DEVICES, setup(), ExploreOptions(hold_s=0.0, set_force_n=3.0), "ur5")
    assert isinstance(found[0], LookFrames)
    return found[1:], left_out


def test_each_approach_is_a_touch_where_it_was() -> None:
    touches, left_out = found_in()
    np.testing.assert_allclose([one.xy_m for one in touches], PLACES_M, atol=1e-9)
    assert left_out == []
    assert all(one.reached for one in touches)


def test_poses_that_are_no_numbers_are_left_out() -> None:
    drawn = np.random.default_rng(2)

    def lost(frame: Frame, at_s: float) -> Frame:
        if isinstance(frame, ArmFrame) and drawn.random() < 0.05:
            return dataclasses.replace(frame, position_m=NAN, rotation_rad=NAN)
        return frame

    touches, left_out = found_in(lost)
    np.testing.assert_allclose([one.xy_m for one in touches], PLACES_M, atol=1e-4)
    assert left_out == []


def test_forces_that_are_no_numbers_are_left_out() -> None:
    drawn = np.random.default_rng(2)

    def lost(frame: Frame, at_s: float) -> Frame:
        if isinstance(frame, WrenchFrame) and drawn.random() < 0.1:
            return dataclasses.replace(frame, force_n=np.full((1, 3), np.nan))
        return frame

    assert len(found_in(lost)[0]) == 2


@pytest.mark.parametrize("kind", [ArmFrame, WrenchFrame])
def test_a_gap_at_contact_makes_no_touch(kind: type) -> None:
    """Where contact was is then not known; its dent would be too small, or too large, by the way in the gap."""
    met_s = contact_s()
    touches, left_out = found_in(
        lambda frame, at_s: None if isinstance(frame, kind) and met_s - 0.6 < at_s < met_s + 0.3 else frame
    )
    np.testing.assert_allclose([one.xy_m for one in touches], PLACES_M[1:], atol=1e-9)
    assert len(left_out) == 1
    assert "readings without a gap at contact" in left_out[0]


def test_a_gap_in_free_air_is_none_of_it() -> None:
    met_s = contact_s()
    touches, _ = found_in(
        lambda frame, at_s: None if isinstance(frame, WrenchFrame) and met_s - 0.6 < at_s < met_s - 0.1 else frame
    )
    assert len(touches) == 2


def test_an_approach_that_the_recording_ends_within_is_named() -> None:
    touches, left_out = found_in(lambda frame, at_s: frame if at_s < END_S - 3.2 else None)
    assert len(touches) == 1
    assert [one.partition(": ")[2] for one in left_out] == ["the recording ends within it"]


def test_a_recording_without_contact_or_without_poses_is_one_line() -> None:
    def without(kind: type) -> Change:
        return lambda frame, at_s: None if isinstance(frame, kind) else frame

    with pytest.raises(InputError, match="no approach: wrench measures less"):
        found_in(lambda frame, at_s: frame if at_s < contact_s() - 0.1 else None)
    with pytest.raises(InputError, match="no force of wrench"):
        found_in(without(WrenchFrame))
    with pytest.raises(InputError, match="states of the arm around contact"):
        found_in(without(ArmFrame))
    with pytest.raises(InputError, match="depth images of the surface before the first touch"):
        found_in(without(DepthFrame))


def test_no_further_touch_is_given_once_somebody_asks_to_end() -> None:
    asked = threading.Event()
    (touched, _), _ = found_in()
    made = Touched(touched, FrameData({}, {}, defaultdict(lambda: np.zeros(3))))
    robot = RecordedTouches([made, made], cast("Any", SimpleNamespace(until_ns=0, start_ns=0)), ())
    robot.asked = asked.is_set
    command = cast("Touch", object.__new__(Touch))
    assert robot.carry_out(command, lambda: None).result() is made
    asked.set()
    with pytest.raises(ExplorationStopped) as stopped:
        robot.carry_out(command, lambda: None).result()
    assert stopped.value.stop.kind == AT_END
