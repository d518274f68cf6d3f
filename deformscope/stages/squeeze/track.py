"""The pose of a rigid container in depth images, also while a hand squeezes it (Thesis ch. 2, after its reference 120).

    renderer = ModelRenderer(ContainerModel.box((0.12, 0.08, 0.2)), camera)
    rest = locate(renderer, depth_m, guess)                     # before the squeeze
    now = track(renderer, depth_m, rest.T_camera_container, rest=rest.T_camera_container, excluded=hand)
    now.good, now.T_camera_container, now.observed

Each pixel of the container's rendering is compared with the data's pixel, along the surface's normal (point-to-plane
distances with projective data association: Blais and Levine 1995). The rendering's outline is compared with jumps of
depth. Flat faces slide along themselves: directions of motion that the data do not observe keep the rest pose, and are
reported. Objects before the container, and dents, have little or no weight (Tukey). The bulge of its walls is estimated
together with the pose (`bulge`), so that a full container does not appear nearer.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.see.cloud import axial_noise_m
from deformscope.stages.squeeze.container import BULGE_M, ModelRenderer, ModelView, bulge_shapes

CORRELATED_PX = 3.0
"""Number of pixels over which a structured-light camera's depth noise is correlated: it matches windows of pixels."""
EDGE_NOISE_PX = 1.5
"""Deviation of where an outline is seen: such cameras fatten and fray edges by a pixel or two."""
EDGE_EVERY_PX = 3
"""Distance of the outline's sampled points."""
EDGE_REACH_PX = 12
EDGE_RUN_PX = 3
"""Number of successive pixels of the container, then of others, at an edge: a single missing pixel is no edge."""
JUMP_M = 0.025
"""Least jump of depth at the outline, so that a table under the container does not count."""
COARSE_M = 0.0015
"""After a smaller motion all pixels are used, and the outline."""
SETTLED_M = 0.0002
RESTLESS_M = 0.0005
"""Motion below which the pose has converged; pixels that appear and disappear may move a pose by this."""
OBSERVED_M = 0.001
"""A direction of motion with a smaller deviation is observed."""
FLATTEST = 0.2
"""Least cosine between a ray and the normal where a pixel counts."""
TUKEY_CUT = 4.685
"""Deviations beyond which a residual has no weight (Tukey's biweight)."""
THIN = (slice(None, None, 2), slice(None, None, 2))
"""Number of the final pixels that are compared."""


@dataclass(frozen=True, slots=True)
class TrackOptions:
    """reach_m: largest distance between surface and data that are matched [m]; steps: largest number; least_pixels:
    fewest pixels of the container seen; least_agreeing: least share of them within the noise for a good track
    farthest_m, farthest_deg: largest distance from the rest pose; jump_m: largest motion from the start, including
    rotation times the lever"""

    reach_m: float = 0.02
    steps: int = 15
    least_pixels: int = 150
    least_agreeing: float = 0.85
    farthest_m: float = 0.05
    farthest_deg: float = 20.0
    jump_m: float = math.inf


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """Pose of a container. T_camera_container: (4, 4)

    directions: (6, 6) a direction of motion each row, container frame: translation, then rotation times `lever_m`
    deviation_m: (6,) standard deviation of the pose along each from image data [m]; observed: (6,) directions that the
    data determine; pixels: number of pixels of the container seen and compared; agreeing: share of them within the
    noise; rms_m: root mean square of these residuals; good: whether
    features may be taken from it; reason: why not, or empty"""

    T_camera_container: FloatArray
    directions: FloatArray
    deviation_m: FloatArray
    observed: BoolArray
    lever_m: float
    pixels: int
    agreeing: float
    rms_m: float
    good: bool
    reason: str


@dataclass(frozen=True, slots=True)
class _Window:
    """The rendering of the container. pixels: (h, w, 2) column and row; ray: (h, w, 3); bulge: (h, w, k)"""

    pixels: IntArray
    ray: FloatArray
    view: ModelView
    bulge: FloatArray

    def part(self, of: tuple[slice, slice]) -> "_Window":
        """Some rows and columns of it."""
        return _Window(self.pixels[of], self.ray[of], self.view.part(of), self.bulge[of])


@dataclass(frozen=True, slots=True)
class _Rows:
    """Linearised equations. jacobian: (n, 6) Jacobian of a motion in the camera frame, rotation about the container's
    origin; residual: (n,) [m]; deviation: (n,) [m]; share: independent of one another, of all; bulge: (n, k) bulge of
    the walls'"""

    jacobian: FloatArray
    residual: FloatArray
    deviation: FloatArray
    share: float
    bulge: FloatArray


