"""`python -m studies placing`: how often an arm's double places the hand, and whether a moved container is noticed.

python -m studies placing --arm jaco --trials 60 --disturbed 50 --json placing.json
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal, cast

import numpy as np

from deformscope.config import flags
from deformscope.experiments.squeeze.features import SqueezeGeometry
from deformscope.experiments.squeeze.frames import ObservedRecorder
from deformscope.experiments.squeeze.placing import CONTAINER, NO_GRASP, Placing, PlacingArm, Squeezed, squeeze
from deformscope.experiments.squeeze.squeezing_hand import SqueezingHand, observer_of
from deformscope.lab.container_setup import CarriedHandLab, container_lab
from deformscope.pictures.report import Table
from deformscope.recording.recorder import Recorder
from deformscope.robot.checks import Preflight
from deformscope.robot.squeeze_plan import RandomGrasp
from deformscope.session import RigExperiment, run
from studies.regions import clopper_pearson
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported

CAMERA_HZ = 5.0
"""Fewer images than a real camera's: they cost most of a trial."""
LEVEL = 0.95
DISTURBED = ("travel", "approach", "retreat")
"""The phases in which a person moves or topples the container, in turn."""
FORCES = ("force above the soft stop", "force above the hard stop")
"""A container that was pushed into the hand's way may be touched before the camera sees it."""


class PlacedTrial:
    """One squeeze of the laboratory that an arm places. found: the outcome; phases: that began; on_phase: called as
    they do; asks: a person is asked before the arm moves, and does this meanwhile"""

    def __init__(self, arm: str = "jaco", container: str = "cylinder-03", seed: int = 4, content: str = "rice") -> None:
        made = container_lab(content, container, seed=seed, camera_hz=CAMERA_HZ, arm=arm)
        self.setup, self.lab, self.seed, self.found = made.setup, cast(CarriedHandLab, made.lab), seed, Squeezed()
        self.phases: list[str] = []
        self.on_phase: Callable[[str], None] = lambda phase: None
        self.asks: Callable[[], None] | None = None
        self.preflight: Preflight | None = None

    def go(self, grasp: RandomGrasp | None = None) -> Squeezed:
        """From opening to the end. grasp: None = drawn from the seed"""
        setup = self.setup
        with setup.open_source() as source:
            observer, geometry = observer_of(setup, source), SqueezeGeometry.of(setup)
            self.hand = hand = SqueezingHand(setup, source, observer)
            hand.on_phase = self._began
            hand.arm = self.arm = PlacingArm(setup, source, hand.begin, hand.cycled)
            placing = Placing(setup, observer.frames, geometry, self.arm, self.seed, self.found, self._permit, grasp)
            before, after = placing.before(), placing.after()
            experiment = squeeze(setup.clock, observer, geometry, self.found, placed=before, withdrawn=after)
            run(source, experiment, ObservedRecorder(Recorder(None), observer), hand)
            hand.halt("the trial is over")
        return self.found

    def at(self, phase: str, action: Callable[[], None], later_s: float = 0.3) -> None:
        """Do something at a time after a phase has begun for the first time."""

        def began(name: str) -> None:
            if name == phase:
                self.lab.schedule(self.lab.clock() + round(later_s * 1e9), action)
                self.on_phase = lambda phase: None

        self.on_phase = began

    def _permit(self, preflight: Preflight) -> RigExperiment[bool]:
        self.preflight = preflight
        if self.asks is not None:
            self.asks()
        yield from ()
        return self.asks is not None

    def _began(self, phase: str) -> None:
        self.phases.append(phase)
        self.on_phase(phase)


@dataclass(frozen=True, slots=True)
class PlacingCase:
    """disturbed: the phase in which a person moves or topples the container, empty = none"""

    arm: str
    seed: int
    disturbed: str = ""


@dataclass(frozen=True, slots=True)
class PlacedRun:
    """Outcome of a case. stop: kind and reason of what ended it, also on the way back, empty = nothing; drawn: grasps,
    and of those that were refused why; changes: changes of the container's place in the looks after the first
    struck: how the container was disturbed, empty = not, as it did not come so far; closed: the fingers closed
    off_mm: offset of the container in the end, from where it stood first"""

    case: PlacingCase
    container: str
    stop: str
    reason: str
    drawn: int
    refused: tuple[str, ...]
    changes: tuple[str, ...]
    struck: str = ""
    off_mm: float = 0.0
    closed: bool = False

    @property
    def placed(self) -> bool:
        """The hand was placed, squeezed, and was withdrawn."""
        return not self.stop

    @property
    def noticed(self) -> str:
        """Detection of a disturbed container in time, by `image` or `force`; empty = none."""
        if self.case.disturbed == DISTURBED[-1]:
            return "image" if self.changes[-1:] not in ((), ("stands",), ("hidden",)) else ""
        told = "image" if self.stop.startswith(CONTAINER) else "force" if self.stop in FORCES else ""
        return "" if self.closed else told


