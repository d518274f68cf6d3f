"""Classifier files: the result of `deformscope classify --save`, as one `.npz` of plain arrays and a line of JSON.

    format      "deformscope classifier 1"
    told        JSON text: labels, modalities with their columns and classifiers, steps, settings of the features,
                the accuracy that the evaluation found, provenance
    fusion.weight (M, C), fusion.offset (C,): how reliable each modality is for each class; step_fusion.3.weight...: the
    same for the modalities with steps at step 3, where there are several
    m0.used (p,), m0.mean, m0.scale, m0.centre (q,), m0.directions (q, d), m0.weight (K, C), m0.offset (C,), and of its
    classifiers m0.c0.points..., in the order of `told`; s0.3.used...: the same for step 3 of the first modality with
    steps

Nothing in it is executed when it is read (no pickle)."""

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.file_io import replacing
from deformscope.files.arrays_file import Arrays, described
from deformscope.stages.squeeze.classifiers import NAMES, Classifier, Linear, Neighbours, Quadratic
from deformscope.stages.squeeze.components import Scaling
from deformscope.stages.squeeze.fusion import Expert, Member, Pool
from deformscope.stages.squeeze.model import ContentModel, ModalityModel

VERSION = 1
FORMAT = f"deformscope classifier {VERSION}"
HOW = "deformscope classify TABLE --save FILE.npz"
KINDS: dict[str, type[Classifier]] = {
    "knn": Neighbours,
    **dict.fromkeys(("qda", "qda-raw"), Quadratic),
    "linear": Linear,
}


def classifier_arrays(model: ContentModel) -> dict[str, npt.NDArray[Any]]:
    """A model as the arrays of its file, by name; shapes as in `_take` and `_member`."""
    arrays: dict[str, npt.NDArray[Any]] = {"fusion.weight": model.fusion.weight, "fusion.offset": model.fusion.offset}
    described: dict[str, Any] = {
        "labels": model.labels,
        "modalities": [
            _put(arrays, f"m{index}", name, one) for index, (name, one) in enumerate(model.modalities.items())
        ],
        "steps": [
            {
                "modality": name,
                "models": [_put(arrays, f"s{index}.{step}", name, one) for step, one in enumerate(models)],
            }
            for index, (name, models) in enumerate(model.steps.items())
        ],
        "step_fusion": len(model.step_fusion),
        "step_s": model.step_s,
        "settings": dict(model.settings),
        "promised": dict(model.promised),
        "provenance": dict(model.provenance),
    }
    for step, pool in enumerate(model.step_fusion):
        arrays |= {f"step_fusion.{step}.weight": pool.weight, f"step_fusion.{step}.offset": pool.offset}
    return {"format": np.array(FORMAT), "told": np.array(json.dumps(described, allow_nan=False)), **arrays}


def _put(arrays: dict[str, npt.NDArray[Any]], prefix: str, name: str, model: ModalityModel) -> dict[str, Any]:
    """Adds a modality's arrays; returns their description for the JSON."""
    own = {"used": model.scaling.used, "mean": model.scaling.mean, "scale": model.scaling.scale}
    own |= {"centre": model.centre, "directions": model.directions}
    own |= {"weight": model.expert.pool.weight, "offset": model.expert.pool.offset}
    arrays.update({f"{prefix}.{key}": value for key, value in own.items()})
    members = []
    for index, one in enumerate(model.expert.members):
        described: dict[str, Any] = {"name": one.name, "columns": one.columns}
        for field in fields(one.classifier):
            value = getattr(one.classifier, field.name)
            if isinstance(value, np.ndarray):
                arrays[f"{prefix}.c{index}.{field.name}"] = value
            else:
                described[field.name] = value
        members.append(described)
    return {"name": name, "columns": model.columns, "classifiers": members}


def save_classifier(model: ContentModel, path: Path) -> None:
    """Write a model; an existing file is replaced when the new one is complete."""
    with replacing(path) as file:
        np.savez_compressed(file, **classifier_arrays(model))  # type: ignore[arg-type]  # numpy's stub


def load_classifier(path: Path) -> ContentModel:
    """Read a model. Raises InputError, in one line, for another kind of file, a damaged one, or another format."""
    return described(path, "classifier", VERSION, HOW, _model)


