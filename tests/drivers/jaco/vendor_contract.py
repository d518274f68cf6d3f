"""What a double of the vendor's library owes: one set of tests, run on each of them through the same functions."""

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.device import CartesianVelocity, JointVelocity
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.jaco import errors, structures
from deformscope_drivers.jaco.config import Workspace
from deformscope_drivers.jaco.library import api_version, call, devices, read
from deformscope_drivers.jaco.structures import velocity_point
from deformscope_drivers.jaco.zones import boxes_of, set_zones, zone_list
from tests.drivers.jaco.benches import DEVICE_TYPES, VendorBench

CYCLE_S = 0.01
SINGLE = 1e-4  # what single precision leaves of angles in degrees, over some hundred cycles


class VendorContract:
    """Every double of the vendor's library passes this. The subclass gives the fixtures `bench` and `cold`."""

    @pytest.fixture
    def bench(self) -> Iterator[VendorBench]:
        raise NotImplementedError("a contract test gives the fixture `bench`")

    @pytest.fixture
    def cold(self) -> Iterator[VendorBench]:
        raise NotImplementedError("a contract test gives the fixture `cold`")

    @pytest.fixture
    def started(self, bench: VendorBench) -> VendorBench:
        call(bench.functions, "InitAPI")
        call(bench.functions, "StartControlAPI")
        return bench

    def test_it_tells_its_version_before_all_else(self, bench: VendorBench) -> None:
        assert api_version(bench.functions) == (5, 2, 0)

    def test_nothing_works_before_it_is_initialised(self, bench: VendorBench) -> None:
        with pytest.raises(errors.ApiNotInitialized):
            read(bench.functions, "GetAngularPosition", structures.AngularPosition)
        with pytest.raises(errors.ApiNotInitialized):
            devices(bench.functions)
        call(bench.functions, "InitAPI")
        read(bench.functions, "GetAngularPosition", structures.AngularPosition)
        call(bench.functions, "CloseAPI")
        with pytest.raises(errors.ApiNotInitialized):
            call(bench.functions, "StartControlAPI")

    def test_it_lists_its_arm_which_goes_back_by_value(self, bench: VendorBench) -> None:
        call(bench.functions, "InitAPI")
        call(bench.functions, "RefresDevicesList")
        (device,) = devices(bench.functions)
        assert device.SerialNumber == b"DOUBLE-1"
        assert device.DeviceType == DEVICE_TYPES[bench.chain.name]
        call(bench.functions, "SetActiveDevice", device)
        with pytest.raises(errors.NoDeviceFound):
            call(bench.functions, "SetActiveDevice", structures.KinovaDevice(b"ANOTHER"))

    def test_general_informations_fit_their_structure(self, started: VendorBench) -> None:
        found = read(started.functions, "GetGeneralInformations", structures.GeneralInformations)
        assert found.SupplyVoltage == 24.0
        assert found.ConnectedActuatorCount == started.chain.joint_count
        assert bytes(found.ExpansionsBytes) == bytes(192)

    def test_a_code_on_demand_comes_once(self, started: VendorBench) -> None:
        started.inject("GetSensorsInfo", 1022)
        with pytest.raises(errors.CommunicationTimeout):
            read(started.functions, "GetSensorsInfo", structures.SensorsInfo)
        assert read(started.functions, "GetSensorsInfo", structures.SensorsInfo).Voltage == 24.0

    def test_a_code_that_nobody_knows_becomes_an_exception_too(self, started: VendorBench) -> None:
        started.inject("EraseAllTrajectories", 4242)
        with pytest.raises(errors.UnknownCode, match="4242") as caught:
            call(started.functions, "EraseAllTrajectories")
        assert caught.value.code == 4242

    def test_a_joint_that_it_has_not_is_never_written(self, started: VendorBench) -> None:
        seven = started.chain.joint_count == 7
        for name in ("GetAngularPosition", "GetAngularVelocity", "GetAngularForceGravityFree", "GetAngularCurrent"):
            poisoned = structures.AngularPosition(structures.AngularInfo(*[-77.0] * 7))
            call(started.functions, name, poisoned)
            assert (poisoned.Actuators.Actuator7 == -77.0) != seven
            assert poisoned.Actuators.Actuator6 != -77.0
        sensors = structures.SensorsInfo(*[-77.0] * 15)
        call(started.functions, "GetSensorsInfo", sensors)
        assert (sensors.ActuatorTemp7 == -77.0) != seven

    def test_a_read_starts_from_zero(self, started: VendorBench) -> None:
        angles = read(started.functions, "GetAngularPosition", structures.AngularPosition).Actuators
        assert len(structures.actuator_values(angles, started.chain.joint_count)) == started.chain.joint_count
        if started.chain.joint_count == 6:
            assert angles.Actuator7 == 0.0

    def test_an_angular_velocity_held_for_1_s_turns_by_its_angle(self, started: VendorBench) -> None:
        rates = np.array([20.0, -10.0, 15.0, 30.0, -40.0, 5.0, -12.0])[: started.chain.joint_count]
        before = joints(started)
        stream(started, JointVelocity(tuple(rates)), seconds=1.0)
        started.advance(0.5)
        np.testing.assert_allclose(joints(started) - before, rates * 1.0, atol=np.max(np.abs(rates)) * CYCLE_S)
        np.testing.assert_allclose(joints(started) - before, rates * 1.0, atol=SINGLE)
        assert np.all(rates_deg_s(started) == 0.0)

    def test_a_cartesian_velocity_held_for_1_s_moves_by_its_length(self, started: VendorBench) -> None:
        before = pose(started)
        stream(started, CartesianVelocity((0.04, -0.03, 0.05)), seconds=1.0)
        started.advance(0.5)
        after = pose(started)
        np.testing.assert_allclose(after[:3, 3] - before[:3, 3], (0.04, -0.03, 0.05), atol=0.06 * CYCLE_S)
        assert Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).magnitude() < 2e-3

    def test_an_angular_velocity_of_the_hand_turns_it_in_place_about_its_own_axes(self, started: VendorBench) -> None:
        """As Kinova's staff say of their arm: kinova-ros issues 154 and 192."""
        before = pose(started)
        stream(started, CartesianVelocity((0.0, 0.0, 0.0), (0.1, -0.2, 0.3)), seconds=1.0)
        after = pose(started)
        turned = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec()
        np.testing.assert_allclose(turned, (0.1, -0.2, 0.3), atol=0.4 * CYCLE_S)
        np.testing.assert_allclose(after[:3, 3], before[:3, 3], atol=1e-3)

    def test_a_translation_stays_in_the_base_frame_while_the_hand_turns(self, started: VendorBench) -> None:
        before = pose(started)
        stream(started, CartesianVelocity((0.02, -0.03, 0.01), (0.1, 0.2, -0.3)), seconds=1.0)
        after = pose(started)
        np.testing.assert_allclose(after[:3, 3] - before[:3, 3], (0.02, -0.03, 0.01), atol=1e-3)
        turned = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec()
        np.testing.assert_allclose(turned, (0.1, 0.2, -0.3), atol=0.4 * CYCLE_S)

    def test_a_base_frame_rotation_is_converted_for_it(self, started: VendorBench) -> None:
        before = pose(started)
        for _ in range(100):
            stream(started, CartesianVelocity.in_base((0.0, 0.0, 0.0), (0.1, -0.2, 0.3), pose(started)), CYCLE_S)
        turned = Rotation.from_matrix(pose(started)[:3, :3] @ before[:3, :3].T).as_rotvec()
        np.testing.assert_allclose(turned, (0.1, -0.2, 0.3), atol=0.4 * CYCLE_S)

    def test_the_rates_are_reported_while_it_moves(self, started: VendorBench) -> None:
        stream(started, CartesianVelocity((0.03, 0.0, -0.02)), seconds=0.2)
        cartesian, angular = structures.CartesianRates(), structures.AngularRates()
        call(started.functions, "GetCommandVelocity", cartesian, angular)
        np.testing.assert_allclose(list(cartesian), (0.03, 0.0, -0.02, 0, 0, 0), atol=1e-3)
        made = started.chain.jacobian(joints(started)) @ np.radians(list(angular)[: started.chain.joint_count])
        np.testing.assert_allclose(made, list(cartesian), atol=1e-4)

    def test_the_firmware_s_joint_velocities_are_halved_wrapped_and_not_zero_at_rest(
        self, started: VendorBench
    ) -> None:
        """As kinova-ros makes up for (kinova_comm.cpp, kinova_arm.cpp) and users see (issue 366)."""
        at_rest = shown_rates_deg_s(started)
        assert np.all((at_rest >= 0.0) & (at_rest < 360.0))
        assert np.abs((at_rest + 180.0) % 360.0 - 180.0).max() > 1.0
        stream(started, JointVelocity((20.0, -20.0, 20.0, -20.0, 20.0, -20.0, 20.0)[: started.chain.joint_count]), 0.2)
        shown = shown_rates_deg_s(started)
        np.testing.assert_allclose(shown[[0, 2, 4]], 10.0, atol=2.0)
        np.testing.assert_allclose(shown[[1, 3, 5]], 350.0, atol=2.0)

    def test_points_sent_at_half_the_rate_move_half_as_far(self, started: VendorBench) -> None:
        before = joints(started)
        for _ in range(50):
            send(started, JointVelocity((20.0,) + (0.0,) * (started.chain.joint_count - 1)))
            started.advance(0.02)
        assert joints(started)[0] - before[0] == pytest.approx(10.0, abs=0.2)

    def test_points_sent_at_twice_the_rate_pile_up_and_the_arm_runs_on(self, started: VendorBench) -> None:
        velocity = JointVelocity((20.0,) + (0.0,) * (started.chain.joint_count - 1))
        before = joints(started)
        for _ in range(200):
            send(started, velocity)
            started.advance(0.005)
        assert fifo(started).TrajectoryCount == pytest.approx(100, abs=1)
        started.advance(0.5)
        assert fifo(started).TrajectoryCount == pytest.approx(50, abs=1)
        assert joints(started)[0] - before[0] == pytest.approx(30.0, abs=0.5)
        call(started.functions, "EraseAllTrajectories")
        stopped = joints(started)
        started.advance(1.0)
        np.testing.assert_allclose(joints(started), stopped, atol=SINGLE)
        assert fifo(started).TrajectoryCount == 0

    def test_the_fifo_holds_2000_points_and_no_more(self, started: VendorBench) -> None:
        still = JointVelocity((0.0,) * started.chain.joint_count)
        for _ in range(2000):
            send(started, still)
        found = fifo(started)
        assert (found.TrajectoryCount, found.UsedPercentage, found.MaxSize) == (2000, 100.0, 2000)
        with pytest.raises(errors.NackReceived):
            send(started, still)

    def test_a_joint_goes_no_faster_than_it_can(self, started: VendorBench) -> None:
        before = joints(started)
        stream(started, JointVelocity((1000.0,) * started.chain.joint_count), seconds=0.1)
        np.testing.assert_allclose(joints(started) - before, 0.1 * started.chain.velocity_deg_s, atol=SINGLE)

    def test_a_joint_stops_at_the_end_of_its_range(self, started: VendorBench) -> None:
        down = (0.0, 36.0) + (0.0,) * (started.chain.joint_count - 2)
        stream(started, JointVelocity(down), seconds=5.0)
        assert joints(started)[1] == pytest.approx(313.0, abs=SINGLE)
        assert rates_deg_s(started)[1] == 0.0

    def test_a_point_of_no_known_type_is_refused(self, started: VendorBench) -> None:
        point = structures.TrajectoryPoint()
        point.Position.Type = 99
        with pytest.raises(errors.InvalidParameter):
            call(started.functions, "SendBasicTrajectory", point)

    def test_the_pose_reported_is_that_of_the_joints(self, started: VendorBench) -> None:
        stream(started, JointVelocity((15.0, -9.0, 11.0, 20.0, -25.0, 30.0, 7.0)[: started.chain.joint_count]), 1.0)
        np.testing.assert_allclose(pose(started), started.chain.end_effector(joints(started)), atol=1e-5)

    def test_it_finds_home(self, started: VendorBench) -> None:
        stream(started, JointVelocity((20.0,) * started.chain.joint_count), seconds=0.5)
        call(started.functions, "MoveHome")
        started.advance(1.0)
        np.testing.assert_allclose(joints(started), started.chain.home_deg, atol=SINGLE)

    @pytest.mark.parametrize("homed", [False, True])
    def test_after_angular_motion_cartesian_velocities_silently_fail_until_it_goes_home(
        self, started: VendorBench, homed: bool
    ) -> None:
        """kinova-ros issue 269: no error, no motion."""
        stream(started, JointVelocity((10.0,) + (0.0,) * (started.chain.joint_count - 1)), seconds=0.1)
        if homed:
            call(started.functions, "MoveHome")
        started.advance(1.0)
        before = pose(started)[:3, 3]
        stream(started, CartesianVelocity((0.0, 0.0, 0.03)), seconds=1.0)
        moved_m = 0.03 if homed else 0.0
        np.testing.assert_allclose(pose(started)[:3, 3] - before, (0.0, 0.0, moved_m), atol=1e-3)

    def test_after_power_up_it_must_go_home_before_it_moves_in_cartesian_space(self, cold: VendorBench) -> None:
        """kinova-ros issues 62 and 148; QuickStatus says so."""
        call(cold.functions, "InitAPI")
        for _ in range(2):  # a cold arm ignores the first
            call(cold.functions, "StartControlAPI")
        assert retract(cold) == structures.RetractType.NOT_INITIALIZED
        before = pose(cold)
        stream(cold, CartesianVelocity((0.0, 0.0, 0.03)), seconds=0.5)
        np.testing.assert_array_equal(pose(cold), before)
        stream(cold, JointVelocity((-20.0,) * cold.chain.joint_count), seconds=0.2)
        call(cold.functions, "MoveHome")
        cold.advance(0.1)
        assert retract(cold) == structures.RetractType.NORMAL_TO_READY
        cold.advance(1.0)
        assert retract(cold) == structures.RetractType.READY_STANDBY
        stream(cold, CartesianVelocity((0.0, 0.0, 0.03)), seconds=1.0)
        assert pose(cold)[2, 3] - before[2, 3] == pytest.approx(0.03, abs=1e-3)
        assert retract(cold) == structures.RetractType.NORMAL_STANDBY

    def test_fingers_open_when_they_are_initialised(self, started: VendorBench) -> None:
        assert read(started.functions, "GetQuickStatus", structures.QuickStatus).Finger1Status == 0
        call(started.functions, "InitFingers")
        started.advance(2.0)
        status = read(started.functions, "GetQuickStatus", structures.QuickStatus)
        assert (status.Finger1Status, status.Finger2Status, status.Finger3Status) == (1, 1, 1)
        assert fingers(started) == (0.0, 0.0, 0.0)

    def test_without_control_it_takes_nothing(self, bench: VendorBench) -> None:
        call(bench.functions, "InitAPI")
        before = joints(bench)
        stream(bench, JointVelocity((20.0,) * bench.chain.joint_count), seconds=0.2)
        np.testing.assert_array_equal(joints(bench), before)
        assert fifo(bench).TrajectoryCount == 0

    def test_a_cold_arm_ignores_the_first_start(self, cold: VendorBench) -> None:
        call(cold.functions, "InitAPI")
        call(cold.functions, "StartControlAPI")
        assert read(cold.functions, "GetQuickStatus", structures.QuickStatus).ControlEnableStatus == 1
        call(cold.functions, "StopControlAPI")
        call(cold.functions, "StartControlAPI")
        assert read(cold.functions, "GetQuickStatus", structures.QuickStatus).ControlEnableStatus == 0
        before = joints(cold)
        stream(cold, JointVelocity((20.0,) * cold.chain.joint_count), seconds=0.1)
        np.testing.assert_allclose(joints(cold) - before, 2.0, atol=SINGLE)

    def test_stopping_the_control_stops_the_arm(self, started: VendorBench) -> None:
        for _ in range(50):
            send(started, JointVelocity((20.0,) * started.chain.joint_count))
        started.advance(0.1)
        call(started.functions, "StopControlAPI")
        stopped = joints(started)
        started.advance(0.5)
        np.testing.assert_array_equal(joints(started), stopped)

    def test_a_push_shows_at_the_hand_and_in_the_joints(self, started: VendorBench) -> None:
        push = np.array([3.0, -2.0, 5.0, 0.1, 0.2, -0.3])
        started.push(push.tolist())
        count = started.chain.joint_count
        torque_nm = started.chain.jacobian(joints(started)).T @ push
        reported = read(started.functions, "GetCartesianForce", structures.CartesianPosition)
        np.testing.assert_allclose(structures.cartesian_values(reported.Coordinates), push, atol=1e-5)
        free = read(started.functions, "GetAngularForceGravityFree", structures.AngularPosition)
        np.testing.assert_allclose(structures.actuator_values(free.Actuators, count), torque_nm, atol=1e-4)
        both = read(started.functions, "GetForcesInfo", structures.ForcesInfo)
        np.testing.assert_allclose([both.Actuator1, both.Actuator2, both.Actuator3], torque_nm[:3], atol=1e-4)
        np.testing.assert_allclose([both.X, both.Y, both.Z, both.ThetaX, both.ThetaY, both.ThetaZ], push, atol=1e-5)

    def test_zones_are_kept_until_they_are_erased(self, bench: VendorBench) -> None:
        call(bench.functions, "InitAPI")
        boxes = Workspace((-1.0, -0.9, -1.0), (1.0, 0.9, -0.01)), Workspace((0.2, 0.3, 0.1), (0.4, 0.5, 0.6))
        for given in (boxes, boxes[:1], ()):
            set_zones(bench.functions, given, lambda: None)
            kept = boxes_of(read(bench.functions, "GetProtectionZone", structures.ZoneList))
            np.testing.assert_allclose([(*a.low_m, *a.high_m) for a in kept], [(*a.low_m, *a.high_m) for a in given])
        too_many = zone_list(boxes)
        too_many.NbZones = 11
        with pytest.raises(DeviceError):
            call(bench.functions, "SetProtectionZone", too_many)


