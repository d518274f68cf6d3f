"""`python -m studies beta`: beta where errors are shared, tracks wrong or lost.

python -m studies beta --jobs 8 --json coverage-beta.json
python -m studies beta --only "outliers,lost tracks" --objects 100

Do the intervals hold where the data are not as assumed? Random bodies of known beta or theta whose observed positions
have errors that neighbours share over several cells, outliers, lost tracks, or a wrong held particle.

Bodies, sizes of noise and truths are those of `studies.random_bodies`; a third of the bodies is in space. Rows named
"other solver" are bodies and errors of `studies.independent`: the whole tool is displaced, or the camera's scale or
lens is wrong, and noise by its roughness.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, get_args

import numpy as np
from tyro.conf import arg

from deformscope.arrays import BoolArray, FloatArray
from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.pictures.report import Table
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation
from deformscope.stages.fit.estimate import DoubtCode, Parameter, Verdict
from studies.field_bodies import SPACING_M
from studies.independent.observed import Errors, Pushed, pushed_clusters
from studies.independent.oracle import widths
from studies.quantities import Quantity, Rate, Row, band, by, counts, number, rows, share, table
from studies.random_bodies import (
    BOUNDS,
    CANDIDATES,
    Outcome,
    RandomBody,
    fitted,
    random_body,
    random_dim,
    random_noise,
    random_sigma,
)
from studies.runner import Study, StudyOptions, StudyReport, Trials

FRAMES = 5
"""Frames of a whole motion, pushed on evenly."""

OUTLIERS = (0.1, 1.0)
"""Distances of a wrong track from where its particle is, even between these [spacings]."""

LOST = (0.0, 0.8)
"""Share of its motion up to which a lost track follows its particle, even between these."""

THETA_BETA = 0.9
"""beta of the bodies whose theta is sought."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Errors of observed positions.

    cells: over how many spacings neighbours share errors (0: not at all), 0.7 to 1.3 times it, exponential, Matern or
    Gaussian; white: share of the variance that they do not; held_noise: held positions have it too; wrong, lost: share
    of the free particles whose track is wrong or lost; off: distance of one held particle from where it is said to be
    [spacings]; frames: frames of a motion, None for its end alone; frames_share: all have the same errors"""

    cells: float = 0.0
    white: float = 0.0
    held_noise: bool = True
    wrong: float = 0.0
    lost: float = 0.0
    off: float = 0.0
    frames: int | None = None
    frames_share: bool = False


DISTURBED: dict[str, Disturbance] = {
    "white": Disturbance(),
    "shared over 1 cell": Disturbance(cells=1.0),
    "shared over 2 cells": Disturbance(cells=2.0),
    "shared over 3 cells": Disturbance(cells=3.0),
    "shared over 6 cells": Disturbance(cells=6.0),
    "half white, half over 2 cells": Disturbance(cells=2.0, white=0.5),
    "half white, half over 6 cells": Disturbance(cells=6.0, white=0.5),
    "white, held exact": Disturbance(held_noise=False),
    "10 % outliers": Disturbance(wrong=0.1),
    "30 % outliers": Disturbance(wrong=0.3),
    "30 % lost tracks": Disturbance(lost=0.3),
    "over 2 cells, 10 % outliers": Disturbance(cells=2.0, wrong=0.1),
    "a held particle off by .3 cell": Disturbance(off=0.3),
    "motion, errors of each frame's own": Disturbance(frames=FRAMES),
    "motion, errors that frames share, over 2 cells": Disturbance(cells=2.0, frames=FRAMES, frames_share=True),
    "motion, 10 % outliers": Disturbance(wrong=0.1, frames=FRAMES),
}
"""By name."""

OTHER_SOLVER: dict[str, Errors] = {
    "white": Errors(),
    "white, held exact": Errors(held=False),
    "tool off by .5 mm along the push": Errors("along", 5e-4),
    "tool off by .5 mm any way": Errors("any", 5e-4),
    "tool turned by .5 mm at its ends": Errors("turned", 5e-4),
    "tool off by 1 mm along the push": Errors("along", 1e-3),
    "scale off by 1 %": Errors(camera="scale", camera_size=0.01),
    "scale of one axis off by 1 %": Errors(camera="scale x", camera_size=0.01),
    "linear drift of 1 mm": Errors(camera="drift", camera_size=1e-3),
    "lens, .5 mm": Errors(camera="lens", camera_size=5e-4),
    "a wave of .5 mm": Errors(camera="wave", camera_size=5e-4),
    "exponential noise over 3 cells": Errors(cells=3.0, smooth=0.5),
    "Matern noise over 3 cells": Errors(cells=3.0, smooth=1.5),
    "Gaussian noise over 3 cells": Errors(cells=3.0),
    "Gaussian noise over 3 cells, held exact and told": Errors(cells=3.0, held=False, told=True),
    "pressed, white": Errors(pressed=True),
    "pressed, Gaussian noise over 3 cells": Errors(cells=3.0, pressed=True),
    "pressed, tool off by .5 mm": Errors("along", 5e-4, pressed=True),
    "pressed, tool off by 1.7 mm": Errors("along", 1.7e-3, pressed=True),
    "pressed, scale 1 % too large": Errors(camera="scale", camera_size=0.01, pressed=True, sign=1),
    "pressed, scale 1 % too small": Errors(camera="scale", camera_size=0.01, pressed=True, sign=-1),
    "pressed, scale .5 % too large": Errors(camera="scale", camera_size=0.005, pressed=True, sign=1),
    "pressed, linear drift of 1 mm": Errors(camera="drift", camera_size=1e-3, pressed=True),
}
"""Errors of bodies of another solver; by name."""

TOOL_OFF = 0.04
"""Deviation of the tool for which one of the oracles allows [spacings]."""

OTHER = "other solver: "
NAMES = (*DISTURBED, *(OTHER + name for name in OTHER_SOLVER))
"""All kinds of errors."""


@dataclass(frozen=True, slots=True)
class DisturbedCase:
    """One random object: its name in `NAMES`, which parameter is fitted, its number and the seed."""

    name: str
    number: int
    seed: int
    parameter: Parameter = "beta"
    level: float = 0.9


@dataclass(frozen=True, slots=True)
class DisturbedOutcome:
    """Result of one object. disturbed, found: particles with a wrong or lost track or a wrong held position, and those
    that were left out; both: how many are in both; oracle: widths of `studies.independent.oracle`, of a right tool
    and of one that may be off by `TOOL_OFF`"""

    outcome: Outcome
    disturbed: int = 0
    found: int = 0
    both: int = 0
    oracle: tuple[float, ...] = ()


def try_disturbed(case: DisturbedCase) -> DisturbedOutcome:
    """One random object through the calibration."""
    rng = np.random.default_rng([case.seed, 16, NAMES.index(case.name), case.number])
    if case.name.startswith(OTHER):
        errors = OTHER_SOLVER[case.name.removeprefix(OTHER)]
        body = pushed_clusters(rng, errors, random_dim(case.number))
        options = FitOptions(Model(cluster_size=body.clusters), BOUNDS, candidates=CANDIDATES, level=case.level)
        outcome = fitted(case.name, body.beta, [observed(body, errors)], options)[0]
        right = errors.pressed and errors.tool == errors.camera == "none"
        return DisturbedOutcome(outcome, oracle=widths(body, errors, (0.0, TOOL_OFF), case.level) if right else ())
    what = DISTURBED[case.name]
    lattice = random_body(rng, random_dim(case.number))
    bounds = BOUNDS if case.parameter == "beta" else (0.0, 1.0)
    truth = float(rng.uniform(*bounds))
    model = _model(case.parameter, lattice)
    drawn = _Errors(what, lattice, random_sigma(rng), rng)
    frames = what.frames or 1
    seen = [drawn.observe(model, truth, (frame + 1) / frames) for frame in range(frames)]
    options = FitOptions(model, bounds, candidates=CANDIDATES, level=case.level)
    outcome, found = fitted(case.name, truth, seen, options, one_motion=what.frames is not None)
    left_out = np.zeros(len(lattice.rest), dtype=bool)
    for one in found.left_out:
        left_out[np.concatenate([one.lost, one.wrong, one.held])] = True
    disturbed, left, both = (int(np.count_nonzero(one)) for one in (drawn.bad, left_out, drawn.bad & left_out))
    return DisturbedOutcome(outcome, disturbed, left, both)


def observed(body: Pushed, errors: Errors) -> Observation:
    """Input of a calibration of a body of another solver; the noise is stated."""
    count = len(body.rest)
    return Observation(
        body.rest,
        body.seen,
        body.held,
        np.ones(count, dtype=bool),
        noise=np.full(count, body.sigma),
        shape=body.shape,
        cell=np.arange(count),
        held_measured=errors.held if errors.told else None,
    )


def _model(parameter: Parameter, body: RandomBody) -> Model:
    if parameter == "beta":
        return Model(cluster_size=body.cluster_size)
    return Model(parameter="theta", cluster_size=body.cluster_size, beta=THETA_BETA, volume="project")


class _Errors:
    """The errors of one object, drawn once. bad: (K,) particles whose track is wrong or lost, or whose held
    position is off"""

    def __init__(self, what: Disturbance, body: RandomBody, sigma: float, rng: np.random.Generator) -> None:
        self.what, self.body, self.sigma, self.rng = what, body, sigma, rng
        count, d = body.rest.shape
        self.free: BoolArray = np.ones(count, dtype=bool)
        self.free[body.held] = False
        self.same = self._noise()
        draw = rng.random(count)
        self.wrong: BoolArray = self.free & (draw < what.wrong)
        self.lost: BoolArray = self.free & (what.wrong <= draw) & (draw < what.wrong + what.lost)
        self.bad = self.wrong | self.lost
        self.jump = SPACING_M * rng.uniform(*OUTLIERS, (count, 1)) * _directions(rng, count, d)
        self.until = rng.uniform(*LOST, (count, 1))
        self.off = np.zeros((count, d))
        displaced = rng.choice(body.held)
        self.off[displaced] = SPACING_M * what.off * _directions(rng, 1, d)[0]
        self.bad[displaced] = what.off > 0.0

    def _noise(self) -> FloatArray:
        what, rng, rest = self.what, self.rng, self.body.rest
        noise = np.sqrt(what.white if what.cells else 1.0) * rng.standard_normal(rest.shape)
        if what.cells:
            noise += np.sqrt(1.0 - what.white) * random_noise(rng, rest / what.cells, correlated=True)
        if not what.held_noise:
            noise[self.body.held] = 0.0
        return np.asarray(self.sigma * noise)

    def observe(self, model: Model, truth: float, share: float) -> Observation:
        """Observation at a share of the motion."""
        body = self.body
        start = body.rest[body.held]
        held = start + share * (body.held_position - start)
        beta, theta = (truth, 0.0) if model.parameter == "beta" else (model.beta, truth)
        simulated = model.body(body.observe(body.rest)).relax(held, beta, theta, volume=model.volume).position[0]
        noise = self.same if self.what.frames_share or self.what.frames is None else self._noise()
        seen = simulated + noise + self.off
        seen[self.wrong] += self.jump[self.wrong]
        stays = self.lost & (share > self.until[:, 0])
        seen[stays] -= ((1.0 - self.until / share) * (simulated - body.rest))[stays]
        return body.observe(seen, self.sigma)


def _directions(rng: np.random.Generator, count: int, d: int) -> FloatArray:
    drawn = rng.standard_normal((count, d))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


# The study -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DisturbedCoverageConfig(StudyOptions):
    """Count how often the intervals hold the truth on data that violate the assumptions: errors that neighbours share
    over 1 to 6 cells, with and without white noise, outliers, lost tracks, a wrong held particle, whole motions. On
    bodies of another solver, also a displaced tool, a wrong camera, and noise by its roughness."""

    objects: Annotated[int, flags.least(3)] = 400
    """Random objects for each kind of error, a third of them in space; each takes some .3 s of a core."""
    only: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """These kinds alone, such as "30 % outliers,30 % lost tracks"; parts of their names do."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""


