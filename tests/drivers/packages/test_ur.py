"""Universal Robots: the driver against its double, in memory on a simulated clock, and behind sockets."""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from deformscope_ur import DRIVER, Ur, UrConfig, UrDouble, rtde, ur_chain
from deformscope_ur.config import CHAINS, RTDE
from deformscope_ur.device import SILENCE_S, control_script, open_ur
from deformscope_ur.double import Connection
from scipy.spatial.transform import Rotation

from deformscope.lab.arms import arm_in_lab
from deformscope.recording.losses import lost_by
from deformscope_drivers.arm import JointVelocity, MotionStopped
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.arm.kinematics import FloatArray, pose_error
from deformscope_drivers.contract import ArmContract as ArmDeviceContract
from deformscope_drivers.contract import DeviceContract
from deformscope_drivers.contract.devices import bench_of, wait_until
from deformscope_drivers.errors import CommandRefused, DeviceError, SettingsRefused
from deformscope_drivers.health import Link
from deformscope_drivers.interface import DRIVERS, ArmInLab, DeviceDriver
from deformscope_drivers.memory import SimulatedClock
from deformscope_drivers.wires import PortsWire
from studies import rigid_faults
from studies.rigid_faults import CASES, FELT, SensorFault
from tests.cases import slow_but
from tests.drivers.arm.contract import ArmBench, ArmContract
from tests.drivers.arm.test_contract import polled
from tests.drivers.packages.ur_faults import BEFORE, FAULTS, run_fault
from tests.drivers.packages.ur_memory import MemoryPorts
from tests.patience import PATIENCE_S

RATES = JointVelocity((6.0, 0.0, 0.0, -4.0, 0.0, 0.0))


class TestUr(DeviceContract, ArmDeviceContract):
    @pytest.fixture
    def driver(self) -> DeviceDriver:
        return dataclasses.replace(DRIVER, example=lambda: UrConfig(own_process=False))


def test_it_moves_from_its_own_process() -> None:
    with bench_of(DRIVER, lambda time_s: None) as bench, bench.device.open() as arm:
        assert isinstance(arm, HostedArm)
        stood = arm.next(PATIENCE_S).joints_deg[0]
        arm.set_velocity(RATES, 60.0)
        wait_until(lambda: bool(arm.next(PATIENCE_S).joints_deg[0] > stood + 0.1))


JUNK = b"\xff" * 9


class Noisy(UrDouble):
    """junk: before so many of its next reports stand bytes that fit no package."""

    junk = 0

    def connection(self, name: str) -> Connection:
        connection = super().connection(name)
        due = connection.due

        def noisy(now_ns: int) -> bytes:
            sent = due(now_ns)
            if name != RTDE or not sent or not self.junk:
                return sent
            self.junk -= 1
            return JUNK + sent

        connection.due = noisy  # type: ignore[method-assign]
        return connection


@pytest.mark.parametrize("own_process", [False, True])
def test_bytes_that_were_skipped_are_losses_of_a_recording(own_process: bool) -> None:
    double = Noisy(UrConfig(own_process=own_process))
    with PortsWire(double) as wire, open_ur(dataclasses.replace(double.config, port=wire.port)) as arm:
        arm.next(PATIENCE_S)
        assert "skipped_bytes" not in lost_by(arm.health())
        double.junk = 3
        wait_until(lambda: lost_by(arm.health()).get("skipped_bytes") == 3 * len(JUNK))
        wait_until(lambda: sum(arm.health().refused.values()) >= 3)


class TestUrMoves(ArmContract):
    @pytest.fixture(params=["ur5e", "ur3", "ur10"])
    def bench(self, request: pytest.FixtureRequest) -> ArmBench:
        clock = SimulatedClock(1_000_000_000)
        config = UrConfig(model=request.param, own_process=False)
        double = UrDouble(config)
        arm = Ur(config, MemoryPorts(double, clock), clock=clock)
        return ArmBench(arm, polled(arm, clock), lambda: double.T_base_end_effector)


