"""Results on contents, as PNG: the thesis's figures 2.6, 2.7 and 2.9 to 2.14, transfer, fusion, calibration."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.pictures.figures import COLOURS, canvas, png_of
from deformscope.stages.squeeze.evaluation import Evaluation
from deformscope.stages.squeeze.groupings import Grouping
from deformscope.stages.squeeze.scores import ClassificationScore, Estimated
from deformscope.stages.squeeze.table import LabelledTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI = 110
MARKERS = "osD^vP*Xhp"
NUMBERED = 12
"""Largest number of classes whose confusion matrices have a number in each cell."""
NAMED = 30
"""Most classes that a legend names."""
SHOWN_IMAGES = 15
"""Classes of which a mean image is shown."""
ABREAST = 4
"""Most confusion matrices in a row."""
UNITS = {"tactile": (1.0, "counts"), "vision": (1e3, "mm"), "vision_small": (1e3, "mm")}
"""Factor and unit with which features of a data set of squeezes are drawn."""
PADS, PAD_SIDE = 36, 6
"""Cells of a fingertip's tactile array in a feature, 6 by 6 (Thesis 2.5.1)."""


def class_colors(count: int) -> list[Any]:
    """(count,) colours, as distinct as possible."""
    if count <= len(COLOURS):
        return list(COLOURS[:count])
    from matplotlib import colormaps

    return [colormaps["turbo"](x) for x in np.linspace(0.03, 0.97, count)]


# Mean features (Thesis fig. 2.6, 2.7) --------------------------------------------------------------------------------


def image_of(features: FloatArray) -> FloatArray:
    """The picture of features (p,): two tactile arrays next to each other, a square patch, or else one row."""
    if features.size == 2 * PADS:
        gap = np.full((PAD_SIDE, 1), np.nan)
        first, second = features.reshape(2, PAD_SIDE, PAD_SIDE)
        return np.concatenate([first, gap, second], axis=1)
    side = math.isqrt(features.size)
    return features.reshape(side, side) if side > 1 and side**2 == features.size else features[None]


def mean_images_png(table: LabelledTable, modality: str) -> bytes:
    """The mean of each class, all on one scale."""
    values = table.modalities[modality]
    classes = table.classes[:SHOWN_IMAGES]
    with np.errstate(invalid="ignore"):
        means = [image_of(_mean(values[table.label == one])) for one in classes]
    if means[0].shape[0] == 1:
        return _profiles_png(table, modality)
    scale, unit = UNITS.get(modality, (1.0, "")) if "tactile_end" in table.settings else (1.0, "")
    means = [scale * one for one in means]
    low, high = np.nanmin(means), np.nanmax(means)
    signed = low < 0.0 < high
    if signed:
        low, high = -max(-low, high), max(-low, high)
    columns = min(5, len(means))
    rows = math.ceil(len(means) / columns)
    wide = means[0].shape[1] / means[0].shape[0]
    side = 1.75 if wide < 1.5 else 1.1
    figure = canvas(1.3 + side * columns * (wide + 0.15), 0.5 + (side + 0.2) * rows, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, gridspec_kw={"wspace": 0.12})
    shown: Any = None
    for axis, one, mean in zip(axes.flat, classes, means, strict=False):
        colors = "RdBu_r" if signed else "viridis"
        shown = axis.imshow(mean, vmin=low, vmax=high, cmap=colors, interpolation="nearest")
        axis.set_title(one, fontsize=10)
    for axis in axes.flat:
        axis.set_axis_off()
    figure.colorbar(shown, ax=axes, shrink=0.8, label=f"{modality}, mean{unit and f' [{unit}]'}")
    return png_of(figure, DPI)