def _model(described: Mapping[str, Any], found: Arrays) -> ContentModel:
    labels = tuple(described["labels"])
    if len(labels) < 2 or len(set(labels)) < len(labels) or not all(isinstance(one, str) for one in labels):
        raise ValueError("list of labels")
    classes = len(labels)
    modalities = {one["name"]: _take(found, f"m{i}", one, classes) for i, one in enumerate(described["modalities"])}
    if not modalities or len(modalities) < len(described["modalities"]):
        raise ValueError("list of modalities")
    steps = {}
    for index, one in enumerate(described["steps"]):
        if one["modality"] in steps or not one["models"]:
            raise ValueError("list of steps")
        models = [_take(found, f"s{index}.{step}", each, classes) for step, each in enumerate(one["models"])]
        steps[one["modality"]] = tuple(models)
    fusion = _pool(found, "fusion", len(modalities), classes)
    fused = range(int(described.get("step_fusion", 0)))  # files of before have none
    step_fusion = tuple(_pool(found, f"step_fusion.{step}", len(steps), classes) for step in fused)
    step_s = float(described["step_s"])
    if not (np.isfinite(step_s) and step_s > 0.0):
        raise ValueError("step_s")
    about: list[Mapping[str, object]] = [described["settings"], described["promised"], described["provenance"]]
    if not all(isinstance(one, dict) for one in about):
        raise ValueError("settings, promised or provenance")
    settings, promised, provenance = about
    return ContentModel(
        labels,
        modalities,
        fusion,
        steps,
        step_fusion,
        step_s,
        settings=settings,
        promised=promised,
        provenance=provenance,
    )


def _take(found: Arrays, prefix: str, described: Mapping[str, Any], classes: int) -> ModalityModel:
    used = _array(found, f"{prefix}.used", "b", (int(described["columns"]),))
    width = int(used.sum())
    mean, scale, centre = (_array(found, f"{prefix}.{one}", "f", (width,)) for one in ("mean", "scale", "centre"))
    if not (scale > 0.0).all():
        raise ValueError(f"{prefix}.scale")
    directions = _array(found, f"{prefix}.directions", "f", (width, None))
    members = tuple(
        _member(found, f"{prefix}.c{index}", one, directions.shape[1], classes)
        for index, one in enumerate(described["classifiers"])
    )
    if not members:
        raise ValueError(f"{prefix} classifiers")
    pool = _pool(found, prefix, len(members), classes)
    return ModalityModel(Scaling(used, mean, scale), centre, directions, Expert(members, pool))


def _member(found: Arrays, prefix: str, described: Mapping[str, Any], size: int, classes: int) -> Member:
    name, columns = described["name"], described["columns"]
    if name not in NAMES or not (columns is None or (isinstance(columns, int) and columns >= 0)):
        raise ValueError(f"classifier {name!r} of {columns!r} columns")
    size = size if columns is None else min(size, columns)
    kind = KINDS[name]
    if kind is Quadratic:
        mean = _array(found, f"{prefix}.mean", "f", (classes, size))
        factor = _array(found, f"{prefix}.factor", "f", (classes, size, size))
        return Member(name, columns, Quadratic(mean, factor, _array(found, f"{prefix}.present", "b", (classes,))))
    if kind is Linear:
        slope = _array(found, f"{prefix}.slope", "f", (size, classes))
        offset = _array(found, f"{prefix}.offset", "f", (classes,))
        return Member(name, columns, Linear(slope, offset, _array(found, f"{prefix}.present", "b", (classes,))))
    points = _array(found, f"{prefix}.points", "f", (None, size))
    target = _array(found, f"{prefix}.target", "iu", (len(points),))
    k = described["k"]
    if not len(points) or target.min() < 0 or target.max() >= classes or not isinstance(k, int) or k < 1:
        raise ValueError(f"{prefix}.target or k")
    if described["classes"] != classes:
        raise ValueError(f"{prefix} classes")
    return Member(name, columns, Neighbours(points, target, k, classes))


def _pool(found: Arrays, prefix: str, members: int, classes: int) -> Pool:
    weight = _array(found, f"{prefix}.weight", "f", (members, classes))
    if (weight < 0.0).any():
        raise ValueError(f"{prefix}.weight")
    return Pool(weight, _array(found, f"{prefix}.offset", "f", (classes,)))


def _array(found: Arrays, name: str, kinds: str, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """The array of this name. shape: as it must be, (p, None) with any number of columns. Raises ValueError."""
    value = found[name]
    fits = value.ndim == len(shape) and all(
        want is None or want == got for want, got in zip(shape, value.shape, strict=True)
    )
    if not fits or value.dtype.kind not in kinds or not np.isfinite(value).all():
        raise ValueError(f"{name}: {value.dtype} of shape {value.shape}")
    return value
