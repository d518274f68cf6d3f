"""Moduli from curves of force over depth: of tables, of recordings, and of what `import` reads with a map."""

import fnmatch
import itertools
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np

from deformscope.arrays import FloatArray
from deformscope.config.indent import IndentConfig
from deformscope.config.options import ViewOptions
from deformscope.errors import InputError
from deformscope.files.arrays_file import read_arrays
from deformscope.frames import ArmFrame, InputFile, WrenchFrame
from deformscope.imports.frame_builder import SI, TIME_NS
from deformscope.imports.import_map import read_map
from deformscope.imports.readers import Reader, open_reader
from deformscope.imports.source import ImportSource
from deformscope.log.layout import FINDINGS
from deformscope.pictures.figures import COLOURS, canvas, png_of
from deformscope.pictures.messages import reason_rows
from deformscope.pictures.report import Figure, Section, Table, html_report
from deformscope.plain import Json
from deformscope.recording.items import read_found, read_items, read_results
from deformscope.recording.reader import Replay
from deformscope.results.render import ReportedResult, Rows, quantities, to_rows
from deformscope.runs.calibration_report import provenance_sections, settings_section
from deformscope.runs.force_log import UNITS, unit_of
from deformscope.runs.pair_calibration import arrays_bytes
from deformscope.runs.result import SourceResult, open_recorder, settings_of
from deformscope.session import Step
from deformscope.stages.map.exploration import TouchEstimate
from deformscope.stages.poke.indentation import (
    IndentCurve,
    IndentEstimate,
    IndentSample,
    IndentSummary,
    combine,
    fit_indentation,
)
from deformscope.stages.poke.tip_law import Ground, Indenter

ROLES = {
    "force": ("N", re.compile(r"(?i)force|load|kraft|last|力|\bf[xyz]?\b|\bfn\b")),
    "depth": ("m", re.compile(r"(?i)disp|depth|dent|ext|pos|travel|weg|stroke|compr|tiefe|llong|位移|height|\b[dz]\b")),
    "time": ("s", re.compile(r"(?i)time|zeit|时间|\bt\b")),
}
"""Quantity of each column, and names that it has."""
FACTORS = (
    SI
    | {unit: ("N", factor) for unit, factor in UNITS.items()}
    | {unit: ("s", ns / 1e9) for unit, ns in TIME_NS.items()}
)
TOUCHED = 0.1
"""Share of the largest force below which the tip of a recording is between two touches."""
UNSHOWN = {"name", "verdict", "reasons"}
"""Quantities that a table has elsewhere."""
CurveArrays = Mapping[str, FloatArray]
"""`depth_m (n,)`, `force_n (n,)`, and optionally `time_s (n,)`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IndentResult(SourceResult):
    """A sample's modulus. curves: that of each poke; together: that of all of them, of two or more"""

    sample: IndentSample
    curves: tuple[IndentEstimate, ...]
    together: IndentSummary | None

    @property
    def modulus_pa(self) -> float:
        """Young's modulus of the sample [Pa]."""
        return (self.together or self.curves[0]).modulus_pa

    @property
    def interval_pa(self) -> tuple[float, float]:
        """Its 90 % interval [Pa]."""
        return (self.together or self.curves[0]).modulus_interval_pa

    def as_json(self) -> Json:
        found: Json = {"tip": str(self.sample.tip), "curves": [one.as_json() for one in self.curves]}
        found |= {"together": self.together and self.together.as_json(), "settings": self.settings}
        return self.with_problems(found)

    def tables(self) -> tuple[Table, ...]:
        found = [
            Table(
                [("verdict", one.verdict), *reason_rows(one.reasons), *shown_rows(one)],
                caption=f"{one.name}, {self.sample.tip} (90 % intervals)",
            )
            for one in self.curves
        ]
        if self.together is not None:
            found.append(Table(shown_rows(self.together, ()), caption="All curves together (90 % interval)"))
        return (*found[:-1], Table([*found[-1].rows, *self.source_rows()], caption=found[-1].caption))

    def figures(self) -> tuple[Figure, ...]:
        return (Figure(curves_png(self.curves), "Force over depth since contact, with the fitted law"),)

    def page(self) -> str:
        """The result as one HTML page."""
        sections = [Section("", [*self.figures(), *self.tables()]), settings_section(self.settings)]
        sections += provenance_sections(seed=0, settings=self.settings)
        return html_report("Young's modulus by indentation", sections)


