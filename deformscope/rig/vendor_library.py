"""Vendors' libraries that a rig file may name: a loaded library runs with the user's rights, and rig files come from
anywhere."""

from __future__ import annotations

import stat
from pathlib import Path

from deformscope.errors import InputError

SYSTEM_FOLDERS = tuple(
    map(Path, ("/lib", "/lib32", "/lib64", "/usr/lib", "/usr/lib32", "/usr/lib64", "/usr/local/lib", "/opt"))
)
ADMINISTRATOR = 0
"""User and group id of the administrator."""
TRY = (
    "install it there, or use --trust-rig, which loads the library that the rig file names and runs it with your rights"
)


def system_library(path: Path) -> Path:
    """The path of a library without links.

    Raises InputError unless it is in one of the system's folders that only the administrator can change."""
    try:
        real = path.resolve()
        folder = next((one for one in map(Path.resolve, SYSTEM_FOLDERS) if real.is_relative_to(one)), None)
        if folder is None:
            listed = ", ".join(map(str, SYSTEM_FOLDERS))
            raise InputError(f"a vendor's library in one of {listed}", "one elsewhere", TRY, path)
        for part in (real, *real.parents):
            if part.exists() and not _is_the_administrators(part):
                raise InputError("a library that only the administrator can change", f"{part} is others'", TRY, path)
            if part == folder:
                break
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: links in a circle
        raise InputError("a readable vendor's library", str(error), TRY, path) from error
    return real


def _is_the_administrators(path: Path) -> bool:
    status = path.stat()
    writable = status.st_mode & stat.S_IWOTH or (status.st_mode & stat.S_IWGRP and status.st_gid != ADMINISTRATOR)
    return status.st_uid == ADMINISTRATOR and not writable
