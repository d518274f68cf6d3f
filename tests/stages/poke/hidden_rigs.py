"""Rigs with a hidden cause that touch layers of finite elements of the tests' own, as they would say that they did.

Shares nothing with the product: elements of `axisymmetric`, and an arm, a sensor and a clock in a few lines."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from deformscope.arrays import FloatArray
from tests.stages.poke.axisymmetric import graded, press, surface_compliance

ARM_M_PER_N = 2e-4
CAUSES = ("none", "force gain", "depth scale", "tip radius", "compliance", "clock")
LAYERS = ((1.0, 0.45), (2.0, 0.49), (4.0, 0.45), (1.5, 0.3))
"""Thickness in radii of the tip's sphere, 1 cm, and Poisson's ratio."""


@dataclass(frozen=True)
class HiddenRig:
    """gain, scale, tip: logs; give_m_per_n: beyond ARM_M_PER_N; clock_s: forces later than poses."""

    cause: str
    gain: float
    scale: float
    tip: float
    give_m_per_n: float
    clock_s: float

    @property
    def value(self) -> float:
        values = (0.0, self.gain, self.scale, self.tip, self.give_m_per_n, self.clock_s)
        return values[CAUSES.index(self.cause)]


def draw(cause: str, random: np.random.Generator) -> HiddenRig:
    """All within common tolerances, and one cause far beyond."""
    values = random.standard_normal(5) * (0.02, 0.002, 0.004, 1e-5, 0.001)
    sign = float(random.choice([-1.0, 1.0]))
    low, high = ((0.1, 0.25), (0.05, 0.12), (0.15, 0.4), (1e-4, 6e-4), (0.01, 0.04))[max(CAUSES.index(cause) - 1, 0)]
    if cause == "compliance" and sign < 0.0:  # an arm gives way, whichever
        low, high = 6e-5, 1.5e-4
    if cause != "none":
        values[CAUSES.index(cause) - 1] = sign * random.uniform(low, high)
    return HiddenRig(cause, *map(float, values))


@cache
def _layer(thickness: float, poisson: float) -> tuple[FloatArray, FloatArray]:
    r = np.append(np.arange(0.0, 0.8, 0.02), 0.8 + graded(0.02, 0.04, 12.0 + 3.0 * thickness, 1.25))
    z = thickness - graded(0.01, 0.02, thickness, 1.25)[::-1]
    return r, surface_compliance(r, z, poisson, bonded=True)


@cache
def _law(thickness: float, poisson: float, tip: float) -> tuple[FloatArray, FloatArray]:
    """Depths [m] and forces for 1 Pa [N] of a ball with that log of its radius over 1 cm."""
    r, compliance = _layer(thickness, poisson)
    depth = np.linspace(0.0, 1.0, 41) ** 1.5 * 0.4
    force = press(compliance, r**2 / 2.0 / np.exp(tip), depth[1:])
    return 1e-2 * depth, 1e-4 * np.append(0.0, force)


def touch(
    rig: HiddenRig, layer: tuple[float, float], young: float, deep_m: float, random: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Depth, force and time as the rig says, at 100 Hz: down with 4 mm/s, half a second at rest, and back."""
    depth, force = _law(*layer, rig.tip)
    force = young * force
    way = depth + (ARM_M_PER_N + rig.give_m_per_n) * force
    top, speed = float(np.interp(deep_m, depth, way)), 4e-5
    down = np.arange(-0.004, top, speed)
    path = np.concatenate([down, np.full(50, top), down[::-1]])
    time = 0.01 * np.arange(len(path))
    pressed = np.interp(time - rig.clock_s, time, np.interp(path, way, force))
    said_n = np.exp(rig.gain) * pressed + 0.01 * random.standard_normal(len(path))
    return np.exp(rig.scale) * path + 3e-5 * random.standard_normal(len(path)) + 0.3, said_n, time
