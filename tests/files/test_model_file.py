"""Model files: written and read alike, open, and refused when they are none."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.files.model_file import load_model, save_model
from deformscope.stages.msm.poke import Law, Tip
from deformscope.stages.poke.fitted import FittedModel, Rival
from deformscope.stages.poke.poke_fit import DentResidual


def model() -> FittedModel:
    return FittedModel(
        body="layers",
        rest=np.random.default_rng(0).normal(size=(20, 3)),
        law=Law(0.3, 0.8, 4),
        spacing=0.005,
        toward=np.array([0.0, 0.0, -1.0]),
        tip=Tip("flat", (0.02, 0.03), slips=False),
        thickness=0.05,
        places=np.array([[0.1, 0.2, 0.05], [0.3, 0.2, 0.05]]),
        stiffness=np.array([20.0, 50.0]),
        field_kind="materials",
        left_out=np.array([0.1, -0.2]),
        surface_error=0.02,
        held_out=float("nan"),
        fitted_depth=0.003,
        fitted_strain=0.15,
        rivals=(Rival(Law(0.4, 1.0, 3), np.array([25.0, 60.0]), 0.03),),
        provenance={"sources": ["a.npz"]},
    )


@pytest.mark.parametrize("rivals", [True, False])
@pytest.mark.parametrize("lattice", [True, False])
def test_a_model_comes_back_as_it_was(tmp_path: Path, rivals: bool, lattice: bool) -> None:
    before = model()
    if not rivals:
        before = dataclasses.replace(before, rivals=())
    if lattice:
        before = dataclasses.replace(before, shape=(4, 5), cell=np.arange(20), body="particles", thickness=None)
    if not lattice:
        before = dataclasses.replace(before, residual=DentResidual(np.arange(8.0), -np.arange(8.0), 0.05))
    save_model(before, tmp_path / "m.npz")
    after = load_model(tmp_path / "m.npz")
    for field in dataclasses.fields(FittedModel):
        one, other = getattr(before, field.name), getattr(after, field.name)
        if field.name == "rivals":
            assert [(r.law, r.surface_error) for r in one] == [(r.law, r.surface_error) for r in other]
            for r, s in zip(one, other, strict=True):
                np.testing.assert_array_equal(r.stiffness, s.stiffness)
        elif field.name == "residual" and one is not None:
            assert (other.thickness, other.outward.tolist()) == (one.thickness, one.outward.tolist())
            assert other.upward.tolist() == one.upward.tolist()
        elif isinstance(one, np.ndarray | float):
            np.testing.assert_array_equal(one, other)
        else:
            assert one == other, field.name


def test_the_file_is_plain_arrays_and_json(tmp_path: Path) -> None:
    save_model(model(), tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
        assert str(file["format"]) == "deformscope model 1"
        told = json.loads(str(file["told"]))
    assert told["law"]["beta"] == 0.3
    assert told["held_out"] is None
    assert list(tmp_path.iterdir()) == [tmp_path / "m.npz"]


def test_what_is_no_model_is_refused_in_one_line(tmp_path: Path) -> None:
    good = tmp_path / "m.npz"
    save_model(model(), good)
    cases = {
        "nothing.npz": (None, "got no such file"),
        "text.npz": (b"hello", "a damaged file"),
        "cut.npz": (good.read_bytes()[:300], "a damaged file"),
    }
    for name, (content, said) in cases.items():
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=said):
            load_model(tmp_path / name)
    np.savez(tmp_path / "pair.npz", rest=np.zeros((3, 3)), deformed=np.zeros((3, 3)))
    with pytest.raises(InputError, match="a pair file"):
        load_model(tmp_path / "pair.npz")
    np.savez(tmp_path / "other.npz", format=np.array("deformscope model 9"), told=np.array("{}"))
    with pytest.raises(InputError, match="format 'deformscope model 1'"):
        load_model(tmp_path / "other.npz")
    np.savez(tmp_path / "less.npz", format=np.array("deformscope model 1"), told=np.array("{}"))
    with pytest.raises(InputError, match="complete model file"):
        load_model(tmp_path / "less.npz")
