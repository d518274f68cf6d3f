"""`python -m studies safety`: whether the arm stops in time, and avoids limits and singularities.

python -m studies safety --faults 1000 --layouts 200 --rigid 214 --jobs 8 --json safety.json
python -m studies safety --faults 100 --layouts 0 --rigid 0
python -m studies safety --arm kuka --faults 500 --layouts 0
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from deformscope.config import flags
from deformscope.lab.faults import Injected
from deformscope.pictures.report import Table
from studies.driven_faults import KILLED_WITHIN_S, KINDS, AnyRun, DrivenRun, KilledRun, kind_of, run_any
from studies.fault_study import ALLOWED_S, ENDED_WITHIN_S, TURNED_DEG, UNSEEN_M, FaultRun
from studies.layouts import LayoutRun, run_layout, shares_by_distance
from studies.rigid_faults import CASES, STIFFNESSES_N_M, RigidRun, run_rigid
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported
from studies.silent_kuka import FARTHEST_M, SilentRun, run_silent


@dataclass(frozen=True, slots=True)
class SafetyCoverageConfig(StudyOptions):
    """Count whether a simulated arm stops in time after faults, of all kinds in turn, and its time and distance to
    rest. On random layouts of arm and table, count its distance from joint limits and singularities."""

    arm: Literal["jaco", "kuka"] = "jaco"
    """Source of faults: jaco = all kinds, or kuka = answers that end during a motion, of controllers with HOLDON 0 and
    1; 500 faults are 50 of each."""
    faults: Annotated[int, flags.least(0)] = 1000
    """Faults; each takes some 2 s of a core. 0 = none."""
    layouts: Annotated[int, flags.least(0)] = 200
    """Layouts; each takes some 5 s of a core. 0 = none."""
    rigid: Annotated[int, flags.least(0)] = len(CASES)
    """Touches of a rigid surface by a force sensor that is wrong; each takes some 4 s of a core. 0 = none."""


def trials(options: SafetyCoverageConfig) -> list[Trials[int, Any]]:
    """Faults, layouts and rigid surfaces; those without a request have no cases."""

    def seeds(count: int) -> Sequence[int]:
        return reported(count, options.output.seed) if count else ()

    return [
        Trials("faults", run_silent if options.arm == "kuka" else run_any, seeds(options.faults)),
        Trials("layouts", run_layout, seeds(options.layouts)),
        Trials("rigid surfaces", run_rigid, seeds(options.rigid)),
    ]


def report(
    options: SafetyCoverageConfig,
    seconds: float,
    runs: Sequence[AnyRun | SilentRun],
    layouts: Sequence[LayoutRun],
    rigid: Sequence[RigidRun],
) -> StudyReport:
    """A table of each that there was."""
    silences = [run for run in runs if isinstance(run, SilentRun)]
    faults = [run for run in runs if not isinstance(run, SilentRun)]
    tables = [fault_table(faults)] if faults else []
    tables += [silence_table(silences)] if silences else []
    tables += [rigid_table(rigid)] if rigid else []
    tables += [layout_table(layouts), slowing_table(layouts)] if layouts else []
    kinds: dict[str, list[AnyRun | SilentRun]] = {} if silences else {kind: [] for kind in KINDS}
    for run in runs:
        kinds.setdefault(run.kind if isinstance(run, SilentRun) else kind_of(run), []).append(run)
    late = [run for run in runs if not run.in_time]
    return StudyReport(
        [*tables, Table([("all", f"{seconds:.0f} s")], caption="Time")],
        {
            "arm": options.arm,
            "faults": options.faults,
            "in_time": options.faults - len(late),
            "late": late,
            "kinds": kinds,
            "rigid": rigid,
            "layouts": layouts,
            "least_margin_deg": min((run.margin_deg for run in layouts), default=None),
            "seconds": seconds,
        },
    )


def fault_table(runs: Sequence[AnyRun]) -> Table:
    """A line for each kind, and one for all."""
    lines = [_fault_line(kind, [run for run in runs if kind_of(run) == kind]) for kind in KINDS]
    lines = [line for line in lines if line[1]]
    names: tuple[str, ...] = (
        "fault",
        "runs",
        "in time",
        "noticed [ms]: median, max, limit",
        "until then, max",
        f"ended [ms], max ({1e3 * ENDED_WITHIN_S:g})",
    )
    names += ("at rest after [ms]: median, max", "tip [mm]: median, max", "joint [deg], max", "left, least")
    return Table([*lines, _fault_line("all", runs)], names, "Injected faults")


def silence_table(runs: Sequence[SilentRun]) -> Table:
    """A line for each HOLDON and what ended the answers: how many were refused, how far the flange moved."""
    lines = []
    for kind in sorted({run.kind for run in runs}):
        of_kind = [run for run in runs if run.kind == kind]
        right, refused = sum(run.in_time for run in of_kind), sum(run.refused for run in of_kind)
        lines.append((kind, len(of_kind), right, refused, _range([1e3 * run.moved_m for run in of_kind], 2)))
    names = ("answers end by", "runs", "in time", "refused at opening", "flange moved [mm]: median, max")
    return Table(lines, names, f"A KUKA at 8 deg/s whose answers end; limit {1e3 * FARTHEST_M:g} mm")


def _fault_line(name: str, runs: Sequence[AnyRun]) -> tuple[object, ...]:
    struck = [run for run in runs if isinstance(run, FaultRun)]
    driven = [run for run in runs if isinstance(run, DrivenRun)]
    killed = [run for run in runs if isinstance(run, KilledRun)]
    noticed_ms = [1e3 * run.noticed_s for run in struck] + [1e3 * run.moved_s for run in killed]
    limits = {_limit(run.injected) for run in struck} | {f"{1e3 * KILLED_WITHIN_S:g}" for _ in killed}
    stopped: list[FaultRun | DrivenRun] = [*struck, *driven]
    stills = [run.standstill for run in stopped if np.isfinite(run.standstill.seconds)]
    turned_deg = [still.turned_deg for still in stills] + [run.turned_deg for run in killed]
    return (
        name,
        len(runs),
        sum(run.in_time for run in runs),
        f"{_range(noticed_ms, 0)}, {limits.pop()}" if len(limits) == 1 else "",
        _until_noticed(struck),
        f"{1e3 * max(run.ended_s for run in stopped):.0f}" if stopped else "",
        _range([1e3 * still.seconds for still in stills], 0),
        _range([1e3 * still.tip_m for still in stills], 1),
        f"{max(turned_deg):.2f}" if turned_deg else "",
        f"{min(run.left for run in driven):.3g}" if driven and name != "all" else "",
    )


def _limit(injected: Injected) -> str:
    """Within which it is to be noticed."""
    match injected:
        case Injected.ARM_FROZEN:
            return f"{1e3 * ALLOWED_S[injected]:.0f} or {1e3 * UNSEEN_M:g} mm"
        case Injected.ARM_TURNS:
            return f"{TURNED_DEG:g} deg"
    return f"{1e3 * ALLOWED_S[injected]:.0f}"


def _until_noticed(runs: Sequence[FaultRun]) -> str:
    """The arm's undetected motion, of the kinds that are judged by it: those detected later than other faults of the
    arm."""
    kinds = {run.injected for run in runs}
    later = [run for run in runs if run.noticed_s > ALLOWED_S[run.injected]]
    if kinds == {Injected.ARM_FROZEN}:
        return f"{1e3 * max((run.unseen_m for run in later), default=0.0):.1f} mm of {len(later)} later ones"
    return f"{max(run.turned_deg for run in runs):.1f} deg" if kinds == {Injected.ARM_TURNS} else ""


def _range(values: Sequence[float], digits: int) -> str:
    return f"{np.median(values):.{digits}f}, {max(values):.{digits}f}" if values else ""


def rigid_table(runs: Sequence[RigidRun]) -> Table:
    """A line for each arm and what was wrong: the greatest force by stiffness in series, and how many were in time."""
    lines = []
    for arm, fault, phase in dict.fromkeys((run.arm, run.fault, run.phase) for run in runs):
        some = [run for run in runs if (run.arm, run.fault, run.phase) == (arm, fault, phase)]
        cells = [_greatest([run for run in some if run.stiffness_n_m == n_m]) for n_m in STIFFNESSES_N_M]
        lines.append((arm, fault, phase or "", *cells, f"{sum(run.in_time for run in some)} of {len(some)}"))
    names = ("arm", "what is wrong", "from the phase", *(f"{n_m / 1e3:g} N/mm" for n_m in STIFFNESSES_N_M), "in time")
    return Table(lines, names, "A rigid surface, and a force sensor that is wrong")


def _greatest(runs: Sequence[RigidRun]) -> str:
    if runs and all(run.refused for run in runs):
        return "refused"
    return f"{max(run.max_force_n for run in runs):.1f} N" if runs else ""


def layout_table(runs: Sequence[LayoutRun]) -> Table:
    """Number of layouts, the ends of their touches, and remaining distance to joint limits."""
    begun = [run for run in runs if not run.refused]
    refused = Counter(run.refused for run in runs if run.refused)
    endings = Counter(ending for run in begun for ending in run.endings)
    faults = Counter(fault for run in begun for fault in run.faults)
    rows: list[tuple[object, ...]] = [("layouts", len(runs)), ("touched", len(begun))]
    rows += [(f"refused: {why}", count) for why, count in refused.most_common()]
    rows += [(f"touches: {ending}", count) for ending, count in endings.most_common()]
    rows += [(f"stopped on its way: {fault}", count) for fault, count in faults.most_common()]
    rows.append(
        ("least distance of a joint to its limit", f"{min((run.margin_deg for run in begun), default=0):.1f} deg")
    )
    return Table(rows, caption="Random layouts of arm and table")


def slowing_table(runs: Sequence[LayoutRun]) -> Table:
    """By distance to a singularity along the motion, the sent share of the requested velocity."""
    rows = [
        (f"up to {high:g} deg" if np.isfinite(high) else "farther", count, f"{share:.2f}")
        for high, (count, share) in shares_by_distance(runs).items()
    ]
    return Table(rows, ("to a singularity", "looks", "share sent, mean"), "Slowing before singularities")


STUDY = Study(SafetyCoverageConfig, trials, report)
