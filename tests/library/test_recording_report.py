"""Figures of recordings, from what they hold alone, and what they lack."""

import json
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

from deformscope.cli import main
from deformscope.images import PNG_SIGNATURE
from deformscope.pictures import recorded
from deformscope.pictures.recorded import Curves, curves_png
from deformscope.recording.facts import run_rrd
from deformscope.runs.recording_report import RecordingReport, report_recording
from tests.cases import Capture, Patch

ROOT = Path(__file__).resolve().parents[2]


def pixels(png: bytes) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    assert png.startswith(PNG_SIGNATURE)
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image  # type: ignore[return-value]


def test_curves_show_events_and_phases() -> None:
    time_s = np.linspace(0.0, 2.0, 50)
    rising = Curves("force [N]", time_s, np.stack([time_s, 2.0 * time_s], axis=1), ("one", "other"))
    bare = pixels(curves_png([rising], "time [s]"))
    phases = pixels(curves_png([rising], "time [s]", phases=[("close", 0.5), ("hold", 1.5)]))
    events = pixels(curves_png([rising], "time [s]", [("first contact", 1.0)]))
    assert bare.shape == phases.shape == events.shape
    assert (bare != phases).any(axis=-1).mean() > 0.2  # most of the time is shaded
    assert 0.001 < (bare != events).any(axis=-1).mean() < 0.1  # a line and its name


def test_names_of_short_phases_stand_side_by_side(monkeypatch: Patch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(recorded, "png_of", lambda figure, dpi: drawn.append(figure) or b"")
    names = ("pre-shape", "look", "travel", "approach", "look", "air", "close", "squeeze", "hold", "open", "retreat")
    begin = (0.3, 2.0, 3.1, 9.4, 14.8, 15.5, 15.6, 17.0, 17.4, 18.2, 19.0)
    curves_png(
        [Curves("force [N]", np.linspace(0.0, 25.0, 50), np.zeros((50, 1)))], "", (), [*zip(names, begin, strict=True)]
    )
    (figure,) = drawn
    figure.canvas.draw()
    shown = [one for one in figure.axes[0].texts if isinstance(one, Annotation)]
    assert [one.get_text() for one in shown] == list(names)
    boxes = [Text.get_window_extent(one) for one in shown]
    assert not [pair for pair in combinations(boxes, 2) if pair[0].overlaps(pair[1])]


def test_a_recording_without_costs_opens_and_says_what_it_lacks(tmp_path: Path, capsys: Capture) -> None:
    path, out, told = tmp_path / "less.rrd", tmp_path / "less.html", tmp_path / "less.json"
    assert run_rrd("filter", "--drop-entity", "/cost", ROOT / "recordings" / "tension.rrd", "-o", path) == ""
    assert main(["report", str(path), "--out", str(out), "--json", str(told)]) == 0
    assert "costs of the stages" in capsys.readouterr().err
    assert json.loads(told.read_text())["lacks"] == ["costs of the stages"]
    assert "It lacks: costs of the stages." in out.read_text(encoding="utf-8")


def test_a_fit_of_images_shows_its_posterior(tmp_path: Path) -> None:
    found = report_recording(ROOT / "recordings" / "tension.rrd")
    assert found.sections[0].title == "Error and posterior"
    assert found.words.startswith("beta = ")
    assert all(pixels(one.png).size for one in found.figures())


def test_what_is_no_recording_is_refused_in_a_line(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "none.rrd"
    path.write_bytes(b"nothing")
    assert main(["report", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not path.with_suffix(".html").exists()


def samples() -> list[Path]:
    return [ROOT / "recordings" / f"{name}.rrd" for name in ("explore", "squeeze", "rig")]


SECTIONS = {
    "explore": ["Map", "Surface", "Touches", "Fields, touch by touch"],
    "squeeze": ["Over time", "Features"],
    "rig": ["Stages over time"],
}


@pytest.mark.parametrize("path", samples(), ids=lambda path: path.stem)
def test_each_sample_has_its_figures_and_lacks_nothing(path: Path) -> None:
    found = report_recording(path)
    assert isinstance(found, RecordingReport)
    assert found.lacks == []
    assert [one.title for one in found.sections] == SECTIONS[path.stem]
    for figure in found.figures():
        assert pixels(figure.png).std() > 5.0, figure.caption  # no empty picture
    page = found.page()
    assert page.count("<img") == len(found.figures())
    assert "It has every stage of its kind." in page
