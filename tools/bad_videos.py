"""Films a rendered sponge well and badly: docs/images/bad-videos.webp, and what a fit says of each.

python tools/bad_videos.py [--fit]
"""

import dataclasses
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

import deformscope as ds
from studies.rendered_video import LogCase, RenderedVideo, VideoCase, render, write

TO = Path(__file__).resolve().parents[1] / "docs" / "images" / "bad-videos.webp"
GOOD = VideoCase(
    3001,
    modulus_pa=15e3,
    poisson=0.05,
    size_m=(0.12, 0.06, 0.04),
    tool_at_m=0.008,
    width_px=640,
    height_px=400,
    frames=12,
    rest=2,
    ramp=8,
    fps=10.0,
    fill=0.6,
    tilt_deg=1.0,
    log=LogCase(offset_s=0.5),
)
BAD: dict[str, dict[str, float]] = {
    "good": {},
    "no texture": {"contrast": 0.006},
    "out of focus": {"blur_px": 6.0},
    "too bright": {"exposure": 2.3},
    "too dark": {"exposure": 0.08, "noise": 5.0},
    "too far away": {"fill": 0.12},
    "from the side": {"tilt_deg": 25.0},
    "turned while pressed": {"turn_deg": 12.0},
    "zoomed while pressed": {"zoom": 0.12},
}
COLUMNS, TILE = 3, (320, 200)


def tile(video: RenderedVideo, number: int) -> np.ndarray:
    """The last image, small, with its number."""
    small = cv2.resize(video.frames[-1], TILE, interpolation=cv2.INTER_AREA)
    cv2.rectangle(small, (0, 0), (26, 30), (255, 255, 255), -1)
    cv2.putText(small, str(number), (5, 23), cv2.FONT_HERSHEY_SIMPLEX, 0.8, (0, 0, 0), 2, cv2.LINE_AA)
    return small


def fitted(name: str, video: RenderedVideo) -> str:
    """What the fit of a video says, with the flags of its truth."""
    with tempfile.TemporaryDirectory() as folder:
        write(video, Path(folder))
        known = {"roi": video.roi, "grid": (7, 13), "held": video.held, "contact": video.contact}
        files = {"force": f"{folder}/force.csv", "force_offset_s": 0.5}
        scale = {"px_per_cm": video.px_per_cm, "thickness_m": video.thickness_m, "progress": False}
        try:
            found = ds.calibrate_beta(f"{folder}/video.mp4", **known, **files, **scale).to_dict()  # type: ignore[arg-type]
        except ds.InputError as error:
            return f"{name}: refused: {error}".splitlines()[0]
    ends = (found["contact_stiffness_n_per_mm"] or {}).get("interval")
    value = (found["contact_stiffness_n_per_mm"] or {}).get("value")
    codes = ", ".join(one["code"] for one in found["reasons"])
    return f"{name}: {value:.3f} N/mm ({ends[0]:.3f} to {ends[1]:.3f}), truth {video.stiffness_n_per_mm:.3f}; {codes}"


def main() -> None:
    tiles = []
    for number, (name, changes) in enumerate(BAD.items(), start=1):
        video = render(dataclasses.replace(GOOD, **changes))  # type: ignore[arg-type]
        tiles.append(tile(video, number))
        print(f"{number} {fitted(name, video) if '--fit' in sys.argv else name}", flush=True)
    rows = [np.hstack(tiles[at : at + COLUMNS]) for at in range(0, len(tiles), COLUMNS)]
    cv2.imwrite(str(TO), cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR), [cv2.IMWRITE_WEBP_QUALITY, 70])
    print(f"{TO}: {TO.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
