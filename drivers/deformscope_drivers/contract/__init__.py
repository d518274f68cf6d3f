"""Tests for any driver. They need pytest: `pip install deformscope[contract]`.

`pytest --pyargs deformscope_drivers.contract -k NAME` runs them on an installed driver and its double. A package has
them among its own tests:

    class TestMysensor(DeviceContract, ForceContract):
        @pytest.fixture
        def driver(self):
            return DRIVER
"""

import pytest

for _name in ("devices", "kinds"):
    pytest.register_assert_rewrite(f"deformscope_drivers.contract.{_name}")

from deformscope_drivers.contract.devices import Bench as Bench  # noqa: E402
from deformscope_drivers.contract.devices import DeviceContract as DeviceContract  # noqa: E402
from deformscope_drivers.contract.kinds import CONTRACTS as CONTRACTS  # noqa: E402
from deformscope_drivers.contract.kinds import ArmContract as ArmContract  # noqa: E402
from deformscope_drivers.contract.kinds import ColorContract as ColorContract  # noqa: E402
from deformscope_drivers.contract.kinds import DepthContract as DepthContract  # noqa: E402
from deformscope_drivers.contract.kinds import ForceContract as ForceContract  # noqa: E402
from deformscope_drivers.contract.kinds import HandContract as HandContract  # noqa: E402
from deformscope_drivers.contract.kinds import TactileContract as TactileContract  # noqa: E402
