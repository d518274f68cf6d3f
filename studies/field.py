"""`python -m studies field`: how well one deformation determines the stiffness of each place of a body.

python -m studies field
python -m studies field --kinds "two, stretch" "three, shear" --objects 20 --json field.json

Plates and slabs whose stiffness differs from place to place, by the laboratory's finite elements (`field_bodies`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.distance import cdist
from tyro.conf import arg

from deformscope.arrays import FloatArray
from deformscope.cli.study import Study, StudyReport, Trials
from deformscope.config import flags
from deformscope.config.reproduce import StudyOptions
from deformscope.errors import InputError
from deformscope.pictures.report import Table
from deformscope.stages.materials.field import fit_field
from studies.field_bodies import NOISE_REACH, NOISE_SHARES, SPACING_M, Way, Young, elastic_pair
from studies.quantities import Rate, by, of_cases
from studies.seeds import reported

PLATE, SLAB = (17, 13), (11, 6, 4)


@dataclass(frozen=True, slots=True)
class FieldBody:
    """young: modulus of places (n, d) [m]; materials: how many there are, 0 = gradual"""

    shape: tuple[int, ...]
    way: Way
    young: Young
    materials: int


def _bodies() -> dict[str, FieldBody]:
    def step(end: float, tilt: float = 0.0) -> Young:
        return lambda place: np.where(place[:, 0] - tilt * place[:, 1] < end, 10e3, 40e3)

    def three(place: FloatArray) -> FloatArray:
        return np.asarray(np.select([place[:, 0] < 0.06, place[:, 0] < 0.11], [10e3, 60e3], 20e3))

    def gradual(place: FloatArray) -> FloatArray:
        return np.asarray(10e3 * 4.0 ** (place[:, 0] / 0.16))

    found = {}
    ways: tuple[Way, ...] = ("stretch", "shear")
    for way in ways:
        found[f"two, {way}"] = FieldBody(PLATE, way, step(0.08), 2)
        found[f"two tilted, {way}"] = FieldBody(PLATE, way, step(0.06, 0.3), 2)
        found[f"three, {way}"] = FieldBody(PLATE, way, three, 3)
        found[f"gradual, {way}"] = FieldBody(PLATE, way, gradual, 0)
        found[f"one, {way}"] = FieldBody(PLATE, way, lambda place: np.full(len(place), 20e3), 1)
    return found | {"two, slab, stretch": FieldBody(SLAB, "stretch", step(0.05), 2)}


BODIES = _bodies()
"""By name."""


@dataclass(frozen=True, slots=True)
class FieldOutcome:
    """How one body's field was determined.

    right: the verdict and number of materials are the true ones; ratio: stiffest over softest, over the true one
    border: how far the farthest wrong cell is from one of the material that it was given [spacings], 0 = none is wrong;
    NaN where there are no materials, or another number
    held: share of the places whose interval holds the truth; beta_ratio: of 1 - beta, over the true ratio of stiffness
    """

    kind: str
    seed: int
    verdict: str
    right: bool
    ratio: float
    covered: bool
    border: float
    held: float
    rms_log: float
    beta_ratio: float


def try_field(case: tuple[str, int]) -> FieldOutcome:
    """Deform the body of that name under the noise of that seed, and fit it."""
    kind, seed = case
    body = BODIES[kind]
    rng = np.random.default_rng(seed)
    reach, size = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (NOISE_REACH, NOISE_SHARES))
    seen = elastic_pair(body.shape, body.young, way=body.way, noise_m=SPACING_M * size, reach=reach, seed=seed)
    found, _ = fit_field(seen)
    young = body.young(found.place)
    true = young / np.exp(np.log(young).mean())
    contrast = float(young.max() / young.min())
    right_name = {0: "gradual", 1: "uniform"}.get(body.materials, "materials")
    right = found.verdict == right_name and max(found.materials, 0) == body.materials
    border = np.nan
    if body.materials > 1 and found.materials == body.materials:
        label = np.unique(young, return_inverse=True)[1]
        gap = cdist(found.place, found.place) / found.spacing
        wrong = np.flatnonzero(label != found.material)
        border = max((float(gap[one, label == found.material[one]].min()) for one in wrong), default=0.0)
    low, high = found.interval.T
    return FieldOutcome(
        kind,
        seed,
        found.verdict,
        right,
        found.ratio / contrast,
        bool(found.ratio_interval[0] <= contrast <= found.ratio_interval[1]),
        border,
        float(np.mean((low <= true) & (true <= high))),
        float(np.sqrt(np.mean(np.log(found.stiffness / true) ** 2))),
        found.beta_ratio / contrast,
    )


# The study -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FieldCoverageConfig(StudyOptions):
    """Count how often `calibrate field` finds materials, their border and their ratio: plates and slabs of finite
    elements, under noise that neighbours share."""

    kinds: Annotated[tuple[str, ...], arg(metavar="NAME...")] = ()
    """Bodies by name, as the table has them; default: all."""
    objects: flags.ManyFlag = 6
    """Bodies of each kind, from seed SEED on; a plate takes some 5 s, a slab 30."""

    def check(self) -> None:
        if unknown := [one for one in self.kinds if one not in BODIES]:
            raise InputError(f"--kinds of {'; '.join(BODIES)}", "; ".join(unknown))


def trials(options: FieldCoverageConfig) -> list[Trials[tuple[str, int], FieldOutcome]]:
    """So many bodies of each kind."""
    seeds = reported(options.objects, options.output.seed)
    return [Trials("bodies", try_field, [(kind, seed) for kind in options.kinds or tuple(BODIES) for seed in seeds])]


def _right(write: Callable[[Sequence[FieldOutcome]], str]) -> Callable[[Sequence[FieldOutcome]], str]:
    """Of those whose verdict is right."""
    return lambda some: write(right) if (right := [one for one in some if one.right]) else "-"


def _border(right: Sequence[FieldOutcome]) -> str:
    several = BODIES[right[0].kind].materials > 1
    return f"{np.mean([one.border < 1.0 + 1e-6 for one in right]):.0%}" if several else "-"


QUANTITIES: dict[str, Callable[[Sequence[FieldOutcome]], str]] = {
    "body": lambda some: some[0].kind,
    "verdict right": lambda some: of_cases(Rate.of(one.right for one in some)),
    "unidentified": lambda some: str(sum(one.verdict == "unidentified" for one in some)),
    "ratio within 15 %": _right(lambda some: f"{np.mean([abs(one.ratio - 1.0) <= 0.15 for one in some]):.0%}"),
    "ratio over the true one": _right(
        lambda some: f"{min(one.ratio for one in some):.2f} to {max(one.ratio for one in some):.2f}"
    ),
    "border within 1 spacing": _right(_border),
    "intervals hold ratio, places": lambda some: (
        f"{np.mean([one.covered for one in some]):.2f}, {np.mean([one.held for one in some]):.2f}"
    ),
    "1 - beta over the true ratio": lambda some: f"{np.median([one.beta_ratio for one in some]):.2f}",
}
"""Columns of the table by their headings."""


def field_rows(tried: Sequence[FieldOutcome]) -> list[tuple[str, ...]]:
    """A line for each kind of body."""
    return [tuple(of(some) for of in QUANTITIES.values()) for some in by(tried, lambda one: one.kind).values()]


def report(options: FieldCoverageConfig, seconds: float, tried: Sequence[FieldOutcome]) -> StudyReport:
    """A line of each kind."""
    seeds = reported(options.objects, options.output.seed)
    caption = f"Fields of stiffness, seeds {seeds.start} to {seeds.stop - 1}; ratio, border: where the verdict is right"
    return StudyReport([Table(field_rows(tried), tuple(QUANTITIES), caption)], tried)


STUDY = Study(FieldCoverageConfig, trials, report)
