"""Errors of devices cross processes: one that cannot be unpickled breaks a pool of workers."""

import pickle

import pytest

from deformscope_drivers.errors import CommandRefused, DeviceError, NotConnected
from deformscope_drivers.jaco.errors import VENDOR_ERRORS, VendorError


@pytest.mark.parametrize(
    "error",
    [
        NotConnected("a controller that sends", "none in 30 s", "start its program", "udp 127.0.0.1:5"),
        CommandRefused(5, "busy", "homing"),
    ],
)
def test_an_error_of_another_process_has_its_kind_words_and_attributes(error: DeviceError) -> None:
    other = pickle.loads(pickle.dumps(error))
    assert type(other) is type(error)
    assert str(other) == str(error)
    assert vars(other) == vars(error)


@pytest.mark.parametrize("kind", VENDOR_ERRORS.values(), ids=lambda kind: kind.__name__)
def test_every_error_of_the_jacos_vendor_crosses_with_its_kind(kind: type[VendorError]) -> None:
    error = kind("SendBasicTrajectory", "joint 3")
    came = pickle.loads(pickle.dumps(error))
    assert type(came) is kind
    assert (str(came), came.vendor_code) == (str(error), kind.vendor_code)
