"""Pictures of a recording, made without a display: python tools/screenshot.py RUN.rrd --out shots

Opens the recording in a headless viewer, sets the `frame` timeline (or `session`, for a rig's, or `touch`), saves the
whole window and every view as PNG, and prints what the viewer complained about. Needs Vulkan; without a GPU: apt-get
install mesa-vulkan-drivers
"""

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from deformscope.page.server.viewer_files import viewer_environment, viewer_executable
from deformscope.recording.live import Viewer, wait_for_viewer

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

Theme = Literal["dark", "light"]
LAVAPIPE = Path("/usr/share/vulkan/icd.d/lvp_icd.x86_64.json")
LOAD_TIMEOUT_S = 30.0
NOTICES_S = 5.0
ATTEMPTS = 3
PRESS = [
    {"name": "click", "args": {"role": "Button", "label_contains": "Light"}},
    {"name": "hover", "args": {"pos": {"x": -99.0, "y": -99.0}}},  # else the pointer is in the pictures
]
"""What makes the viewer light, in its settings."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--out", type=Path, default=Path("shots"))
    parser.add_argument("--frame", type=int, help="default: the last one")
    parser.add_argument("--session", type=float, metavar="S", help="a moment of the session [s] instead of a frame")
    parser.add_argument("--touch", type=int, help="a touch of an exploration instead of a frame")
    parser.add_argument("--prefix", default="")
    parser.add_argument("--theme", choices=get_args(Theme), default="dark")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    with headless_viewer(theme=arguments.theme) as viewer:
        complaints = shoot(
            viewer, arguments.recording, arguments.out, arguments.frame, arguments.prefix, arguments.session,
            arguments.touch,
        )  # fmt: skip
    for line in complaints:
        print(line)
    print(f"{len(complaints)} complaints of the viewer")
    return 1 if complaints else 0


@contextlib.contextmanager
def headless_viewer(size: str = "1920x1080", theme: Theme = "dark") -> "Iterator[ViewerClient]":
    """A viewer without a window, on loopback alone; ended at exit. Raises ConnectionError where it cannot start, or has
    no light theme."""
    from rerun.experimental import ViewerClient

    command = [str(viewer_executable()), "--headless", "--bind", "127.0.0.1", "--port", "0"]
    command += ["--window-size", size, "--memory-limit", "2GB", "--hide-welcome-screen"]
    environment = viewer_environment() | {"RUST_LOG": "warn,re_grpc_server=info"}
    if "VK_ICD_FILENAMES" not in environment and LAVAPIPE.exists():
        environment["VK_ICD_FILENAMES"] = str(LAVAPIPE)
    with tempfile.TemporaryFile() as messages:
        process = subprocess.Popen(
            command, env=environment, start_new_session=True, stdout=subprocess.DEVNULL, stderr=messages
        )
        try:
            viewer = Viewer(process.pid, messages.fileno())
            wait_for_viewer(viewer, threading.Event())
            client = ViewerClient.connect(viewer.url)
            if theme == "light":
                make_light(client)
            yield client
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(10)


def make_light(viewer: "ViewerClient") -> None:
    """Press the button of the light theme: no option, command or blueprint of the viewer has it, only its settings.
    Raises ConnectionError where that fails."""
    viewer.run_command("ui.open_settings")
    initialize = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "shots", "version": "1"}}
    requests: list[dict[str, object]] = [
        {"id": 0, "method": "initialize", "params": initialize},
        {"method": "notifications/initialized"},
        {"id": 1, "method": "tools/call", "params": {"name": "batch", "arguments": {"actions": PRESS}}},
    ]
    ended = subprocess.run(
        [str(viewer_executable()), "viewer-mcp", "--endpoint", viewer.url.replace("rerun+", "").removesuffix("/proxy")],
        env=viewer_environment(),
        input="".join(json.dumps({"jsonrpc": "2.0"} | request) + "\n" for request in requests),
        capture_output=True,
        text=True,
        timeout=LOAD_TIMEOUT_S,
    )
    if '"isError":false' not in ended.stdout:
        raise ConnectionError(f"no light theme in the viewer's settings: {(ended.stdout or ended.stderr)[-300:]}")


def shoot(
    viewer: "ViewerClient",
    recording: Path,
    out: Path,
    frame: int | None = None,
    prefix: str = "",
    session_s: float | None = None,
    touch: int | None = None,
) -> list[str]:
    """Save PNGs of the window and of every view; what the views and the viewer's log complain about."""
    opened = viewer.open(str(recording.resolve()))
    if not opened.store_ids:
        return [f"nothing opened: {recording}"]
    deadline = time.monotonic() + LOAD_TIMEOUT_S
    while viewer.get_state().loading and time.monotonic() < deadline:
        time.sleep(0.1)
    if touch is not None:
        viewer.set_time("touch", sequence=touch, play_state="paused")
    elif session_s is not None:
        viewer.set_time("session", duration=session_s, play_state="paused")
    else:
        viewer.set_time("frame", sequence=last_frame(recording) if frame is None else frame, play_state="paused")
    time.sleep(1.0)  # the first picture of a view may still lack its images
    for left in reversed(range(ATTEMPTS)):  # on a busy machine the viewer answers late
        with contextlib.suppress(*[TimeoutError] * (left > 0)):
            viewer.save_screenshot(
                str(out / f"{prefix}window.png")
            )  # before a hidden view has a notice over the window
            break
    complaints = []
    for view in viewer.get_state().views:
        name = "".join(letter if letter.isalnum() else "_" for letter in view.name)[:40]
        try:
            viewer.save_screenshot(str(out / f"{prefix}{name}.png"), view_id=view.view_id)
        except ConnectionError:  # not found: it is behind another tab; until the viewer's notice of that is gone
            time.sleep(NOTICES_S)
    for view in viewer.get_state().views:
        complaints += [f"{view.name}: {report.severity}: {report.summary}" for report in view.reports]
    for entry in viewer.get_logs():
        text = str(entry)
        if "not found for screenshot" in text:
            continue
        if ("WARN" in text.upper() or "ERROR" in text.upper()) and "rasterizer" not in text:
            complaints.append(text)
    return complaints


def last_frame(recording: Path) -> int:
    from rerun.chunk import RrdReader

    last = 0
    for chunk in RrdReader(recording).stream():
        if "frame" in chunk.timeline_names and not chunk.is_static:
            last = max([last, *chunk.to_record_batch().column("frame").to_pylist()])
    return last


if __name__ == "__main__":
    sys.exit(main())
