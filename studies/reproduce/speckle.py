"""A camera's view of a pressed foam: speckles that move with the finite elements.

The image is made backwards: for each pixel, the rest position of its point (Newton's method on the true motion, a
bicubic spline of the finite element displacement). The speckles there, also a spline, are averaged over the pixel.
Therefore the rendering adds no displacement, which would appear as motion.

Foam that bulges around the clamp would overlap the clamp's side by about a millimetre, as the finite elements have no
contact there. The clamp is drawn in front.

Image axes: x to the right, y down; whole numbers are pixels' middles [px]."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline

from deformscope.arrays import BoolArray, FloatArray
from studies.reproduce.pressed_block import Block, PressedBlock

SPECKLE_PX = 1.5
"""Standard deviation of the blur that makes white noise speckles: they are about 5 px across."""

FOAM_GREY, FOAM_CONTRAST = 130.0, 34.0
BEHIND_GREY, GROUND_GREY, CLAMP_GREY, STILL_CONTRAST = 55.0, 85.0, 190.0, 8.0

KNOT_PX = 5
"""Distance of the places where the finite element displacement is computed [px]."""

INVERSE_TOLERANCE_PX = 1e-4
EDGE_FINENESS = 8
"""Parts of a pixel along each axis, for computing the share of it inside the outline."""


@dataclass(frozen=True, slots=True)
class View:
    """View of the camera: width x height [px], the block's middle at column `middle_px`, its top in row `top_px`."""

    width: int
    height: int
    middle_px: float
    top_px: float
    px_per_m: float

    def in_metres(self, place: FloatArray, block: Block) -> FloatArray:
        """Image positions (k, 2) as positions in the block's frame [m]: x from its middle, y up from the ground."""
        x, y = np.asarray(place, dtype=np.float64).T
        return np.column_stack(
            [(x - self.middle_px) / self.px_per_m, block.height_m - (y - self.top_px) / self.px_per_m]
        )


class SpeckleMotion:
    """The true motion of one pose in the image: the place of each point of the foam at rest."""

    def __init__(self, pressed: PressedBlock | None, block: Block, view: View) -> None:
        reach = 40  # the surroundings that are pushed into the view
        ground = view.top_px + block.height_m * view.px_per_m
        columns = np.arange(-reach, view.width + reach + KNOT_PX, KNOT_PX, dtype=np.float64)
        rows = np.linspace(view.top_px, ground, max(4, round((ground - view.top_px) / KNOT_PX)) + 1)
        place = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        moved = np.zeros_like(place)
        if pressed is not None:
            moved = pressed.at(view.in_metres(place, block)) * view.px_per_m * np.array([1.0, -1.0])
        self._spline = [RectBivariateSpline(rows, columns, axis.reshape(len(rows), -1)) for axis in moved.T]
        self._low = np.array([columns[0], rows[0]])
        self._high = np.array([columns[-1], rows[-1]])
        grids = [axis.reshape(len(rows), len(columns)) for axis in moved.T]
        self._slopes = [slope for grid in grids for slope in np.gradient(grid, rows, columns)]  # x by y, x by x, y...
        self._knot = np.array([KNOT_PX, rows[1] - rows[0]])
        self.depth_px = 0.0 if pressed is None else pressed.depth_m * view.px_per_m

    def displacement(self, rest: FloatArray) -> FloatArray:
        """Displacements (k, 2) [px] of points (k, 2) at rest; beyond the foam, that of its nearest point."""
        x, y = np.clip(rest, self._low, self._high).T
        return np.column_stack([spline.ev(y, x) for spline in self._spline])

    def rest_of(self, place: FloatArray, start: FloatArray) -> FloatArray:
        """Rest positions of the points now seen at (k, 2), from a guess."""
        rest = start.copy()
        left = np.arange(len(rest))
        for _ in range(30):
            off = place[left] - rest[left] - self.displacement(rest[left])
            # Newton's step, its slopes only interpolated: that costs a step more and saves most of each
            at = ((np.clip(rest[left], self._low, self._high) - self._low) / self._knot)[:, ::-1].T
            uxy, uxx, uyy, uyx = (ndimage.map_coordinates(slope, at, order=1, mode="nearest") for slope in self._slopes)
            a, b, c, d = 1.0 + uxx, uxy, uyx, 1.0 + uyy
            step = np.column_stack([d * off[:, 0] - b * off[:, 1], a * off[:, 1] - c * off[:, 0]])
            rest[left] += step / np.maximum(a * d - b * c, 0.1)[:, None]
            left = left[np.abs(off).max(axis=1) > INVERSE_TOLERANCE_PX]
            if left.size == 0:
                break
        return rest

    def surface(self, view: View) -> FloatArray:
        """The foam's present upper outline, (k, 2) [px], from left to right."""
        x = np.arange(self._low[0], self._high[0])
        rest = np.column_stack([x, np.full_like(x, view.top_px)])
        return np.asarray(rest + self.displacement(rest))


