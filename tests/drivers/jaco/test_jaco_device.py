"""The arm as a device: what it sends and when, and that it stops whatever happens to the sender."""

import contextlib
import ctypes
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from deformscope_drivers import jaco
from deformscope_drivers.arm.device import Velocity
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.device import Reconnect
from deformscope_drivers.errors import LinkLost, NotConnected, OutOfLimits, SettingsRefused
from deformscope_drivers.health import Link
from deformscope_drivers.jaco import errors as vendor_errors
from deformscope_drivers.jaco import structures
from deformscope_drivers.jaco.chains import CHAINS, J2N6S300
from deformscope_drivers.jaco.device import check_pose
from deformscope_drivers.jaco.library import Functions, Library, call, read
from deformscope_drivers.jaco.structures import velocity_point
from deformscope_drivers.memory import SimulatedClock
from deformscope_drivers.pacing import SlotPacer
from tests.drivers.contract import Bench, DeviceContract, wait_until
from tests.drivers.jaco.benches import CBench, build

QUICK = Reconnect(0.01, 0.05)
PERIOD_S = 0.01
TURN = jaco.JointVelocity((10.0, 0.0, 0.0, 0.0, 0.0, 0.0))
PATIENT = jaco.JacoConfig(open_attempts=1, command_deadline_s=5.0)  # in real time a busy machine may stall the cycle


class Recorded:
    """Functions that note who was called, when, and with what; `takes_s` is how long each call lasts."""

    def __init__(self, functions: Functions, clock: Callable[[], int]) -> None:
        self._functions = functions
        self._clock = clock
        self.where = functions.where
        self.calls: list[tuple[float, str, Any]] = []
        self.takes_s = 0.0

    def function(self, name: str) -> Callable[..., int]:
        inner = self._functions.function(name)

        def called(*arguments: Any) -> int:
            argument = arguments[0] if arguments else None
            if isinstance(argument, ctypes.Structure):
                argument = type(argument).from_buffer_copy(argument)
            self.calls.append((self._clock() / 1e9, name, argument))
            if self.takes_s and isinstance(self._clock, SimulatedClock):
                self._clock.advance_to(self._clock() + round(self.takes_s * 1e9))
            return inner(*arguments)

        return called

    @property
    def names(self) -> list[str]:
        return [name for _, name, _ in self.calls if not name.startswith("Get")]

    def times(self, name: str) -> list[float]:
        return [at_s for at_s, called, _ in self.calls if called == name]

    def points(self) -> list[tuple[float, float]]:
        """When a velocity point was sent, and its first joint's rate."""
        return [
            (at_s, argument.Position.Actuators.Actuator1)
            for at_s, name, argument in self.calls
            if name == "SendBasicTrajectory" and argument.Position.Type == structures.PositionType.ANGULAR_VELOCITY
        ]


class Simulated:
    """A device over a double on a simulated clock, opened without a thread: every run is the same."""

    def __init__(self, config: jaco.JacoConfig | None = None, **double: Any) -> None:
        self.clock = SimulatedClock(1_000_000_000)
        self.double = jaco.JacoDouble(clock=self.clock, **double)
        self.recorded = Recorded(self.double, self.clock)
        self.arm = jaco.Jaco(config or jaco.JacoConfig(), self.recorded, clock=self.clock)

    def run(self, seconds: float) -> None:
        until_ns = self.clock() + round(seconds * 1e9)
        while (left_ns := until_ns - self.clock()) > 0:
            self.arm.poll(left_ns / 1e9)

    @property
    def now_s(self) -> float:
        return self.clock() / 1e9


@pytest.fixture
def lab() -> Iterator[Simulated]:
    made = Simulated()
    with made.arm.open(own_thread=False):
        yield made


class TestOverThePythonDouble(DeviceContract):
    @pytest.fixture
    def bench(self) -> Bench:
        double = jaco.JacoDouble()
        return Bench(jaco.Jaco(PATIENT, double, reconnect=QUICK), double.unplug, double.plug)


class TestOverTheCDouble(DeviceContract):
    @pytest.fixture
    def bench(self) -> Bench:
        CBench("j2n6s300").real_time(True)
        return Bench(jaco.Jaco(jaco.JacoConfig(library=build("usb"))))


@pytest.mark.hardware
class TestOnHardware(DeviceContract):
    """A real arm, powered, with room around it; nothing moves. DEFORMSCOPE_JACO_LIBRARY names the library."""

    @pytest.fixture
    def bench(self) -> Bench:
        library = os.environ.get("DEFORMSCOPE_JACO_LIBRARY")
        if library is None:
            pytest.skip("no arm: DEFORMSCOPE_JACO_LIBRARY is not set")
        return Bench(jaco.Jaco(jaco.JacoConfig(library=library)))


def test_over_the_c_double_by_ethernet() -> None:
    CBench("j2s7s300", "ethernet").real_time(True)
    config = jaco.JacoConfig(library=build("ethernet"), connection="ethernet", ethernet=jaco.EthernetAddresses())
    with jaco.Jaco(config) as arm:
        assert len(arm.next(5.0).joints_deg) == 7


class Coupled(SimulatedClock):
    """A simulated clock that the C double lives by."""

    def __init__(self, bench: CBench) -> None:
        super().__init__()
        self._bench = bench

    def advance_to(self, then_ns: int) -> None:
        before_ns = self()
        super().advance_to(then_ns)
        self._bench.advance((self() - before_ns) / 1e9)


@pytest.fixture(params=["python", "c"])
def simulated(request: pytest.FixtureRequest) -> Iterator[jaco.Jaco]:
    """The driver on a simulated clock, over each of the doubles."""
    if request.param == "python":
        clock = SimulatedClock()
        arm = jaco.Jaco(jaco.JacoConfig(), jaco.JacoDouble(clock=clock), clock=clock)
    else:
        bench = CBench("j2n6s300")
        arm = jaco.Jaco(jaco.JacoConfig(library=bench.path), clock=Coupled(bench))
    with arm.open(own_thread=False):
        yield arm


