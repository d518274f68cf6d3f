"""`deformscope flow`: dense optical flow of two images, and its error."""

import cv2
import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.cli.common import recorder_of, replacing, show, write_file, write_json
from deformscope.config import FlowConfig
from deformscope.errors import InputError
from deformscope.files.sources import DEFAULT_FPS
from deformscope.frames import ColorFrame
from deformscope.images import read_image
from deformscope.log.layout import FLOW
from deformscope.pictures.figures import flow_png
from deformscope.pictures.report import Findings, Table
from deformscope.session import Step
from deformscope.stages.see.flow import flow_both_ways
from deformscope_drivers.clock import Stamp

MOVING, DOUBTFUL, NAMED = 0.1, 0.25, 0.05
"""A pixel moves from this share of the largest motion on; its flow is doubtful if it comes back with an error of this
share of its motion; that is named from this share of the moving pixels on."""
STILL_PX = 0.01


def run(config: FlowConfig) -> None:
    """Compute the flow there and back, write the requested files, and print the motion and its error."""
    before, after = read_image(config.before), read_image(config.after)
    if before.shape[:2] != after.shape[:2]:
        sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in (before, after))
        raise InputError("two images of one size", f"{sizes} px", "crop both alike", config.after)
    forward, backward = flow_both_ways(before, after)
    flow_px, backward_px = (np.asarray(one.flow_px, dtype=np.float32) for one in (forward, backward))

    arrays = {"flow_px": flow_px} | ({"backward_px": backward_px} if config.backward else {})
    with replacing(config.out) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # numpy's stub takes the arrays for its own flag
    if config.picture is not None:
        write_file(config.picture, flow_png(before, flow_px))

    length_px = np.hypot(flow_px[..., 0], flow_px[..., 1])
    error_px = _there_and_back(flow_px, backward_px)
    inside = np.isfinite(error_px)
    height, width = length_px.shape
    moving = inside & (length_px > max(MOVING * length_px.max(), STILL_PX))
    doubtful = moving & (error_px > DOUBTFUL * length_px)
    numbers = {
        "mean_px": float(length_px.mean()),
        "median_px": float(np.median(length_px)),
        "max_px": float(length_px.max()),
        "forward_backward_median_px": float(np.median(error_px[inside])) if inside.any() else None,
        "doubtful_share": float(doubtful.sum() / moving.sum()) if moving.any() else None,
    }
    rows = [
        ("mean motion", _px(numbers["mean_px"])),
        ("median motion", _px(numbers["median_px"])),
        ("largest motion", _px(numbers["max_px"])),
        ("forward-backward error (median)", _px(numbers["forward_backward_median_px"])),
    ]
    if (share := numbers["doubtful_share"] or 0.0) > NAMED:
        text = f"{share:.0%} of the pixels that move, most of them {_part(doubtful)}: they do not come back within "
        text += f"{DOUBTFUL:.0%} of their motion. Film with texture and even light, in smaller steps, without occlusion"
        rows.append(("doubtful", text))
    title = f"Flow of {config.before.name} to {config.after.name} ({width} x {height})"
    found = Findings((Table(rows, caption=title),))
    show(found)
    with recorder_of(config, FLOW) as recorder:
        for index, image in enumerate((before, after)):
            recorder.write(ColorFrame(Stamp(round(index * 1e9 / DEFAULT_FPS)), index, image))
        recorder.write(Step((forward, found)))
    settings = {"width": width, "height": height, "out": config.out}
    write_json(settings | numbers, config.output.json)


def _part(marked: BoolArray) -> str:
    """The ninth of the image in which most pixels of (H, W) are marked, in words."""
    counts = cv2.resize(marked.astype(np.float32), (3, 3), interpolation=cv2.INTER_AREA)
    row, column = np.unravel_index(int(np.argmax(counts)), (3, 3))
    return ("top", "middle", "bottom")[row] + " " + ("left", "centre", "right")[column]


def _px(value: float | None) -> str:
    return "none: every pixel leaves the image" if value is None else f"{value:.3f} px"


def _there_and_back(flow_px: FloatArray, backward_px: FloatArray) -> FloatArray:
    """(H, W) how far each pixel ends from its start after the flow and the flow back [px]; NaN where it leaves the
    image."""
    height, width = flow_px.shape[:2]
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    to_x, to_y = x + flow_px[..., 0], y + flow_px[..., 1]
    back_px = cv2.remap(backward_px, to_x, to_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (to_x >= 0) & (to_x <= width - 1) & (to_y >= 0) & (to_y <= height - 1)
    missed_px = flow_px + back_px
    return np.asarray(np.where(inside, np.hypot(missed_px[..., 0], missed_px[..., 1]), np.nan))
