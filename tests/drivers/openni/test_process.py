"""The process that reads a camera starts quickly, and reports what it finds."""

import subprocess
import sys

from deformscope_drivers.errors import LibraryMissing
from deformscope_drivers.hosted import ask_hosted, hosted_environment
from deformscope_drivers.openni.camera import report_cameras
from deformscope_drivers.openni.library import ListedDevice
from tests.patience import PATIENCE_S


def test_it_starts_without_what_takes_long_to_load() -> None:
    script = "import sys, deformscope_drivers.openni.camera; print('numpy' in sys.modules)"
    shown = subprocess.run(
        [sys.executable, "-S", "-c", script],
        env=hosted_environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    assert shown.stdout == "False\n"


def test_cameras_are_listed() -> None:
    """A list, or why there is none."""
    try:
        reported = ask_hosted(report_cameras, timeout_s=PATIENCE_S)
    except LibraryMissing as error:
        reported = error
    assert isinstance(reported, list) or "libopenni2-0" in str(reported)
    assert not isinstance(reported, list) or all(isinstance(camera, ListedDevice) for camera in reported)
