"""What is discarded stays, and whoever reads it is told so: while it is recorded, and later in its ledger."""

import json
import logging
from pathlib import Path

import pytest

from deformscope import open_recording
from deformscope.cli import main
from deformscope.frames import NoteKind, SessionNote
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording.ledger import LedgerWriter, check_recording, discards_of, ledger_path
from deformscope.recording.recorder import Recorder
from tests.verified import verify_here


def recorded(path: Path, *notes: tuple[NoteKind, str]) -> Path:
    with Recorder(path, application=RIG) as recorder:
        recorder.start(RigLayout(()), 0)
        recorder.write([SessionNote(at * 10**9, about, text) for at, (about, text) in enumerate(notes)])
    return path


def test_an_episode_is_discarded_while_it_is_recorded(tmp_path: Path) -> None:
    path = recorded(
        tmp_path / "r.rrd",
        ("episode-begin", "soft"),
        ("episode-end", "soft"),
        ("discard-episode", "it slipped"),
        ("episode-begin", "hard"),
    )
    (found,) = open_recording(path).discarded()
    assert (found.episode, found.label, found.reason) == (1, "soft", "it slipped")


def test_a_recording_is_discarded_later(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    path = recorded(tmp_path / "r.rrd", ("episode-begin", "soft"), ("episode-begin", "hard"))
    before = path.read_bytes()
    assert main(["discard", str(path), "--episode", "2", "--reason", "it slipped"]) == 0
    assert main(["discard", str(path), "--reason", "wrong foam"]) == 0
    assert path.read_bytes() == before
    assert check_recording(path).problems == []
    assert [str(one) for one in open_recording(path).discarded()] == [
        "episode 2 (hard): it slipped",
        "all of it: wrong foam",
    ]
    capsys.readouterr()
    assert verify_here(path, "--json", "-") == 0  # it is whole
    assert [one["reason"] for one in json.loads(capsys.readouterr().out)["discarded"]] == ["it slipped", "wrong foam"]
    with caplog.at_level(logging.WARNING):
        assert "wrong foam" in str(open_recording(path))
    assert [record.message for record in caplog.records if "is discarded: all of it: wrong foam" in record.message]


def test_what_cannot_be_marked_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded(tmp_path / "r.rrd", ("episode-begin", "soft"))
    assert main(["discard", str(path), "--episode", "2", "--reason", "it slipped"]) == 2
    assert "1 = soft" in capsys.readouterr().err
    assert main(["discard", str(path), "--reason", " "]) == 2
    ledger_path(path).unlink()  # nothing says any more that its bytes are as they were: nor may this
    assert main(["discard", str(path), "--reason", "it slipped"]) == 2
    assert not ledger_path(path).exists()


@pytest.mark.parametrize("written", ["lost", None, [{"reason": "wrong foam", "by": "somebody"}, "lost"]])
def test_a_ledger_that_says_more_or_nonsense_still_opens(tmp_path: Path, written: object) -> None:
    path = recorded(tmp_path / "r.rrd")
    known = ["all of it: wrong foam"] if isinstance(written, list) else []
    ledger = LedgerWriter(ledger_path(path), path)
    for one in written if isinstance(written, list) else [written]:
        ledger.add({"discarded": one})
    ledger.close()
    assert [str(one) for one in discards_of(path, [])] == known