def hold(arm: jaco.Jaco, velocity: Velocity, seconds: float) -> None:
    """Command a velocity for a time, and let the arm come to rest."""
    arm.set_velocity(velocity, valid_for_s=seconds)
    until_ns = arm._clock() + round((seconds + 0.2) * 1e9)
    while arm._clock() < until_ns:
        arm.poll((until_ns - arm._clock()) / 1e9)


@pytest.mark.parametrize("rate_deg_s", [20.0, -7.5, 1.0])
def test_an_angular_velocity_held_for_1_s_moves_the_double_by_the_right_angle(
    simulated: jaco.Jaco, rate_deg_s: float
) -> None:
    before = np.array(simulated.next(1.0).joints_deg)
    hold(simulated, jaco.JointVelocity((0.0, rate_deg_s, 0.0, -rate_deg_s, 0.0, 0.0)), 1.0)
    moved = np.array(simulated.next(1.0).joints_deg) - before
    one_cycle = abs(rate_deg_s) * PERIOD_S * 1.01
    np.testing.assert_allclose(moved, (0, rate_deg_s, 0, -rate_deg_s, 0, 0), atol=one_cycle)


def test_a_cartesian_rotation_is_about_the_hand_s_own_axes_and_a_translation_along_the_base_s(
    simulated: jaco.Jaco,
) -> None:
    before = simulated.next(1.0).T_base_end_effector
    hold(simulated, jaco.CartesianVelocity((0.03, -0.02, 0.01), (0.05, 0.0, 0.1)), 1.0)
    after = simulated.next(1.0).T_base_end_effector
    turned = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec()
    assert turned == pytest.approx([0.05, 0.0, 0.1], abs=2e-3)
    np.testing.assert_allclose(after[:3, 3] - before[:3, 3], (0.03, -0.02, 0.01), atol=0.04 * PERIOD_S)


def test_a_velocity_about_the_base_s_axes_is_converted() -> None:
    pose = J2N6S300.end_effector(J2N6S300.home_deg)
    velocity = jaco.CartesianVelocity.in_base((0.01, 0.02, 0.03), (0.1, -0.2, 0.3), pose)
    assert velocity.linear_m_s == (0.01, 0.02, 0.03)
    assert pose[:3, :3] @ velocity.angular_rad_s == pytest.approx([0.1, -0.2, 0.3])
    assert velocity.angular_rad_s != pytest.approx([0.1, -0.2, 0.3], abs=0.05)


@pytest.mark.realtime
def test_in_real_time_it_turns_by_the_right_angle_too() -> None:
    bench = CBench("j2n6s300")
    bench.real_time(True)
    with jaco.Jaco(jaco.JacoConfig(library=bench.path, command_deadline_s=5.0)) as arm:
        before = joints(Library(bench.path))
        arm.set_velocity(TURN, valid_for_s=1.0)
        wait_until(lambda: arm.health().extra["commands_expired"] == 1)
        time.sleep(0.05)
        missed = arm.health().extra["slots_missed"]  # a busy machine may be late: such slots are not made up for
        moved = joints(Library(bench.path))[0] - before[0]
    assert moved == pytest.approx(10.0, abs=10.0 * PERIOD_S * (1.5 + missed))


def joints(functions: Functions) -> FloatArray:
    return np.array(
        structures.actuator_values(read(functions, "GetAngularPosition", structures.AngularPosition).Actuators, 6)
    )


def test_it_comes_up_in_the_order_of_the_vendors_driver_and_lets_go_erasing_first(lab: Simulated) -> None:
    assert [name for _, name, _ in lab.recorded.calls][:13] == [
        "GetAPIVersion",
        "InitAPI",
        "RefresDevicesList",
        "GetDevices",
        "SetActiveDevice",
        "GetGeneralInformations",
        "StartControlAPI",
        "StopControlAPI",
        "EraseAllTrajectories",
        "StartControlAPI",
        "SetGravityType",
        "SetTorqueSafetyFactor",
        "SendBasicTrajectory",
    ]
    assert all(name.startswith("Get") for _, name, _ in lab.recorded.calls[13:])
    point = lab.recorded.calls[12][2].Position
    assert point.Type == structures.PositionType.CARTESIAN_VELOCITY
    assert not any(structures.cartesian_values(point.CartesianPosition))
    stop_s, (_, start_s) = lab.recorded.times("StopControlAPI")[0], lab.recorded.times("StartControlAPI")
    assert start_s - stop_s >= 0.05
    assert lab.recorded.times("SetTorqueSafetyFactor")[0] - lab.recorded.times("SetGravityType")[0] >= 0.1 - 1e-9
    count = len(lab.recorded.names)
    lab.arm.close()
    assert lab.recorded.names[count:] == ["EraseAllTrajectories", "StopForceControl", "StopControlAPI", "CloseAPI"]


@pytest.mark.parametrize(
    "ask", [lambda arm: arm.set_velocity(TURN), lambda arm: arm.set_velocity(jaco.CartesianVelocity((0.0, 0.0, 0.02)))]
)
def test_an_arm_that_was_not_homed_since_it_was_switched_on_says_so_before_it_moves(
    ask: Callable[[jaco.Jaco], object],
) -> None:
    lab = Simulated(cold_boot=True)
    with lab.arm.open(own_thread=False):
        assert not lab.arm.homed
        with pytest.raises(jaco.NotHomed, match=r"home button.*arm\.home\(\)"):
            ask(lab.arm)
        lab.run(0.1)
        assert lab.recorded.points() == []


def test_an_arm_that_is_homed_by_its_joystick_may_move_then() -> None:
    lab = Simulated(cold_boot=True)
    with lab.arm.open(own_thread=False):
        call(lab.double, "MoveHome")
        lab.run(1.5)
        assert lab.arm.homed
        lab.arm.set_velocity(TURN)


