"""`python -m studies field`: how well one deformation determines the stiffness of each place of a body.

python -m studies field
python -m studies field --kinds "two, stretch" "three, shear" --objects 20 --json field.json
python -m studies field --independent --objects 20

Plates and slabs whose stiffness differs from place to place, by the laboratory's finite elements (`field_bodies`); and
plates that share nothing with the estimator (`independent.orthotropic_elements`). These have one material, isotropic or
not, seen by an exact or a wrong camera, and some differ from place to place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.distance import cdist
from tyro.conf import arg

from deformscope.arrays import FloatArray
from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.pictures.report import Table
from deformscope.stages.fit.model import Observation
from deformscope.stages.materials.field import fit_field
from studies.field_bodies import NOISE_REACH, NOISE_SHARES, SPACING_M, Way, Young, elastic_pair
from studies.independent.orthotropic_elements import OrthotropicLaw, isotropic, orthotropic, plate
from studies.quantities import Rate, by, of_cases
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import independent, reported

SMOOTH_M = 0.015
"""Length of the hyperbolic tangent of a smooth border."""
PLATE, SLAB = (17, 13), (11, 6, 4)


@dataclass(frozen=True, slots=True)
class FieldBody:
    """young: modulus of places (n, d) [m]; materials: how many there are, 0 = gradual; None: the seed decides; smooth:
    the modulus changes over a wide border"""

    shape: tuple[int, ...]
    way: Way
    young: Young | None
    materials: int
    stiffer: float = 1.0
    camera: bool = False
    smooth: bool = False


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

WAYS: tuple[Way, ...] = ("stretch", "shear")
INDEPENDENT_BODIES = (
    {f"orthotropic, {way}": FieldBody(PLATE, way, None, 1, stiffer=2.5) for way in WAYS}
    | {f"camera off, {way}": FieldBody(PLATE, way, None, 1, camera=True) for way in WAYS}
    | {f"one, own elements, {way}": FieldBody(PLATE, way, None, 1) for way in WAYS}
    | {f"two, own elements, {way}": FieldBody(PLATE, way, None, 2) for way in WAYS}
    | {f"gradual, own elements, {way}": FieldBody(PLATE, way, None, 0) for way in WAYS}
    | {f"smooth border, {way}": FieldBody(PLATE, way, None, 2, smooth=True) for way in WAYS}
)
"""By name: of a generator that shares nothing with the estimator. stiffer: along one direction than across it."""


def _own_young(materials: int, smooth: bool, rng: np.random.Generator) -> Young:
    """One material, two with a border across x, or a change along any direction. smooth: 10 to 90 % of the change at
    the border are within 3.3 cm"""
    ratio, border, angle = rng.uniform(3.0, 5.0), rng.uniform(0.05, 0.11), rng.uniform(0.0, np.pi)
    across = np.array([np.cos(angle), np.sin(angle)])
    if smooth:
        return lambda place: 1.0 + 0.5 * (ratio - 1.0) * (1.0 + np.tanh((place[:, 0] - border) / SMOOTH_M))
    return {
        0: lambda place: np.asarray(ratio ** (place @ across / 0.16)),
        1: lambda place: np.ones(len(place)),
        2: lambda place: np.where(place[:, 0] < border, 1.0, ratio),
    }[materials]


def _own_plate(body: FieldBody, seed: int) -> tuple[Observation, Young, OrthotropicLaw]:
    rng = np.random.default_rng([seed, 0xF1E])
    law = isotropic(float(rng.uniform(0.1, 0.45))) if body.stiffer == 1.0 else orthotropic(rng, body.stiffer)
    young = _own_young(body.materials, body.smooth, rng)
    seen = plate((body.shape[0], body.shape[1]), law, young, way=body.way, camera=body.camera, rng=rng)
    everyone = np.ones(len(seen.rest), dtype=bool)
    cell = np.arange(len(seen.rest))
    return Observation(seen.rest, seen.deformed, seen.held, everyone, shape=seen.shape, cell=cell), young, law


@dataclass(frozen=True, slots=True)
class FieldOutcome:
    """Result of one body's field.

    right: the verdict and number of materials are the true ones; ratio: stiffest over softest, over the true one
    border: distance of the farthest wrong cell from one of its assigned material [spacings], 0 = none is wrong; NaN
    without materials, or with another number; held: share of the places whose interval holds the truth; beta_ratio:
    ratio of 1 - beta, over the true ratio of stiffness; claims: places differ; reasons: to doubt it; directions: ratio
    of moduli along those that are named, over the true one, None where none are"""

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
    claims: bool = False
    reasons: tuple[str, ...] = ()
    directions: float | None = None


def try_field(case: tuple[str, int]) -> FieldOutcome:
    """Deform the body of that name under the noise of that seed, and fit it."""
    kind, seed = case
    body = (BODIES | INDEPENDENT_BODIES)[kind]
    law = None
    if body.young is None:
        seen, young_of, law = _own_plate(body, seed)
    else:
        young_of, rng = body.young, np.random.default_rng(seed)
        reach, size = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (NOISE_REACH, NOISE_SHARES))
        seen = elastic_pair(body.shape, young_of, way=body.way, noise_m=SPACING_M * size, reach=reach, seed=seed)
    found, _ = fit_field(seen)
    young = young_of(found.place)
    true = young / np.exp(np.log(young).mean())
    contrast = float(young.max() / young.min())
    one = "uniform" if body.stiffer == 1.0 else "anisotropic"
    right_name = {0: "gradual", 1: one}.get(body.materials, "materials")
    along = found.directions
    directions = None
    if law is not None and along is not None:
        directions = along.ratio * law.modulus(along.softest) / law.modulus(along.stiffest)
    right = found.verdict == right_name and max(found.materials, 0) == body.materials
    border = np.nan
    if body.materials > 1 and found.materials == body.materials and not body.smooth:
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
        claims=found.verdict in ("gradual", "materials"),
        reasons=tuple(reason.code for reason in found.reasons),
        directions=directions,
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
    independent: bool = False
    """Plates of a generator that shares nothing with the estimator, from seed 2000 + SEED on."""

    def check(self) -> None:
        if unknown := [one for one in self.kinds if one not in _known(self)]:
            raise InputError(f"--kinds of {'; '.join(_known(self))}", "; ".join(unknown))


def _known(options: FieldCoverageConfig) -> dict[str, FieldBody]:
    return INDEPENDENT_BODIES if options.independent else BODIES


def _seeds(options: FieldCoverageConfig) -> range:
    return (independent if options.independent else reported)(options.objects, options.output.seed)


def trials(options: FieldCoverageConfig) -> list[Trials[tuple[str, int], FieldOutcome]]:
    """So many bodies of each kind."""
    kinds = options.kinds or tuple(_known(options))
    return [Trials("bodies", try_field, [(kind, seed) for kind in kinds for seed in _seeds(options)])]


def _right(write: Callable[[Sequence[FieldOutcome]], str]) -> Callable[[Sequence[FieldOutcome]], str]:
    """Share of those whose verdict is right."""
    return lambda some: write(right) if (right := [one for one in some if one.right]) else "-"


def _span(values: Sequence[float | None]) -> str:
    """Least and largest of those that are known."""
    known = [one for one in values if one is not None]
    return f"{min(known):.2f} to {max(known):.2f}" if known else "-"


def _border(right: Sequence[FieldOutcome]) -> str:
    several = (BODIES | INDEPENDENT_BODIES)[right[0].kind].materials > 1
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
    "reports that places differ": lambda some: of_cases(Rate.of(one.claims for one in some)),
    "smooth-error named": lambda some: str(sum("smooth-error" in one.reasons for one in some)),
    "ratio of directions over the true one": lambda some: _span([one.directions for one in some]),
    "1 - beta over the true ratio": lambda some: f"{np.median([one.beta_ratio for one in some]):.2f}",
}
"""Columns of the table by their headings."""


def field_rows(tried: Sequence[FieldOutcome]) -> list[tuple[str, ...]]:
    """A line for each kind of body."""
    return [tuple(of(some) for of in QUANTITIES.values()) for some in by(tried, lambda one: one.kind).values()]


def report(options: FieldCoverageConfig, seconds: float, tried: Sequence[FieldOutcome]) -> StudyReport:
    """A line of each kind."""
    seeds = _seeds(options)
    caption = f"Fields of stiffness, seeds {seeds.start} to {seeds.stop - 1}; ratio, border: where the verdict is right"
    return StudyReport([Table(field_rows(tried), tuple(QUANTITIES), caption)], tried)


STUDY = Study(FieldCoverageConfig, trials, report)
