"""Paths for rerun of files whose names are not UTF-8, which rerun cannot open."""

from __future__ import annotations

import hashlib
import os
import tempfile
from functools import cache
from pathlib import Path


def utf8_path(path: Path) -> Path:
    """The path, or, if it is not UTF-8, a link to it, which exists until this process ends."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        absolute = Path.cwd() / path
        link = Path(_links().name) / (hashlib.sha256(os.fsencode(absolute)).hexdigest() + path.suffix)
        if not link.is_symlink():
            link.symlink_to(absolute)
        return link
    return path


@cache
def _links() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="deformscope-")
