"""Force and torque at the tip from bytes that were typed by the vendors' documents, and from an arm's own report."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from deformscope_ft300 import Ft300, Ft300Config
from deformscope_ft300.double import PERIOD_NS, Ft300Double
from deformscope_netft import HexConfig, NetftSensor
from deformscope_netft.double import NetftDouble
from deformscope_ur import Ur, UrConfig, UrDouble

from deformscope.experiments.live.device_stages import LiveOptions, Stage, compute, for_rig
from deformscope.frames import ArmFrame, Frame
from deformscope.rig.measured import to_frame
from deformscope.rig.rig_file import Rig, parse_rig
from deformscope.stages.poke.tip_wrench import TipWrench
from deformscope_drivers.arm.wrench import ArmWrench, ArmWrenchConfig
from deformscope_drivers.clock import Stamp
from deformscope_drivers.device import Device
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from tests.drivers.packages.ur_memory import MemoryPorts

TOOL = """
[devices.arm]
driver = "jaco"
[devices.tip]
driver = "optoforce"
port = "memory"
[tool]
tip = "flat"
length_m = 0.2
sensor_m = [0.0, 0.0, 0.05]
"""
PRESSED_S, END_S = 0.6, 1.2
# In free air (4, -3, 12) N and (0.05, -0.1, 0.02) N m. A tip that presses with (1, 0, -10) N, 0.15 m behind the sensor,
# and twists by 0.05 N m about z, is (1, 0, -10) N and (0, 0.15 x 1, 0.05) N m more in it.
FREE_HEX = bytes.fromhex("0000 0000 0000 0000  00009c40 ffff8ad0 0001d4c0 00001388 ffffd8f0 000007d0")
PRESSED_HEX = bytes.fromhex("0000 0000 0000 0000  0000c350 ffff8ad0 00004e20 00001388 00001388 00001b58")
FREE_FT = bytes.fromhex("20 4e  90 01 d4 fe b0 04  32 00 9c ff 14 00  f3 0c")
PRESSED_FT = bytes.fromhex("20 4e  f4 01 d4 fe c8 00  32 00 32 00 46 00  ec b9")
FORCE_N, TORQUE_NM = [1.0, 0.0, -10.0], [0.0, 0.0, 0.05]


class TypedHex(NetftDouble):
    """Its records have the typed counts behind their own number."""

    def due(self, now_ns: int) -> bytes:
        sent, typed = super().due(now_ns), PRESSED_HEX if now_ns > PRESSED_S * 1e9 else FREE_HEX
        return b"".join(sent[at : at + 4] + typed for at in range(0, len(sent), 36))


class TypedFt(Ft300Double):
    """Its packets are the typed ones."""

    def due(self, now_ns: int) -> bytes:
        while self.streams and self._next_ns <= now_ns:
            self._line.send(PRESSED_FT if self._next_ns > PRESSED_S * 1e9 else FREE_FT, self._next_ns)
            self._next_ns += PERIOD_NS
        return self._line.due(now_ns)


def hex_sensor(clock: SimulatedClock) -> NetftSensor:
    config = HexConfig(rate_hz=100.0)
    return NetftSensor(config, transport=MemoryTransport(TypedHex(config), clock), clock=clock)


def ft_sensor(clock: SimulatedClock) -> Ft300:
    return Ft300(Ft300Config(), transport=MemoryTransport(TypedFt(), clock), clock=clock)


def wrench_stage(rig: Rig) -> Stage:
    return Stage("wrench", for_rig(LiveOptions(("wrench",)), rig))


def found_in(frames: Sequence[Frame], stage: Stage) -> list[tuple[float, TipWrench]]:
    """The results, each with the time of its reading [s]."""
    chooser, found = stage.chooser(), []
    for frame in sorted(frames, key=lambda one: (one.stamp.host_ns, one.device)):
        chooser.see(frame)
        if (taken := chooser.take()) is not None:
            found.append((taken[-1].stamp.host_ns * 1e-9, compute(stage, stage.packed(taken))))
    return found


def at_rest(end_ns: int) -> Iterator[ArmFrame]:
    nothing, none = np.zeros(3), np.zeros(0)
    for index, ns in enumerate(range(0, end_ns, 10_000_000)):
        place = np.array([0.4, 0.1, 0.3])
        yield ArmFrame(Stamp(ns), index, none, none, none, place, nothing, nothing, nothing, none, device="arm")


@pytest.mark.parametrize("make", [hex_sensor, ft_sensor])
def test_typed_bytes_give_typed_force_and_torque(make: Any) -> None:
    clock, frames = SimulatedClock(), list[Frame]()
    sensor: Device[Any]
    with make(clock).open(own_thread=False) as sensor:
        while clock() < END_S * 1e9:
            frames += [to_frame("wrench", one, 0, "tip", sensor) for one in sensor.poll(0.02)]
    frames = [dataclasses.replace(one, index=index) for index, one in enumerate(frames)]  # type: ignore[type-var]
    found = found_in([*frames, *at_rest(clock())], wrench_stage(parse_rig(TOOL, "rig")))
    before = [one for when, one in found if when < PRESSED_S - 0.02]
    pressed = [one for when, one in found if when > PRESSED_S + 0.02]
    assert len(before) > 10
    assert len(pressed) > 20
    for one in before:
        assert one.torque_nm is not None
        np.testing.assert_allclose([*one.force_n, *one.torque_nm], 0.0, atol=1e-9)
    for one in pressed:
        assert one.torque_nm is not None
        np.testing.assert_allclose(one.force_n, FORCE_N, atol=1e-9)
        np.testing.assert_allclose(one.torque_nm, TORQUE_NM, atol=1e-9)


def test_a_turned_sensor_has_the_same_tip() -> None:
    """Mounted a quarter turn about its z, it reports the reaction: the tip's x is its y, y its -x, z its -z."""
    turned = TOOL + "R_tip_force = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]\n"
    clock, frames = SimulatedClock(), list[Frame]()
    with hex_sensor(clock).open(own_thread=False) as sensor:
        while clock() < END_S * 1e9:
            frames += [to_frame("wrench", one, 0, "tip", sensor) for one in sensor.poll(0.02)]
    found = found_in([*frames, *at_rest(clock())], wrench_stage(parse_rig(turned, "rig")))
    last = found[-1][1]
    assert last.torque_nm is not None
    np.testing.assert_allclose([*last.force_n, *last.torque_nm], [0.0, -1.0, 10.0, 0.0, 0.0, -0.05], atol=1e-9)


