"""`--picture` and `--report` of `calibrate`: whole files for every kind of source, refused where they cannot be."""

import json
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from deformscope.cli import main
from deformscope.stages.msm import reference
from tests.cases import Capture, Patch
from tests.pictures.test_report import Page
from tests.stages import reference_states
from tests.stages.bodies import pushed

FAST = ["--candidates", "12", "--viewer", "none"]


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """A pair of known beta 0.6, whose name would be markup if it were not escaped."""
    body = pushed((5, 6), np.random.default_rng(1))
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    deformed, _ = reference_states.relax(spec, body.held_position, beta=0.6)
    path = tmp_path / "a<b>&c.npz"
    np.savez(path, rest=body.rest, deformed=deformed, held=body.held)
    return path


def summaries(arguments: list[str], folder: Path) -> tuple[np.ndarray, Page, str]:
    """What a command has drawn and told."""
    assert main([*arguments, *FAST, "--picture", str(folder / "p.png"), "--report", str(folder / "r.html")]) == 0
    picture = cv2.imread(str(folder / "p.png"))
    assert picture.std() > 20
    text = (folder / "r.html").read_text(encoding="utf-8")
    page = Page(text)
    page.assert_self_contained()
    return picture, page, text


def test_pair(pair: Path, tmp_path: Path, monkeypatch: Patch, capsys: Capture) -> None:
    monkeypatch.setattr(sys, "argv", ["/somewhere/deformscope", "calibrate", "beta", str(pair), "--seed", "3"])
    json_file = tmp_path / "found.json"
    arguments = ["calibrate", "beta", str(pair), "--json", str(json_file), "--seed", "3"]
    picture, page, text = summaries(arguments, tmp_path)
    assert picture.shape[1] == 1870
    found = json.loads(json_file.read_text())
    assert page.tags.count("img") == 3
    assert found["verdict_text"] in page.words
    assert text.index(found["verdict_text"]) < text.index("<table>")  # the verdict in plain words comes first
    assert found["stiffness_text"] in page.words
    assert f"{found['value']:.4g}" in page.words
    assert "a<b>&c.npz" in page.words
    assert "a<b>" not in text
    assert f"deformscope calibrate beta '{pair}' --seed 3" in page.words
    for said in ("cluster_size", "version of rerun-sdk", "The largest error is", "Calibration of beta: a<b>&c.npz"):
        assert said in page.words
    shown = capsys.readouterr()
    assert f"report: {tmp_path / 'r.html'}" in shown.err
    assert f"picture: {tmp_path / 'p.png'}" in shown.err


