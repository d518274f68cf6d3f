"""Results of an exploration, for a terminal, JSON, a page and a notebook."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.experiments.explore.options import SHALLOW_M
from deformscope.pictures import messages
from deformscope.pictures.report import Figure, Table
from deformscope.plain import Json
from deformscope.recording.losses import named
from deformscope.results.render import Rows, derived, format_value, quantities, reported, to_columns, to_json, units_of
from deformscope.runs.result import LibraryResult
from deformscope.stages.map.exploration import (
    PLATEAU_FACTOR,
    DetectionLimit,
    InclusionsResult,
    MapEstimate,
    MapRegion,
    MissProbability,
    StageFailure,
    TouchEstimate,
)
from deformscope.stages.map.touch_beta import BOUNDS

RIVAL = 0.1
"""Probability from which another verdict is named in addition to the given one."""
NOT_KNOWN = "not known"


@dataclass(frozen=True, slots=True)
class LayerThickness:
    """The layer that represents the foam: thickness and its deviation [m], and its source."""

    thickness_m: float | None = field(metadata=reported(unit="m"))
    sd_m: float | None = field(metadata=reported(unit="m"))
    known_by: str = field(metadata=reported())


@dataclass(frozen=True, slots=True)
class TruthScore:
    """The true regions, and the map's agreement with them; None if either has no regions, or no border."""

    region_count: int = field(metadata=reported())
    iou: float | None = field(metadata=reported())
    boundary_m: float | None = field(metadata=reported())


@dataclass(frozen=True, slots=True)
class TouchOutcome:
    """A touch, and its effect on the exploration.

    ended_s: time since the session began; iou: IoU of the map after it; failed: failures on it, as text; asked_for:
    requested by a person on the page, or by an own planner"""

    touch: TouchEstimate = field(metadata=reported(flat=True))
    ended_s: float = field(metadata=reported())
    iou: float | None = field(metadata=reported())
    failed: list[str] = field(metadata=reported())
    asked_for: bool = field(metadata=reported())