def _fits(some: Sequence[DisturbedOutcome]) -> list[Outcome]:
    return [one.outcome for one in some]


def _covered(some: Sequence[DisturbedOutcome], dim: int | None = None) -> Rate:
    """Truths within their intervals, in the plane or in space."""
    return Rate.of(one.covered for one in _fits(some) if dim in (None, one.dim))


def _over_oracle(some: Sequence[DisturbedOutcome]) -> list[float]:
    """Median widths in units of each oracle's; empty where none was computed."""
    each = [float(np.ptp(one.outcome.interval)) / np.array(one.oracle) for one in some if one.oracle]
    return [float(one) for one in np.median(each, axis=0)] if each else []


def _called(verdict: Verdict) -> Callable[[Sequence[DisturbedOutcome]], Rate]:
    return lambda some: Rate.of(one.verdict == verdict for one in _fits(some))


def _alarms(some: Sequence[DisturbedOutcome]) -> Rate:
    """Share of undisturbed particles that are left out."""
    others = sum(one.outcome.particles - one.disturbed for one in some)
    return Rate(others, sum(one.found - one.both for one in some))


def _reasons(some: Sequence[DisturbedOutcome]) -> dict[DoubtCode, Rate]:
    """Number of each reason to doubt the value."""
    named = {code: Rate.of(code in one.codes for one in _fits(some)) for code in get_args(DoubtCode)}
    return {code: rate for code, rate in named.items() if rate.hits}


