"""`python -m studies materials`: how often the intervals of `calibrate axes`, `yield` and `viscous` hold the truth.

python -m studies materials
python -m studies materials --kinds axes viscous slow --objects 200 --json materials.json

Deformations and motions of known materials: how often `calibrate axes`, `yield` and `viscous` hold the truth.

Random quantities of each: the material, its push, and the noise, which neighbours share over a reach.

axes: a plate of this model, pushed anywhere at its top: its betas are the model's, so that no other truth of them is
yield: a block of this model, pressed and released, that yields; beta is fitted with it
viscous: a block of finite elements, pressed, held and released, whose moduli relax in one branch (stresses that relax,
integrated here, while the fit uses their creep) and which may have a permanent set
slow: as viscous, with a branch that outlasts the record
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from scipy.spatial.distance import cdist
from tyro.conf import arg

from deformscope.arrays import FloatArray, IntArray
from deformscope.config import flags
from deformscope.experiments.fit.material_motion import recovery_of_motion
from deformscope.lab.elasticity import ElasticBox
from deformscope.pictures.report import Table
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.fit.motion import Motion
from deformscope.stages.materials.anisotropy import fit_axes
from deformscope.stages.materials.plasticity import YieldOptions, fit_yield
from deformscope.stages.materials.recovery import RecoveryEstimate
from deformscope.stages.msm import clusters
from deformscope.stages.msm.materials import AxisBeta, Plasticity
from deformscope.stages.msm.plastic import PlasticMsm
from deformscope.stages.msm.solver import Msm
from studies.field_bodies import NOISE_REACH, NOISE_SHARES, SPACING_M, lattice, shared_noise
from studies.quantities import KnownEstimate, by, counts, interval_rows, interval_table
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported

MotionKind = Literal["axes", "yield", "viscous", "slow"]
MOTION_KINDS: tuple[MotionKind, ...] = get_args(MotionKind)
PARAMETERS: dict[str, tuple[str, ...]] = {
    "axes": ("beta along x", "beta along y"),
    "yield": ("yield strain", "beta"),
} | dict.fromkeys(("viscous", "slow"), ("share that relaxes", "mean relaxation time", "share that stays"))
COMMANDS = {"slow": "viscous, one branch that outlasts the record"}
LEVEL = 0.9
PLATE, BLOCK, PAD = (6, 7), (7, 5), (7, 7, 4)
BETAS, PUSH = (0.3, 0.95), 1.5
"""Betas of plates; by how many spacings a particle of the top is moved (one deviation)."""
YIELDS, BLOCK_BETAS, DEPTH = (0.04, 0.12), (0.5, 0.9), 1.4
RELAXES, TIMES_S, SLOW_S, KEEPS = (0.1, 0.4), (0.3, 3.0), (10.0, 40.0), (0.0, 0.1)
RATE_HZ, RAMP_S, HELD_S, WATCHED_S = 12.0, 0.5, 1.5, 5.0
FINE = 40
"""Steps between two frames."""


def try_motion(case: tuple[MotionKind, int]) -> KnownEstimate:
    """Make the motion of a kind and a seed, and fit it."""
    kind, seed = case
    if kind in ("viscous", "slow"):
        return _viscous(seed, kind)
    return {"axes": _axes, "yield": _yield}[kind](seed)


def _axes(seed: int) -> KnownEstimate:
    random = np.random.default_rng([seed, MOTION_KINDS.index("axes")])
    beta = random.uniform(*BETAS, 2)
    rest = lattice(PLATE)
    low, high = _ends(rest)
    held = np.concatenate([low, random.choice(high, 2, replace=False)])
    moved = rest[held]
    moved[len(low) :] += random.normal(0.0, PUSH * SPACING_M, 2)
    everyone = np.ones(len(rest), dtype=bool)
    still = Observation(rest, rest, held, everyone, shape=PLATE, cell=np.arange(len(rest)), held_measured=True)
    deformed = Model().body(still).relax(moved, AxisBeta(beta), tolerance=1e-11).position[0]
    deformed[held] = moved
    seen = dataclasses.replace(still, deformed=deformed + _NeighbourNoise(rest, random).drawn(random))
    found = fit_axes([seen], Model(), level=LEVEL, seed=seed)
    ends = [(low, high) for low, high in found.interval.tolist()]
    estimates = zip(found.value.tolist(), ends, strict=True)
    return KnownEstimate.of("axes", ", ".join(found.verdict), beta.tolist(), estimates)


def _yield(seed: int) -> KnownEstimate:
    random = np.random.default_rng([seed, MOTION_KINDS.index("yield")])
    truth = float(random.uniform(*YIELDS)), float(random.uniform(*BLOCK_BETAS))
    rest = lattice(BLOCK)
    low, top = _ends(rest)
    pressing = np.concatenate([low, _tip(rest, top)])
    body = PlasticMsm(Msm(rest, clusters.lattice(rest, BLOCK, np.arange(len(rest)), 3), pressing), Plasticity(truth[0]))
    loads = (0.5, 1.0, 0.65, 0.3, 0.0, 0.0)
    states, held = [], np.zeros((len(loads), len(rest)), dtype=bool)
    for frame, load in enumerate(loads):
        index = pressing if load else low
        position = rest[index]
        position[len(low) :, -1] -= load * DEPTH * SPACING_M
        body.hold(index)
        states.append(body.load(position, truth[1], settled=1e-4).position[0])
        held[frame, index] = True
    errors = _NeighbourNoise(rest, random)
    motion = np.stack([state + errors.drawn(random) for state in states])
    found = fit_yield(
        Motion(rest, motion, held, None, BLOCK, np.arange(len(rest))), YieldOptions(level=LEVEL, seed=seed)
    )
    both = (found.yield_strain, found.beta)
    return KnownEstimate.of("yield", found.verdict, truth, [(one.value, one.interval) for one in both])


def _viscous(seed: int, kind: MotionKind) -> KnownEstimate:
    random = np.random.default_rng([seed, MOTION_KINDS.index(kind)])
    share, kept = float(random.uniform(*RELAXES)), float(random.choice(KEEPS))
    fastest, slowest = np.log(SLOW_S if kind == "slow" else TIMES_S)
    relax_s = float(np.exp(random.uniform(fastest, slowest)))
    rest = lattice(PAD)
    low, top = _ends(rest)
    tip = _tip(rest, top)
    box = ElasticBox(*(np.arange(n) * SPACING_M for n in PAD), young=40e3, poisson=0.2)
    fixed, push = np.zeros((len(box.nodes), 3), dtype=bool), np.zeros((len(box.nodes), 3))
    ground = box.plane(2, 0.0)
    pressed = cdist(box.nodes, rest[tip]).min(axis=1) < 1e-9
    fixed[ground | pressed] = True
    push[pressed, 2] = -DEPTH * SPACING_M
    shape_m = box.sample(box.hold(fixed).solve(push).displacement, rest)
    time_s = np.arange(0.0, RAMP_S + HELD_S + WATCHED_S, 1.0 / RATE_HZ)
    size = recovering(time_s, share, relax_s, kept)
    held = np.zeros((len(time_s), len(rest)), dtype=bool)
    held[:, low] = True
    held[time_s <= RAMP_S + HELD_S] |= np.isin(np.arange(len(rest)), tip)
    errors = _NeighbourNoise(rest, random)
    states = np.stack([rest + one * shape_m + errors.drawn(random) for one in size])
    later = slice(1, None)
    duration = np.full(len(time_s) - 1, 1.0 / RATE_HZ)
    motion = Motion(rest, states[later], held[later], duration, PAD, np.arange(len(rest)))
    found = recovery_of_motion(motion, LEVEL, seed).estimate
    assert isinstance(found, RecoveryEstimate)
    every = (found.share, found.time_s, found.set)
    estimates = [(one.value, one.interval) for one in every]
    return KnownEstimate.of(kind, found.verdict, (share, relax_s, kept), estimates)


def recovering(time_s: FloatArray, share: float, relax_s: float, kept: float) -> FloatArray:
    """(T,) share of the push at each time of a standard linear solid that is pressed, held, and released."""
    fine = np.linspace(0.0, time_s[-1], FINE * (len(time_s) - 1) + 1)
    left = float(np.exp(-fine[1] / relax_s))
    middle = share * float(np.exp(-0.5 * fine[1] / relax_s))
    strain, branch = np.zeros(len(fine)), 0.0
    for i in range(1, len(fine)):
        branch *= left
        if fine[i] <= RAMP_S + HELD_S + 1e-9:
            strain[i] = (1.0 - kept) * min(fine[i] / RAMP_S, 1.0)
        else:  # nothing touches it: the stresses cancel
            strain[i] = (middle * strain[i - 1] - branch) / (1.0 - share + middle)
        branch += middle * (strain[i] - strain[i - 1])
    return np.asarray((strain + kept * np.minimum(fine / RAMP_S, 1.0))[::FINE])


# What they are made of -----------------------------------------------------------------------------------------------


class _NeighbourNoise:
    """Noise of all coordinates that neighbours share (Matern 3/2), its size and reach drawn."""

    def __init__(self, rest: FloatArray, random: np.random.Generator) -> None:
        reach, size = (float(np.exp(random.uniform(*np.log(ends)))) for ends in (NOISE_REACH, NOISE_SHARES))
        self._root, self._d = size * SPACING_M * shared_noise(rest, reach), rest.shape[1]

    def drawn(self, random: np.random.Generator) -> FloatArray:
        """(K, d)"""
        return np.asarray(self._root @ random.standard_normal((len(self._root), self._d)))


def _ends(rest: FloatArray) -> tuple[IntArray, IntArray]:
    """Particles of the lowest layer, and of the highest."""
    height = rest[:, -1]
    return np.flatnonzero(height < 1e-9), np.flatnonzero(height > height.max() - 1e-9)


def _tip(rest: FloatArray, top: IntArray) -> IntArray:
    """Particles of the top that are pressed: those in its middle."""
    middle = rest[:, :-1].max(axis=0) / 2.0
    return np.asarray(top[np.linalg.norm(rest[top][:, :-1] - middle, axis=1) <= 1.01 * SPACING_M])


# The study -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class MaterialsCoverageConfig(StudyOptions):
    """Count how often the intervals of `calibrate axes`, `yield` and `viscous` hold the truth: deformations and motions
    of known materials, under noise that neighbours share."""

    kinds: Annotated[tuple[MotionKind, ...], arg(metavar="NAME...")] = ()
    """Kinds out of axes, yield, viscous and slow; default: all."""
    objects: flags.ManyFlag = 12
    """Motions of each kind, from seed SEED on; one to yield takes some 5 s, another less than one."""


def trials(options: MaterialsCoverageConfig) -> list[Trials[tuple[MotionKind, int], KnownEstimate]]:
    """So many motions of each kind."""
    seeds = reported(options.objects, options.output.seed)
    return [Trials("motions", try_motion, [(kind, seed) for kind in options.kinds or MOTION_KINDS for seed in seeds])]


def report(options: MaterialsCoverageConfig, seconds: float, tried: Sequence[KnownEstimate]) -> StudyReport:
    """A table of each kind, and the verdicts."""
    kinds = by(tried, lambda one: one.kind)
    lines = {kind: interval_rows(some, PARAMETERS[kind]) for kind, some in kinds.items()}
    verdicts = {kind: counts(one.verdict for one in some) for kind, some in kinds.items()}
    tables = [interval_table(some, "motions", f"calibrate {COMMANDS.get(kind, kind)}") for kind, some in lines.items()]
    taken = [(kind, "; ".join(f"{name}: {count}" for name, count in some.items())) for kind, some in verdicts.items()]
    tables.append(Table(taken, ("motions of", "verdicts"), "verdicts by kind"))
    return StudyReport(tables, {kind: {"rows": lines[kind], "verdicts": verdicts[kind]} for kind in kinds})


STUDY = Study(MaterialsCoverageConfig, trials, report)
