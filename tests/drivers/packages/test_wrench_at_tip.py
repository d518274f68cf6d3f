"""The stage of force and torque at the tip: on a sensor's double in free motion, and on a rig's doubles end to end."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from deformscope_netft import NetftConfig, NetftSensor
from deformscope_netft.double import NOISE_N, NOISE_NM, NetftDouble

from deformscope.arrays import FloatArray
from deformscope.experiments.live.device_stages import LiveOptions, Stage, WrenchChooser, compute, for_rig
from deformscope.frames import ArmFrame, Frame, Item, SessionNote, WrenchFrame
from deformscope.rig.measured import to_frame
from deformscope.rig.rig_file import parse_rig
from deformscope.stages.poke.tip_wrench import TipWrench
from deformscope_drivers.arm.kinematics import euler_xyz_from_rotation
from deformscope_drivers.arms import chains
from deformscope_drivers.clock import Stamp
from deformscope_drivers.memory import MemoryTransport, SimulatedClock

CHAIN = chains()["j2n6s300"]
MASS_KG, CENTER_M, SENSOR_M, REACH_M = 1.2, np.array([0.01, -0.02, 0.07]), np.array([0.0, 0.0, 0.04]), 0.18
RIG = f"""
[devices.arm]
driver = "jaco"
double = true

[devices.tip]
driver = "optoforce"
double = true

[tool]
tip = "flat"
length_m = {REACH_M}
weight_n = [0.0, 0.0, {-9.80665 * MASS_KG}]
weight_center_m = {CENTER_M.tolist()}
sensor_m = {SENSOR_M.tolist()}
"""


def moved_deg(time_s: float) -> FloatArray:
    """Joints at rest for half a second, then all in motion, as fast as a Jaco's: 36 and 48 deg/s."""
    began = max(time_s - 0.5, 0.0)
    share = min(began, 1.0)
    swing = np.sin(np.array([3.0, 2.0, 2.5, 3.0, 2.5, 3.0]) * began) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return CHAIN.home_deg + np.array([12.0, 8.0, 9.0, 15.0, 15.0, 15.0]) * swing


def end_at(time_s: float) -> FloatArray:
    return CHAIN.forward(moved_deg(time_s))[-1]


def carried(time_s: float, step_s: float = 2e-3) -> FloatArray:
    """(6,) what the sensor carries: Newton's law for the place of the centre of mass, differentiated twice."""
    before, here, after = (end_at(time_s + by) for by in (-step_s, 0.0, step_s))
    places = [T[:3, 3] + T[:3, :3] @ (SENSOR_M + CENTER_M) for T in (before, here, after)]
    acceleration = (places[0] - 2.0 * places[1] + places[2]) / step_s**2
    force_n = here[:3, :3].T @ (MASS_KG * (acceleration + np.array([0.0, 0.0, 9.80665])))
    return np.concatenate([force_n, np.cross(CENTER_M, force_n)])


def frames_of(seconds: float, load: Callable[[float], FloatArray]) -> list[Frame]:
    """What the double measures in time, and states of the arm each 10 ms."""
    clock = SimulatedClock()
    config = NetftConfig(counts_per_n=1e6, counts_per_nm=1e6, rate_hz=250)
    double, began_ns = NetftDouble(config, load), clock()
    made: list[Frame] = []
    with NetftSensor(config, transport=MemoryTransport(double, clock), clock=clock).open(own_thread=False) as sensor:
        while clock() - began_ns < seconds * 1e9:
            made += [to_frame("wrench", one, len(made), "tip", sensor) for one in sensor.poll(0.02)]
    readings = [dataclasses.replace(one, index=index) for index, one in enumerate(made)]
    nothing = np.zeros(3)
    for index, ns in enumerate(range(began_ns, clock(), 10_000_000)):
        T = end_at(1e-9 * ns)
        turned = np.array(euler_xyz_from_rotation(T[:3, :3]))
        joints = moved_deg(1e-9 * ns)
        state = (joints, 0.0 * joints, 0.0 * joints, T[:3, 3], turned, nothing, nothing, np.zeros(3))
        readings.append(ArmFrame(Stamp(ns), index, *state, device="arm"))
    return sorted(readings, key=lambda frame: (frame.stamp.host_ns, frame.device))


def stage() -> Stage:
    options = for_rig(LiveOptions(("wrench",)), parse_rig(RIG, "rig.toml"))
    return Stage("wrench", options)


