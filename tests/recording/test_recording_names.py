"""What a recording is called: no two runs at once to one name, links stay links, and a full disk is noticed first."""

import os
import shutil
import signal
import subprocess
import sys
from collections import namedtuple
from datetime import datetime
from pathlib import Path

import pytest

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.file_io import new_recording
from deformscope.frames import InputFile
from deformscope.recording.lateness import FREE_BYTES, RecordingError
from deformscope.recording.ledger import check_recording
from deformscope.recording.lock import is_being_written
from deformscope.recording.recorder import Recorder
from tests.cases import Capture, Patch

USAGE = namedtuple("USAGE", "total used free")


@pytest.mark.parametrize("overwrite", [False, True])
def test_two_runs_at_once_to_one_name(tmp_path: Path, overwrite: bool) -> None:
    path = tmp_path / "run.rrd"
    with Recorder(path, overwrite=overwrite) as first:
        first.write(InputFile("a", b"1"))
        assert is_being_written(tmp_path / "run.part.rrd")
        with (
            pytest.raises(InputError, match=r"another run is recording to \(run.part.rrd\)"),
            Recorder(path, overwrite=overwrite),
        ):
            pytest.fail("the second one began")
        with Recorder(tmp_path / "other.rrd") as other:
            other.write(InputFile("a", b"2"))
    assert sorted(left.name for left in tmp_path.glob("*.rrd")) == ["other.rrd", "run.rrd"]
    assert check_recording(path).problems == []
    assert not is_being_written(path)
    with Recorder(path, overwrite=True) as again:
        again.write(InputFile("a", b"3"))
    assert check_recording(path).problems == []


def test_names_that_are_made_within_a_second_differ(tmp_path: Path, monkeypatch: Patch) -> None:
    """Also before there is a file, as of a page where two buttons are pressed, and while another run records."""
    monkeypatch.setattr("deformscope.file_io.datetime", Frozen)
    names = [new_recording(tmp_path, "rig") for _ in range(2)]
    (tmp_path / "rig-20260102-030405-3.part.rrd").touch()
    names.append(new_recording(tmp_path, "rig"))
    assert [path.name for path in names] == [f"rig-20260102-030405{end}.rrd" for end in ("", "-2", "-4")]


class Frozen:
    @staticmethod
    def now() -> datetime:
        return datetime(2026, 1, 2, 3, 4, 5)


def test_the_lock_of_a_run_that_was_killed_is_gone(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    code = (
        "import sys; from pathlib import Path; from deformscope.recording.recorder import Recorder\n"
        "from deformscope.frames import InputFile\n"
        "r = Recorder(Path(sys.argv[1])).__enter__(); r.write(InputFile('a', b'1')); print('on', flush=True); input()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    with process:
        assert process.stdout.readline() == b"on\n"
        part = tmp_path / "run.part.rrd"
        assert is_being_written(part)
        with pytest.raises(InputError, match="another run"), Recorder(path):
            pass
        process.send_signal(signal.SIGKILL)
        process.wait()
    with Recorder(path) as made:
        made.write(InputFile("a", b"2"))
    assert check_recording(path).problems == []
    assert part.exists(), "what the killed run had recorded is not touched"


@pytest.mark.parametrize("dangling", [False, True])
def test_a_link_stays_a_link_to_the_new_recording(tmp_path: Path, dangling: bool) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    link, target = tmp_path / "run.rrd", disk / "true.rrd"
    link.symlink_to(target)
    if not dangling:
        target.write_bytes(b"old")
    with Recorder(link, overwrite=not dangling) as made:
        made.write(InputFile("a", b"1"))
    assert link.is_symlink()
    assert made.summary().path == target
    assert check_recording(link).problems == check_recording(target).problems == []
    assert sorted(left.name for left in tmp_path.iterdir()) == ["disk", "run.rrd"]


def test_a_link_to_nowhere_is_refused(tmp_path: Path, capsys: Capture) -> None:
    gone, loop = tmp_path / "gone.rrd", tmp_path / "loop.rrd"
    gone.symlink_to(tmp_path / "no folder" / "run.rrd")
    loop.symlink_to(loop)
    for link, said in ((gone, "a folder to record into"), (loop, "one that leads to itself")):
        with pytest.raises(InputError, match=said), Recorder(link):
            pass
        assert main(["record", "lab:bench", "--record", str(link)]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
        assert link.is_symlink()


def test_a_disk_that_is_too_small_at_the_start_keeps_nothing_and_says_so(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda where: USAGE(FREE_BYTES, 0, FREE_BYTES - 1))
    with pytest.raises(RecordingError, match="64 MiB free on the disk; got 63 MiB free") as told:
        Recorder(tmp_path / "run.rrd").__enter__()
    assert "kept" not in str(told.value)
    assert not list(tmp_path.iterdir())


def test_a_disk_that_fills_before_anything_was_recorded_keeps_nothing_and_says_so(
    tmp_path: Path, monkeypatch: Patch
) -> None:
    with pytest.raises(RecordingError, match="free on the disk") as told, Recorder(tmp_path / "run.rrd"):
        monkeypatch.setattr(shutil, "disk_usage", lambda where: USAGE(FREE_BYTES, 0, 0))
    assert "kept" not in str(told.value)
    assert not list(tmp_path.iterdir())
