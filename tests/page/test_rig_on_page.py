"""A rig watched on a page: files come and go while its devices stay open, and each says what a person remarked."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from deformscope.cli import main
from deformscope.frames import HealthReport, WrenchFrame
from deformscope.page.server.page_server import PageServer, running_pages
from deformscope.recording.lateness import RecordingError
from deformscope.recording.losses import lost_by, since
from deformscope.recording.recorder import Recorder
from deformscope.runs.recordings import OpenRecording
from deformscope_drivers.health import Health, Link
from tests.cases import slow_but
from tests.page.pages import page_script
from tests.patience import PATIENCE_S
from tests.verified import verify_here

RIG = """
[devices.tip]
driver = "optoforce"
double = true
rate_hz = 100
sensitivity = { counts_at_nominal = [16037.0, 16037.0, 16037.0], nominal = [40.0, 40.0, 40.0] }

[record]
folder = "FOLDER"
"""
WHOLE = (0, 3)


class CommandInThread:
    """A command that runs until its page stops it. status, found: once it has ended"""

    def __init__(self, *words: str, folder: Path) -> None:
        self.status = -1
        self._json = folder / "told.json"
        arguments = [*words, "--viewer", "page", "--json", str(self._json)]
        arguments += [] if words[0] in ("explore", "squeeze") else ["--seconds", str(PATIENCE_S)]
        self._thread = threading.Thread(target=lambda: setattr(self, "status", main(arguments)), daemon=True)
        self._thread.start()
        deadline = time.monotonic() + PATIENCE_S
        while not running_pages():
            assert self._thread.is_alive(), "it ended before its page was there"
            assert time.monotonic() < deadline
            time.sleep(0.01)
        (self.page,) = running_pages()

    def ended(self) -> dict[str, Any]:
        """Its JSON."""
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()
        found: dict[str, Any] = json.loads(self._json.read_text())
        return found


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG.replace("FOLDER", str(tmp_path / "runs")))
    return path


@contextmanager
def started(*words: str, folder: Path) -> Iterator[CommandInThread]:
    command = CommandInThread(*words, folder=folder)
    try:
        yield command
    finally:
        with suppress(Exception), page_script(command.page, "end") as one:  # where the test has failed before
            one.command("stop")
        command._thread.join(PATIENCE_S)


def received(state: dict[str, Any]) -> int:
    """Readings of the rig's device so far."""
    return int(state["devices"][0]["received"]) if state["devices"] else 0


def frames(path: Path) -> list[WrenchFrame]:
    return [item for item in OpenRecording(path).items() if isinstance(item, WrenchFrame)]


@pytest.mark.slow
def test_files_come_and_go_while_the_devices_stay_open(rig: Path, tmp_path: Path) -> None:
    with started("live", str(rig), folder=tmp_path) as command, page_script(command.page, "a") as one:
        one.until(lambda state: "start-recording" in state["commands"])
        assert one.state["phase"] == "live"
        assert one.command("write-note", text="lost")[0] == "refused"  # there is no file yet
        for _ in range(2):
            assert one.command("start-recording")[0] == "begun"
            one.until(lambda state: state["phase"] == "recording")
            assert one.command("discard", what="episode", reason="none yet")[0] == "refused"
            assert one.command("begin-episode", label="soft")[0] == "done"
            assert one.until(lambda state: state["episode"] == "soft")["recording"].endswith(".rrd")
            assert one.command("write-note", text="it gives")[0] == "done"
            assert one.command("discard", what="episode", reason="slipped")[0] == "done"
            enough = received(one.state) + 50
            one.until(lambda state, enough=enough: state["recorded_bytes"] > 0 and received(state) > enough)
            assert one.command("stop-recording")[0] == "begun"
            one.until(lambda state: "start-recording" in state["commands"])
        assert one.until(lambda state: state["devices"])["devices"][0]["state"] == "ok"
        assert one.command("stop") == ("done", "it ends now")
        one.until(lambda state: state["phase"] == "stopped")
        assert one.state["reason"].startswith("from the page after")
        found = command.ended()
    assert command.status in WHOLE
    assert found["recording"] == found["recordings"][-1]
    assert len(found["recordings"]) == 2
    first, second = (frames(Path(path)) for path in found["recordings"])
    assert first[-1].index < second[0].index  # the device went on
    for path in map(Path, found["recordings"]):
        assert verify_here(path) in WHOLE
        whole = OpenRecording(path)
        notes = whole.notes()
        assert [(note.about, note.text) for note in notes] == [
            ("episode-begin", "soft"),
            ("note", "it gives"),
            ("discard-episode", "slipped"),
            ("episode-end", "soft"),
        ]
        taken = [frame.stamp.host_ns for frame in frames(path)]
        assert all(taken[0] - 5e8 < note.host_ns < taken[-1] + 5e8 for note in notes)
        assert whole.outcome["complete"] is True
        assert json.loads(whole.outcome["counts"])["notes"] == 4
        assert [str(one) for one in whole.discarded()] == ["episode 1 (soft): slipped"]
        indices = [frame.index for frame in frames(path)]
        assert indices == list(range(indices[0], indices[-1] + 1))


