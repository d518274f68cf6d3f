"""Both doubles of the vendor's library pass the same contract, and agree with each other."""

import time

import numpy as np
import pytest

from deformscope_drivers.arm.device import CartesianVelocity, JointVelocity
from deformscope_drivers.jaco import errors
from deformscope_drivers.jaco.chains import CHAINS, J2N6S300
from deformscope_drivers.jaco.double import JacoDouble
from deformscope_drivers.jaco.library import Connection, call, devices, read
from deformscope_drivers.jaco.structures import AngularPosition, TrajectoryPoint, velocity_point
from tests.drivers.jaco.benches import CBench, PythonBench, VendorBench
from tests.drivers.jaco.vendor_contract import VendorContract, joints, pose, stream
from tests.patience import PATIENCE_S

MODELS = sorted(CHAINS)


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> str:
    return str(request.param)


class TestPythonDouble(VendorContract):
    @pytest.fixture
    def bench(self, model: str) -> VendorBench:
        return PythonBench(model)

    @pytest.fixture
    def cold(self, model: str) -> VendorBench:
        return PythonBench(model, cold=True)


class TestCDouble(VendorContract):
    connection: Connection = "usb"

    @pytest.fixture
    def bench(self, model: str) -> VendorBench:
        return CBench(model, self.connection)

    @pytest.fixture
    def cold(self, model: str) -> VendorBench:
        return CBench(model, self.connection, cold=True)


class TestCDoubleWithEthernetPrefix(TestCDouble):
    connection: Connection = "ethernet"

    @pytest.fixture
    def model(self) -> str:
        return "j2n6s300"  # the prefix is what differs


def test_both_doubles_agree_over_a_mixed_motion(model: str) -> None:
    """Two programs of the same published geometry, one in Python, one in C."""
    benches: list[VendorBench] = [PythonBench(model), CBench(model)]
    for bench in benches:
        call(bench.functions, "InitAPI")
        call(bench.functions, "StartControlAPI")
        stream(bench, CartesianVelocity((0.03, 0.02, -0.04), (0.1, 0.0, 0.2)), 1.0)
        stream(bench, CartesianVelocity((-0.02, 0.05, 0.01)), 0.5)
        stream(bench, JointVelocity((10.0, -8.0, 12.0, 5.0, 6.0, 25.0, 5.0)[: bench.chain.joint_count]), 1.0)
        # away from singularities, near which one of the two damps its pseudo-inverse
        assert np.linalg.svd(bench.chain.jacobian(joints(bench)))[1][-1] > 0.03
    python, c = benches
    np.testing.assert_allclose(joints(python), joints(c), atol=1e-3)
    np.testing.assert_allclose(pose(python), pose(c), atol=1e-5)


def test_in_real_time_the_c_double_turns_by_its_angle() -> None:
    bench = CBench("j2n6s300")
    bench.real_time(True)
    call(bench.functions, "InitAPI")
    call(bench.functions, "StartControlAPI")
    before = joints(bench)
    for _ in range(20):
        stream(bench, JointVelocity((30.0, 0, 0, 0, 0, 0)), 0.01)
    deadline = time.monotonic() + PATIENCE_S
    while joints(bench)[0] - before[0] < 6.0 - 1e-3 and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.03)
    assert joints(bench)[0] - before[0] == pytest.approx(6.0, abs=1e-3)


@pytest.fixture
def bench() -> PythonBench:
    made = PythonBench("j2n6s300")
    call(made.functions, "InitAPI")
    call(made.functions, "StartControlAPI")
    return made


@pytest.mark.parametrize("code", sorted(errors.VENDOR_ERRORS))
def test_every_vendor_code_becomes_its_exception(code: int, bench: PythonBench) -> None:
    """One double is enough: the contract has a code of each."""
    for name in ("EraseAllTrajectories", "GetDevices"):
        bench.inject(name, code)
    with pytest.raises(errors.VENDOR_ERRORS[code]) as caught:
        call(bench.functions, "EraseAllTrajectories")
    assert caught.value.code == code
    with pytest.raises(errors.VENDOR_ERRORS[code]):
        devices(bench.functions)


def test_an_arm_at_rest_costs_nothing_however_long_it_rests(bench: PythonBench) -> None:
    bench.advance(1e6)
    assert bench.double.fifo_count == 0


def test_a_pulled_cable_times_out_and_the_arm_goes_on(bench: PythonBench) -> None:
    before = joints(bench)
    for _ in range(50):
        stream(bench, JointVelocity((20.0, 0, 0, 0, 0, 0)), 0.01)
    for _ in range(10):
        call(bench.functions, "SendBasicTrajectory", _velocity(20.0))
    bench.double.unplug()
    with pytest.raises(errors.CommunicationTimeout):
        joints(bench)
    with pytest.raises(errors.NoDeviceFound):
        call(bench.functions, "InitAPI")
    bench.advance(1.0)
    assert bench.double.joints_deg[0] - before[0] == pytest.approx(0.6 * 20.0, abs=1e-3)
    bench.double.plug()
    call(bench.functions, "InitAPI")
    joints(bench)


def test_torques_hold_the_arm_up(bench: PythonBench) -> None:
    torques = read(bench.functions, "GetAngularForce", AngularPosition).Actuators
    expected = J2N6S300.gravity_torque_nm(J2N6S300.forward(J2N6S300.home_deg))
    np.testing.assert_allclose([torques.Actuator2, torques.Actuator3], expected[1:3], atol=1e-4)
    assert abs(torques.Actuator1) < 1e-6


def test_power_lost_and_back_leaves_a_cold_arm_with_nothing_to_do(bench: PythonBench) -> None:
    for _ in range(50):
        call(bench.functions, "SendBasicTrajectory", _velocity(20.0))
    bench.double.power_up()
    before = bench.double.joints_deg
    bench.advance(1.0)
    np.testing.assert_array_equal(bench.double.joints_deg, before)
    assert bench.double.fifo_count == 0


def test_two_runs_on_simulated_clocks_are_the_same_to_the_last_bit() -> None:
    ends = []
    for _ in range(2):
        made = PythonBench("j2s7s300")
        call(made.functions, "InitAPI")
        call(made.functions, "StartControlAPI")
        stream(made, CartesianVelocity((0.03, -0.02, 0.01), (0.1, 0.2, 0.3)), 2.0)
        ends.append(made.double.joints_deg.tobytes())
    assert ends[0] == ends[1]


def test_several_arms_are_listed_by_their_serial_numbers() -> None:
    double = JacoDouble(serials=("A", "B"))
    call(double, "InitAPI")
    assert [device.SerialNumber for device in devices(double)] == [b"A", b"B"]


def _velocity(rate_deg_s: float) -> TrajectoryPoint:
    return velocity_point(JointVelocity((rate_deg_s, 0, 0, 0, 0, 0)))
