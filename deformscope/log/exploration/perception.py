"""Results between frames and estimates: one tree of named frames, the pixels used, the surface under a touch.

display/perception/frames/...    world, surface, camera, arm_base, tool: a transform each, of the frame of this name
display/perception/pixels        labels of the newest depth image that something was computed from
display/perception/surface/...   the surface under the newest touch, coloured by its deviation, and tactile points
display/perception/error         error over beta
display/perception/maps/... each map as an image on the surface, with its values as `value`"""

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.log.canvas import TEXT
from deformscope.log.exploration.scene import SCENE, SURFACE_FRAME, grid_of
from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.arm import POSE_NS
from deformscope.log.rig.columns import log_series
from deformscope.pictures import exploration as pictures
from deformscope.pictures.palette import AXES, BAD, HELD, IDLE, JOINTS, OBSERVED, Rgb, colors, round_up
from deformscope.rows import SERIES
from deformscope.stages.map.exploration import SurfaceEstimate
from deformscope.stages.map.perception import NAMES, ForcePose, LookPerception, TouchPerception
from deformscope.stages.see.pixel_labels import PixelLabel

FRAMES, PIXELS, UNDER, ERROR, MAPS = (
    f"display/perception/{part}" for part in ("frames", "pixels", "surface", "error", "maps")
)
LABELS: dict[PixelLabel, Rgb] = {
    PixelLabel.NOTHING_SEEN: (0, 0, 0),
    PixelLabel.USED: OBSERVED,
    PixelLabel.OUTSIDE_THE_BOX: IDLE,
    PixelLabel.ROBOT_CAPSULE: BAD,
    PixelLabel.ROBOT_SOLID: (230, 110, 60),
    PixelLabel.HANGING: (204, 121, 167),
    PixelLabel.LONE: (240, 228, 66),
    PixelLabel.MISFIT: (255, 255, 255),
}
AXIS_M, TACTILE_M, NET_M, HEIGHTS = 0.06, 0.0008, 0.0002, 4.0
TOUCH = "touch"
"""Frame in the middle of the square around the newest touch."""


def log_frames(
    rec: rr.RecordingStream, base_from_surface: FloatArray | None, T_surface_camera: FloatArray | None
) -> None:
    """Log the constant frames, and the names of later entities. base_from_surface: (4, 4), None = the same;
    T_surface_camera: (4, 4), None = not known"""
    none: FloatArray = np.eye(4)
    base = none if base_from_surface is None else np.linalg.inv(base_from_surface)
    known = {"arm_base": base, "camera": T_surface_camera}
    stands = {"world": (SURFACE_FRAME, none), "surface": ("world", none)}
    stands |= {name: ("surface", T) for name, T in known.items() if T is not None}
    for name, (parent, T) in stands.items():
        placed = rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3], parent_frame=parent, child_frame=name)
        rec.log(f"{FRAMES}/{name}", placed, static=True)
        rec.log(f"{SCENE}/frames/{name}", rr.CoordinateFrame(name), rr.TransformAxes3D(AXIS_M), static=True)
    classes = [(int(one), one.name.lower().replace("_", " "), rgb) for one, rgb in LABELS.items()]
    rec.log(PIXELS, rr.AnnotationContext(classes), static=True)
    log_series(rec, SERIES[ForcePose], NAMES, (*AXES, *JOINTS[:6]))


def log_pixels(now: ResultBatch, perception: LookPerception | TouchPerception) -> None:
    """Log the labels of the last image; the others are in the result."""
    if perception.masks is not None:
        now.show(PIXELS, rr.SegmentationImage(perception.masks.decode(-1)))


def log_under_touch(now: ResultBatch, perception: TouchPerception) -> None:
    """The surface under the touch, and the error over beta; missing ones are left out."""
    now.show_png(ERROR, pictures.error_png, perception)
    if (under := perception.surface) is None:
        now.show(UNDER, rr.Clear(recursive=True))
        return
    dent = under.dent
    end_mm, triangles = round_up(1e3 * float(dent.sd_m.max())), grid_of(dent.shape, 1.0)[1]
    tints = colors(1e3 * dent.sd_m / end_mm)
    middle, near = dent.after.mean(axis=0), dent.after.min(axis=0)
    scale = [1.0, 1.0, 1.0 / HEIGHTS]  # seen from this frame heights are drawn out
    stands = rr.Transform3D(translation=middle, scale=scale, parent_frame="surface", child_frame=TOUCH)
    now.show(f"{FRAMES}/{TOUCH}", stands)
    mesh = rr.Mesh3D(vertex_positions=dent.after, triangle_indices=triangles, vertex_colors=tints)
    now.show(f"{UNDER}/heights", mesh)
    rows = dent.after.reshape(*dent.shape, 3)
    now.show_lines(f"{UNDER}/net", np.concatenate([rows, rows.swapaxes(0, 1)]), TEXT, NET_M)
    now.show_points(f"{UNDER}/tactile", under.tactile_m, HELD, TACTILE_M)
    words = f"deviation 0 to {end_mm:g} mm, violet to yellow; heights drawn {HEIGHTS:g} times"
    now.show_points(f"{UNDER}/label", [[middle[0], near[1] - 0.01, near[2]]], TEXT, 1e-4, [words])


def log_tool(now: ResultBatch, poses: ForcePose) -> None:
    """The tip's frame while it touches."""
    _, some = np.unique(poses.host_ns // POSE_NS, return_index=True)
    pose = poses.values[some, 3:]
    columns = rr.Transform3D.columns(
        translation=pose[:, :3],
        quaternion=Rotation.from_rotvec(pose[:, 3:]).as_quat(),
        parent_frame=["surface"] * len(some),
        child_frame=["tool"] * len(some),
    )
    now.batch.send_series(f"{FRAMES}/tool", poses.host_ns[some], columns)
    for axes in (rr.CoordinateFrame.columns(frame=["tool"]), rr.TransformAxes3D.columns(axis_length=[AXIS_M])):
        now.batch.send_series(f"{SCENE}/frames/tool", poses.host_ns[:1], axes)


def log_ground(now: ResultBatch, surface: SurfaceEstimate) -> None:
    """The plane below the maps."""
    places, triangles = grid_of(surface.height_m.shape, surface.cell_m)
    at, size_m = np.column_stack([places, surface.height_m.ravel()]), places.max(axis=0) + 0.5 * surface.cell_m
    mesh = rr.Mesh3D(vertex_positions=at, triangle_indices=triangles, vertex_texcoords=places / size_m)
    for name in pictures.FIELDS:
        now.show(f"{MAPS}/{name}", mesh)


def log_on_surface(now: ResultBatch, name: str, drawn: pictures.DrawnMap) -> None:
    """A map with its picture, on the surface, and its values (rows, columns)."""
    rows, columns, _ = drawn.colors.shape
    form = rr.components.ImageFormat(
        width=columns, height=rows, color_model="RGB", channel_datatype=rr.ChannelDatatype.U8
    )
    texture = rr.Mesh3D.from_fields(albedo_texture_buffer=drawn.colors.tobytes(), albedo_texture_format=form)
    now.show(f"{MAPS}/{name}", texture)
    now.show(f"{MAPS}/{name}", rr.AnyValues(value=drawn.values.ravel()))
