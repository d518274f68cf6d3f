"""What `calibrate axes`, `yield` and `viscous` take from a recording of a rig: the force beside the images."""

from pathlib import Path

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.frames import Stream, WrenchFrame
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.runs.force_log import kept_force, recorded_force
from deformscope_drivers.clock import Stamp

START_NS = 5_000_000_000


def reading(index: int, device: str) -> WrenchFrame:
    """A sensor that reads (0.3, 0, -0.2) in free air, and 2 N more along z from 0.4 to 0.7 s."""
    pressed = 40 <= index < 70
    force_n = np.array([[0.3, 0.0, -0.2 - 2.0 * pressed]])
    return WrenchFrame(Stamp(START_NS + index * 10_000_000), index, np.zeros(3, dtype=np.int64), force_n, device=device)


def recorded(path: Path, *devices: str) -> Path:
    with Recorder(path, "none", {}, application=RIG) as recorder:
        recorder.start(RigLayout(tuple(Stream(device, "wrench", "optoforce") for device in devices)), START_NS)
        recorder.write([reading(index, device) for index in range(100) for device in devices])
    return path


def test_the_force_of_a_recording_is_that_without_the_sensors_zero(tmp_path: Path) -> None:
    path = recorded(tmp_path / "rig.rrd", "tip")
    force = recorded_force(path, None, START_NS + 100_000_000)
    assert force.time_s[[0, -1]] == pytest.approx([-0.1, 0.89])  # on the clock of the first image
    assert force.at(np.array([0.0, 0.45, 0.8])) == pytest.approx([0.0, 2.0, 0.0])
    assert force.off_n() == pytest.approx(0.1)
    assert kept_force(Replay(path)) is None
    with pytest.raises(InputError, match="a force sensor 'other'"):
        recorded_force(path, "other", START_NS)


def test_of_several_force_sensors_one_is_named(tmp_path: Path) -> None:
    path = recorded(tmp_path / "rig.rrd", "palm", "tip")
    with pytest.raises(InputError, match=r"one force sensor.*--force"):
        recorded_force(path, None, START_NS)
    assert recorded_force(path, "tip", START_NS) is not None
