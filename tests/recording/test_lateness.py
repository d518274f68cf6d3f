"""A recording that falls behind says what it waited for, and claims to be kept only where it can be recovered."""

# ruff: noqa: PT012 (what raises is the recording's end, not one statement in it)

import fcntl
import os
import shutil
import threading
import time
from pathlib import Path
from typing import Any

import pytest
import rerun as rr

from deformscope.cli import main
from deformscope.frames import ColorFrame, DepthFrame, Item
from deformscope.log import rig as rig_log
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording import recorder
from deformscope.recording.lateness import FREE_BYTES, RecordingError, writes_are_held_up
from deformscope.recording.recent import WatchedRecorder
from deformscope.recording.recorder import Recorder
from tests.cases import Patch
from tests.log import synthetic_rig as rig
from tests.patience import PATIENCE_S
from tests.recording.test_recorder import wait_for_looks

Gate = threading.Event


@pytest.fixture
def items(monkeypatch: Patch) -> list[Item]:
    """More than may wait."""
    monkeypatch.setattr(recorder, "BACKLOG_BYTES", 300_000)
    return [one for one in rig.items(1.0, (24, 32)) if not isinstance(one, ColorFrame | DepthFrame)]


def recording(path: Path) -> Recorder:
    return Recorder(path, "none", {}, application=RIG, real_time=True)


def fall_behind(made: Recorder | WatchedRecorder, items: list[Item]) -> None:
    """Write until it raises: on a fast machine, once through gives a few large portions that fill little."""
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        for batch in rig.batches(items):
            made.write(batch)
            time.sleep(0.001)


class HeldUpDisk:
    """Takes the first 4 KiB and no more, until it is gone: the system has whoever writes wait, as with a slow disk."""

    def __init__(self, pipe: Path) -> None:
        os.mkfifo(pipe)
        self._reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
        fcntl.fcntl(self._reader, fcntl.F_SETPIPE_SZ, 4096)
        self._sink, self._pipe = rr.FileSink, pipe

    def sink(self, path: Path, **options: Any) -> Any:
        return self._sink(self._pipe if path.name.endswith(".part.rrd") else path, **options)

    def leave(self) -> None:
        os.close(self._reader)


@pytest.fixture
def held_up(tmp_path_factory: pytest.TempPathFactory, monkeypatch: Patch) -> HeldUpDisk:
    disk = HeldUpDisk(tmp_path_factory.mktemp("disk") / "pipe")
    monkeypatch.setattr(rr, "FileSink", disk.sink)
    monkeypatch.setattr("deformscope.recording.rrd_file.RecordingFile.flush", lambda file: None)  # it would wait
    return disk


def wait_for(gate: Gate) -> None:
    assert gate.wait(PATIENCE_S)


def wait_until_held_up() -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not writes_are_held_up():
        assert time.monotonic() < until_s
        time.sleep(0.01)


def test_a_disk_that_is_too_slow_is_named(tmp_path: Path, items: list[Item], held_up: HeldUpDisk) -> None:
    said = pytest.raises(RecordingError, match=r"a disk that keeps up; got one that held the writing up")
    with said as told, recording(tmp_path / "run.rrd") as made:
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        made.write(next(rig.batches(items)))
        wait_until_held_up()
        gate = Gate()
        made._put(lambda: wait_for(gate), 0)  # what is small would not fill what rerun holds
        try:
            fall_behind(made, items)
        finally:
            held_up.leave()
            gate.set()
    assert "another disk" in str(told.value)
    assert not (tmp_path / "run.rrd").exists()


def busy_processor(monkeypatch: Patch) -> tuple[Gate, Gate]:
    """Encoding does not get on: (that it has begun, until this)."""
    prepare, begun, free = rig_log.prepare_items, Gate(), Gate()

    def slow(*given: Any) -> Any:
        begun.set()
        free.wait(PATIENCE_S)
        return prepare(*given)

    monkeypatch.setattr(rig_log, "prepare_items", slow)
    return begun, free


@pytest.mark.slow
def test_a_processor_that_is_too_slow_is_named_and_what_there_is_is_ended(
    tmp_path: Path, items: list[Item], monkeypatch: Patch, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.part.rrd"
    said = pytest.raises(RecordingError, match=r"a processor that keeps up .*% of a core .*try: end other programs")
    with said as told, recording(tmp_path / "run.rrd") as made:
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        made.write(next(rig.batches(items)))
        wait_for_looks(made)
        _, free = busy_processor(monkeypatch)
        try:
            fall_behind(made, items)
        finally:
            free.set()
    assert "disk" not in str(told.value).split("try:")[1]
    assert f"are stored: deformscope recover {path}" in caplog.text
    assert main(["recover", str(path)]) == 0


def test_a_full_disk_is_named_whatever_waits(tmp_path: Path, items: list[Item], monkeypatch: Patch) -> None:
    usage = shutil.disk_usage(tmp_path)
    with (
        pytest.raises(RecordingError, match="64 MiB free on the disk; got 0 MiB free"),
        recording(tmp_path / "run.rrd") as made,
    ):
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        _, free = busy_processor(monkeypatch)
        monkeypatch.setattr(shutil, "disk_usage", lambda where: usage._replace(free=FREE_BYTES // 100))
        try:
            fall_behind(made, items)
        finally:
            free.set()


@pytest.mark.slow
def test_what_cannot_be_read_is_not_called_kept(
    tmp_path: Path, items: list[Item], monkeypatch: Patch, caplog: pytest.LogCaptureFixture
) -> None:
    """Everything was handed over, and nothing of it had come to the disk."""
    with pytest.raises(RecordingError), recording(tmp_path / "run.rrd") as made:
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        _, free = busy_processor(monkeypatch)
        try:
            fall_behind(made, items)
        finally:
            free.set()
        monkeypatch.setattr("deformscope.recording.recorder.Recorder._write_last", lambda made: None)
    part = tmp_path / "run.part.rrd"
    recovered = main(["recover", str(part)]) == 0
    assert ("are stored" in caplog.text) == recovered
    assert ("no data recorded before the error" in caplog.text) == (not recovered)


def test_the_view_goes_on_where_its_file_cannot(
    tmp_path: Path, items: list[Item], monkeypatch: Patch, caplog: pytest.LogCaptureFixture
) -> None:
    watched: list[object] = []
    watch, kept = Recorder(None), recording(tmp_path / "run.rrd")
    monkeypatch.setattr(watch, "write", watched.append)
    batches = list(rig.batches(items))
    with pytest.raises(RecordingError, match="a processor"), WatchedRecorder(watch, kept) as made:
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        made.write(batches[0])
        wait_for_looks(kept)
        _, free = busy_processor(monkeypatch)
        times, until_s = 0, time.monotonic() + PATIENCE_S
        try:
            while "the view continues" not in caplog.text and time.monotonic() < until_s:
                times += 1
                for batch in batches:
                    made.write(batch)  # raises nothing
                    time.sleep(0.001)
        finally:
            free.set()
        assert "the view continues: expected a processor" in caplog.text
    assert watched == [batches[0], *(times * batches)]
    assert kept.summary().path == tmp_path / "run.part.rrd"
    assert made.summary().frames < times * len(items)