def reasons_text(reasons: Mapping[DoubtCode, Rate]) -> str:
    """Number of each reason, as text."""
    return ", ".join(f"{code} {rate.rate:.2f}" for code, rate in reasons.items())


QUANTITIES: tuple[Quantity[Sequence[DisturbedOutcome]], ...] = (
    Quantity("condition", lambda some: some[0].outcome.condition, {"errors": str}),
    Quantity("covered", _covered, {"cases": lambda rate: rate.cases, "held": share(3), "95 % band": band(3)}),
    Quantity("covered_2d", lambda some: _covered(some, 2), {"2D": share(2)}),
    Quantity("covered_3d", lambda some: _covered(some, 3), {"3D": share(2)}),
    Quantity(
        "width", lambda some: float(np.median([np.ptp(one.interval) for one in _fits(some)])), {"width": number(3)}
    ),
    Quantity(
        "rms",
        lambda some: float(np.sqrt(np.mean([(one.value - one.beta) ** 2 for one in _fits(some)]))),
        {"rms difference": number(3)},
    ),
    Quantity(
        "over_oracle",
        _over_oracle,
        {"times the oracle's, tool right / may be off": lambda each: " / ".join(f"{one:.2f}" for one in each)},
    ),
    Quantity("identified", _called("identified"), {"identified": share(2)}),
    Quantity("unidentified", _called("unidentified"), {"unidentified": share(2)}),
    Quantity(
        "wrong",
        lambda some: Rate.of(not one.covered for one in _fits(some) if one.verdict == "identified"),
        {"identified without the truth": lambda rate: rate.hits},
    ),
    Quantity(
        "caught",
        lambda some: Rate(sum(one.disturbed for one in some), sum(one.both for one in some)),
        {"wrong ones left out": share(2)},
    ),
    Quantity("alarms", _alarms, {"right ones left out": lambda rate: f"{rate.rate:.4f}"}),
    Quantity("verdicts", lambda some: counts(one.verdict for one in _fits(some))),
    Quantity("reasons", _reasons, {"reasons": reasons_text}),
    Quantity("fit_seconds", lambda some: float(np.median([one.seconds for one in _fits(some)]))),
)
COLUMNS = {name: name for one in QUANTITIES for name in one.columns if name != "rms difference"}