@dataclass(slots=True)
class _Disturbance:
    """A person moves or topples the container once. struck: how"""

    trial: PlacedTrial
    random: np.random.Generator
    struck: list[str] = field(default_factory=list)

    def __call__(self) -> None:
        simulated, way = self.trial.lab.simulated, self.random.uniform(-np.pi, np.pi)
        direction = np.array([np.cos(way), np.sin(way)])
        if self.random.integers(2):
            simulated.topple(direction)
            self.struck.append("toppled")
            return
        far_m, turn_deg = self.random.uniform(0.008, 0.03), self.random.uniform(-20.0, 20.0)
        simulated.shift(far_m * direction[0], far_m * direction[1], turn_deg)
        self.struck.append("moved")


def try_placing(case: PlacingCase) -> PlacedRun:
    """One trial, its container of either kind."""
    random = np.random.default_rng([case.seed, 0x9A])
    container = f"{random.choice(['box', 'cylinder'])}-{int(random.integers(100)):02d}"
    trial = PlacedTrial(case.arm, container, case.seed)
    disturbance = _Disturbance(trial, random)
    if case.disturbed:
        trial.at(case.disturbed, disturbance, random.uniform(0.1, 1.5))
    stood = trial.lab.simulated.T_table_container[:2, 3].copy()
    found = trial.go()
    stop, placed = found.stop or found.withdrawal, found.placement
    refused = () if placed is None else placed.refused
    off_m = float(np.linalg.norm(trial.lab.simulated.T_table_container[:2, 3] - stood))
    return PlacedRun(
        case,
        container,
        "" if stop is None else stop.kind,
        "" if stop is None else stop.reason,
        len(refused),
        tuple(why for why in refused if why),
        tuple(one.change.kind for one in found.sightings if one.change is not None),
        "".join(disturbance.struck),
        1e3 * off_m,
        "close" in trial.phases,
    )


@dataclass(frozen=True, slots=True)
class PlacingStudyConfig(StudyOptions):
    """Count how often a simulated arm places the hand at a container, and the reasons of failures. Also count whether
    it detects a container that a person moves or topples on the way there, or on the way back."""

    arm: Literal["jaco", "kuka"] = "jaco"
    """The arm's double."""
    trials: flags.ManyFlag = 60
    """Containers that no person touches; each takes about 7 s of a core."""
    disturbed: Annotated[int, flags.least(0)] = 50
    """Containers that a person moves or topples."""


def trials(options: PlacingStudyConfig) -> list[Trials[PlacingCase, PlacedRun]]:
    """Containers that no person touches, and those that a person disturbs: of the seeds after those."""
    seeds = reported(options.trials + options.disturbed, options.output.seed)
    cases = [PlacingCase(options.arm, seed) for seed in seeds[: options.trials]]
    moved = [
        PlacingCase(options.arm, seed, DISTURBED[index % len(DISTURBED)])
        for index, seed in enumerate(seeds[options.trials :])
    ]
    return [Trials("containers", try_placing, cases), Trials("disturbed containers", try_placing, moved)]


def report(
    options: PlacingStudyConfig, seconds: float, runs: Sequence[PlacedRun], disturbed: Sequence[PlacedRun]
) -> StudyReport:
    """Number of placed ones, and reasons of failures; refused grasps; detected disturbances, and their detection."""
    placed, stops = sum(one.placed for one in runs), Counter(one.stop for one in runs if one.stop)
    changes = Counter(change for one in runs for change in one.changes)
    refused, drawn = Counter(why for one in runs for why in one.refused), sum(one.drawn for one in runs)
    rows: list[tuple[object, ...]] = [("placed, squeezed and withdrawn", _share(placed, len(runs)))]
    rows += [(f"ended: {why}", count) for why, count in stops.most_common()]
    rows += [(f"looks afterwards: {change}", count) for change, count in changes.most_common()]
    rows.append(("grasps drawn", drawn))
    rows += [(f"refused: {why}", count) for why, count in refused.most_common()]
    tables = [Table(rows, caption=f"{options.arm}: containers that no person touches")]
    struck = [one for one in disturbed if one.struck]
    lines = []
    for phase in DISTURBED:
        for how in ("moved", "toppled"):
            some = [one for one in struck if one.case.disturbed == phase and one.struck == how]
            by = Counter(one.noticed for one in some)
            lines.append((how, phase, len(some), by["image"], by["force"], by[""]))
    if disturbed:
        lines.append(("all", "", *np.sum([line[2:] for line in lines], axis=0).tolist()))
        names = ("container", "while", "trials", "noticed by image", "by the fingers", "not noticed")
        told = _share(sum(bool(one.noticed) for one in struck), len(struck))
        caption = f"{options.arm}: containers that a person moves or topples; noticed {told}"
        tables.append(Table(lines, names, caption))
    return StudyReport(
        [*tables, Table([("all", f"{seconds:.0f} s")], caption="Time")],
        {
            "arm": options.arm,
            "placed": placed,
            "trials": len(runs),
            "no_grasp": stops[NO_GRASP],
            "noticed": sum(bool(one.noticed) for one in struck),
            "struck": len(struck),
            "runs": [*runs, *disturbed],
            "seconds": seconds,
        },
    )


def _share(count: int, of: int) -> str:
    low, high = clopper_pearson(count, of, LEVEL)
    return f"{count} of {of} ({low:.2f} to {high:.2f})"


STUDY = Study(PlacingStudyConfig, trials, report)
