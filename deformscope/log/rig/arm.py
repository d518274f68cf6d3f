"""An arm's shape, which moves with its joints."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr

from deformscope.frames import ArmFrame, Stream
from deformscope.log.rig.columns import Batch, moments, root

POSE_NS = 40_000_000
"""Shortest period of the shape's motion: a pose has nine rows of names and numbers, all of them from the joint
angles."""
MOVABLE = ("revolute", "continuous", "prismatic")

SOLID = {
    "Boxes3D:half_sizes": rr.Boxes3D.from_fields(fill_mode=rr.components.FillMode.Solid),
    "Cylinders3D:radii": rr.Cylinders3D.from_fields(fill_mode=rr.components.FillMode.Solid),
    "Ellipsoids3D:half_sizes": rr.Ellipsoids3D.from_fields(fill_mode=rr.components.FillMode.Solid),
}
"""Components that identify simple shapes of a URDF: rerun would draw these as wires."""


@dataclass(frozen=True, slots=True)
class Shape:
    """An arm's description for a viewer.

    joints: joints that the arm's own angles turn, in order; fingers: (joint, angle open, angle closed) [rad]; base: the
    frame of its first link; reach_m: the length of all its links together"""

    tree: rr.urdf.UrdfTree
    joints: tuple[str, ...]
    fingers: tuple[tuple[str, float, float], ...]
    base: str
    reach_m: float


@functools.lru_cache(maxsize=8)
def shape_of(urdf: Path, device: str) -> Shape:
    """Read a URDF. Frames carry the device's name, so that two arms of one model do not mix."""
    prefix = f"{device}/"
    tree = rr.urdf.UrdfTree.from_file_path(urdf, frame_prefix=prefix)
    movable = [joint for joint in tree.joints() if joint.joint_type in MOVABLE]
    fingers = [joint for joint in movable if "finger" in joint.name]
    return Shape(
        tree=tree,
        joints=tuple(joint.name for joint in movable if joint not in fingers),
        fingers=tuple((j.name, j.limit_lower, j.limit_upper) for j in fingers if "tip" not in j.name),
        base=prefix + tree.root_link().name.removeprefix(prefix),
        reach_m=float(sum(np.linalg.norm(joint.origin_xyz) for joint in movable if joint not in fingers)),
    )


def log_shape(rec: rr.RecordingStream, stream: Stream) -> None:
    if stream.urdf is not None:
        display = root("/display/arm", stream.device)
        for chunk in shape_of(stream.urdf, stream.device).tree.stream():
            # rerun takes no path but one of a single part for an arm, hence each part of it is moved
            moved = chunk.with_entity_path(f"{display}{chunk.entity_path}")
            rec.send_chunks(moved)
            for name in moved.to_record_batch().schema.names:
                if name in SOLID:
                    rec.log(moved.entity_path, SOLID[name], static=True)


def log_pose(batch: Batch, device: str, frames: Sequence[ArmFrame], start_ns: int, stream: Stream | None) -> None:
    """All joints in one call: rows of one entity, each about another pair of frames; nothing without a shape."""
    if stream is None or stream.urdf is None:
        return
    shape = shape_of(stream.urdf, device)
    slots = [frame.stamp.host_ns // POSE_NS for frame in frames]
    frames = [frame for frame, slot, before in zip(frames, slots, [None, *slots], strict=False) if slot != before]
    names = [*shape.joints, *(name for name, _, _ in shape.fingers)]
    values = []
    for frame in frames:
        angles = np.deg2rad(frame.joint_deg).tolist()
        fingers = [
            low + share * (high - low) for share, (_, low, high) in zip(frame.finger, shape.fingers, strict=False)
        ]
        values.append([*angles[: len(shape.joints)], *fingers])
    if {len(row) for row in values} != {len(names)}:
        return  # an arm that is not the one described: its numbers are recorded all the same
    found = shape.tree.compute_joint_transform_batches(pa.array([names] * len(frames)), pa.array(values)).flatten()
    columns = rr.Transform3D.columns(
        translation=np.stack(found.field("translation").to_pylist()),
        quaternion=np.stack(found.field("quaternion").to_pylist()),
        parent_frame=found.field("parent_frame").to_pylist(),
        child_frame=found.field("child_frame").to_pylist(),
    )
    when = [frame.stamp.host_ns for frame in frames for _ in names]
    batch.send_columns(root("display/arm", device, "joints"), moments(when, start_ns), columns)
