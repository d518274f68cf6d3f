"""Made-up results over real frames: what a calibration would log, without computing one."""

from collections.abc import Iterator

import cv2
import numpy as np

from deformscope.frames import ColorFrame
from deformscope.session import Experiment, Step
from deformscope.stages.fit.estimate import Comparison, Curve, Estimate
from deformscope.stages.see.flow import FlowField
from deformscope.stages.see.particles import ParticleGrid, Tracked
from deformscope_drivers.clock import Stamp

ROI = (150.0, 10.0, 90.0, 300.0)
SHAPE = (22, 7)


def lattice(roi: tuple[float, float, float, float] = ROI, shape: tuple[int, int] = SHAPE) -> ParticleGrid:
    x, y, width, height = roi
    rows, columns = np.meshgrid(
        np.linspace(y, y + height, shape[0]), np.linspace(x, x + width, shape[1]), indexing="ij"
    )
    rest = np.column_stack([columns.ravel(), rows.ravel()])
    spacing = np.array([width / (shape[1] - 1), height / (shape[0] - 1)])
    return ParticleGrid(rest_px=rest, shape=shape, cell=np.arange(len(rest)), spacing_px=spacing)


def estimate(verdict: str = "identified", unit: str = "px") -> Estimate:
    beta = np.linspace(0.05, 0.99, 20)
    scale = 1.0 if unit == "px" else 1e-3
    aee = scale * (0.35 + 3.0 * (beta - 0.62) ** 2)
    return Estimate(
        parameter="beta",
        value=0.62,
        interval=(0.56, 0.69),
        level=0.9,
        bounds=(0.0, 1.0),
        verdict=verdict,  # type: ignore[arg-type]
        stiffness_verdict="unidentified",
        aee=0.35 * scale,
        aee_free=0.41 * scale,
        nearest=0.29 * scale,
        unit=unit,  # type: ignore[arg-type]
        curve=Curve(parameter=beta, aee=aee),
        converged=True,
        settings={"cluster_size": 3, "mode": "linear", "alpha": 1.0, "theta": 0.0, "noise": float("nan")},
        metres_per_unit=None if unit == "px" else 1.0,
    )


def compare(rest: np.ndarray, observed: np.ndarray, seen: np.ndarray, shape: tuple[int, int], index: int) -> Comparison:
    rng = np.random.default_rng(index)
    bend = 0.3 * index * np.sin(np.linspace(0, np.pi, shape[0]))[:, None].repeat(shape[1], axis=1).ravel()
    simulated = observed + np.column_stack([0.2 * bend, bend]) + rng.normal(0, 0.1 * index, observed.shape)
    held = np.concatenate([np.arange(shape[1]), np.arange(len(rest) - shape[1], len(rest))])
    simulated[held] = observed[held]
    return Comparison(rest=rest, observed=observed, simulated=simulated, seen=seen, held=held, unit="px")


def calibration(
    roi: tuple[float, float, float, float] = ROI, shape: tuple[int, int] = SHAPE
) -> Experiment[dict[str, float]]:
    """Yields what a beta calibration of a sequence yields; sees each frame once."""
    grid = lattice(roi, shape)
    frame = yield Step()
    assert frame is not None
    position = grid.rest_px.copy()
    seen = np.ones(len(position), dtype=np.bool_)
    tracks = [Tracked(position.copy(), np.full(len(position), 0.05), seen.copy(), np.zeros(len(position)))]
    results: tuple[object, ...] = (grid, tracks[0])
    while True:
        before = frame
        frame = yield Step(results)
        if frame is None:
            break
        flow_px = flow(before.image, frame.image)
        place = np.rint(position).astype(int)
        height, width = flow_px.shape[:2]
        position = position + flow_px[place[:, 1].clip(0, height - 1), place[:, 0].clip(0, width - 1)]
        if len(tracks) == 5:
            seen[np.array([25, 26, 80]) % len(seen)] = False
        tracks.append(Tracked(position.copy(), np.full(len(position), 0.1), seen.copy(), np.zeros(len(position))))
        results = (FlowField(flow_px), tracks[-1])
    for index, track in enumerate(tracks):
        yield Step((compare(grid.rest_px, track.position_px, track.seen, shape, index),), frame=index)
    yield Step((estimate(),))
    return {"frames": float(len(tracks))}


def flow(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    def grey(image: np.ndarray) -> np.ndarray:
        image = image if image.ndim == 2 else image[..., 0]
        return (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image

    return cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(grey(before), grey(after), None)


def frames(count: int, size: tuple[int, int] = (48, 64), depth: type = np.uint8, seed: int = 0) -> Iterator[ColorFrame]:
    """Noise frames, small and different from one another."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        image = rng.integers(0, np.iinfo(depth).max, size, dtype=depth, endpoint=True)
        yield ColorFrame(Stamp(1_000_000_007 + index * 33_333_333), index, image)


def pair_in_space() -> Comparison:
    """A volume lattice that is pushed down in the middle [m]."""
    axes = [np.linspace(0, 0.1, 9), np.linspace(0, 0.1, 9), np.linspace(-0.03, 0.0, 4)]
    rest = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    reach = np.exp(-(((rest[:, :2] - 0.05) / 0.02) ** 2).sum(axis=1)) * (1 + rest[:, 2] / 0.03)
    observed = rest - np.column_stack([0 * reach, 0 * reach, 0.012 * reach])
    simulated = rest - np.column_stack([0 * reach, 0 * reach, 0.010 * reach**1.5])
    held = np.flatnonzero(rest[:, 2] < -0.029)
    seen = rest[:, 2] > -0.025
    return Comparison(rest=rest, observed=observed, simulated=simulated, seen=seen, held=held, unit="m")


def pair_in_plane() -> Comparison:
    """A square sheet that is sheared and bulged [m]."""
    axes = [np.linspace(0, 0.1, 8), np.linspace(0, 0.1, 8)]
    rest = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    bulge = np.sin(rest[:, 1] / 0.1 * np.pi)
    observed = rest + np.column_stack([0.02 * rest[:, 1] / 0.1 + 0.004 * bulge, 0 * bulge])
    simulated = rest + np.column_stack([0.02 * rest[:, 1] / 0.1 + 0.002 * bulge, 0.001 * bulge])
    held = np.flatnonzero((rest[:, 1] < 1e-9) | (rest[:, 1] > 0.1 - 1e-9))
    return Comparison(rest, observed, simulated, np.ones(len(rest), dtype=np.bool_), held, "m")