def _mean(values: FloatArray) -> FloatArray:
    """Mean of values (n, ...) over the first axis without NaN; NaN where there is nothing else."""
    known = ~np.isnan(values)
    count = known.sum(axis=0)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def _profiles_png(table: LabelledTable, modality: str) -> bytes:
    """Features that are no picture, each on the scale of its own deviation over all trials."""
    values, classes = table.modalities[modality], table.classes[:SHOWN_IMAGES]
    known = np.where(np.isnan(values), _mean(values), values)
    deviation = known.std(axis=0)
    scaled = (known - known.mean(axis=0)) / np.where(deviation > 0.0, deviation, 1.0)
    names = table.settings.get(modality)
    figure = canvas(7.6, 4.6 if isinstance(names, list) else 3.8, layout="constrained")
    axis = figure.subplots()
    for color, one in zip(class_colors(len(classes)), classes, strict=True):
        mean = scaled[table.label == one].mean(axis=0)
        axis.plot(mean, "o-" if mean.size < 30 else "-", color=color, label=one, markersize=4)
    if isinstance(names, list) and len(names) == values.shape[1]:
        axis.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=8)
    else:
        axis.set_xlabel(f"feature of {modality}")
    axis.set_ylabel(f"{modality}, mean\n[deviations of all trials]")
    axis.grid(alpha=0.25)
    if len(classes) <= NAMED:
        columns = max(1, math.ceil(len(classes) / 12))
        axis.legend(fontsize=8, ncols=columns, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return png_of(figure, DPI)


# Natural groupings (Thesis fig. 2.9, 2.10) ---------------------------------------------------------------------------


def clusters_png(table: LabelledTable, found: Grouping, modality: str) -> bytes:
    """Trials on the two largest components: by content, and by cluster with the centroids."""
    figure = canvas(11.4, 4.4, layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    label = table.label[found.rows]
    classes = table.classes
    for index, (color, one) in enumerate(zip(class_colors(len(classes)), classes, strict=True)):
        inside = label == one
        marker = MARKERS[index % len(MARKERS)]
        left.scatter(*found.plane[inside].T, s=16, color=color, marker=marker, alpha=0.75, linewidths=0, label=one)
    left.set_title(f"{modality}: contents", fontsize=10)
    colors = class_colors(len(found.centroid))
    for cluster, color in enumerate(colors):
        inside = found.cluster == cluster
        right.scatter(*found.plane[inside].T, s=16, color=color, alpha=0.6, linewidths=0)
    right.scatter(*found.centroid.T, s=150, marker="X", c=colors, edgecolors="black", linewidths=1.4, zorder=3)
    spread = f"{found.rand.mean():.2f} ± {found.rand.std():.2f}"
    title = f"{modality}: {len(found.centroid)} clusters (k-means), adjusted Rand index {spread}"
    right.set_title(title, fontsize=10)
    for axis in (left, right):
        axis.set_xlabel(f"component 1 ({found.explained[0]:.0%} of the variance)")
        axis.grid(alpha=0.25)
    if len(found.explained) > 1:
        left.set_ylabel(f"component 2 ({found.explained[1]:.0%})")
    if len(classes) <= NAMED:
        figure.legend(fontsize=8, ncols=max(1, math.ceil(len(classes) / 14)), loc="outside right center")
    return png_of(figure, DPI)


# Learning curve (Thesis fig. 2.11) -----------------------------------------------------------------------------------


def curve_png(found: Evaluation) -> bytes:
    """Accuracy over the share of the training data."""
    methods = sorted({point.method for point in found.curve})
    figure = canvas(4.9 * len(methods) + 0.6, 4.0, layout="constrained")
    axes = figure.subplots(1, len(methods), squeeze=False, sharey=True)[0]
    modalities = list(dict.fromkeys(point.modality for point in found.curve))
    for axis, method in zip(axes, methods, strict=True):
        for index, modality in enumerate(modalities):
            points = [one for one in found.curve if (one.modality, one.method) == (modality, method)]
            share = np.array([one.share for one in points]) + 0.006 * (index - len(modalities) / 2)
            value = np.array([one.accuracy.value for one in points])
            reach = _reach([one.accuracy for one in points])
            color = COLOURS[index % len(COLOURS)]
            axis.errorbar(share, value, yerr=reach, fmt="o-", capsize=3, color=color, label=modality)
        axis.axhline(found.scores[0].chance, color="tab:gray", linestyle=":", label="no-information rate")
        axis.set(xlabel="share of the training trials", title=method, xticks=[0.2, 0.4, 0.6, 0.8, 1.0])
        axis.xaxis.set_major_formatter(lambda x, _: f"{x:.0%}")
        axis.grid(alpha=0.25)
    _percent(axes[0])
    axes[-1].legend(fontsize=8)
    return png_of(figure, DPI)


def _reach(found: Sequence[Estimated]) -> FloatArray:
    """(2, n) how far intervals reach below and above their values."""
    value = np.array([one.value for one in found])
    ends = np.array([one.interval for one in found])
    return np.asarray(np.maximum(np.stack([value - ends[:, 0], ends[:, 1] - value]), 0.0))


def _percent(axis: "Axes", name: str = "accuracy") -> None:
    axis.set(ylim=(-0.02, 1.02), ylabel=name)
    axis.yaxis.set_major_formatter(lambda y, _: f"{y:.0%}")


# Confusion (Thesis fig. 2.12 to 2.14) --------------------------------------------------------------------------------


def confusion_png(scores: Sequence[ClassificationScore], labels: Sequence[str]) -> bytes:
    """Confusion matrices side by side: rows are the true contents, each adding up to 100 %; with intervals if there are
    few classes."""
    count = len(labels)
    side = 3.6 if count <= 6 else 4.8 if count <= NUMBERED else 5.6 if count <= NAMED else 7.5
    columns = min(len(scores), ABREAST)
    rows = math.ceil(len(scores) / columns)
    figure = canvas(side * columns + 0.9, (side + 0.7) * rows, layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    axes = list(grid.flat)[: len(scores)]
    for axis in list(grid.flat)[len(scores) :]:
        axis.set_axis_off()
    shown: Any = None
    for index, (axis, score) in enumerate(zip(axes, scores, strict=True)):
        shown = axis.imshow(score.shares, vmin=0.0, vmax=1.0, cmap="Blues")
        low, high = score.accuracy.interval
        title = f"{score.modality}: {score.method}\n{score.accuracy.value:.1%} ({low:.1%} to {high:.1%})"
        axis.set_title(title, fontsize=10)
        size = 8 if count <= NAMED else 360 / count * 0.75
        axis.set_xticks(range(count), labels, rotation=45 if count <= NUMBERED else 90, fontsize=size)
        axis.set_yticks(range(count), [""] * count if index % columns else labels, fontsize=size)
        axis.set_xlabel("named")
        if index % columns == 0:
            axis.set_ylabel("true")
        if count <= NUMBERED:
            _numbers(axis, score)
    figure.colorbar(shown, ax=axes, shrink=0.75 / rows, format=lambda share, _: f"{share:.0%}")
    return png_of(figure, DPI)


def _numbers(axis: "Axes", score: ClassificationScore) -> None:
    count = len(score.shares)
    for row in range(count):
        for column in range(count):
            share = score.shares[row, column]
            if not np.isfinite(share):
                continue
            color = "white" if share > 0.55 else "black"
            raised = 0.12 if count <= 6 else 0.0
            size = 10 if count <= 6 else 7
            axis.text(column, row - raised, f"{100 * share:.0f}", ha="center", va="center", color=color, fontsize=size)
            if count <= 6:
                low, high = score.share_interval(row, column)
                words = f"{100 * low:.0f}–{100 * high:.0f}"
                axis.text(column, row + 0.25, words, ha="center", va="center", color=color, fontsize=6)


# All methods, fusion, transfer ---------------------------------------------------------------------------------------


def accuracies_png(scores: Sequence[ClassificationScore]) -> bytes:
    """Accuracy of every method and modality with its interval, and the no-information rate."""
    modalities = list(dict.fromkeys(one.modality for one in scores))
    methods = list(dict.fromkeys(one.method for one in scores))
    figure = canvas(8.6, 1.2 + 0.16 * len(scores) + 0.28 * len(methods), layout="constrained")
    axis = figure.subplots()
    step = 0.75 / max(len(modalities), 1)
    for index, modality in enumerate(modalities):
        mine = [one for one in scores if one.modality == modality]
        place = [methods.index(one.method) + step * (index - (len(modalities) - 1) / 2) for one in mine]
        value = [one.accuracy.value for one in mine]
        reach = _reach([one.accuracy for one in mine])
        color = COLOURS[index % len(COLOURS)]
        axis.errorbar(value, place, xerr=reach, fmt="o", capsize=3, color=color, label=modality, markersize=5)
    axis.axvline(scores[0].chance, color="tab:gray", linestyle=":", label="no-information rate")
    axis.set_yticks(range(len(methods)), methods)
    axis.invert_yaxis()
    axis.set(xlim=(-0.02, 1.02), xlabel=f"accuracy with its {scores[0].level:.0%} interval")
    axis.xaxis.set_major_formatter(lambda x, _: f"{x:.0%}")
    axis.grid(alpha=0.25)
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return png_of(figure, DPI)


def fusion_png(found: Evaluation) -> bytes:
    """Right answers in each class, by each modality, and by late fusion."""
    late = found.best
    shown = [*(found.score(name, "pooled") for name in found.table.fused[0]), late]
    count = len(found.table.classes)
    figure = canvas(max(6.5, 1.6 + 0.55 * count) if count <= NAMED else 15.0, 4.0, layout="constrained")
    axis = figure.subplots()
    step = 0.7 / len(shown)
    for index, score in enumerate(shown):
        place = np.arange(count) + step * (index - (len(shown) - 1) / 2)
        share = np.diagonal(score.shares)
        ends = np.array([score.share_interval(one, one) for one in range(count)])
        reach = np.nan_to_num(np.maximum(np.stack([share - ends[:, 0], ends[:, 1] - share]), 0.0))
        color = "black" if score is late else COLOURS[index % (len(COLOURS) - 1)]
        label = "late fusion" if score is late else score.modality
        axis.errorbar(place, share, yerr=reach, fmt="s" if score is late else "o", capsize=2, color=color, label=label)
    names = found.table.classes
    axis.set_xticks(range(count), names if count <= NAMED else [""] * count, rotation=0 if count < 8 else 60)
    axis.grid(alpha=0.25)
    _percent(axis, "named rightly")
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return png_of(figure, DPI)


def transfer_png(found: Evaluation) -> bytes:
    """Accuracy on another kind of container than that of the training, compared with that within one kind."""
    transfers = [one for one in found.scores if one.pair is not None and one.method in ("pooled", "late-fusion", "knn")]
    pairs = list(dict.fromkeys(one.pair for one in transfers if one.pair is not None))
    keys = list(dict.fromkeys((one.modality, one.method) for one in transfers))
    figure = canvas(9.0, 1.2 + 0.22 * len(keys) * (len(pairs) + 1), layout="constrained")
    axis = figure.subplots()
    sets: list[tuple[str, list[ClassificationScore]]] = [
        (f"no transfer, {found.protocol} splits", [found.score(modality, method) for modality, method in keys])
    ]
    for pair in pairs:
        mine = {(one.modality, one.method): one for one in transfers if one.pair == pair}
        sets.append((f"{pair[0]} to {pair[1]}", [mine[key] for key in keys if key in mine]))
    step = 0.75 / len(sets)
    for index, (name, scores) in enumerate(sets):
        place = [keys.index((one.modality, one.method)) + step * (index - (len(sets) - 1) / 2) for one in scores]
        value, reach = [one.accuracy.value for one in scores], _reach([one.accuracy for one in scores])
        color = "black" if index == 0 else COLOURS[(index - 1) % (len(COLOURS) - 1)]
        axis.errorbar(value, place, xerr=reach, fmt="o", capsize=3, color=color, label=name, markersize=5)
    axis.axvline(found.scores[0].chance, color="tab:gray", linestyle=":", label="no-information rate")
    axis.set_yticks(range(len(keys)), [f"{modality}: {method}" for modality, method in keys])
    axis.invert_yaxis()
    axis.set(xlim=(-0.02, 1.02), xlabel="accuracy")
    axis.xaxis.set_major_formatter(lambda x, _: f"{x:.0%}")
    axis.grid(alpha=0.25)
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return png_of(figure, DPI)


# Calibration and time ------------------------------------------------------------------------------------------------


def reliability_png(scores: Sequence[ClassificationScore]) -> bytes:
    """How often answers of a probability are right; shaded, where a perfectly calibrated classifier would lie."""
    figure = canvas(3.7 * len(scores) + 0.6, 4.2, layout="constrained")
    axes = figure.subplots(1, len(scores), squeeze=False, sharey=True)[0]
    for axis, score in zip(axes, scores, strict=True):
        found = score.reliability
        filled = found.count > 0
        sure, right, band = found.sure[filled], found.right[filled], found.band[filled]
        axis.plot([0, 1], [0, 1], color="tab:gray", linestyle=":")
        ends = np.stack([sure - band[:, 0], band[:, 1] - sure])
        label = f"{score.level:.0%} band, perfectly calibrated"
        axis.errorbar(
            sure, sure, yerr=np.maximum(ends, 0.0), fmt="none", color=COLOURS[5], linewidth=7, alpha=0.5, label=label
        )
        size = 20 + 180 * found.count[filled] / max(int(found.count.max()), 1)
        axis.scatter(sure, right, s=size, color=COLOURS[0], zorder=3)
        axis.set(xlim=(0, 1.03), xlabel="probability of the answer")
        title = f"{score.modality}: {score.method}\ncalibration error {score.calibration_error:.1%}"
        axis.set_title(title, fontsize=10)
        axis.xaxis.set_major_formatter(lambda x, _: f"{x:.0%}")
        axis.grid(alpha=0.25)
    _percent(axes[0], "share that is right")
    axes[-1].legend(fontsize=8, loc="upper left")
    return png_of(figure, DPI)


def steps_png(found: Evaluation) -> bytes:
    """Posterior during a squeeze, and the result of stopping once it is confident enough."""
    figure = canvas(9.4, 4.0, layout="constrained")
    now, early = figure.subplots(1, 2, sharex=True, sharey=True)
    for index, (name, points) in enumerate(found.steps.items()):
        time = np.array([one.time_s for one in points])
        value = np.array([one.accuracy.value for one in points])
        color = COLOURS[index % len(COLOURS)]
        reach = _reach([one.accuracy for one in points])
        now.errorbar(time, value, yerr=reach, fmt="o-", capsize=3, color=color, label=name)
        early.plot(time, [one.stopped for one in points], color=color)
        early.plot(time, [one.right for one in points], ":", color=color)
    now.axhline(found.scores[0].chance, color="tab:gray", linestyle="--", label="no-information rate")
    early.plot([], [], color="0.3", label="confident enough to stop by then")
    early.plot([], [], ":", color="0.3", label="right answers, of those")
    for axis, title in ((now, "right answers at that moment"), (early, "stopped once it is confident")):
        axis.set(xlabel="time since the first contact [s]")
        axis.set_title(title, fontsize=10)
        axis.grid(alpha=0.25)
        axis.legend(fontsize=8, loc="lower right")
    _percent(now, "share of trials")
    return png_of(figure, DPI)
