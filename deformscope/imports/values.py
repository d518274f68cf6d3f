"""The streams of a map in few numbers and a picture: a person judges whether they are what was measured."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from deformscope.arrays import FloatArray, ImageArray
from deformscope.errors import InputError
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame, HandFrame, TactileFrame, WrenchFrame
from deformscope.imports.frame_builder import TIME_NS
from deformscope.imports.import_map import ASKED, ImportMap, MappedStream
from deformscope.imports.readers import TABLE_TYPES, Reader
from deformscope.imports.source import ImportSource

MOST_IMAGES, MOST_ROWS = 100, 100_000
"""How many frames of a stream are looked at: its first."""
MOST_SHOWN = 12
"""Quantities of a stream in its line."""
KEPT = 4096
"""Values that a median is of, and points of a picture, up to twice as many."""
Quantities = dict[str, tuple[str, FloatArray]]
"""Unit and values of each."""


@dataclass(slots=True)
class QuantityValues:
    """Values in a unit. known: how many of `count` are; means: mean of each row with its time, `every` rows apart"""

    unit: str
    count: int = 0
    known: int = 0
    smallest: float = np.inf
    largest: float = -np.inf
    every: int = 1
    values: list[FloatArray] = field(default_factory=list)
    means: list[tuple[float, float]] = field(default_factory=list)

    def add(self, values: FloatArray, at: int, time_s: float) -> None:
        """Values of one row. at: its number"""
        good = values[np.isfinite(values)]
        self.count, self.known = self.count + values.size, self.known + good.size
        if not good.size:
            return
        self.smallest, self.largest = min(self.smallest, float(good.min())), max(self.largest, float(good.max()))
        if at % self.every == 0:
            self.values.append(good[:: max(good.size // 512, 1)])
            self.means.append((time_s, float(good.mean())))
            if len(self.values) > 2 * KEPT:
                self.values, self.means, self.every = self.values[::2], self.means[::2], 2 * self.every

    @property
    def three(self) -> tuple[float, float, float]:
        """Smallest, median, largest."""
        return self.smallest, float(np.median(np.concatenate(self.values))), self.largest


@dataclass(slots=True)
class StreamValues:
    """Values of a stream of a map. why: why there are none, or in the source's units alone; image: its last that was
    looked at; is_timed: rows have times; is_part: there are more rows"""

    device: str
    kind: str
    why: str = ""
    rows: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    is_timed: bool = True
    is_part: bool = False
    quantities: dict[str, QuantityValues] = field(default_factory=dict)
    image: ImageArray | FloatArray | None = None

    @property
    def rate_hz(self) -> float:
        """Mean rate; 0 = not known."""
        span_s = self.last_s - self.first_s
        return (self.rows - 1) / span_s if span_s > 0 and self.is_timed else 0.0

    @property
    def valid(self) -> float:
        """Share of values that are numbers, of pixels that saw something."""
        return sum(one.known for one in self.quantities.values()) / max(
            sum(one.count for one in self.quantities.values()), 1
        )

    def add(self, found: Quantities, time_s: float) -> None:
        """One row."""
        self.first_s, self.last_s = (self.first_s if self.rows else time_s), time_s
        for name, (unit, values) in found.items():
            self.quantities.setdefault(name, QuantityValues(unit)).add(values, self.rows, time_s - self.first_s)
        self.rows += 1

    def to_text(self) -> str:
        known = {name: one for name, one in self.quantities.items() if one.values}
        each = [
            f"{name} {', '.join(f'{value:.4g}' for value in one.three)}{one.unit and f' {one.unit}'}"
            for name, one in list(known.items())[:MOST_SHOWN]
        ]
        each += [f"{len(known) - MOST_SHOWN} more"] if len(known) > MOST_SHOWN else []
        rate = f"{self.rate_hz:.4g}/s, " if self.rate_hz else ""
        numbers = f"{rate}{100 * self.valid:.4g} % valid; smallest, median, largest: {'; '.join(each)}" if each else ""
        more = f" (its first {self.rows})" if self.is_part else ""
        said = "; ".join(one for one in (numbers + more, self.why) if one)
        return f"stream {self.device} ({self.kind}): {said or 'no values'}"

    def as_json(self) -> dict[str, Any]:
        named = {name: one for name, one in self.quantities.items() if one.values}
        each = {
            name: {"unit": one.unit, **dict(zip(("smallest", "median", "largest"), one.three, strict=True))}
            for name, one in named.items()
        }
        about: dict[str, Any] = {"device": self.device, "kind": self.kind, "rate_hz": self.rate_hz}
        return about | {"valid": self.valid, "rows": self.rows, "quantities": each, "why": self.why}


def stream_values(reader: Reader, asked: ImportMap) -> list[StreamValues]:
    """Values of each stream of a map in SI units; where the map still asks, those of its tables' columns."""
    return [_of_stream(reader, asked, one) for one in asked.streams]