def track(
    renderer: ModelRenderer,
    depth_m: FloatArray,
    start: FloatArray,
    *,
    rest: FloatArray | None = None,
    excluded: BoolArray | None = None,
    options: TrackOptions | None = None,
) -> PoseEstimate:
    """The container's pose in a depth image (H, W) [m]; pixels of 0 or NaN saw nothing.

    start: (4, 4) T_camera_container to begin at, such as that of the frame before; rest: (4, 4) pose for directions
    that the data do not observe, default `start`; excluded: (H, W) pixels of the hand and of the dent A bad track is a
    result (`good` False), never an exception. Raises InputError for shapes that do not fit."""
    options = options or TrackOptions()
    depth = np.asarray(depth_m, dtype=np.float64)
    if depth.ndim != 2 or (excluded is not None and excluded.shape != depth.shape):
        raise InputError("a depth image (H, W) and a mask of its size", f"shape {depth.shape}")
    seen = np.isfinite(depth) & (depth > 0.0)
    depth = np.where(seen, depth, np.nan)
    usable = seen if excluded is None else seen & ~excluded
    pose: FloatArray = np.array(start, dtype=np.float64)
    rest = pose.copy() if rest is None else np.asarray(rest, dtype=np.float64)
    lever = 0.5 * renderer.model.radius_m
    settled, fine, gain = False, False, 1.0
    for _ in range(options.steps):
        rows, _ = _equations(renderer, depth, usable, pose, options.reach_m, fine)
        motion, _, _ = _solve(rows, pose, rest, lever)
        motion = gain * motion
        pose = pose.copy()
        pose[:3, 3] += motion[:3]
        pose[:3, :3] = Rotation.from_rotvec(motion[3:]).as_matrix() @ pose[:3, :3]
        length = _length(motion, lever)
        settled = fine and length < RESTLESS_M
        if fine and length < SETTLED_M:
            break
        if fine:  # ever less, so that outlines that jump from pixel to pixel do not swing it for ever
            gain = 1.0 / (0.5 + 1.0 / gain)
        fine = fine or length < COARSE_M
    away_m = _length(_between(np.asarray(start, np.float64), pose), lever)
    return _judged(renderer, depth, usable, pose, rest, lever, settled, away_m, options)


def locate(
    renderer: ModelRenderer,
    depth_m: FloatArray,
    guess: FloatArray,
    *,
    yaws_deg: tuple[float, ...] = (0.0, 30.0, -30.0, 60.0, -60.0, 90.0),
    excluded: BoolArray | None = None,
) -> PoseEstimate:
    """The pose of a container near its assumed place, turned about its z axis by any of some angles.

    guess: (4, 4) T_camera_container, right within a few centimetres. The start that explains the most pixels (those
    compared times the share that agree) is the best."""
    options = TrackOptions(reach_m=0.06, steps=40)
    found = []
    for yaw in yaws_deg:
        start = np.array(guess, dtype=np.float64)
        start[:3, :3] = start[:3, :3] @ Rotation.from_euler("z", yaw, degrees=True).as_matrix()
        rough = track(renderer, depth_m, start, excluded=excluded, options=options)
        found.append(track(renderer, depth_m, rough.T_camera_container, excluded=excluded))
    return max(found, key=lambda one: (one.good, one.agreeing * one.pixels))


def _equations(
    renderer: ModelRenderer, depth: FloatArray, usable: BoolArray, pose: FloatArray, reach_m: float, fine: bool
) -> tuple[list[_Rows], _Window | None]:
    """Equations of the surface, and of the outline at fine resolution, in this order; and the rendering, None if the
    container is outside the image. depth: (h, w) [m]; usable: (h, w); pose: (4, 4) [m]"""
    margin = EDGE_REACH_PX if fine else 0
    left, top, right, bottom = renderer.window(pose, (depth.shape[0], depth.shape[1]), margin)
    every = 1 if fine else 4
    pixels = np.stack(np.meshgrid(np.arange(left, right, every), np.arange(top, bottom, every)), axis=-1)
    if not pixels.size:
        return [], None
    ray = renderer.rays(pixels)
    view = renderer.render(pose, pixels, ray)
    bulge: FloatArray = np.zeros((*pixels.shape[:2], 0))
    if fine:
        bulge = bulge_shapes(view, (ray * view.depth_m[..., None] - pose[:3, 3]) @ pose[:3, 2])
    window = _Window(pixels, ray, view, bulge)
    some, apart_px = (window.part(THIN), 2) if fine else (window, 4)
    rows = [_surface_rows(depth, usable, pose, some, reach_m, apart_px)]
    if fine:
        rows.append(_edge_rows(renderer, depth, usable, pose, view.depth_m, (left, top)))
    return rows, window


