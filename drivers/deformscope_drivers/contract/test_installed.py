"""The contract of every installed driver that has a double: `pytest --pyargs deformscope_drivers.contract -k NAME`."""

import pytest

from deformscope_drivers.contract import kinds
from deformscope_drivers.contract.devices import DeviceContract
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS, DeviceDriver


def _doubled(name: str) -> bool:
    try:
        return DRIVERS[name].doubled
    except DeviceError:  # reported by the test below
        return False


def _of(kind: str) -> list[str]:
    return [name for name in DRIVERS if _doubled(name) and kind in ("", DRIVERS[name].kind)]


@pytest.mark.parametrize("name", DRIVERS)
def test_it_can_be_loaded(name: str) -> None:
    assert DRIVERS[name].name == name


class TestEveryDevice(DeviceContract):
    @pytest.fixture(params=_of(""))
    def driver(self, request: pytest.FixtureRequest) -> DeviceDriver:
        driver = DRIVERS[request.param]
        self.scene = kinds.CONTRACTS[driver.kind]().scene  # type: ignore[method-assign]
        return driver


class _Installed(kinds.KindContract):
    @pytest.fixture
    def driver(self, request: pytest.FixtureRequest) -> DeviceDriver:
        return DRIVERS[request.param]


@pytest.mark.parametrize("driver", _of("wrench"), indirect=True)
class TestForceSensors(_Installed, kinds.ForceContract):
    pass


@pytest.mark.parametrize("driver", _of("color"), indirect=True)
class TestColorCameras(_Installed, kinds.ColorContract):
    pass


@pytest.mark.parametrize("driver", _of("depth"), indirect=True)
class TestDepthCameras(_Installed, kinds.DepthContract):
    pass


@pytest.mark.parametrize("driver", _of("tactile"), indirect=True)
class TestTactileArrays(_Installed, kinds.TactileContract):
    pass


@pytest.mark.parametrize("driver", _of("hand"), indirect=True)
class TestHands(_Installed, kinds.HandContract):
    pass


@pytest.mark.parametrize("driver", _of("arm"), indirect=True)
class TestArms(_Installed, kinds.ArmContract):
    pass
