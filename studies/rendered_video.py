"""Videos of a pressed block whose truth is known: finite elements with texture, hand, shadow, perspective, compression.

video = render(case(2000))
write(video, Path("runs/sponge"))     # video.mp4, force.csv, truth.json

The block is a sheet in plane stress (`studies.independent.large_strain`); nothing here is shared with what is fitted.
Each image is made backwards: for each pixel the place at rest of the point that is seen there, by Newton's method on
the finite elements' own functions. The texture there, a spline without details below a pixel, is the pixel's shade.

World axes: x to the right from the block's middle, y up from its bottom [m]. Image axes: x to the right, y down, whole
numbers are pixels' middles [px]. The scene is flat: block, tool, hand, wall and table are at one distance."""

import dataclasses
import importlib
import importlib.util
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.interpolate import CubicSpline

from studies.independent.large_strain import Bools, Floats, Law, Motion, Sheet

Images = npt.NDArray[np.uint8]
Holding = Literal["tool", "plate", "clamped"]
HOLDINGS: tuple[Holding, ...] = get_args(Holding)
"""A tool on a part of the top, a plate on all of it (both: the bottom is held), or a tool on a block held at its ends.
Tool, plate, ground and clamps do not slip."""

LEVELS = 8
"""Depths at which the finite elements are balanced; between them nodes follow a cubic spline of the depth."""
CELLS = 12
"""Cells along the block's height."""
FOCAL = 0.9
"""Focal length as a share of the image's width: a phone that films."""
INVERSE_PX = 1e-4
EDGE_FINENESS = 4
"""Parts of a pixel along each axis, for computing the share of it that a thing covers."""
GRAVITY = 9.80665
RULER = (-0.0503, -0.019, 0.0503, -0.006)
"""Corners of the ruler; its marks are a centimetre apart, the first at -5 cm [m]."""


@dataclass(frozen=True, slots=True)
class LogCase:
    """How the force was read: rate [Hz], time in the log of the first image [s], deviation of a reading, step of the
    display and drift over the whole log [N], time constant of a slow display [s]; grams as a scale shows them"""

    rate_hz: float = 50.0
    offset_s: float = 0.0
    noise_n: float = 0.0
    step_n: float = 0.0
    drift_n: float = 0.0
    lag_s: float = 0.0
    unit: Literal["N", "g"] = "N"


SCALE = LogCase(rate_hz=10.0, step_n=1e-3 * GRAVITY, lag_s=0.3, unit="g")
"""A kitchen scale: it shows grams, and needs a while."""


@dataclass(frozen=True, slots=True)
class VideoCase:
    """A block, what is done to it, and how it is filmed.

    size_m: width, height, thickness along the view; tool_m, tool_at_m: width of the tool, and its middle from the
    block's; clamps: ends that are held if clamped; push: depth as a share of the height; approach_m: way of the tool
    before it touches; rest, ramp: images before the tool moves, and while it does; fill: width of the block as a share
    of the image's; shake_px: rms shift of the camera, which also turns; tilt_deg: angle between the view and the
    block's normal; shadow: share of light that a moving soft shadow takes; flicker: share of light; noise: deviation of
    a grey value; hand: whether one holds the tool; ruler: whether one of
    10 cm lies below the block; contrast: deviation of the foam's texture

    What spoils a video: pan_px: shift of the camera from the first image to the last; zoom: growth of the picture;
    turn_deg: further tilt at the last image; blur_px: deviation of a blur; exposure: gain"""

    seed: int
    holding: Holding = "tool"
    modulus_pa: float = 40e3
    poisson: float = 0.2
    law: Law = "neo-hooke"
    size_m: tuple[float, float, float] = (0.12, 0.05, 0.04)
    tool_m: float = 0.04
    tool_at_m: float = 0.0
    clamps: tuple[str, ...] = ("left", "right")
    push: float = 0.15
    approach_m: float = 0.0
    width_px: int = 640
    height_px: int = 480
    frames: int = 30
    fps: float = 30.0
    rest: int = 6
    ramp: int = 20
    fill: float = 0.6
    contrast: float = 0.2
    shake_px: float = 2.0
    tilt_deg: float = 3.0
    shadow: float = 0.3
    flicker: float = 0.01
    noise: float = 2.0
    hand: bool = True
    ruler: bool = False
    pan_px: float = 0.0
    zoom: float = 0.0
    turn_deg: float = 0.0
    blur_px: float = 0.0
    exposure: float = 1.0
    log: LogCase = field(default_factory=LogCase)