def test_who_knows_better_may_move_it_all_the_same() -> None:
    lab = Simulated(jaco.JacoConfig(require_home=False), cold_boot=True)
    with lab.arm.open(own_thread=False):
        before = lab.double.joints_deg
        hold(lab.arm, TURN, 0.5)
        assert lab.double.joints_deg[0] - before[0] == pytest.approx(5.0, abs=0.11)


def test_a_cartesian_velocity_moves_the_arm_after_angular_motion_too(simulated: jaco.Jaco) -> None:
    """The arm's own Cartesian velocities would silently fail then: kinova-ros issue 269."""
    hold(simulated, jaco.JointVelocity((5.0,) * 6), 1.0)
    before = simulated.next(1.0).T_base_end_effector
    hold(simulated, jaco.CartesianVelocity((0.02, -0.01, 0.03), (0.0, 0.05, 0.1)), 1.0)
    after = simulated.next(1.0).T_base_end_effector
    assert after[:3, 3] - before[:3, 3] == pytest.approx([0.02, -0.01, 0.03], abs=1e-3)
    turned = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec()
    assert turned == pytest.approx([0.0, 0.05, 0.1], abs=2e-3)


def test_a_cartesian_velocity_stops_before_a_joint_s_limit_and_says_so() -> None:
    start_deg = J2N6S300.home_deg.copy()
    start_deg[2] = J2N6S300.lower_deg[2] + 12.0
    lab = Simulated(start_deg=start_deg)
    towards = J2N6S300.jacobian(start_deg) @ np.radians([0.0, 0.0, -6.0, 0.0, 0.0, 0.0])
    with lab.arm.open(own_thread=False):
        pose = lab.arm.next(1.0).T_base_end_effector
        lab.arm.set_velocity(jaco.CartesianVelocity.in_base(towards[:3], towards[3:], pose), valid_for_s=10.0)
        lab.run(4.0)
        assert "joint 3" in lab.arm.stopped_because
        assert J2N6S300.to_limits_deg(lab.double.joints_deg)[2] > 4.5


def test_a_cartesian_velocity_that_a_singularity_would_turn_away_stops_the_arm_and_says_so() -> None:
    lab = Simulated(jaco.JacoConfig(joint_limit_deg_s=36.0))
    with lab.arm.open(own_thread=False):
        lab.arm.next(1.0)
        start_m = lab.double.T_base_end_effector[:3, 3]
        out = tuple(0.05 * start_m / np.linalg.norm(start_m))  # until the arm is stretched out
        worst = 0.0
        for _ in range(1200):
            if lab.arm.stopped_because:
                break
            lab.arm.set_velocity(jaco.CartesianVelocity(out), valid_for_s=0.5)
            lab.run(0.02)
            gone = lab.double.T_base_end_effector[:3, 3] - start_m
            worst = max(worst, float(np.linalg.norm(gone - (gone @ out) / 0.0025 * np.array(out))))
        assert "singularity" in lab.arm.stopped_because
        assert worst < 0.01


def test_a_cold_arm_obeys_after_it_was_brought_up_and_homed() -> None:
    lab = Simulated(cold_boot=True)
    with lab.arm.open(own_thread=False):
        lab.arm.home()
        before = lab.double.joints_deg
        hold(lab.arm, TURN, 0.5)
        assert lab.double.joints_deg[0] - before[0] == pytest.approx(5.0, abs=0.11)


def test_fingers_are_initialised_when_that_is_asked_for() -> None:
    lab = Simulated(jaco.JacoConfig(initialize_fingers=True))
    with lab.arm.open(own_thread=False):
        assert "InitFingers" in lab.recorded.names


def test_an_arm_that_is_not_found_is_sought_again_with_longer_and_longer_pauses() -> None:
    lab = Simulated()
    lab.double.inject("InitAPI", 1015, 2)
    with lab.arm.open(own_thread=False):
        first, second, third = lab.recorded.times("InitAPI")
        assert second - first >= 0.5
        assert third - second >= 1.0
        assert lab.recorded.names.count("CloseAPI") == 2


def test_an_arm_that_stays_away_is_reported_with_what_to_try() -> None:
    lab = Simulated(serials=())
    with pytest.raises(jaco.NoDeviceFound, match="22cd") as caught:
        lab.arm.open(own_thread=False)
    assert str(caught.value).endswith("simulated j2n6s300")
    assert lab.recorded.names.count("InitAPI") == 3
    assert lab.recorded.names[-1] == "CloseAPI"


def test_other_codes_at_opening_are_not_tried_again() -> None:
    lab = Simulated()
    lab.double.inject("InitAPI", 2002)
    with pytest.raises(vendor_errors.CommLayerMissing, match="LD_LIBRARY_PATH"):
        lab.arm.open(own_thread=False)
    assert lab.recorded.names.count("InitAPI") == 1


def test_the_arm_meant_is_chosen_by_its_serial_number() -> None:
    lab = Simulated(jaco.JacoConfig(serial="B"), serials=("A", "B"))
    with lab.arm.open(own_thread=False):
        (device,) = [argument for _, name, argument in lab.recorded.calls if name == "SetActiveDevice"]
        assert device.SerialNumber == b"B"
        assert lab.arm.identity().serial == "B"
        assert lab.arm.identity().model == "j2n6s300"
        assert lab.arm.identity().firmware == "6.2.5 (library 5.2.0)"


@pytest.mark.parametrize(("serial", "reported"), [(None, "serial"), ("C", "C")])
def test_another_arm_than_the_one_meant_is_not_taken(serial: str | None, reported: str) -> None:
    lab = Simulated(jaco.JacoConfig(serial=serial), serials=("A", "B"))
    with pytest.raises(NotConnected, match=reported):
        lab.arm.open(own_thread=False)


