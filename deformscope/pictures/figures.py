"""Figures as PNG, by matplotlib without a display; of them those of one array: optical flow, distributions."""

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from deformscope.arrays import FloatArray, ImageArray
from deformscope.images import encode_png
from deformscope.pictures.palette import BACKGROUND
from deformscope.stages.poke.fitted import PokeComparison, Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours that colour-blind readers can distinguish (Okabe and Ito 2008)."""

LINES = ("-", "--", ":", "-.")


def canvas(
    width: float, height: float, *, dpi: float | None = None, layout: Literal["constrained"] | None = None
) -> "Figure":
    """An empty figure [inch], drawn off screen on any display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), dpi=dpi, layout=layout)
    FigureCanvasAgg(made)
    return made


def png_of(drawn: "Figure", dpi: int) -> bytes:
    """The same bytes for the same drawing."""
    encoded = io.BytesIO()
    drawn.savefig(encoded, format="png", dpi=dpi, metadata={"Software": None})
    return encoded.getvalue()


ARROWS = 36
"""Number of arrows along the longer side of the picture."""


def flow_png(image: ImageArray, flow_px: FloatArray) -> bytes:
    """The flow (H, W, 2) [px] over the first image: arrows, coloured by length."""
    height, width = flow_px.shape[:2]
    step = max(1, max(height, width) // ARROWS)
    y, x = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    u, v = flow_px[y, x, 0], flow_px[y, x, 1]
    length_px = np.hypot(u, v)
    # Arrows as long as their spacing can be seen whatever the motion; the colour bar has the true length.
    typical_px = float(np.percentile(length_px, 95))
    factor = step / typical_px if typical_px > 0 else 1.0

    inches = 9 / max(height, width)
    figure = canvas(width * inches + 2, max(2.5, height * inches), layout="constrained")
    axes = figure.subplots()
    shown = image if image.ndim == 2 else image.mean(axis=2)
    axes.imshow(shown, cmap="gray", alpha=0.6)
    arrows = axes.quiver(
        x, y, u * factor, v * factor, length_px, angles="xy", scale_units="xy", scale=1, cmap="viridis", width=0.003
    )
    figure.colorbar(arrows, ax=axes, label="motion [px]")
    axes.set(xlim=(0, width - 1), ylim=(height - 1, 0), xlabel="x [px]", ylabel="y [px]")
    axes.set_title(f"optical flow, arrows {factor:.3g} times as long as the motion", fontsize=10)
    return png_of(figure, 110)


COLUMNS, BINS, DPI = 3, 24, 110


def distributions_png(quantities: Mapping[str, Mapping[str, Sequence[float]]]) -> bytes:
    """How many cases gave which value, a panel for each quantity. quantities: finite values by the varied setting"""
    rows = -(-len(quantities) // COLUMNS)
    drawn = canvas(3.6 * COLUMNS, 2.7 * rows, layout="constrained")
    flat = list(np.ravel(drawn.subplots(rows, COLUMNS, squeeze=False)))
    for panel, (name, groups) in zip(flat, quantities.items(), strict=False):
        every = np.concatenate([np.asarray(values, np.float64) for values in groups.values()])
        low, high = every.min(), every.max()
        bins = np.linspace(low, high, BINS + 1) if high > low else np.array([low - 0.5, low + 0.5])
        for number, (group, values) in enumerate(groups.items()):
            filled = "step" if len(groups) > 1 else "stepfilled"
            panel.hist(values, bins, histtype=filled, color=COLOURS[number % len(COLOURS)], label=group)
        panel.locator_params("x", nbins=4)
        panel.set_xlabel(name)
        panel.set_ylabel("cases")
    for panel in flat[len(quantities) :]:
        panel.set_visible(False)
    groups = next(iter(quantities.values()), {})
    if len(groups) > 1:
        flat[0].legend(fontsize="small")
    return png_of(drawn, DPI)


# Dents as pictures: cuts through the surface along x under each tip, predicted and, if available, measured

SIMULATED, MEASURED, TIP = "#d92b2b", "#1f5fd0", "#555555"
ACROSS = 3
REACH_M = 0.08


def dents_png(predictions: Sequence[Prediction], compared: Sequence[PokeComparison]) -> bytes:
    """One panel per poke: height change along a line through the tip [mm], and each method's force."""
    import matplotlib as mpl

    measured = {id(one.prediction): one for one in compared}
    rows = -(-len(predictions) // ACROSS)
    columns = min(ACROSS, len(predictions))
    with mpl.rc_context({"font.size": 9}):
        figure = canvas(4.6 * columns, 3.3 * rows + 0.4, layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        for panel, one in zip(axes.flat, predictions, strict=False):
            _draw(panel, one, measured.get(id(one)))
        for unused in axes.flat[len(predictions) :]:
            unused.set_axis_off()
        return png_of(figure, 130)


def _draw(axes: "Axes", found: Prediction, measured: PokeComparison | None) -> None:
    rest, moved = found.rest[found.surface], (found.position - found.rest)[found.surface]
    at = found.poke.at
    up = rest.shape[1] - 1
    line = np.ones(len(rest), dtype=bool)
    if up == 2:
        off = np.abs(rest[:, 1] - at[1])
        line = off <= off.min() + 1e-9
    line &= np.abs(rest[:, 0] - at[0]) <= REACH_M
    order = np.flatnonzero(line)[np.argsort(rest[line, 0])]
    axes.plot(1e2 * (rest[order, 0] - at[0]), 1e3 * moved[order, up], "-o", ms=3, color=SIMULATED, label="predicted")
    if measured is not None:
        points = measured.poke.points
        off = np.abs(points[:, 1] - at[1])
        near = np.flatnonzero((off <= off.min() + 1e-6) & (np.abs(points[:, 0] - at[0]) <= REACH_M))
        near = near[np.argsort(points[near, 0])]
        x, z = 1e2 * (points[near, 0] - at[0]), 1e3 * measured.poke.moved[near, 2]
        axes.plot(x, z, "x", ms=6, color=MEASURED, label="measured")
    half = 50.0 * found.poke.tip.size[0]
    low = -1e3 * found.depth
    axes.plot([-half, half], [low, low], color=TIP, lw=3, alpha=0.5, label="tip")
    place = ", ".join(f"{v:.3g}" for v in at[:2])
    size = " x ".join(f"{1e3 * side:.3g}" for side in found.poke.tip.size)
    force = "" if found.force is None else f"\n{found.force:.3g} N predicted"
    if measured is not None and measured.poke.force is not None:
        force += f", {measured.poke.force:.3g} N measured"
    axes.set_title(f"{found.poke.tip.shape} {size} mm at ({place}) m{force}", fontsize=9)
    axes.set_xlabel("along x from the tip's axis [cm]")
    axes.set_ylabel("height change [mm]")
    axes.legend(loc="lower right", fontsize=8)
    axes.grid(alpha=0.3)


# The depth change around a fingertip as a picture with its scale (Thesis fig. 2.6)

RANGE_M = 0.003
"""The colours end at this dent and bulge: the same for all pictures, so that they compare."""
ENLARGED = 6
MISSING: tuple[int, int, int] = (90, 94, 100)
INK: tuple[int, int, int] = (235, 235, 235)


def depth_change_png(change_m: FloatArray, width_m: float, missing: float) -> bytes:
    """(n, n) data minus model [m], NaN grey; red is farther from the camera (a dent), blue nearer. width_m: width of
    the patch on the container; missing: share of NaN"""
    share = np.clip(np.nan_to_num(change_m) / RANGE_M, -1.0, 1.0)
    picture = np.repeat(np.repeat(_diverging(share, np.isfinite(change_m)), ENLARGED, axis=0), ENLARGED, axis=1)
    width = picture.shape[1]
    bar = np.repeat(_diverging(np.linspace(-1.0, 1.0, width)[None], np.ones((1, width), bool)), 12, axis=0)
    words = np.full((44, width, 3), BACKGROUND, np.uint8)
    ends = (f"{-1e3 * RANGE_M:g} mm: bulge", "0", f"{1e3 * RANGE_M:g} mm: dent")
    for share_x, text in zip((0.0, 0.5, 1.0), ends, strict=True):
        (length, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
        place = round(share_x * (width - length)), 15
        cv2.putText(words, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)
    about = f"{100 * width_m:.1f} cm wide; grey: finger, outline, or not measured ({100 * missing:.0f} %)"
    cv2.putText(words, about, (4, 36), cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)
    gap = np.full((6, width, 3), BACKGROUND, np.uint8)
    return encode_png(np.concatenate([picture, gap, bar, words]))


def _diverging(share: FloatArray, known: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """(..., 3) blue below 0, white at 0, red above."""
    size = np.abs(share)[..., None]
    end = np.where((share > 0.0)[..., None], (200, 30, 40), (30, 80, 210))
    color = (1.0 - size) * 245.0 + size * end
    return np.where(np.asarray(known, bool)[..., None], color, MISSING).astype(np.uint8)
