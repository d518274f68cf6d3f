"""All three kinds of arm keep the contract of an arm."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from deformscope_drivers.arm import Arm, MotionStopped
from deformscope_drivers.errors import OutOfLimits
from deformscope_drivers.jaco import Jaco, JacoConfig, JacoDouble
from deformscope_drivers.jaco.chains import CHAINS as JACO
from deformscope_drivers.kuka import Kuka, KukaConfig, KukaDouble
from deformscope_drivers.manual_arm import ManualArm, ManualArmConfig
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from tests.drivers.arm.contract import ArmBench, ArmContract
from tests.drivers.contract import Bench, DeviceContract

START = ManualArmConfig(start_m=(0.3, 0.2, 0.3))


def polled(arm: Arm[Any], clock: SimulatedClock) -> Callable[[float], None]:
    """Lets time pass, the arm looking after itself every millisecond while it is open."""

    def advance(seconds: float) -> None:
        until_ns = clock() + round(seconds * 1e9)
        while clock() < until_ns:
            clock.advance_to(min(clock() + 1_000_000, until_ns))
            if arm.is_open:
                arm.poll(0.0)

    return advance


class TestJaco(ArmContract):
    @pytest.fixture(params=sorted(JACO))
    def bench(self, request: pytest.FixtureRequest) -> ArmBench:
        clock = SimulatedClock(1_000_000_000)
        double = JacoDouble(request.param, clock)
        arm = Jaco(JacoConfig(), double, clock=clock)
        return ArmBench(arm, polled(arm, clock), lambda: double.T_base_end_effector)


class TestKuka(ArmContract):
    @pytest.fixture(params=[0.012, 0.004])
    def bench(self, request: pytest.FixtureRequest) -> ArmBench:
        clock = SimulatedClock(1_000_000_000)
        double = KukaDouble(cycle_s=request.param)
        arm = Kuka(KukaConfig(cycle_s=request.param), MemoryTransport(double, clock), clock=clock)
        return ArmBench(arm, polled(arm, clock), lambda: double.T_base_end_effector)


class TestPlaced(ArmContract):
    @pytest.fixture
    def bench(self) -> ArmBench:
        clock = SimulatedClock(1_000_000_000)
        arm = ManualArm(START, clock=clock)
        return ArmBench(arm, polled(arm, clock), lambda: arm.T_base_end_effector)

    def test_it_is_where_it_was_placed(self, bench: ArmBench, arm: ManualArm) -> None:
        pose = arm.T_base_end_effector
        pose[:3, 3] = 0.1, 0.2, 0.15
        arm.place(pose)
        (*_, state) = self.states(bench, 0.1)
        np.testing.assert_allclose(state.T_base_end_effector, pose, atol=1e-12)
        assert state.joints_deg == ()

    def test_it_is_not_placed_where_nothing_can_be(self, bench: ArmBench, arm: ManualArm) -> None:
        for wrong in (np.full((4, 4), np.nan), np.diag([1.0, 2.0, 1.0, 1.0]), np.eye(3)):
            with pytest.raises(OutOfLimits):
                arm.place(wrong)
        arm.halt("enough")
        with pytest.raises(MotionStopped):
            arm.place(arm.T_base_end_effector)


class TestPlacedAsADevice(DeviceContract):
    @pytest.fixture
    def bench(self) -> Bench:
        return Bench(ManualArm(START))