class Mistaken(jaco.JacoDouble):
    """An arm with the spherical wrist that says it is one with the curved wrist."""

    def GetDevices(self, devices: Any, status: Any) -> int:
        count = super().GetDevices(devices, status)
        devices[0].DeviceType = 3
        return count


def test_an_arm_of_another_geometry_than_it_says_is_refused_and_let_go() -> None:
    clock = SimulatedClock(1_000_000_000)
    recorded = Recorded(Mistaken("j2s6s300", clock), clock)
    with pytest.raises(SettingsRefused, match=r"j2n6s300.*mm and .* deg away") as caught:
        jaco.Jaco(jaco.JacoConfig(), recorded, clock=clock).open(own_thread=False)
    assert "model" in str(caught.value)
    assert recorded.names[-1] == "CloseAPI"


@pytest.mark.parametrize(("offset_m", "refused"), [((0.0, 0.0, 0.05), True), ((0.0, 0.0, 0.001), False)])
def test_a_tool_offset_that_is_stored_in_the_arm_is_found_at_the_start(
    offset_m: tuple[float, float, float], refused: bool
) -> None:
    lab = Simulated()
    lab.double.store_tool_offset(offset_m)
    with pytest.raises(SettingsRefused, match=r"50\.0 mm") if refused else contextlib.nullcontext() as caught:
        lab.arm.open(own_thread=False)
    lab.arm.close()
    if refused:
        assert "SetEndEffectorOffset" in str(caught.value)


def test_an_arm_that_is_led_by_its_joystick_meanwhile_is_no_other_model() -> None:
    lab = Simulated()
    lab.recorded.takes_s = 0.004
    for _ in range(100):
        lab.double._arm.fifo.append(velocity_point(jaco.JointVelocity((36.0, 36.0, 0.0, 0.0, 0.0, 0.0))))
    lab.double._arm.control = True
    check_pose(_initialised(lab), J2N6S300)
    assert lab.double.joints_deg[0] > J2N6S300.home_deg[0] + 0.2


def _initialised(lab: Simulated) -> Recorded:
    call(lab.double, "InitAPI")
    return lab.recorded


@pytest.mark.parametrize("model", sorted(CHAINS))
def test_each_model_is_known_by_the_type_that_the_arm_reports(model: str) -> None:
    lab = Simulated(model=model)
    with lab.arm.open(own_thread=False):
        assert lab.arm.identity().model == model
        assert len(lab.arm.next(1.0).joints_deg) == len(CHAINS[model].joints)


def test_an_arm_of_another_model_is_refused() -> None:
    lab = Simulated(jaco.JacoConfig(model="j2s7s300"))
    with pytest.raises(SettingsRefused, match="j2n6s300"):
        lab.arm.open(own_thread=False)


def test_what_fails_at_closing_keeps_nothing_else_from_being_done(lab: Simulated) -> None:
    lab.double.inject("EraseAllTrajectories", 1016)
    lab.double.inject("StopControlAPI", 1016)
    lab.arm.close()
    assert lab.recorded.names[-5:] == [
        "EraseAllTrajectories",
        "EraseAllTrajectories",
        "StopForceControl",
        "StopControlAPI",
        "CloseAPI",
    ]


def test_a_moving_arm_that_cannot_be_reported_to_stop_is_reported_to_the_user(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=10.0)
    lab.run(0.1)
    lab.double.unplug()
    with pytest.raises(jaco.NotStopped, match="emergency stop"):
        lab.arm.close()
    assert not lab.arm.is_open


def test_a_command_that_is_not_refreshed_is_zeroed_and_erased_within_two_periods(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=0.25)
    expires_s = lab.now_s + 0.25
    lab.run(1.0)
    moving = [at_s for at_s, rate in lab.recorded.points() if rate != 0.0]
    zeros = [at_s for at_s, rate in lab.recorded.points() if rate == 0.0]
    erased = [at_s for at_s in lab.recorded.times("EraseAllTrajectories") if at_s > expires_s]
    assert moving[-1] <= expires_s
    assert len(zeros) == 1
    assert expires_s < zeros[0] <= expires_s + PERIOD_S
    assert len(erased) == 1
    assert zeros[0] < erased[0] <= expires_s + 2 * PERIOD_S + 1e-6
    assert lab.double.fifo_count == 0
    assert lab.arm.health().extra["commands_expired"] == 1


def test_a_command_that_is_refreshed_goes_on(lab: Simulated) -> None:
    before = lab.double.joints_deg
    for _ in range(20):
        lab.arm.set_velocity(TURN)
        lab.run(0.05)
    assert lab.arm.health().extra["commands_expired"] == 0
    assert lab.double.joints_deg[0] - before[0] == pytest.approx(10.0, abs=0.2)


def test_never_more_than_a_point_waits_in_the_arm(lab: Simulated) -> None:
    """What an arm would still do if this process were killed outright."""
    lab.arm.set_velocity(TURN, valid_for_s=10.0)
    most = 0
    for _ in range(500):
        lab.arm.poll(PERIOD_S)
        most = max(most, lab.double.fifo_count)
    assert most == 1


PROGRAM = """
import sys, threading, time
from deformscope_drivers.jaco import *
calls = []
class Noted(JacoDouble):
    def function(self, name):
        calls.append(name) if not name.startswith("Get") else None
        return super().function(name)
    def CloseAPI(self):
        print(self.fifo_count, *calls[-4:], flush=True)
        return super().CloseAPI()
arm = Jaco(JacoConfig(), Noted())
def moving():
    arm.set_velocity(JointVelocity((10.0, 0, 0, 0, 0, 0)), valid_for_s=60.0)
    time.sleep(0.1)
    print("moving", flush=True)
"""
ENDINGS = {
    "Ctrl-C": "with arm:\n    moving()\n    time.sleep(60)",
    "Ctrl-C on the way home": (
        "with arm:\n    moving(); arm.stop(); arm._functions.put((100.0, 180, 180, 180, 180, 180))\n    arm.home(60.0)"
    ),
    "sys.exit in a program that forgot to close": "arm.open()\nmoving()\nsys.exit(3)",
}


