"""A recorded motion: positions of particles in each frame, and which of them were prescribed."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.estimate import LengthUnit, NoiseSource


@dataclass(frozen=True, slots=True)
class Motion:
    """A recorded motion.

    rest: (K, d) positions before any load; position: (T, K, d) positions at each frame [unit of rest]; NaN where a
    particle was not seen; held: (T, K) particles whose position is prescribed in a frame
    duration: (T,) [s] from each frame to the next (the last: as long as the one before); None: not known
    shape, cell: the particles' lattice, None without one
    noise: standard deviation of a coordinate; None: from the residuals; noise_source: where it is known from
    unit, metres_per_unit: unit and scale of positions; None: not known"""

    rest: FloatArray
    position: FloatArray
    held: BoolArray
    duration: FloatArray | None = None
    shape: tuple[int, ...] | None = None
    cell: IntArray | None = None
    noise: float | None = None
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0
    noise_source: NoiseSource = "given"

    def __post_init__(self) -> None:
        if self.position.ndim != 3 or self.position.shape[1:] != self.rest.shape or not len(self.position):
            wanted = f"positions of shape (T, {', '.join(map(str, self.rest.shape))})"
            raise InputError(wanted, str(self.position.shape))
        if self.held.shape != self.position.shape[:2]:
            raise InputError(f"held of shape {self.position.shape[:2]}", str(self.held.shape))
        if not np.isfinite(self.position[self.held]).all():
            raise InputError("finite positions of the held particles", "NaN or infinity", "hold fewer particles")
        if not self.held.any(axis=1).all():
            raise InputError("held particles in every frame", "a frame without", "hold the fixed part")
        if not self.judged.any():
            raise InputError("free particles that were observed", "none", "hold fewer particles")
        if (some := self.duration) is not None and (some.shape != (len(self.position),) or not (some > 0.0).all()):
            raise InputError("a positive duration for each frame", str(self.duration))

    @property
    def judged(self) -> BoolArray:
        """(T, K) particles by which the fit is judged."""
        return np.asarray(~self.held & np.isfinite(self.position).all(axis=2))
