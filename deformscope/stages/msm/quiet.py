"""warp without its greeting."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def quiet_warp() -> None:
    """Start warp without its greeting; below Python it complains of a missing GPU driver, which is no fault here."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with Path(os.devnull).open("wb") as nothing:
            os.dup2(nothing.fileno(), 2)
            wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
