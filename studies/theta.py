"""`python -m studies theta`: theta where errors are shared, tracks wrong or lost, and at other settings.

python -m studies theta --only "another" --objects 100

Does a theta hold for another depth or resolution? Cubes of finite elements have a Poisson's ratio, but no theta: the
value depends on their compression and on the lattice of their particles.

Each cube is pressed twice, to two depths, on two lattices or both. Counted is how often the interval of one fit holds
the value of the other, by verdict.
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from deformscope.stages.fit.calibrate import FitOptions, Model
from studies.beta import (
    DISTURBED,
    QUANTITIES,
    DisturbedCase,
    DisturbedCoverageConfig,
    DisturbedOutcome,
    cases,
    disturbed_rows,
    names_of,
    summary,
    try_disturbed,
)
from studies.quantities import table
from studies.random_bodies import CANDIDATES, fitted
from studies.reproduce.pressed_cubes import DEPTHS_M, thesis_cubes
from studies.runner import Study, StudyReport, Trials

Setting = Literal["another depth", "another resolution", "another depth and resolution"]
SETTINGS: tuple[Setting, ...] = get_args(Setting)
"""In what the two fits of a cube differ."""

POISSON = (0.05, 0.45)
SIDES = (5, 6, 7, 8)
"""Particles along a side."""

NOISE_M = 1e-4


def try_setting(case: DisturbedCase) -> DisturbedOutcome:
    """One cube of a random Poisson's ratio at two settings; `beta` of the outcome is the theta of the other one."""
    rng = np.random.default_rng([case.seed, 17, get_args(Setting).index(case.name), case.number])
    ratio = float(rng.uniform(*POISSON))
    depths, sides = rng.choice(DEPTHS_M, 2, replace=False), rng.choice(SIDES, 2, replace=False)
    if "depth" not in case.name:
        depths[1] = depths[0]
    if "resolution" not in case.name:
        sides[1] = sides[0]
    model = Model("theta", cluster_size=None, basis="quadratic", beta=0.99, volume="project")
    options = FitOptions(model, (0.0, 1.0), candidates=CANDIDATES, level=case.level)

    def fit(depth: float, side: int, truth: float) -> DisturbedOutcome:
        (cube,), _ = thesis_cubes((ratio,), (side,), (depth,))
        deformed = cube.seen.deformed + rng.normal(0.0, NOISE_M, cube.seen.deformed.shape)
        deformed[cube.seen.held] = cube.seen.deformed[cube.seen.held]
        noise = np.full(len(deformed), NOISE_M)
        seen = dataclasses.replace(cube.seen, deformed=deformed, noise=noise, held_measured=None)
        return DisturbedOutcome(fitted(case.name, truth, [seen], options)[0])

    other = fit(float(depths[1]), int(sides[1]), 0.0).outcome.value
    return fit(float(depths[0]), int(sides[0]), other)


# The study -----------------------------------------------------------------------------------------------------------


COLUMNS = {
    "errors": "the other fit has",
    **{name: name for name in ("cases", "held", "95 % band", "width", "rms difference", "identified")},
    "identified without the truth": "identified without the other",
    "reasons": "reasons",
}


def trials(options: DisturbedCoverageConfig) -> list[Trials[DisturbedCase, DisturbedOutcome]]:
    """Requested objects of the kinds of errors, and cubes at the settings."""
    names = names_of(options.only, (*DISTURBED, *SETTINGS))
    disturbed, settings = ([name for name in names if (name in SETTINGS) is kind] for kind in (False, True))
    return [
        Trials("random objects", try_disturbed, cases(options, disturbed, "theta")),
        Trials("cubes at two settings", try_setting, cases(options, settings, "theta")),
    ]


def report(
    options: DisturbedCoverageConfig,
    seconds: float,
    disturbed: Sequence[DisturbedOutcome],
    settings: Sequence[DisturbedOutcome],
) -> StudyReport:
    """A line of each kind of errors, and one for each way in which two fits of a cube differ."""
    tables, found = summary(options, "theta", seconds, disturbed)
    lines = disturbed_rows(settings)
    if lines:
        title = f"{options.level:.0%} intervals that contain the theta of another setting"
        tables.append(table(lines, QUANTITIES, title, COLUMNS))
    return StudyReport(tables, found | {"settings": lines})


STUDY = Study(DisturbedCoverageConfig, trials, report)
