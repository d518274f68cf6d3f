"""Classifier files: what is loaded answers as what was trained, and what is none is refused in one line."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.files.classifier_file import FORMAT, classifier_arrays, load_classifier, save_classifier
from deformscope.stages.squeeze.model import ContentModel, fit_model
from tests.stages.squeeze.trials import stepped, two_modalities


@pytest.fixture(scope="module")
def model() -> ContentModel:
    table = two_modalities()
    series = np.stack([0.1 * table.modalities["touch"], table.modalities["touch"]], axis=1)
    table = dataclasses.replace(table, series={"touch": series}, settings={"end": "tip"})
    return fit_model(table, by_group=False, promised={"accuracy": 0.9}, provenance={"source": "a"})


def test_a_loaded_model_answers_to_the_bit_as_the_trained_one(tmp_path: Path, model: ContentModel) -> None:
    path = tmp_path / "m.npz"
    save_classifier(model, path)
    loaded = load_classifier(path)
    new = two_modalities(seed=5).modalities
    np.testing.assert_array_equal(loaded.predict_proba(new), model.predict_proba(new))
    for step in (0, 1):
        np.testing.assert_array_equal(
            loaded.predict_step("touch", step, new["touch"]), model.predict_step("touch", step, new["touch"])
        )
    assert loaded.labels == model.labels
    assert (loaded.settings, loaded.promised, loaded.provenance) == ({"end": "tip"}, {"accuracy": 0.9}, {"source": "a"})
    assert list(tmp_path.iterdir()) == [path]


def test_the_fusion_of_each_step_is_kept_and_a_file_without_it_answers_by_touch(tmp_path: Path) -> None:
    made, path = fit_model(stepped(), by_group=False), tmp_path / "m.npz"
    save_classifier(made, path)
    new = {name: values[:, 6] for name, values in stepped(seed=5).series.items()}
    loaded = load_classifier(path)
    assert loaded.predict_at(0.6, new)[0] == ("tactile", "vision_small")
    np.testing.assert_array_equal(loaded.predict_at(0.6, new)[1], made.predict_at(0.6, new)[1])
    arrays = classifier_arrays(made)
    told = json.loads(str(arrays["told"]))
    del told["step_fusion"], told["steps"][1:]  # as it was written before
    np.savez(path, **arrays | {"told": np.array(json.dumps(told))})
    assert load_classifier(path).predict_at(0.6, new)[0] == ("tactile",)


def test_the_file_is_plain_arrays_and_json(tmp_path: Path, model: ContentModel) -> None:
    save_classifier(model, tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
        told = json.loads(str(file["told"]))
        assert str(file["format"]) == "deformscope classifier 1"
        assert all(file[name].dtype.kind in "fiubU" for name in file.files)
    assert [one["name"] for one in told["modalities"]] == ["touch", "vision"]
    assert told["modalities"][1]["columns"] == 4


def test_damage_never_goes_unnoticed(tmp_path: Path, model: ContentModel) -> None:
    """Any flipped byte is refused, or one of the archive that says nothing of the arrays."""
    path = tmp_path / "m.npz"
    save_classifier(model, path)
    whole = path.read_bytes()
    new = two_modalities(seed=5).modalities
    wanted = model.predict_proba(new)
    refused = 0
    for place in np.linspace(0, len(whole) - 1, 60).astype(int):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x41]) + whole[place + 1 :])
        try:
            np.testing.assert_array_equal(load_classifier(path).predict_proba(new), wanted)
        except InputError as error:
            refused += "\n" not in str(error)
    assert refused > 45
    for length in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError):
            load_classifier(path)


def refusal(path: Path, arrays: dict[str, Any]) -> str:
    np.savez(path, **arrays)
    with pytest.raises(InputError) as found:
        load_classifier(path)
    assert "\n" not in str(found.value)
    return str(found.value)


def test_what_is_foreign_or_newer_is_refused_in_one_line(tmp_path: Path, model: ContentModel) -> None:
    path = tmp_path / "m.npz"
    good = classifier_arrays(model)
    newer = np.array(FORMAT.replace("1", "2"))
    assert "got 'deformscope classifier 2' | try: a newer deformscope" in refusal(path, good | {"format": newer})
    assert "got a pair file" in refusal(path, {"rest": [0], "deformed": [0], "held": [0]})
    assert "got an .npz of force" in refusal(path, {"force": [0]})
    calibrated = {"format": np.array("deformscope model 1"), "told": np.array("{}")}
    assert "got 'deformscope model 1'" in refusal(path, calibrated)
    path.write_bytes(b"not a classifier")
    with pytest.raises(InputError, match="a damaged file"):
        load_classifier(path)
    with pytest.raises(InputError, match="got no such file"):
        load_classifier(tmp_path / "none.npz")


def test_arrays_that_do_not_fit_together_are_refused(tmp_path: Path, model: ContentModel) -> None:
    path = tmp_path / "m.npz"
    good = classifier_arrays(model)
    told = json.loads(str(good["told"]))
    for name, value in (
        ("fusion.weight", np.ones((3, 4))),
        ("fusion.offset", np.full(4, np.nan)),
        ("m0.used", np.ones(3)),
        ("m0.scale", np.zeros(3)),
        ("m0.directions", np.ones((2, 3))),
        ("m0.c0.points", np.ones((0, 1))),
        ("m1.c0.target", np.full(len(good["m1.c0.target"]), 9)),
        ("m1.c3.slope", np.ones((4, 7))),
        ("s0.1.weight", -good["s0.1.weight"]),
    ):
        assert name in good
        assert "a complete classifier file" in refusal(path, good | {name: value}), name
        assert "a complete classifier file" in refusal(path, {key: one for key, one in good.items() if key != name})
    for change in (
        {"labels": ["a", "a", "b", "c"]},
        {"labels": ["a"]},
        {"modalities": []},
        {"step_s": 0},
        {"steps": 1},
    ):
        assert "a complete classifier file" in refusal(path, good | {"told": np.array(json.dumps(told | change))}), (
            change
        )
    assert "a complete classifier file" in refusal(path, good | {"told": np.array("{")})
