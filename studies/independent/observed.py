"""A camera's view of bodies of other solvers: lattices that are pushed, and errors of tool, camera and noise.

Lengths in metres, a spacing of 1 cm."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.linalg import cholesky
from scipy.spatial.distance import cdist
from scipy.special import gamma, kv

from studies.independent import plane_elements, shape_matching

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

CELL = 0.01
BETA_MOST = 0.99

ToolError = Literal["none", "along", "any", "turned", "ramp"]
CameraError = Literal["none", "scale", "scale x", "drift", "lens", "wave"]
Motion = Literal["stretch", "press", "shear"]


@dataclass(frozen=True, slots=True)
class Errors:
    """tool: displacement of all moved particles, by `tool_size` [m]: along the push, in any direction, turned by this
    at its ends, or in proportion to the place along it
    camera: what is wrong with all deformed positions: scale off by a share `camera_size`, of both axes or one; drift,
    largest at one end [m]; lens: radial, or a wave as long as the body, at most this [m]
    cells: over how many spacings neighbours share noise, 0 for none; smooth: nu of the Matern kernel, inf for Gaussian
    held: whether held positions have noise too; told: whether that is stated
    pressed: the tool presses into the body, by .4 to 1.5 spacings, instead of any way; sign: that of the
    camera's error, 0 = either"""

    tool: ToolError = "none"
    tool_size: float = 0.0
    camera: CameraError = "none"
    camera_size: float = 0.0
    cells: float = 0.0
    smooth: float = np.inf
    held: bool = True
    told: bool = False
    pressed: bool = False
    sign: int = 0


@dataclass(frozen=True, slots=True)
class Pushed:
    """rest, true: (K, d); seen: (K, d) with errors; held, tool: (n,) held particles, and those that the tool moved;
    sigma: deviation of the noise; clusters: particles a side, 0 of finite elements; beta: the truth, NaN there"""

    rest: Floats
    shape: tuple[int, ...]
    held: Ints
    tool: Ints
    true: Floats
    seen: Floats
    sigma: float
    clusters: int
    beta: float


def lattice(shape: tuple[int, ...]) -> Floats:
    """(K, d), last axis fastest."""
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, len(shape))
    return np.asarray(CELL * places, dtype=np.float64)


def pushed_clusters(rng: np.random.Generator, errors: Errors, dim: int) -> Pushed:
    """A lattice of shape matching clusters of 2 to 5 a side, one face held, a patch of the other moved."""
    shape = (int(rng.integers(4, 9)), int(rng.integers(4, 13))) if dim == 2 else tuple(map(int, rng.integers(3, 6, 3)))
    rest, size = lattice(shape), int(rng.integers(2, 6))
    near, far = (np.flatnonzero(np.isclose(rest[:, 0], end)) for end in (0.0, rest[:, 0].max()))
    reach = CELL * rng.uniform(0.5, 2.0)
    tool = far[np.linalg.norm(rest[far] - rest[rng.choice(far)], axis=1) <= reach]
    push = rng.normal(0.0, CELL * rng.uniform(0.4, 1.2), dim)
    if errors.pressed:
        push = CELL * np.concatenate([[-rng.uniform(0.4, 1.5)], rng.normal(0.0, 0.2, dim - 1)])
    held, beta = np.concatenate([near, tool]), float(rng.uniform(0.0, BETA_MOST))
    place = rest[held] + np.where(np.isin(held, tool)[:, None], push, 0.0)
    true = shape_matching.static_state(rest, shape_matching.windows(shape, size), beta, held, place)
    sigma = CELL * float(np.exp(rng.uniform(np.log(0.005), np.log(0.05))))
    seen = with_errors(rng, errors, rest, true, held, tool, push, sigma)
    return Pushed(rest, shape, held, tool, true, seen, sigma, size, beta)


def pushed_elements(
    rng: np.random.Generator, material: Floats, motion: Motion, errors: Errors, *, patch: bool = False
) -> Pushed:
    """A rectangle of one material, whose whole faces (or a patch of one) are held and moved by 2 to 10 %."""
    shape = (int(rng.integers(6, 10)), int(rng.integers(6, 13)))
    rest = lattice(shape)
    near, far = (np.flatnonzero(np.isclose(rest[:, 0], end)) for end in (0.0, rest[:, 0].max()))
    if patch:
        far = far[np.linalg.norm(rest[far] - rest[rng.choice(far)], axis=1) <= CELL * rng.uniform(0.8, 2.5)]
    push = {"stretch": (1.0, 0.0), "press": (-1.0, 0.0), "shear": (0.0, 1.0)}[motion]
    move = np.array(push) * rest[:, 0].max() * rng.uniform(0.02, 0.1)
    held = np.concatenate([near, far])
    moved = np.where(np.isin(held, far)[:, None], move, 0.0)
    true = rest + plane_elements.deform(shape, CELL, material, held, moved)
    sigma = CELL * float(np.exp(rng.uniform(np.log(0.005), np.log(0.02))))
    seen = with_errors(rng, errors, rest, true, held, far, move, sigma)
    return Pushed(rest, shape, held, far, true, seen, sigma, 0, np.nan)


