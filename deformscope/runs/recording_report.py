"""A recording as a report: figures of the thesis's chapters 2 to 4 from what it holds, and what it lacks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.frames import HandFrame, StageResult
from deformscope.log.exploration.layout import EXPLORATION
from deformscope.log.squeeze.layout import SQUEEZE
from deformscope.pictures import recorded
from deformscope.pictures.evidence import evidence_png, headline
from deformscope.pictures.exploration import height_png, result_png
from deformscope.pictures.messages import counted, format_iou, format_verdict
from deformscope.pictures.recorded import Curves
from deformscope.pictures.report import Figure, ReportVerdict, Section, Table, html_report
from deformscope.recording.item_rows import Row, read_rows
from deformscope.recording.items import read_estimates, read_stage_results
from deformscope.recording.reader import Replay
from deformscope.recording.stages import RecordedStage, recorded_stages
from deformscope.runs.result import LibraryResult
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.map.exploration import InclusionsResult, MapEstimate, SurfaceEstimate, TouchEstimate
from deformscope.stages.see.tactile import TactileContact
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.trial import (
    ContentPosterior,
    FingertipPressure,
    SqueezeFeatures,
    SqueezePhase,
    TrackedContainer,
)

T = TypeVar("T")
PAD_ROWS = 6
"""Rows and columns of a fingertip's cells in a feature (Thesis 2.5.1)."""


@dataclass(frozen=True, slots=True)
class RecordingReport(LibraryResult):
    """What a recording shows. words: in a line; stages: with their costs, those that it lacks among them; drawn: its
    figures by section"""

    recording: Path
    words: str
    stages: tuple[RecordedStage, ...]
    drawn: tuple[tuple[str, tuple[Figure, ...]], ...]

    @property
    def lacks(self) -> tuple[str, ...]:
        """Stages of chapters 2 to 4 of which there are no rows, though they were to be expected, or their costs."""
        missing = [one.name for one in self.stages if one.missing]
        costs = [] if any(one.computed for one in self.stages) else ["costs of the stages"]
        return (*missing, *costs)

    def figures(self) -> tuple[Figure, ...]:
        return tuple(figure for _, figures in self.drawn for figure in figures)

    def tables(self) -> tuple[Table, ...]:
        rows = [
            (one.name, f"chapter {one.chapter}" if one.chapter else "the run", f"/{one.entity}", one.rows, _cost(one))
            for one in self.stages
            if one.rows or one.missing
        ]
        return (Table(rows, ("stage", "of", "entity", "rows", "CPU [ms]"), f"{self.recording}: {self.words}"),)

    def as_json(self) -> dict[str, Any]:
        return {
            "recording": self.recording,
            "words": self.words,
            "lacks": self.lacks,
            "stages": [{**dataclasses.asdict(one), "live": one.live} for one in self.stages],
            "figures": [{"section": title, "caption": one.caption} for title, some in self.drawn for one in some],
        }

    def page(self) -> str:
        """As one HTML page."""
        lacks = f"It lacks: {', '.join(self.lacks)}." if self.lacks else "Every stage of its kind is in it."
        first = Section("", [ReportVerdict(self.words, (lacks,))])
        return html_report(
            str(self.recording.name), [first, *(Section(*one) for one in self.drawn), Section("Stages", self.tables())]
        )


def report_recording(path: Path) -> RecordingReport:
    """Draw what a recording holds. Raises InputError for what is none, or cannot be read."""
    replay = Replay(path)
    name, stages = replay.identity[0], recorded_stages(path)
    kinds: dict[str, Callable[[Replay], tuple[str, list[Any]]]] = {
        EXPLORATION.name: _exploration,
        SQUEEZE.name: _squeeze,
    }
    words, drawn = (kinds.get(name) or (_rig if "rig" in replay.settings else _fits))(replay)
    spent = [(one.name, one.computed * one.cpu_ms) for one in stages if one.cpu_ms and one.rows]
    if spent:
        drawn.append(("What the stages cost", (Figure(recorded.costs_png(spent), "time of the processor by stage"),)))
    return RecordingReport(path, words, tuple(stages), tuple(drawn))