def case(seed: int, **changes: Any) -> VideoCase:
    """The case of a seed: kinds of holding in turn, all else drawn; its log is that of a load cell, or of a scale.
    changes: fields that are given instead"""
    rng = np.random.default_rng([seed, 50])
    holding = HOLDINGS[seed % len(HOLDINGS)]
    width, thickness = float(rng.uniform(0.08, 0.15)), float(rng.uniform(0.01, 0.06))
    height = float(width * rng.uniform(0.35, 0.55) if holding != "clamped" else width * rng.uniform(0.25, 0.35))
    tool = float(width * rng.uniform(0.25, 0.45))
    clamps = ("left",) if rng.random() < 0.5 else ("left", "right")
    reach = 0.5 * (width - tool)
    at = float(rng.uniform(-0.5, 0.5) * reach)
    if holding == "clamped" and len(clamps) == 1:
        at = float(rng.uniform(0.4, 0.8) * reach)
    offset, rate, lag = rng.uniform(0.0, 5.0), rng.choice([50.0, 100.0, 200.0]), rng.uniform(0.0, SCALE.lag_s)
    log = LogCase(float(rate), noise_n=2e-3)
    if rng.random() < 0.5:
        log = dataclasses.replace(SCALE, lag_s=float(lag))
    log = dataclasses.replace(log, offset_s=float(offset))
    slow: dict[str, Any] = (
        {} if "fps" in changes or log.unit == "N" else {"fps": 10.0}
    )  # whoever reads a scale presses slowly
    drawn = VideoCase(
        seed,
        holding,
        modulus_pa=float(np.exp(rng.uniform(np.log(5e3), np.log(200e3)))),
        poisson=float(rng.uniform(0.0, 0.45)),
        size_m=(width, height, thickness),
        tool_m=width if holding == "plate" else tool,
        tool_at_m=0.0 if holding == "plate" else at,
        clamps=clamps,
        push=float(rng.uniform(0.1, 0.2)),
        approach_m=float(rng.choice([0.0, 1.0]) * rng.uniform(0.001, 0.006)),
        frames=int(rng.integers(24, 41)),
        fill=float(rng.uniform(0.5, 0.65)),
        hand=bool(rng.random() < 0.7),
        log=log,
    )
    ramp: dict[str, Any] = {} if "ramp" in changes else {"ramp": (changes.get("frames", drawn.frames) * 2) // 3}
    return dataclasses.replace(drawn, **ramp, **slow, **changes)


@dataclass(frozen=True, slots=True)
class ForceLog:
    """Readings (n,) in newtons or grams at times (n,) of the log's own clock [s]."""

    time_s: Floats
    value: Floats
    unit: str


@dataclass(frozen=True, slots=True)
class RenderedVideo:
    """Images (H, W, 3) uint8, RGB, and their truth.

    depth_m, force_n: (n,) depth of the tool and its force at each image; stiffness_n_per_mm:
    the last force over the last depth;
    outline, tool: corners (k, 2) in the first image [px]; roi: rectangle x, y, width, height around the outline;
    contact: rectangle below the tool, a sixth of the block high; held: `--held` that says what is moved from outside;
    px_per_cm: at the block's middle; cameras: (n, 3, 3) world to image; motions: the block at each image"""

    case: VideoCase
    frames: list[Images]
    fps: float
    depth_m: Floats
    force_n: Floats
    outline: Floats
    tool: Floats
    roi: tuple[int, int, int, int]
    contact: tuple[int, int, int, int]
    held: tuple[str, ...]
    px_per_cm: float
    cameras: Floats
    motions: tuple[Motion, ...]
    log: ForceLog

    @property
    def modulus_pa(self) -> float:
        """Young's modulus at small strains [Pa]."""
        return self.case.modulus_pa

    @property
    def poisson(self) -> float:
        """Poisson's ratio at small strains."""
        return self.case.poisson

    @property
    def thickness_m(self) -> float:
        """Thickness along the view [m]."""
        return self.case.size_m[2]

    @property
    def stiffness_n_per_mm(self) -> float:
        """Last force over last depth [N/mm]."""
        return float(1e-3 * self.force_n[-1] / self.depth_m[-1])

    def follow(self, place: Floats) -> Floats:
        """Where points of the block at (k, 2) in the first image are in each image, (n, k, 2) [px]."""
        return followed(place, self.cameras, self.motions)


def followed(place: Floats, cameras: Floats, motions: Sequence[Motion]) -> Floats:
    """Where points of a resting block at (k, 2) in the first image are in each image, (n, k, 2) [px]."""
    rest = _through(np.linalg.inv(cameras[0]), np.asarray(place, dtype=np.float64))
    return np.stack(
        [_through(camera, rest + motion.at(rest)[0]) for camera, motion in zip(cameras, motions, strict=True)]
    )


def render(case: VideoCase) -> RenderedVideo:
    """The video of a case; the same case gives the same images."""
    down = _way(case)
    depth = np.maximum(0.0, down)
    motions, force = pressed(case, depth)
    cameras = camera_path(case)
    scene = Scene(case)
    rng = np.random.default_rng([case.seed, 51])
    frames = [
        scene.image(motion, -float(way), camera, index, rng)
        for index, (motion, way, camera) in enumerate(zip(motions, down, cameras, strict=True))
    ]
    width, height, _ = case.size_m
    low, high = case.tool_at_m - 0.5 * case.tool_m, case.tool_at_m + 0.5 * case.tool_m
    outline = _through(cameras[0], _rectangle(-0.5 * width, 0.0, 0.5 * width, height))
    return RenderedVideo(
        case,
        frames,
        case.fps,
        depth,
        force,
        outline,
        _through(cameras[0], scene.tool + np.array([0.0, -float(down[0])])),
        _around(outline),
        _around(_through(cameras[0], _rectangle(low, height * 5.0 / 6.0, high, height))),
        (*(("bottom",) if case.holding != "clamped" else case.clamps), "contact"),
        0.01 * px_per_m(case),
        cameras,
        motions,
        _read(case, depth, force),
    )


def px_per_m(case: VideoCase) -> float:
    """The scale at the block's middle [px/m]."""
    return case.fill * case.width_px / case.size_m[0]


def _way(case: VideoCase) -> Floats:
    """(n,) how far the tool is below the block's top at rest, at each image [m]: negative before it touches."""
    share = np.clip((np.arange(case.frames) - case.rest + 1) / case.ramp, 0.0, 1.0)
    eased = share * share * (3.0 - 2.0 * share)
    return eased * (case.push * case.size_m[1] + case.approach_m) - case.approach_m


def pressed(case: VideoCase, depth: Floats) -> tuple[tuple[Motion, ...], Floats]:
    """Motion of the block, and force (n,) [N], at depths (n,) [m] of the tool."""
    width, height, thickness = case.size_m
    low, high = case.tool_at_m - 0.5 * case.tool_m, case.tool_at_m + 0.5 * case.tool_m
    stops = sorted({-0.5 * width, low, high, 0.5 * width})
    stops = [one for index, one in enumerate(stops) if index == 0 or one - stops[index - 1] > 1e-9]
    parts = [np.linspace(a, b, max(2, round((b - a) / height * CELLS)) + 1)[:-1] for a, b in itertools.pairwise(stops)]
    lines = np.append(np.concatenate(parts), stops[-1])
    sheet = Sheet(lines, np.linspace(0.0, height, CELLS + 1), case.modulus_pa, case.poisson, case.law)
    place = sheet.nodes()
    touched = np.zeros(sheet.shape, dtype=np.bool_)
    touched[:, -1] = (place[:, -1, 0] > low - 1e-9) & (place[:, -1, 0] < high + 1e-9)
    held: Bools = touched.copy()
    if case.holding == "clamped":
        held[0] |= "left" in case.clamps
        held[-1] |= "right" in case.clamps
    else:
        held[:, 0] = True
    deepest = max(float(depth.max()), 1e-6)
    levels = np.linspace(0.0, deepest, LEVELS + 1)
    push = np.where(touched, -1.0, 0.0)[..., None] * np.array([0.0, 1.0])
    found, forces = sheet.deform(np.repeat(held[..., None], 2, axis=2), [level * push for level in levels[1:]])
    nodes = CubicSpline(levels, np.stack([0.0 * push, *(one.moved for one in found)]))
    carried = CubicSpline(levels, [0.0, *(-thickness * float(one[touched, 1].sum()) for one in forces)])
    motions = tuple(Motion(sheet.xs, sheet.ys, np.asarray(nodes(one))) for one in depth)
    return motions, np.asarray(carried(depth))


# The camera ----------------------------------------------------------------------------------------------------------


def camera_path(case: VideoCase) -> Floats:
    """(n, 3, 3) from places in the world (x, y, 1) [m] to images [px]."""
    rng = np.random.default_rng([case.seed, 52])
    towards = rng.uniform(0.0, 2.0 * np.pi)
    focal, scale = FOCAL * case.width_px, px_per_m(case)
    middle = np.array([0.5 * (case.width_px - 1), 0.5 * (case.height_px - 1)])
    looks = np.array([middle[0], middle[1] + 0.06 * case.height_px])  # the block is a little below the middle
    walk = _walk(case, rng)
    late = np.linspace(0.0, 1.0, case.frames)
    found = []
    for index in range(case.frames):
        angle = np.deg2rad(case.tilt_deg + case.turn_deg * late[index])
        turn, _ = cv2.Rodrigues(angle * np.array([np.cos(towards), np.sin(towards), 0.0]))
        world = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.5 * case.size_m[1]], [0.0, 0.0, 1.0]])
        plane = np.column_stack([turn[:, 0], turn[:, 1], [0.0, 0.0, focal / scale]])
        lens = np.array([[focal, 0.0, looks[0]], [0.0, focal, looks[1]], [0.0, 0.0, 1.0]])
        x, y, roll, nearer = walk[index]
        grown = (1.0 + nearer) * (1.0 + case.zoom * late[index])
        c, s = grown * np.cos(roll), grown * np.sin(roll)
        shift = np.array([x + case.pan_px * late[index], y])
        hand = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        hand[:2, 2] = middle + shift - hand[:2, :2] @ middle
        found.append(hand @ lens @ plane @ world)
    return np.stack(found)