class Bench:
    """An arm in memory. advance: lets time pass [s], the driver looking after its arm"""

    def __init__(self, config: UrConfig | None = None) -> None:
        self.clock = SimulatedClock(1_000_000_000)
        self.config = config or UrConfig(own_process=False)
        self.double = UrDouble(self.config)
        self.ports = MemoryPorts(self.double, self.clock)
        self.arm = Ur(self.config, self.ports, clock=self.clock)
        self.advance: Callable[[float], None] = polled(self.arm, self.clock)

    def move(self) -> None:
        self.arm.set_velocity(RATES, 30.0)
        self.advance(0.3)
        assert np.any(self.double.rates_deg_s)


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    with contextlib.suppress(DeviceError), bench.arm.open(own_thread=False):
        yield bench


# Kinematics, against an independent chain ----------------------------------------------------------------------------

# typed from ur_description (ros-industrial), config/MODEL/default_kinematics.yaml: place [m] and roll, pitch, yaw of
# each joint in the one before; behind the last one are flange and tool0, which it turns to the wrist's own frame
HALF, WHOLE = math.pi / 2, math.pi
URDF = {
    "ur3": ((0.1519, -0.24365, -0.21325, 0.11235, -0.08535, 0.0819)),
    "ur5": ((0.089159, -0.425, -0.39225, 0.10915, -0.09465, 0.0823)),
    "ur10": ((0.1273, -0.612, -0.5723, 0.163941, -0.1157, 0.0922)),
    "ur3e": ((0.15185, -0.24355, -0.2132, 0.13105, -0.08535, 0.0921)),
    "ur5e": ((0.1625, -0.425, -0.3922, 0.1333, -0.0997, 0.0996)),
    "ur16e": ((0.1807, -0.4784, -0.36, 0.17415, -0.11985, 0.11655)),
}


def by_urdf(model: str, joints_deg: FloatArray) -> FloatArray:
    shoulder_z, forearm_x, wrist_1_x, wrist_1_z, wrist_2_y, wrist_3_y = URDF[model]
    frames = (
        ((0, 0, shoulder_z), (0, 0, 0)),
        ((0, 0, 0), (HALF, 0, 0)),
        ((forearm_x, 0, 0), (0, 0, 0)),
        ((wrist_1_x, 0, wrist_1_z), (0, 0, 0)),
        ((0, wrist_2_y, 0), (HALF, 0, 0)),
        ((0, wrist_3_y, 0), (HALF, WHOLE, WHOLE)),
    )
    T = np.eye(4)
    for (xyz_m, rpy_rad), angle_deg in zip(frames, joints_deg, strict=True):
        step = np.eye(4)
        step[:3, :3] = (
            Rotation.from_euler("xyz", rpy_rad) * Rotation.from_euler("z", angle_deg, degrees=True)
        ).as_matrix()
        step[:3, 3] = xyz_m
        T = T @ step
    return T


@pytest.mark.parametrize("model", URDF)
def test_the_flange_is_where_ur_description_has_it(model: str) -> None:
    random = np.random.default_rng(3)
    for joints_deg in random.uniform(-180.0, 180.0, (20, 6)):
        np.testing.assert_allclose(CHAINS[model].end_effector(joints_deg), by_urdf(model, joints_deg), atol=1e-8)


def test_a_ur5e_at_zero_is_where_its_maker_says() -> None:
    np.testing.assert_allclose(CHAINS["ur5e"].end_effector([0.0] * 6)[:3, 3], [-0.8172, -0.2329, 0.0628], atol=1e-12)


@pytest.mark.parametrize("model", URDF)
def test_the_jacobian_is_the_change_of_the_pose(model: str) -> None:
    chain, random, step_deg = CHAINS[model], np.random.default_rng(4), 1e-4
    for joints_deg in random.uniform(-170.0, 170.0, (5, 6)):
        for joint in range(6):
            ahead = np.eye(6)[joint] * step_deg
            ends = [by_urdf(model, joints_deg + sign * ahead) for sign in (-1.0, 1.0)]
            change = pose_error(*ends) / math.radians(2 * step_deg)
            np.testing.assert_allclose(chain.jacobian(joints_deg)[:, joint], change, atol=1e-6)


