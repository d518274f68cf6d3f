"""`rerun rrd ...` of the installed wheel, run to its end."""

from __future__ import annotations

import re
import signal
import subprocess
from pathlib import Path

TIMEOUT_S = 600.0


def run_rrd(*arguments: str | Path) -> str:
    """Run it; what it refuses, in a line; empty where it is done."""
    from deformscope.recording.live import viewer_executable

    command = [str(viewer_executable()), "rrd", *map(str, arguments)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return f"it was not read within {TIMEOUT_S:g} s"
    if done.returncode == 0:
        return ""
    if done.returncode < 0:
        return f"its bytes end rerun's reader ({signal.Signals(-done.returncode).name})"
    said = [line for line in re.sub(r"\x1b\[\d*m", "", done.stderr + done.stdout).splitlines() if line.strip()]
    reason = [line for line in said if "footer" in line] or said[-1:]
    return " ".join(reason[0].split())[:300] if reason else "rerun refuses it without a word"
