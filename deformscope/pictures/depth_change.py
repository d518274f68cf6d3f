"""The depth change around a fingertip as a picture with its scale (Thesis fig. 2.6)."""

from __future__ import annotations

import cv2
import numpy as np

from deformscope.arrays import FloatArray
from deformscope.images import encode_png
from deformscope.pictures.palette import BACKGROUND

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
