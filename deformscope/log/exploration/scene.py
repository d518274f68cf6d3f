"""The surface in space, in its frame, and the arm over it.

The surface frame is the root of all frames, `tf#/`. Entities need no transform of their own, and the scene's one
transform places an arm's base in it."""

import numpy as np
import rerun as rr
from scipy.spatial import cKDTree

from deformscope.arrays import FloatArray, IntArray
from deformscope.frames import Stream
from deformscope.log.canvas import TEXT, sides_of
from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.arm import shape_of
from deformscope.log.rig.columns import Sink, root
from deformscope.pictures.exploration import STIFFNESS, stiffness_range
from deformscope.pictures.palette import OBSERVED, SIMULATED, ColorArray, Rgb, round_down
from deformscope.stages.map.exploration import MapEstimate, PlannedTouch, SurfaceEstimate, TouchEstimate, TouchForecast
from deformscope.stages.see.cloud import reduce_to_grid
from deformscope.stages.see.triangulation import triangulate

SCENE = "display/scene"
SURFACE_FRAME = "tf#/"

HEIGHTS = "cividis"
TABLE: Rgb = (84, 88, 96)
CONTACT: Rgb = (255, 255, 255)
NORMAL: Rgb = (255, 200, 0)
TARGET: Rgb = (232, 17, 45)
ASKED = f"{SCENE}/asked"
ASKED_COLOR: Rgb = (0, 200, 255)
FORCE_M_PER_N = 0.02
POINT_M, LINE_M, MARK_M, ARROW_M = 0.0006, 0.0016, 0.006, 0.05
TARGET_TOP_M = 0.12


def log_base(rec: Sink, stream: Stream, base_from_surface: FloatArray) -> None:
    """Log the pose of an arm's base. base_from_surface: (4, 4) [m]"""
    assert stream.urdf is not None
    surface_from_base = np.linalg.inv(base_from_surface)
    stands = rr.Transform3D(
        translation=surface_from_base[:3, 3],
        mat3x3=surface_from_base[:3, :3],
        parent_frame=SURFACE_FRAME,
        child_frame=shape_of(stream.urdf, stream.device).base,
    )
    rec.log(root(f"{SCENE}/base", stream.device), stands, static=True)


def log_surface(now: ResultBatch, surface: SurfaceEstimate, *, colored: bool) -> None:
    """Log the points that the camera saw, lower ones brighter, and the surface of the Gaussian process. colored: colour
    it by its height, as long as there is no map"""
    points = surface.points_m
    low, high = (np.quantile(points[:, 2], (0.01, 0.99))) if len(points) else (0.0, 1.0)
    share = (points[:, 2] - low) / max(high - low, 1e-9)
    now.show_points(f"{SCENE}/observed", points, _colors("Greys", 0.05 + 0.5 * share), POINT_M)
    places, triangles = grid_of(surface.height_m.shape, surface.cell_m)
    vertices = np.column_stack([places, surface.height_m.ravel()])
    share = (surface.height_m.ravel() - low) / max(high - low, 1e-9)
    tints = _colors(HEIGHTS, share) if colored else None
    # (n, 3) out of the surface, so that dents are shaded
    down_y, down_x = np.gradient(surface.height_m, surface.cell_m)
    normals = np.stack([-down_x, -down_y, np.ones_like(down_x)], axis=-1).reshape(-1, 3)
    normals = np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    mesh = rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, vertex_normals=normals, vertex_colors=tints)
    now.show(f"{SCENE}/surface", mesh)
    rows, width = surface.height_m.shape
    x, y = width * surface.cell_m, rows * surface.cell_m
    corners = np.array([[0, 0, 0], [x, 0, 0], [x, y, 0], [0, y, 0], [0, 0, 0]], dtype=np.float64)
    now.show_lines(f"{SCENE}/table", corners[None], TABLE, LINE_M)


def log_stiffness(now: ResultBatch, maps: MapEstimate) -> None:
    """Log the surface in the colours of the map of stiffness; its observed shape is unchanged."""
    low, high = stiffness_range(maps.stiffness_n_per_mm)
    known = np.nan_to_num(maps.stiffness_n_per_mm.ravel(), nan=low, posinf=high, neginf=low).clip(low, high)
    share = np.log(known / low) / np.log(high / low)
    now.show(f"{SCENE}/surface", rr.Mesh3D.from_fields(vertex_colors=_colors(STIFFNESS, share)))


def log_contact(now: ResultBatch, touch: TouchEstimate) -> None:
    """Log a touch's mark, its number and its normal. Marks of earlier touches stay visible."""
    at, path = touch.xyz_m, f"{SCENE}/contacts/{touch.number}"
    now.show_points(path, at[None], CONTACT, MARK_M, [str(touch.number)])
    arrow = rr.Arrows3D(origins=[at], vectors=[touch.normal * ARROW_M], colors=NORMAL, radii=LINE_M)
    now.show(f"{path}/normal", arrow)


def log_target(now: ResultBatch, plan: PlannedTouch) -> None:
    """Log a red line at the place of the next touch; no line if none follows."""
    if plan.target_m is None:
        now.show(f"{SCENE}/target", rr.LineStrips3D([]))
        now.show(f"{SCENE}/target/name", rr.Points3D([]))
        return
    x, y = plan.target_m
    top = np.array([x, y, TARGET_TOP_M])
    now.show_lines(f"{SCENE}/target", np.array([[[x, y, 0.0], top]]), TARGET, LINE_M)
    now.show_points(f"{SCENE}/target/name", top[None], TEXT, 0.0005, ["next"])


