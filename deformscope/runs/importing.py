"""Data of others as a recording like any rig's."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any, cast

from deformscope.config import ImportConfig
from deformscope.errors import InputError, printable
from deformscope.experiments.live_stages import live_stages
from deformscope.frames import HealthReport
from deformscope.imports.import_map import read_map
from deformscope.imports.inspect import inspect, propose
from deformscope.imports.readers import open_reader
from deformscope.imports.source import ImportSource
from deformscope.log.rig_layout import RIG, RigLayout
from deformscope.pictures.report import Table
from deformscope.plain import plain
from deformscope.recording.losses import losses_of
from deformscope.runs.recordings import RecordResult
from deformscope.runs.result import open_recorder, recording_rows
from deformscope.session import finish, run

LONG_GAP = 100
"""Of so many usual steps a gap in a stream is told."""


@dataclasses.dataclass(frozen=True, slots=True)
class Inspected:
    """What a source holds. topics: as the JSON has them; toml: a map to begin with, what is found as its comments"""

    topics: list[dict[str, Any]]
    toml: str


def inspect_source(config: ImportConfig) -> Inspected:
    """Read a source once, and propose a map."""
    with open_reader(config.source) as reader:
        found = inspect(reader)
        asked = propose(reader, found)
    lines = ["# " + "\\n".join(printable(one.to_text()).split("\n")) for one in found]
    facts = [
        {"topic": one.topic.name, "type": one.topic.type, "messages": one.messages, "rate_hz": one.rate_hz}
        | {"longest_gap_s": one.gap_ns / 1e9, "clock_s": one.clock_s, "columns": dict(one.topic.units)}
        for one in found
    ]
    return Inspected(facts, "\n".join([*lines, "", asked.to_toml()]))


def import_source(config: ImportConfig) -> RecordResult:
    """Record it. Raises InputError for what the map must say and for what is wrong; then nothing is left."""
    if config.map is None:
        raise InputError("--map", "none", f"deformscope import --inspect {config.source} > map.toml")
    asked = read_map(config.map)
    text = config.map.read_text(encoding="utf-8")
    settings = {
        "rig": asked.rig_text(),
        "rig_name": config.source.name,
        "import": {"source": config.source.name, "map": text},
    }
    with (
        open_reader(config.source, asked.skip_rows, [one.time for one in asked.streams]) as reader,
        contextlib.closing(ImportSource(reader, asked)) as source,
    ):
        with open_recorder(config.output, settings, RIG.variant("import"), whole_or_nothing=True) as recorder:
            lossless = [stream.device for stream in source.streams if stream.kind in ("color", "depth")]
            recorder.start(RigLayout(source.streams), source.start_ns, lossless)

            def is_over(items: object) -> bool:
                return source.ended

            run(source, live_stages((), {}, is_over), recorder)
            last = finish(source, recorder)
            recorder.stopped_because("the source is at its end")
        return _result(config, source, last, recorder.summary())


def _result(config: ImportConfig, source: ImportSource, last: HealthReport, summary: Any) -> RecordResult:
    devices = dict(last.devices)
    kinds = {stream.device: stream.kind for stream in source.streams}
    rows = [(name, _words(kinds[name], health.received, health.lost)) for name, health in devices.items()]
    gaps_s = {name: gap_s for name, gap_s in source.gaps_s.items() if gap_s * devices[name].rate_hz > LONG_GAP}
    rows += [(name, f"longest gap {gap_s:.4g} s") for name, gap_s in gaps_s.items()]
    found: dict[str, object] = {"recording": summary.path, "frames": summary.frames, "bytes": summary.bytes}
    found |= {"source": config.source, "devices": devices, "losses": losses_of(last), "long_gaps_s": gaps_s}
    table = Table([*rows, *recording_rows(summary)], caption=str(config.source))
    return RecordResult(cast("dict[str, Any]", plain(found)), table)


def _words(kind: str, frames: int, lost: int) -> str:
    return f"{frames} frames ({kind})" + (f", {lost} of its messages made none" if lost else "")
