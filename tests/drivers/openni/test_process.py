"""The process that reads a camera starts quickly, and reports what it finds."""

from __future__ import annotations

import json
import subprocess
import sys

from deformscope_drivers.camera_process.command import ask_process, process_environment
from tests.patience import PATIENCE_S


def test_it_starts_without_what_takes_long_to_load() -> None:
    script = "import sys, deformscope_drivers.openni.process; print('numpy' in sys.modules)"
    shown = subprocess.run(
        [sys.executable, "-S", "-c", script],
        env=process_environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )

    assert shown.stdout == "False\n"


def test_cameras_are_listed_in_json() -> None:
    """A list, or why there is none."""
    shown = ask_process("deformscope_drivers.openni.process", "list", timeout_s=PATIENCE_S)
    reported = json.loads(shown)

    assert isinstance(reported, list) or "libopenni2-0" in reported["error"]
