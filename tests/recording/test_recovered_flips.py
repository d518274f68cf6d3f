"""What `verify` says against an interrupted recording is in the words of `recover`, and in its new ledger."""

import json
import shutil
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.frames import ColorFrame, RawBytes, Stream, WrenchFrame
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording.facts import Facts, gather_facts
from deformscope.recording.ledger import check_recording, ledger_path, read_discards, read_ledger
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.recording.summary import summarise
from deformscope.runs import recovery
from deformscope.runs.verification import verify_recording
from deformscope_drivers.clock import Stamp
from tests.patience import PATIENCE_S
from tests.verified import verify_here

RECORDINGS, FLIPS = 50, 1_000


def interrupt(folder: Path, seed: int) -> Path:
    """The file and the ledger of a run that is killed: a camera and a force sensor, a portion of each a beat."""
    rng, part = np.random.default_rng(seed), folder / "killed.part.rrd"
    streams = (Stream("front", "color", "webcam"), Stream("tip", "wrench", "optoforce"))
    with Recorder(folder / "run.rrd", settings={"seed": seed}, application=RIG) as recorder:
        file = recorder._outputs.file
        assert file is not None
        recorder.start(RigLayout(streams), 0)
        for index in range(rng.integers(4, 9)):
            stamp = Stamp(index * 100_000_000)
            image = rng.integers(0, 255, (24, 32), np.uint8)
            counts, force_n = rng.integers(-99, 99, 3), rng.normal(size=(1, 3))
            recorder.write([ColorFrame(stamp, index, image, "front")])
            recorder.write(
                [
                    RawBytes(stamp.host_ns, rng.bytes(64), False, "tip"),
                    WrenchFrame(stamp, index, counts, force_n, device="tip"),
                ]
            )
            recorder._put(recorder._encoder.write_rest, 0)
            recorder._put(file.flush, 0)
        written = threading.Event()
        recorder._put(written.set, 0)
        assert written.wait(PATIENCE_S)
        shutil.copy(folder / "run.part.rrd", part)
        shutil.copy(ledger_path(folder / "run.part.rrd"), ledger_path(part))
    return part


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    return interrupt(tmp_path, 0)


@pytest.fixture
def quicker(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Content is read in one process for all, in a second less; some damaged bytes end it."""
    pools = [ProcessPoolExecutor(1, get_context("spawn"))]

    def read(path: Path) -> Facts:
        try:
            return pools[-1].submit(gather_facts, path).result(PATIENCE_S)
        except BrokenProcessPool:
            pools.append(ProcessPoolExecutor(1, get_context("spawn")))
            return Facts(damage="its bytes end rerun's reader (SIGABRT)")

    monkeypatch.setattr("deformscope.recording.facts.read_facts", read)
    monkeypatch.setattr("deformscope.runs.verification.read_facts", read)
    yield
    for one in pools:
        one.shutdown()


def flip(path: Path, place: int, bit: int = 0) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 1 << bit
    path.write_bytes(content)


def recover(part: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, object], str]:
    """(exit status, JSON, what was said)"""
    capsys.readouterr()
    status = main(["recover", str(part), "--json", "-"])
    said = capsys.readouterr()
    return status, json.loads(said.out or "{}"), " ".join(said.err.split())


@pytest.mark.usefixtures("quicker")
def test_damage_is_named_and_stays_with_what_is_recovered(killed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By stream and seconds, in words, JSON, ledger, and all that reads the new recording."""
    block = read_ledger(killed).blocks[-2]
    flip(killed, (block.start + block.end) // 2)
    status, found, said = recover(killed, capsys)
    (problem,) = check_recording(killed).problems
    assert f"wrench/tip, {block.from_s:.3f} to {block.to_s:.3f} s) differ" in problem
    assert "color/front" in problem
    problems = cast("list[str]", verify_recording(killed).found["problems"])
    assert (status, found["problems"], problems[0]) == (3, problems, problem)
    assert problem in said
    assert "everything" not in said

    out = killed.with_name("killed.recovered.rrd")
    assert check_recording(out).source_problems == problems
    assert Replay(out).source_problems == problems
    assert str(killed.parent) not in ledger_path(out).read_text()
    assert verify_here(out) == 3
    assert f"damaged before it was recovered: {problem}" in capsys.readouterr().err
    row = summarise(out)
    assert (row["status"], row["problem"]) == ("damaged", problem)
    assert main(["export", str(out), "--to", "csv", "--out", str(killed.with_name("tables"))]) == 3
    assert problem in capsys.readouterr().err

    # What is recovered of it in its turn, with a discard, keeps both.
    assert main(["discard", str(out), "--reason", "it slipped"]) == 0
    flip(out, out.stat().st_size // 2)
    status, found, _ = recover(out, capsys)
    (again,) = check_recording(out).problems
    # the viewer's reader may add why it cannot read the block: that depends on the byte
    assert (status, found["problems"][: len(problems) + 1]) == (3, [*problems, again])
    last = Path(str(found["recovered"]))
    assert check_recording(last).source_problems == found["problems"]
    assert [one["reason"] for one in read_discards(last)] == ["it slipped"]


@pytest.mark.usefixtures("quicker")
def test_the_ledger_of_another_file(killed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "other").mkdir()
    shutil.copy(ledger_path(interrupt(tmp_path / "other", 1)), ledger_path(killed))
    status, found, said = recover(killed, capsys)
    assert status == 3
    assert found["missing"] == {}
    (problem,) = [one for one in check_recording(killed).problems if "truncated" not in one]
    assert "every block: is the ledger of another file?" in problem
    assert problem in said
    assert problem in check_recording(killed.with_name("killed.recovered.rrd")).source_problems


@pytest.mark.usefixtures("quicker")
@pytest.mark.parametrize(("recordings", "flips"), [(2, 4), pytest.param(RECORDINGS, FLIPS, marks=pytest.mark.slow)])
def test_every_flip_that_verify_sees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, recordings: int, flips: int
) -> None:
    """One at a time, every fourth in the ledger. Figures: pytest -m slow -s tests/recording/test_recovered_flips.py"""
    rng, seen, refused, silent = np.random.default_rng(recordings), 0, 0, 0
    for number in range(flips):
        if number % (flips // recordings) == 0:
            folder = tmp_path / str(number)
            folder.mkdir()
            part = interrupt(folder, number)
            out, whole = folder / "killed.recovered.rrd", {one: one.read_bytes() for one in (part, ledger_path(part))}
        flipped = ledger_path(part) if number % 4 == 3 else part
        place = int(rng.integers(len(whole[flipped])))
        flip(flipped, place, int(rng.integers(8)))
        verified = verify_recording(part)
        monkeypatch.setattr(recovery, "verify_recording", lambda path, found=verified: found)  # once is enough
        problems = verified.found["problems"]
        status, found, said = recover(part, capsys)
        seen += bool(problems)
        if status == 2:
            refused += 1
            assert not out.exists()
            assert all(one in said for one in problems) or "a file of another kind" in said
        else:
            assert status in (0, 3), (flipped.name, place, said)
            assert (status, found["problems"]) == (3 if problems else 0, problems)
            assert all(one in said for one in problems)
            check = check_recording(out)
            assert (check.problems, check.source_problems) == ([], problems)
            silent += not problems
        for one, content in whole.items():
            one.write_bytes(content)
        out.unlink(missing_ok=True)
        ledger_path(out).unlink(missing_ok=True)
    with capsys.disabled():
        print(f"\n{seen} of {flips} flips seen by verify, all carried on; {refused} left nothing to recover;", end=" ")
        print(f"{silent} seen by neither")
    assert seen > flips // 2
