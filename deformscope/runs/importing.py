"""Imports data of other programs as a recording like that of a rig."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import msgspec
import numpy as np

from deformscope.config import ImportConfig
from deformscope.errors import InputError, printable
from deformscope.experiments.live.live_stages import StageCounts, live_stages
from deformscope.file_io import none_larger
from deformscope.files.table_file import cut_words
from deformscope.frames import HealthReport
from deformscope.imports.import_map import ImportMap, read_map
from deformscope.imports.inspect import Found, inspect, propose
from deformscope.imports.readers import open_reader
from deformscope.imports.source import ImportSource
from deformscope.imports.values import StreamValues, stream_values
from deformscope.log.layout import RIG, RigLayout
from deformscope.pictures.recorded import Preview, preview_png
from deformscope.pictures.report import Table
from deformscope.plain import plain
from deformscope.recording.losses import losses_of
from deformscope.runs.recordings import RecordResult
from deformscope.runs.result import open_recorder, recording_rows
from deformscope.session import Inline, finish, run
from deformscope.stages.msm.quiet import quiet_warp
from deformscope_drivers.health import Health

if TYPE_CHECKING:
    from deformscope.experiments.live.device_stages import Stage

LONG_GAP = 100
"""A gap in a stream is reported if it is longer than this number of usual steps."""


@dataclasses.dataclass(frozen=True, slots=True)
class Inspected:
    """Content of a source. topics: topics as in the JSON; toml: a map as a start, with the findings as its comments
    values: what the map's streams hold"""

    topics: list[dict[str, Any]]
    toml: str
    values: list[StreamValues]

    def picture(self) -> bytes:
        """The streams as a PNG."""
        shown = []
        for one in self.values:
            points = {name: np.array(found.means).T for name, found in one.quantities.items() if found.means}
            lines = {f"{name} [{one.quantities[name].unit or '?'}]": values for name, (_, values) in points.items()}
            times = next((times for times, _ in points.values()), np.zeros(0))
            lines = {name: values for name, values in lines.items() if len(values) == len(times)}
            shown.append(
                Preview(
                    one.to_text().partition(";")[0][:100],
                    "time [s]" if one.is_timed else "row",
                    times,
                    lines,
                    one.image,
                )
            )
        return preview_png(shown)


def inspect_source(config: ImportConfig) -> Inspected:
    """Read a source once, and propose a map."""
    given = ImportMap() if config.map is None else read_map(config.map, is_draft=True)
    times = [one.time for one in given.streams]
    with none_larger(config.largest_mb * 10**6), open_reader(config.source, given.skip_rows, times) as reader:
        found = inspect(reader)
        asked = given if given.streams else msgspec.structs.replace(propose(reader, found), skip_rows=given.skip_rows)
        values = stream_values(reader, asked)
    said: list[Found | StreamValues] = [*found, *values]
    lines = ["# " + "\\n".join(printable(one.to_text()).split("\n")) for one in said]
    toml = asked.to_toml() if config.map is None or not given.streams else config.map.read_text(encoding="utf-8")
    facts = [
        {"topic": one.topic.name, "type": one.topic.type, "messages": one.seen.count, "rate_hz": one.seen.rate_hz}
        | {"longest_gap_s": one.seen.gap_ns / 1e9, "clock_s": one.clock_s, "columns": dict(one.topic.units)}
        for one in found
    ]
    return Inspected(facts, "\n".join([*lines, "", toml]), values)