def disturbed_rows(tried: Sequence[DisturbedOutcome]) -> list[Row]:
    """All quantities, of each kind of errors."""
    return rows(by(tried, lambda one: one.outcome.condition).values(), QUANTITIES)


def names_of(only: str, every: Sequence[str]) -> list[str]:
    """Those whose names contain one of some parts, parted by commas; all for none."""
    parts = [part.strip() for part in only.split(",") if part.strip()]
    names = [name for name in every if not parts or any(part in name for part in parts)]
    if not names:
        raise InputError(f"parts of {'; '.join(every)}", only)
    return names


def cases(options: DisturbedCoverageConfig, names: Sequence[str], parameter: Parameter) -> list[DisturbedCase]:
    """So many objects of each of these names."""
    numbers, seed = range(options.objects), options.output.seed
    return [DisturbedCase(name, number, seed, parameter, options.level) for name in names for number in numbers]


def summary(
    options: DisturbedCoverageConfig, parameter: Parameter, seconds: float, tried: Sequence[DisturbedOutcome]
) -> tuple[list[Table], dict[str, object]]:
    """The table of what was disturbed, if anything, and what the JSON has."""
    lines = disturbed_rows(tried)
    tables = [table(lines, QUANTITIES, f"{options.level:.0%} intervals for {parameter}", COLUMNS)] if lines else []
    return tables, {
        "parameter": parameter,
        "level": options.level,
        "seed": options.output.seed,
        "disturbances": [row | {"errors": _errors_of(row["condition"])} for row in lines],
        "seconds": seconds,
    }


def _errors_of(name: str) -> Disturbance | Errors:
    return OTHER_SOLVER[name.removeprefix(OTHER)] if name.startswith(OTHER) else DISTURBED[name]


def trials(options: DisturbedCoverageConfig) -> list[Trials[DisturbedCase, DisturbedOutcome]]:
    """Objects of the requested kinds of errors."""
    return [Trials("random objects", try_disturbed, cases(options, names_of(options.only, NAMES), "beta"))]


def report(options: DisturbedCoverageConfig, seconds: float, tried: Sequence[DisturbedOutcome]) -> StudyReport:
    """A line of each kind of errors."""
    return StudyReport(*summary(options, "beta", seconds, tried))


STUDY = Study(DisturbedCoverageConfig, trials, report)
