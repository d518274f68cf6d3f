"""`verify` and `recover`: what is said of whole, unchecked, unfinished, cut-off and damaged recordings."""

import json
import shutil
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.frames import ColorFrame, InputFile, Stream
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording import facts as recording_facts
from deformscope.recording.ledger import LedgerWriter, check_recording, ledger_path, read_ledger, write_ledger
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.runs import verification
from deformscope.runs.recovery import recover_recording
from deformscope_drivers.clock import Stamp
from tests.cases import Capture, Patch
from tests.patience import PATIENCE_S
from tests.verified import verify_here

FRAMES = 12


def frames() -> Iterator[ColorFrame]:
    for index in range(FRAMES):
        image = np.random.default_rng(index).integers(0, 255, (32, 48), np.uint8)
        yield ColorFrame(Stamp(index * 100_000_000), index, image)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording, and what its file was when the run would have been killed."""
    folder = tmp_path_factory.mktemp("made")
    whole, killed = folder / "run.rrd", folder / "killed.part.rrd"
    with Recorder(whole, settings={"seed": 1}) as recorder:
        for frame in frames():
            recorder.write(frame)
            recorder._put(recorder._outputs.file.flush, 0)  # so that each is a message of its own
        written = threading.Event()
        recorder._put(written.set, 0)
        assert written.wait(PATIENCE_S)
        shutil.copy(folder / "run.part.rrd", killed)
    return whole, killed


@pytest.fixture
def whole(made: tuple[Path, Path], tmp_path: Path) -> Path:
    shutil.copy(ledger_path(made[0]), ledger_path(tmp_path / "run.rrd"))
    return Path(shutil.copy(made[0], tmp_path / "run.rrd"))


@pytest.fixture
def killed(made: tuple[Path, Path], tmp_path: Path) -> Path:
    return Path(shutil.copy(made[1], tmp_path / "run.part.rrd"))


def verified(
    path: Path, capsys: Capture, command: Callable[..., int] = verify_here
) -> tuple[int, dict[str, object], str]:
    """(exit status, JSON, what was said on stderr without the table)"""
    status = command(path, "--json", "-")
    said = capsys.readouterr()
    return status, json.loads(said.out), said.err


def in_another_process(path: Path, *flags: str) -> int:
    """As a user has it: damaged bytes may end the reader."""
    return main(["verify", str(path), *flags])


def test_a_whole_recording(whole: Path, capsys: Capture) -> None:
    status, found, _ = verified(whole, capsys, in_another_process)
    assert (status, found["ok"], found["checked"], found["finished"]) == (0, True, True, True)


def test_without_a_ledger_nothing_is_called_checked(whole: Path, capsys: Capture) -> None:
    ledger_path(whole).unlink()
    status, found, said = verified(whole, capsys)
    assert (status, found["ok"], found["checked"], found["problems"]) == (3, None, False, [])
    assert "it has no ledger: changed bytes cannot be detected" in said


def test_what_is_wrong_with_the_structure_names_no_folder(whole: Path, capsys: Capture, monkeypatch: Patch) -> None:
    """`recover` puts it into a ledger that goes to others."""
    monkeypatch.setattr(
        verification,
        "run_rrd",
        lambda *words: f'"{words[-1]}": ' + ("no footer" if len(words) == 2 else f"{words[-1]} has a bad chunk"),
    )
    status, found, _ = verified(whole, capsys)
    assert status == 2
    assert found["problems"] == ["it has a bad chunk"]


@pytest.mark.parametrize(("content", "came"), [(b"of another kind", "a file of another kind"), (b"", "an empty file")])
def test_a_foreign_file_is_refused_without_the_advice_to_recover_it(
    tmp_path: Path, capsys: Capture, content: bytes, came: str
) -> None:
    (tmp_path / "r.rrd").write_bytes(content)
    assert main(["verify", str(tmp_path / "r.rrd")]) == 2
    said = capsys.readouterr().err
    assert f"expected a recording (.rrd); got {came}" in said
    assert "recover" not in said


def test_an_unfinished_recording_is_no_damage_and_recover_makes_it_whole(killed: Path, capsys: Capture) -> None:
    before = killed.read_bytes()
    status, found, said = verified(killed, capsys)
    assert (status, found["ok"], found["finished"], found["problems"]) == (2, False, False, [])
    assert "one of an interrupted run; everything until 1.1 s is there" in said
    assert f"deformscope recover {killed}" in said
    assert "Verification failed" not in said
    assert main(["recover", str(killed), "--json", "-"]) == 0
    recovered = json.loads(capsys.readouterr().out)
    out = killed.with_name("run.recovered.rrd")
    assert recovered["recovered"] == str(out)
    assert recovered["until_s"] == pytest.approx(1.1)
    assert recovered["counts"]["frames"] == FRAMES
    assert killed.read_bytes() == before
    assert check_recording(out).problems == []
    assert [frame.image.tolist() for frame in Replay(out).frames()] == [frame.image.tolist() for frame in frames()]
    assert Replay(out).settings == {"seed": 1}
    assert sorted(left.name for left in killed.parent.iterdir()) == [
        *("run.part.rrd", "run.recovered.rrd", "run.recovered.rrd.ledger")
    ]
    status, found, said = verified(out, capsys)
    assert (status, found["ok"], found["finished"]) == (3, True, True)
    assert "recovered until 1.1 s: later data are lost" in said


@pytest.mark.slow
def test_a_file_cut_within_a_message_gives_what_came_before(killed: Path, capsys: Capture) -> None:
    cut = killed.with_name("cut.rrd")
    cut.write_bytes(killed.read_bytes()[: round(0.7 * killed.stat().st_size)])
    status, found, said = verified(cut, capsys)
    assert (status, found["finished"]) == (2, False)
    assert f"deformscope recover {cut}" in said
    out = killed.with_name("saved.rrd")
    assert main(["recover", str(cut), "--out", str(out), "--json", "-"]) == 0
    recovered = json.loads(capsys.readouterr().out)
    kept = [frame.image.tolist() for frame in Replay(out).frames()]
    assert 0 < len(kept) == recovered["counts"]["frames"] < FRAMES
    assert kept == [frame.image.tolist() for frame in frames()][: len(kept)]


@pytest.mark.slow
def test_a_cut_recording_is_compared_with_its_ledger(killed: Path, capsys: Capture) -> None:
    write_ledger(killed, {"frames": FRAMES})
    killed.write_bytes(killed.read_bytes()[: round(0.7 * killed.stat().st_size)])
    assert verified(killed, capsys)[0] == 2
    assert main(["recover", str(killed), "--json", "-"]) == 3
    recovered = json.loads(capsys.readouterr().out)
    assert recovered["problems"][0].startswith("truncated: ")
    assert recovered["missing"]["frames"] == FRAMES - recovered["counts"]["frames"] > 0


@pytest.mark.slow
def test_recover_refuses_what_it_cannot_or_need_not_mend(
    whole: Path, killed: Path, tmp_path: Path, capsys: Capture
) -> None:
    text, noise = tmp_path / "text.rrd", tmp_path / "noise.rrd"
    text.write_text("no recording")
    noise.write_bytes(killed.read_bytes()[:16] + np.random.default_rng(0).bytes(5000))
    with Recorder(tmp_path / "now.rrd") as recorder:
        recorder.write(InputFile("a", b"1"))
        refused = {
            text: "a file of another kind",
            noise: "with readable parts",
            whole: "a finished one",
            tmp_path / "now.part.rrd": "one that a run is writing",
            tmp_path / "none.rrd": "nothing there",
            tmp_path: "a folder",
        }
        for path, said in refused.items():
            assert main(["recover", str(path), "--out", str(tmp_path / "out.rrd")]) == 2, path
            (line,) = capsys.readouterr().err.splitlines()
            assert said in line
        assert main(["verify", str(tmp_path / "now.part.rrd")]) == 2
        assert "one that a run is writing" in capsys.readouterr().err
    assert main(["recover", str(killed), "--out", str(whole)]) == 2
    assert "one that exists" in capsys.readouterr().err
    assert not (tmp_path / "out.rrd").exists()
    assert not list(tmp_path.glob(".*"))


def test_recover_refuses_a_folder_that_is_not_there(killed: Path, tmp_path: Path) -> None:
    """The command line's own check comes first; a script meets this one."""
    with pytest.raises(InputError, match=r"no such folder \| try: make it first"):
        recover_recording(killed, tmp_path / "none" / "out.rrd")
    assert not (tmp_path / "none").exists()