def _surface_rows(
    depth: FloatArray, usable: BoolArray, pose: FloatArray, window: _Window, reach_m: float, every: int
) -> _Rows:
    pixels, view, bulge = window.pixels, window.view, window.bulge
    model_m = view.depth_m
    data = depth[pixels[..., 1], pixels[..., 0]]
    with np.errstate(invalid="ignore"):
        near = np.isfinite(model_m) & usable[pixels[..., 1], pixels[..., 0]] & (np.abs(data - model_m) < reach_m)
    ray, n, z = window.ray[near], view.normal(near), model_m[near]
    facing = np.einsum("ij,ij->i", n, ray) / np.linalg.norm(ray, axis=1)
    flat = np.abs(facing) > FLATTEST
    ray, n, z, facing, data = ray[flat], n[flat], z[flat], facing[flat], data[near][flat]
    along = np.einsum("ij,ij->i", n, ray)
    jacobian = np.column_stack([n, np.cross(z[:, None] * ray - pose[:3, 3], n)])
    noise = axial_noise_m(z, np.arccos(np.clip(np.abs(facing), 0.0, 1.0)))
    share = min((every / CORRELATED_PX) ** 2, 1.0)
    return _Rows(jacobian, along * (data - z), np.abs(along) * noise, share, bulge[near][flat])


def _edge_rows(
    renderer: ModelRenderer,
    depth: FloatArray,
    usable: BoolArray,
    pose: FloatArray,
    model_m: FloatArray,
    corner: tuple[int, int],
) -> _Rows:
    """Rows where the data's depth jumps along the normals of the rendering's outline, against the end of the
    rendering."""
    nothing = _rigid(np.zeros((0, 6)), np.zeros(0), np.zeros(0), 1.0)
    inside = np.isfinite(model_m)
    outlines, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines or max(map(len, outlines)) < 8 * EDGE_RUN_PX:
        return nothing
    outline = max(outlines, key=len)[:, 0, :].astype(np.float64)
    ahead, behind = np.roll(outline, -4, axis=0), np.roll(outline, 4, axis=0)
    tangent = ahead - behind
    length = np.linalg.norm(tangent, axis=1)
    straight = length > 6.0  # not at corners, where a normal means little
    at = outline[straight][::EDGE_EVERY_PX]
    tangent = (tangent / np.maximum(length, 1.0)[:, None])[straight][::EDGE_EVERY_PX]
    if not len(at):
        return nothing
    outward = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    outward *= np.sign(cv2.contourArea(outline.astype(np.float32), oriented=True))
    offset = np.arange(-EDGE_REACH_PX, EDGE_REACH_PX + 1)
    line = np.rint(at[:, None, :] + offset[None, :, None] * outward[:, None, :]).astype(int) + corner  # (m, k, 2)
    high, wide = depth.shape
    within = (line >= 0).all(axis=(1, 2)) & (line[..., 0] < wide).all(axis=1) & (line[..., 1] < high).all(axis=1)
    at, outward, line = at[within], outward[within], line[within]
    z = model_m[at[:, 1].astype(int), at[:, 0].astype(int)]
    found, offset_px = _jumps(depth, usable, line, z, inside, corner)
    at, outward, z = at[found] + corner, outward[found], z[found]
    aside = (at - renderer.camera.centre_px) / renderer.camera.focal_px
    metres = z / np.mean(renderer.camera.focal_px)
    across = np.column_stack([outward, -np.einsum("ij,ij->i", outward, aside)])
    point = np.column_stack([aside * z[:, None], z])
    jacobian = np.column_stack([across, np.cross(point - pose[:3, 3], across)])
    return _rigid(jacobian, metres * offset_px[found], metres * EDGE_NOISE_PX, min(EDGE_EVERY_PX / CORRELATED_PX, 1.0))