def _walk(case: VideoCase, rng: np.random.Generator) -> Floats:
    """(n, 4) shift [px], roll [rad] and growth of the picture by a hand, from the first image on."""
    drawn = rng.standard_normal((case.frames + 80, 4))
    smooth = ndimage.gaussian_filter1d(drawn, 3.0, axis=0) + 1.5 * ndimage.gaussian_filter1d(drawn[::-1], 9.0, axis=0)
    smooth = smooth[40:-40] - smooth[40]
    shift = np.sqrt((smooth[:, :2] ** 2).sum(axis=1).mean())
    rest = np.sqrt((smooth[:, 2:] ** 2).mean(axis=0))
    rms = case.shake_px * np.array([1.0, 1.0, 1e-3, 2e-4])
    return np.asarray(smooth / np.array([shift, shift, *rest]) * rms)


def _through(camera: Floats, place: Floats) -> Floats:
    """(k, 2) places after a homography."""
    found = place @ camera[:, :2].T + camera[:, 2]
    return np.asarray(found[:, :2] / found[:, 2:])


# The scene -----------------------------------------------------------------------------------------------------------


class Scene:
    """Block, tool, hand, clamps, wall and table, each with its texture in the world."""

    def __init__(self, case: VideoCase) -> None:
        self.case = case
        rng = np.random.default_rng([case.seed, 53])
        self.scale = px_per_m(case)
        width, height, _ = case.size_m
        y, x = np.mgrid[: case.height_px, : case.width_px]
        self.pixels: Floats = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
        view = np.array([case.width_px, case.height_px]) / self.scale
        margin = 0.15 * view + 0.01
        self.foam = _Texture(rng, (-0.5 * width, 0.0), (width, height), 2.0 * self.scale, (1.1, 2.4, 5.0, 14.0), 0.25)
        corner, all_of_it = (-0.5 * view[0] - margin[0], -0.5 * view[1] - margin[1]), tuple(view + 2.0 * margin)
        self.middle = np.array([0.0, 0.5 * height])
        self.wall = _Texture(rng, corner, all_of_it, self.scale, (2.0, 6.0, 25.0))
        self.table = _Texture(rng, corner, all_of_it, self.scale, (1.5, 4.0), stretch=8.0)
        self.skin = _Texture(rng, corner, all_of_it, self.scale, (3.0, 12.0))
        self.colours = {
            "foam": np.array([[205, 180, 80], [110, 150, 190], [190, 130, 120], [150, 165, 120]])[rng.integers(4)],
            "wall": np.array([[185, 185, 180], [120, 125, 130], [90, 80, 70]])[rng.integers(3)],
            "table": np.array([[140, 105, 75], [85, 85, 90]])[rng.integers(2)],
            "tool": np.array([[70, 72, 78], [200, 60, 50], [225, 225, 220]])[rng.integers(3)],
            "hand": np.array([[196, 150, 125], [120, 82, 62]])[rng.integers(2)],
            "clamp": np.array([60, 62, 66]),
            "ruler": np.array([235, 230, 205]),
            "mark": np.array([30, 30, 30]),
        }
        low, high = case.tool_at_m - 0.5 * case.tool_m, case.tool_at_m + 0.5 * case.tool_m
        far = height + 2.0 * view[1]
        stem = min(0.5 * case.tool_m, 0.02)
        at = case.tool_at_m
        thick = 0.008
        self.tool = (
            np.array(
                [
                    [low - 0.004, height],
                    [high + 0.004, height],
                    [high + 0.004, height + thick],
                    [at + stem, height + thick],
                    [at + stem, far],
                    [at - stem, far],
                    [at - stem, height + thick],
                    [low - 0.004, height + thick],
                ]
            )
            if case.holding == "plate"
            else _rectangle(low, height, high, far)
        )
        round_ = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
        grip, reach = height + 0.012 + 0.015 * float(rng.random()), max(0.025, stem + 0.012)
        fingers = [
            np.column_stack([at + reach * np.cos(round_), grip + 0.009 * (1 + 2 * index) + 0.010 * np.sin(round_)])
            for index in range(4)
        ]
        palm = np.column_stack(
            [at + 0.02 + (reach + 0.01) * np.cos(round_), grip + 0.05 + 0.05 * np.sin(round_) * (np.sin(round_) > 0)]
        )
        self.hand = [*fingers, palm] if case.hand else []
        self.ruler = [_rectangle(*RULER)] if case.ruler else []
        marks = np.linspace(RULER[0], RULER[2], 11)
        self.marks = [_rectangle(x - 3e-4, RULER[3] - 0.005, x + 3e-4, RULER[3]) for x in marks] if case.ruler else []
        self.clamps = []
        if case.holding == "clamped":
            over = 0.15 * height
            for side in case.clamps:
                edge, out = (-0.5 * width, -1.0) if side == "left" else (0.5 * width, 1.0)
                self.clamps.append(_rectangle(edge, -over, edge + out * view[0], height + over))
        sides = np.linspace(0.0, 1.0, 200)[:-1]
        corners = _rectangle(-0.5 * width, 0.0, 0.5 * width, height)
        self.border = np.concatenate(
            [a + sides[:, None] * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        )
        self.ground = (-1.3 * float(view[0]), -1.3 * float(view[1]), 1.3 * float(view[0]), 0.0)
        self.start = np.zeros((0, 2))

    def image(self, motion: Motion, raised: float, camera: Floats, index: int, rng: np.random.Generator) -> Images:
        """The image of one moment, with noise. raised: height of the tool above the block's top at rest [m]"""
        shade = self.shades(motion, raised, camera)
        case = self.case
        late = index / max(1, case.frames - 1)
        x, y = self.pixels.T.reshape(2, case.height_px, case.width_px)
        x, y = x / case.width_px, y / case.height_px
        dark = np.exp(-(((x - 0.15 - 0.45 * late) / 0.25) ** 2) - ((y - 0.45 - 0.1 * late) / 0.45) ** 2)
        light = 1.0 + case.flicker * np.sin(2.0 * np.pi * 7.3 * index / case.fps + case.seed)
        shade = shade * (case.exposure * light * (1.0 - case.shadow * dark))[..., None]
        if case.blur_px > 0.0:
            shade = np.stack([ndimage.gaussian_filter(shade[..., one], case.blur_px) for one in range(3)], axis=-1)
        shade = shade + case.noise * rng.standard_normal(shade.shape)
        return np.clip(np.rint(shade), 0, 255).astype(np.uint8)

    def shades(self, motion: Motion, raised: float, camera: Floats) -> Floats:
        """(H, W, 3) colours without light, lens and noise."""
        back = np.asarray(np.linalg.inv(camera), dtype=np.float64)
        world = _through(back, self.pixels)
        lifted = world - np.array([0.0, raised])
        left = np.ones(len(world))
        shade = np.zeros((len(world), 3))

        def draw(share: Floats, texture: _Texture, place: Floats, colour: str, contrast: float) -> None:
            taken = np.minimum(share.ravel(), left)
            shown = np.flatnonzero(taken > 0.0)
            grey = 1.0 + contrast * texture.at(place[shown])
            shade[shown] += (taken[shown] * grey)[:, None] * self.colours[colour]
            left[shown] -= taken[shown]

        up = np.array([0.0, raised])
        if self.hand:
            held = self.covered([_through(camera, one + up) for one in self.hand])
            draw(held, self.skin, lifted - self.middle, "hand", 0.06)
        draw(self.covered([_through(camera, self.tool + up)]), self.wall, lifted - self.middle, "tool", 0.05)
        if self.clamps:
            draw(
                self.covered([_through(camera, one) for one in self.clamps]),
                self.wall,
                world - self.middle,
                "clamp",
                0.1,
            )
        for things, colour in ((self.marks, "mark"), (self.ruler, "ruler")):
            if things:
                shown = self.covered([_through(camera, one) for one in things])
                draw(shown, self.wall, world - self.middle, colour, 0.02)
        share = self.covered([_through(camera, self.border + motion.at(self.border)[0])])
        seen = np.flatnonzero(share.ravel() > 0.0)
        start = world if len(self.start) != len(world) else self.start
        rest = motion.rest_of(world[seen], start[seen], INVERSE_PX / self.scale)
        self.start = world.copy()
        self.start[seen] = rest
        everywhere = world.copy()
        everywhere[seen] = rest
        draw(share, self.foam, everywhere, "foam", self.case.contrast)
        if self.case.holding != "clamped":
            ground = self.covered([_through(camera, _rectangle(*self.ground))])
            draw(ground, self.table, world - self.middle, "table", 0.12)
        draw(np.ones(len(world)), self.wall, world - self.middle, "wall", 0.1)
        return shade.reshape(self.case.height_px, self.case.width_px, 3)

    def covered(self, outlines: Sequence[Floats]) -> Floats:
        """(H, W) share of each pixel within any of the outlines [px]."""
        fine = np.zeros((EDGE_FINENESS * self.case.height_px, EDGE_FINENESS * self.case.width_px), dtype=np.uint8)
        for outline in outlines:
            near = np.clip(outline, -2000.0, 4000.0)
            corners = np.rint(((near + 0.5) * EDGE_FINENESS - 0.5) * 16.0).astype(np.int32)
            cv2.fillPoly(fine, [corners], 255, shift=4)
        share = cv2.resize(fine, (self.case.width_px, self.case.height_px), interpolation=cv2.INTER_AREA)
        return np.asarray(share, dtype=np.float64) / 255.0


class _Texture:
    """A pattern of unit deviation over a rectangle of the world, a cubic spline."""

    def __init__(
        self,
        rng: np.random.Generator,
        corner: tuple[float, ...],
        size: tuple[float, ...],
        per_m: float,
        blurs_px: tuple[float, ...],
        pores: float = 0.0,
        stretch: float = 1.0,
    ) -> None:
        """corner, size: of the rectangle [m]; per_m: samples per metre; blurs_px: deviations of the blurs that make it
        [samples, or half of them where the texture has two per pixel]; pores: how much darker than bright it is"""
        self.edge = 12
        self.corner, self.per_m = np.array(corner), per_m
        shape = [round(per_m * one) + 2 * self.edge for one in (size[1], size[0])]
        fine = 2.0 if pores else 1.0
        total = np.zeros(shape)
        for blur in blurs_px:
            noise = rng.standard_normal(shape)
            soft = ndimage.gaussian_filter(noise, (fine * blur, fine * blur * stretch), mode="wrap")
            total += soft / soft.std()
        total /= total.std()
        total = np.clip(total - pores * (total**2 - 1.0), -3.0, 2.5)
        self.spline = ndimage.spline_filter(total / total.std(), order=3, mode="mirror").astype(np.float32)

    def at(self, place: Floats) -> Floats:
        """(k,) at places (k, 2) of the world [m]."""
        x, y = ((place - self.corner) * self.per_m + self.edge).T
        found = ndimage.map_coordinates(self.spline, [y, x], order=3, prefilter=False, mode="mirror")
        return np.asarray(found, dtype=np.float64)


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> Floats:
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _around(outline: Floats) -> tuple[int, int, int, int]:
    """x, y, width, height of the rectangle around an outline [px]."""
    low, high = np.rint(outline.min(axis=0)).astype(int), np.rint(outline.max(axis=0)).astype(int)
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


# Readings of force ---------------------------------------------------------------------------------------------------


def _read(case: VideoCase, depth: Floats, force: Floats) -> ForceLog:
    """What the sensor wrote: at rest before the video, and holding after it."""
    log = case.log
    rng = np.random.default_rng([case.seed, 54])
    length = log.offset_s + case.frames / case.fps + 1.0
    dense = np.arange(0.0, length, 1e-3)
    true = np.interp(dense - log.offset_s, np.arange(case.frames) / case.fps, force, left=0.0)
    if log.lag_s > 0.0:
        keep = np.exp(-1e-3 / log.lag_s)
        for index in range(1, len(true)):
            true[index] = keep * true[index - 1] + (1.0 - keep) * true[index]
    time = np.arange(0.0, length - 1e-3, 1.0 / log.rate_hz)
    read = np.interp(time, dense, true) + log.drift_n * time / length + log.noise_n * rng.standard_normal(len(time))
    if log.step_n > 0.0:
        read = np.rint(read / log.step_n) * log.step_n
    return ForceLog(time, read * 1e3 / GRAVITY if log.unit == "g" else read, log.unit)


# Files ---------------------------------------------------------------------------------------------------------------


def write(video: RenderedVideo, folder: Path, *, mbit: float = 4.0, name: str = "video.mp4") -> str:
    """Write the video, `force.csv` and `truth.json` into a folder; returns the name of the encoder.

    It is H.264 where PyAV is installed (`pip install av`), else MPEG-4 Part 2 of OpenCV."""
    folder.mkdir(parents=True, exist_ok=True)
    coded = encode(video.frames, video.fps, folder / name, mbit)
    (folder / "force.csv").write_text(force_table(video.log), encoding="utf-8")
    (folder / "truth.json").write_text(json.dumps(truth(video), indent=1) + "\n", encoding="utf-8")
    return coded


def force_table(log: ForceLog) -> str:
    """A log as CSV, with units in its head."""
    column, digits = ("force [N]", 4) if log.unit == "N" else ("weight [g]", 2)
    rows = [f"{t:.3f},{v:.{digits}f}" for t, v in zip(log.time_s, log.value, strict=True)]
    return "\n".join([f"time [s],{column}", *rows, ""])


def truth(video: RenderedVideo) -> dict[str, Any]:
    """What is true of a video, for JSON."""
    return {
        "case": dataclasses.asdict(video.case),
        "modulus_pa": video.modulus_pa,
        "poisson": video.poisson,
        "thickness_m": video.thickness_m,
        "px_per_cm": video.px_per_cm,
        "stiffness_n_per_mm": video.stiffness_n_per_mm,
        "depth_m": video.depth_m.tolist(),
        "force_n": video.force_n.tolist(),
        "outline": video.outline.tolist(),
        "roi": video.roi,
        "contact": video.contact,
        "held": video.held,
        "force_offset_s": video.case.log.offset_s,
    }


def encode(frames: Sequence[Images], fps: float, path: Path, mbit: float) -> str:
    """Write RGB images as an MP4 of a mean rate [Mbit/s]; returns the name of the encoder."""
    if importlib.util.find_spec("av") is None:
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, frames[0].shape[1::-1])
        for frame in frames:
            writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        writer.release()
        return "mp4v"
    av = importlib.import_module("av")
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=round(fps))
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.bit_rate = round(1e6 * mbit)
        stream.thread_count = 1  # the same bytes on any machine
        for frame in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        file.mux(stream.encode())
    return "libx264"