@dataclass(frozen=True, slots=True, repr=False)
class ExplorationResult(LibraryResult):
    """Result of `explore`: `to_dict()`, or `found`, is the JSON of `deformscope explore`.

    feel: the mapped quantity; set_force_n, more_force_n: force of touches, and the larger one if that hardly dents,
    None = never
    estimate: the maps, None if no touch gave any; inclusions: result of the search for inclusions, None without one
    missed: detection limit, None before any plan; probability: probability of each number of regions; max_force_n:
    largest true force, in the laboratory; measured_max_force_n: largest force that the sensor measured
    seconds: durations of computing, of the slowest touch, by the robot's clock and on this computer
    supervisor_gaps_ms: times between two checks of the supervisor, None if the arm could never move; arm_stands:
    whether it could be stopped; losses: losses of each device that lost something; fault: why it was stopped
    simulated: the scene; laboratory: its settings; recorded: the touches are those of a recording, and no robot was
    commanded; certificate: the rig's bias on a known sample, and whether it is taken out; None = not certified
    """

    scenario: str = field(metadata=reported())
    seed: int = field(metadata=reported())
    version: str = field(metadata=reported())

    @property
    @derived()
    def units(self) -> dict[str, str]:
        """Units of the JSON's values."""
        return units_of((ExplorationResult, LayerThickness, TouchEstimate, MapRegion, DetectionLimit, MissProbability))

    set_force_n: float = field(metadata=reported(unit="N"))
    more_force_n: float | None = field(metadata=reported(unit="N"))
    feel: str = field(metadata=reported(key="stiffness"))
    thickness: LayerThickness = field(metadata=reported())

    @property
    @derived(unit="m")
    def levelled_m(self) -> float | None:
        """Thickness of the level layer to which all stiffness is converted [m]; None: it is apparent."""
        return None if self.estimate is None else self.estimate.levelled_m

    @property
    @derived()
    def verdict(self) -> str | None:
        """`regions`, `gradual` (the stiffness changes smoothly), or None where no touch gave a map."""
        return None if self.estimate is None else self.estimate.verdict

    @property
    @derived()
    def verdict_probability(self) -> float | None:
        """Probability of the verdict and its number of regions."""
        return None if self.estimate is None else self.estimate.probability

    touches: tuple[TouchOutcome, ...] = field(metadata=reported())

    @property
    @derived()
    def region_count(self) -> int | None:
        """Number of regions."""
        return None if self.estimate is None else self.estimate.region_count

    @property
    @derived()
    def region_count_at_least(self) -> bool:
        """Whether there may be more: three and more are not distinguished reliably."""
        return self.estimate is not None and self.estimate.more_possible

    @property
    @derived()
    def regions(self) -> tuple[MapRegion, ...]:
        """Each region, the softest first."""
        return () if self.estimate is None else self.estimate.regions

    probability: dict[str, float] | None = field(metadata=reported())
    truth: TruthScore | None = field(metadata=reported())
    travel_m: float = field(metadata=reported(unit="m"))
    max_force_n: float | None = field(metadata=reported(unit="N"))
    measured_max_force_n: float = field(metadata=reported(unit="N"))
    seconds: dict[str, float] = field(metadata=reported(unit="s"))
    supervisor_gaps_ms: dict[str, float] | None = field(metadata=reported())
    stop_reason: str = field(metadata=reported())
    inclusions: InclusionsResult | None = field(metadata=reported(key="inclusions"))
    missed: DetectionLimit | None = field(metadata=reported())
    arm_stands: bool = field(metadata=reported())
    failures: tuple[StageFailure, ...] = field(metadata=reported())
    losses: dict[str, dict[str, float]] = field(metadata=reported())
    recording: Path | str | None = field(metadata=reported())
    fault: Json | None = field(metadata=reported())
    laboratory: Json | None = field(metadata=reported())
    estimate: MapEstimate | None = None
    simulated: bool = True
    recorded: bool = False
    certificate: str | None = field(default=None, metadata=reported("certificate", optional=True))

    @property
    def found(self) -> Json:
        """The JSON."""
        return self.to_dict()

    @property
    def maps(self) -> dict[str, np.ndarray]:
        """The arrays (rows, columns) of the known maps, by name with its unit; empty without a map."""
        return {} if self.estimate is None else map_arrays(self.estimate)

    @property
    def png(self) -> bytes:
        """The maps drawn, empty without a map."""
        from deformscope.pictures.exploration import result_png

        return b"" if self.estimate is None else result_png(self.estimate, self.scenario, self.inclusions)

    @property
    def stiffness_n_per_mm(self) -> FloatArray:
        """Stiffness (rows, columns) at the set force [N/mm]; empty without a map."""
        return np.empty((0, 0)) if self.estimate is None else self.estimate.stiffness_n_per_mm

    @property
    def labels(self) -> IntArray:
        """(rows, columns) region of each cell, from 0 = the softest; -1 = no regions; empty without a map."""
        return np.empty((0, 0), np.int64) if self.estimate is None else self.estimate.labels

    def __repr__(self) -> str:
        return f"<exploration of {self.scenario}: {self.verdict_text}, {messages.counted(len(self.touches), 'touch')}>"

    def as_json(self) -> Json:
        return to_json(self)

    def tables(self) -> tuple[Table, ...]:
        names, rows = to_columns([one.touch for one in self.touches])
        touches = [(str(number), *row) for number, row in enumerate(rows, start=1)]
        found = Table(self.rows(), caption=self.scenario)
        return (found, Table(touches, ("touch", *names), "Touches")) if touches else (found,)

    def figures(self) -> tuple[Figure, ...]:
        return (Figure(png, f"Maps of {self.scenario}"),) if (png := self.png) else ()

    @property
    def verdict_text(self) -> str:
        """The verdict with its probability, and other probable ones."""
        if self.estimate is None:
            return "none: no touch gave a map"
        kind = messages.format_regions(self.estimate)
        if self.verdict == "gradual":
            kind = "gradual: no regions, the stiffness changes smoothly"
        return f"{kind} (probability {self.verdict_probability:.2f}{self._rival()})"

    def _rival(self) -> str:
        """The other probable verdict, if the verdict is uncertain."""
        given = str(self.region_count or "gradual")
        # "at least" includes the greater numbers
        claimed = self.region_count if self.region_count_at_least else None
        share, count = max(
            (share, count)
            for count, share in (self.probability or {}).items()
            if count != given and (claimed is None or count == "gradual" or int(count) < claimed)
        )
        words = count if count == "gradual" else messages.counted(int(count), "region")
        return f", {words} {share:.2f}; more touches decide" if share >= RIVAL else ""

    def rows(self) -> Rows:
        """The results, as names and values."""
        rows = [("verdict", self.verdict_text)]
        rows += [(f"region {number}", self._format_region(one)) for number, one in enumerate(self.regions, start=1)]
        if self.levelled_m is not None:
            level = f"converted to a level layer {100.0 * self.levelled_m:.2g} cm thick"
            rows.append(("stiffness", f"{level}; the JSON also has each touch as measured"))
        if self.thickness.known_by == NOT_KNOWN:
            why = "no thickness_m in [surface], and the camera sees no table around the foam"
            rows.append(("modulus", f"not known: {why}"))
        elif any(one.modulus_text for one in self.regions):
            rows.append(
                ("modulus", f"no interval: foam on its plateau may have up to {PLATEAU_FACTOR:g} times as much")
            )
        if (truth := self.truth) is not None and truth.iou is not None:
            off = "" if truth.boundary_m is None else f", border {100 * truth.boundary_m:.1f} cm off"
            true = messages.counted(truth.region_count, "region")
            rows.append(("truth", f"{true}; IoU of map and truth {truth.iou:.3f}{off}"))
        elif truth is not None and not truth.region_count:
            rows.append(("truth", "no regions: the stiffness changes smoothly"))
        if with_beta := [one.touch for one in self.touches if one.touch.beta is not None]:
            rows.append(("beta", format_betas(with_beta)))
        if self.inclusions is not None:
            rows += self.inclusions.rows
        rows += self._missed_rows()
        rows += [("failed", messages.format_failure(one)) for one in self.failures]
        rows += [
            ("touches", f"{len(self.touches)}, {messages.format_travel(self.travel_m)}"),
            ("ended", messages.format_stop(self.stop_reason)),
            ("contact force", f"measured {self.measured_max_force_n:.2f} N" if self.recorded else self.force_text),
        ]
        if not self.recorded:
            rows.append(("arm", "at rest" if self.arm_stands else "COULD NOT BE STOPPED: use its emergency stop"))
        if gaps := self.supervisor_gaps_ms:
            words = f"every {gaps['p50']:.0f} ms, at most {gaps['max']:.0f} ms apart"
            late = gaps["max"] > 2.0 * gaps["p50"]
            rows.append(("safety checks", words + "; a stop may be that late: close other programs" * late))
        robot_s, wall_s = self.seconds["session"], self.seconds["wall"]
        rows.append(("time", f"{robot_s:.0f} s by the robot's clock, {wall_s:.0f} s on this computer"))
        if self.certificate is not None:
            rows.append(("certificate", self.certificate))
        if self.losses:
            rows.append(("lost", named(self.losses)))
        if self.recording is not None:
            rows.append(("recording", str(self.recording)))
        return rows

    def _format_region(self, region: MapRegion) -> str:
        if region.rigid:
            return f"{region.level_text} N/mm (a lower bound: hardly dented)"
        low, high = region.stiffness_interval_n_per_mm
        modulus = f"; modulus {format_value(region, 'modulus_pa')} if linear" if region.modulus_pa is not None else ""
        return f"{region.level_text} N/mm ({low:.3g} to {high:.3g}) at {self.set_force_n:g} N{modulus}"

    def _missed_rows(self) -> Rows:
        """Possible inclusions and regions without a touch."""
        if (missed := self.missed) is None:
            return []
        x, y = 100.0 * missed.untouched_at_m
        wide = 200.0 * missed.untouched_m
        what = f"the largest circle without a touch is {wide:.0f} cm across, around ({x:.0f}, {y:.0f}) cm"
        rows = [("untouched", what)]
        if self.inclusions is None and (unseen := missed.inclusions):
            each = ", ".join(f"{one.probability:.2f} if {200.0 * one.radius_m:.3g} cm wide" for one in unseen)
            stated = f"assumed: {missed.contrast:g} times as stiff or as soft; {missed.prior:g} before any touch"
            words = f"probability {each} that one is there and no touch shows it; more touches lower it ({stated})"
            rows.append(("inclusions unseen", words))
        return rows

    @property
    def force_text(self) -> str:
        """Set force of touches, and the largest force: by the sensor, and true if it is known."""
        more_n, true_n = self.more_force_n, self.max_force_n
        more = "" if more_n is None else f" ({more_n:g} N if the dent is below {1e3 * SHALLOW_M:g} mm)"
        true = "" if true_n is None else f", true {true_n:.2f} N (available in simulation only)"
        return f"set to {self.set_force_n:g} N{more}; largest: measured {self.measured_max_force_n:.2f} N{true}"


def format_betas(touches: Sequence[TouchEstimate]) -> str:
    """beta over the touches that have one, as text."""
    values = [one.beta for one in touches if one.beta is not None]
    low, high = min(values), max(values)
    span = f"{low:.2f}" if f"{low:.2f}" == f"{high:.2f}" else f"{low:.2f} to {high:.2f}"
    every = f"{span} in {messages.counted(len(values), 'touch')}"
    if high <= BOUNDS[0] or low >= BOUNDS[1]:
        return f"{every}, the end of its range: beta does not distinguish the touched places"
    bound = sum(one.beta_verdict == "at-bound" for one in touches)
    if bound:
        why = "as expected of linear foam, whose beta is the same at any stiffness; regions are decided by stiffness"
        return f"{every}, {why} (interval at the end of its range: {messages.counted(bound, 'touch')})"
    return every


def map_arrays(maps: MapEstimate) -> dict[str, np.ndarray]:
    """The maps that are known, by name: rows along y, columns along x, cells of cell_m with the surface's corner at (0,
    0)."""
    known = {one.name: getattr(maps, one.name) for one in quantities(MapEstimate)}
    return {name: np.asarray(value) for name, value in known.items() if value is not None}
