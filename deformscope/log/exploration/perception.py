"""Results between frames and estimates: one tree of named frames, the pixels used, the error over beta.

display/perception/frames/...    world, surface, camera, arm_base, tool: a transform each, of the frame of this name
display/perception/pixels        labels of the newest depth image that something was computed from
display/perception/error         error over beta
display/perception/maps/... each map as an image on the surface, with its values as `value`"""

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.log.exploration.scene import SCENE, SURFACE_FRAME, grid_of
from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.arm import POSE_NS
from deformscope.log.rig.columns import log_series
from deformscope.pictures import exploration as pictures
from deformscope.pictures.palette import AXES, BAD, IDLE, JOINTS, OBSERVED, Rgb
from deformscope.rows import SERIES
from deformscope.stages.map.exploration import SurfaceEstimate
from deformscope.stages.map.perception import NAMES, ForcePose, LookPerception, TouchPerception
from deformscope.stages.see.pixel_labels import PixelLabel

FRAMES, PIXELS, ERROR, MAPS = (f"display/perception/{part}" for part in ("frames", "pixels", "error", "maps"))
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
AXIS_M = 0.06


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


def log_error(now: ResultBatch, perception: TouchPerception) -> None:
    """The error over beta, left out if there is none."""
    now.show_png(ERROR, pictures.error_png, perception)


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