def shown_rows(found: ReportedResult, without: Container[str] = UNSHOWN) -> Rows:
    """All quantities with a name, as rows."""
    return to_rows(found, *(one.name for one in quantities(type(found)) if one.label and one.name not in without))


def indent(config: IndentConfig, arrays: Sequence[CurveArrays] = ()) -> IndentResult:
    """Read the curves, fit each, and record the findings. arrays: curves of a script, in place of the sources. Raises
    InputError."""
    ground: Ground = "bonded" if config.bonded else "sliding" if config.sliding else "half-space"
    sample = IndentSample(
        tip=Indenter(cast("Any", config.tip.kind), config.tip.size),
        thickness_m=config.thickness_m,
        ground=ground,
        poisson=config.poisson,
        width_m=config.width_m,
        machine_n_per_mm=config.machine_n_per_mm,
        tip_sd=config.tip_tolerance,
        thickness_sd=config.thickness_tolerance,
        gain_sd=config.force_tolerance,
        machine_sd=config.machine_tolerance,
    )
    if arrays:
        curves = [_of_arrays(one, name) for one, name in zip(arrays, config.sources, strict=True)]
    else:
        curves = [curve for source in config.sources for curve in curves_of(Path(source), config)]
    return _fitted(curves, sample, settings_of(config), config.output)


def _fitted(
    curves: Sequence[IndentCurve], sample: IndentSample, settings: Mapping[str, object], output: ViewOptions
) -> IndentResult:
    """The same for a first run and for its replay."""
    found = tuple(fit_indentation(one, sample) for one in curves)
    together = combine(found) if len(found) > 1 else None
    result = IndentResult(sample=sample, curves=found, together=together, settings=settings)
    with open_recorder(output, {**settings, "indented": asdict(sample)}, FINDINGS.variant("indent")) as recorder:
        for number, (one, given) in enumerate(zip(found, curve_files(curves), strict=True)):
            recorder.write(given)
            recorder.write(Step((one,), frame=number))
        recorder.write(Step((result.findings(),), frame=0))
    return replace(result, recording=recorder.summary())


def curve_files(curves: Sequence[IndentCurve]) -> list[InputFile]:
    """The curves for a recording, so that it can be replayed."""
    every = ({name: value for name, value in asdict(one).items() if value is not None} for one in curves)
    return [InputFile(f"curve/{number}", arrays_bytes(**one)) for number, one in enumerate(every)]


def kept_curves(recording: Replay) -> list[IndentCurve]:
    """The curves from which a recorded run was computed."""
    found = list[IndentCurve]()
    for raw in recording.read_numbered("curve"):
        one: dict[str, Any] = read_arrays(raw, "a recorded curve", recording.path)
        found.append(IndentCurve(**{**one, "name": str(one["name"])}))
    return found


def replay_indent(recording: Replay, output: ViewOptions) -> tuple[list[IndentEstimate], IndentResult]:
    """The recorded estimates, and a new fit to the recorded curves."""
    settings = dict(recording.settings)
    sample = msgspec.convert(settings.pop("indented"), IndentSample)
    return read_found(recording, IndentEstimate), _fitted(kept_curves(recording), sample, settings, output)


def _of_arrays(given: CurveArrays, name: str) -> IndentCurve:
    known = {"depth_m", "force_n", "time_s"}
    if not {"depth_m", "force_n"} <= given.keys() <= known:
        raise InputError("depth_m, force_n and optionally time_s", ", ".join(map(str, given)), where=name)
    every = {key: np.asarray(value, np.float64) for key, value in given.items()}
    return IndentCurve(name=name, **every)