def _jumps(
    depth: FloatArray, usable: BoolArray, line: IntArray, z: FloatArray, inside: BoolArray, corner: tuple[int, int]
) -> tuple[BoolArray, FloatArray]:
    """Which lines (m, k, 2) across the outline have one jump of depth, and how far outside the rendering it is [px]."""
    data = depth[line[..., 1], line[..., 0]]
    local = line - corner
    held = (local >= 0).all(axis=2) & (local[..., 0] < inside.shape[1]) & (local[..., 1] < inside.shape[0])
    local = np.where(held[..., None], local, 0)
    model = held & inside[local[..., 1], local[..., 0]]
    with np.errstate(invalid="ignore"):
        ours = np.abs(data - z[:, None]) < JUMP_M
        before = data < z[:, None] - JUMP_M
    hidden = (before | (np.isfinite(data) & ~usable[line[..., 1], line[..., 0]])).any(axis=1)
    run = np.lib.stride_tricks.sliding_window_view(ours, EDGE_RUN_PX, axis=1)
    whole, none = np.asarray(run.all(axis=2)), np.asarray(~run.any(axis=2))
    count = ours.shape[1] - 2 * EDGE_RUN_PX + 1
    jump = whole[:, :count] & none[:, EDGE_RUN_PX : EDGE_RUN_PX + count]
    one = (jump.sum(axis=1) == 1) & ~hidden
    last_of_data = jump.argmax(axis=1) + EDGE_RUN_PX - 1
    last_of_model = model.shape[1] - 1 - model[:, ::-1].argmax(axis=1)
    return one & model.any(axis=1), (last_of_data - last_of_model).astype(np.float64)


def _rigid(jacobian: FloatArray, residual: FloatArray, deviation: FloatArray, share: float) -> _Rows:
    """Equations of rigid motion alone. jacobian: (n, 6); residual, deviation: (n,) [m]"""
    return _Rows(jacobian, residual, deviation, share, np.zeros((len(residual), 0)))