@dataclass(frozen=True, slots=True)
class Film:
    """A push as a camera records it.

    mask: (H, W) True where the foam is in the first image; motions: the true motion at each image; images: functions
    that make each (H, W) uint8 image on demand"""

    mask: BoolArray
    motions: tuple[SpeckleMotion, ...]
    images: Callable[[], Iterator[npt.NDArray[np.uint8]]]


def film(
    poses: Sequence[PressedBlock], block: Block, clamp_m: float, view: View, *, noise: float = 2.0, seed: int = 0
) -> Film:
    """The block at rest and at each pose under a clamp `clamp_m` wide, with camera noise of `noise` grey values."""
    motions = (SpeckleMotion(None, block, view), *(SpeckleMotion(pose, block, view) for pose in poses))
    scene = _Scene(block, clamp_m, view, seed)

    def images() -> Iterator[npt.NDArray[np.uint8]]:
        rng = np.random.default_rng([seed, 1])
        rest = scene.pixels
        for motion in motions:
            shade, rest = scene.render(motion, rest)
            noisy = shade + noise * rng.standard_normal(shade.shape)
            yield np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    return Film(scene.foam_share(motions[0]) > 0.5, motions, images)


class _Scene:
    """Foam, ground, clamp and background, each with its speckles."""

    def __init__(self, block: Block, clamp_m: float, view: View, seed: int) -> None:
        self.view = view
        self.ground_px = view.top_px + block.height_m * view.px_per_m
        self.clamp_px = clamp_m * view.px_per_m
        rng = np.random.default_rng([seed, 0])
        y, x = np.mgrid[: view.height, : view.width]
        self.pixels: FloatArray = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
        self.margin = 60
        self.foam = _speckles((view.height + 2 * self.margin, view.width + 2 * self.margin), rng)
        still = cv2.GaussianBlur(rng.standard_normal((view.height, view.width)), (0, 0), 2.0)
        still *= STILL_CONTRAST / still.std()
        self.behind = np.where(y >= self.ground_px, GROUND_GREY, BEHIND_GREY) + still
        self.tool = CLAMP_GREY + still[::-1]

    def foam_share(self, motion: SpeckleMotion) -> FloatArray:
        """Share of each pixel that the foam covers, (H, W)."""
        low = [[self.view.width + 100.0, self.ground_px], [-100.0, self.ground_px]]
        return _covered(np.concatenate([motion.surface(self.view), low]), self.view)

    def render(self, motion: SpeckleMotion, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The image without noise (H, W), and the place at rest of each pixel."""
        view = self.view
        rest = motion.rest_of(self.pixels, start)
        place = rest.reshape(view.height, view.width, 2)
        by_y, by_x = np.gradient(place, axis=0), np.gradient(place, axis=1)
        shade = np.zeros((view.height, view.width))
        half = 0.5 / np.sqrt(3.0)  # the mean over a pixel by Gauss's rule of two points along each axis
        for dy in (-half, half):
            for dx in (-half, half):
                at = 2.0 * (place + dx * by_x + dy * by_y + self.margin)
                shade += 0.25 * ndimage.map_coordinates(
                    self.foam, [at[..., 1], at[..., 0]], order=3, prefilter=False, mode="mirror", output=np.float64
                )
        foam = self.foam_share(motion)
        left, right = view.middle_px - 0.5 * self.clamp_px, view.middle_px + 0.5 * self.clamp_px
        bottom = view.top_px + motion.depth_px
        tool = _covered(np.array([[left, -50.0], [right, -50.0], [right, bottom], [left, bottom]]), view)
        moved = ndimage.shift(self.tool, (motion.depth_px, 0.0), order=1, mode="mirror")
        foam = np.minimum(foam, 1.0 - tool)  # the clamp is in front; they share the pixels of their common edge
        behind = 1.0 - tool - foam
        return behind * self.behind + tool * moved + foam * (FOAM_GREY + FOAM_CONTRAST * shade), rest


def _speckles(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """Spline coefficients of a speckle pattern of unit standard deviation on a grid of half pixels, (2 H, 2 W)."""
    white = rng.standard_normal((2 * shape[0], 2 * shape[1]))
    fine = cv2.GaussianBlur(white, (0, 0), 2.0 * SPECKLE_PX)
    coarse = cv2.GaussianBlur(white[::-1], (0, 0), 4.0 * SPECKLE_PX)
    pattern = fine / fine.std() + 0.5 * coarse / coarse.std()
    return np.asarray(ndimage.spline_filter(pattern / pattern.std(), order=3, output=np.float64, mode="mirror"))


def _covered(outline: FloatArray, view: View) -> FloatArray:
    """Share of each pixel that lies within an outline (k, 2) [px], (H, W)."""
    fine = np.zeros((EDGE_FINENESS * view.height, EDGE_FINENESS * view.width), dtype=np.uint8)
    corners = np.rint(((outline + 0.5) * EDGE_FINENESS - 0.5) * 16.0).astype(np.int32)
    cv2.fillPoly(fine, [corners], 255, shift=4)
    share = cv2.resize(fine, (view.width, view.height), interpolation=cv2.INTER_AREA)
    return np.asarray(share, dtype=np.float64) / 255.0
