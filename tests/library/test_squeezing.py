"""`ds.squeeze` and `ds.open_dataset`, on a simulated clock."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deformscope as ds
from deformscope.cli import main
from deformscope.files.classifier_file import save_classifier
from tests.cases import Capture, Patch
from tests.experiments.toy_squeeze import ToySqueeze, use_toy_squeeze


@pytest.fixture(autouse=True)
def toy(monkeypatch: Patch) -> dict[str, Any]:
    """What is squeezed is a toy; its content is a stiffness."""
    return use_toy_squeeze(monkeypatch)


def test_a_squeeze_gives_the_json_of_the_command_and_its_features(tmp_path: Path, capsys: Capture) -> None:
    given = ["squeeze", "lab:containers", "--content", "rice", "--container", "box-07", "--viewer", "none"]
    assert main([*given, "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    squeezed = ds.squeeze("lab:containers", content="rice", container="box-07")
    assert capsys.readouterr() == ("", "")
    assert squeezed.to_dict() == found
    assert squeezed.features["tactile"].shape == (72,)
    assert {name: len(values) for name, values in squeezed.features.items()} == found["features"]
    assert squeezed.physical["force_n"] > 0.0
    assert squeezed.content == "rice"
    assert squeezed.named is None
    assert "first contact" in str(squeezed)
    assert repr(squeezed).startswith("<squeeze lab-0-box-07-00000: ")


def test_a_data_set_grows_is_opened_classified_and_names_the_next_one(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    for number in range(4):
        for content in ("rice", "empty"):
            where = {"dataset": folder, "session": "s", "keep": "features"}
            ds.squeeze("lab:containers", content=content, container=f"box-{number}", seed=number, **where)  # type: ignore[arg-type]
    opened = ds.open_dataset(folder)
    assert len(opened) == 8
    assert {one.content for one in opened.trials} == {"rice", "empty"}
    assert opened.to_dict()["trials"][0]["container"] == "box-0"
    assert "4 trials, 4 containers" in str(opened)
    table = opened.table()
    assert table.modalities["tactile"].shape == (8, 72)
    save_classifier(ds.classify(table.of(["tactile"]), splits=4, curve_splits=0).model(), tmp_path / "m.npz")
    squeezed = ds.squeeze("lab:containers", model=tmp_path / "m.npz", seed=3)
    assert squeezed.named == "empty"  # as soft as the toy is without a content
    assert squeezed.posterior["empty"] == pytest.approx(max(squeezed.posterior.values()))
    assert np.isclose(sum(squeezed.posterior.values()), 1.0)


def test_a_squeeze_that_was_stopped_is_an_error_and_a_discarded_trial(tmp_path: Path, toy: dict[str, Any]) -> None:
    toy["squeeze"] = dataclasses.replace(ToySqueeze().squeeze, saturation_counts=200)
    with pytest.raises(ds.InputError, match="tactile array saturated"):
        ds.squeeze("lab:containers", content="rice", container="box-1", dataset=tmp_path / "d")
    (entry,) = ds.open_dataset(tmp_path / "d").trials
    assert entry.discarded is not None
    assert ds.open_dataset(tmp_path / "d").recording(entry.trial).is_file()


def test_what_cannot_be_used_is_one_error_in_the_words_of_python(tmp_path: Path) -> None:
    with pytest.raises(ds.InputError, match="a data set of squeezes"):
        ds.open_dataset(tmp_path)
    with pytest.raises(ds.InputError, match="content NAME, or model MODEL to name it"):
        ds.squeeze("lab:containers")
