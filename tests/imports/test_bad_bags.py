"""Bags with something wrong: one line, nothing left, and not everything read before it is said."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.cli import main
from tests.imports.test_importing import MEMORY, inspected

MAP = '[[streams]]\ndevice = "ft"\nkind = "wrench"\ntopics = ["/ft"]\n'
OTHER = f'{MAP}[[streams]]\ndevice = "other"\nkind = "wrench"\ntopics = ["/other"]\n'
COUNT = 400


def write_bag(path: Path, stamp_s: Callable[[int], float], *, count: int = COUNT, **more: Any) -> Path:
    """Wrenches, recorded at 100 Hz. stamp_s: of each, its own; more: nan: at which message; other_s: by how much the
    stamps of a second sensor differ"""
    writers = pytest.importorskip("mcap_ros2.writer")
    pytest.importorskip("rosbags")
    from deformscope.recording.export.mcap import definition

    with path.open("wb") as file:
        writer = writers.Writer(file)
        kind = writer.register_msgdef("geometry_msgs/msg/WrenchStamped", definition("geometry_msgs/WrenchStamped"))
        thing = writer.register_msgdef("other_msgs/msg/Thing", "float64 mass")
        for at in range(count):
            force = {"x": float("nan") if at == more.get("nan") else 0.0, "y": 0.0, "z": float(np.sin(at / 30))}
            for topic, off_s in (("/ft", 0.0), ("/other", more.get("other_s", 0.0))):
                ns, log_ns = round((stamp_s(at) + off_s) * 1e9), 10**18 + at * 10**7
                header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": "ft"}
                wrench = {"force": force, "torque": dict.fromkeys("xyz", 0.0)}
                writer.write_message(topic, kind, {"header": header, "wrench": wrench}, log_ns, log_ns, at)
            writer.write_message("/thing", thing, {"mass": 1.0}, log_ns, log_ns, at)
        writer.finish()
    return path


def steady(at: int) -> float:
    return 1e9 + at / 100


def cut(path: Path) -> Path:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


CASES: dict[str, tuple[Callable[[Path], Path], str, str]] = {
    "back": (
        lambda path: write_bag(path, lambda at: steady(at) - 5.0 * (at > 300)),
        MAP,
        "stamps of ft that only rise; got one 4.99 s before the last, in frame 301",
    ),
    "ahead": (
        lambda path: write_bag(path, lambda at: steady(at) + 3600.0 * (at > 300)),
        MAP,
        "stamps of ft that only rise, as time does; got one 3600 s after 0.01 s, in frame 301",
    ),
    "unknown type": (lambda path: write_bag(path, steady), MAP.replace("/ft", "/thing"), "of ft in the map"),
    "nan": (lambda path: write_bag(path, steady, nan=200), MAP, "forces of ft that are numbers; got NaN in frame 200"),
    "cut": (lambda path: cut(write_bag(path, steady)), MAP, "a complete bag; got one that is truncated or damaged"),
    "clocks": (
        lambda path: write_bag(path, steady, other_s=3600.0, nan=5),
        OTHER,  # said at the first message, before the NaN
        "offset_s of other in the map: how its clock differs; got 'stamps 3600 s from those of ft'",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_wrong_with_a_bag_is_one_line(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    make, text, words = CASES[name]
    bag, map_file = make(tmp_path / "bag.mcap"), tmp_path / "map.toml"
    map_file.write_text(text)
    assert main(["import", str(bag), "--map", str(map_file), "--record", str(tmp_path / "r.rrd")]) == 2
    error = capfd.readouterr().err
    assert words in error
    assert len(error.strip().splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag.mcap", "map.toml"]


def test_a_clock_that_is_simulated_or_pauses_is_taken(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag.mcap", lambda at: 5.0 + at / 50 * (at < 200) + (at >= 200) * (4.0 + at / 1000))
    (tmp_path / "map.toml").write_text(OTHER)
    assert main(["import", str(bag), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "r.rrd")]) == 0


@pytest.mark.slow
def test_memory_does_not_grow_with_a_bag(tmp_path: Path) -> None:
    used = []
    for count in (5_000, 150_000):
        bag = write_bag(tmp_path / f"{count}.mcap", steady, count=count)
        (tmp_path / "map.toml").write_text(inspected(bag))
        asked = [str(bag), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / f"{count}.rrd")]
        done = subprocess.run([sys.executable, "-c", MEMORY, *asked], capture_output=True, text=True, check=True)
        used.append(float(done.stdout.split()[-1]))
    assert used[1] < used[0] + 60.0, used
