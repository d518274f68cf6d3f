"""Model files: the result of a calibration for predictions, as one `.npz` of plain arrays and a line of JSON.

    format            "deformscope model 1"
    told              JSON text: body, law, rivals, tip, errors, provenance
    rest, toward, fixed, places, stiffness, left_out, rival_stiffness; shape and cell where the particles have a lattice
    residual (2, k) outward and upward, the law's residual around a tip, common to all pokes

Nothing in it is executed when it is read (no pickle)."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.file_io import replacing
from deformscope.files.arrays_file import Arrays, described, lattice
from deformscope.stages.msm.poke import Law, Tip
from deformscope.stages.poke.fitted import FittedModel, Rival
from deformscope.stages.poke.poke_fit import DentResidual

VERSION = 1
FORMAT = f"deformscope model {VERSION}"
ARRAYS = ("rest", "toward", "fixed", "places", "stiffness", "left_out")


def save_model(model: FittedModel, path: Path) -> None:
    """Write a model; an existing file is replaced in one step."""
    described: dict[str, Any] = {
        "body": model.body,
        "law": dataclasses.asdict(model.law),
        "spacing_m": model.spacing,
        "thickness_m": model.thickness,
        "tip": None if model.tip is None else dataclasses.asdict(model.tip),
        "field": model.field_kind,
        "surface_error": _number(model.surface_error),
        "held_out": _number(model.held_out),
        "fitted_depth_m": _number(model.fitted_depth),
        "fitted_strain": _number(model.fitted_strain),
        "rivals": [{"law": dataclasses.asdict(one.law), "surface_error": one.surface_error} for one in model.rivals],
        "provenance": dict(model.provenance),
    }
    arrays: dict[str, Any] = {name: getattr(model, name) for name in ARRAYS}
    rivals = [one.stiffness for one in model.rivals]
    arrays["rival_stiffness"] = np.reshape(rivals, (len(rivals), len(model.stiffness)))
    if model.shape is not None and model.cell is not None:
        arrays["shape"], arrays["cell"] = np.array(model.shape), model.cell
    if model.residual is not None:
        arrays["residual"] = np.stack([model.residual.outward, model.residual.upward])
    with replacing(path) as file:
        np.savez_compressed(file, format=np.array(FORMAT), told=np.array(json.dumps(described)), **arrays)


def load_model(path: Path) -> FittedModel:
    """Read a model. Raises InputError for another kind of file, a damaged one, or another format."""
    return described(path, "model", VERSION, "deformscope calibrate beta ... --save FILE.npz", _model)


def _model(described: Mapping[str, Any], found: Arrays) -> FittedModel:
    tip = described["tip"]
    rivals = zip(described["rivals"], found["rival_stiffness"], strict=True)
    shape, cell = lattice(found, found["rest"]) if "shape" in found else (None, None)
    residual = None
    if "residual" in found and described["thickness_m"] is not None:
        outward, upward = found["residual"]
        residual = DentResidual(outward, upward, float(described["thickness_m"]))
    return FittedModel(
        body=described["body"],
        law=Law(**described["law"]),
        spacing=float(described["spacing_m"]),
        thickness=described["thickness_m"],
        tip=None if tip is None else Tip(tip["shape"], tuple(tip["size"]), bool(tip["slips"])),
        field_kind=described["field"],
        surface_error=_or_nan(described["surface_error"]),
        held_out=_or_nan(described["held_out"]),
        fitted_depth=_or_nan(described.get("fitted_depth_m")),
        fitted_strain=_or_nan(described.get("fitted_strain")),
        rivals=tuple(Rival(Law(**one["law"]), np.asarray(k), float(one["surface_error"])) for one, k in rivals),
        residual=residual,
        provenance=described["provenance"],
        shape=shape,
        cell=cell,
        **{name: found[name] for name in ARRAYS},
    )


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else float(value)
