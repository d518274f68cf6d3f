"""What every device owes its users, and what only a machine that is not busy shows."""

import time
from typing import Any

import pytest

from deformscope_drivers.contract import devices
from deformscope_drivers.contract.devices import PATIENCE_S as PATIENCE_S
from deformscope_drivers.contract.devices import Bench as Bench
from deformscope_drivers.contract.devices import nothing_left_since as nothing_left_since
from deformscope_drivers.contract.devices import open_things as open_things
from deformscope_drivers.contract.devices import wait_until as wait_until
from deformscope_drivers.device import Device


class DeviceContract(devices.DeviceContract):
    @pytest.mark.realtime
    def test_a_cable_pulled_out_is_reported_in_time(self, bench: Bench, device: Device[Any]) -> None:
        if bench.unplug is None:
            pytest.skip("this cable cannot be pulled from here")
        events = device.events()
        device.next(PATIENCE_S)
        pulled_ns = time.monotonic_ns()
        bench.unplug()
        assert events.get(PATIENCE_S).host_ns - pulled_ns < bench.told_within_s * 1e9
