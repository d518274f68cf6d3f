"""The parameters with which another simulator repeats measured pokes: modulus, Poisson's ratio, stiffness of contact.

Gauss-Newton steps with finite differences over few runs: force is nearly proportional to the modulus. Forces, the
dented surface and, weakly, the tip's penetration into the body are compared; whether the pokes determine a parameter
follows from the derivatives of force and surface, and from what is left of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import lsq_linear

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.fit.least_squares import Noise
from deformscope.stages.poke.fitted import Score, score_of
from deformscope.stages.poke.poke_fit import SeenPoke
from deformscope.stages.simulate.slab_mesh import SlabMesh

FORCE_SD, DENT_SD, PENETRATION = 0.02, 0.03, 0.1
"""Standard deviations of a force, relative, and of the surface, as a share of the depth; a penetration, as a share of
the depth, that counts as one standard deviation: it should be small."""
NEAR_SHARE = 0.6
"""The surface within this many thicknesses of the tip is compared."""
STEPS = np.array([0.1, -0.04, 0.5])
"""Steps of log modulus or ratio, Poisson's ratio, log stiffness of contact for the derivatives: above the simulator's
noise."""
LONGEST = np.array([1.5, 0.1, 2.0])
MOST_ROUNDS, SETTLED, NOTHING = 5, 0.02, 0.01
"""Rounds of derivatives and a step; share of the error by which a step must be better for another round; an error, in
standard deviations, that is negligible."""
DETERMINED = np.array([0.1, 0.05, 0.7])
"""Standard deviations up to which a parameter is determined."""


class Stopped(Exception):
    """A run of the simulator was given up, for the time limit or a person."""


@dataclass(frozen=True, slots=True)
class TargetParameters:
    """young: Young's modulus of the first material [Pa]; poisson: Poisson's ratio; contact: stiffness of contact, in
    the target's unit; ratios: moduli of the other materials over the first one's."""

    young: float
    poisson: float
    contact: float
    ratios: tuple[float, ...] = ()

    @property
    def moduli(self) -> tuple[float, ...]:
        """Young's modulus of each material [Pa]."""
        return tuple(self.young * one for one in (1.0, *self.ratios))

    @property
    def vector(self) -> FloatArray:
        """(3 + ratios,) as they are fitted."""
        return np.array([np.log(self.young), self.poisson, np.log(self.contact), *np.log(self.ratios)])

    @classmethod
    def of(cls, vector: FloatArray) -> "TargetParameters":
        """The inverse of `vector`."""
        ratios = tuple(float(one) for one in np.exp(vector[3:]))
        return cls(float(np.exp(vector[0])), float(vector[1]), float(np.exp(vector[2])), ratios)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vector's entries."""
        return (*NAMES, *(f"ratio {one}" for one in range(1, len(self.ratios) + 1)))


NAMES = ("young", "poisson", "contact")
LOWEST, HIGHEST = (10.0, 0.0, 0.01), (1e9, 0.49, 1e3)
MOST_RATIO = 1e3
"""Bounds of the parameters; stiffness of contact relative to where the fit begins."""


@dataclass(frozen=True)
class MeasuredPoke:
    """A measured poke. name; seen: its place, tip, and surface at the greatest depth; depth, force: (n,) rising depths
    of the tip and the forces there [m, N]; material: what lies below it"""

    name: str
    seen: SeenPoke
    depth: FloatArray
    force: FloatArray
    material: int = 0


@dataclass(frozen=True)
class TargetPoke:
    """The simulator's answer. force: (n,) [N] and penetration: (n,) [m] at the depths; rest, moved: (k, 3) vertices and
    their displacement at the greatest depth [m]; step_s: seconds that a step took; how: numbers of the way to it"""

    force: FloatArray
    penetration: FloatArray
    rest: FloatArray
    moved: FloatArray
    step_s: float = 0.0
    how: dict[str, float] = field(default_factory=dict)


