"""`deformscope catalog` as a user calls it: every recording of a folder, the damaged ones too, read once."""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import pyarrow.parquet as pq
import pytest

from deformscope.cli import main
from deformscope.cli.sweep import find_sources
from deformscope.config import SweepConfig
from deformscope.executor.local import open_workers
from deformscope.page.playback import serve_catalog
from deformscope.recording.ledger import add_discard
from deformscope.runs.catalog import catalogue
from tests.cases import Capture, Patch, slow
from tests.patience import PATIENCE_S
from tests.test_imports import ROOT

SHIPPED = ROOT / "recordings"


def copy(recording: Path, target: Path) -> None:
    shutil.copy(recording, target)
    shutil.copy(f"{recording}.ledger", f"{target}.ledger")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("recordings")
    for name in ("explore", "tension"):
        copy(SHIPPED / f"{name}.rrd", made / f"{name}.rrd")
    (made / "older").mkdir()
    copy(SHIPPED / "rig.rrd", made / "older" / "rig.rrd")
    copy(SHIPPED / "rig.rrd", made / "flipped.rrd")
    content = bytearray((made / "flipped.rrd").read_bytes())
    content[len(content) // 2] ^= 4
    (made / "flipped.rrd").write_bytes(content)
    copy(SHIPPED / "squeeze.rrd", made / "short.rrd")
    with (made / "short.rrd").open("r+b") as file:
        file.truncate(300_000)
    (made / "none.rrd").write_bytes(b"no recording")
    return made


def catalog(folder: Path, *flags: str, apart: bool = False) -> dict[str, Any]:
    """Read in this process, or in one of its own as users have it."""
    target = folder.parent / f"{folder.name}.json"
    with pytest.MonkeyPatch.context() as monkeypatch:
        if not apart:
            monkeypatch.setattr("deformscope.runs.catalog.open_workers", lambda *given, apart: open_workers(*given))
        assert main(["catalog", str(folder), "--workers", "1", "--json", str(target), *flags]) == 0
    found: dict[str, Any] = json.loads(target.read_text())
    return found


@pytest.fixture(scope="module")
def listed(folder: Path) -> dict[str, dict[str, Any]]:
    return {one["path"]: one for one in catalog(folder, apart=True)["recordings"]}


def test_all_are_listed_and_the_damaged_as_damaged(listed: dict[str, dict[str, Any]]) -> None:
    assert {name: row["status"] for name, row in listed.items()} == {
        "explore.rrd": "whole",
        "tension.rrd": "whole",
        "older/rig.rrd": "whole",
        "flipped.rrd": "damaged",
        "short.rrd": "damaged",
        "none.rrd": "damaged",
    }
    assert "differ from what was recorded" in listed["flipped.rrd"]["problem"]
    assert "truncated" in listed["short.rrd"]["problem"]
    assert listed["none.rrd"]["problem"] == "expected a recording (.rrd); got a file of another kind"


def test_a_row_says_what_made_it_and_what_it_found(listed: dict[str, dict[str, Any]]) -> None:
    tension, explored = listed["tension.rrd"], listed["explore.rrd"]
    assert (tension["kind"], explored["kind"]) == ("images", "exploration")
    assert tension["settings.stride"] == 2
    assert tension["beta_low"] <= tension["beta"] <= tension["beta_high"]
    assert (explored["touches"], explored["devices"], explored["verdict"]) == (2, "arm, camera, tip", "regions")
    assert explored["stiffness_low"] < explored["stiffness"] < explored["stiffness_high"]
    assert explored["duration_s"] == pytest.approx(12.37, abs=0.01)
    assert explored["settings.explore.pace"] == "quick"
    assert len(explored["sha256"]) == 64


def test_columns_have_units(folder: Path, capsys: Capture) -> None:
    assert main(["catalog", str(folder), "--columns", "path,duration_s,stiffness_low,touches"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split() == [
        *("path", "duration_s", "[s]", "stiffness_low", "[N/mm]", "touches")
    ]


def test_what_holds_for_a_condition_is_listed_in_the_order_asked_for(folder: Path) -> None:
    found = catalog(folder, "--where", "not damaged and duration_s > 1", "--sort=-duration_s")
    assert [one["path"] for one in found["recordings"]] == ["explore.rrd", "tension.rrd", "older/rig.rrd"]
    assert [one["path"] for one in catalog(folder, "--where", "stiffness < 5")["recordings"]] == ["explore.rrd"]


def test_only_what_changed_is_read_again(folder: Path, tmp_path: Path) -> None:
    here = tmp_path / "here"
    shutil.copytree(folder, here)
    assert catalog(here)["read"] in (0, 6)  # times of a copy may be others
    assert catalog(here)["read"] == 0
    add_discard(here / "tension.rrd", {"reason": "the clamp slipped", "episode": 0, "label": ""})
    (here / "none.rrd").unlink()
    copy(SHIPPED / "squeeze.rrd", here / "short.rrd")
    found = catalog(here)
    rows = {one["path"]: one for one in found["recordings"]}
    assert found["read"] == 2
    assert rows["tension.rrd"]["discarded"] == "all of it: the clamp slipped"
    assert (rows["short.rrd"]["status"], "none.rrd" in rows) == ("whole", False)
    assert pq.read_table(here / "catalog.parquet").num_rows == 5


def test_what_the_system_refuses_to_read_is_read_again(tmp_path: Path) -> None:
    """As for a disk that reports an error once: nothing is said of the recording itself."""
    whole, refused = tmp_path / "tension.rrd", tmp_path / "refused.rrd"
    copy(SHIPPED / "tension.rrd", whole)
    copy(SHIPPED / "tension.rrd", refused)
    ledger = Path(f"{refused}.ledger")
    content = ledger.read_bytes()
    ledger.unlink()
    ledger.mkdir()
    found = catalog(tmp_path, "--page")
    rows = {one["path"]: one for one in found["recordings"]}
    assert (rows["tension.rrd"]["status"], rows["refused.rrd"]["status"]) == ("whole", "unread")
    assert "Is a directory" in rows["refused.rrd"]["problem"]
    assert "damaged" not in rows["refused.rrd"]
    assert [one.stem for one in (tmp_path / ".catalog").iterdir()] == [rows["tension.rrd"]["sha256"]]
    times = ledger.stat()
    ledger.rmdir()
    ledger.write_bytes(content)
    os.utime(ledger, ns=(times.st_atime_ns, times.st_mtime_ns))
    found = catalog(tmp_path)
    assert found["read"] == 1
    assert {one["status"] for one in found["recordings"]} == {"whole"}


def test_a_ctrl_c_keeps_what_was_read(tmp_path: Path, monkeypatch: Patch) -> None:
    for name in ("a", "b", "c"):
        copy(SHIPPED / "tension.rrd", tmp_path / f"{name}.rrd")

    def interrupt(what: str, done: int, of: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        catalogue(tmp_path, workers=1, progress=interrupt)
    rows = pq.read_table(tmp_path / "catalog.parquet").to_pylist()
    assert [row["status"] for row in rows] == ["whole", "whole", "unread"]
    assert catalogue(tmp_path, workers=1).read == 1


def test_a_page_has_a_picture_of_each_that_opens_it(folder: Path, tmp_path: Path) -> None:
    here = tmp_path / "here"
    here.mkdir()
    copy(SHIPPED / "tension.rrd", here / "tension one.rrd")
    catalog(here, "--page")
    page = (here / "catalog.html").read_text()
    (picture,) = (here / ".catalog").iterdir()
    made = picture.stat().st_mtime_ns
    assert re.search(r'<a href="tension%20one\.rrd"><img src="data:image/png;base64,', page)
    catalog(here, "--page")
    assert picture.stat().st_mtime_ns == made


def test_a_served_page_plays_a_recording_that_is_clicked(folder: Path, listed: object) -> None:
    page = serve_catalog("two", '<a href="0/">one</a>', [folder / "older" / "rig.rrd", folder / "none.rrd"])
    with contextlib.closing(page):
        assert asked(page.address) == (200, b'<a href="0/">one</a>')
        status, playing = asked(f"{page.address}0/")
        assert (status, b'data-recording="recording.rrd"' in playing) == (200, True)
        assert asked(f"{page.address}0/recording.rrd") == (200, (folder / "older" / "rig.rrd").read_bytes())
        assert asked(f"{page.address}1/")[0] == 422
        assert [asked(f"{page.address}{path}")[0] for path in ("2/", "-1/", "0", "9" * 5000 + "/")] == [404] * 4
        stranger = page.address.rsplit("/", 2)[0]
        assert [asked(f"{stranger}/{path}")[0] for path in ("", "0/", "guessed/0/")] == [403] * 3


def asked(address: str) -> tuple[int, bytes]:
    try:
        with urlopen(address, timeout=PATIENCE_S) as answer:
            return answer.status, answer.read()
    except HTTPError as error:
        with error:
            return error.code, error.read()


def test_names_that_are_not_utf_8_are_listed_swept_drawn_and_linked(tmp_path: Path) -> None:
    name = os.fsdecode(b"caf\xe9.rrd")
    copy(SHIPPED / "tension.rrd", tmp_path / "plain.rrd")
    copy(SHIPPED / "tension.rrd", tmp_path / name)
    found = catalog(tmp_path, "--page")
    assert {one["path"]: one["status"] for one in found["recordings"]} == dict.fromkeys(
        ("plain.rrd", r"caf\udce9.rrd"), "whole"
    )
    assert catalog(tmp_path)["read"] == 0
    assert 'href="caf%E9.rrd"' in (tmp_path / "catalog.html").read_text()
    options = SweepConfig(source=tmp_path / "catalog.parquet", command=("calibrate", "beta"))
    assert {one.name for one in find_sources(options)} == {"plain.rrd", name}


def test_no_text_of_a_recording_controls_the_terminal_of_whoever_draws_it(tmp_path: Path, capfd: Capture) -> None:
    copy(SHIPPED / "tension.rrd", tmp_path / "r.rrd")
    add_discard(tmp_path / "r.rrd", {"reason": "\x1b]0;owned\x07"})
    catalog(tmp_path, "--page", apart=True)
    said = capfd.readouterr()
    assert "is discarded: all of it: \\x1b]0;owned" in said.err
    assert not {"\x1b", "\x07"} & {*said.out, *said.err}


@pytest.mark.parametrize("ends", [signal.SIGINT, slow(signal.SIGTERM)])
def test_a_catalog_is_served_until_it_is_ended_without_a_terminal_too(tmp_path: Path, ends: signal.Signals) -> None:
    copy(SHIPPED / "tension.rrd", tmp_path / "r.rrd")
    command = [sys.executable, "-m", "deformscope", "catalog", str(tmp_path), "--serve", "--workers", "1"]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as ran:
        assert ran.stderr is not None
        assert asked(next(one for one in ran.stderr if "until Ctrl-C" in one).split()[-1])[0] == 200
        assert ran.poll() is None
        ran.send_signal(ends)
        assert ran.wait(PATIENCE_S) == (0 if ends == signal.SIGINT else 128 + ends)


def compared(first: Path, second: Path, tmp_path: Path) -> dict[str, Any]:
    target = tmp_path / "compared.json"
    assert main(["catalog", "compare", str(first), str(second), "--json", str(target)]) == 0
    found: dict[str, Any] = json.loads(target.read_text())
    return found


def test_a_recording_does_not_differ_from_itself(tmp_path: Path) -> None:
    found = compared(SHIPPED / "explore.rrd", SHIPPED / "explore.rrd", tmp_path)
    by_name = {one["name"]: one for one in found["results"]}
    assert found["settings"] == {}
    assert {one["difference"]["value"] for one in found["results"] if "difference" in one} == {0}
    touched = by_name["touch 2.apparent_stiffness_n_per_mm"]["difference"]
    assert touched["interval"][0] < 0 < touched["interval"][1]
    assert {one["name"].partition(":")[0] for one in found["series"]} == {"arm", "tip"}
    assert all(one["rms"] == 0 and one["to_s"] > one["from_s"] >= 0 for one in found["series"])


def test_settings_and_results_that_differ_are_named_and_what_has_no_contact_is_not_aligned(tmp_path: Path) -> None:
    found = compared(SHIPPED / "tension.rrd", SHIPPED / "explore.rrd", tmp_path)
    assert found["settings"]["stride"] == {"first": 2, "second": None}
    assert "without a contact" in found["unaligned"]
    assert found["series"] == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "a folder of recordings"),
        (["{folder}", "--where", "stiffnes < 1"], "stiffness"),
        (["{folder}", "--where", "open('x')"], "columns compared with values"),
        (["{folder}", "--columns", "path,no_such"], "columns of the catalog"),
        (["compare", "{folder}/flipped.rrd", "{folder}/explore.rrd"], "that matches its ledger"),
        (["compare", "{folder}/none.rrd", "{folder}/explore.rrd"], "a recording"),
    ],
)
def test_what_cannot_be_listed_is_said_in_one_line(
    arguments: list[str], words: str, folder: Path, listed: object, capsys: Capture
) -> None:
    assert main(["catalog", *(one.format(folder=folder) for one in arguments)]) == 2
    said = capsys.readouterr().err.splitlines()
    assert words in said[-1]
    assert sum("error" in line for line in said) == 1


@pytest.mark.slow
def test_a_sweep_takes_what_a_catalog_selects(folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "found.json"
    flags = ["--where", 'kind == "exploration"', "--out", str(tmp_path / "out"), "--json", str(target)]
    assert main(["sweep", str(folder), *flags, "--workers", "1", "--", "verify"]) == 0
    assert json.loads(target.read_text())["tasks"] == 1
    (tmp_path / "made").mkdir()
    copy(SHIPPED / "explore.rrd", tmp_path / "made" / "explore.rrd")
    inside = tmp_path / "made" / "out" / "files"
    inside.mkdir(parents=True)
    copy(SHIPPED / "tension.rrd", inside / "own.rrd")
    options = SweepConfig.of(source=tmp_path / "made", out=inside.parent, where="size > 0", command=("verify",))
    assert find_sources(options) == [tmp_path / "made" / "explore.rrd"]  # what the sweep wrote is none
    (row,) = pq.read_table(tmp_path / "out" / "results.parquet").to_pylist()
    assert (Path(row["source"]).name, row["ok"], row["checked"]) == ("explore.rrd", True, True)