def test_an_exception_within_the_block_erases_before_it_closes(lab: Simulated) -> None:
    def fail() -> None:
        with lab.arm:
            lab.arm.set_velocity(TURN, valid_for_s=60.0)
            lab.run(0.1)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert lab.recorded.names[-4:] == ["EraseAllTrajectories", "StopForceControl", "StopControlAPI", "CloseAPI"]
    assert lab.double.fifo_count == 0


@pytest.mark.parametrize("ending", ENDINGS)
def test_however_a_program_ends_it_erases_before_it_closes(ending: str) -> None:
    path = os.pathsep.join(entry for entry in sys.path if entry)
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM + ENDINGS[ending]],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout.readline() == "moving\n"
        if "Ctrl-C" in ending:
            time.sleep(0.1)
            process.send_signal(signal.SIGINT)
        reported = process.stdout.read()
    last_calls = ["EraseAllTrajectories", "StopForceControl", "StopControlAPI", "CloseAPI"]
    assert reported.splitlines()[0].split() == ["0", *last_calls], reported


def test_points_go_out_at_100_hz_one_in_each_slot(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=2.0)
    lab.run(1.5)
    times_s = [at_s for at_s, _ in lab.recorded.points()]
    np.testing.assert_allclose(np.diff(times_s), PERIOD_S, atol=1e-6)
    assert lab.arm.health().extra["slots_missed"] == 0


def test_after_a_stall_nothing_is_made_up_for(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=2.0)
    lab.run(0.5)
    lab.clock.advance_to(lab.clock() + 55_000_000)
    resumed_s = lab.now_s
    lab.run(0.2)
    after = [at_s for at_s, _ in lab.recorded.points() if at_s >= resumed_s]
    assert len([at_s for at_s in after if at_s < resumed_s + PERIOD_S]) <= 2
    np.testing.assert_allclose(np.diff(after)[1:], PERIOD_S, atol=1e-6)
    assert lab.arm.health().extra["slots_missed"] == 4
    assert lab.double.fifo_count <= 1


def test_a_stall_before_the_first_command_does_not_stop_the_arm(lab: Simulated) -> None:
    lab.run(0.1)
    lab.clock.advance_to(lab.clock() + 500_000_000)
    lab.arm.set_velocity(TURN, 0.5)
    told_s = lab.now_s
    lab.run(0.1)
    assert lab.arm.stopped_because == ""
    assert len([at_s for at_s, _ in lab.recorded.points() if at_s >= told_s]) >= 9


def test_a_stall_longer_than_the_deadline_stops_the_arm_and_says_so(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=10.0)
    lab.run(0.5)
    lab.clock.advance_to(lab.clock() + 300_000_000)
    stalled_s = lab.now_s
    lab.run(0.1)
    assert [at_s for at_s, _ in lab.recorded.points() if at_s >= stalled_s] == []
    assert [at_s for at_s in lab.recorded.times("EraseAllTrajectories") if at_s >= stalled_s]
    assert "late" in lab.arm.stopped_because
    with pytest.raises(jaco.MotionStopped, match="late"):
        lab.arm.set_velocity(TURN)
    with pytest.raises(jaco.MotionStopped, match="late"):
        lab.arm.home()
    lab.arm.acknowledge_stop()
    lab.arm.set_velocity(TURN)


def test_an_erase_that_fails_is_tried_until_it_is_done(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=0.05)
    lab.double.inject("EraseAllTrajectories", 9999, 3)
    before = len(lab.recorded.times("EraseAllTrajectories"))
    lab.run(0.5)
    assert len(lab.recorded.times("EraseAllTrajectories")) == before + 4
    assert lab.arm.link is Link.CONNECTED
    assert lab.arm.health().refused == {"9999 ERROR_NACK_RECEIVED": 3}


@pytest.mark.parametrize("state_hz", [50.0, 100.0])
@pytest.mark.parametrize("call_ms", [1.0, 2.8, 4.0])
def test_a_slow_link_costs_neither_points_nor_states(call_ms: float, state_hz: float) -> None:
    """Over USB a call takes 2.8 ms or more (kinova-ros issues 281, 372): angles come first, the rest takes turns."""
    lab = Simulated(jaco.JacoConfig(state_hz=state_hz))
    lab.recorded.takes_s = call_ms / 1e3
    with lab.arm.open(own_thread=False):
        lab.arm.set_velocity(TURN, valid_for_s=10.0)
        lab.run(2.0)
        states, began_s = lab.arm.readings(), lab.now_s
        lab.run(2.0)
        taken = states.take()
        times_s = [at_s for at_s, _ in lab.recorded.points() if at_s > began_s]
        np.testing.assert_allclose(np.diff(times_s), PERIOD_S, atol=1e-6)
        assert len(taken) >= 0.8 * state_hz * 2.0
        assert np.diff([state.stamp.host_ns for state in taken]).max() <= 30e6
        assert max(state.sweep_s for state in taken) < 0.4
        assert lab.arm.health().extra["call_ms"] == pytest.approx(call_ms, rel=0.05)
        assert lab.double.fifo_count <= 1


def test_a_link_too_slow_for_a_point_and_a_state_in_a_slot_alternates(lab: Simulated) -> None:
    """At 10 ms a call the arm moves at half its speed, and is still seen; the preflight refuses it."""
    lab.recorded.takes_s = 0.01
    before = lab.double.joints_deg
    lab.arm.set_velocity(TURN, valid_for_s=4.0)
    lab.run(2.0)
    states = lab.arm.readings()
    lab.run(2.0)
    taken = states.take()
    assert lab.arm.stopped_because == ""
    assert np.diff([state.stamp.host_ns for state in taken]).max() <= 50e6
    assert lab.double.joints_deg[0] - before[0] == pytest.approx(20.0, abs=2.0)  # of 40
    assert lab.arm.health().extra["call_ms"] == pytest.approx(10.0)


