"""Universal Robots: the driver against its double, in memory on a simulated clock, and behind sockets."""

import pytest
from deformscope_ur import DRIVER, MemoryPorts, Ur, UrConfig, UrDouble

from deformscope_drivers.contract import ArmContract as ArmDeviceContract
from deformscope_drivers.contract import DeviceContract
from deformscope_drivers.interface import DeviceDriver
from deformscope_drivers.memory import SimulatedClock
from tests.drivers.arm.contract import ArmBench, ArmContract
from tests.drivers.arm.test_contract import polled


class TestUr(DeviceContract, ArmDeviceContract):
    @pytest.fixture
    def driver(self) -> DeviceDriver:
        return DRIVER


class TestUrMoves(ArmContract):
    @pytest.fixture(params=["ur5e", "ur3", "ur10"])
    def bench(self, request: pytest.FixtureRequest) -> ArmBench:
        clock = SimulatedClock(1_000_000_000)
        config = UrConfig(model=request.param, own_process=False)
        double = UrDouble(config)
        arm = Ur(config, MemoryPorts(double, clock), clock=clock)
        return ArmBench(arm, polled(arm, clock), lambda: double.T_base_end_effector)
