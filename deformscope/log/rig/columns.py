"""Columns of a batch: one call to rerun for many rows of an entity."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import rerun as rr
from rerun.chunk import Chunk

from deformscope.arrays import FloatArray, IntArray
from deformscope.frames import Frame, StageCost
from deformscope.pictures.palette import Rgb
from deformscope.rows import ENTITIES, FRAMES, OF_DEVICES, to_columns

Columns = Iterable[rr.ComponentColumn]

AGAIN_NS = 10_000_000_000
"""Constants are sent again after this time, for viewers that missed them."""

Shown = dict[str, tuple[object, int]]
"""Data that seldom change, with the host time when a viewer received them [ns]: the scale next to each device's
picture, the state of each device."""


@dataclass(frozen=True, slots=True)
class Place:
    """Place of rows on an exploration's timelines, in addition to `session`.

    touch: place on the timeline `touch`; pictures_ns: (n,) session times of the depth camera's pictures so far, rising
    [ns]. On `frame` a row is at the picture that was newest then, so that all devices scrub together, and on `index` at
    its index in its own device's stream; frame: use this picture instead, None = find it by the time; start_ns: the
    host's clock at `session` 0"""

    touch: int
    pictures_ns: IntArray
    frame: int | None = None
    start_ns: int = 0

    def at(self, session_ns: IntArray) -> IntArray:
        """Frames (m,) of times (m,) [ns]; 0 before the first picture."""
        if self.frame is not None:
            return np.full(len(session_ns), self.frame)
        return np.maximum(np.searchsorted(self.pictures_ns, session_ns, side="right") - 1, 0)

    def moved(self, times: Sequence[rr.TimeColumn]) -> list[rr.TimeColumn]:
        """The times of a recording of devices, converted to those of an exploration."""
        by_name = {time.timeline_name(): time.as_arrow_array() for time in times}
        session_ns = by_name["session"].cast(pa.int64()).to_numpy()
        own = [rr.TimeColumn("index", sequence=by_name["frame"].to_numpy())] if "frame" in by_name else []
        return [
            *(time for time in times if time.timeline_name() != "frame"),
            *own,
            rr.TimeColumn("frame", sequence=self.at(session_ns)),
            rr.TimeColumn("touch", sequence=np.full(len(session_ns), self.touch)),
        ]


class Batch:
    """Calls to rerun that are prepared once, with encoded images, and sent to any number of streams.

    place: in an exploration, place of the rows on its timelines"""

    def __init__(self, place: Place | None = None) -> None:
        self.parts: list[tuple[str, Chunk | Callable[[rr.RecordingStream], None]]] = []
        self.place = place

    def send_columns(self, path: str, times: Sequence[rr.TimeColumn], columns: Columns) -> None:
        """Store columns until `send`; arguments as in `rr.RecordingStream.send_columns`."""
        ready = list(columns)
        when = list(times) if self.place is None else self.place.moved(times)
        self.parts.append((path, Chunk.from_columns(path, when, ready)))

    def send_series(self, path: str, host_ns: IntArray, columns: Columns) -> None:
        """Log rows, each at its time on the host's clock and at the picture that was newest then."""
        assert self.place is not None
        own, self.place = self.place, replace(self.place, frame=None)
        self.send_columns(path, moments(host_ns, own.start_ns), columns)
        self.place = own

    def show(self, path: str, times: Sequence[rr.TimeColumn], entity: rr.AsComponents) -> None:
        """Log one row: an entity at one time."""
        parts = [(one.component_descriptor(), one) for one in entity.as_component_batches()]
        columns = [rr.ComponentColumn(named, one, lengths=[len(one.as_arrow_array())]) for named, one in parts]
        self.send_columns(path, times, columns)

    def log(self, path: str, entity: rr.AsComponents, *, static: bool) -> None:
        """Store an entity until `send`; arguments as in `rr.RecordingStream.log`."""
        self.parts.append((path, lambda rec: rec.log(path, entity, static=static)))

    def send(self, rec: rr.RecordingStream, visible: Callable[[str], bool] | None = None) -> None:
        """Send the whole batch, or only the entities that are visible."""
        for path, part in self.parts:
            if visible is not None and not visible(path):
                continue
            if isinstance(part, Chunk):
                rec.send_chunks(part)
            else:
                part(rec)


Sink = rr.RecordingStream | Batch
"""Destination of logged data."""


def is_news(shown: Shown | None, device: str, what: object, now_ns: int) -> bool:
    """Whether the scale next to a device's picture has to be sent: it has changed, or viewers may have missed it."""
    before, since_ns = (None, 0) if shown is None else shown.get(device, (None, 0))
    if what == before and now_ns - since_ns < AGAIN_NS:
        return False
    if shown is not None:
        shown[device] = what, now_ns
    return True


def root(kind: str, device: str, *below: str) -> str:
    """The entity of a device, for any letters in its name."""
    return "/".join([kind, rr.escape_entity_path_part(device), *below])


def moments(host_ns: Sequence[int] | IntArray, start_ns: int) -> list[rr.TimeColumn]:
    """Times of rows that are no frames."""
    return [rr.TimeColumn("session", duration=(np.array(host_ns, np.int64) - start_ns).astype("timedelta64[ns]"))]


def frame_times(frames: Sequence[Frame], start_ns: int) -> list[rr.TimeColumn]:
    """Times of frames: the session time, and the place in the device's stream."""
    indices = np.array([frame.index for frame in frames], np.int64)
    return [*moments([frame.stamp.host_ns for frame in frames], start_ns), rr.TimeColumn("frame", sequence=indices)]


def recorded(items: Sequence[object], leave_out: tuple[str, ...] = ()) -> list[rr.ComponentColumn]:
    """Every field of these items except images, entity and times; all items have the same class and, if any, device."""
    kind, found = type(items[0]), list[rr.ComponentColumn]()
    elsewhere = ("device",) * (kind in OF_DEVICES) + ("index",) * (kind in FRAMES)
    for name, column in to_columns(items, elsewhere + leave_out).items():
        made = rr.DynamicArchetype.columns(archetype=kind.__name__, components={name: column.values})
        found += made.partition(column.lengths)
    return found


def prepare_costs(rows: Sequence[tuple[int, int | None, StageCost]]) -> Batch:
    """Costs of stages: `session` [ns], and `frame` if all are at one."""
    times_ns, frames, costs = zip(*rows, strict=True)
    at = [] if None in frames else [rr.TimeColumn("frame", sequence=frames)]
    batch = Batch()
    batch.send_columns(ENTITIES[StageCost], [*moments(times_ns, 0), *at], recorded(costs))
    return batch


def scalars(rows: Sequence[FloatArray]) -> Columns:
    """One (n,) array a row, as a plot shows it: n series, float64."""
    flat: npt.NDArray[np.float64] = np.concatenate(rows).astype(np.float64, copy=False)
    batch = rr.components.ScalarBatch(flat)
    return [rr.ComponentColumn(rr.Scalars.descriptor_scalars(), batch, lengths=[len(row) for row in rows])]


def states(colors: Mapping[Any, Rgb]) -> rr.StateConfiguration:
    """The colours of a lane over time."""
    return rr.StateConfiguration(values=list(map(str, colors)), colors=list(colors.values()))


def log_series(rec: Sink, path: str, names: Sequence[str], colors: Sequence[tuple[int, ...]]) -> None:
    """Log names and colours of the series at a path, which are constant."""
    rec.log(path, rr.SeriesLines(names=list(names), colors=list(colors), widths=[1.5] * len(names)), static=True)