def test_a_file_that_was_begun_with_the_command_ends_with_it(rig: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.rrd"
    with started("record", str(rig), "--record", str(file), folder=tmp_path) as command:
        with page_script(command.page, "a") as one:
            one.until(lambda state: "stop-recording" in state["commands"])
            assert one.state["recording"] == str(file)
            assert one.state["tares"] == ["tip"]
            assert one.command("tare", device="pads")[0] == "refused"
            assert one.command("tare", device="tip")[0] == "begun"
            said = one.until(
                lambda state: any("tip" in one["words"] and "tare" in one["words"] for one in state["remarks"])
            )
            tared = any("tip: tared" in remark["words"] for remark in said["remarks"])
            assert one.command("stop")[0] == "done"
        found = command.ended()
    assert command.status in WHOLE
    assert found["recordings"] == [str(file)]
    assert [note.text for note in OpenRecording(file).notes()] == ["tip"] * tared
    assert frames(file)[0].index == 0


def test_what_was_lost_before_a_file_began_is_not_its_loss() -> None:
    before = Health(
        Link.CONNECTED, received=10, lost=3, refused={"checksum": 2}, extra={"raw_dropped": 1}, silent_s=1.0
    )
    now = Health(
        Link.CONNECTED,
        received=25,
        lost=3,
        refused={"checksum": 2, "length": 1},
        extra={"raw_dropped": 1},
        silent_s=1.0,
    )
    looks = [HealthReport(at, (("tip", health),)) for at, health in ((1, before), (2, now))]
    ((_, found),) = since(looks[1], looks[0]).devices
    assert found.received == 15
    assert lost_by(found) == {"refused": 1}
    assert lost_by(now) != lost_by(found)


def test_a_page_that_ends_leaves_no_thread(rig: Path, tmp_path: Path) -> None:
    with PageServer("x") as page:
        assert page in running_pages()
    assert page not in running_pages()
    assert not [thread for thread in threading.enumerate() if thread.name == "deformscope-page"]


def test_the_last_seconds_are_kept_by_a_button(rig: Path, tmp_path: Path) -> None:
    with started("live", str(rig), folder=tmp_path) as command, page_script(command.page, "a") as one:
        one.until(lambda state: "keep-recent" in state["commands"] and received(state) > 100)
        assert one.state["phase"] == "live"
        assert one.until(lambda state: state["held_s"] > 0.5)["recording"] == ""
        assert one.command("keep-recent")[0] == "begun"
        said = one.until(lambda state: any("recorded" in remark["words"] for remark in state["remarks"]))
        assert said["phase"] == "live"  # nothing else goes on
        assert one.command("stop")[0] == "done"
        found = command.ended()
    (path,) = map(Path, found["recordings"])
    assert verify_here(path) in WHOLE
    indices = [frame.index for frame in frames(path)]
    assert indices == list(range(indices[0], indices[-1] + 1))
    assert OpenRecording(path).outcome["stopped"].startswith("stored from the page: the last")
    assert json.loads(OpenRecording(path).outcome["counts"])["tip/frames"] == len(indices)


@pytest.mark.parametrize("viewer", slow_but(["none"], ["page", "none"]))
@pytest.mark.slow
def test_record_may_hold_the_last_seconds_alone(rig: Path, tmp_path: Path, viewer: str) -> None:
    file, said = tmp_path / "last.rrd", tmp_path / "found.json"
    flags = ["--record", str(file), "--seconds", "3", "--keep-last", "0.5", "--viewer", viewer, "--json", str(said)]
    assert main(["record", str(rig), *flags]) in WHOLE
    assert verify_here(file) in WHOLE
    taken = [frame.stamp.host_ns for frame in frames(file)]
    assert 0.5e9 < taken[-1] - taken[0] < 2.8e9
    assert frames(file)[0].index > 0
    found = json.loads(said.read_text())
    assert found["recording"] == str(file)
    assert found["devices"]["tip"]["received"] <= frames(file)[-1].index  # of the file, not of the run


@pytest.mark.slow
def test_the_last_seconds_are_kept_where_the_file_beside_them_cannot_be_closed(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, close = tmp_path / "last.rrd", Recorder._close

    def full(self: Recorder, *, complete: bool) -> None:
        close(self, complete=complete)
        if self.summary().path is not None and self.summary().path != file:
            raise RecordingError("a disk with room", "a full one")

    monkeypatch.setattr(Recorder, "_close", full)
    words = ("record", str(rig), "--record", str(file), "--keep-last", "5")
    with started(*words, folder=tmp_path) as command, page_script(command.page, "a") as one:
        one.until(lambda state: "start-recording" in state["commands"] and received(state) > 50)
        assert one.command("start-recording")[0] == "begun"
        one.until(lambda state: state["recorded_bytes"] > 0)
        assert one.command("stop")[0] == "done"
        command._thread.join(PATIENCE_S)
    assert command.status == 2
    assert verify_here(file) in WHOLE
    assert frames(file)


def test_what_cannot_be_held_is_refused(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", str(rig), "--keep-last", "5", "--viewer", "none"]) == 2
    assert "--keep-last with --viewer page" in capsys.readouterr().err
    assert main(["record", str(rig), "--keep-last", "5", "--stage", "contact"]) == 2


@pytest.mark.slow
def test_the_page_goes_on_where_its_file_cannot(rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And another file can be begun, as on a disk where room was made."""
    full, write = threading.Event(), Recorder.write

    def written(self: Recorder, items: object) -> None:
        if full.is_set() and self.summary().path is not None:
            raise RecordingError("64 MiB free on the disk", "0 MiB free")
        write(self, items)

    monkeypatch.setattr(Recorder, "write", written)
    with started("live", str(rig), folder=tmp_path) as command, page_script(command.page, "a") as one:
        one.until(lambda state: "start-recording" in state["commands"])
        assert one.command("start-recording")[0] == "begun"
        one.until(lambda state: state["recorded_bytes"] > 0)
        full.set()
        before = received(one.until(lambda state: "start-recording" in state["commands"]))
        assert any(remark["bad"] and "0 MiB free" in remark["words"] for remark in one.state["remarks"])
        full.clear()
        one.until(lambda state: received(state) > before)
        assert one.command("start-recording")[0] == "begun"
        one.until(lambda state: state["phase"] == "recording")
        one.command("stop")
        command._thread.join(PATIENCE_S)
    assert command.status == 2
    # the file that could not be continued has its ledger too
    assert [len(list(tmp_path.rglob(f"*{ending}"))) for ending in (".part.rrd", ".rrd.ledger")] == [1, 2]
