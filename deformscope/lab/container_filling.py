"""Effect of a container's content on its walls: gas above and within it, and a resistance behind each patch of wall.

Gas: the rest of the closed container is air at one temperature. When the walls move inwards by a volume V, its pressure
over the outside becomes p0 (T / T0) Vg / (Vg - V) - p0. A liquid passes it on to every wall.

Patches: the content resists a wall that moves inwards by w with a traction q [Pa] above its value at rest. It is
elastic (q_e = k (w - w_p)) until it yields, and then flows or fails, with a viscous part (Perzyna):

    q = q_y(w_p) + N K (dw_p/dt / l)^n  while w_p grows,     q_y(w_p) = q_1 w_p / (w_p + a)

- granular: k = chi_u s / l on unloading, and the first loading (slope q_1 / a) is softer, chi_l s / l in all (EN 1991-4
  annex C: modulus = chi x stress). q_1 is the passive earth pressure K_p sigma_v + 2 c sqrt(K_p) less that at rest
  (Rankine), so that failure needs more at depth, and flour's cohesion adds to it. Unloading follows k: hysteresis. For
  flour the softer first loading is its compaction.
- yogurt: k = 3 G / l (incompressible), q_1 = N tau_y at once (a = 0), then Herschel-Bulkley's K and n.
- water: no yield, n = 1: only its viscosity, which is negligible at this speed (about 1e-3 Pa).
Here l is half the container's width along the squeeze, N = 2 + pi bears on shear (Prandtl), s the stress half way to
q_1. Unloading beyond rest is limited by the active pressure, so that no content pulls at a wall.

Not modelled: waves and inertia (rho v^2 is 1 Pa), flow of a granular filling along the container, settling between
squeezes, the shape of grains.
"""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.lab.container_constants import AIR_PRESSURE_PA, BEARING_FACTOR, GRAVITY_M_S2, ROOM_K, Content

ITERATIONS = 12
LEAST_PA = 1e-9
"""Parts with smaller yield do not."""


@dataclass(frozen=True, slots=True)
class Gas:
    """The air in a closed container. volume_m3: volume of it; warming_k: warming since it was closed"""

    volume_m3: float
    warming_k: float = 0.0

    def pressure_pa(self, squeezed_m3: float) -> tuple[float, float]:
        """Pressure above the outside's after the walls reduced the volume, and its slope [Pa/m3]."""
        left = max(self.volume_m3 - squeezed_m3, 0.05 * self.volume_m3)
        inside = AIR_PRESSURE_PA * (1.0 + self.warming_k / ROOM_K) * self.volume_m3 / left
        return inside - AIR_PRESSURE_PA, inside / left


@dataclass(frozen=True, slots=True)
class Patches:
    """The resistance behind patches of wall, (p,) each. It has elastic stiffness, greatest and least yield traction,
    plastic displacement at half of the greatest, and viscous traction at 1 m/s; and the index of the rate."""

    stiffness_pa_m: FloatArray
    most_pa: FloatArray
    least_pa: FloatArray
    half_m: FloatArray
    viscous_pa: FloatArray
    index: float

    @classmethod
    def of(cls, content: Content, depth_m: FloatArray, half_width_m: float) -> "Patches":
        """Resistance of patches (p,) at a depth below the content's surface; patches above it have none."""
        under = depth_m > 0.0
        none = np.zeros(depth_m.shape)
        if content.shear_modulus_pa > 0.0:
            rate = BEARING_FACTOR * content.consistency_pa_sn / half_width_m**content.flow_index
            most = BEARING_FACTOR * content.yield_pa * under
            stiffness = 3.0 * content.shear_modulus_pa / half_width_m * under
            return cls(stiffness, most, -most, none, rate * under, content.flow_index)
        if content.friction_deg == 0.0:
            return cls(none, none, none, none, none, 1.0)
        sine = np.sin(np.radians(content.friction_deg))
        passive = (1.0 + sine) / (1.0 - sine)
        vertical = content.density_kg_m3 * GRAVITY_M_S2 * np.maximum(depth_m, 0.0)
        rest = content.lateral_ratio * vertical
        most = (passive * vertical + 2.0 * content.cohesion_pa * np.sqrt(passive) - rest) * under
        active = np.maximum(vertical / passive - 2.0 * content.cohesion_pa / np.sqrt(passive), 0.0)
        stress = rest + 0.5 * most
        elastic = content.unload_modulus * stress / half_width_m * under
        first = content.load_modulus * stress / half_width_m
        half = np.where(under, most * (1.0 / np.maximum(first, 1e-9) - 1.0 / np.maximum(elastic, 1e-9)), 0.0)
        return cls(elastic, most, (active - rest) * under, half, none, 1.0)

    @property
    def resist(self) -> bool:
        """Whether there is any resistance."""
        return bool((self.stiffness_pa_m > 0.0).any())

    def moved(
        self, moved_m: FloatArray, traction_pa: FloatArray, plastic_m: FloatArray, step_s: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Tractions, plastic displacements and slopes [Pa/m] after walls moved inwards by `moved_m` (p,) in a step,
        from tractions and plastic displacements before it."""
        stiffness = self.stiffness_pa_m
        trial = traction_pa + stiffness * moved_m
        hardening = plastic_m / np.maximum(plastic_m + self.half_m, 1e-12)
        over = trial - (self.most_pa * np.where(self.half_m > 0.0, hardening, 1.0))
        flows = (over > LEAST_PA) & (stiffness > 0.0)
        growth, slope = np.zeros(trial.shape), stiffness.copy()
        if flows.any():
            growth[flows], slope[flows] = self._grow(flows, trial[flows], plastic_m[flows], over[flows], step_s)
        traction = trial - stiffness * growth
        low = traction < self.least_pa
        return np.where(low, self.least_pa, traction), plastic_m + growth, np.where(low, 0.0, slope)

    def _grow(
        self, at: BoolArray, trial: FloatArray, plastic_m: FloatArray, over: FloatArray, step_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Growth of the plastic displacement, and the traction's slope: Newton from below, where the residual is convex
        and falls, so that it never passes the root."""
        k, most, half, viscous = (v[at] for v in (self.stiffness_pa_m, self.most_pa, self.half_m, self.viscous_pa))
        rate = viscous / step_s**self.index
        harden = np.where(half > 0.0, most * half / np.maximum(plastic_m + half, 1e-12) ** 2, 0.0)
        x = over / (3.0 * np.maximum(k, harden))
        x = np.where(
            rate > 0.0, np.minimum(x, (over / (3.0 * np.where(rate > 0.0, rate, 1.0))) ** (1.0 / self.index)), x
        )
        falls = k
        for _ in range(ITERATIONS):
            yields = np.where(half > 0.0, most * (plastic_m + x) / np.maximum(plastic_m + x + half, 1e-12), most)
            hardens = np.where(half > 0.0, most * half / np.maximum(plastic_m + x + half, 1e-12) ** 2, 0.0)
            flow = rate * x**self.index
            falls = k + hardens + self.index * flow / x
            step = (trial - k * x - yields - flow) / falls
            x = x + step
            if (np.abs(step) <= 1e-9 * x).all():
                break
        return x, k * (1.0 - k / falls)
