"""Experiment 3.B: beta of five foams from images of a push, with their true motion and their force.

A flat clamp pushes five virtual foams (`studies.reproduce.virtual_foams`) by the same distance. A camera sees speckles
move; dense flow carries 7 x 15 particles; the last pose is fitted at cluster sizes 2, 4 and 5. Each fit is made four
times: from the flow and from the true positions, which shows the flow's error. Held particles are either the one below
the clamp's middle, as in the thesis, or all below the clamp. The force of the push gives the model's k."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.stats import rankdata

from deformscope.arrays import FloatArray
from deformscope.experiments.fit.whole_motion import ParticleOptions, hold_what_is_seen, observe, track
from deformscope.frames import ColorFrame
from deformscope.images import encode_png
from deformscope.recording.recorder import Recorder
from deformscope.session import run
from deformscope.stages.fit.calibrate import Calibration, FitOptions, Model, Observation, calibrate
from deformscope.stages.see.particles import ParticleGrid, Tracked, seed_grid, select_held
from deformscope_drivers.clock import Stamp
from studies.reproduce.pressed_block import Block, PressedBlock, press
from studies.reproduce.speckle import SpeckleMotion, View, film
from studies.reproduce.virtual_foams import FOAMS, Foam

Source = Literal["flow", "true"]
Held = Literal["one", "clamp"]

SOURCES: tuple[Source, ...] = ("flow", "true")
HELD: tuple[Held, ...] = ("one", "clamp")
CLUSTER_SIZES = (2, 4, 5)

PX_PER_CM = 50.0
FRAME_NS = 10 * 10**9 // 30
"""Period of the used images: the thesis uses every tenth image of 30 a second."""


BLOCK = Block(width_m=0.25, height_m=0.07, thickness_m=0.10)
"""The block, wider than the image, as in the thesis; its thickness affects only the force."""

VIEW = View(width=810, height=430, middle_px=405.0, top_px=50.0, px_per_m=100.0 * PX_PER_CM)


@dataclass(frozen=True, slots=True)
class FoamSetup:
    """The push and its images.

    depth_m: depth of the clamp at the end; images: number of images, including that at rest; noise: noise of the camera
    [grey values]"""

    foams: tuple[Foam, ...] = FOAMS
    block: Block = BLOCK
    clamp_m: float = 0.03
    depth_m: float = 0.02
    images: int = 7
    noise: float = 2.0
    element_m: float = 0.005
    view: View = VIEW
    grid: tuple[int, int] = (7, 15)
    cluster_sizes: tuple[int, ...] = CLUSTER_SIZES

    def particles(self, held: Held) -> ParticleOptions:
        """The grid over the visible part of the block, and its held particles below the clamp."""
        rows, columns = self.grid
        middle, top = self.view.middle_px, self.view.top_px
        wide, high = columns * PX_PER_CM, rows * PX_PER_CM
        footprint = self.clamp_m * self.view.px_per_m if held == "clamp" else 0.5 * PX_PER_CM
        return ParticleOptions(
            roi=(middle - 0.5 * wide, top, wide, high),
            grid=self.grid,
            held=("bottom", "contact"),
            contact=(middle - 0.5 * footprint, top, footprint, PX_PER_CM),
            px_per_cm=PX_PER_CM,
        )


@dataclass(frozen=True, slots=True)
class FoamFit:
    """One calibration of one foam; source: where its positions are from; held: the prescribed particles below the
    clamp."""

    source: Source
    held: Held
    cluster_size: int
    calibration: Calibration


@dataclass(frozen=True, slots=True)
class FoamResult:
    """One foam pushed, seen and fitted.

    depth_m, force_n: depth and force of every pose; lost: particles; error_px: (K,) distance of each particle from its
    true place in the last image, NaN if lost; noise_px: (K,) the flow's noise, standard deviation of a coordinate
    image: the last image; mask: (H, W) the foam in the first image"""

    foam: Foam
    depth_m: tuple[float, ...]
    force_n: tuple[float, ...]
    lost: int
    error_px: FloatArray
    noise_px: FloatArray
    fits: tuple[FoamFit, ...]
    image: npt.NDArray[np.uint8]

    def fit(self, source: Source, held: Held, cluster_size: int) -> Calibration:
        """One of its calibrations."""
        wanted = source, held, cluster_size
        return next(f.calibration for f in self.fits if (f.source, f.held, f.cluster_size) == wanted)

    @property
    def stiffness(self) -> float:
        """Force over depth at the end of the push [N/m]."""
        return self.force_n[-1] / self.depth_m[-1]


# One foam ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FoamCase:
    """One foam. images: folder for its images, from which those of an earlier run are removed; empty = none
    changed: its difference from `BASE`, of a `Control`"""

    foam: Foam
    setup: FoamSetup
    seed: int = 0
    images: str = ""
    changed: str = ""


def measure(case: FoamCase) -> FoamResult:
    """Push one foam, film it, follow its particles, and fit them in every combination."""
    foam, setup, seed = case.foam, case.setup, case.seed
    poses = _push(foam, setup, setup.images - 1)
    keep = _keeper(Path(case.images)) if case.images else None
    shot = film(poses, setup.block, setup.clamp_m, setup.view, noise=setup.noise, seed=seed)
    shown: list[npt.NDArray[np.uint8]] = []

    def frames() -> Iterator[ColorFrame]:
        for index, image in enumerate(shot.images()):
            shown[:] = [image]
            frame = ColorFrame(Stamp(index * FRAME_NS), index, image)
            if keep is not None:
                keep(frame)
            yield frame

    with Recorder(None) as recorder:
        grid, history = run(frames(), track(setup.particles("clamp"), shot.mask), recorder)
    true = grid.rest_px + shot.motions[-1].displacement(grid.rest_px)
    last = history[-1]
    seen = [
        (source, held, _observation(grid, last, true, source, setup.particles(held), poses[-1].force_n))
        for source in SOURCES
        for held in HELD
    ]
    return FoamResult(
        foam=foam,
        depth_m=tuple(pose.depth_m for pose in poses),
        force_n=tuple(pose.force_n for pose in poses),
        lost=int(np.count_nonzero(~last.seen)),
        error_px=np.where(last.seen, np.linalg.norm(last.position_px - true, axis=1), np.nan),
        noise_px=np.asarray(last.noise_px),
        fits=tuple(_fits(seen, setup, seed)),
        image=shown[0],
    )


def _keeper(folder: Path) -> Callable[[ColorFrame], None]:
    folder.mkdir(parents=True, exist_ok=True)
    for earlier in folder.glob("frame-*.png"):
        earlier.unlink()

    def keep(frame: ColorFrame) -> None:
        (folder / f"frame-{frame.index:02d}.png").write_bytes(encode_png(frame.image))

    return keep


def _push(foam: Foam, setup: FoamSetup, steps: int) -> list[PressedBlock]:
    depths = [setup.depth_m * (index + 1) / steps for index in range(steps)]
    return press(foam.law(), setup.block, setup.clamp_m, depths, setup.element_m)


def _observation(
    grid: ParticleGrid, last: Tracked, true: FloatArray, source: Source, particles: ParticleOptions, force_n: float
) -> Observation:
    """The last pose by the flow, or the true one, with the force on the particles held below the clamp."""
    contact = select_held(grid, ("contact",), particles.contact_rect)
    if source == "flow":
        held, _ = hold_what_is_seen(grid, last, particles.held, particles.contact_rect)
        seen = observe(grid, last, held, particles)
        return dataclasses.replace(seen, force_n=force_n, contact=np.intersect1d(contact, held))
    exact = dataclasses.replace(last, position_px=true, seen=np.ones(len(true), dtype=bool))
    seen = observe(grid, exact, select_held(grid, particles.held, particles.contact_rect), particles)
    # no noise is stated: all that is left over is the model's misfit
    return dataclasses.replace(seen, noise=None, held_measured=False, force_n=force_n, contact=contact)


def _fits(seen: Sequence[tuple[Source, Held, Observation]], setup: FoamSetup, seed: int) -> Iterator[FoamFit]:
    for source, held, observation in seen:
        for size in setup.cluster_sizes:
            found = calibrate([observation], FitOptions(Model("beta", "linear", size), seed=seed))
            yield FoamFit(source, held, size, found)


# All foams -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Trend:
    """How beta changes with hardness over the foams, for one combination.

    drop: beta of the softest less that of the firmest foam (Thesis: .04, .16, .21 at cluster sizes 2, 4, 5)
    rank_correlation: rank correlation of beta with hardness (Spearman), None if all are equal or there are only two
    foams; common: betas in every foam's interval; None = there are none, so that beta differs between foams
    told: the trend in words (a key of the JSON)"""

    source: Source
    held: Held
    cluster_size: int
    drop: float
    rank_correlation: float | None
    common: tuple[float, float] | None
    told: str


def trend(results: Sequence[FoamResult], source: Source, held: Held, cluster_size: int) -> Trend:
    """Whether beta falls with firmness, and whether the intervals support it."""
    ordered = sorted(results, key=lambda result: result.foam.hardness)
    found = [result.fit(source, held, cluster_size).estimate for result in ordered]
    value = np.array([one.least_aee[0] for one in found if one.least_aee])  # as the thesis has it
    low, high = max(one.interval[0] for one in found), min(one.interval[1] for one in found)
    correlation = rank_correlation(np.array([result.foam.hardness for result in ordered]), value)
    if low <= high:
        summary = f"no trend: any beta from {low:.2f} to {high:.2f} fits all"
    else:
        summary = format_order(value)
    common = (low, high) if low <= high else None
    return Trend(source, held, cluster_size, float(value[0] - value[-1]), correlation, common, summary)


def format_order(value: FloatArray, same: float = 0.0) -> str:
    """How values (n,) of foams change, the softest first; same: the largest difference of equal values."""
    steps = np.diff(value)
    if np.ptp(value) <= same:
        return "is the same for all"
    if (steps < 0.0).all():
        return "falls with firmness"
    return "rises with firmness" if (steps > 0.0).all() else "differs, but not in the order of firmness"


def rank_correlation(a: FloatArray, b: FloatArray) -> float | None:
    """Spearman's [-] of values (n,) and (n,); None if either does not vary, or with fewer than three."""
    if len(a) < 3:
        return None
    ranks = [rankdata(np.round(x, 6)) for x in (a, b)]
    if min(float(np.ptp(r)) for r in ranks) == 0.0:
        return None
    return float(np.corrcoef(ranks)[0, 1])


