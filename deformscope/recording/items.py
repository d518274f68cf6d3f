"""A rig's recording read back: the same items that were recorded, in order of time."""

from __future__ import annotations

import heapq
import json
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.frames import (
    ArmFrame,
    ColorFrame,
    DepthFrame,
    HandFrame,
    HealthReport,
    Item,
    LinkChange,
    RawBytes,
    Stream,
    TactileFrame,
    WrenchFrame,
)
from deformscope.images import decode_image
from deformscope.recording.reader import Replay
from deformscope.rows import stream_from_json
from deformscope_drivers.clock import ClockRelation, Stamp
from deformscope_drivers.health import Health, Link, LinkEvent

if TYPE_CHECKING:
    from rerun.chunk import Chunk

FRAMES = ("wrench", "tactile", "arm", "hand", "color", "depth")
KINDS = (*FRAMES, "raw", "link", "health")
MEASURED = (
    *("Stamp:", "Scalars:", "WrenchFrame:", "TactileFrame:", "ArmFrame:", "HandFrame:", "DepthFrame:"),
    *("EncodedImage:blob", "EncodedDepthImage:blob", "RawBytes:", "LinkEvent:", "HealthReport:", "Health:"),
)
"""What items are made of; all else is there to be looked at."""
STAMPS = ("Stamp:host_ns", "RawBytes:host_ns", "LinkEvent:host_ns", "HealthReport:host_ns")
"""One of these every item has, and once."""
SINCE = ("lost_by_time", "silent_s")
"""Of a device's health, what older recordings lack."""
CONTENTS = tuple(f"/{kind}/**" for kind in KINDS)

_PART = re.compile(r"(?:[^/\\]|\\.)+")
_ESCAPED = re.compile(r"\\(?:u\{([0-9a-fA-F]+)\}|(.))")
_CONTROL = {"n": "\n", "r": "\r", "t": "\t"}

_logger = logging.getLogger(__name__)

Cells = dict[str, Any]
"""What one item is made of: arrays, or lists of words, by the component's name below the item's entity."""

Key = tuple[str, str, int]
"""Kind, device, and the place in its stream; the time [ns] of a report, the row of what else may come at one moment."""


def read_items(path: Path, *, trust: bool = False, kinds: Sequence[str] = KINDS) -> Iterator[Item]:
    """The items of a recording in order of time; of one moment in the order in which they were recorded.

    Portions of a recording may lie in any order. Their times are read first; then an item waits only until nothing
    before it can come any more, so that a long recording is never held whole. JPEG images come as a viewer shows them;
    all else is equal to what was recorded. A frame that a crash cut off is left out, with a warning.
    trust: skip the comparison with the ledger; kinds: those of `KINDS` alone
    """
    replay = Replay(path, trust=trust)
    starts = _Starts(replay, kinds)
    parts: dict[Key, Cells] = {}
    waiting: list[tuple[int, bytes, Key]] = []
    cut_off: Counter[tuple[str, str]] = Counter()
    for chunk in _moving(replay, kinds):
        for when, row_id, key, cells in _rows(chunk):
            parts.setdefault(key, {}).update(cells)
            if row_id is not None:
                heapq.heappush(waiting, (when, row_id, key))
        until = starts.after(chunk)
        while waiting and (until is None or waiting[0][0] < until):
            kind, device, place = key = heapq.heappop(waiting)[2]
            try:
                yield _MAKERS[kind](parts.pop(key), device, place)
            except KeyError:  # a part of it is missing
                cut_off[kind, device] += 1
    for (kind, device), count in cut_off.items():
        _logger.warning("%d of %s %s were recorded in part, and are left out", count, kind, device)


def read_streams(path: Path, *, trust: bool = False) -> tuple[Stream, ...]:
    """What was known of the recorded devices before their first frames, by kind and name."""
    found: dict[str, Stream] = {}
    for chunk in Replay(path, trust=trust).chunks(*CONTENTS):
        batch = chunk.to_record_batch()
        if chunk.is_static and "stream" in batch.schema.names:
            for cell in batch.column("stream").to_pylist():
                found[chunk.entity_path] = stream_from_json(cell[0])
    return tuple(found[entity] for entity in sorted(found))


class _Starts:
    """The earliest time of each portion that is still to come."""

    def __init__(self, replay: Replay, kinds: Sequence[str]) -> None:
        self._coming = [(min(_times(chunk), default=0), str(chunk.id)) for chunk in _moving(replay, kinds)]
        heapq.heapify(self._coming)
        self._done: set[str] = set()

    def after(self, chunk: Chunk) -> int | None:
        """Once this portion has come: nothing that follows is earlier [ns]; None = nothing follows."""
        self._done.add(str(chunk.id))
        while self._coming and self._coming[0][1] in self._done:
            self._done.remove(heapq.heappop(self._coming)[1])
        return self._coming[0][0] if self._coming else None


