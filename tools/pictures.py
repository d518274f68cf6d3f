"""Every picture of the documentation that a run of today shows: python tools/pictures.py [NAME...]    make pictures

Runs the commands of `WINDOWS` and takes the headless viewer's window (tools/screenshot.py), takes windows and films of
the recordings that ship (tools/gallery.py), and photographs the pages (tools/page_pictures.py). Needs Vulkan and
Chromium. On a machine with other work the page of the rig has lost frames: it is then taken again, three times at most.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import page_pictures
from gallery import MOMENTS, film
from PIL import Image
from samples import poke
from screenshot import NOTICES_S, headless_viewer, shoot

ROOT = Path(__file__).resolve().parents[1]
IMAGES, RECORDINGS = ROOT / "docs" / "images", ROOT / "recordings"
WITH_LOSSES = 3
"""Exit status of a command that lost some readings, as on a machine with other work."""
SIZE, BAR_PX, FILM_PX = (1920, 1080), 36, (800, 450)
"""The window, and at its top the viewer's own bar, which is cut off."""
SLAB = ("calibrate", "beta", "sample:poke", "--thickness-m", "0.05", "--save", "slab.npz")
PRESSED = ((0.19, 0.12), 2.0), ((0.2, 0.125), 3.0), ((0.19, 0.12), 4.0)
"""Place [m] and force [N] of the pokes that MuJoCo repeats."""
BODY = ("simulate", "slab.npz", "--in", "mujoco", "--out", "body", "--against", "poke0.npz", "poke1.npz", "poke2.npz")
TARGET = tuple(f"--python={one}" for one in (os.environ.get("DEFORMSCOPE_TARGETS_PYTHON"),) if one)
SQUEEZE = ("squeeze", "lab:containers", "--content", "rice", "--container", "box-01")
WINDOWS: dict[str, tuple[Path, tuple[tuple[str, ...], ...], dict[str, Any]]] = {
    "tension": (RECORDINGS / "tension.png", (("calibrate", "beta", "sample:tension"),), {}),
    "predict": (IMAGES / "predict.png", (SLAB, ("predict", "slab.npz", "--against", "unseen.npz")), {"frame": 0}),
    "simulate": (IMAGES / "simulate.png", (SLAB, (*BODY, *TARGET)), {"frame": 1}),
    "explore": (RECORDINGS / "explore.png", (("demo",),), {"touch": 12}),
    "bench": (RECORDINGS / "bench.png", (("record", "lab:bench", "--seconds", "10"),), {"session_s": 9.0}),
    "squeeze": (IMAGES / "squeeze.png", (SQUEEZE,), {"session_s": 5.0}),
}
"""Of each picture its file, the commands, of which the last is recorded, and what `shoot` shows of it."""


def window(name: str) -> None:
    """The viewer's window of a command's recording."""
    path, commands, moment = WINDOWS[name]
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run.rrd"
        (Path(folder) / "unseen.npz").write_bytes(poke((0.19, 0.12), 4.0))
        for number, (at, force_n) in enumerate(PRESSED):
            (Path(folder) / f"poke{number}.npz").write_bytes(poke(at, force_n))
        for words in commands:
            recorded = ("--record", str(run), "--viewer", "none") if words is commands[-1] else ()
            done = subprocess.run([sys.executable, "-m", "deformscope", *words, *recorded], cwd=folder, check=False)
            if done.returncode not in (0, WITH_LOSSES):
                raise SystemExit(f"{words}: exit status {done.returncode}")
        show(run, path, moment)
        if name == "tension":
            show(run, IMAGES / "gallery-tension.webp", moment)


def show(run: Path, path: Path, moment: dict[str, Any], size: tuple[int, int] | None = None) -> None:
    """Save the window without its bar, in 256 colours as PNG."""
    with tempfile.TemporaryDirectory() as folder, headless_viewer("{}x{}".format(*SIZE)) as viewer:
        time.sleep(2 * NOTICES_S)  # the viewer begins with notices over its views
        shoot(viewer, run, Path(folder), **moment)
        picture = Image.open(Path(folder) / "window.png").convert("RGB").crop((0, BAR_PX, *SIZE))
        if path.suffix == ".png":
            picture.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
        else:
            picture.resize((1280, 696), Image.Resampling.LANCZOS).save(path, quality=80)
            if path.stem in ("gallery-tension", "gallery-squeeze"):
                film(viewer, run, path.with_name(f"{path.stem}-film.webp"), FILM_PX)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def gallery() -> None:
    """Recordings that ship."""
    for name in ("explore", "squeeze"):
        show(RECORDINGS / f"{name}.rrd", IMAGES / f"gallery-{name}.webp", MOMENTS[name])


MADE: dict[str, Callable[[], None]] = {
    **{name: partial(window, name) for name in WINDOWS},
    "gallery": gallery,
    "live-page": page_pictures.live,
    "explore-page": page_pictures.explore,
    "film": page_pictures.film,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(MADE)}; none: all")
    for name in parser.parse_args().names or MADE:
        MADE[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main())