def _solve(
    rows: list[_Rows], pose: FloatArray, rest: FloatArray, lever: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(6,) the motion in the camera frame: along observed directions to the data, along the others to the rest pose.
    Also directions (6, 6) by row in the container frame, and the deviation along each (6,) [m]"""
    turn = np.zeros((6, 6))
    turn[:3, :3], turn[3:, 3:] = pose[:3, :3], pose[:3, :3] / lever  # from container frame with lever to camera frame
    total, right = np.zeros((6, 6)), np.zeros(6)
    for part in rows:
        jacobian = part.jacobian @ turn / part.deviation[:, None]
        residual = part.residual / part.deviation
        square, along = _normal_equations(jacobian, residual, part.bulge / part.deviation[:, None], part.share)
        total += square
        right += along
    strength, directions = np.linalg.eigh(total)
    large = (np.abs(directions) > 0.3).argmax(axis=0)  # of a unit vector some entry is at least 1 / 6^0.5
    directions *= np.sign(directions[large, range(6)])
    known = strength > OBSERVED_M**-2
    to_rest = np.linalg.solve(turn, _between(pose, rest))
    along = np.where(known, (directions.T @ right) / np.maximum(strength, 1e-12), directions.T @ to_rest)
    return turn @ (directions @ along), directions.T, 1.0 / np.sqrt(np.maximum(strength, 1e-12))


def _normal_equations(
    jacobian: FloatArray, residual: FloatArray, bulge: FloatArray, share: float
) -> tuple[FloatArray, FloatArray]:
    """(6, 6) and (6,) of the motion, without the bulges (n, k), which are found and taken out; all in deviations."""
    weight = share * _tukey(residual)
    if bulge.shape[1]:
        # once more with weights of what is left: a wall that bulges is no outlier
        weight = share * _tukey(residual - bulge @ _bulges(jacobian, residual, bulge, weight))
    square, along = jacobian.T @ (weight[:, None] * jacobian), jacobian.T @ (weight * residual)
    if bulge.shape[1]:
        mixed = jacobian.T @ (weight[:, None] * bulge)
        own = bulge.T @ (weight[:, None] * bulge) + np.eye(bulge.shape[1]) / BULGE_M**2
        square -= mixed @ np.linalg.solve(own, mixed.T)
        along -= mixed @ np.linalg.solve(own, bulge.T @ (weight * residual))
    return square, along


def _bulges(jacobian: FloatArray, residual: FloatArray, bulge: FloatArray, weight: FloatArray) -> FloatArray:
    """(k,) how far the walls bulge [m], whatever the motion is; all in deviations."""
    every = np.hstack([jacobian, bulge])
    prior = np.diag([1e-9] * 6 + [BULGE_M**-2] * bulge.shape[1])
    found = np.linalg.solve(every.T @ (weight[:, None] * every) + prior, every.T @ (weight * residual))
    return np.asarray(found[6:])


def _tukey(residual: FloatArray) -> FloatArray:
    """Weights (n,) of residuals (n,) in deviations (Tukey's biweight). The deviation is estimated from them if it is
    larger than assumed, so that a start away from the pose converges to it."""
    if not len(residual):
        return residual
    scale = max(1.4826 * float(np.median(np.abs(residual))), 1.0)
    return np.asarray(np.maximum(1.0 - (residual / (TUKEY_CUT * scale)) ** 2, 0.0) ** 2)


def _between(pose: FloatArray, other: FloatArray) -> FloatArray:
    """(6,) the motion from one pose to another, camera frame, rotation about the container's origin."""
    turn = Rotation.from_matrix(other[:3, :3] @ pose[:3, :3].T).as_rotvec()
    return np.concatenate([other[:3, 3] - pose[:3, 3], turn])


def _judged(
    renderer: ModelRenderer,
    depth: FloatArray,
    usable: BoolArray,
    pose: FloatArray,
    rest: FloatArray,
    lever: float,
    settled: bool,
    moved_m: float,
    options: TrackOptions,
) -> PoseEstimate:
    rows, window = _equations(renderer, depth, usable, pose, options.reach_m, fine=True)
    _, directions, deviation = _solve(rows, pose, rest, lever)
    shown = _compared(depth, usable, pose, rows, window)
    agreeing = float(np.mean(np.abs(shown) < 4.0)) if len(shown) else 0.0
    rms = float(np.sqrt(np.mean(rows[0].residual ** 2))) if rows and len(rows[0].residual) else float("nan")
    away = _between(rest, pose)
    away_m, away_deg = float(np.linalg.norm(away[:3])), float(np.degrees(np.linalg.norm(away[3:])))
    reason = ""
    if len(shown) < options.least_pixels:
        reason = f"{len(shown)} pixels of the container seen, {options.least_pixels} needed"
    elif agreeing < options.least_agreeing:
        reason = f"{agreeing:.0%} of the container's pixels agree with its model, {options.least_agreeing:.0%} needed"
    elif away_m > options.farthest_m or away_deg > options.farthest_deg:
        reason = f"{1e3 * away_m:.0f} mm and {away_deg:.0f} degrees from the rest pose"
    elif moved_m > options.jump_m:
        reason = f"a jump of {1e3 * moved_m:.0f} mm from the pose before, {1e3 * options.jump_m:.0f} mm at most"
    elif not settled:
        reason = f"the pose did not settle in {options.steps} steps"
    return PoseEstimate(
        T_camera_container=pose,
        directions=directions,
        deviation_m=deviation,
        observed=deviation < OBSERVED_M,
        lever_m=lever,
        pixels=len(shown),
        agreeing=agreeing,
        rms_m=rms,
        good=not reason,
        reason=reason,
    )


def _compared(
    depth: FloatArray, usable: BoolArray, pose: FloatArray, rows: list[_Rows], window: _Window | None
) -> FloatArray:
    """(n,) differences of depth in deviations at the container's pixels, those of the background included: if they show
    no container, the track is wrong. Objects before it, such as a cable, are left out, and the bulge of walls is taken
    into account. rows: the equations there, of this window"""
    if window is None:
        return np.zeros(0)
    view, surface = window.view, rows[0]
    expected = view.depth_m
    if len(surface.residual) and surface.bulge.shape[1]:
        jacobian, residual, bulge = (
            one / surface.deviation.reshape(-1, *[1] * (one.ndim - 1))
            for one in (surface.jacobian, surface.residual, surface.bulge)
        )
        out_m = window.bulge @ _bulges(jacobian, residual, bulge, _tukey(residual))
        along = np.einsum("hwi,hwi->hw", view.outward @ pose[:3, :3].T, window.ray)
        expected = expected + out_m / np.minimum(along, -FLATTEST)
    column, row = np.moveaxis(window.pixels[THIN], -1, 0)
    expected = expected[THIN]
    here = np.isfinite(expected) & usable[row, column]
    difference, z = depth[row, column][here] - expected[here], expected[here]
    scaled = difference / np.maximum(axial_noise_m(z), 0.001)
    return np.asarray(scaled[difference > -JUMP_M])


def _length(motion: FloatArray, lever: float) -> float:
    """Length of a motion (6,) [m]: translation, and rotation times its lever."""
    return float(np.hypot(np.linalg.norm(motion[:3]), np.linalg.norm(motion[3:]) * lever))
