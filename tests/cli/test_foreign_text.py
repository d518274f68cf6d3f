"""What comes from others is said, and controls nothing: no terminal, no page, no JSON; a request to end is heard."""

import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.errors import InputError, printable
from deformscope.page.server.page_session import PageSession
from deformscope.pictures.report import html_report
from deformscope.recording.rrd_file import merged_path
from deformscope.runs.recordings import OpenRecording
from deformscope.terminal import say
from tests.cases import slow_but
from tests.page.pages import page_script
from tests.page.test_rig_on_page import RIG, WHOLE, started
from tests.patience import PATIENCE_S
from tests.verified import verify_here

ESC = "\x1b]0;owned\x07\x1b[2J"
NOT_UTF8 = os.fsdecode(b"caf\xe9")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\x1b[2Jb", "a\\x1b[2Jb"),
        ("a\rb\x07\x9b", "a\\rb\\x07\\x9b"),
        ("\u202egnp.exe", "\\u202egnp.exe"),
        (NOT_UTF8, "caf\\udce9"),
        ("two\nlines,\ta tab, µm, é, 😀", "two\nlines,\ta tab, µm, é, 😀"),
    ],
)
def test_what_controls_a_terminal_is_shown_instead(text: str, shown: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert printable(text) == shown
    assert shown in str(InputError("a number", text))
    assert shown in str(InputError.about(ValueError(text), text))
    say(text)
    assert capsys.readouterr().err == f"{shown}\n"
    assert html_report(text, ()).encode()


def written(folder: Path) -> list[list[str]]:
    """Command lines with files whose names, keys and contents control a terminal."""
    table, pair, rig, video = (
        folder / f"{ESC.replace('/', '')}{name}" for name in ("t.npz", "p.npz", "r.toml", "v.mp4")
    )
    np.savez(table, **{ESC: np.zeros(3), "label": np.array([ESC] * 3)})  # type: ignore[arg-type]
    np.savez(pair, **{ESC: np.zeros(3)})  # type: ignore[arg-type]
    rig.write_text(f'[devices."{ESC}"]\ndriver = "{ESC}"\n'.replace("\x1b", "\\u001b").replace("\x07", "\\u0007"))
    video.write_bytes(ESC.encode())
    log = folder / "log.csv"
    log.write_text(f"time,{ESC}\n0,{ESC}\n1,x\n")
    mesh = folder / "rig.toml"
    mesh.write_text('[shape]\nurdf = "a\\u001b[2J.urdf"\n[devices.arm]\ndriver = "jaco"\n')
    return [
        ["classify", str(table)],
        ["calibrate", "beta", str(pair)],
        ["calibrate", "beta", str(video)],
        ["calibrate", "beta", str(log)],
        ["calibrate", "beta", str(folder / ESC)],
        ["calibrate", "arm", str(log)],
        ["predict", str(log), "--poke", "0,0"],
        ["record", str(rig), "--seconds", "1"],
        ["doctor", str(mesh)],
        ["verify", str(pair)],
        ["replay", str(log)],
        [ESC],
        ["record", f"lab:{ESC}"],
        ["record", "lab:bench", f"--{ESC}", NOT_UTF8],
    ]


@pytest.mark.parametrize("number", range(14))
def test_no_refusal_reaches_the_terminal_as_it_came(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], number: int
) -> None:
    assert main(written(tmp_path)[number]) in (1, 2, 3)
    shown = capfd.readouterr()
    assert not {"\x1b", "\x07"} & {*shown.out, *shown.err}
    assert shown.err.strip()
    shown.err.encode()