def import_source(config: ImportConfig) -> RecordResult:
    """Record it. Raises InputError for missing keys of the map and for errors; then no file remains."""
    if config.map is None:
        raise InputError("--map", "none", f"deformscope import --inspect {config.source} > map.toml")
    asked = read_map(config.map)
    settings = {
        "rig": asked.rig_text(),
        "rig_name": config.source.name,
        "import": {"source": config.source.name, "map": config.map.read_text(encoding="utf-8")},
    }
    with (
        none_larger(config.largest_mb * 10**6),
        open_reader(config.source, asked.skip_rows, [one.time for one in asked.streams]) as reader,
        ImportSource(reader, asked) as source,
    ):
        stages: tuple[Stage, ...] = ()
        if names := config.stages.names:
            from deformscope.experiments.live.device_stages import stages_of
            from deformscope.runs.rig_run import live_options

            quiet_warp()
            options = live_options(config.stages, source.rig, source.streams)
            settings["stages"], stages = dataclasses.asdict(options), stages_of(options, source.streams)
        with open_recorder(config.output, settings, RIG.variant("import"), whole_or_nothing=True) as recorder:
            lossless = [stream.device for stream in source.streams if stream.kind in ("color", "depth")]
            shown = tuple((stage.name, stage.device) for stage in stages)
            recorder.start(RigLayout(source.streams, shown), source.start_ns, lossless)

            def is_over(items: Sequence[object]) -> bool:
                return source.ended and not items  # what the last items gave comes with the next step

            within = {str(name): Inline() for name in names}
            experiment = live_stages(stages, within, is_over, lossless=True, clock=lambda: source.now_ns)
            counts = run(source, experiment, recorder)
            last = finish(source, recorder)
            recorder.stopped_because("the source is at its end")
        return _result(config, source, last, recorder.summary(), counts)


def _result(
    config: ImportConfig, source: ImportSource, last: HealthReport, summary: Any, stages: Mapping[str, StageCounts]
) -> RecordResult:
    devices = dict(last.devices)
    kinds = {stream.device: stream.kind for stream in source.streams}
    seen, losses = source.seen, losses_of(last)
    rows = [(name, _words(kinds[name], health, seen.get(name, {}))) for name, health in devices.items()]
    for name, one in seen.items():
        if not one["valid_share"]:
            losses[name] = losses.get(name, {}) | {"unseen": devices[name].received}
            rows.append((name, _likely(one)))
    cuts = {one.name: one.cut for one in source.topics.values() if one.cut}
    rows += [(name, cut_words(cut)) for name, cut in cuts.items()]
    gaps_s = {name: gap_s for name, gap_s in source.gaps_s.items() if gap_s * devices[name].rate_hz > LONG_GAP}
    rows += [(name, f"longest gap {gap_s:.4g} s") for name, gap_s in gaps_s.items()]
    rows += [(f"stage {name}", counts.to_text()) for name, counts in stages.items()]
    found: dict[str, object] = {"recording": summary.path, "frames": summary.frames, "bytes": summary.bytes}
    found |= {"stages": {name: counts.as_json() for name, counts in stages.items()}} if stages else {}
    found |= {"source": config.source, "devices": devices, "losses": losses, "long_gaps_s": gaps_s, "seen": seen}
    table = Table([*rows, *recording_rows(summary)], caption=str(config.source))
    return RecordResult(cast("dict[str, Any]", plain(found)), table)


def _words(kind: str, health: Health, seen: Mapping[str, Any]) -> str:
    """Frames of a device, and how much of them is valid. seen: as of `ImportSource.seen`"""
    words = f"{health.received} frames ({kind})"
    words += f", {health.lost} of its messages made no frame" if health.lost else ""
    words += f", {seen['left_out']} messages of others left out" if seen.get("left_out") else ""
    if "range_m" in seen or seen.get("valid_share", 1.0) < 1.0:
        words += f", {100 * seen['valid_share']:.3g} % of its values valid"
    words += ", {:.4g} to {:.4g} m".format(*seen["range_m"]) if "range_m" in seen else ""
    words += f", {seen['frames_without']} frames without any" if seen.get("frames_without") else ""
    words += f", {seen['beyond']} pixels beyond the last step of unit_m" if seen.get("beyond") else ""
    return words + (f", {seen['outside']} points outside the image" if seen.get("outside") else "")


def _likely(seen: Mapping[str, Any]) -> str:
    """Why nothing of a stream is valid."""
    causes = {
        "beyond": "distances beyond 65535 steps: a larger unit_m, or their unit (units)",
        "outside": "points outside the image: axes, focal_px, center_px, size_px, or their unit (units)",
    }
    found = [words for key, words in causes.items() if seen.get(key)]
    return "nothing valid, probably " + ("; ".join(found) or "another topic: all its values are 0 or no numbers")
