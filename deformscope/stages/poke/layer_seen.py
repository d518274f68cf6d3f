"""Thickness of the touched foam, and its source: stated, or measured from its top and the table around it.

table = find_table(points_m, size_m=(0.6, 0.4))            # None where the camera sees none
known_layer(heights_m, table, stated_m=None)                  # its thickness is None: it is not known
"""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.poke.contact import Z_90, layer_modulus

AROUND_M, MARGIN_M = 0.10, 0.02
"""The table counts between these distances from the surface, beyond its visible sides."""
WITHIN_M = 0.02
"""Points farther than this from z = 0 do not belong to the table."""
FEWEST = 100
"""Points of the table: 16 cm2, at one in each cell of 4 mm."""
UNEVEN = 0.05
"""A surface counts as level if its heights differ by less than this share of the stated thickness, and on average from
it by less than twice as much. Stiffness differs by some 2 % there, the error of the law."""


@dataclass(frozen=True, slots=True)
class TableSeen:
    """height_m: height of the table in the surface frame, as the camera saw it; sd_m: how far its points lie apart,
    tilt and unevenness included [m]"""

    height_m: float
    sd_m: float


@dataclass(frozen=True, slots=True)
class KnownLayer:
    """thickness_m: thickness of the level layer that represents the foam [m], None = not known; sd_m: its deviation [m]
    table_m: height of the table under the foam; uneven: whether the surface's shape is used"""

    thickness_m: float | None
    sd_m: float = 0.0
    table_m: float = 0.0
    uneven: bool = False


def find_table(points_m: FloatArray, size_m: tuple[float, float]) -> TableSeen | None:
    """The table, from points (n, 3) in the surface frame; None with too few of them around the surface."""
    off = np.maximum(-points_m[:, :2], points_m[:, :2] - np.asarray(size_m)).max(axis=1)
    height = points_m[(off > MARGIN_M) & (off < AROUND_M) & (np.abs(points_m[:, 2]) < WITHIN_M), 2]
    if len(height) < FEWEST:
        return None
    low, middle, high = np.quantile(height, (0.16, 0.5, 0.84))
    return TableSeen(float(middle), 0.5 * float(high - low))


def known_layer(height_m: FloatArray, table: TableSeen | None, *, stated_m: float | None) -> KnownLayer:
    """Thickness and shape of foam with surface heights (n,) [m] at possible touches. stated_m: its stated thickness, if
    any: the foam then lies at z = 0"""
    mean_m, range_m = float(height_m.mean()), float(np.ptp(height_m))
    if stated_m is not None:
        even_m = UNEVEN * stated_m
        return KnownLayer(stated_m, uneven=range_m > even_m or abs(mean_m - stated_m) > 2.0 * even_m)
    thickness_m = 0.0 if table is None else mean_m - table.height_m
    if table is None or thickness_m <= 2.0 * table.sd_m:
        return KnownLayer(None)
    return KnownLayer(thickness_m, table.sd_m, table.height_m, uneven=range_m > UNEVEN * thickness_m)


@dataclass(frozen=True, slots=True)
class LayerModulus:
    """pa: Young's modulus; interval_pa: 90 % interval, due to the stiffness and the thickness, at a known Poisson's
    ratio"""

    pa: float
    interval_pa: tuple[float, float]


def modulus_of(
    layer: KnownLayer,
    n_per_mm: float,
    interval_n_per_mm: tuple[float, float],
    *,
    force_n: float,
    radius_m: float,
    dent_m: float | None = None,
) -> LayerModulus | None:
    """Modulus of foam of this stiffness at a force, under a ball on the layer; None with an unknown thickness. dent_m:
    the dent at that force, if it was the measured quantity: then its modulus is that to the last bit"""
    if layer.thickness_m is None:
        return None

    def pa(stiffness: float, thickness_m: float) -> float:
        return layer_modulus(1e-3 * force_n / stiffness, force_n, radius_m=radius_m, thickness_m=thickness_m)

    dent_m = 1e-3 * force_n / n_per_mm if dent_m is None else dent_m
    found = layer_modulus(dent_m, force_n, radius_m=radius_m, thickness_m=layer.thickness_m)
    low, high = (float(np.log(pa(end, layer.thickness_m) / found)) for end in interval_n_per_mm)
    thicker = float(np.log(pa(n_per_mm, layer.thickness_m + layer.sd_m) / found))
    off = Z_90 * thicker
    return LayerModulus(found, (found * float(np.exp(-np.hypot(low, off))), found * float(np.exp(np.hypot(high, off)))))
