"""Protection zones: set as the arm is opened, read back, and kept to by Cartesian motions of the double alone."""

import dataclasses
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from deformscope_drivers.arm.device import CartesianVelocity, JointVelocity
from deformscope_drivers.errors import SettingsRefused
from deformscope_drivers.jaco import Jaco, JacoConfig, JacoDouble
from deformscope_drivers.jaco.config import Workspace
from deformscope_drivers.jaco.library import call
from deformscope_drivers.jaco.structures import CartesianInfo, Zone, ZoneList, velocity_point
from deformscope_drivers.jaco.zones import set_zones, zone_list
from deformscope_drivers.memory import SimulatedClock


class Counted:
    """The double's functions, with how often each was called; a liar forgets zones."""

    def __init__(self, double: JacoDouble, liar: bool = False) -> None:
        self.where, self.calls = double.where, Counter[str]()
        self._double, self._liar = double, liar

    def function(self, name: str) -> Callable[..., int]:
        self.calls[name] += 1
        return (lambda *_: 1) if self._liar and name == "SetProtectionZone" else self._double.function(name)


def test_zones_are_written_once_and_an_arm_that_does_not_keep_them_is_refused() -> None:
    clock = SimulatedClock()
    double = JacoDouble("j2n6s300", clock)
    below = JacoConfig(protection_zones=(Workspace((-1.0, -1.0, -1.0), (1.0, 1.0, -0.01)),))
    for functions, config, written in (
        (Counted(double), JacoConfig(), 0),
        (Counted(double), below, 1),
        (Counted(double), below, 0),
        (Counted(double), JacoConfig(), 0),
        (Counted(double), dataclasses.replace(below, protection_zones=()), 0),
    ):
        with Jaco(config, functions, clock=clock).open(own_thread=False):
            assert functions.calls["SetProtectionZone"] == written
    assert functions.calls["EraseAllProtectionZones"] == 1
    with pytest.raises(SettingsRefused, match="protection zones"):
        Jaco(below, Counted(double, liar=True), clock=clock).open(own_thread=False)


BOXES = Workspace((-1.0, -0.9, -1.0), (1.0, 0.9, -0.01)), Workspace((0.2, 0.3, 0.1), (0.4, 0.5, 0.6))


def other_order(zones: ZoneList) -> None:
    zones.Zones[0], zones.Zones[1] = Zone.from_buffer_copy(zones.Zones[1]), Zone.from_buffer_copy(zones.Zones[0])


def other_corners(zones: ZoneList) -> None:
    """From another corner on, the other way round, and a hair beside."""
    points = zones.Zones[1].zoneShape.Points
    old = [CartesianInfo.from_buffer_copy(point) for point in points]
    for number in range(8):
        points[number] = old[(2 - number) % 4 + number // 4 * 4]
    points[0].X += 2e-6


def turned(zones: ZoneList) -> None:
    """A base that stands on its corner in the box, and is half of it."""
    for point, (x, y) in zip(
        zones.Zones[1].zoneShape.Points, ((0.3, 0.3), (0.2, 0.4), (0.3, 0.5), (0.4, 0.4)) * 2, strict=True
    ):
        point.X, point.Y = x, y


def one_more(zones: ZoneList) -> None:
    zones.NbZones = 3
    zones.Zones[2] = Zone.from_buffer_copy(zones.Zones[1])


def slower_alone(zones: ZoneList) -> None:
    zones.Zones[1].zoneLimitation.speedParameter1 = 0.05


def another_shape(zones: ZoneList) -> None:
    zones.Zones[1].zoneShape.shapeType = 0


@pytest.mark.parametrize(
    ("change", "same"),
    [
        (other_order, True),
        (other_corners, True),
        (turned, False),
        (one_more, False),
        (slower_alone, False),
        (another_shape, False),
    ],
)
def test_zones_are_the_same_by_what_they_keep_the_hand_out_of(change: Callable[[ZoneList], None], same: bool) -> None:
    functions = Counted(JacoDouble("j2n6s300", SimulatedClock()))
    call(functions, "InitAPI")
    kept = zone_list(BOXES)
    change(kept)
    call(functions, "SetProtectionZone", kept)
    functions.calls.clear()
    set_zones(functions, BOXES, lambda: None)
    assert functions.calls["SetProtectionZone"] == (not same)


@pytest.mark.parametrize("by_joints", [False, True])
def test_the_hand_does_not_enter_a_zone_by_cartesian_motion(by_joints: bool) -> None:
    clock = SimulatedClock()
    double = JacoDouble("j2n6s300", clock)
    x, y, z = double.T_base_end_effector[:3, 3]
    floor_m = float(z) - 0.03
    config = JacoConfig(protection_zones=(Workspace((x - 1.0, y - 1.0, -1.0), (x + 1.0, y + 1.0, floor_m)),))
    with Jaco(config, double, clock=clock).open(own_thread=False):
        double.function("EraseAllTrajectories")()
        down = JointVelocity((0.0, 0.0, -10.0, 0.0, 0.0, 0.0)) if by_joints else CartesianVelocity((0.0, 0.0, -0.05))
        lowest_m = np.inf
        for _ in range(150):
            double.function("SendBasicTrajectory")(velocity_point(down))
            clock.advance_to(clock() + 10_000_000)
            lowest_m = min(lowest_m, float(double.T_base_end_effector[2, 3]))
    assert (lowest_m > floor_m - 1e-4) is not by_joints


def test_more_zones_than_an_arm_keeps_are_refused() -> None:
    one = Workspace((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="10 protection_zones"):
        JacoConfig(protection_zones=(one,) * 11)
