"""How the process that reads a camera is started."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any


def process_command(module: str, *arguments: str) -> list[str]:
    """What starts the process that reads a camera, by this interpreter; no module of the working folder's (-P).

    module: deformscope_drivers.openni.process or deformscope_drivers.realsense.process
    """
    return [sys.executable, "-S", "-P", "-m", module, *arguments]


def ask_process(module: str, *arguments: str, timeout_s: float) -> str:
    """What such a process prints before it ends; empty where it fails, or does not end in time."""
    command = process_command(module, *arguments)
    options: dict[str, Any] = {"env": process_environment(), "stdin": subprocess.DEVNULL, "capture_output": True}
    try:
        return str(subprocess.run(command, timeout=timeout_s, check=False, text=True, **options).stdout)
    except (subprocess.TimeoutExpired, OSError):
        return ""


def process_environment() -> dict[str, str]:
    """That process finds the packages where this one does, and looks for no others (-S)."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
