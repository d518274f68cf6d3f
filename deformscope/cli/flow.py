"""`deformscope flow`: dense optical flow of two images, and how far to trust it.

deformscope flow before.png after.png --out flow.npz
deformscope flow before.png after.png --out flow.npz --method farneback --picture flow.png
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deformscope.cli.common import replacing, show_table, write_json
from deformscope.config import FlowConfig
from deformscope.errors import InputError

if TYPE_CHECKING:
    from deformscope.arrays import FloatArray, ImageArray

ARROWS = 36
"""Arrows along the longer side of the picture."""


def run(config: FlowConfig) -> None:
    """Compute the flow there and back, write what was asked for, and tell the motion and its error."""
    import numpy as np

    from deformscope.images import read_image
    from deformscope.stages.see.flow import dense_flow

    before, after = read_image(config.before), read_image(config.after)
    if before.shape[:2] != after.shape[:2]:
        sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in (before, after))
        raise InputError("two images of one size", f"{sizes} px", "crop both alike", config.after)
    flow_px = np.asarray(dense_flow(before, after, config.method).flow_px, dtype=np.float32)
    backward_px = np.asarray(dense_flow(after, before, config.method).flow_px, dtype=np.float32)

    arrays = {"flow_px": flow_px} | ({"backward_px": backward_px} if config.backward else {})
    with replacing(config.out) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # numpy's stub takes the arrays for its own flag
    if config.picture is not None:
        _draw(before, flow_px, config.picture)

    length_px = np.hypot(flow_px[..., 0], flow_px[..., 1])
    error_px = _there_and_back(flow_px, backward_px)
    height, width = length_px.shape
    numbers = {
        "mean_px": float(length_px.mean()),
        "median_px": float(np.median(length_px)),
        "max_px": float(length_px.max()),
        "forward_backward_median_px": float(np.median(error_px)) if error_px.size else None,
    }
    show_table(
        f"Flow of {config.before.name} to {config.after.name} ({width} x {height}, {config.method})",
        [
            ("mean motion", _px(numbers["mean_px"])),
            ("median motion", _px(numbers["median_px"])),
            ("largest motion", _px(numbers["max_px"])),
            ("forward-backward error (median)", _px(numbers["forward_backward_median_px"])),
            ("written", str(config.out) if config.picture is None else f"{config.out}, {config.picture}"),
        ],
    )
    settings = {"method": config.method, "width": width, "height": height, "out": config.out}
    write_json(settings | numbers, config.json)


def _px(value: float | None) -> str:
    return "none: every pixel leaves the image" if value is None else f"{value:.3f} px"


def _there_and_back(flow_px: FloatArray, backward_px: FloatArray) -> FloatArray:
    """How far each pixel ends from its start after the flow and the flow back [px], for pixels that stay inside."""
    import cv2
    import numpy as np

    height, width = flow_px.shape[:2]
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    to_x, to_y = x + flow_px[..., 0], y + flow_px[..., 1]
    back_px = cv2.remap(backward_px, to_x, to_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (to_x >= 0) & (to_x <= width - 1) & (to_y >= 0) & (to_y <= height - 1)
    missed_px = (flow_px + back_px)[inside]
    error_px: FloatArray = np.hypot(missed_px[:, 0], missed_px[:, 1])
    return error_px


def _draw(image: ImageArray, flow_px: FloatArray, path: Path) -> None:
    """The flow over the first image: arrows, coloured by length."""
    import numpy as np
    from matplotlib.figure import Figure

    height, width = flow_px.shape[:2]
    step = max(1, max(height, width) // ARROWS)
    y, x = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    u, v = flow_px[y, x, 0], flow_px[y, x, 1]
    length_px = np.hypot(u, v)
    # Arrows as long as their spacing can be seen whatever the motion; the colour bar tells the true length.
    typical_px = float(np.percentile(length_px, 95))
    factor = step / typical_px if typical_px > 0 else 1.0

    inches = 9 / max(height, width)
    figure = Figure(figsize=(width * inches + 2, max(2.5, height * inches)), layout="constrained")
    axes = figure.subplots()
    shown = image if image.ndim == 2 else image.mean(axis=2)
    axes.imshow(shown, cmap="gray", alpha=0.6)
    arrows = axes.quiver(
        x, y, u * factor, v * factor, length_px, angles="xy", scale_units="xy", scale=1, cmap="viridis", width=0.003
    )
    figure.colorbar(arrows, ax=axes, label="motion [px]")
    axes.set(xlim=(0, width - 1), ylim=(height - 1, 0), xlabel="x [px]", ylabel="y [px]")
    axes.set_title(f"optical flow, arrows {factor:.3g} times as long as the motion", fontsize=10)
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=110)
