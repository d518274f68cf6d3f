"""Plates and slabs whose stiffness differs from place to place, by the laboratory's finite elements: how well one
deformation determines it (`calibrate field`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.distance import cdist

from deformscope.arrays import FloatArray, IntArray
from deformscope.lab.elasticity import ElasticBox
from deformscope.stages.fit.model import Observation
from deformscope.stages.materials.field import fit_field

SPACING_M = 0.01
Way = Literal["stretch", "shear"]
Young = Callable[[FloatArray], FloatArray]


def elastic_pair(
    shape: tuple[int, ...],
    young: Young,
    *,
    noise_m: float = 1e-4,
    reach: float = 1.0,
    seed: int = 0,
    way: Way = "stretch",
    poisson: float = 0.3,
    strain: float = 0.06,
) -> Observation:
    """A plate (shape of two numbers) or slab clamped at its two ends in x, which are moved apart or past each other.

    young: modulus of places (n, d) [m]; noise_m: of every coordinate, shared by neighbours (Matern 3/2) over `reach`
    spacings, held particles included. The elements are half as wide as the particles' cells, quadratic, in space.
    """
    d = len(shape)
    ends = [(n - 1) * SPACING_M for n in shape]
    fine = [np.linspace(0.0, end, 2 * n - 1) for end, n in zip(ends, shape, strict=True)]
    axes = fine if d == 3 else [*fine, np.array([0.0, 0.2 * SPACING_M])]
    box = ElasticBox(*axes, young=lambda centres: young(centres[:, :d]), poisson=poisson)
    held, moved = np.zeros((len(box.nodes), 3), dtype=bool), np.zeros((len(box.nodes), 3))
    low, high = box.plane(0, 0.0), box.plane(0, ends[0])
    held[low | high, :d] = True
    if d == 2:
        held[low & box.plane(2, 0.0), 2] = True
    moved[high, 0 if way == "stretch" else 1] = strain * ends[0]
    solved = box.hold(held).solve(moved)
    rest = np.stack(np.meshgrid(*[np.arange(n) * SPACING_M for n in shape], indexing="ij"), axis=-1).reshape(-1, d)
    inside = rest if d == 3 else np.column_stack([rest, np.full(len(rest), 0.1 * SPACING_M)])
    u = box.sample(solved.displacement, inside)[:, :d]
    force = float(np.linalg.norm(solved.force[high].sum(axis=0)))
    gap = np.sqrt(3.0) * cdist(rest, rest) / (reach * SPACING_M)
    root = np.linalg.cholesky((1.0 + gap) * np.exp(-gap) + 1e-9 * np.eye(len(rest)))
    errors = noise_m * root @ np.random.default_rng(seed).standard_normal(rest.shape)
    ends_held: IntArray = np.flatnonzero((rest[:, 0] < 1e-9) | (rest[:, 0] > ends[0] - 1e-9))
    return Observation(
        rest,
        rest + u + errors,
        ends_held,
        np.ones(len(rest), dtype=bool),
        shape=shape,
        cell=np.arange(len(rest)),
        force_n=force,
    )


# How well it is determined -------------------------------------------------------------------------------------------

PLATE, SLAB = (17, 13), (11, 6, 4)
NOISE_SHARES, NOISE_REACH = (0.005, 0.02), (0.6, 3.0)
"""Sizes and reach of the noise [spacings], even in their logarithms."""


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


def field_rows(outcomes: Sequence[FieldOutcome]) -> list[tuple[str, ...]]:
    """A line of words for each kind of body."""
    rows: list[tuple[str, ...]] = []
    for kind in dict.fromkeys(one.kind for one in outcomes):
        some = [one for one in outcomes if one.kind == kind]
        right = [one for one in some if one.right]
        ratio = np.array([one.ratio for one in right])
        several = BODIES[kind].materials > 1
        rows.append(
            (
                kind,
                f"{len(right)} of {len(some)}",
                str(sum(one.verdict == "unidentified" for one in some)),
                f"{np.mean(np.abs(ratio - 1.0) <= 0.15):.0%}" if len(right) else "-",
                f"{ratio.min():.2f} to {ratio.max():.2f}" if len(right) else "-",
                f"{np.mean([one.border < 1.0 + 1e-6 for one in right]):.0%}" if several and right else "-",
                f"{np.mean([one.covered for one in some]):.2f}, {np.mean([one.held for one in some]):.2f}",
                f"{np.median([one.beta_ratio for one in some]):.2f}",
            )
        )
    return rows