def calibrated(parallel_m: float) -> dict[str, tuple[float, ...]]:
    """Deviations as a controller has them, with d of the second and third joint that cancel."""
    random = np.random.default_rng(6)
    small = {name: tuple(random.normal(0.0, 5e-4, 6)) for name in ("delta_theta", "delta_a", "delta_d", "delta_alpha")}
    d = np.add(small["delta_d"], [0.0, parallel_m, -parallel_m, 0.0, 0.0, 0.0])
    return small | {"delta_d": tuple(d)}


@pytest.mark.parametrize("parallel_m", [0.0, 80.0])
def test_a_calibrated_arm_is_the_product_of_its_own_denavit_hartenberg_steps(parallel_m: float) -> None:
    deltas = calibrated(parallel_m)
    chain = ur_chain("ur10e", *deltas.values())
    a = np.array([0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0]) + deltas["delta_a"]
    d = np.array([0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655]) + deltas["delta_d"]
    alpha = np.array([HALF, 0.0, 0.0, HALF, -HALF, 0.0]) + deltas["delta_alpha"]
    for joints_deg in np.random.default_rng(7).uniform(-180.0, 180.0, (10, 6)):
        T = np.eye(4)
        for joint, theta in enumerate(np.radians(joints_deg) + deltas["delta_theta"]):
            ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha[joint]), np.sin(alpha[joint])
            T = T @ [
                [ct, -st * ca, st * sa, a[joint] * ct],
                [st, ct * ca, -ct * sa, a[joint] * st],
                [0.0, sa, ca, d[joint]],
                [0.0, 0.0, 0.0, 1.0],
            ]
        np.testing.assert_allclose(chain.end_effector(joints_deg), T, atol=1e-9)
        assert np.abs(chain.forward(joints_deg)[:, :3, 3]).max() < 2.0  # no frame is far from the arm


def test_a_calibration_is_refused_unless_it_is_this_arm_and_noticed_where_it_is_missing() -> None:
    deltas = calibrated(0.0)
    bench = Bench()
    bench.double.chain = ur_chain("ur5e", *deltas.values())
    with bench.arm.open(own_thread=False):
        (remark,) = bench.arm.remarks()
    assert "calibration.conf" in remark
    bench = Bench(UrConfig(own_process=False, **deltas))
    with bench.arm.open(own_thread=False):
        assert bench.arm.remarks() == ()


# Unkind controllers --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("strike", "reason"),
    [
        (lambda bench: bench.double.protective_stop(), "protective stop: look for its cause"),
        (lambda bench: bench.double.emergency_stop(), "emergency stop"),
        (lambda bench: bench.double.pause(), "its program is paused"),
        (lambda bench: bench.double.end_program(), "its program is stopped"),
        (lambda bench: setattr(bench.double, "slider", 0.2), "speed slider at 20 %"),
        (lambda bench: setattr(bench.double, "lag_s", 0.5), "no heartbeat for 0.1 s"),
        (lambda bench: setattr(bench.double, "gain", 10.0), "a joint turned at .* deg/s, and at most 6.0 was asked"),
    ],
)
def test_what_its_controller_reports_stops_the_arm_until_it_is_acknowledged(
    strike: Callable[[Bench], object], reason: str, bench: Bench
) -> None:
    bench.move()
    strike(bench)
    bench.advance(0.2)
    assert not np.any(bench.double.rates_deg_s)
    with pytest.raises(MotionStopped, match=reason):
        bench.arm.set_velocity(RATES, 1.0)
    stands = bench.double.joints_deg
    bench.double.slider, bench.double.lag_s, bench.double.gain = 1.0, 0.002, 1.0
    bench.advance(0.5)
    np.testing.assert_array_equal(bench.double.joints_deg, stands)


def test_a_protective_stop_is_unlocked_by_who_acknowledges_it_but_not_too_early(bench: Bench) -> None:
    bench.move()
    bench.double.protective_stop()
    bench.advance(1.0)
    with pytest.raises(CommandRefused, match="Cannot unlock protective stop until 5s"):
        bench.arm.acknowledge_stop()
    assert bench.arm.stopped_because
    bench.advance(5.0)
    bench.arm.acknowledge_stop()
    assert not bench.arm.stopped_because
    bench.move()