def with_errors(
    rng: np.random.Generator,
    errors: Errors,
    rest: Floats,
    true: Floats,
    held: Ints,
    tool: Ints,
    push: Floats,
    sigma: float,
) -> Floats:
    """(K, d) what is seen of true positions."""
    noise = sigma * field(rng, rest, errors.cells, errors.smooth)
    if not errors.held:
        noise[held] = 0.0
    seen = true + noise + _camera(rng, errors, rest, true)
    seen[tool] += _tool(rng, errors, rest[tool], push)
    return seen


def field(rng: np.random.Generator, rest: Floats, cells: float, smooth: float) -> Floats:
    """(K, d) noise of unit variance, white or of a Matern kernel of this length and nu."""
    white = rng.standard_normal(rest.shape)
    return white if cells <= 0.0 else np.asarray(cholesky(covariance(rest, cells, smooth), lower=True) @ white)


def covariance(rest: Floats, cells: float, smooth: float) -> Floats:
    """(K, K) covariance of a coordinate of `field`."""
    if cells <= 0.0:
        return np.eye(len(rest))
    apart = cdist(rest, rest) / (CELL * cells)
    if np.isinf(smooth):
        kernel = np.exp(-0.5 * apart**2)
    else:
        s = np.sqrt(2.0 * smooth) * np.maximum(apart, 1e-9)
        kernel = 2.0 ** (1.0 - smooth) / gamma(smooth) * s**smooth * kv(smooth, s)
    return np.asarray(kernel + 1e-8 * np.eye(len(rest)))


def _tool(rng: np.random.Generator, errors: Errors, rest: Floats, push: Floats) -> Floats:
    """(n, d) error of the given positions of the tool's particles."""
    dim, sign = rest.shape[1], rng.choice([-1.0, 1.0])
    way = sign * push / np.linalg.norm(push)
    drawn = rng.standard_normal(dim)
    away = (rest - rest.mean(axis=0)) / max(float(np.ptp(rest, axis=0).max()) / 2.0, CELL)
    if errors.tool == "any":
        way = drawn / np.linalg.norm(drawn)
    if errors.tool in ("along", "any"):
        return np.asarray(errors.tool_size * np.ones((len(rest), 1)) * way)
    if errors.tool == "turned":
        turn = np.zeros((dim, dim))
        turn[0, 1], turn[1, 0] = -sign, sign
        return np.asarray(errors.tool_size * away @ turn.T)
    if errors.tool == "ramp":
        return np.asarray(errors.tool_size * away[:, 1:2] * way)
    return np.zeros_like(rest)


def _camera(rng: np.random.Generator, errors: Errors, rest: Floats, true: Floats) -> Floats:
    """(K, d) what the camera adds to true positions."""
    dim, sign = rest.shape[1], rng.choice([-1.0, 1.0])
    sign = errors.sign or sign
    middle, size = rest.mean(axis=0), float(np.ptp(rest, axis=0).max())
    drawn = rng.standard_normal((2, dim))
    first, second = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    away, amount = true - middle, sign * errors.camera_size
    if errors.camera == "scale":
        return np.asarray(amount * away)
    if errors.camera == "scale x":
        return np.asarray(amount * away * (np.arange(dim) == rng.integers(dim)))
    if errors.camera == "drift":
        along = (rest - middle) @ first
        return np.asarray(amount * ((along - along.min()) / np.ptp(along))[:, None] * second)
    if errors.camera == "lens":
        radius = np.linalg.norm(away, axis=1, keepdims=True)
        return np.asarray(amount * (radius / radius.max()) ** 3 * away / np.maximum(radius, 1e-9))
    if errors.camera == "wave":
        return np.asarray(
            amount * np.sin(2.0 * np.pi * ((rest - middle) @ first / size + rng.random()))[:, None] * second
        )
    return np.zeros_like(rest)