def send(bench: VendorBench, velocity: JointVelocity | CartesianVelocity) -> None:
    call(bench.functions, "SendBasicTrajectory", velocity_point(velocity))


def stream(bench: VendorBench, velocity: JointVelocity | CartesianVelocity, seconds: float) -> None:
    """Send one point each 10 ms."""
    for _ in range(round(seconds / CYCLE_S)):
        send(bench, velocity)
        bench.advance(CYCLE_S)


def joints(bench: VendorBench) -> FloatArray:
    angles = read(bench.functions, "GetAngularPosition", structures.AngularPosition).Actuators
    return np.array(structures.actuator_values(angles, bench.chain.joint_count))


def rates_deg_s(bench: VendorBench) -> FloatArray:
    """The rates (n,) that the arm was commanded: it holds them within the cycle."""
    cartesian, angular = structures.CartesianRates(), structures.AngularRates()
    call(bench.functions, "GetCommandVelocity", cartesian, angular)
    return np.array(list(angular)[: bench.chain.joint_count])


def shown_rates_deg_s(bench: VendorBench) -> FloatArray:
    rates = read(bench.functions, "GetAngularVelocity", structures.AngularPosition).Actuators
    return np.array(structures.actuator_values(rates, bench.chain.joint_count))


def pose(bench: VendorBench) -> FloatArray:
    x, y, z, *theta = structures.cartesian_values(
        read(bench.functions, "GetCartesianPosition", structures.CartesianPosition).Coordinates
    )
    return kinematics.transform(Rotation.from_euler("XYZ", theta).as_matrix(), (x, y, z))


def fingers(bench: VendorBench) -> tuple[float, float, float]:
    return structures.finger_values(read(bench.functions, "GetAngularPosition", structures.AngularPosition).Fingers)


def retract(bench: VendorBench) -> int:
    return read(bench.functions, "GetQuickStatus", structures.QuickStatus).RetractType


def fifo(bench: VendorBench) -> structures.TrajectoryFIFO:
    return read(bench.functions, "GetGlobalTrajectoryInfo", structures.TrajectoryFIFO)
