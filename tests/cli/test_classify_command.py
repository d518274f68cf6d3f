"""`deformscope classify` and `deformscope.classify`, as a user runs them on a table of their own."""

import errno
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import deformscope as ds
from deformscope.cli import main
from deformscope.images import encode_png
from deformscope.pictures.figures import canvas, png_of
from tests.cases import Capture, Patch
from tests.pictures.test_report import Page
from tests.stages.squeeze.trials import blobs, two_modalities

FAST = ["--splits", "6", "--curve-splits", "3", "--viewer", "none"]


def write(path: Path, seed: int = 0, **more: Any) -> Path:
    table = two_modalities(seed=seed)
    np.savez(path, label=table.label, group=table.group, **table.modalities, **more)  # type: ignore[arg-type]
    return path


@pytest.fixture(scope="module", autouse=True)
def drawn_once() -> Iterator[None]:
    """Each kind of picture is drawn once, roughly; from then on it is a pixel: most of the time would go into them."""
    drawn: set[str] = set()
    pixel = encode_png(np.zeros((1, 1, 3), np.uint8))

    def draw(figure: Figure, dpi: int) -> bytes:
        kind = sys._getframe(1).f_code.co_name
        if kind in drawn:
            return pixel
        drawn.add(kind)
        return png_of(figure, dpi)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deformscope.pictures.classification.DPI", 30)
        patch.setattr("deformscope.pictures.classification.canvas", lambda width, height, **_: canvas(width, height))
        patch.setattr("deformscope.pictures.classification.png_of", draw)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table with everything that it may have, evaluated once."""
    made = tmp_path_factory.mktemp("classify")
    table = two_modalities()
    series = np.stack([0.3 * table.modalities["touch"], table.modalities["touch"]], axis=1)
    write(made / "t.npz", kind=np.array(["carton", "bottle"])[np.arange(64) % 2], **{"series.touch": series})
    files = ["--json", str(made / "t.json"), "--report", str(made / "report"), "--save", str(made / "m.npz")]
    assert main(["classify", str(made / "t.npz"), *FAST, *files, "--record", str(made / "t.rrd")]) == 0
    return made


def test_the_json_is_the_public_list(folder: Path) -> None:
    found = json.loads((folder / "t.json").read_text())
    assert isinstance(found, list)
    for one in found:
        assert set(one) >= {"modality", "method", "accuracy", "interval", "chance", "confusion", "labels", "splits"}
        assert one["labels"] == ["empty", "flour", "rice", "water"]
        confusion = np.array(one["confusion"])
        assert confusion.shape == (4, 4)
        assert one["interval"][0] <= one["accuracy"] <= one["interval"][1]
        assert 1.0 < one["independent_trials"] < sum(one["tested_trials"])
        assert one["chance"] == pytest.approx(0.25, abs=0.02)
        if one["protocol"] == "stratified":
            assert np.trace(confusion) / confusion.sum() == pytest.approx(one["accuracy"], abs=0.01)
    assert {one["modality"] for one in found} == {"touch", "vision", "touch+vision"}
    methods = {one["method"] for one in found}
    assert methods >= {"knn", "qda", "linear", "pooled", "late-fusion"}
    assert {one["protocol"] for one in found} == {"random", "stratified", "group", "transfer"}
    (best,) = (one for one in found if one["recommended"])
    assert (best["method"], best["protocol"]) == ("late-fusion", "group")
    assert {one["with_modality"] for one in best["comparisons"]} == {"touch", "vision", "touch+vision"}
    knn = next(one for one in found if (one["modality"], one["method"], one["protocol"]) == ("touch", "knn", "group"))
    assert len(knn["learning_curve"]) == 5
    assert knn["k_means"]["clusters"] == 4
    pooled = next(one for one in found if one["protocol"] == "group" and one["method"] == "pooled")
    assert [step["time_s"] for step in pooled["steps"]] == [0.0, 0.1]


def test_the_report_has_the_figures_of_the_thesis(folder: Path) -> None:
    drawn = {path.stem for path in (folder / "report").glob("*.png")}
    assert drawn >= {"mean-touch", "clusters-vision", "curve", "confusion-knn", "confusion-qda", "raw-linear"}
    assert drawn >= {"accuracies", "fusion", "fused", "transfer", "reliability", "steps"}
    text = (folder / "report" / "classification.html").read_text()
    assert Page(text).open == []
    assert text.count("<img") == len(drawn)
    for words in ("Natural groupings", "Confusions", "Fusion", "Transfer", "Calibration", "Provenance", "late-fusion"):
        assert words in text


def test_the_saved_classifier_answers_as_the_library_s(folder: Path) -> None:
    new = two_modalities(seed=4).modalities
    loaded = ds.load_classifier(folder / "m.npz")
    result = ds.classify(folder / "t.npz", splits=6, curve_splits=3)
    found = json.loads((folder / "t.json").read_text())
    np.testing.assert_array_equal(loaded.predict_proba(new), result.model().predict_proba(new))
    assert loaded.promised["accuracy"] == pytest.approx(result.accuracy)
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False))["classification"] == found
    assert "right (90% interval" in repr(result)
    assert result._repr_html_().count("<img") == 3


def test_arrays_of_a_script_with_one_modality_and_merged_classes() -> None:
    table = two_modalities()
    arrays = {"label": table.label, "touch": table.modalities["touch"]}
    result = ds.classify(arrays, merge={"granular": ["flour", "rice"]}, splits=4, curve_splits=0)
    assert result.evaluation.table.classes == ("empty", "granular", "water")
    assert result.evaluation.best.method == "pooled"
    assert result.evaluation.protocol == "stratified"
    with pytest.raises(ds.InputError, match="splits of 2 or more"):
        ds.classify(arrays, splits=1)


def test_many_classes_of_few_trials_and_a_page_alone(tmp_path: Path, capsys: Capture) -> None:
    table = blobs(classes=16, each=4, columns=12, apart=6.0)
    np.savez(tmp_path / "t.npz", label=table.label, touch=table.modalities["touch"])
    page = tmp_path / "r.html"
    assert main(["classify", str(tmp_path / "t.npz"), *FAST, "--quick", "--report", str(page), "--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert {one["splits"] for one in json.loads(out)} == {6}
    assert "fewer than 5 trials of c00" in err
    assert "stratified splits" in page.read_text()


def test_a_disk_that_is_full_for_the_classifier_does_not_cost_the_json(tmp_path: Path, monkeypatch: Patch) -> None:
    def no_room(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("deformscope.files.classifier_file.save_classifier", no_room)
    found = tmp_path / "t.json"
    files = ["--json", str(found), "--save", str(tmp_path / "m.npz")]
    assert main(["classify", str(write(tmp_path / "t.npz")), *FAST, "--quick", "--splits", "2", *files]) != 0
    assert json.loads(found.read_text())


def test_what_cannot_be_used_is_refused_in_one_line(tmp_path: Path, capsys: Capture) -> None:
    table = two_modalities()
    twice = {name: values.copy() for name, values in table.modalities.items()}
    for values in twice.values():
        values[40] = values[2]
    np.savez(tmp_path / "twice.npz", label=table.label, **twice)  # type: ignore[arg-type]
    good = str(write(tmp_path / "t.npz"))
    for arguments, said in (
        ([str(tmp_path / "twice.npz")], "row 3 = row 41 with the same features | try: leave the copies out"),
        ([good, "--modalities", "smell"], "modalities out of touch, vision; got smell"),
        ([good, "--merge", "liquid"], "--merge NAME=A,B"),
        ([good, "--merge", "liquid=oil,water"], "got 'oil'"),
        ([good, "--transfer", "a-b"], "--transfer TRAINED:TESTED"),
        ([good, "--transfer", "box:*"], "got 'box'"),
        ([good, "--splits", "1"], "a --splits of 2 or more"),
        ([good, "--save", good], "a file after --save that is no input"),
        ([good, "--save", "m.pkl"], "ends in .npz after --save"),
        ([good, "--report", "r.pdf"], "ends in .html after --report"),
        ([str(tmp_path)], "a data set of squeezes, with its index.parquet; got a folder without it"),
    ):
        assert main(["classify", *FAST, *arguments]) == 2, arguments
        refusal = capsys.readouterr().err
        assert said in refusal
        assert len(refusal.splitlines()) == 1
    drop = [str(tmp_path / "twice.npz"), "--duplicates", "drop", "--splits", "2", "--quick", "--viewer", "none"]
    assert main(["classify", *drop]) == 2  # equal trials with two labels are an error of the table
    assert "one label" in capsys.readouterr().err
