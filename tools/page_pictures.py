"""The pictures of the page in README.md and docs/howto, made anew:

    python tools/page_pictures.py [live explore film]

Each starts its command, opens its page in a headless Chromium of 1280x800 that draws by software, waits until there is
something to see, and saves what is on the screen. `film` clicks through an exploration (Explore, Confirm) to its end
and saves it as a GIF of 30 s: the beginning as it went by, what follows as much faster as it then says at the top.
Needs playwright and Chromium (apt-get install chromium).

Another command, size, colours, moment: python tools/page_pictures.py --out tablet.png --size 1024x768 --theme light \\
    --after 40 -- live lab:bench
"""

import argparse
import base64
import contextlib
import io
import os
import pty
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw
from playwright.sync_api import sync_playwright

CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
IMAGES = Path(__file__).parents[1] / "docs" / "images"
LIVE = ("live", "lab:bench")
EXPLORE = ("explore", "lab:three-60-110-rigid", "--paused")
START_S, PATIENCE_S = 60.0, 240.0
ATTEMPTS = 3
FILM_S, FILM_PX, FILM_BYTES = 30.0, (960, 600), 3 << 20
OPENING_S, ENDING_S = 8.0, 3.0
"""Of a film, as it went by; and for so long the last picture."""
SHORTEST_S = 0.25
"""Of a film's frame: what comes sooner replaces the one before."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", help="live, explore, film: none = all; or a command, with --out")
    parser.add_argument("--out", type=Path, help="of another command: a picture")
    parser.add_argument("--size", default="1280x800")
    parser.add_argument("--theme", choices=("dark", "light"), default="dark")
    parser.add_argument("--after", type=float, default=60.0, metavar="S", help="since the page was opened")
    parser.add_argument("--touch", action="store_true", help="a tablet: fingers, no mouse")
    arguments = parser.parse_args()
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # which a job in the background ignores, and its commands too
    if arguments.out is not None:
        size = tuple(map(int, arguments.size.split("x")))
        with opened(arguments.what, size, arguments.theme, touch=arguments.touch) as page:
            page.wait_for_timeout(1000 * arguments.after)
            page.screenshot(path=arguments.out)
        return 0
    for what in arguments.what or ("live", "explore", "film"):
        {"live": live, "explore": explore, "film": film}[what]()
    return 0


def live() -> None:
    """Devices, pictures, pressures, while a file is being written; again where the machine was too busy for that."""
    for _ in range(ATTEMPTS):
        with opened(LIVE) as page:
            drawn(page)
            page.keyboard.press("r")
            until(page, lambda: page.inner_text("#phase") == "recording")
            page.wait_for_timeout(15_000)
            page.screenshot(path=IMAGES / "live-page.png")
            lost = page.eval_on_selector_all("[data-of=lost]", "cells => cells.map((one) => Number(one.textContent))")
        if not any(lost):
            return
        print(f"frames lost: {lost}: other work on this machine")


def explore() -> None:
    """After some touches, with a map, while it goes on."""
    with opened(EXPLORE) as page:
        begun(page)
        until(page, lambda: "touch 7 " in page.inner_text("#remarks") or page.inner_text("#phase") == "stopped")
        page.wait_for_timeout(2_000)
        page.screenshot(path=IMAGES / "explore-page.png")


def film() -> None:
    """From the page that waits to the map."""
    with opened(EXPLORE) as page:
        drawn(page)
        with filmed(page, IMAGES / "explore-page.gif"):
            page.wait_for_timeout(1_500)
            begun(page, pause_ms=1_500)
            until(page, lambda: page.inner_text("#phase") == "stopped", 4 * PATIENCE_S)
            until(page, lambda: page.inner_text("#lag").startswith("the viewer shows all"))
            page.wait_for_timeout(2_000)


def drawn(page: Any) -> None:
    """Wait until the viewer shows data."""
    until(page, lambda: "viewer" in page.inner_text("#lag"))


def begun(page: Any, pause_ms: float = 0.0) -> None:
    """Press Explore, and confirm."""
    until(page, lambda: page.inner_text("#phase") == "paused")
    page.click("[data-kind=explore]")
    until(page, lambda: page.is_visible("#confirm"))
    page.wait_for_timeout(pause_ms)
    page.click("#confirm-yes")


def until(page: Any, happened: Any, patience_s: float = PATIENCE_S) -> None:
    deadline = time.monotonic() + patience_s
    while not happened():
        if time.monotonic() > deadline:
            raise TimeoutError("it never happened")
        page.wait_for_timeout(100)


@contextlib.contextmanager
def opened(
    words: Sequence[str], size: tuple[int, ...] = (1280, 800), theme: str = "dark", *, touch: bool = False
) -> Iterator[Any]:
    """The page of a command, in a browser of its own; both are ended."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        said = Path(folder) / "said"
        near, far = pty.openpty()  # at a terminal the page stays when its command has come to its end
        with said.open("w") as stderr:
            command = subprocess.Popen(
                [sys.executable, "-m", "deformscope", *words, "--viewer", "page"],
                cwd=folder,
                stdin=far,
                stdout=far,
                stderr=stderr,
            )
        threading.Thread(target=read_on, args=(near,), daemon=True).start()
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        try:
            width, height = size
            page = browser.new_page(
                viewport={"width": width, "height": height}, color_scheme=theme, has_touch=touch, is_mobile=touch
            )
            page.goto(address_of(said))
            yield page
        finally:
            browser.close()
            for _ in range(2):  # at the second the page ends, too
                command.send_signal(signal.SIGINT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    command.wait(10.0)
            command.wait(START_S)


def read_on(terminal: int) -> None:
    """What nobody reads would hold up whoever prints it."""
    with contextlib.suppress(OSError):
        while os.read(terminal, 65536):
            pass


def address_of(said: Path) -> str:
    """Which the command prints."""
    deadline = time.monotonic() + START_S
    while not (found := re.search(r"http://127\S+/", said.read_text())):
        if time.monotonic() > deadline:
            raise TimeoutError(f"no address: {said.read_text()}")
        time.sleep(0.2)
    return found[0]


@contextlib.contextmanager
def filmed(page: Any, path: Path) -> Iterator[None]:
    """What the page shows meanwhile, as GIF."""
    shots: list[tuple[float, bytes]] = []
    devtools = page.context.new_cdp_session(page)

    def keep(event: dict[str, Any]) -> None:
        devtools.send("Page.screencastFrameAck", {"sessionId": event["sessionId"]})
        shots.append((event["metadata"]["timestamp"], base64.b64decode(event["data"])))

    devtools.on("Page.screencastFrame", keep)
    devtools.send("Page.startScreencast", {"format": "png", "everyNthFrame": 1})
    yield
    devtools.send("Page.stopScreencast")
    write_gif(shots, path)


def write_gif(shots: Sequence[tuple[float, bytes]], path: Path) -> None:
    """Fewer colours where it would be too large. shots: times [s] and PNGs"""
    began_s, rest_s = shots[0][0], shots[-1][0] - shots[0][0] - OPENING_S
    faster = max(1.0, rest_s / (FILM_S - OPENING_S - ENDING_S))
    kept: list[tuple[float, Image.Image]] = []
    for at_s, png in shots:
        film_s = at_s - began_s
        hurried = film_s > OPENING_S and faster > 1.0
        film_s = OPENING_S + (film_s - OPENING_S) / faster if hurried else film_s
        if kept and film_s - kept[-1][0] < SHORTEST_S:
            film_s = kept.pop()[0]
        frame = Image.open(io.BytesIO(png)).convert("RGB").resize(FILM_PX, Image.Resampling.LANCZOS)
        if hurried:
            ImageDraw.Draw(frame).text((FILM_PX[0] - 240, 6), f"{faster:.0f} x", fill="#e8b13a", font_size=14)
        kept.append((film_s, frame))
    ends_s = [film_s for film_s, _ in kept[1:]] + [kept[-1][0] + ENDING_S]
    lasts_ms = [max(20, round(1000 * (end_s - film_s))) for (film_s, _), end_s in zip(kept, ends_s, strict=True)]
    for colors in (128, 96, 64, 48, 32):
        palette = kept[-1][1].quantize(colors)
        drawn = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for _, frame in kept]
        drawn[0].save(path, save_all=True, append_images=drawn[1:], duration=lasts_ms, loop=0, optimize=True)
        print(f"{path}: {len(drawn)} frames, {colors} colours, {path.stat().st_size / 1e6:.2f} MB")
        if path.stat().st_size <= FILM_BYTES:
            return
    raise RuntimeError(f"{path} is larger than {FILM_BYTES} bytes")


if __name__ == "__main__":
    sys.exit(main())