@pytest.mark.slow  # one pair and pokes have the same tables
def test_several_pairs(pair: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.npz"
    shutil.copy(pair, other)
    apart, page, _ = summaries(["calibrate", "beta", str(pair), str(other)], tmp_path)
    assert page.tags.count("img") == 6
    assert page.words.count("identified: beta is") >= 4
    assert "other.npz: The largest error is" in page.words
    assert "Calibration of beta: 2 pairs" in page.words
    assert apart.shape[0] > 1000  # two rows


@pytest.mark.slow
def test_several_pairs_jointly(pair: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.npz"
    shutil.copy(pair, other)
    report = tmp_path / "joint.html"
    assert main(["calibrate", "beta", str(pair), str(other), "--joint", *FAST, "--report", str(report)]) == 0
    assert Page(report.read_text(encoding="utf-8")).tags.count("img") == 5


@pytest.mark.slow
def test_theta_of_a_volume(tmp_path: Path) -> None:
    body = pushed((3, 3, 3), np.random.default_rng(0))
    np.savez(tmp_path / "c.npz", rest=body.rest, deformed=1.02 * body.rest, held=body.held)
    _, page, _ = summaries(["calibrate", "theta", str(tmp_path / "c.npz")], tmp_path)
    assert "Calibration of theta: c.npz" in page.words
    assert page.tags.count("img") == 3


@pytest.mark.slow
def test_images_show_the_last_frame(tmp_path: Path) -> None:
    _, page, _ = summaries(["calibrate", "beta", "sample:tension", "--stride", "3"], tmp_path)
    assert "sample:tension" in page.words
    assert " px" in page.words
    assert "lost" in page.words


@pytest.mark.slow
def test_pokes_have_their_table(tmp_path: Path, capsys: Capture) -> None:
    pokes = []
    axes = np.meshgrid(np.linspace(0.02, 0.1, 9), np.linspace(0.02, 0.1, 9), indexing="ij")
    rest = np.column_stack([np.stack(axes, axis=-1).reshape(-1, 2), np.full(81, 0.03)])
    for number, at in enumerate(((0.05, 0.06), (0.07, 0.06))):
        away = np.linalg.norm(rest[:, :2] - at, axis=1)
        contact = np.flatnonzero(np.abs(rest[:, :2] - at).max(axis=1) < 0.0101)
        dent = 0.002 * np.exp(-((np.maximum(away - 0.01, 0.0) / 0.015) ** 2))
        dent[contact] = 0.002
        deformed = rest - dent[:, None] * np.array([0.0, 0.0, 1.0])
        pokes.append(str(tmp_path / f"poke{number}.npz"))
        np.savez(pokes[-1], rest=rest, deformed=deformed, held=contact, contact=contact, force_n=2.0)
    record = tmp_path / "run.rrd"
    arguments = ["calibrate", "beta", *pokes, "--thickness-m", "0.03", "--spacing-m", "0.01", "--cluster-size", "2"]
    told = tmp_path / "found.json"
    arguments += ["--theta", "0.3", "--record", str(record), "--json", str(told)]
    _, page, _ = summaries(arguments, tmp_path)
    found = json.loads(told.read_text())
    share = np.sqrt(np.mean([one["surface_error"] ** 2 for one in found["pokes"]]))
    assert found["identifiability"]["misfit_m"] == pytest.approx(share * 0.002 / np.sqrt(3))  # in metres, as it says
    assert record.exists()
    assert f"{record} (" in capsys.readouterr().out  # and not the name that it had while it was written
    for said in (
        "middle of the touched points x, y [m]",
        "0.05, 0.06",
        "0.07, 0.06",
        "Cluster sizes tried",
        "N/m",
        "poke1.npz",
    ):
        assert said in page.words


@pytest.mark.parametrize(
    ("flag", "name", "expected"),
    [
        ("--picture", "p.jpg", "ends in .png after --picture"),
        ("--report", "r.pdf", "ends in .html after --report"),
        ("--report", "missing/r.html", "a folder for the file of --report"),
    ],
)
def test_what_cannot_be_written_is_refused_at_once(
    pair: Path, tmp_path: Path, capsys: Capture, flag: str, name: str, expected: str
) -> None:
    assert main(["calibrate", "beta", str(pair), flag, str(tmp_path / name)]) == 2
    assert expected in capsys.readouterr().err


def test_plane_and_space_do_not_fit_into_one_recording(pair: Path, tmp_path: Path, capsys: Capture) -> None:
    body = pushed((3, 3, 3), np.random.default_rng(0))
    other = tmp_path / "c.npz"
    np.savez(other, rest=body.rest, deformed=1.02 * body.rest, held=body.held)
    assert main(["calibrate", "beta", str(pair), str(other), *FAST, "--record", str(tmp_path / "r.rrd")]) == 2
    assert "all in the plane, or all in space" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.rrd"))


def test_a_source_is_not_written_over(pair: Path, capsys: Capture) -> None:
    copy = pair.with_suffix(".html")
    shutil.copy(pair, copy)
    before = copy.read_bytes()
    assert main(["calibrate", "beta", str(copy), "--report", str(copy)]) == 2
    assert copy.read_bytes() == before
    assert "--report" in capsys.readouterr().err