def test_an_arms_own_force_is_that_of_the_tip() -> None:
    """A UR that is pushed reports what pushes it; the tip gives it back, and has no torque that was learned."""
    clock = SimulatedClock(10**9)
    double = UrDouble(UrConfig())
    arm, own = Ur(UrConfig(own_process=False), MemoryPorts(double, clock), clock=clock), ArmWrench(ArmWrenchConfig())
    own.attach(arm)
    push_n = np.array([6.0, -4.0, 8.0])
    turned = double.T_base_end_effector[:3, :3]
    frames = list[Frame]()
    with arm.open(own_thread=False), own.open(own_thread=False), arm.readings() as states:
        for step in range(400):
            if step == 150:
                double.push([*push_n, 0.3, 0.0, 0.0])
            arm.poll(0.008)
            frames += [to_frame("wrench", one, 0, "tip", own) for one in own.poll(0.0)]
            frames += [to_frame("arm", one, 0, "arm", arm) for one in states.take()]
    rig = parse_rig(TOOL.replace('"optoforce"\nport = "memory"', '"arm"'), "rig")
    found = [one for when, one in found_in(frames, wrench_stage(rig)) if when > frames[-1].stamp.host_ns * 1e-9 - 0.5]
    assert len(found) > 20
    assert all(one.torque_nm is None for one in found)
    np.testing.assert_allclose(np.mean([one.force_n for one in found], axis=0), -turned.T @ push_n, atol=0.3)