def log_no_forecast(now: ResultBatch, result: object) -> None:
    """After this result no touch is requested any more."""
    now.show(f"{ASKED}/way", rr.LineStrips3D([]))
    now.show(f"{ASKED}/normal", rr.Arrows3D(vectors=[]))
    now.show(f"{ASKED}/place", rr.Points3D([]))


def log_forecast(now: ResultBatch, forecast: TouchForecast) -> None:
    """Log the requested touch: its path down, an arrow with the length of its force, and the forecast."""
    low, high = forecast.stiffness_interval
    words = f"{forecast.set_force_n:g} N: {forecast.stiffness_n_per_mm:.2g} N/mm expected ({low:.2g} to {high:.2g})"
    now.show_lines(f"{ASKED}/way", forecast.way_m[None], ASKED_COLOR, LINE_M)
    back = forecast.normal * FORCE_M_PER_N * forecast.set_force_n
    arrow = rr.Arrows3D(origins=[forecast.xyz_m + back], vectors=[-back], colors=ASKED_COLOR, radii=2 * LINE_M)
    now.show(f"{ASKED}/normal", arrow)
    now.show_points(f"{ASKED}/place", forecast.xyz_m[None], ASKED_COLOR, MARK_M, [words])


def grid_of(shape: tuple[int, ...], cell_m: float) -> tuple[FloatArray, IntArray]:
    """(n, 2) cell centres, (m, 3) triangles between them."""
    rows, columns = shape
    y, x = (np.mgrid[:rows, :columns] + 0.5) * cell_m
    place = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (one.ravel() for one in (place[:-1, :-1], place[:-1, 1:], place[1:, 1:], place[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x, y], axis=-1).reshape(-1, 2), triangles


def _colors(name: str, share: FloatArray) -> ColorArray:
    """(n, 3) RGB 0 to 255 of shares (n,) from 0 to 1, by a colour map of this name."""
    import matplotlib as mpl

    tints: ColorArray = mpl.colormaps[name](np.clip(share, 0.0, 1.0), bytes=True)[:, :3]
    return tints


# The last dent close up: the observed points, and the particles of the fitted model

DENT = "display/dent"
MOST_DRAWN_OUT, SHARE = 8.0, 0.5
"""Heights are magnified until the dent is this share of the half width, up to this factor."""
HALF_M, CELL_M = 0.05, 0.0035
"""Half the side of the view, and of cells whose mean height represents their observed points."""
NEIGHBOURS = 1.3
"""Multiple of the usual distance up to which lines connect particles."""
STEPS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
FRAME: Rgb = (150, 155, 165)


def log_dent(now: ResultBatch, touch: TouchEstimate) -> None:
    """Log the dent around the contact; half the width is 1, and heights are magnified. The measured values are in the
    result."""
    observed, simulated = (_near(one - touch.xyz_m) for one in (touch.observed_m, touch.simulated_m))
    if len(observed):
        observed = reduce_to_grid(observed, CELL_M)[0]
    half = HALF_M
    top = _top(simulated)
    times = 1.0 if touch.rigid else _drawn_out(touch.depth_m, half)  # of a rigid place it would be noise
    scale = np.array([1.0, 1.0, times]) / half
    now.show_points(f"{DENT}/observed", observed * scale, OBSERVED, 0.012)
    now.show_points(f"{DENT}/simulated", top * scale, SIMULATED, 0.016)
    now.show_lines(f"{DENT}/simulated/net", _net(top) * scale, SIMULATED, 0.006)
    bar_m = round_down(half)  # about half the width
    floor = float(min((top[:, 2] * scale[2]).min(initial=0.0), (observed[:, 2] * scale[2]).min(initial=0.0)))
    ends = np.array([[-0.5 * bar_m / half, -1.15, floor], [0.5 * bar_m / half, -1.15, floor]])
    now.show_lines(f"{DENT}/scale", ends[None], FRAME, 0.012)
    drawn = f", heights drawn {times:g} times" if times > 1 else ""
    middle = ends.mean(axis=0)
    now.show_points(f"{DENT}/scale/label", middle[None], TEXT, 0.002, [f"{bar_m * 100:g} cm{drawn}"])


def _near(points: FloatArray) -> FloatArray:
    """The shown part of points (n, 3) relative to the contact [m]: within `HALF_M` along x and y."""
    return points[(np.abs(points[:, :2]) <= HALF_M + 1e-6).all(axis=1)]


def _top(particles: FloatArray) -> FloatArray:
    """Those of particles (n, 3) with no other above them: the visible part of a body made of layers."""
    if len(particles) < 2:
        return particles
    flat = cKDTree(particles[:, :2])
    near = 0.5 * float(np.median(cKDTree(particles).query(particles, k=2)[0][:, 1]))
    highest = [particles[rows, 2].max() for rows in flat.query_ball_point(particles[:, :2], near)]
    return particles[particles[:, 2] >= highest]


def _net(top: FloatArray) -> FloatArray:
    """(n, 2, 3) lines between neighbours."""
    triangles = triangulate(top[:, :2])
    if not len(triangles):
        return np.zeros((0, 2, 3))
    pairs = sides_of(triangles)
    apart = np.linalg.norm(top[pairs[:, 0], :2] - top[pairs[:, 1], :2], axis=1)
    return np.asarray(top[pairs[apart <= NEIGHBOURS * float(np.median(apart))]])


def _drawn_out(depth_m: float, half: float) -> float:
    wanted = SHARE * half / max(depth_m, 1e-6)
    return max((step for step in STEPS if step <= min(wanted, MOST_DRAWN_OUT)), default=1.0)
