"""Doubles on real transports leave nothing behind, however their process ends."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from deformscope_drivers.doubles import announced, announcements, running_doubles
from deformscope_drivers.errors import NotConnected
from deformscope_drivers.transport import SerialTransport
from deformscope_drivers.wires import PtyWire
from tests.cases import Patch
from tests.drivers.toy import ToyDouble

PROGRAM = """
import sys, time
from deformscope_drivers.wires import PtyWire
from tests.drivers.toy import ToyDouble
with PtyWire(ToyDouble()) as wire:
    print(wire.port, flush=True)
    sys.stdin.read()
"""


def test_a_double_that_is_killed_leaves_nothing(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "TMPDIR": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        port = process.stdout.readline().strip()
        transport = SerialTransport(port, 115_200)
        transport.open()
        assert transport.read(20.0)
        transport.close()
        process.kill()
        process.wait(20.0)
    assert not Path(port).exists()
    assert list(tmp_path.iterdir()) == []


def test_a_port_has_one_name_from_plugging_to_plugging() -> None:
    with PtyWire(ToyDouble()) as wire:
        port = wire.port
        transport = SerialTransport(port, 115_200)
        for _ in range(3):
            transport.open()
            assert transport.read(20.0)
            transport.close()
            wire.unplug()
            with pytest.raises(NotConnected, match="a port that is there; got none"):
                transport.open()
            wire.plug()
            assert wire.port == port


def test_announcements_in_a_folder_of_another_users_are_left_alone(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with announced("dsa", "/dev/x", "mine"):
        assert [double.name for double in running_doubles()] == ["mine"]
        own = os.getuid()
        monkeypatch.setattr("os.getuid", lambda: own)
        folder = announcements()
    monkeypatch.setattr("deformscope_drivers.doubles.announcements", lambda: folder)
    monkeypatch.setattr("os.getuid", lambda: own + 1)
    with announced("dsa", "/dev/x", "theirs"):
        assert running_doubles() == []
        assert list(folder.iterdir()) == []
