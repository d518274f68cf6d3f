"""Errors of devices cross processes: one that cannot be unpickled breaks a pool of workers."""

from __future__ import annotations

import pickle

import pytest

from deformscope_drivers.errors import CommandRefused, DeviceError, NotConnected


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
