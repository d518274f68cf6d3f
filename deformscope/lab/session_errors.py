"""Hidden errors of a laboratory, drawn once for each session; the estimator does not receive them.

    errors = LabErrors().draw(seed)        # LabErrors.none() is the old, clean laboratory
    errors.arm_n_per_m, errors.gain, errors.scatter(xy_m)

The estimator has the deviations of common practice (a calibration with its interval, a force sensor's data sheet), and
never the random values.
"""

import dataclasses
import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.lab.arm_contact import ARM_DOUBT, ARM_STIFFNESS_N_M
from deformscope.lab.scenes import Scene

TOUCHES_S = 100.0
"""Time in which ten touches are made."""
HERTZ = 1.5
"""Change of log modulus for one of log stiffness at a set force, under a ball: the scatter is one of stiffness."""
WAVES = 96
"""Number of cosines in a random field."""


@dataclass(frozen=True, slots=True)
class LabErrors:
    """Differences between sessions.

    arm: deviation of the arm's compliance as a share of its calibrated value; gain: deviation of the force sensor's
    gain; drift: deviation of the gain's change in TOUCHES_S
    scatter: range of the deviation of log stiffness within one material, drawn evenly in logarithms;
    scatter_length_m: length over which it changes
    thickness: deviation of the true thickness as a share of the stated one; overshoot_m: overshoot of the arm after the
    stop, uniform from 0; friction: friction of the tip on the surface, evenly from 0; tip: deviation of the log of the
    true tip's radius over the stated one"""

    arm: float = ARM_DOUBT
    gain: float = 0.03
    drift: float = 0.01
    scatter: tuple[float, float] = (0.02, 0.10)
    scatter_length_m: float = 0.04
    thickness: float = 0.03
    overshoot_m: float = 3e-4
    friction: float = 0.3
    tip: float = 0.0

    @classmethod
    def uncertified(cls) -> "LabErrors":
        """Those of an uncertified rig: a wrong tip, an old sensor, a loose stick; on silicone."""
        return cls(arm=0.5, gain=0.12, drift=0.0, scatter=(0.003, 0.01), thickness=0.01, tip=0.1)

    @classmethod
    def none(cls) -> "LabErrors":
        """The clean laboratory, without errors beyond those that the estimator assumes."""
        return cls(0.0, 0.0, 0.0, (0.0, 0.0), 0.04, 0.0, 0.0, 0.0)

    def draw(self, seed: int | list[int]) -> "SessionErrors":
        """One session's."""
        random = np.random.default_rng(np.append(seed, 0x5E5510))
        arm, gain, drift, thickness = random.standard_normal(4)
        low, high = self.scatter
        sd = float(low * (high / low) ** random.random()) if low > 0.0 else 0.0
        return SessionErrors(
            arm_n_per_m=ARM_STIFFNESS_N_M / max(1.0 + self.arm * float(arm), 0.1),
            gain=1.0 + self.gain * float(gain),
            drift=self.drift * float(drift),
            scatter_sd=sd,
            thickness=max(1.0 + self.thickness * float(thickness), 0.5),
            overshoot_m=self.overshoot_m * float(random.random()),
            friction=self.friction * float(random.random()),
            friction_rad=float(random.uniform(0.0, 2.0 * np.pi)),
            wave_rad_m=random.standard_normal((WAVES, 2)) / self.scatter_length_m,
            phase_rad=random.uniform(0.0, 2.0 * np.pi, WAVES),
            tip=float(np.exp(self.tip * random.standard_normal())),
        )

    def plain(self) -> dict[str, Any]:
        """The fields as a dict for JSON."""
        return dataclasses.asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class SessionErrors:
    """One session's.

    arm_n_per_m: the arm's true stiffness; gain: initial ratio of measured to true force, drift: its change in
    TOUCHES_S; scatter_sd: deviation of log stiffness within a material; thickness: true over stated; overshoot_m;
    friction: sideways over normal force, towards `friction_rad`; wave_rad_m, phase_rad: (w, 2), (w,) wave and phase of
    the scatter's field; tip: true over stated radius of the tip"""

    arm_n_per_m: float
    gain: float
    drift: float
    scatter_sd: float
    thickness: float
    overshoot_m: float
    friction: float
    friction_rad: float
    wave_rad_m: FloatArray
    phase_rad: FloatArray
    tip: float = 1.0

    def scatter(self, xy_m: FloatArray) -> FloatArray:
        """(...,) log stiffness at places (..., 2) relative to its material's level: a Gaussian random field of squared
        exponential covariance, as a sum of cosines (Rahimi and Recht 2008)."""
        waves = np.cos(np.asarray(xy_m) @ self.wave_rad_m.T + self.phase_rad)
        return np.asarray(self.scatter_sd * np.sqrt(2.0 / WAVES) * waves.sum(axis=-1))

    def gain_at(self, time_s: float) -> float:
        """Ratio of measured to true force, at a time since the first touch [s]."""
        return self.gain + self.drift * time_s / TOUCHES_S

    def sensed(self, force_n: FloatArray, time_s: float) -> FloatArray:
        """(3,) output of the sensor for a force (3,) in the tip's frame [N]: its gain, without friction."""
        if not (size_n := math.sqrt(float(force_n @ force_n))):
            return self.gain_at(time_s) * force_n
        aside = self.friction * size_n * np.array([np.cos(self.friction_rad), np.sin(self.friction_rad), 0.0])
        return np.asarray(self.gain_at(time_s) * (force_n + aside))

    def slab(self, scene: Scene) -> Scene:
        """The slab with its true thickness, from which the true map is computed."""
        return dataclasses.replace(scene, thickness_m=scene.thickness_m * self.thickness)

    def foam(self, scene: Scene) -> Scene:
        """The touched slab, whose foams scatter."""
        slab = self.slab(scene)
        return dataclasses.replace(slab, _modulus=partial(self._modulus_pa, slab)) if self.scatter_sd > 0.0 else slab

    def _modulus_pa(self, slab: Scene, xy_m: FloatArray) -> FloatArray:
        return np.asarray(slab.modulus_pa(xy_m) * np.exp(HERTZ * self.scatter(xy_m)))

    def plain(self) -> dict[str, Any]:
        """The drawn values, for JSON; the scatter's field by its deviation."""
        left_out = ("wave_rad_m", "phase_rad")
        return {one.name: getattr(self, one.name) for one in dataclasses.fields(self) if one.name not in left_out}