def _cost(one: RecordedStage) -> str:
    return "-" if one.cpu_ms is None else f"{one.computed} x {one.cpu_ms:.3g}"


def _of(rows: Sequence[Row], kind: type[T]) -> list[T]:
    return [row.item for row in rows if isinstance(row.item, kind)]


# Chapter 4 -----------------------------------------------------------------------------------------------------------


def _exploration(replay: Replay) -> tuple[str, list[Any]]:
    rows = list(read_rows(replay, (SurfaceEstimate, TouchEstimate, MapEstimate, InclusionsResult)))
    surfaces, touches = _of(rows, SurfaceEstimate), _of(rows, TouchEstimate)
    maps, inclusions = _of(rows, MapEstimate), _of(rows, InclusionsResult)
    drawn: list[Any] = []
    if maps:
        found = Figure(result_png(maps[-1], found=inclusions[-1] if inclusions else None), "what the touches measured")
        drawn.append(("Map", (found,)))
    if surfaces:
        drawn.append(("Surface", (Figure(height_png(surfaces[0]), "height before any touch (Thesis eq. 4.3, 4.4)"),)))
    if touches:
        drawn.append(
            (
                "Touches",
                (
                    Figure(recorded.touches_png(touches), "stiffness and beta of each touch (as Thesis fig. 4.5)"),
                    Figure(recorded.dents_png(touches), "force over depth, and dents (as Thesis fig. 4.4 and 4.6)"),
                ),
            )
        )
    if maps:
        drawn.append(
            (
                "Fields, touch by touch",
                (
                    Figure(recorded.fields_png(maps), "fields after each touch (as Thesis fig. 4.7)"),
                    Figure(recorded.progress_png(maps), "way, deviation and overlap by touch"),
                ),
            )
        )
    words = counted(len(touches), "touch")
    if maps:
        words = ", ".join(one for one in (words, format_verdict(maps[-1]), format_iou(maps[-1])) if one)
    return words, drawn


# Chapter 2 -----------------------------------------------------------------------------------------------------------


def _squeeze(replay: Replay) -> tuple[str, list[Any]]:
    kinds = (
        FingertipPressure,
        TrackedContainer,
        SqueezeFeatures,
        SqueezeEvents,
        ContentPosterior,
        SqueezePhase,
        HandFrame,
    )
    rows = list(read_rows(replay, kinds))
    pressed, tracked, hand, named = (
        [row for row in rows if isinstance(row.item, one)]
        for one in (FingertipPressure, TrackedContainer, HandFrame, ContentPosterior)
    )
    panels: list[Curves] = []
    if pressed:
        fingers = tuple(f"fingertip {at + 1}" for at in range(len(pressed[0].item.force_n)))
        panels.append(_over_time("force [N]", pressed, lambda one: one.force_n, fingers))
        panels.append(_over_time("contact area [cm\u00b2]", pressed, lambda one: 1e4 * one.area_m2, fingers))
    if hand:
        axes = [1, 5]
        panels.append(_over_time("closing axes [deg]", hand, lambda one: one.position_deg[axes], ("axis 1", "axis 5")))
    good = [row for row in tracked if row.item.good]
    if good:
        first = np.linalg.inv(good[0].item.T_camera_container)
        moved = [_moved(first @ row.item.T_camera_container) for row in good]
        times = _times(good)
        panels.append(Curves("container moved [mm]", times, np.array([one[:1] for one in moved]), marks=len(good) < 30))
        panels.append(
            Curves("container turned [deg]", times, np.array([one[1:] for one in moved]), marks=len(good) < 30)
        )
    by_touch = [row for row in named if row.item.index >= 0]
    if by_touch:
        labels = by_touch[0].item.labels
        panels.append(_over_time("probability [-]", by_touch, lambda one: one.probability, labels))
    phases = [(row.item.name, row.session_ns / 1e9) for row in rows if isinstance(row.item, SqueezePhase)]
    events, features = _of(rows, SqueezeEvents), _of(rows, SqueezeFeatures)
    when: list[tuple[str, float]] = []
    words = "squeezed, without first contact and steady state"
    if events:
        at = next(row.session_ns for row in rows if isinstance(row.item, SqueezeEvents))
        steady_s, took_s = at / 1e9, (events[0].steady_ns - events[0].first_ns) / 1e9
        when = [("first contact", steady_s - took_s), ("steady state", steady_s)]
        words = f"steady state {took_s:.2f} s after first contact"
    if named:
        words += f"; taken for {named[-1].item.content}"
    drawn: list[Any] = []
    if panels:
        curves = recorded.curves_png(panels, when, phases)
        drawn.append(("Over time", (Figure(curves, "forces, pose of the container and posterior over time"),)))
    if features:
        one = features[0]
        cells = one.tactile.reshape(2, PAD_ROWS, -1)
        caption = f"at steady state (Thesis fig. 2.6, 2.7){f'; no depth change: {one.reason}' if one.reason else ''}"
        drawn.append(("Features", (Figure(recorded.feature_png(cells, one.vision, one.patch_width_m), caption),)))
    return words, drawn