def test_the_pose_is_that_of_the_angles_read_with_it(lab: Simulated) -> None:
    lab.recorded.takes_s = 0.004
    lab.arm.set_velocity(jaco.JointVelocity((15.0, -10.0, 12.0, 20.0, -20.0, 10.0)), valid_for_s=1.0)
    lab.run(0.5)
    state = lab.arm.next(1.0)
    np.testing.assert_allclose(state.T_base_end_effector, J2N6S300.end_effector(state.joints_deg), atol=1e-9)


def test_an_arm_that_is_not_seen_any_more_is_stopped(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=10.0)
    lab.run(0.2)
    lab.recorded.takes_s = 0.045
    lab.double.inject("GetAngularPosition", 1016, 8)
    lab.run(2.0)
    assert "could not be read" in lab.arm.stopped_because
    assert lab.double.fifo_count == 0


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["turn", "stall", "stop", "wait"]),
            st.floats(min_value=0.001, max_value=0.3, allow_nan=False),
        ),
        min_size=1,
        max_size=12,
    )
)
def test_whatever_the_sender_does_no_point_outlives_its_command(steps: list[tuple[str, float]]) -> None:
    lab = Simulated()
    vouched_s = 0.0
    with lab.arm.open(own_thread=False):
        for kind, seconds in steps:
            if kind == "turn" and not lab.arm.stopped_because:
                lab.arm.set_velocity(TURN, valid_for_s=seconds)
                vouched_s = lab.now_s + seconds
            elif kind == "stall":
                lab.clock.advance_to(lab.clock() + round(seconds * 1e9))
            elif kind == "stop":
                lab.arm.stop()
                vouched_s = lab.now_s
            lab.run(0.05)
            assert lab.double.fifo_count <= 2
            assert all(at_s <= vouched_s for at_s, rate in lab.recorded.points()[-1:] if rate != 0.0)
        lab.run(0.5)
        assert lab.double.fifo_count == 0
        times_ms = np.array([at_s * 1e3 for at_s, _ in lab.recorded.points()])
        for at_ms in times_ms:  # no burst: at most one point a slot, and a late one beside the next
            assert np.sum((times_ms >= at_ms) & (times_ms < at_ms + 50.0)) <= 6
        stopped = lab.double.joints_deg
        lab.run(0.2)
        np.testing.assert_array_equal(lab.double.joints_deg, stopped)


def test_an_arm_whose_clock_runs_slow_is_not_filled_up() -> None:
    clock = SimulatedClock()
    double = jaco.JacoDouble(clock=lambda: round(clock() * 0.98))
    with jaco.Jaco(jaco.JacoConfig(), double, clock=clock).open(own_thread=False) as arm:
        arm.set_velocity(TURN, valid_for_s=30.0)
        most = 0
        while clock() < 20_000_000_000:
            arm.poll(PERIOD_S)
            most = max(most, double.fifo_count)
        assert most <= 5
        assert arm.health().extra["slots_left_out"] == pytest.approx(0.02 * 2000, abs=8)


def test_states_come_at_their_rate_and_have_no_seventh_joint(lab: Simulated) -> None:
    states = lab.arm.readings()
    lab.run(2.0)
    taken = states.take()
    assert len(taken) == pytest.approx(100, abs=1)
    state = taken[-1]
    for values in (state.joints_deg, state.rates_deg_s, state.torques_nm, state.currents_a, state.temperatures_deg_c):
        assert len(values) == 6
    np.testing.assert_allclose(state.joints_deg, J2N6S300.home_deg, atol=1e-4)
    np.testing.assert_allclose(state.T_base_end_effector, J2N6S300.end_effector(J2N6S300.home_deg), atol=1e-6)
    assert state.supply_v == 24.0
    assert state.fifo_count == 0


def test_a_push_is_seen_in_the_state(lab: Simulated) -> None:
    lab.double.push((1.0, 2.0, 3.0, 0.1, 0.2, 0.3))
    np.testing.assert_allclose(lab.arm.next(1.0).wrench, (1.0, 2.0, 3.0, 0.1, 0.2, 0.3), atol=1e-6)


def test_codes_that_pass_are_counted_and_those_that_stay_are_a_lost_link(lab: Simulated) -> None:
    lab.double.inject("GetCartesianForce", 1016, 3)
    lab.run(0.5)
    assert lab.arm.health().refused == {"1016 ERROR_OPERATION_INCOMPLETED": 3}
    assert lab.arm.link is Link.CONNECTED
    lab.double.inject("GetCartesianForce", 1016, 30)
    with pytest.raises(LinkLost, match="1016"):
        lab.run(0.5)


@pytest.mark.parametrize(
    "velocity",
    [
        jaco.JointVelocity((20.1, 0, 0, 0, 0, 0)),
        jaco.JointVelocity((0, 0, 0, 0, 0, -20.1)),
        jaco.JointVelocity((math.nan, 0, 0, 0, 0, 0)),
        jaco.JointVelocity((math.inf, 0, 0, 0, 0, 0)),
        jaco.JointVelocity((1.0, 0, 0, 0, 0)),
        jaco.JointVelocity((1.0, 0, 0, 0, 0, 0, 0)),
        jaco.CartesianVelocity((0.0501, 0, 0)),
        jaco.CartesianVelocity((0.03, 0.03, 0.03)),
        jaco.CartesianVelocity((0, 0, math.nan)),
        jaco.CartesianVelocity((0, 0, 0), (0, 0.36, 0)),
        jaco.CartesianVelocity((0, 0, 0), (0, -math.inf, 0)),
    ],
)
def test_velocities_beyond_the_limits_are_refused_and_nothing_is_sent(lab: Simulated, velocity: Velocity) -> None:
    before = len(lab.recorded.times("SendBasicTrajectory"))
    with pytest.raises(OutOfLimits):
        lab.arm.set_velocity(velocity)
    lab.run(0.1)
    assert len(lab.recorded.times("SendBasicTrajectory")) == before
    np.testing.assert_allclose(lab.double.joints_deg, J2N6S300.home_deg)


