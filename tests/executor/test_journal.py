"""Lines that stay when a process is killed."""

import math
import os
from pathlib import Path

import pytest

from deformscope.errors import InputError
from deformscope.executor.tasks import PIECE, Journal


@pytest.mark.parametrize("cut_off", ["", '{"half": "a li', "x" * (2 * PIECE)])
def test_lines_come_back_without_one_that_was_cut_off(cut_off: str, tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    with Journal(path, "lines") as journal:
        journal.add({"a": 1}, [math.inf, None])
        journal.add("b")
    with path.open("a") as file:
        file.write(cut_off)
    with Journal(path, "lines") as journal:
        assert list(journal.lines()) == [{"a": 1}, [math.inf, None], "b"]
        journal.add("c")
        assert list(journal.lines())[-1] == "c"


@pytest.mark.parametrize("content", [b'{"of": "another program"}', b"words\nand no end", b"\x89PNG\n\xff"])
def test_a_file_of_another_program_stays_as_it_is(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "theirs.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"expected lines; .*theirs\.json"), Journal(path, "lines") as journal:
        list(journal.lines())
    assert path.read_bytes() == content


def test_what_is_no_line_of_it_and_a_second_writer_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    path.write_text("no JSON\n")
    with Journal(path, "outcomes", "leave it out") as journal:
        with pytest.raises(InputError, match=r"expected outcomes; .*leave it out.*lines\.jsonl:1"):
            list(journal.lines())
        with pytest.raises(InputError, match="another command adds to"):
            Journal(path, "outcomes")
    Journal(path, "outcomes").__exit__(None, None, None)


def test_a_full_disk_is_an_error_and_leaves_whole_lines(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write = os.write
    with Journal(tmp_path / "lines.jsonl", "lines") as journal:
        journal.add("a")
        monkeypatch.setattr("os.write", lambda handle, text: write(handle, text[:-2]))
        with pytest.raises(OSError, match="No space left"):
            journal.add("b")
        assert list(journal.lines()) == ["a"]
