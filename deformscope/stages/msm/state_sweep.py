"""Static states of bodies over beta or theta: effect of the two parameters (Thesis figures 3.5, 3.7 and 3.13)."""

from dataclasses import dataclass
from typing import Literal

from deformscope.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class StateSweep:
    """A lattice of particles in the plane, or one layer of one in space, seen from the side.

    over: name of the parameter; value: (n,) values of it; rest: (rows, columns, 2), position: (n, rows, columns, 2)
    [m]; held: (rows, columns) particles whose position is prescribed; measure: (n,) measure of the body (`measured`)"""

    name: str
    over: Literal["beta", "theta"]
    value: FloatArray
    rest: FloatArray
    position: FloatArray
    held: BoolArray
    measured: str
    measure: FloatArray

    def to_text(self) -> str:
        """The measured values at both ends of the parameter, as text."""
        ends = (f"{self.measure[at]:.1f} at {self.over} {self.value[at]:g}" for at in (0, -1))
        return f"{self.name}: {self.measured}: {', '.join(ends)}"


@dataclass(frozen=True, slots=True)
class StateSweeps:
    """Several sweeps, for one view."""

    sweeps: tuple[StateSweep, ...]
