"""A body of finite elements is no shape-matching model: no beta is true of it. There the test is prediction: fitted to
one poke, do the 90 % predictive intervals hold the particles of a poke that was not seen?

Bodies: a sheet in plane stress (a thin box, one of whose faces is a plane of symmetry) or a block. They have a random
Poisson's ratio and a Young's modulus that varies by up to a factor of 7; a patch of the far side is pushed, pulled or
sheared."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.lab.elasticity import ElasticBox
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation, calibrate
from studies.field_bodies import SPACING_M, lattice
from studies.predictive import predict
from studies.random_bodies import CANDIDATES, random_dim

NOISE_M = 1e-4


@dataclass(frozen=True, slots=True)
class PokeCase:
    """One body and two pokes of it."""

    number: int
    seed: int
    level: float = 0.9


@dataclass(frozen=True, slots=True)
class UnseenPrediction:
    """Accuracy of one predicted unseen poke.

    coordinates: coordinates of its free particles; covered: covered of them within their intervals; width: median of
    these [m]; error: root mean square of predicted - true [m]; motion: motion of true - rest [m]; both a coordinate"""

    dim: int
    cluster_size: int
    coordinates: int
    covered: int
    width: float
    error: float
    motion: float


class FoamBody:
    """A random elastic body whose particles lie on a lattice; rest: (K, d) [m]; even: it has one modulus."""

    def __init__(self, rng: np.random.Generator, dim: int, *, even: bool = False) -> None:
        sides = ((5, 9), (6, 12)) if dim == 2 else ((4, 7),) * 3
        self.shape = tuple(int(rng.integers(low, high)) for low, high in sides)
        axes = [np.arange(n) * SPACING_M for n in self.shape]
        self.rest = lattice(self.shape)
        if dim == 2:  # elements of half a spacing, and as thick
            axes = [np.linspace(0.0, axis[-1], 2 * len(axis) - 1) for axis in axes]
            axes.append(np.array([0.0, 0.5 * SPACING_M]))
        contrast, wave, phase = rng.uniform(0.0, 1.0), rng.normal(0.0, 60.0, 3), rng.uniform(0.0, 6.3)
        self.box = ElasticBox(
            *axes,
            young=lambda centre: 3e4 * np.exp((0.0 if even else contrast) * np.sin(centre @ wave + phase)),
            poisson=float(rng.uniform(0.0, 0.45)),
        )

    def poke(self, rng: np.random.Generator) -> tuple[IntArray, FloatArray]:
        """A random poke: held particles (n,), and where all are then (K, d) [m]."""
        rest, box = self.rest, self.box
        dim, top = rest.shape[1], float(rest[:, 0].max())
        far = np.flatnonzero(rest[:, 0] >= top - 1e-9)
        middle, reach = rest[rng.choice(far)], SPACING_M * rng.uniform(0.8, 1.8)
        patch = far[np.linalg.norm(rest[far] - middle, axis=1) <= reach]
        move = np.zeros(dim)
        move[0] = SPACING_M * rng.uniform(0.3, 1.0) * (-1.0 if rng.random() < 0.8 else 1.0)
        move[1:] = rng.normal(0.0, 0.3 * SPACING_M, dim - 1)
        nodes = box.nodes
        pushed = box.plane(0, top) & (np.linalg.norm(nodes[:, :dim] - middle, axis=1) <= reach + 1e-9)
        held = np.zeros(nodes.shape, dtype=bool)
        held[box.plane(0, 0.0) | pushed, :dim] = True
        if dim == 2:
            held[box.plane(2, 0.0), 2] = True
        moved = np.zeros(nodes.shape)
        moved[pushed, :dim] = move
        inside = np.zeros((len(rest), 3))
        inside[:, :dim] = rest
        displacement = box.sample(box.hold(held).solve(moved).displacement, inside)[:, :dim]
        return np.concatenate([np.flatnonzero(rest[:, 0] <= 0.0), patch]), rest + displacement


def try_unseen_poke(case: PokeCase) -> UnseenPrediction:
    """Fit one poke of a random body, predict another."""
    dim = random_dim(case.number)
    rng = np.random.default_rng([case.seed, 77, case.number])
    body = FoamBody(rng, dim)
    model = Model(cluster_size=int(rng.integers(2, 5)))
    (held, shape), (other_held, other_shape) = body.poke(rng), body.poke(rng)
    seen = observe_foam(body, held, shape, rng)
    found = calibrate([seen], FitOptions(model, candidates=CANDIDATES, level=case.level))
    poke = observe_foam(body, other_held, other_shape, rng)
    predicted = predict(found, [seen], model, poke, level=case.level)
    free = poke.free_observed
    inside = (predicted.low <= poke.deformed) & (poke.deformed <= predicted.high)
    return UnseenPrediction(
        dim=dim,
        cluster_size=model.cluster_size or 0,
        coordinates=int(inside[free].size),
        covered=int(np.count_nonzero(inside[free])),
        width=float(np.median((predicted.high - predicted.low)[free])),
        error=float(np.sqrt(np.mean((predicted.position - other_shape)[free] ** 2))),
        motion=float(np.sqrt(np.mean((other_shape - body.rest)[free] ** 2))),
    )


def observe_foam(body: FoamBody, held: IntArray, deformed: FloatArray, rng: np.random.Generator) -> Observation:
    count = len(body.rest)
    return Observation(
        body.rest,
        deformed + rng.normal(0.0, NOISE_M, deformed.shape),
        held,
        np.ones(count, dtype=bool),
        noise=np.full(count, NOISE_M),
        shape=body.shape,
        cell=np.arange(count),
    )