Press = Callable[[TargetParameters, Sequence[MeasuredPoke]], list[TargetPoke]]


@dataclass(frozen=True)
class TargetFit:
    """The fit. deviation: (3 + ratios,) standard deviations of the vector's entries; free: those that were fitted;
    errors: (r,) root mean square of the weighted residuals after each run that was better; converged: the last step
    helped little"""

    parameters: TargetParameters
    deviation: FloatArray
    free: tuple[bool, ...]
    errors: tuple[float, ...]
    converged: bool
    answers: list[TargetPoke] = field(default_factory=list)

    def determined(self, name: str) -> bool:
        """Whether the pokes determine a parameter."""
        at = self.parameters.names.index(name)
        return bool(self.free[at] and self.deviation[at] <= DETERMINED[at if at < len(NAMES) else 0])


def surface_moved(mesh: SlabMesh, poke: MeasuredPoke, answer: TargetPoke) -> FloatArray:
    """Displacement (n, 3) of the measured points in the simulator [m]; heights alone, where a camera sees no other."""
    moved = mesh.at_surface(answer.moved, poke.seen.points[:, :2])
    if poke.seen.heights_only:
        moved = mesh.at_surface(answer.moved, poke.seen.points[:, :2] - moved[:, :2]) * [0.0, 0.0, 1.0]
    return moved


def followed(mesh: SlabMesh, seen: SeenPoke) -> BoolArray:
    """(n,) points where such cells can follow the surface: at the edge of a flat tip it falls within a millimetre, and
    within a cell of it they cannot."""
    off = np.abs(seen.points[:, :2] - seen.at[:2])
    aside = np.linalg.norm(np.maximum(off - seen.tip.half, 0.0), axis=1)
    if seen.tip.shape != "flat":
        aside = np.linalg.norm(off, axis=1) - seen.tip.half[0]
    cell = max(float(np.diff(axis).max()) for axis in mesh.axes[:2])
    return np.asarray((aside <= 0.0) | (aside >= cell) | (seen.tip.shape == "sphere"))


def score_beyond_edge(mesh: SlabMesh, poke: MeasuredPoke, answer: TargetPoke) -> float:
    """Error of the surface where the cells can follow it, as a share of the depth."""
    kept, moved = followed(mesh, poke.seen), surface_moved(mesh, poke, answer)
    seen = replace(poke.seen, points=poke.seen.points[kept], moved=poke.seen.moved[kept])
    return score_of("", seen, moved[kept], None).surface_error


def target_score(mesh: SlabMesh, poke: MeasuredPoke, answer: TargetPoke, method: str) -> Score:
    """Errors on one poke: of the surface, and the largest of the forces."""
    found = score_of(method, poke.seen, surface_moved(mesh, poke, answer), float(answer.force[-1]))
    off = answer.force / poke.force - 1.0
    return replace(found, force_error=float(off[np.abs(off).argmax()]))


