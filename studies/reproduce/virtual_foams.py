"""Five virtual foams that represent those of Thesis table 3.3, each with a law of two terms (`OgdenFoam`).

A maker states density and hardness. Consequences of these, and remaining choices:

- **Hardness sets the scale.** It is the force that presses a plate of 324 cm2 into the foam by 40 % (ISO 2439). The law
  is scaled so that its uniaxial stress at 40 % is that force over that area. The plate's edge is not modelled, which
  makes every law somewhat too stiff.
- **Density sets densification.** Past its plateau the stress of open-cell foam grows as 1 / (e_D - e) with e_D = 1 -
  1.4 density / 1200 kg/m3 (of solid polyurethane; Gibson and Ashby 1997, chapter 5). A first term alone grows as 1 / (1
  - e): foam that weighs nothing. The second term, with exponent -4, adds the difference at a strain of 65 %.
- **The plateau is chosen.** Exponent a of the first term puts the plateau near Young's modulus over a: 20 is the 5 % of
  conventional foam (Gibson and Ashby), 6 an almost linear high-resilience one. Makers do not state it. Foams that are
hard for their density (28/150, 39/200) have a strong plateau, those that are soft for their density a weak one.
- **Poisson's ratio is chosen**, within the 0 to 0.3 that flexible foam shows at small strain. Makers do not state it.

Neither parameter rises or falls with hardness (rank correlations over the five foams: 0.1 and 0), so that they
introduce no trend of beta.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from deformscope.lab.plateau_world import OgdenFoam
from deformscope.lab.scenes import PLATE_M2

HARDNESS_STRAIN = 0.4
SOLID_KG_M3 = 1200.0
"""Density of the cells' polyurethane."""

DENSIFYING_EXPONENT, DENSIFIED_STRAIN = -4.0, 0.65


def uniaxial(law: OgdenFoam, stretch: float) -> tuple[float, float]:
    """Nominal stress [Pa] at a stretch along one axis, and the stretch across it that leaves no stress there."""

    def across(log_across: float) -> float:
        return float(law.derivatives(np.array([stretch, *[np.exp(log_across)] * 2]))[0][1])

    far = abs(float(np.log(stretch))) + 1e-3  # half of it would keep the volume
    lateral = float(np.exp(brentq(across, -far, far, xtol=1e-14)))
    return float(law.derivatives(np.array([stretch, lateral, lateral]))[0][0]), lateral


@dataclass(frozen=True, slots=True)
class Foam:
    """Parameters of one foam.

    density [kg/m3]; hardness: force at 40 % indentation [N]; plateau: exponent of the yielding term;
    poisson: Poisson's ratio of small strains"""

    density: float
    hardness: float
    plateau: float
    poisson: float

    @property
    def name(self) -> str:
        """Name of the foam in the thesis: density/hardness."""
        return f"{self.density:g}/{self.hardness:g}"

    def law(self) -> OgdenFoam:
        """The foam's Ogden law [Pa]."""
        most = 1.0 - 1.4 * self.density / SOLID_KG_M3
        stiffer = (1.0 - DENSIFIED_STRAIN) / (most - DENSIFIED_STRAIN)
        pressed = 1.0 - DENSIFIED_STRAIN
        weightless = uniaxial(OgdenFoam((1.0,), (self.plateau,), self.poisson), pressed)[0]

        def excess(log_weight: float) -> float:
            return uniaxial(self._shape(log_weight), pressed)[0] / weightless - stiffer

        shape = self._shape(float(brentq(excess, -30.0, 0.0, xtol=1e-12)))
        scale = -self.hardness / PLATE_M2 / uniaxial(shape, 1.0 - HARDNESS_STRAIN)[0]
        return OgdenFoam(tuple(scale * mu for mu in shape.shear), shape.exponent, shape.poisson)

    def _shape(self, log_weight: float) -> OgdenFoam:
        """The law up to its scale, with the ratio of the second term's shear modulus to the first's."""
        return OgdenFoam((1.0, math.exp(log_weight)), (self.plateau, DENSIFYING_EXPONENT), self.poisson)


FOAMS = (
    Foam(24.0, 80.0, 12.0, 0.05),
    Foam(28.0, 150.0, 20.0, 0.10),
    Foam(39.0, 120.0, 6.0, 0.25),
    Foam(39.0, 200.0, 16.0, 0.0),
    Foam(50.0, 230.0, 9.0, 0.20),
)
"""Foams in the thesis's order, from the softest to the firmest."""
