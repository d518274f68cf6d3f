"""A surface out of a depth camera's points: a sparse Gaussian process with its hyper-parameters, and an exact one."""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from deformscope.arrays import FloatArray
from deformscope.bench.plan import BenchPlan, Note
from deformscope.bench.timing import OURS, Contestant, TimingRow, clock, compare
from deformscope.stages.map.surface import HeightProcess, fit_surface
from deformscope.stages.regions.touches import MapGrid
from studies.engines.memory import Meter

POINTS, QUICK_POINTS = 12_000, 3000
SIZE_M = (0.6, 0.4)
HOLE_M, HOLE_RADIUS_M = (0.35, 0.2), 0.06
"""Places without camera points: the estimate there must be as exact."""
NOISE_M, BUMPS_M, LENGTH_M = 1.5e-3, 8e-3, 0.06
ASKED_M, MAP_M = 0.02, 0.005
BYTES = 8


def surface(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """Fit and map of one cloud; for comparison the exact process at places 2 cm apart, with the same
    hyper-parameters."""
    count = QUICK_POINTS if plan.quick else POINTS
    what = f"surface from {count:,} points".replace(",", " ")
    note(f"surface: {what}")
    points = _cloud(count)
    maps = MapGrid(SIZE_M, MAP_M)
    asked = MapGrid(SIZE_M, ASKED_M).centres_m
    kept: dict[str, HeightProcess] = {}
    exact: dict[str, tuple[FloatArray, FloatArray]] = {}

    def ours() -> None:
        kept["surface"] = fit_surface(points)
        kept["surface"].on(maps)

    def whole() -> None:
        fitted = kept["surface"]
        exact["believed"] = _exact(fitted, points, asked)

    def found() -> Mapping[str, object]:
        meter = Meter("cpu")
        ours()
        facts: dict[str, object] = {"peak_bytes": meter.peak()}
        if "believed" in exact:
            mean, deviation = exact["believed"]
            believed = kept["surface"].at(asked)
            facts["from_exact_m"] = float(np.abs(believed.mean - mean).max())
            facts["deviation_from_exact"] = float(np.abs(believed.deviation / deviation - 1.0).max())
        return facts

    sparse = Contestant(what, f"{OURS}, learned and mapped", partial(clock, ours), found=found)
    given = "hyper-parameters given to it; places 2 cm apart"
    dense = Contestant(what, "exact process (LAPACK)", partial(clock, whole), beside=sparse, note=given)
    yield from compare("surface", [sparse, dense] if _fits(count) else [sparse], plan.rounds)


def _cloud(count: int) -> FloatArray:
    """(count, 3) places of a wavy surface with noise and a hole, the same every time."""
    random = np.random.default_rng(12)
    places = random.uniform(size=(3 * count, 2)) * SIZE_M
    places = places[np.hypot(*(places - HOLE_M).T) > HOLE_RADIUS_M][:count]
    wave = random.normal(size=(2, 300)) / LENGTH_M
    heights = BUMPS_M * np.sqrt(2 / 300) * np.cos(places @ wave + random.uniform(0.0, 2.0 * np.pi, 300)).sum(axis=1)
    return np.column_stack([places, heights + NOISE_M * random.normal(size=count)])


def _exact(surface: HeightProcess, points: FloatArray, asked: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and deviation by Thesis eq. 4.3 and 4.4."""
    places = points[:, :2]
    factor = cho_factor(surface.kernel.between(places, places) + np.diag(surface.noise_m**2), overwrite_a=True)
    across = surface.kernel.between(places, asked)
    mean = surface.level_m + across.T @ cho_solve(factor, points[:, 2] - surface.level_m)
    variance = surface.kernel.sigma_e**2 - np.sum(across * cho_solve(factor, across), axis=0)
    return mean, np.sqrt(variance)


def _fits(count: int) -> bool:
    """Whether the exact process has the memory: three matrices of all points against all."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return False
    free = [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable")]
    return bool(free) and 4 * BYTES * count**2 < free[0]
