"""How the process that reads a camera is started."""

from __future__ import annotations

import os
import sys


def process_command(*arguments: str) -> list[str]:
    """What starts the process that reads a camera, by this interpreter; no module of the working folder's (-P)."""
    return [sys.executable, "-S", "-P", "-m", "deformscope_drivers.openni.process", *arguments]


def process_environment() -> dict[str, str]:
    """That process finds the packages where this one does, and looks for no others (-S)."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
