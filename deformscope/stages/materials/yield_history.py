"""Histories of a body that yields, for candidates of its parameters, to compare with its recorded motion."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.calibrate import BETA_LIMIT, Model, Observation
from deformscope.stages.fit.model import explained_share, unexplained
from deformscope.stages.fit.motion import Motion
from deformscope.stages.msm.materials import Plasticity
from deformscope.stages.msm.plastic import PlasticMsm
from deformscope.stages.msm.solver import TOLERANCE

SETTLED = 3e-3
"""Share of the yield strain below which flow counts as over."""


@dataclass(frozen=True, slots=True)
class YieldOptions:
    """Known and unknown parameters.

    beta: None = fitted together with the yield strain; creep: "none" (loads act until the body rests), "fit", or a rate
    [1/s]; maximum: bound of the plastic strain; level: level of the intervals; seed: seed of the noise of held
    positions"""

    beta: float | None = None
    creep: float | str = "none"
    maximum: float = np.inf
    cluster_size: int = 3
    theta: float = 0.0
    level: float = 0.9
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.beta is not None and not 0.0 <= self.beta <= BETA_LIMIT:
            raise InputError(f"beta within 0 to {BETA_LIMIT:g}", str(self.beta))
        if isinstance(self.creep, str) and self.creep not in ("none", "fit"):
            raise InputError("creep: none, fit or a rate [1/s]", self.creep)
        if not isinstance(self.creep, str) and not self.creep > 0.0:
            raise InputError("a creep above 0", str(self.creep))


class YieldHistories:
    """Histories of candidates; coordinates are log yield, then -log(1 - beta) and log creep where they are fitted."""

    def __init__(self, motion: Motion, options: YieldOptions) -> None:
        self.motion, self.options = motion, options
        self.frames = [np.flatnonzero(held) for held in motion.held]
        first = Observation(
            rest=motion.rest,
            deformed=np.where(np.isfinite(motion.position[0]), motion.position[0], motion.rest),
            held=self.frames[0],
            observed=np.ones(len(motion.rest), dtype=bool),
            shape=motion.shape,
            cell=motion.cell,
            unit=motion.unit,
            metres_per_unit=motion.metres_per_unit,
        )
        self.model = Model(cluster_size=options.cluster_size, volume="project", device=options.device)
        self.body = self.model.body(first)
        self.judged = motion.judged
        self.observed = motion.position[self.judged].ravel()
        self.fits_beta, self.fits_creep = options.beta is None, options.creep == "fit"
        if options.creep != "none" and motion.duration is None:
            raise InputError(
                "the time between frames with creep", "none", "give `dt` [s] in the file, or leave creep out"
            )

    def numbers(self, at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Yield strain, beta and creep of candidates (B, m), (B,) each."""
        strain = np.exp(at[:, 0])
        beta = self.shrink(at[:, 1]) if self.fits_beta else np.full(len(at), self.options.beta)
        creep = np.full(len(at), np.inf if isinstance(self.options.creep, str) else self.options.creep)
        return strain, np.asarray(beta), np.exp(at[:, -1]) if self.fits_creep else creep

    def run(
        self, strain: FloatArray, beta: FloatArray, creep: FloatArray, held: list[FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """(B, T, K, d) states, NaN if one did not converge, and the largest strain of any cluster, (B,). held: for each
        frame (B, n, d), in place of the observation"""
        motion, options = self.motion, self.options
        body = PlasticMsm(self.body, Plasticity(strain, creep, options.maximum), len(strain))
        found = np.empty((len(strain), *motion.position.shape))
        largest = np.zeros(len(strain))
        for frame, index in enumerate(self.frames):
            body.hold(index)
            loaded = body.load(
                motion.position[frame, index] if held is None else held[frame],
                beta,
                options.theta,
                duration=None if options.creep == "none" or motion.duration is None else motion.duration[frame],
                settled=SETTLED,
            )
            largest = np.maximum(largest, loaded.strain.max(axis=1, initial=0.0))
            found[:, frame] = np.where(loaded.converged[:, None, None], loaded.position, np.nan)
        return found, largest

    def simulate(self, at: FloatArray) -> FloatArray:
        """(B, n) observed numbers for (B, m)."""
        return self.compared(self.run(*self.numbers(at))[0])

    def history(self, at: FloatArray) -> FloatArray:
        """(T, K, d) states of one candidate (m,)."""
        return np.asarray(self.run(*self.numbers(at[None]))[0][0])

    def compared(self, states: FloatArray) -> FloatArray:
        """(B, n) of (B, T, K, d)."""
        return np.asarray(states[:, self.judged].reshape(len(states), -1))

    def stretched(self, beta: FloatArray | float) -> FloatArray:
        """-log(1 - beta) of betas of any shape."""
        return np.asarray(-np.log1p(-np.asarray(beta)))

    def shrink(self, stretched: FloatArray | float) -> FloatArray:
        """beta of values of -log(1 - beta), any shape, at most `BETA_LIMIT`."""
        return np.asarray(np.clip(-np.expm1(-np.asarray(stretched, dtype=np.float64)), 0.0, BETA_LIMIT))

    @property
    def resolved(self) -> float:
        """The smallest difference of coordinates that numbers of this precision can resolve, in their unit."""
        return 10.0 * TOLERANCE[self.body.precision] * self.body.extent

    def prescribed(self) -> list[FloatArray]:
        """Where the prescribed particles were seen, (n, d) of each frame."""
        return [self.motion.position[frame, index] for frame, index in enumerate(self.frames)]

    def frame(self, row: int | np.int64) -> Observation:
        """Observation of one of the frames."""
        motion = self.motion
        seen = np.isfinite(motion.position[row]).all(axis=1)
        noise = None if motion.noise is None else np.full(len(seen), motion.noise)
        return Observation(
            rest=motion.rest,
            deformed=motion.position[row],
            held=self.frames[row],
            observed=seen,
            noise=noise,
            noise_source=motion.noise_source,
            shape=motion.shape,
            cell=motion.cell,
            unit=motion.unit,
            metres_per_unit=motion.metres_per_unit,
        )

    def apart(self, one: FloatArray, other: FloatArray) -> float:
        """Root mean square distance of two states (K, d) of the last frame, at its free particles."""
        free = ~self.motion.held[-1]
        return float(np.sqrt(np.mean(np.sum((one - other)[free] ** 2, axis=1))))

    def explained(self, states: FloatArray) -> float:
        """Share of the motion beyond a rigid one that states (T, K, d) explain."""
        motion = self.motion
        left = [
            unexplained(motion.rest, seen, state, judged, judged | held)
            for seen, state, judged, held in zip(motion.position, states, self.judged, motion.held, strict=True)
        ]
        return explained_share(left, self.body.extent)

    def aee(self, simulated: FloatArray) -> float:
        """Average Euclidean error of simulated coordinates (n,) over all observed particles of all frames, held ones
        included, in their unit of length."""
        d = self.motion.rest.shape[1]
        distance = np.linalg.norm((simulated - self.observed).reshape(-1, d), axis=1)
        return float(distance.sum() / np.isfinite(self.motion.position).all(axis=2).sum())