def _moved(T: FloatArray) -> tuple[float, float]:
    """How far [mm], and by how much it turned [deg], of a motion (4, 4)."""
    turned = np.degrees(np.arccos(np.clip(0.5 * (np.trace(T[:3, :3]) - 1.0), -1.0, 1.0)))
    return 1e3 * float(np.linalg.norm(T[:3, 3])), float(turned)


def _times(rows: Sequence[Row]) -> FloatArray:
    return np.array([row.session_ns / 1e9 for row in rows])


def _over_time(label: str, rows: Sequence[Row], value: Callable[[Any], FloatArray], names: tuple[str, ...]) -> Curves:
    return Curves(label, _times(rows), np.array([value(row.item) for row in rows], np.float64), names)


# Stages on a rig, and fits -------------------------------------------------------------------------------------------


def _rig(replay: Replay) -> tuple[str, list[Any]]:
    results = read_stage_results(replay.path, trust=True)
    panels, start_ns = [], min((one.host_ns for one in results), default=0)
    for name in dict.fromkeys(one.stage for one in results):
        mine = [one for one in results if one.stage == name]
        times = np.array([(one.host_ns - start_ns) / 1e9 for one in mine])
        panels.append(Curves(f"{name}: lag [ms]", times, np.array([[1e3 * one.late_s] for one in mine])))
        panels += _of_stage(name, [one for one in mine if isinstance(one.result, MomentFit | TactileContact)], start_ns)
    words = f"a rig, {counted(len(results), 'result')} of stages" if results else "a rig without stages"
    if not panels:
        return words, []
    curves = recorded.curves_png(panels, label="time since the first result's frame [s]")
    return words, [("Stages over time", (Figure(curves, "results of the stages, and how far they are behind"),))]


def _of_stage(name: str, some: Sequence[StageResult], start_ns: int) -> list[Curves]:
    times = np.array([(one.host_ns - start_ns) / 1e9 for one in some])
    if not some:
        return []
    if isinstance(some[0].result, TactileContact):
        return [Curves("force of all pads [N]", times, np.array([[one.result.force_n.sum()] for one in some]))]
    fits: list[MomentFit] = [one.result for one in some]
    value = np.array([[one.value] for one in fits])
    low, high = (np.array([[one.interval[end]] for one in fits]) for end in (0, 1))
    return [Curves(f"{name} [-], 90 %", times, value, low=low, high=high, marks=True)]


def _fits(replay: Replay) -> tuple[str, list[Any]]:
    try:
        estimates = read_estimates(replay)
    except InputError as error:
        return str(error), []
    figures = tuple(Figure(evidence_png(one), headline(one)) for one in estimates)
    words = "; ".join(headline(one) for one in estimates) or "no estimate"
    return words, [("Error and posterior", figures)] if figures else []