# Reading -------------------------------------------------------------------------------------------------------------


def curves_of(path: Path, config: IndentConfig) -> list[IndentCurve]:
    """The curves of a source: one of each table, one of each touch of a recording; BOOK.xlsx#SHEET: of the sheets with
    such a name, which may have wildcards. Raises InputError."""
    path, only = (path, "*") if path.exists() else (Path(one) for one in f"{path}#*".split("#")[:2])
    if config.map is not None:
        asked = read_map(config.map)
        with (
            open_reader(path, asked.skip_rows, [one.time for one in asked.streams]) as reader,
            ImportSource(reader, asked) as source,
        ):
            return touches_of(source.drain(), path.name)
    if path.suffix.lower() == ".rrd":
        touches = [row.item for row in read_results(path, (TouchEstimate,))]
        if touches:
            return [
                IndentCurve(one.approach_m, one.approach_n, name=f"{path.name}, touch {one.number}") for one in touches
            ]
        return touches_of(read_items(path, kinds=(ArmFrame, WrenchFrame)), path.name)
    with open_reader(path) as reader:
        sheets = [name.removeprefix(f"{path.name}/") for name in reader.topics]
        chosen = [name for name, sheet in zip(reader.topics, sheets, strict=True) if fnmatch.fnmatch(sheet, str(only))]
        if not chosen:
            raise InputError(f"a sheet out of {', '.join(sheets)}", f"{only}", f"{path.name}#{sheets[0]}", path)
        return [_of_table(reader, name, config, path) for name in chosen]


def _of_table(reader: Reader, name: str, config: IndentConfig, path: Path) -> IndentCurve:
    topic = reader.topics[name]
    units = {column: unit_of(column, unit) for column, unit in topic.units.items()}
    asked = {"force": config.force_column, "depth": config.depth_column, "time": config.time_column}
    found = {role: _column(role, said, units, path) for role, said in asked.items()}
    way = found["depth"][0] if found["depth"] else ""
    if topic.spring_n_per_m and config.machine_n_per_mm is None and "tip" not in way.lower():
        hint = f"--machine-n-per-mm {1e-3 * topic.spring_n_per_m:.4g}, as the file states"
        raise InputError("the way of the tip, or the cantilever's stiffness", f"{way}, the piezo's", hint, path)
    rows = [message.value for message in reader.messages([name])]
    values: dict[str, FloatArray] = {}
    for role, column in found.items():
        if column is not None:
            which, factor = column
            try:
                given = np.array([np.nan if row[which] is None else row[which] for row in rows], np.float64)
            except (TypeError, ValueError):
                raise InputError(f"numbers in column {which}", "text", where=path) from None
            values[role] = factor * given
    shown = name if name.startswith(path.name) else f"{path.name}/{name}"
    time_s = values.get("time")
    if time_s is not None and np.mean(time_s < np.maximum.accumulate(time_s)) > 0.1:
        time_s = None  # a clock of each segment
    return IndentCurve(values["depth"], values["force"], time_s, shown)