def fit_target(
    mesh: SlabMesh,
    pokes: Sequence[MeasuredPoke],
    press: Press,
    start: TargetParameters,
    free: tuple[bool, ...],
    note: Callable[[int, int], None] = lambda done, total: None,
) -> TargetFit:
    """The parameters with the least squares, from `start`. free: which of them are fitted; note: called with the runs
    done and the most. `press` may raise `Stopped`: then the best so far is the result."""
    open_ = np.flatnonzero(free)
    others = len(start.ratios)
    low, high = (
        TargetParameters(one[0], one[1], one[2] * start.contact, (share,) * others).vector
        for one, share in ((LOWEST, 1.0 / MOST_RATIO), (HIGHEST, MOST_RATIO))
    )
    steps, longest = (np.append(one, np.repeat(one[:1], others)) for one in (STEPS, LONGEST))
    at, deviation = start.vector, np.full(len(low), np.inf)
    total, done = MOST_ROUNDS * (len(open_) + 1) + 1, 0
    near = [_near(poke.seen, mesh.size[2]) & followed(mesh, poke.seen) for poke in pokes]
    errors: list[float] = []

    def run(vector: FloatArray) -> _Run:
        nonlocal done
        answers = press(TargetParameters.of(vector) if errors else start, pokes)  # the caller may know those of start
        done += 1
        note(done, total)
        return _Run(answers, *_residuals(mesh, pokes, near, answers))

    best = run(at)
    errors.append(best.rms)
    converged, damping, jacobian = False, 1e-3, None
    try:
        for _ in range(MOST_ROUNDS):
            ahead = np.where((at + steps > high) | (at + steps < low), -steps, steps)
            slopes = [(run(at + ahead * (np.arange(len(at)) == one)).every - best.every) / ahead[one] for one in open_]
            jacobian = np.stack(slopes, axis=1)
            # the best step of those that are allowed: a longer one cut short has lost its balance of modulus and ratio
            held = np.diag(np.sqrt(damping * np.sum(jacobian**2, axis=0) + 1e-9))
            room = np.maximum(low - at, -longest)[open_], np.minimum(high - at, longest)[open_]
            wanted = -np.append(best.every, np.zeros(len(held)))
            trial = at.copy()
            trial[open_] += lsq_linear(np.vstack([jacobian, held]), wanted, room, "bvls").x
            tried = run(trial)
            if tried.rms >= best.rms:
                damping *= 30.0
                if converged := damping > 1.0:
                    break
                continue
            converged = tried.rms > (1.0 - SETTLED) * best.rms or tried.rms < NOTHING
            at, best, damping = trial, tried, 0.3 * damping
            errors.append(best.rms)
            if converged:
                break
    except Stopped:
        pass
    if jacobian is not None:
        # by what is left of forces and of surfaces, each at least as stated. A poke's force is one number, and its
        # surface, whose points err together, another
        noise = [max(1.0, float(np.sqrt(one @ one / max(len(pokes) - 1, 1)))) for one in (best.force, best.dent)]
        sd = np.repeat(noise, [len(best.force), len(best.dent)])
        known = jacobian[: len(sd)] / sd[:, None]
        deviation[open_] = np.sqrt(np.diag(Noise(1.0, np.zeros((0, len(sd)))).covariance(known)))
    return TargetFit(TargetParameters.of(at), deviation, free, tuple(errors), converged, best.answers)


@dataclass(frozen=True)
class _Run:
    """The answers, and what they differ by in standard deviations: forces, surfaces, penetrations."""

    answers: list[TargetPoke]
    force: FloatArray
    dent: FloatArray
    inside: FloatArray

    @property
    def every(self) -> FloatArray:
        return np.concatenate([self.force, self.dent, self.inside])

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.every**2)))


def _near(seen: SeenPoke, thickness: float) -> BoolArray:
    """(n,) points that are compared, by their distance from the tip."""
    away = np.linalg.norm(np.maximum(np.abs(seen.points[:, :2] - seen.at[:2]) - seen.tip.half, 0.0), axis=1)
    return np.asarray(away <= NEAR_SHARE * thickness)


def _residuals(
    mesh: SlabMesh, pokes: Sequence[MeasuredPoke], near: Sequence[BoolArray], answers: Sequence[TargetPoke]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Differences of forces and surfaces, and penetrations, in standard deviations; all pokes count equally."""
    forces, dents, inside = [], [], []
    for poke, used, answer in zip(pokes, near, answers, strict=True):
        force = np.log(np.maximum(answer.force, 1e-6 * poke.force) / poke.force) / FORCE_SD
        off = (surface_moved(mesh, poke, answer) - poke.seen.moved)[used] / (DENT_SD * poke.seen.depth)
        forces.append(force / np.sqrt(len(force)))
        dents.append(off.ravel() / np.sqrt(max(len(off), 1)))
        inside.append(answer.penetration / (PENETRATION * poke.depth) / np.sqrt(len(poke.depth)))
    return np.concatenate(forces), np.concatenate(dents), np.concatenate(inside)