def test_a_path_that_is_not_utf_8_is_recorded_and_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / NOT_UTF8
    folder.mkdir()
    rig, file = folder / f"{NOT_UTF8}.toml", folder / f"{NOT_UTF8}.rrd"
    rig.write_text(RIG.replace("FOLDER", str(tmp_path / "runs")))
    with (
        started("record", str(rig), "--record", str(file), folder=tmp_path) as command,
        page_script(command.page, "a") as one,
    ):
        assert "caf" in one.until(lambda state: state["recorded_bytes"] > 0)["recording"]
        assert one.command("write-note", text="here")[0] == "done"
        one.command("stop")
        assert command.ended()["recording"] == str(file)  # a JSON escape, which is the path again
    assert command.status in WHOLE
    assert verify_here(file, "--json", str(tmp_path / "verify.json")) in WHOLE
    assert json.loads((tmp_path / "verify.json").read_text())["recording"] == str(file)
    assert list(OpenRecording(file).items())
    assert main(["replay", str(file)]) in WHOLE
    capsys.readouterr().out.encode()


def test_a_page_of_any_desk_gets_its_state(tmp_path: Path) -> None:
    session = PageSession(NOT_UTF8)
    session.remark(f"{tmp_path}/{NOT_UTF8}", bad=True)
    from deformscope.page.server.page_server import _encoded

    assert json.loads(_encoded(session.state))["title"] == NOT_UTF8


COMMANDS = {
    "page": ["calibrate", "beta", "sample:tension", "--viewer", "page"],
    "record": ["record", "RIG", "--viewer", "none", "--record", "FILE"],
    "live": ["live", "RIG", "--viewer", "page"],
}
BEGUN = {"page": "viewer: ", "record": "recording into", "live": "watching"}


@pytest.mark.parametrize(
    ("name", "number"),
    slow_but([("record", signal.SIGTERM)], itertools.product(COMMANDS, (signal.SIGTERM, signal.SIGHUP))),
)
def test_a_request_to_end_is_heard(tmp_path: Path, name: str, number: signal.Signals) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.replace("FOLDER", str(tmp_path / "runs")))
    words = [{"RIG": str(rig), "FILE": str(tmp_path / "r.rrd")}.get(word, word) for word in COMMANDS[name]]
    process = subprocess.Popen(
        [sys.executable, "-m", "deformscope", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    watchdog = threading.Timer(PATIENCE_S, process.kill)
    watchdog.start()
    said = ""
    while BEGUN[name] not in said and (line := process.stderr.readline()):
        said += line
    process.send_signal(number)
    rest = process.stderr.read()
    process.stderr.close()
    watchdog.cancel()
    assert process.wait() == 128 + number, said + rest
    assert number.name in rest
    assert "Traceback" not in rest
    if name == "record":
        assert verify_here(tmp_path / "r.rrd") in WHOLE
    assert not list(tmp_path.rglob("*.merged"))


def test_nohup_is_left_alone() -> None:
    code = "import signal; from deformscope.cli import main; main(['--version']); print(signal.getsignal(1).name)"
    command = ["nohup", sys.executable, "-c", code]
    assert "SIG_IGN" in subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=True).stdout


def test_a_run_that_was_killed_leaves_no_stray_file(tmp_path: Path) -> None:
    """Whatever the next one is called; what it recorded stays."""
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.replace("FOLDER", str(tmp_path)))
    command = [sys.executable, "-m", "deformscope", "record", str(rig), "--record", str(tmp_path / "first.rrd")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    part, deadline = tmp_path / "first.part.rrd", threading.Event()
    timer = threading.Timer(PATIENCE_S, deadline.set)
    timer.start()
    while not (part.exists() and part.stat().st_size > 100_000):
        assert not deadline.wait(0.05)
        assert process.poll() is None
    timer.cancel()
    process.kill()
    process.wait()
    assert merged_path(part).exists()
    again = shutil.copytree(tmp_path, tmp_path / "again") / part.name
    assert main(["record", str(rig), "--record", str(tmp_path / "next.rrd"), "--seconds", "0.3"]) in WHOLE
    assert part.exists()
    assert main(["recover", str(again)]) == 0
    assert not list(tmp_path.rglob("*.merged"))
