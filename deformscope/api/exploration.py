"""`deformscope.explore`: map how soft a surface is, and where, from a script."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deformscope.api.result import LibraryResult, Rows, ViewerChoice, python_names
from deformscope.arrays import FloatArray, IntArray
from deformscope.config import ExploreConfig, OutputOptions
from deformscope.errors import InputError
from deformscope.experiments.options import SHALLOW_M
from deformscope.pictures.exploration import result_png
from deformscope.pictures.report import Figure, Table
from deformscope.pictures.words import claim_words, counted, ended_words, failed_words, travel_words
from deformscope.recording.losses import named
from deformscope.stages.map.exploration import StageFailure
from deformscope.stages.map.touch_beta import BOUNDS
from deformscope.terminal import Say, said_to

RIVAL = 0.1
"""Probability from which another verdict is named beside the one that is given."""

Planner = Literal["regions", "integrated-variance", "max-variance", "random-above", "thesis"]


@dataclass(frozen=True, slots=True)
class ExplorationResult(LibraryResult):
    """What `explore` found.

    found: the JSON of `deformscope explore`; maps: its arrays by name, rows along y, columns along x, cells of
    `cell_m`: `stiffness_n_per_mm`, `stiffness_log_sd`, `loss` (with feel="loss"), `labels`, `label_probability`,
    `beta`... empty where no touch gave a map; png: the maps drawn, empty without a map
    """

    found: Mapping[str, Any]
    maps: Mapping[str, np.ndarray]
    png: bytes = b""

    @property
    def verdict(self) -> str | None:
        """`regions`, `gradual` (the stiffness changes smoothly), or None where no touch gave a map."""
        verdict: str | None = self.found["verdict"]
        return verdict

    @property
    def stiffness_n_per_mm(self) -> FloatArray:
        """(rows, columns) at the force that was set [N/mm]; empty without a map."""
        return np.asarray(self.maps.get("stiffness_n_per_mm", np.empty((0, 0))), dtype=np.float64)

    @property
    def labels(self) -> IntArray:
        """(rows, columns) region of each cell, from 0 = the softest; -1 = no regions; empty without a map."""
        return np.asarray(self.maps.get("labels", np.empty((0, 0))), dtype=np.int64)

    def __repr__(self) -> str:
        touches = counted(len(self.found["touches"]), "touch")
        return f"<exploration of {self.found['scenario']}: {verdict_of(self.found)}, {touches}>"

    def as_json(self) -> dict[str, Any]:
        return dict(self.found)

    def tables(self) -> tuple[Table, ...]:
        return (Table(exploration_rows(self.found), caption=str(self.found["scenario"])),)

    def figures(self) -> tuple[Figure, ...]:
        return (Figure(self.png, f"Maps of {self.found['scenario']}"),) if self.png else ()


def verdict_of(found: Mapping[str, Any]) -> str:
    """The verdict with its probability; found: as in the JSON"""
    if found["verdict"] is None:
        return "none: no touch gave a map"
    gradual = (
        f"gradual: no regions, the {'energy loss' if found['stiffness'] == 'loss' else 'stiffness'} changes smoothly"
    )
    kind = gradual if found["verdict"] == "gradual" else counted(found["region_count"], "region")
    if found["regions_by"] == "beta":
        kind += " between isopleths of beta"
    return f"{kind} ({claim_words(found['verdict_probability'])}{_rival(found)})"


def _rival(found: Mapping[str, Any]) -> str:
    """What else is likely, where the verdict is in doubt; what stiffness says, where the regions are those of beta."""
    by_beta = found["regions_by"] == "beta"
    given = "" if by_beta else str(found["region_count"] or "gradual")
    share, count = max((share, count) for count, share in found["probability"].items() if count != given)
    words = count if count == "gradual" else counted(int(count), "region")
    if by_beta:
        return f"; by stiffness {words}, probability {share:.2f}"
    return f", {words} {share:.2f}" if share >= RIVAL else ""


def exploration_rows(found: Mapping[str, Any]) -> Rows:
    """What was found, as names and values. found: as in the JSON"""
    rows = [("verdict", verdict_of(found))]
    for number, region in enumerate(found["regions"], start=1):
        value, (low, high) = math.exp(region["log_stiffness"]), map(math.exp, region["interval"])
        at = f"at {found['set_force_n']:g} N"
        words = f"{value:.3g} N/mm ({low:.3g} to {high:.3g}) {at}{_modulus_words(region)}"
        if region["rigid"]:
            words = f"> {value:.3g} N/mm (a lower bound: hardly dented)"
        if region["loss"] is not None:
            words = (
                "loses {:.0%} ({:.0%} to {:.0%}) of a touch's energy; ".format(region["loss"], *region["loss_interval"])
                + words
            )
        rows.append((f"region {number}", words))
    if (level_m := found["levelled_m"]) is not None:
        level = f"converted to that of a level layer {100.0 * level_m:.2g} cm thick"
        rows.append(("stiffness", f"{level}; the JSON has each touch as it was measured, too"))
    if found["thickness"]["known_by"] == "not known":
        rows.append(("modulus", "not known: no thickness_m in [surface], and the camera sees no table beside the foam"))
    truth, touches = found["truth"], found["touches"]
    if truth is not None and truth["iou"] is not None:
        off = "" if truth["boundary_m"] is None else f", border {100 * truth['boundary_m']:.1f} cm off"
        true = counted(truth["region_count"], "region")
        rows.append(("truth", f"{true}; IoU of the map's with them {truth['iou']:.3f}{off}"))
    elif truth is not None and not truth["region_count"]:
        rows.append(("truth", "no regions: the stiffness changes smoothly"))
    if any(one["beta"] is not None for one in touches):
        rows.append(("beta", beta_words([one for one in touches if one["beta"] is not None])))
    if inclusions := found["inclusions"]:
        rows += [(name, words) for name, words in inclusions["words"]]
    if missed := found["missed"]:
        by_loss = found["stiffness"] == "loss"
        rows += missed_rows({**missed, "lumps": []} if inclusions else missed, by_loss=by_loss)
    rows += [
        ("failed", failed_words(StageFailure(one["stage"], one["touch"], one["reason"], "")))
        for one in found["failures"]
    ]
    rows += [
        ("touches", f"{len(touches)}, {travel_words(found['travel_m'])}"),
        ("ended", ended_words(found["stop_reason"])),
        ("contact force", force_words(found)),
        ("arm", "at rest" if found["arm_stands"] else "COULD NOT BE STOPPED: use its emergency stop"),
    ]
    if gaps := found["supervisor_gaps_ms"]:
        words = f"every {gaps['p50']:.0f} ms; 99.9 % within {gaps['p99_9']:.0f} ms, all within {gaps['max']:.0f} ms"
        rows.append(("safety checks", words))
    robot_s, wall_s = found["seconds"]["session"], found["seconds"]["wall"]
    rows.append(("time", f"{robot_s:.0f} s by the robot's clock, {wall_s:.0f} s on this computer"))
    if found["losses"]:
        rows.append(("lost", named(found["losses"])))
    if found["recording"] is not None:
        rows.append(("recording", str(found["recording"])))
    return rows


def force_words(found: Mapping[str, Any]) -> str:
    """What touches were to press with, and the largest force: by the sensor, and true where the laboratory knows it."""
    more_n, true_n = found["more_force_n"], found["max_force_n"]
    more = "" if more_n is None else f" ({more_n:g} N where that dents less than {1e3 * SHALLOW_M:g} mm)"
    true = "" if true_n is None else f", true {true_n:.2f} N (known in the simulation alone)"
    return f"set to {found['set_force_n']:g} N{more}; largest: measured {found['measured_max_force_n']:.2f} N{true}"


def beta_words(touches: Sequence[Mapping[str, Any]]) -> str:
    """What beta says, over the touches that have one. touches: as in the JSON"""
    values = [one["beta"] for one in touches]
    low, high = min(values), max(values)
    span = f"{low:.2f}" if f"{low:.2f}" == f"{high:.2f}" else f"{low:.2f} to {high:.2f}"
    every = f"{span} in {counted(len(values), 'touch')}"
    if high <= BOUNDS[0] or low >= BOUNDS[1]:
        return f"{every}, the end of its range: beta does not distinguish what was touched"
    bound = sum(one["beta_verdict"] == "at-bound" for one in touches)
    if bound:
        why = "linear foam has the same beta however soft it is"
        return f"{every}; in {bound} its interval reaches the end of its range: {why}, and stiffness decides"
    return every


def _modulus_words(region: Mapping[str, Any]) -> str:
    if region["modulus_pa"] is None or region["rigid"]:
        return ""
    value, (low, high) = 1e-3 * region["modulus_pa"], (1e-3 * one for one in region["modulus_interval_pa"])
    return f"; modulus {value:.3g} kPa ({low:.3g} to {high:.3g})"


def missed_rows(missed: Mapping[str, Any], *, by_loss: bool = False) -> Rows:
    """What may be there that no touch has met; missed: as in the JSON; by_loss: the map is that of the loss"""
    x, y = (100.0 * value for value in missed["untouched_at_m"])
    wide = 200.0 * missed["untouched_m"]
    rows = [("untouched", f"the largest circle without a touch is {wide:.0f} cm across, around ({x:.0f}, {y:.0f}) cm")]
    if lumps := missed["lumps"]:
        each = ", ".join(f"{one['probability']:.2f} for {200.0 * one['radius_m']:.3g} cm" for one in lumps)
        kind = "the energy loss of what is around it, or as many times less" if by_loss else "as stiff or as soft"
        stated = f"assumed: {missed['contrast']:g} times {kind}; {missed['prior']:g} before any touch"
        rows.append(("lumps unseen", f"probability that one was missed, by its width: {each} ({stated})"))
    return rows


def explore(
    rig: str | Path,
    *,
    touches: int | None = None,
    goal: Literal["regions", "inclusions"] = "regions",
    planner: Planner = "regions",
    set_force_n: float | None = None,
    smallest_inclusion_m: float | None = None,
    smallest_lump_m: float | None = None,
    beta_model: Literal["volume", "thesis", "layers", "none"] | None = None,
    pace: Literal["careful", "quick"] = "careful",
    hold_s: float = 0.0,
    feel: Literal["apparent", "relaxed", "loss"] = "apparent",
    seed: int = 0,
    record: Path | str | None = None,
    viewer: ViewerChoice = "none",
    overwrite: bool = False,
    yes: bool = False,
    trust_rig: bool = False,
    progress: Say | bool | None = None,
) -> ExplorationResult:
    """Map how soft a surface is: look, touch where it says most about the map, map, and again.

    rig: a rig file (.toml), or a simulated scene (`lab:NAME`); touches: at most, default 8, or 30 for inclusions
    goal: regions of one stiffness each, or inclusions: lumps below the surface; smallest_lump_m: radius of the smallest
    that must not be missed, default 0.02; set_force_n: at most 5 N
    smallest_inclusion_m: radius of the smallest lumps that are sought, default 0.06; pace: quick = low and fast over
    what is known of the surface; hold_s: of each touch, from which it says how the foam creeps; feel: what is mapped:
    stiffness at once, stiffness when all has relaxed, or the share of its energy that a touch loses
    record: a recording to make (.rrd); yes: let a real arm move, once the checks have passed, without asking
    progress: called with each line about checks and touches; default: they are printed on stderr where that is a
    terminal or a notebook; True: always, False: never; those of a rig file always, unless there is a function
    Raises InputError for what cannot be used, and SystemExit where the exploration was stopped before its end.
    """
    simulated = str(rig).startswith("lab:")
    with python_names():
        config = ExploreConfig(
            str(rig),
            touches=touches,
            goal=goal,
            smallest_lump_cm=None if smallest_lump_m is None else 100.0 * smallest_lump_m,
            planner=planner,
            set_force=set_force_n,
            smallest_inclusion=smallest_inclusion_m,
            beta_model=beta_model,
            pace=pace,
            hold=hold_s,
            feel=feel,
            yes=yes,
            trust_rig=trust_rig,
            output=OutputOptions(None, None if record is None else Path(record), viewer, overwrite, seed),
        )
        with said_to(progress if simulated or callable(progress) else True):
            return _explored(config)


def _explored(config: ExploreConfig) -> ExplorationResult:
    from deformscope.api.exploration_run import explore_on, map_arrays

    explored = explore_on(config, lambda explored: None)
    if explored is None:
        raise InputError("an exploration", "none: it ended before the arm could move")
    if (maps := explored.maps) is None:
        return ExplorationResult(explored.found, {})
    return ExplorationResult(explored.found, map_arrays(maps), result_png(maps, config.rig, explored.lumps))
