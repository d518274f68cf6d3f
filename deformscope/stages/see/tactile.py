"""Place, area and force of contacts on a tactile sensor's pads."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class TactileContact:
    """Summary of the pressures on each pad.

    center_m: (pads, 2) centre of pressure (x along the columns, y along the rows) from the outer corner of the pad's
    first texel [m], NaN without contact; area_m2: (pads,) area of the texels in contact [m^2]
    force_n: (pads,) pressure integrated over the texels in contact, normal to the pad [N]; peak_pa: (pads,) [Pa]"""

    center_m: FloatArray
    area_m2: FloatArray
    force_n: FloatArray
    peak_pa: FloatArray


def tactile_contact(
    pressure_pa: Sequence[FloatArray], texel_m: Sequence[tuple[float, float]], threshold_pa: float = 0.0
) -> TactileContact:
    """Centre of pressure, contact area and force of every pad.

    pressure_pa: one (rows, columns) array for each pad [Pa]; texel_m: (width, height) texel size of each pad's texels
    [m]; threshold_pa: texels at or below it are not in contact: the sensor's noise [Pa]. Raises InputError if pads and
    texel sizes do not match, and for pressures that are not finite."""
    if len(pressure_pa) != len(texel_m):
        raise InputError(f"a texel size for each of {len(pressure_pa)} pads", str(len(texel_m)))
    center_m = np.full((len(pressure_pa), 2), np.nan)
    area_m2, force_n, peak_pa = (np.zeros(len(pressure_pa)) for _ in range(3))
    for pad, (pressure, (width, height)) in enumerate(zip(pressure_pa, texel_m, strict=True)):
        pressure = np.asarray(pressure, dtype=np.float64)
        if not np.isfinite(pressure).all():
            raise InputError("finite pressures", f"NaN or infinity on pad {pad}")
        row, column = np.nonzero(pressure > threshold_pa)
        load = pressure[row, column]
        area_m2[pad] = len(load) * width * height
        force_n[pad] = load.sum() * width * height
        peak_pa[pad] = pressure.max(initial=0.0)
        if load.sum() > 0.0:
            center_m[pad] = (load @ (column + 0.5) * width / load.sum(), load @ (row + 0.5) * height / load.sum())
    return TactileContact(center_m, area_m2, force_n, peak_pa)