def test_a_joint_s_own_greatest_rate_holds_whatever_is_configured() -> None:
    lab = Simulated(jaco.JacoConfig(joint_limit_deg_s=40.0))
    with lab.arm.open(own_thread=False):
        lab.arm.set_velocity(jaco.JointVelocity((36.0, 0, 0, 40.0, 0, 0)))
        with pytest.raises(OutOfLimits, match="rate of joint 2 up to 36 deg/s"):
            lab.arm.set_velocity(jaco.JointVelocity((0, 37.0, 0, 0, 0, 0)))


@pytest.mark.parametrize("valid_for_s", [0.0, -1.0, math.nan, math.inf, 61.0])
def test_a_time_that_means_nothing_is_refused(lab: Simulated, valid_for_s: float) -> None:
    with pytest.raises(OutOfLimits):
        lab.arm.set_velocity(TURN, valid_for_s=valid_for_s)


def test_a_refused_velocity_leaves_the_one_before(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=1.0)
    with pytest.raises(OutOfLimits):
        lab.arm.set_velocity(jaco.JointVelocity((99.0, 0, 0, 0, 0, 0)))
    before = lab.double.joints_deg
    lab.run(0.5)
    assert lab.double.joints_deg[0] - before[0] == pytest.approx(5.0, abs=0.11)


BOX = jaco.Workspace((0.1, -0.35, 0.40), (0.3, -0.15, 0.60))  # around the home pose's (0.2145, -0.2563, 0.5107)


def test_the_arm_stops_before_it_leaves_its_workspace_and_says_so() -> None:
    lab = Simulated(jaco.JacoConfig(workspace=BOX))
    with lab.arm.open(own_thread=False):
        lab.arm.next(1.0)
        lab.arm.set_velocity(jaco.CartesianVelocity((0.0, 0.0, -0.05)), valid_for_s=10.0)
        lab.run(5.0)
        assert 0.40 < lab.double.T_base_end_effector[2, 3] < 0.41
        assert "along z" in lab.arm.stopped_because
        with pytest.raises(jaco.MotionStopped, match="along z"):
            lab.arm.set_velocity(TURN)
        lab.arm.acknowledge_stop()
        lab.arm.set_velocity(jaco.CartesianVelocity((0.0, 0.0, 0.05)), valid_for_s=1.0)
        lab.run(0.5)
        assert lab.arm.stopped_because == ""
        assert lab.double.T_base_end_effector[2, 3] > 0.42


def test_joint_velocities_keep_the_workspace_too() -> None:
    lab = Simulated(jaco.JacoConfig(workspace=BOX))
    with lab.arm.open(own_thread=False):
        lab.arm.next(1.0)
        lab.arm.set_velocity(jaco.JointVelocity((0.0, 20.0, 0.0, 0.0, 0.0, 0.0)), valid_for_s=10.0)
        lab.run(5.0)
        assert "workspace" in lab.arm.stopped_because
        assert BOX.contains(tuple(lab.double.T_base_end_effector[:3, 3]))


def test_a_home_that_is_not_reached_in_time_stops_the_arm(lab: Simulated) -> None:
    lab.double.put(J2N6S300.home_deg - 40.0)
    with pytest.raises(jaco.NotReached, match=r"1\.5 s"):
        lab.arm.home(timeout_s=1.5)
    stopped = lab.double.joints_deg
    lab.run(0.5)
    np.testing.assert_array_equal(lab.double.joints_deg, stopped)
    assert lab.double.fifo_count == 0


def test_a_move_whose_caller_vanished_is_stopped_by_the_cycle(lab: Simulated) -> None:
    lab.arm._homing_until_ns = lab.clock() + 100_000_000  # as if the thread that waits had died
    lab.run(0.3)
    assert "no caller waited" in lab.arm.stopped_because


def test_one_thing_at_a_time(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=5.0)
    with pytest.raises(OutOfLimits, match="moving"):
        lab.arm.home()
    before = lab.double.joints_deg
    lab.run(0.5)
    assert lab.double.joints_deg[0] - before[0] == pytest.approx(5.0, abs=0.11)  # what went on goes on
    lab.arm.stop()
    lab.arm.home()
    lab.arm._homing_until_ns = lab.clock() + 100_000_000
    with pytest.raises(OutOfLimits, match="home"):
        lab.arm.set_velocity(TURN)


def test_stop_erases_at_once(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=5.0)
    lab.run(0.3)
    asked_s = lab.now_s
    lab.arm.stop()
    assert lab.recorded.times("EraseAllTrajectories")[-1] == asked_s
    assert lab.double.fifo_count == 0
    stopped = lab.double.joints_deg
    lab.run(0.3)
    np.testing.assert_array_equal(lab.double.joints_deg, stopped)


def test_a_halt_holds_against_a_sender_that_goes_on() -> None:
    double = jaco.JacoDouble()
    recorded = Recorded(double, time.monotonic_ns)
    with jaco.Jaco(PATIENT, recorded) as arm:
        over = threading.Event()

        def sender() -> None:
            while not over.is_set():
                with contextlib.suppress(jaco.MotionStopped):
                    arm.set_velocity(TURN)

        thread = threading.Thread(target=sender)
        thread.start()
        wait_until(lambda: arm.health().extra["points_sent"] > 10)
        arm.halt("the force was too high")
        halted_s = time.monotonic()
        time.sleep(0.1)
        over.set()
        thread.join()
        assert [at_s for at_s, rate in recorded.points() if rate != 0.0 and at_s > halted_s] == []
        assert double.fifo_count == 0
        with pytest.raises(jaco.MotionStopped, match="force"):
            arm.set_velocity(TURN)


