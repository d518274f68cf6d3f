"""Labelled tables whose answers are known."""

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.squeeze.table import LabelledTable


def blobs(
    classes: int = 3, each: int = 12, columns: int = 6, apart: float = 3.0, *, seed: int = 0, groups: int = 4
) -> LabelledTable:
    """Normal clouds of unit variance about means that are `apart` deviations long; each group has one class."""
    rng = np.random.default_rng(seed)
    target = np.repeat(np.arange(classes), each)
    mean = rng.normal(size=(classes, columns))
    mean *= apart / np.linalg.norm(mean, axis=1, keepdims=True)
    label = np.array([f"c{one:02d}" for one in target])
    group = np.array([f"{label[row]}-{row % groups}" for row in range(len(target))])
    return LabelledTable(label, group, {"touch": mean[target] + rng.normal(size=(len(target), columns))})


def two_modalities(each: int = 16, *, seed: int = 0) -> LabelledTable:
    """Four classes: touch separates the first two from the last two, vision the odd ones from the even ones."""
    rng = np.random.default_rng(seed)
    target = np.repeat(np.arange(4), each)
    touch = 2.5 * (target // 2)[:, None] + rng.normal(size=(len(target), 3))
    vision = 2.5 * (target % 2)[:, None] + rng.normal(size=(len(target), 4))
    label = np.array(["empty", "water", "flour", "rice"])[target]
    group = np.array([f"{one}-{row % 4}" for row, one in enumerate(label)])
    return LabelledTable(label, group, {"touch": touch, "vision": vision})


def stepped(each: int = 30, *, seed: int = 0) -> LabelledTable:
    """The same as `tactile` and `vision`, with twelve steps: nothing is known in the first ones, all from the sixth on.
    Vision is small there, and a trial in six has none."""
    table, rng = two_modalities(each, seed=seed), np.random.default_rng([seed, 1])
    touch, vision = table.modalities["touch"], table.modalities["vision"]

    def series(values: FloatArray) -> FloatArray:
        noise = rng.normal(size=values.shape)
        return np.stack([noise + min(step / 5, 1.0) * (values - noise) for step in range(12)], axis=1)

    small = series(vision[:, :3])
    small[::6] = np.nan
    named: dict[str, FloatArray] = {"tactile": touch, "vision": vision}
    steps: dict[str, FloatArray] = {"tactile": series(touch), "vision_small": small}
    return LabelledTable(table.label, table.group, named, series=steps)


def noise(classes: int, each: int, columns: int, *, seed: int) -> LabelledTable:
    """Features that have nothing to do with the labels."""
    rng = np.random.default_rng(seed)
    label = np.repeat([f"c{one}" for one in range(classes)], each)
    features: FloatArray = rng.normal(size=(len(label), columns))
    return LabelledTable(label, None, {"touch": features})
