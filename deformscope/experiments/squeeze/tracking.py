"""The container in successive depth images: its pose, and the difference of the depth around the fingertip from that of
the rigid model (Thesis ch. 2). It is the same function of the same images while the hand squeezes, afterwards, and when
a recording is replayed."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.frames import DepthFrame, StageCost
from deformscope.rig.sections import ContainerSection
from deformscope.robot.mesh_files import read_meshes
from deformscope.robot.squeeze_plan import PAD_ALONG_M, hand_capsules
from deformscope.session import measuring
from deformscope.solid import moved
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.squeeze.container import ContainerModel, ModelRenderer, outline_px
from deformscope.stages.squeeze.patch import DepthChange, around, depth_change, hand_pixels, median_of
from deformscope.stages.squeeze.track import PoseEstimate, TrackOptions, locate, track
from deformscope.stages.squeeze.trial import ContainerChange, TrackedContainer
from deformscope_drivers.images import depth_m
from deformscope_drivers.sdh.kinematics import DISTAL_LINK_M, finger_points

REST_IMAGES = 5
"""Number of depth images whose median is used to locate the container."""
DENT_M = 0.035
"""Distance from a fingertip within which the wall does not count as rigid."""
JUMP_M, FASTEST_M_S = 0.005, 0.15
"""A container that is held moves by no more than the first and, for each second, the second. Chosen."""
MARGIN_PX = 120
"""Margin around the container: pixels farther away are not used."""


@dataclass(frozen=True, slots=True, eq=False)
class ContainerImage:
    """An image in which the container is to be tracked.

    frames: up to `REST_IMAGES` - 1 earlier images and, last, the image; angles_deg: (7,) angles of the hand then
    T_camera_hand, T_hand_container: (4, 4), the latter where the container is expected
    first_ns: time of first contact, 0 = not known then; closed_m: by how much the fingertips have closed since [m]"""

    frames: tuple[DepthFrame, ...]
    angles_deg: npt.NDArray[np.float64]
    T_camera_hand: FloatArray
    T_hand_container: FloatArray
    first_ns: int = 0
    closed_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TrackedImage:
    """Result of an image. when_ns: its time on the host's clock; measured: the change of depth, or None
    costs: its computation time during the squeeze"""

    when_ns: int
    container: TrackedContainer
    change: ContainerChange
    pose: PoseEstimate
    measured: DepthChange | None
    costs: tuple[StageCost, ...] = ()

    def after(self, lag_s: float, skipped: int = 0, costs: tuple[StageCost, ...] = ()) -> "TrackedImage":
        """The result with its delay after the image, and the number of images before it that were left out."""
        known = dataclasses.replace(self.container, lag_s=lag_s, skipped=skipped)
        return dataclasses.replace(self, container=known, costs=costs)


class ContainerTracker:
    """Tracks a container of known form in the images of a camera in front of it and of the hand that squeezes it;
    stores the last pose.

    rest: the image in which it was located before the squeeze, None = not yet"""

    def __init__(self, section: ContainerSection, fingers: tuple[int, ...], camera: Intrinsics) -> None:
        """fingers: that squeeze. Raises InputError for a mesh that cannot be read and a camera with distortion."""
        self.renderer = ModelRenderer(container_model(section), camera)
        self._fingers, self._camera = fingers, camera
        self.rest: TrackedImage | None = None
        self._start: TrackedImage | None = None

    def track(self, image: ContainerImage) -> TrackedImage:
        """Locate the container in the median of the frames until it is found once, then track it in the newest one."""
        return self.track_median(image, image.frames if self.rest is None else image.frames[-1:], -1)

    def follow(self, found: TrackedImage) -> TrackedImage:
        """Continue from an image, or from the rest if the image's pose was refused."""
        self.rest = self.rest or (found if found.pose.good else None)
        self._start = found if found.pose.good else self.rest
        return found

    def track_median(self, image: ContainerImage, frames: tuple[DepthFrame, ...], of: int) -> TrackedImage:
        """The pose in the median of some frames, which counts as an image at the time of the frame `of`."""
        frame, start = frames[of], self._start
        expected = image.T_camera_hand @ image.T_hand_container if start is None else start.pose.T_camera_container
        depth = self._median_m(frames, expected)
        when_ns, tip = frame.stamp.host_ns, self._fingertip(image)
        hand = hand_pixels(depth, self._camera, moved(hand_capsules(image.angles_deg), image.T_camera_hand))
        if self.rest is None or start is None:
            pose = locate(self.renderer, depth, expected, yaws_deg=(0.0,), excluded=hand)
        else:
            radius_px = DENT_M / tip[2] * float(np.mean(self._camera.focal_px))
            center = tip[:2] / tip[2] * np.array(self._camera.focal_px) + np.array(self._camera.centre_px)
            excluded = hand | around(center, (depth.shape[0], depth.shape[1]), radius_px)
            options = TrackOptions(jump_m=JUMP_M + FASTEST_M_S * (when_ns - start.when_ns) / 1e9)
            rest = self.rest.pose.T_camera_container
            pose = track(self.renderer, depth, expected, rest=rest, excluded=excluded, options=options)
        since_s = (when_ns - image.first_ns) / 1e9 if image.first_ns else float("nan")
        measured, changed = None, ContainerChange(frame.index, since_s, pose.reason)
        if pose.good:
            try:
                pose_m, closed_m = pose.T_camera_container, image.closed_m
                with measuring("depth change"):
                    measured = depth_change(self.renderer, pose_m, depth, tip, excluded=hand, closed_m=closed_m)
                fields = {field.name: getattr(measured, field.name) for field in dataclasses.fields(measured)}
                changed = dataclasses.replace(changed, **fields | {"change_m": measured.change_m.astype(np.float32)})
            except InputError as error:
                changed = dataclasses.replace(changed, reason=str(error))
        shown = TrackedContainer(
            index=frame.index,
            T_camera_container=pose.T_camera_container,
            good=pose.good,
            reason=pose.reason,
            observed=pose.observed.astype(np.float64),
            agreeing=pose.agreeing,
            edges_px=outline_px(self.renderer.model, self._camera, pose.T_camera_container),
            since_s=since_s,
            directions=pose.directions,
            deviation_m=pose.deviation_m,
        )
        return self.follow(TrackedImage(when_ns, container=shown, change=changed, pose=pose, measured=measured))

    def _median_m(self, frames: Sequence[DepthFrame], pose: FloatArray) -> FloatArray:
        """(H, W) of images taken together around the container [m], nan elsewhere and where none of them saw it."""
        high, wide = frames[-1].depth.shape
        left, top, right, bottom = self.renderer.window(pose, (high, wide), MARGIN_PX)
        part = slice(top, bottom), slice(left, right)
        whole, seen = np.full((high, wide), np.nan), seen_m(frames, part)
        whole[part] = median_of(seen) if len(seen) > 1 else seen[0]
        return whole

    def _fingertip(self, image: ContainerImage) -> FloatArray:
        """(3,) the middle of the pad of the finger that is nearer to the camera, camera frame [m]."""
        points = np.stack([finger_points(image.angles_deg, finger) for finger in self._fingers])
        pads = points[:, 1] + PAD_ALONG_M / DISTAL_LINK_M * (points[:, 2] - points[:, 1])
        tips = pads @ image.T_camera_hand[:3, :3].T + image.T_camera_hand[:3, 3]
        return np.asarray(tips[int(tips[:, 2].argmin())])


def seen_m(frames: Sequence[DepthFrame], part: tuple[slice, slice] = (slice(None), slice(None))) -> FloatArray:
    """(n, H, W) depths of a part of each image [m], nan where nothing was seen."""
    depths = np.stack([depth_m(one.depth[part].astype(np.uint16, copy=False), one.unit_m) for one in frames])
    return np.where(depths > 0.0, depths, np.nan).astype(np.float64)


def container_model(section: ContainerSection) -> ContainerModel:
    """The rigid model of a container. Raises InputError for a mesh that cannot be read."""
    size = section.size_m
    if section.shape == "box":
        return ContainerModel.box(size)
    if section.shape == "cylinder":
        return ContainerModel.cylinder(size[0] / 2, size[2])
    ((vertices_m, triangles),) = read_meshes([Path(section.mesh)], coarse=False)
    return ContainerModel.mesh(vertices_m, triangles.astype(np.int64))