@pytest.mark.parametrize("end", ["pause", "end_program"])
def test_a_program_that_was_stopped_on_the_pendant_is_started_again_by_who_acknowledges_it(
    end: str, bench: Bench
) -> None:
    bench.move()
    getattr(bench.double, end)()
    bench.advance(0.1)
    bench.arm.acknowledge_stop()
    assert len(bench.double.programs) == 2
    bench.move()


def test_a_slider_that_stays_low_is_not_acknowledged(bench: Bench) -> None:
    bench.double.slider = 0.2
    bench.advance(0.1)
    with pytest.raises(SettingsRefused, match=r"speed slider at 20 %.*try: set it to 100 %"):
        bench.arm.acknowledge_stop()
    bench.double.slider = 1.0
    bench.advance(0.1)
    bench.arm.acknowledge_stop()
    bench.move()


def test_its_script_stops_the_arm_when_nobody_sends_heartbeats(bench: Bench) -> None:
    bench.move()
    at = bench.double.joints_deg[0]
    bench.clock.advance_to(bench.clock() + 1_500_000_000)
    bench.double.live(bench.clock())
    assert not np.any(bench.double.rates_deg_s)
    assert bench.double.joints_deg[0] - at == pytest.approx(6.0 * SILENCE_S, abs=0.15)
    assert bench.double.popups == ["RTDE watchdog: input_int_register_42"]
    bench.advance(0.1)
    with pytest.raises(MotionStopped):
        bench.arm.set_velocity(RATES, 1.0)


def test_its_script_does_not_move_on_when_the_driver_is_back(bench: Bench) -> None:
    """Heartbeats that come again with the velocity of before: first it must be zero."""
    bench.move()
    bench.clock.advance_to(bench.clock() + 200_000_000)
    bench.double.live(bench.clock())
    stands = bench.double.joints_deg
    for beat in range(100):
        bench.double.take({"input_int_register_42": 1000 + beat}, bench.clock())
        bench.clock.advance_to(bench.clock() + 8_000_000)
        bench.double.live(bench.clock())
    np.testing.assert_array_equal(bench.double.joints_deg, stands)


def test_without_our_script_registers_move_nothing(bench: Bench) -> None:
    bench.double.load("def p():\n  while True:\n    speedj([0, 0, 0, 0, 0, 0], 1, 0.002)\n  end\nend\n", bench.clock())
    bench.double.take({f"input_double_register_{number}": 0.1 for number in range(42, 48)}, bench.clock())
    bench.advance(0.5)
    np.testing.assert_array_equal(bench.double.joints_deg, bench.double.chain.home_deg)


def test_a_cable_that_is_pulled_ends_the_motion_and_is_found_again(bench: Bench) -> None:
    """Behind real sockets: the link is reset, and opened again; then a velocity is refused until it is acknowledged."""
    bench.arm.close()
    double = UrDouble()
    with PortsWire(double) as wire, Ur(UrConfig(port=wire.port)) as arm:
        arm.set_velocity(RATES, 30.0)
        wait_until(lambda: bool(np.any(double.rates_deg_s)))
        wire.unplug()
        wait_until(lambda: arm.link is Link.LOST)
        wire.plug()
        wait_until(lambda: arm.link is Link.CONNECTED)
        assert not np.any(double.rates_deg_s)
        with pytest.raises(MotionStopped, match="the link to the arm was lost while it moved"):
            arm.set_velocity(RATES, 1.0)
        arm.acknowledge_stop()
        arm.set_velocity(RATES, 1.0)


@pytest.mark.parametrize("seed", range(40))
def test_a_fault_stops_it_within_two_control_periods_or_is_refused_before_it_moves(seed: int) -> None:
    found = run_fault(seed)
    assert found.in_time, found


@pytest.mark.slow
def test_a_thousand_random_faults() -> None:
    found = [run_fault(seed) for seed in range(1000)]
    assert {one.fault for one in found} == {*FAULTS, *BEFORE}
    assert [one for one in found if not one.in_time] == []