# What beta answers to ------------------------------------------------------------------------------------------------

BASE = Foam(39.0, 150.0, 12.0, 0.1)
"""A foam in the middle of the five."""

CHANGES: dict[str, tuple[float, float]] = {
    "hardness": (80.0, 230.0),
    "density": (24.0, 50.0),
    "plateau": (20.0, 6.0),
    "poisson": (0.0, 0.25),
}
"""The ends of the five foams' range, each tried alone."""


@dataclass(frozen=True, slots=True)
class Control:
    """The middle foam with one property changed: effect of the change on its true positions, and on beta from these.

    true_px: (K, 2) places of its particles"""

    changed: str
    foam: Foam
    force_n: float
    true_px: FloatArray
    fits: tuple[FoamFit, ...]

    def moved_mm(self, unchanged: "Control") -> float:
        """Root mean square distance of its particles from the unchanged foam's."""
        return float(np.sqrt(np.mean(np.sum((self.true_px - unchanged.true_px) ** 2, axis=1)))) / PX_PER_CM * 10.0


def controls(setup: FoamSetup, seed: int = 0) -> list[FoamCase]:
    """The unchanged foam first, then one property at a time."""
    tried = [("nothing", BASE)]
    tried += [(name, dataclasses.replace(BASE, **{name: value})) for name, ends in CHANGES.items() for value in ends]
    return [FoamCase(foam, setup, seed, changed=name) for name, foam in tried]


def measure_control(case: FoamCase) -> Control:
    """The push without a camera: its true positions are fitted in every combination."""
    setup, box = case.setup, case.setup.particles("clamp")
    grid = seed_grid((setup.view.height, setup.view.width), box.roi_rect, setup.grid)
    pose = _push(case.foam, setup, 3)[-1]
    true = grid.rest_px + SpeckleMotion(pose, setup.block, setup.view).displacement(grid.rest_px)
    still = Tracked(true, np.zeros(len(true)), np.ones(len(true), dtype=bool), np.zeros(len(true)))
    seen: list[tuple[Source, Held, Observation]] = [
        ("true", held, _observation(grid, still, true, "true", setup.particles(held), pose.force_n)) for held in HELD
    ]
    return Control(case.changed, case.foam, pose.force_n, true, tuple(_fits(seen, setup, case.seed)))