def _moving(replay: Replay, kinds: Sequence[str]) -> Iterator[Chunk]:
    contents = [f"/{kind}/**" for kind in kinds]
    return (chunk for chunk in replay.chunks(*contents) if not chunk.is_static and "session" in chunk.timeline_names)


def _times(chunk: Chunk) -> list[int]:
    times: list[int] = chunk.to_record_batch().column("session").cast("int64").to_pylist()
    return times


def _rows(chunk: Chunk) -> Iterator[tuple[int, bytes | None, Key, Cells]]:
    """(time [ns], row id, key, cells) of each row. The row id is there in that part of an item which has its stamp."""
    kind, *names = (_unescaped(part) for part in _PART.findall(chunk.entity_path))
    device, below = (names[0], names[1:]) if names else ("", [])
    if kind == "raw":
        kind, below = "/".join([kind, *below]), []
    elif kind == "health" and device:
        device, below = "", [device]
    own = "index" if "touch" in chunk.timeline_names else "frame"  # in an exploration `frame` is the depth camera's
    if kind in FRAMES and own not in chunk.timeline_names:
        return  # where a plot breaks off
    batch = chunk.to_record_batch()
    times = _times(chunk)
    frames = batch.column(own).to_pylist() if own in chunk.timeline_names else times
    ids = batch.column("rerun.controls.RowId").to_pylist()
    cells = {"/".join([*below, name]): _cells(batch.column(name)) for name in batch.schema.names if _measured(name)}
    stamped = next((name for name in cells if name in STAMPS), None)
    for row, (when, frame, row_id) in enumerate(zip(times, frames, ids, strict=True)):
        found = {name: cell[row] for name, cell in cells.items() if cell[row] is not None}
        place = frame if kind in FRAMES or kind == "health" else int.from_bytes(row_id, "big")
        yield when, row_id if stamped in found else None, (kind, device, place), found


def _measured(name: str) -> bool:
    return name.startswith(MEASURED)


def _cells(column: Any) -> list[Any]:
    """One array a row, or one list of words; None where there is nothing."""
    values, offsets = column.values, column.offsets.to_numpy()
    if str(values.type) == "string":
        cut = values.to_pylist()
    elif hasattr(values.type, "value_type"):  # one blob a row
        cut, offsets = values.values.to_numpy(zero_copy_only=False), values.offsets.to_numpy()[offsets]
    else:
        cut = values.to_numpy(zero_copy_only=False)
    rows = [cut[first:last] for first, last in pairwise(offsets)]
    return [row if there else None for row, there in zip(rows, column.is_valid().to_pylist(), strict=True)]


# One maker a kind ----------------------------------------------------------------------------------------------------


def _wrench(cells: Cells, device: str, index: int) -> WrenchFrame:
    torque = _channels(cells, "torque_nm")
    return WrenchFrame(
        stamp=_stamp(cells),
        index=index,
        counts=cells["WrenchFrame:counts"],
        force_n=np.stack(_channels(cells, "force_n") or [cells["force_n/0/Scalars:scalars"]]),
        torque_nm=np.stack(torque) if torque else None,
        overload=bool(cells["WrenchFrame:overload"][0]),
        usable=bool(cells["WrenchFrame:usable"][0]),
        device=device,
    )


def _channels(cells: Cells, quantity: str) -> list[FloatArray]:
    found: list[FloatArray] = []
    while (name := f"{quantity}/{len(found)}/Scalars:scalars") in cells:
        found.append(cells[name])
    return found


def _tactile(cells: Cells, device: str, index: int) -> TactileFrame:
    shapes = cells["TactileFrame:shape"].reshape(-1, 2)
    ends = np.cumsum(shapes.prod(axis=1))[:-1]
    pads = np.split(cells["TactileFrame:pressure_pa"], ends) if len(shapes) else []
    return TactileFrame(
        stamp=_stamp(cells),
        index=index,
        counts=cells["TactileFrame:counts"],
        pressure_pa=tuple(pad.reshape(shape) for pad, shape in zip(pads, shapes, strict=True)),
        device=device,
    )