def _column(role: str, said: str | None, units: Mapping[str, str], path: Path) -> tuple[str, float] | None:
    """A column and the factor to SI: the one that is said, or the only one with such a unit and name. None: no time"""
    wanted, named = ROLES[role]
    flag = f"--{role}-column"
    if said is not None:
        name, _, unit = said.rpartition("=") if "=" in said and said not in units else (said, "", "")
        sign = -1.0 if name not in units and name.startswith("-") else 1.0
        name = name if sign > 0 else name[1:]
        if name not in units:
            raise InputError(f"{flag} out of {', '.join(units)}", repr(name), where=path)
    else:
        fits = [one for one, unit in units.items() if FACTORS.get(unit, ("",))[0] == wanted or not unit]
        choice = [one for one in fits if named.search(one)] or [one for one in fits if units[one]]
        if role == "time" and len(choice) != 1:
            return None
        if len(choice) != 1:
            came = ", ".join(choice or units)
            raise InputError(f"one column of {role}", came, f"{flag} NAME", path)
        name, sign, unit = choice[0], 1.0, ""
    unit = unit or units[name]
    if role == "time" and not unit:
        return (name, 1.0) if said is not None else None
    if FACTORS.get(unit, ("",))[0] != wanted:
        known = ", ".join(one for one, (of, _) in FACTORS.items() if of == wanted)
        expected, came = f"the unit of column {name}: {known}", repr(unit) if unit else "none"
        raise InputError(expected, came, f"{flag} {name}=UNIT", path)
    return name, sign * FACTORS[unit][1]


def touches_of(frames: Iterable[object], name: str) -> list[IndentCurve]:
    """The touches of an arm with a force sensor: the way of its end, along the straight line that it presses on, and
    the size of the force. Raises InputError without both, and with two sensors."""
    arm, wrench = list[ArmFrame](), list[WrenchFrame]()
    for frame in frames:
        if isinstance(frame, ArmFrame):
            arm.append(frame)
        elif isinstance(frame, WrenchFrame) and frame.usable:
            wrench.append(frame)
    if len(devices := sorted({one.device for one in wrench})) != 1 or len(arm) < 2:
        came = f"{', '.join(devices) or 'no forces'}, and {len(arm)} poses of an arm"
        raise InputError("forces of one sensor on the tip, and poses of an arm", came, where=name)
    arm_ns, wrench_ns = (np.array([one.stamp.host_ns for one in each]) for each in (arm, wrench))
    force = np.stack([one.force_n.sum(axis=0) for one in wrench])
    force_n = np.linalg.norm(force - np.median(force[: max(5, len(force) // 20)], axis=0), axis=1)
    force_n, at_m = np.interp(arm_ns, wrench_ns, force_n), np.stack([one.position_m for one in arm])
    return list(_each_touch((arm_ns - arm_ns[0]) / 1e9, at_m, force_n, name))


def _each_touch(time_s: FloatArray, at_m: FloatArray, force_n: FloatArray, name: str) -> Iterator[IndentCurve]:
    pressed = force_n > TOUCHED * force_n.max()
    edges = np.flatnonzero(np.diff(pressed.astype(int), prepend=0, append=0))
    begins, ends = edges[::2], edges[1::2]
    between = [0, *((ends[:-1] + begins[1:]) // 2), len(force_n)]
    for number, (first, last) in enumerate(itertools.pairwise(between), start=1):
        part = slice(first, last)
        way = at_m[first + int(np.argmax(force_n[part]))] - at_m[first]
        length = float(np.linalg.norm(way))
        if length > 0.0:
            along_m = (at_m[part] - at_m[first]) @ way / length
            shown = f"{name}, touch {number}" if len(between) > 2 else name
            yield IndentCurve(along_m, force_n[part], time_s[part], shown)


def curves_png(curves: Sequence[IndentEstimate]) -> bytes:
    """Force over depth since contact, with the law."""
    figure = canvas(6.4, 4.4, layout="constrained")
    axis = figure.subplots()
    for one, colour in zip(curves, COLOURS * len(curves), strict=False):
        axis.plot(1e3 * one.along_m, one.force_n, ".", markersize=2, color=colour, label=one.name)
        order = np.argsort(one.along_m)
        within = order[one.along_m[order] <= one.depth_m]
        axis.plot(1e3 * one.along_m[within], one.law_n[within], color=colour, linewidth=1.2)
        axis.axvline(1e3 * one.depth_m, color=colour, linestyle=":", linewidth=0.8)
    axis.set(xlabel="depth since contact [mm]", ylabel="force [N]")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    return png_of(figure, 130)
