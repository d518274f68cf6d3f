"""Random slabs, 24 pokes of each: halves, a stiff or a soft disc, a gradual change, or one material."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.lab.slab import Slab

SlabKind = Literal["one material", "halves", "stiff disc", "soft disc", "gradual"]
KINDS: tuple[SlabKind, ...] = get_args(SlabKind)
Split = Literal["alternate", "random"]
PokeGroup = Literal["in one material", "near a border", "on the inclusion"]

SIZE = (0.4, 0.3, 0.05)
POISSON = 0.3
GRID, MARGIN, JITTER = (6, 4), 0.035, 0.012
"""Pokes along x and y, how far the outermost are from the slab's sides, and by how much each may be off [m]."""

SOFT, STIFF = 20e3, (70e3, 120e3)
HALVES = (20e3, 80e3)
RADIUS = (0.07, 0.095)
LEAST_SEEN = 3
"""Least number of fitted pokes, and of unseen ones, within an inclusion: untouched material cannot be predicted."""

BORDER = 0.02
"""Distance from a border within which a poke counts as near it: its contact covers both materials [m]."""


@dataclass(frozen=True, slots=True)
class PokedSlab:
    """A slab and the places of its pokes.

    normal, middle: (2,) normal and middle of the border of halves, or the direction of a gradual change; middle,
    radius: middle and radius of a disc; modulus: (2,) [Pa] where `inside` is negative and positive; places: (24, 2)
    [m]; fitted: (24,) whether each poke is fitted; the others are unseen"""

    kind: SlabKind
    seed: int
    normal: FloatArray
    middle: FloatArray
    radius: float
    modulus: tuple[float, float]
    places: FloatArray
    fitted: BoolArray

    def inside(self, place: FloatArray) -> FloatArray:
        """Signed distance (...) of places (..., 2) to the border [m], above 0 within the second material."""
        if self.kind == "one material":
            return np.full(place.shape[:-1], -np.inf)
        if "disc" in self.kind:
            return np.asarray(self.radius - np.linalg.norm(place - self.middle, axis=-1))
        return np.asarray((place - self.middle) @ self.normal)

    def young(self, place: FloatArray) -> FloatArray:
        """Young's modulus (n,) [Pa] at places (n, 2) or (n, 3)."""
        low, high = self.modulus
        inside = self.inside(place[..., :2])
        if self.kind == "gradual":
            share = np.clip(0.5 + inside / max(SIZE), 0.0, 1.0)
            return np.asarray(low * (high / low) ** share)
        return np.where(inside > 0.0, high, low)

    def slab(self, poisson: float = POISSON) -> Slab:
        return Slab(SIZE, self.young, poisson)

    def group(self, place: FloatArray) -> PokeGroup:
        """Kind of a poke at a place (2,) for this slab."""
        inside = float(self.inside(place))
        if self.kind != "gradual" and abs(inside) < BORDER:
            return "near a border"
        return "on the inclusion" if "disc" in self.kind and inside > 0.0 else "in one material"


def draw_slab(kind: SlabKind, seed: int, split: Split = "alternate") -> PokedSlab:
    """The slab of this kind and seed. split: pokes that are fitted: every other one, as on a chess board, or a random
    half"""
    rng = np.random.default_rng([seed, KINDS.index(kind), 16])
    axes = [np.linspace(MARGIN, side - MARGIN, count) for side, count in zip(SIZE, GRID, strict=False)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    every_other = (np.add.outer(*(np.arange(count) for count in GRID)).ravel() + seed) % 2 == 0
    while True:
        angle = rng.choice(4) * np.pi / 2.0 + rng.normal(0.0, np.radians(10.0))
        middle = np.asarray(SIZE[:2]) * rng.uniform(0.3, 0.7, 2)
        soft, stiff = SOFT, float(rng.uniform(*STIFF))
        modulus = {
            "one material": (2.0 * SOFT,) * 2,
            "halves": HALVES,
            "stiff disc": (soft, stiff),
            "soft disc": (stiff, soft),
            "gradual": (soft, soft * float(rng.uniform(1.5, 4.0))),
        }[kind]
        found = PokedSlab(
            kind=kind,
            seed=seed,
            normal=np.array([np.cos(angle), np.sin(angle)]),
            middle=middle,
            radius=float(rng.uniform(*RADIUS)),
            modulus=modulus,
            places=grid + rng.uniform(-JITTER, JITTER, grid.shape),
            fitted=every_other if split == "alternate" else rng.permutation(every_other),
        )
        inner = found.inside(found.places) > 0.0
        if "disc" not in kind or min((inner & found.fitted).sum(), (inner & ~found.fitted).sum()) >= LEAST_SEEN:
            return found