def _arm(cells: Cells, device: str, index: int) -> ArmFrame:
    return ArmFrame(
        stamp=_stamp(cells),
        index=index,
        joint_deg=cells["joint_deg/Scalars:scalars"],
        joint_velocity_deg_s=cells["joint_velocity_deg_s/Scalars:scalars"],
        joint_torque_nm=cells["joint_torque_nm/Scalars:scalars"],
        position_m=cells["position_m/Scalars:scalars"],
        rotation_rad=cells["rotation_rad/Scalars:scalars"],
        force_n=cells["force_n/Scalars:scalars"],
        torque_nm=cells["torque_nm/Scalars:scalars"],
        finger=cells["finger/Scalars:scalars"],
        queued=int(cells["ArmFrame:queued"][0]),
        device=device,
    )


def _hand(cells: Cells, device: str, index: int) -> HandFrame:
    return HandFrame(
        stamp=_stamp(cells),
        index=index,
        position_deg=cells["position_deg/Scalars:scalars"],
        velocity_deg_s=cells["velocity_deg_s/Scalars:scalars"],
        temperature_c=cells["temperature_c/Scalars:scalars"],
        state=tuple(cells["HandFrame:state"]),
        device=device,
    )


def _color(cells: Cells, device: str, index: int) -> ColorFrame:
    image = decode_image(cells["EncodedImage:blob"].tobytes(), f"image {index} of {device}")
    return ColorFrame(_stamp(cells), index, image, device)


def _depth(cells: Cells, device: str, index: int) -> DepthFrame:
    where = f"image {index} of {device}"
    colored = bool(cells["DepthFrame:colored"][0])
    return DepthFrame(
        stamp=_stamp(cells),
        index=index,
        depth=decode_image(cells["EncodedDepthImage:blob"].tobytes(), where),
        unit_m=float(cells["DepthFrame:unit_m"][0]),
        color=decode_image(cells["color/EncodedImage:blob"].tobytes(), where) if colored else None,
        device=device,
    )


def _raw(sent: bool) -> Callable[[Cells, str, int], Item]:
    def make(cells: Cells, device: str, row: int) -> RawBytes:
        return RawBytes(int(cells["RawBytes:host_ns"][0]), cells["RawBytes:data"].tobytes(), sent, device)

    return make


def _link(cells: Cells, device: str, when: int) -> LinkChange:
    host_ns = int(cells["LinkEvent:host_ns"][0])
    return LinkChange(LinkEvent(host_ns, Link(cells["LinkEvent:link"][0]), cells["LinkEvent:reason"][0]), device)


def _health(cells: Cells, device: str, when: int) -> HealthReport:
    return HealthReport(
        int(cells["HealthReport:host_ns"][0]),
        tuple((name, _device_health(cells, f"{name}/Health:")) for name in cells["HealthReport:devices"]),
    )


def _device_health(cells: Cells, prefix: str) -> Health:
    counters = ("received", "lost", "dropped", "skipped_bytes", "resyncs", "reconnects")
    since = {name: cells[f"{prefix}{name}"][0] for name in SINCE if f"{prefix}{name}" in cells}
    age_s, clock = cells[f"{prefix}age_s"], cells[f"{prefix}clock"]
    return Health(
        link=Link(cells[f"{prefix}link"][0]),
        reason=cells[f"{prefix}reason"][0],
        refused=json.loads(cells[f"{prefix}refused"][0]),
        rate_hz=float(cells[f"{prefix}rate_hz"][0]),
        age_s=float(age_s[0]) if len(age_s) else None,
        stuck=bool(cells[f"{prefix}stuck"][0]),
        clock=ClockRelation(**json.loads(clock[0])) if len(clock) else None,
        extra=json.loads(cells[f"{prefix}extra"][0]),
        lost_by_time=int(since.get("lost_by_time", 0)),
        silent_s=float(since.get("silent_s", 0.0)),
        **{counter: int(cells[f"{prefix}{counter}"][0]) for counter in counters},
    )


_MAKERS: dict[str, Callable[[Cells, str, int], Item]] = {
    "wrench": _wrench,
    "tactile": _tactile,
    "arm": _arm,
    "hand": _hand,
    "color": _color,
    "depth": _depth,
    "raw/received": _raw(False),
    "raw/sent": _raw(True),
    "link": _link,
    "health": _health,
}


def _stamp(cells: Cells) -> Stamp:
    ticks = cells["Stamp:device_ticks"]
    return Stamp(int(cells["Stamp:host_ns"][0]), int(ticks[0]) if len(ticks) else None)


def _unescaped(part: str) -> str:
    """A device's name as it was before it became part of a path."""

    def one(found: re.Match[str]) -> str:
        if found[1] is not None:
            return chr(int(found[1], 16))
        return _CONTROL.get(found[2], found[2])

    return _ESCAPED.sub(one, part)