def _of_stream(reader: Reader, asked: ImportMap, stream: MappedStream) -> StreamValues:
    made = StreamValues(stream.device, stream.kind)
    try:
        with ImportSource(reader, msgspec.structs.replace(asked, streams=(stream,), start_ns=None)) as source:
            while not source.ended and made.rows < MOST_ROWS and (made.image is None or made.rows < MOST_IMAGES):
                for frame in source.take(0.0):
                    if found := _of_frame(frame, made):
                        made.add(found, frame.stamp.host_ns / 1e9)  # type: ignore[union-attr]
            made.is_part = not source.ended
        alone = [one for one in stream.columns if one.startswith("force_") and one != "force_n"]
        if stream.kind == "wrench" and len(alone) == 1:
            made.why = f"a force along {alone[0][6]} alone, 0 along the others"
    except InputError as error:
        made.why = str(error).partition(" | ")[0]
        if not made.rows and all(
            reader.topics[one].type in TABLE_TYPES for one in stream.topics if one in reader.topics
        ):
            # what the map still asks need not be said again
            made = StreamValues(stream.device, "as in the source", "" if f"'{ASKED}'" in repr(stream) else made.why)
            for row, time_s in _rows(reader, stream, made):
                made.add(row, time_s)
    return made


def _rows(reader: Reader, stream: MappedStream, made: StreamValues) -> Iterator[tuple[Quantities, float]]:
    units = {
        name: unit
        for topic in stream.topics
        if topic in reader.topics
        for name, unit in reader.topics[topic].units.items()
    }
    unit = units.get(stream.time) or stream.time_unit
    made.is_timed = stream.time in units and unit in TIME_NS
    for at, message in enumerate(reader.messages([one for one in stream.topics if one in reader.topics])):
        if at == MOST_ROWS:
            made.is_part = True
            return
        row: Mapping[str, Any] = message.value
        time = row.get(stream.time) if made.is_timed else at
        time_s = time * TIME_NS[unit] / 1e9 if made.is_timed and isinstance(time, int | float) else float(at)
        found: Quantities = {}
        for name, one in row.items():
            numbers, unit_of = _numbers(one), units.get(name, "")
            parts = 1 < len(numbers) <= MOST_SHOWN
            named = (
                {f"{name}[{part}]": numbers[part : part + 1] for part in range(len(numbers))}
                if parts
                else {name: numbers}
            )
            found |= {name: (unit_of, values) for name, values in named.items() if len(values)}
        yield found, time_s


def _numbers(value: Any) -> FloatArray:
    """(n,); none of a text."""
    try:
        return np.asarray(np.nan if value is None else value, np.float64).ravel()
    except (TypeError, ValueError):
        return np.zeros(0)


def _of_frame(frame: object, made: StreamValues) -> Quantities:
    """Quantities of a frame in SI units; an image is kept."""
    match frame:
        case WrenchFrame():
            vectors = {"force": ("N", frame.force_n)}
            vectors |= {} if frame.torque_nm is None else {"torque": ("N m", frame.torque_nm)}
            return {
                f"{name}_{f'{at}_' * (len(vector) > 1)}{axis}": (unit, vector[at, place : place + 1])
                for name, (unit, vector) in vectors.items()
                for at in range(len(vector))
                for place, axis in enumerate("xyz")
            }
        case TactileFrame():
            return {"pressure": ("Pa", np.concatenate([one.ravel() for one in frame.pressure_pa]))}
        case ArmFrame():
            found: Quantities = {
                f"position_{axis}": ("m", frame.position_m[at : at + 1]) for at, axis in enumerate("xyz")
            }
            return found | ({"joint angle": ("rad", np.deg2rad(frame.joint_deg))} if len(frame.joint_deg) else {})
        case HandFrame():
            return {"joint angle": ("rad", np.deg2rad(frame.position_deg))}
        case DepthFrame():
            distance_m: FloatArray = np.where(frame.depth > 0, frame.depth * frame.unit_m, np.nan)
            made.image = distance_m
            return {"distance": ("m", distance_m.ravel())}
        case ColorFrame():
            made.image = frame.image
            return {"brightness": ("", frame.image.ravel()[:: max(frame.image.size // 4096, 1)].astype(np.float64))}
    return {}
