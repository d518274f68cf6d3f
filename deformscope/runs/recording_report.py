"""A recording as a report: figures of the thesis's chapters 2 to 4 from its content, and a list of missing ones."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.errors import InputError
from deformscope.frames import HandFrame
from deformscope.log.layout import EXPLORATION, SQUEEZE
from deformscope.pictures import exploration as drawn_of
from deformscope.pictures.evidence import evidence_png, headline
from deformscope.pictures.figures import depth_change_png
from deformscope.pictures.messages import counted, format_iou, format_verdict
from deformscope.pictures.recorded import Curves, cells_png, curves_png
from deformscope.pictures.report import Figure, Part, ReportVerdict, Section, Table, html_report
from deformscope.plain import Json
from deformscope.recording.items import read_estimates, read_stage_results
from deformscope.recording.reader import BLOB, Replay, Row, read_rows
from deformscope.recording.stages import RecordedStage, recorded_stages
from deformscope.robot.squeeze_plan import CLOSING_AXES
from deformscope.runs.result import LibraryResult
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.map.exploration import InclusionsResult, MapEstimate, SurfaceEstimate, TouchEstimate
from deformscope.stages.map.perception import TouchPerception
from deformscope.stages.see.tactile import TactileContact
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.trial import (
    ContainerChange,
    ContentPosterior,
    FingertipPressure,
    SqueezeFeatures,
    SqueezePhase,
    TrackedContainer,
)

SHOWN = 6
"""Largest number of touches, and of maps, with pictures: the last ones, if there are more."""
TIME = "time since the recording's start [s]"
CHAPTERS = {
    2: "chapter 2: the content of the container",
    3: "chapter 3: meshless shape matching",
    4: "chapter 4: exploring a surface",
    0: "of the run itself",
}
COLUMNS = ("stage", "gives", "entity", "timelines", "rows", "times x CPU (wall) [ms]", "live")
Drawn = tuple[str, list[Section]]
"""The result, in a line, and its figures."""


@dataclass(frozen=True, slots=True)
class RecordingReport(LibraryResult):
    """Figures of a recording. words: the recording in a line; stages: stages with their costs, including those that it
    lacks"""

    recording: Path
    words: str
    stages: tuple[RecordedStage, ...]
    sections: tuple[Section, ...]

    @property
    def lacks(self) -> list[str]:
        """Stages whose rows, or whose costs, were expected and are missing."""
        missing = [one.name for one in self.stages if one.missing]
        return missing + ["costs of the stages"] * (not any(one.computed for one in self.stages))

    def figures(self) -> tuple[Figure, ...]:
        parts = (part for section in self.sections for part in section.parts)
        every = (one for part in parts for one in (part if isinstance(part, tuple) else [part]))
        return tuple(one for one in every if isinstance(one, Figure))

    def tables(self) -> tuple[Table, ...]:
        return (Table([("holds", self.words)], caption=str(self.recording)), *stage_tables(self.stages))

    def as_json(self) -> Json:
        shown = [one.caption for one in self.figures()]
        return {"recording": self.recording, "lacks": self.lacks, "stages": self.stages, "figures": shown}

    def page(self) -> str:
        """The report as one HTML page."""
        lacks = f"It lacks: {', '.join(self.lacks)}." if self.lacks else "It has every stage of its kind."
        first, last = Section("", [ReportVerdict(self.words, (lacks,))]), Section("Stages", stage_tables(self.stages))
        return html_report(self.recording.name, [first, *self.sections, last])


def report_recording(path: Path) -> RecordingReport:
    """Draw the content of a recording. Raises InputError for another kind of file, or an unreadable one."""
    replay = Replay(path)
    kinds: dict[str, Callable[[Replay], Drawn]] = {EXPLORATION.name: _exploration, SQUEEZE.name: _squeeze}
    draw = kinds.get(replay.identity[0]) or (_rig if "rig" in replay.settings else _fits)
    words, sections = draw(replay)
    if found := _found(replay):
        words, sections = found[0], [*found[1], *sections]
    drawn = tuple(one for one in sections if one.parts)
    return RecordingReport(path, words, tuple(recorded_stages(path)), drawn)


def stage_tables(stages: Sequence[RecordedStage]) -> list[Table]:
    """Stages in a recording, and missing ones, a table for each chapter."""
    by_chapter = {title: [one for one in stages if one.chapter == chapter] for chapter, title in CHAPTERS.items()}
    return [Table([_stage_row(one) for one in some], COLUMNS, title) for title, some in by_chapter.items() if some]


def _stage_row(one: RecordedStage) -> tuple[str, ...]:
    rows = str(one.rows or ("MISSING" if one.missing else f"- ({one.when})"))
    nothing = one.cpu_ms is None or not (one.rows or one.missing)  # what is not asked for ends at once
    cost = "-" if nothing else f"{one.computed} x {one.cpu_ms:.3g} ({one.wall_ms:.3g})"
    soon = "live" if one.live else "afterwards"
    live = "-" if nothing or one.behind_ms is None else f"{soon}, {one.behind_ms:.0f} ms behind"
    return one.name, one.gives, f"/{one.entity}", ", ".join(one.timelines) or "-", rows, cost, live


def _read(replay: Replay, *kinds: type) -> list[list[Row]]:
    """The rows of each kind, in order of time."""
    every = list(read_rows(replay, kinds))
    return [[row for row in every if isinstance(row.item, kind)] for kind in kinds]


def _exploration(replay: Replay) -> Drawn:
    """Chapter 4."""
    kinds = SurfaceEstimate, TouchEstimate, MapEstimate, InclusionsResult, TouchPerception
    looks, touches, maps, found, seen = ([row.item for row in rows] for rows in _read(replay, *kinds))
    surfaces = [Figure(drawn_of.height_png(one), "height of the surface (eq. 4.3, 4.4)") for one in looks]
    touched: list[Part] = [_by_touch(touches)] if touches else []
    for one in touches[-SHOWN:]:
        number = one.number
        force = Figure(drawn_of.force_png(one), f"touch {number}: force over depth")
        dent = Figure(drawn_of.section_png(one), f"touch {number}: its dent (as fig. 4.4, 4.6)")
        sweeps = (of for of in seen if of.number == one.number and of.error is not None)
        errors = [Figure(drawn_of.error_png(of), f"touch {number}: error over beta (eq. 4.6)") for of in sweeps]
        touched.append((force, dent, *errors))
    fields: list[Part] = [_progress(maps)] if maps else []
    for after in maps[-SHOWN:]:
        named = (name for name in drawn_of.MAP_DRAWINGS if name.startswith(("beta", "stiffness")))
        caption = f"after {counted(after.touches, 'touch')} (as fig. 4.7)"
        fields.append(tuple(Figure(drawn_of.draw_map(name, after).png, caption) for name in named))
    words, whole = counted(len(touches), "touch"), list[Part]()
    if maps:
        words = ", ".join(one for one in (words, format_verdict(maps[-1]), format_iou(maps[-1])) if one)
        result = drawn_of.result_png(maps[-1], found=found[-1] if found else None)
        whole.append(Figure(result, "measurements of the touches"))
    surface, at_touches = Section("Surface", surfaces), Section("Touches", touched)
    return words, [Section("Map", whole), surface, at_touches, Section("Fields, touch by touch", fields)]


def _by_touch(touches: Sequence[TouchEstimate]) -> Figure:
    nan, at = float("nan"), np.array([one.number for one in touches])
    stiffness = [(one.stiffness_n_per_mm, *one.stiffness_interval) for one in touches]
    beta = [(nan if one.beta is None else one.beta, *(one.beta_interval or (nan, nan))) for one in touches]
    panels = [_with_interval(*one, at) for one in (("stiffness [N/mm], 90 %", stiffness), ("beta [-], 90 %", beta))]
    return Figure(curves_png(panels, "touch"), "stiffness and beta of each touch (as fig. 4.5)")


def _with_interval(label: str, rows: Sequence[tuple[float, ...]], at: Any) -> Curves:
    """rows: value, low, high"""
    value, low, high = np.array(rows, np.float64).reshape(-1, 3).T[..., None]
    return Curves(label, at, value, low=low, high=high)


def _progress(maps: Sequence[MapEstimate]) -> Figure:
    at, nan = np.array([one.touches for one in maps]), float("nan")
    values = {
        "travel over the surface [m]": [one.travel_m for one in maps],
        "deviation of log stiffness [-]": [float(np.mean(one.stiffness_log_sd)) for one in maps],
        "IoU with the truth [-]": [nan if one.iou is None else one.iou for one in maps],
    }
    panels = [Curves(label, at, np.array(some)[:, None]) for label, some in values.items() if np.isfinite(some).any()]
    return Figure(curves_png(panels, "touches"), "travel, deviation and overlap by touch")


def _squeeze(replay: Replay) -> Drawn:
    """Chapter 2."""
    seen_kinds = FingertipPressure, HandFrame, TrackedContainer, ContentPosterior, ContainerChange
    rows = _read(replay, *seen_kinds, SqueezeFeatures, SqueezeEvents, SqueezePhase)
    pressed, hand, tracked, named, changes, features, ended, begun = rows
    tracked, by_step = [row for row in tracked if row.item.good], [row for row in named if row.item.index >= 0]
    rest = np.linalg.inv(tracked[0].item.T_camera_container) if tracked else np.eye(4)
    seen = [row for row in changes if row.item.change_m is not None]
    axes, tips = [int(one) for one in CLOSING_AXES], ("fingertip 1", "fingertip 2")
    labels = by_step[0].item.labels if by_step else ()
    panels = [
        _over_time("force [N]", pressed, lambda one: one.force_n, tips),
        _over_time("contact area [cm\u00b2]", pressed, lambda one: 1e4 * one.area_m2, tips),
        _over_time(
            "closing axes [deg]", hand, lambda one: one.position_deg[axes], tuple(f"axis {one}" for one in axes)
        ),
        _over_time("container moved [mm]", tracked, lambda one: [_moved(rest @ one.T_camera_container)[0]]),
        _over_time("container turned [deg]", tracked, lambda one: [_moved(rest @ one.T_camera_container)[1]]),
        _over_time("depth change, mean [mm]", seen, lambda one: [1e3 * np.nanmean(one.change_m)]),
        _over_time("probability [-]", by_step, lambda one: one.probability, labels),
    ]
    phases = [(row.item.name, row.session_ns / 1e9) for row in begun]
    words, events = "squeezed, without first contact and steady state", list[tuple[str, float]]()
    for row in ended:
        took_s = (row.item.steady_ns - row.item.first_ns) / 1e9
        events = [("first contact", row.session_ns / 1e9 - took_s), ("steady state", row.session_ns / 1e9)]
        words = f"steady state {took_s:.2f} s after first contact"
    if named:
        words += f"; named {named[-1].item.content}"
    shown = [one for one in panels if one is not None]
    curves = [Figure(curves_png(shown, TIME, events, phases), "a squeeze over time")] if shown else []
    return words, [Section("Over time", curves), Section("Features", [_features(row.item) for row in features])]


def _features(one: SqueezeFeatures) -> Part:
    cells = Figure(cells_png(one.tactile.reshape(2, 6, 6)), "tactile feature at steady state (fig. 2.7)")
    if one.vision is None:
        return (cells,)
    change = depth_change_png(one.vision, one.patch_width_m, one.missing)
    return cells, Figure(change, "depth change at steady state, data minus model (fig. 2.6)")


def _moved(T: Any) -> tuple[float, float]:
    """How far [mm], and by how much it turned [deg], of a motion (4, 4)."""
    turned = np.degrees(np.arccos(np.clip(0.5 * (np.trace(T[:3, :3]) - 1.0), -1.0, 1.0)))
    return 1e3 * float(np.linalg.norm(T[:3, 3])), float(turned)


def _over_time(
    label: str, rows: Sequence[Row], value: Callable[[Any], Any], names: tuple[str, ...] = ()
) -> Curves | None:
    times = np.array([row.session_ns / 1e9 for row in rows])
    return Curves(label, times, np.array([value(row.item) for row in rows], np.float64), names) if rows else None


def _rig(replay: Replay) -> Drawn:
    """Stages that ran while the devices did."""
    results = read_stage_results(replay.path, trust=True)
    panels, start_ns = [], min((one.host_ns for one in results), default=0)
    for name in dict.fromkeys(one.stage for one in results):
        mine = [one for one in results if one.stage == name]
        times = np.array([(one.host_ns - start_ns) / 1e9 for one in mine])
        panels.append(Curves(f"{name}: lag [ms]", times, np.array([[1e3 * one.late_s] for one in mine])))
        found = [one.result for one in mine]
        if all(isinstance(one, TactileContact) for one in found):
            panels.append(Curves("force of all pads [N]", times, np.array([[one.force_n.sum()] for one in found])))
        elif all(isinstance(one, MomentFit) for one in found):
            panels.append(_with_interval(f"{name} [-], 90 %", [(one.value, *one.interval) for one in found], times))
    words = f"a rig, {counted(len(results), 'result')} of stages" if results else "a rig without stages"
    label = "time since the first result's frame [s]"
    figures = [Figure(curves_png(panels, label), "results of the stages, and their lag")] if panels else []
    return words, [Section("Stages over time", figures)]


def _found(replay: Replay) -> Drawn | None:
    """The tables and pictures of a command, as they were recorded."""
    figures, tables = list[Figure](), list[Table]()
    for chunk in replay.chunks("/found/picture/**", "/found/tables", "/calibration/chart", "/calibration/summary"):
        batch = chunk.to_record_batch()
        names = [one for one in (BLOB, "caption", "json") if one in batch.schema.names]
        for row in batch.select(names).to_pylist():
            if row.get(BLOB) and row.get("caption"):
                figures.append(Figure(bytes(row[BLOB][0]), row["caption"][0]))
            elif row.get("json"):
                tables += [Table(**one) for one in json.loads(row["json"][0])]
    if not tables:
        return None
    first = " ".join(map(str, tables[-1].rows[0]))
    return f"{tables[-1].caption}: {first}", [Section("Result", [*figures, *tables])]


def _fits(replay: Replay) -> Drawn:
    try:
        estimates = read_estimates(replay)
    except InputError as error:
        return str(error), []
    figures = [Figure(evidence_png(one), headline(one)) for one in estimates]
    return "; ".join(map(headline, estimates)) or "no estimate", [Section("Error and posterior", figures)]