def test_a_halt_ends_a_way_home() -> None:
    double = jaco.JacoDouble(start_deg=J2N6S300.home_deg - 40.0)
    with jaco.Jaco(PATIENT, double) as arm:
        reported: list[BaseException] = []

        def mover() -> None:
            try:
                arm.home()
            except jaco.MotionStopped as error:
                reported.append(error)

        thread = threading.Thread(target=mover)
        thread.start()
        wait_until(lambda: double.joints_deg[0] > J2N6S300.home_deg[0] - 39.0)
        arm.halt("the force was too high")
        thread.join(5.0)
        assert "force" in str(reported[0])
        stopped = double.joints_deg
        time.sleep(0.05)
        np.testing.assert_array_equal(double.joints_deg, stopped)
        assert double.fifo_count == 0


def test_stop_that_does_not_reach_the_arm_is_reported(lab: Simulated) -> None:
    lab.arm.set_velocity(TURN, valid_for_s=5.0)
    lab.double.unplug()
    with pytest.raises(LinkLost):
        lab.arm.stop()
    lab.double.plug()


def test_it_goes_home(lab: Simulated) -> None:
    hold(lab.arm, jaco.JointVelocity((20.0, 10.0, 0.0, 0.0, -20.0, 0.0)), 1.0)
    np.testing.assert_allclose(lab.arm.home().joints_deg, J2N6S300.home_deg, atol=0.1)


def test_the_rates_reported_are_those_of_the_joints_and_zero_at_rest(simulated: jaco.Jaco) -> None:
    at_rest = [simulated.next(1.0) for _ in range(20)]
    assert max(abs(rate) for state in at_rest for rate in state.rates_deg_s) < 0.05
    simulated.set_velocity(jaco.JointVelocity((20.0, -15.0, 0.0, 10.0, -5.0, 0.0)), valid_for_s=2.0)
    until_ns = simulated._clock() + 500_000_000
    while simulated._clock() < until_ns:
        state = simulated.next(1.0)
    np.testing.assert_allclose(state.rates_deg_s, (20.0, -15.0, 0.0, 10.0, -5.0, 0.0), atol=0.1)


def test_a_link_lost_while_it_moves_comes_back_with_the_arm_stopped() -> None:
    double = jaco.JacoDouble()
    with jaco.Jaco(PATIENT, double, reconnect=QUICK) as arm:
        arm.set_velocity(TURN, valid_for_s=30.0)
        wait_until(lambda: arm.health().extra["points_sent"] > 5)
        double.unplug()
        wait_until(lambda: arm.link is Link.LOST)
        with pytest.raises(jaco.MotionStopped, match="lost"):
            arm.set_velocity(TURN)
        double.plug()
        wait_until(lambda: arm.link is Link.CONNECTED)
        with pytest.raises(jaco.MotionStopped, match="lost"):
            arm.set_velocity(TURN)
        wait_until(lambda: double.fifo_count == 0)
        stopped = double.joints_deg
        arm.next(5.0)
        np.testing.assert_array_equal(double.joints_deg, stopped)
        arm.acknowledge_stop()
        arm.set_velocity(TURN)
        wait_until(lambda: double.joints_deg[0] > stopped[0] + 0.2)


def test_a_link_lost_on_the_way_home_is_reported_at_once() -> None:
    double = jaco.JacoDouble(start_deg=J2N6S300.home_deg - 40.0)
    with jaco.Jaco(PATIENT, double, reconnect=QUICK) as arm:
        reported: list[BaseException] = []

        def mover() -> None:
            try:
                arm.home()
            except jaco.MotionStopped as error:
                reported.append(error)

        thread = threading.Thread(target=mover)
        thread.start()
        wait_until(lambda: double.joints_deg[0] > J2N6S300.home_deg[0] - 39.0)
        double.unplug()
        thread.join(10.0)
        assert "lost" in str(reported[0])
        assert double.rates_deg_s[0] > 0.0  # the arm itself goes on: nothing can be erased without a cable
        double.plug()
        wait_until(lambda: arm.link is Link.CONNECTED)
        wait_until(lambda: not double.rates_deg_s.any())
        assert double.joints_deg[0] < J2N6S300.home_deg[0] - 1.0


def test_a_pacer_keeps_its_schedule_and_counts_what_it_missed() -> None:
    pacer = SlotPacer(10)
    pacer.start(100)
    assert pacer.enter(100) == 0
    assert pacer.due_ns == 110
    assert pacer.enter(113) == 3
    assert pacer.due_ns == 120
    assert pacer.enter(157) == 37
    assert (pacer.due_ns, pacer.missed, pacer.slots) == (160, 3, 3)
    assert pacer.lateness_ms()[2] == 37e-6


@pytest.mark.parametrize(
    "wrong",
    [
        {"connection": "serial"},
        {"model": "panda"},
        {"linear_limit_m_s": 0.0},
        {"angular_limit_rad_s": math.nan},
        {"joint_limit_deg_s": -1.0},
        {"command_deadline_s": 0.0},
        {"state_hz": 0.0},
        {"state_hz": 101.0},
        {"open_attempts": 0},
    ],
)
def test_a_configuration_that_makes_no_sense_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="expected"):
        jaco.JacoConfig(**wrong)


def test_boxes_and_addresses_are_checked() -> None:
    with pytest.raises(ValueError, match="low below high"):
        jaco.Workspace((0.0, 0.0, 0.5), (1.0, 1.0, 0.4))
    with pytest.raises(ValueError, match="192"):
        jaco.EthernetAddresses(robot_ip="192.168.100.300")


def test_the_fifo_is_reported_in_the_state() -> None:
    lab = Simulated()
    with lab.arm.open(own_thread=False):
        lab.arm.set_velocity(TURN, valid_for_s=1.0)
        lab.run(0.2)
        assert (
            lab.arm.latest(1.0).fifo_count
            == read(lab.double, "GetGlobalTrajectoryInfo", structures.TrajectoryFIFO).TrajectoryCount
        )
