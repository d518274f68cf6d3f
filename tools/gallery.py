"""Pictures of every view and short films, of the recordings that ship: python tools/gallery.py [--out build/gallery]

Opens each recording of `recordings/` in a dark and in a light headless viewer (Vulkan, as tools/screenshot.py). Saves
every view, a film of the window over the session, and the figures of `deformscope report`, all shown by `index.html`.
"""

import argparse
import html
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from PIL import Image
from screenshot import Theme, headless_viewer, shoot

import deformscope as ds

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

ROOT = Path(__file__).resolve().parents[1]
MOMENTS: dict[str, dict[str, float]] = {
    "tension": {},
    "explore": {"touch": 2},
    "rig": {"session_s": 3.5},
    "squeeze": {"session_s": 4.2},
}
"""Of each recording, what `shoot` shows; nothing = the last frame."""
FILM_FRAMES, FILM_MS, FILM_PX = 12, 350, (960, 540)
PAGE = """<!DOCTYPE html>
<meta charset="utf-8"><meta name="color-scheme" content="light dark"><title>Gallery of deformscope</title>
<style>
body {{ font: 16px/1.5 sans-serif; margin: 2em; background: Canvas; color: CanvasText }}
div {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(420px, 1fr)); gap: 1em }}
img {{ width: 100% }} figure {{ margin: 0 }}
</style>
<h1>Gallery of deformscope</h1>
{sections}
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "gallery")
    parser.add_argument("names", nargs="*", default=[*MOMENTS])
    arguments = parser.parse_args()
    complaints = []
    for name in arguments.names:
        recording, out = ROOT / "recordings" / f"{name}.rrd", arguments.out / name
        out.mkdir(parents=True, exist_ok=True)
        for theme in get_args(Theme):
            with headless_viewer(theme=theme) as viewer:
                complaints += shoot(viewer, recording, out, prefix=f"{theme}_", **MOMENTS[name])  # type: ignore[arg-type]
                film(viewer, recording, out / f"{theme}_film.webp")
        for number, figure in enumerate(ds.report(recording).figures(), start=1):
            (out / f"report-{number}.png").write_bytes(figure.png)
        print(f"{name}: {len(list(out.glob('*.*')))} pictures in {out}")
    sections = [section(folder) for folder in sorted(arguments.out.iterdir()) if folder.is_dir()]
    index = arguments.out / "index.html"
    index.write_text(PAGE.format(sections="\n".join(sections)), encoding="utf-8")
    print(f"index: {index}")
    for line in complaints:
        print(line)
    return 1 if complaints else 0


def film(viewer: "ViewerClient", recording: Path, path: Path, size: tuple[int, int] = FILM_PX) -> None:
    """The window at even moments of the session, as an animated WebP."""
    end_s = ds.verify(recording).found["until_s"]
    pictures = []
    for number in range(FILM_FRAMES):
        viewer.set_time("session", duration=end_s * (number + 1) / FILM_FRAMES, play_state="paused")
        time.sleep(0.5)
        still = path.with_suffix(".png")
        viewer.save_screenshot(str(still))
        pictures.append(Image.open(still).convert("RGB").resize(size, Image.Resampling.LANCZOS))
        still.unlink()
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=FILM_MS, loop=0, quality=60)


def section(folder: Path) -> str:
    figures = [
        f'<figure><img src="{folder.name}/{html.escape(one.name)}" alt="{html.escape(one.stem)}" loading="lazy">'
        f"<figcaption>{html.escape(one.stem.replace('_', ' '))}</figcaption></figure>"
        for one in sorted(folder.glob("*.*"))
    ]
    return f"<h2>{folder.name}</h2>\n<div>{''.join(figures)}</div>"


if __name__ == "__main__":
    sys.exit(main())