def test_bytes_that_end_the_reader_are_one_line(whole: Path, capsys: Capture, monkeypatch: Patch) -> None:
    ledger_path(whole).unlink()
    aborted = subprocess.CompletedProcess([], -signal.SIGABRT, "", "")
    monkeypatch.setattr(recording_facts.subprocess, "run", lambda *args, **options: aborted)
    status, found, said = verified(whole, capsys, in_another_process)
    assert (status, found["ok"]) == (2, False)
    assert "its bytes end rerun's reader (SIGABRT)" in said.splitlines()[-1]


def test_a_flip_is_placed_by_stream_and_seconds(whole: Path, capsys: Capture) -> None:
    block = max((one for one in read_ledger(whole).blocks if one.to_s), key=lambda one: one.end - one.start)
    content = bytearray(whole.read_bytes())
    content[(block.start + block.end) // 2] ^= 1
    whole.write_bytes(content)
    status, found, said = verified(whole, capsys)
    assert (status, found["truncated"]) == (2, False)
    (damaged,) = cast("list[dict[str, object]]", found["damaged"])
    assert damaged["streams"] == list(block.streams)
    assert (damaged["from_s"], damaged["to_s"]) == (0.0, pytest.approx(0.1 * (FRAMES - 1)))
    assert f"({block.streams[0]}, 0.000 to 1.100 s) differ from what was recorded" in said


def test_truncated_is_told_from_damaged_and_from_a_run_cut_short(whole: Path, killed: Path, capsys: Capture) -> None:
    whole.write_bytes(whole.read_bytes()[:-5000])
    status, found, said = verified(whole, capsys)
    assert (status, found["truncated"], found["damaged"]) == (2, True, [])
    assert "truncated: " in said
    size = killed.stat().st_size
    writer = LedgerWriter(ledger_path(killed), killed)
    for end in (size // 2, size - 1000):
        writer.commit(end, ("camera",), (0.0, end / size))
    writer.close()
    status, found, _ = verified(killed, capsys)
    assert (status, found["truncated"], found["checked"], found["finished"]) == (2, False, True, False)
    assert (found["committed_bytes"], found["problems"]) == (size - 1000, [])
    killed.write_bytes(killed.read_bytes()[: size // 2 + 10])
    status, found, said = verified(killed, capsys)
    assert (status, found["truncated"], found["damaged"]) == (2, True, [])
    assert "from 0.000 s of camera on" in said


def test_devices_without_a_frame_are_named(tmp_path: Path, capsys: Capture) -> None:
    """One that was described, and one that only the rig file names; of the recording, and of what is recovered."""
    whole, killed = tmp_path / "r.rrd", tmp_path / "killed.part.rrd"
    rig = "".join(f'[devices.{name}]\ndriver = "webcam"\n' for name in ("front", "side", "top"))
    with Recorder(whole, settings={"rig": rig, "label": ""}, application=RIG) as recorder:
        recorder.start(RigLayout((Stream("front", "color", "webcam"), Stream("side", "color", "webcam"))), 0)
        recorder.write([ColorFrame(Stamp(0), 0, np.zeros((8, 8), np.uint8), "front")])
        recorder._put(recorder._encoder.write_rest, 0)
        recorder._put(recorder._outputs.file.flush, 0)
        written = threading.Event()
        recorder._put(written.set, 0)
        assert written.wait(PATIENCE_S)
        shutil.copy(tmp_path / "r.part.rrd", killed)
    status, found, said = verified(whole, capsys)
    assert (status, found["absent"], found["ok"]) == (3, ["side", "top"], True)
    assert said.count("all frames: the recording names it, and holds none") == 4  # in the table, and in a line
    assert "front lost" in said
    status, found, said = verified(killed, capsys)
    assert (status, found["absent"]) == (2, ["side", "top"])
    assert "is there, but no frame of side, top" in said
    write_ledger(killed, {"frames": 3, "front/frames": 1, "side/frames": 2})
    assert main(["recover", str(killed), "--json", "-"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["absent"] == ["side", "top"]
    assert json.loads(said.out)["missing"] == {"frames": 2, "side/frames": 2}
    assert "but no frame of side, top" in said.err