def results(frames: Sequence[Item], of: Stage) -> list[TipWrench]:
    chooser, found = of.chooser(), []
    for frame in frames:
        chooser.see(frame)
        if (taken := chooser.take()) is not None:
            found.append(compute(of, of.packed(taken)))
    return found


def test_of_a_known_tool_in_free_motion_the_noise_is_left() -> None:
    frames = frames_of(3.0, carried)
    found = results(frames, stage())
    assert len(found) > 150
    force_n = np.array([one.force_n for one in found])
    torque_nm = np.array([one.torque_nm for one in found])
    # the lever of a reading's noise, and the parabola's error in these motions, which is less than the noise
    noise_nm = np.hypot(NOISE_NM, NOISE_N * (REACH_M - SENSOR_M[2] + CENTER_M[2]))
    assert np.sqrt((force_n**2).mean(axis=0)).max() < 1.5 * NOISE_N
    assert np.sqrt((torque_nm**2).mean(axis=0)).max() < 1.5 * noise_nm
    still = dataclasses.replace(stage().options, weight_n=(0.0, 0.0, 0.0))
    known = np.array([one.force_n for one in results(frames, Stage("wrench", still))])
    assert np.abs(known).max() > 100.0 * NOISE_N, "the weight turned in the sensor"


def test_the_motion_of_the_tool_is_taken_out_not_its_weight_alone() -> None:
    frames = frames_of(3.0, carried)
    of = stage()
    chooser, moving_n = of.chooser(), []
    for frame in frames:
        chooser.see(frame)
        if (taken := chooser.take()) is not None:
            free, now = of.packed(taken)
            still = dataclasses.replace(now, position_m=0.0 * now.position_m)
            at = np.argmin(np.abs(now.arm_s))
            still = dataclasses.replace(still, rotation=np.repeat(now.rotation[at : at + 1], len(now.arm_s), axis=0))
            moving_n.append(compute(of, (free, still)).force_n)
    assert np.abs(moving_n).max() > 20.0 * NOISE_N


def test_a_push_in_the_motion_is_found_at_the_tip() -> None:
    push_n, twist_nm = np.array([0.5, -1.0, 3.0]), np.array([0.0, 0.05, -0.1])

    def pushed(time_s: float) -> FloatArray:
        lever = np.array([0.0, 0.0, REACH_M]) - SENSOR_M
        on = np.concatenate([push_n, np.cross(lever, push_n) + twist_nm])
        return carried(time_s) + (on if time_s > 1.0 else 0.0)

    found = results(frames_of(2.0, pushed), stage())[-60:]
    np.testing.assert_allclose(np.mean([one.force_n for one in found], axis=0), push_n, atol=0.01)
    np.testing.assert_allclose(np.mean([one.torque_nm for one in found], axis=0), twist_nm, atol=2e-3)


def test_the_frames_that_a_result_names_give_it_again_in_the_order_of_a_replay() -> None:
    of, chooser = stage(), stage().chooser()
    taken = None
    for frame in frames_of(0.8, carried):
        chooser.see(frame)
        taken = chooser.take() or taken
    assert taken is not None
    named = sorted(taken, key=lambda frame: (frame.device == "tip", frame.index))
    again, first = compute(of, of.packed(named)), compute(of, of.packed(taken))
    np.testing.assert_array_equal(again.force_n, first.force_n)
    np.testing.assert_array_equal(again.torque_nm, first.torque_nm)


def test_a_tare_begins_anew() -> None:
    frames = frames_of(1.5, lambda time_s: carried(time_s) + np.array([0, 0, 2.0 if time_s > 0.4 else 0.0, 0, 0, 0]))
    at = next(index for index, frame in enumerate(frames) if frame.stamp.host_ns > 450_000_000)
    other: list[Item] = [*frames[:at], SessionNote(frames[at].stamp.host_ns, "tare", "wrist"), *frames[at:]]
    tared: list[Item] = [*frames[:at], SessionNote(frames[at].stamp.host_ns, "tare", "tip"), *frames[at:]]
    assert results(other, stage())[-1].force_n[2] == pytest.approx(2.0, abs=0.1)
    assert results(tared, stage())[-1].force_n[2] == pytest.approx(0.0, abs=0.1)


def test_it_says_what_it_waits_for() -> None:
    chooser = WrenchChooser("tip", "arm")
    readings = [frame for frame in frames_of(0.5, carried) if isinstance(frame, WrenchFrame)]
    for frame in readings:
        chooser.see(frame)
    assert chooser.take() is None
    assert chooser.lacks == "no force of tip in 0.25 s of states of arm"