# Broken rigs (more of them: tests/cli/test_broken_rigs.py) -----------------------------------------------------------


def one_line(error: BaseException) -> str:
    words = str(error)
    assert "\n" not in words
    assert "try: " in words
    return words


@pytest.mark.parametrize(
    ("broken", "what_to_do"),
    [
        (lambda double: setattr(double, "remote", False), "got local control | try: choose remote control"),
        (lambda double: double.protective_stop(), "got a protective stop | try: look for its cause, then unlock it"),
        (lambda double: setattr(double, "chain", CHAINS["ur10e"]), "try: another `model`; a TCP of zero"),
    ],
)
def test_a_controller_that_is_not_ready(broken: Callable[[UrDouble], object], what_to_do: str) -> None:
    bench = Bench()
    broken(bench.double)
    with pytest.raises(SettingsRefused) as caught:
        bench.arm.open(own_thread=False)
    assert what_to_do in one_line(caught.value)
    assert not bench.double.programs  # nothing was uploaded


def test_a_gain_of_ten(bench: Bench) -> None:
    bench.double.gain = 10.0
    bench.arm.set_velocity(RATES, 30.0)
    bench.advance(0.2)
    with pytest.raises(MotionStopped) as caught:
        bench.arm.set_velocity(RATES, 1.0)
    assert "and at most 6.0 was asked" in one_line(caught.value)
    assert np.abs(bench.double.joints_deg - bench.double.chain.home_deg).max() < 2.0


# Settings --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [
        {"port": "/dev/ttyUSB0"},
        {"model": "ur7"},
        {"state_hz": 120.0},
        {"state_hz": 10.0},
        {"model": "ur5", "state_hz": 500.0},
        {"delta_a": (0.0,) * 5},
        {"delta_d": (math.nan,) * 6},
        {"joint_limit_deg_s": 0.0},
        {"command_deadline_s": 9.0},
    ],
)
def test_wrong_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises((ValueError, DeviceError)):
        UrConfig(**wrong)  # type: ignore[arg-type]


def test_the_script_has_no_place_left_open() -> None:
    text = control_script(UrConfig(), 9)
    assert "{{" not in text
    assert all(len(line) <= 120 for line in text.splitlines())
    assert rtde.NORMAL  # the vendor's names of its modes are those of the guide
    assert rtde.ROBOT_MODES[7] == "RUNNING"
    assert rtde.SAFETY[9] == "a safety fault"
    assert rtde.SAFETY[11] == "its three-position switch"


# A rigid surface under a force sensor that is wrong (studies/rigid_faults.py), with this arm ---------------------


@pytest.mark.parametrize("fault", slow_but([SensorFault.DEAD, SensorFault.SCALE], [*FELT, SensorFault.FROZEN]))
def test_a_wrong_force_sensor_is_refused_or_stops_the_arm(fault: SensorFault, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DRIVERS._loaded, "ur", dataclasses.replace(DRIVER, name="ur"))

    def with_ur(driver: str, config: object, *more: Any) -> ArmInLab:
        return arm_in_lab("ur", UrConfig(), *more)

    monkeypatch.setattr(rigid_faults, "arm_in_lab", with_ur)
    found = rigid_faults.run_rigid(CASES.index(("kuka with motor currents", fault, 2e4, None)))
    assert found.in_time, found
    assert found.refused or found.ended.startswith("stopped: ")


def test_it_is_an_arm_of_the_laboratory() -> None:
    clock = SimulatedClock(1_000_000_000)
    assert DRIVER.in_lab is not None
    made = DRIVER.in_lab(UrConfig(), CHAINS["ur5e"].home_deg + 5.0, clock)
    with made.arm.open(own_thread=False) as arm:
        made.body.push([0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
        states = []
        with arm.readings() as queue:
            polled(arm, clock)(0.5)
            states = queue.take()
        np.testing.assert_allclose(made.body.T_base_end_effector, states[-1].T_base_end_effector, atol=1e-9)
        assert np.mean([state.wrench[2] for state in states]) == pytest.approx(20.0, abs=2.0)
        assert len(states[-1].currents) == 6
