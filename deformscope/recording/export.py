"""The images of a recording as files: byte for byte as they were recorded."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from deformscope.errors import InputError
from deformscope.frames import ColorFrame, DepthFrame
from deformscope.images import PNG_SIGNATURE
from deformscope.recording.item_rows import read_rows
from deformscope.recording.reader import Replay

OURS = re.compile(r"\d{6,}\.(png|jpg)")


@dataclass(frozen=True, slots=True)
class ExportedImages:
    """Files of one kind. device: that took them; what: image, depth, or color (of a depth camera)"""

    device: str
    what: str
    folder: Path
    count: int


def export_images(
    replay: Replay, folder: Path, camera: str | None, *, overwrite: bool, note: Callable[[str, int, int], None]
) -> list[ExportedImages]:
    """Write the images of one camera, or of all, as `INDEX.jpg` and `INDEX.png`.

    folder: for those of one kind; several kinds get folders in it: DEVICE and, for the colour images of a depth camera,
    DEVICE-color; overwrite: replace what an earlier export wrote
    note: called with what is done, how much of it, and of how much
    """
    counts = {one: count for one, count in replay.image_counts.items() if camera in (None, one[0])}
    if not counts:
        known = sorted({device for device, _ in replay.image_counts})
        came = "none" if camera is None else f"none of {camera!r}"
        hint = f"--camera {' or '.join(known)}" if known else ""
        raise InputError("images in the recording", came, hint, replay.path)
    folders = {
        one: folder if len(counts) == 1 else folder / re.sub(r"[^\w.-]", "_", "-".join(_name(*one))) for one in counts
    }
    for path in folders.values():
        _empty(path, overwrite=overwrite)
    total = sum(count for (_, what), count in counts.items() if what != "color")
    rows = read_rows(replay, (ColorFrame, DepthFrame), lambda encoded, which: encoded, device=camera)
    for done, row in enumerate(rows, start=1):
        frame = row.item
        for what in ("image", "depth", "color"):
            if encoded := getattr(frame, what, None):
                suffix = "png" if encoded.startswith(PNG_SIGNATURE) else "jpg"
                _write(folders[frame.device, what] / f"{frame.index:06d}.{suffix}", encoded)
        note("images", done, total)
    return [ExportedImages(*one, folders[one], count) for one, count in counts.items()]


def _name(device: str, what: str) -> tuple[str, ...]:
    return (device, what) if what == "color" else (device,)


def _empty(folder: Path, *, overwrite: bool) -> None:
    """Make a folder without images of an earlier export."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = list(folder.iterdir())
        if held and not overwrite:
            raise InputError(
                "an empty folder, or a new one", "one that holds files", "another one, or --overwrite", folder
            )
        for path in held:
            if OURS.fullmatch(path.name):
                path.unlink()
    except OSError as error:
        raise _unwritable(folder, error) from error


def _write(path: Path, encoded: bytes) -> None:
    try:
        path.write_bytes(encoded)
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError("a folder that can be written to", (error.strerror or str(error)).lower(), "another one", path)
