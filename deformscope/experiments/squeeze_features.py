"""From the frames of a squeeze to its features: one function, while the hand squeezes and when it is replayed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray, FloatArray
from deformscope.capsule import Capsule, moved
from deformscope.errors import InputError
from deformscope.experiments.squeeze_frames import SqueezeFrames, frame_ns
from deformscope.frames import DepthFrame, HandFrame
from deformscope.results.declared import reported
from deformscope.rig.squeeze_sections import ContainerSection, HandSection
from deformscope.robot.mesh_files import read_meshes
from deformscope.robot.setup import CameraView
from deformscope.robot.squeeze_plan import PAD_ALONG_M, hand_capsules
from deformscope.robot.squeeze_setup import SqueezeSetup
from deformscope.robot.squeeze_supervisor import gap_m
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.squeeze.container import ContainerModel, ModelRenderer
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.outline import outline_px
from deformscope.stages.squeeze.patch import DepthChange, around, depth_change, filled, hand_pixels, median_of
from deformscope.stages.squeeze.physical import physical_features
from deformscope.stages.squeeze.tactile import series_of, tactile_feature
from deformscope.stages.squeeze.track import PoseEstimate, locate, track
from deformscope.stages.squeeze.trial import SqueezeFeatures, TrackedContainer
from deformscope_drivers.arm.kinematics import rotation_from_euler_xyz, transform
from deformscope_drivers.depth_camera.image import depth_m
from deformscope_drivers.sdh.kinematics import DISTAL_LINK_M, finger_points

REST_IMAGES, STEADY_IMAGES = 5, 3
"""Depth images whose median is taken together, before the first contact and from the steady state on."""
TRACK_HZ = 5.0
"""Of the images between them, so many a second are tracked."""
AROUND = 0.6
"""Room on each side of the container in a picture, as a share of its larger side there."""
DENT_M = 0.035
"""The wall is no part of a rigid container within this of a fingertip."""


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeGeometry:
    """What the features need to know beside the frames; it stands in a recording's settings.

    T_camera_hand: (4, 4), None = not known, or by the arm: T_arm_hand (hand to the arm's end) and T_arm_camera
    T_hand_container: (4, 4) where the container is expected
    arm_model, T_arm_table: of the arm that places the hand, and the table's frame to its base; empty, None = none does
    """

    hand: HandSection
    container: ContainerSection
    camera: CameraView
    T_hand_container: FloatArray
    T_camera_hand: FloatArray | None = None
    T_arm_hand: FloatArray | None = None
    T_arm_camera: FloatArray | None = None
    arm_model: str = ""
    T_arm_table: FloatArray | None = None

    @classmethod
    def of(cls, setup: SqueezeSetup) -> SqueezeGeometry:
        """The one of a setup."""
        return cls(
            setup.hand,
            setup.container,
            setup.camera,
            setup.grasp.T_hand_container,
            setup.T_camera_hand,
            setup.T_arm_hand,
            setup.T_arm_camera,
            "" if setup.placing is None else setup.placing.chain.name,
            None if setup.placing is None else setup.placing.placement.T_base_surface,
        )

    def as_json(self) -> dict[str, Any]:
        """For a recording's settings."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return msgspec.json.decode(msgspec.json.encode(values, enc_hook=lambda array: array.tolist()))  # type: ignore[no-any-return]

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> SqueezeGeometry:
        """The reverse of `as_json`. Raises InputError where something is missing."""
        try:
            poses: dict[str, Any] = {
                name: None if value is None else np.array(value)
                for name, value in given.items()
                if name.startswith("T_")
            }
            camera: dict[str, Any] = {
                name: tuple(value) if isinstance(value, list) else value for name, value in given["camera"].items()
            }
            return cls(
                msgspec.convert(given["hand"], HandSection),
                msgspec.convert(given["container"], ContainerSection),
                CameraView(**camera),
                arm_model=given.get("arm_model", ""),
                **poses,
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError("a recorded squeeze with its setup", f"{type(error).__name__}: {error}") from error

    def camera_from_hand(self, frames: SqueezeFrames) -> FloatArray | None:
        """(4, 4) hand to camera [m] at the time of the squeeze."""
        if self.T_camera_hand is not None or self.T_arm_hand is None or self.T_arm_camera is None:
            return self.T_camera_hand
        if frames.arm is None:
            return None
        arm = transform(rotation_from_euler_xyz(*frames.arm.rotation_rad.tolist()), frames.arm.position_m)
        return np.asarray(np.linalg.inv(self.T_arm_camera) @ arm @ self.T_arm_hand)


@dataclass(frozen=True, slots=True, eq=False)
class TrialFeatures:
    """What was computed of a squeeze. tracked: each with its image's time [ns], in order; poses: the same with all that
    is known of them; vision_series: (k, 121) the small change of depth every 0.1 s since first contact, None = none"""

    events: SqueezeEvents
    features: SqueezeFeatures = field(metadata=reported(flat=True))
    tracked: tuple[tuple[int, TrackedContainer], ...] = ()
    poses: tuple[PoseEstimate, ...] = ()
    vision_series: FloatArray | None = None

    @property
    def series(self) -> dict[str, FloatArray]:
        """Features every 0.1 s since first contact, by modality (k, p)."""
        seen = {} if self.vision_series is None else {"vision_small": self.vision_series}
        return {"tactile": self.features.series, **seen}

    @property
    def modalities(self) -> dict[str, FloatArray]:
        """(p,) features of each as classifiers take them: missing depth changes [m] as in `patch.filled`."""
        found = {"tactile": self.features.tactile, "physical": self.features.physical}
        if self.features.vision is not None and self.features.vision_small is not None:
            found["vision"] = filled(self.features.vision).ravel()
            found["vision_small"] = filled(self.features.vision_small).ravel()
        return found

    def steps(self) -> list[tuple[int, tuple[object, ...]]]:
        """Results, and when on the devices' clock they belong."""
        found: list[tuple[int, tuple[object, ...]]] = [(when, (one,)) for when, one in self.tracked]
        return [*found, (self.events.steady_ns, (self.events, self.features))]


def trial_features(frames: SqueezeFrames, geometry: SqueezeGeometry) -> TrialFeatures:
    """The events and features of a squeeze. Raises InputError where it has no first contact or no steady state.

    Without a camera, or with a bad track, there is no visual feature, and the reason stands in its place.
    """
    events = frames.events()
    if not events.first_ns or not events.steady_ns:
        raise InputError("a squeeze with first contact and steady state", "one without", "onset and still in [squeeze]")
    source, end = frames.tactile_source, geometry.hand.tactile_end
    tactile = [one for one in frames.during(frames.tactile) if frame_ns(one) >= events.first_ns]
    at = next((place for place, one in enumerate(tactile) if frame_ns(one) >= events.steady_ns), len(tactile) - 1)
    time_s = np.array([(frame_ns(one) - events.first_ns) / 1e9 for one in tactile])
    cells = np.stack([tactile_feature(source.counts(one), end) for one in tactile])
    hands = frames.during(frames.hands)
    gaps = _gaps(hands, geometry, [frame_ns(one) for one in tactile])
    physical = physical_features(
        time_s,
        [source.pressure_pa(one) for one in tactile],
        source.texel_m,
        np.maximum(0.5 * (gaps[0] - gaps), 0.0),
        0.0,
        float(time_s[at]),
    )
    series_s, series = series_of(time_s, cells)
    features = SqueezeFeatures(cells[at], physical.values, series_s, series)
    try:
        return _with_vision(frames, geometry, events, hands, features)
    except InputError as error:
        return TrialFeatures(events, dataclasses.replace(features, reason=str(error)))


def _gaps(hands: Sequence[HandFrame], geometry: SqueezeGeometry, when_ns: Sequence[int]) -> FloatArray:
    """(n,) between the fingertips at these times, straight between the hand's readings [m]."""
    known = np.array([frame_ns(one) for one in hands], np.float64)
    gaps = np.array([gap_m(np.asarray(one.position_deg, np.float64), geometry.hand.fingers) for one in hands])
    return np.asarray(np.interp(np.array(when_ns, np.float64) - known[0], known - known[0], gaps))


def around_px(geometry: SqueezeGeometry) -> tuple[float, float, float, float] | None:
    """Left, top, right and bottom of what is worth seeing of an image: the container where it is expected, and as much
    again around it; None where the camera's place or projection is not known before."""
    camera, pose = geometry.camera, geometry.T_camera_hand
    if pose is None or camera.focal_px is None or camera.center_px is None:
        return None
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    corners = 0.5 * signs * geometry.container.size_m
    seen = np.c_[corners, np.ones(8)] @ (pose @ geometry.T_hand_container).T
    if seen[:, 2].min() <= 0.0:
        return None
    pixels = seen[:, :2] / seen[:, 2:3] * camera.focal_px + camera.center_px
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    more = AROUND * float((high - low).max())
    return float(low[0] - more), float(low[1] - more), float(high[0] + more), float(high[1] + more)


# Vision --------------------------------------------------------------------------------------------------------------


def container_model(section: ContainerSection) -> ContainerModel:
    """The rigid model of a container. Raises InputError for a mesh that cannot be read."""
    size = section.size_m
    if section.shape == "box":
        return ContainerModel.box(size)
    if section.shape == "cylinder":
        return ContainerModel.cylinder(size[0] / 2, size[2])
    ((vertices_m, triangles),) = read_meshes([Path(section.mesh)], coarse=False)
    return ContainerModel.mesh(vertices_m, triangles.astype(np.int64))


class _Seen:
    """The images of a squeeze, and where the hand is in them."""

    def __init__(self, frames: SqueezeFrames, geometry: SqueezeGeometry, hands: Sequence[HandFrame]) -> None:
        camera, T_camera_hand = geometry.camera, geometry.camera_from_hand(frames)
        if not frames.depth:
            raise InputError("depth images of the squeeze", "none")
        if T_camera_hand is None:
            raise InputError("[hand] T_camera_hand, or T_arm_hand and [camera] T_arm_camera", "neither")
        if camera.focal_px is None or camera.center_px is None:
            raise InputError("[camera] focal_px and center_px", "none")
        self.T_camera_hand: FloatArray = T_camera_hand
        self.camera = Intrinsics(camera.focal_px, camera.center_px, camera.distortion)
        self.images = frames.during(frames.depth)
        self._fingers = geometry.hand.fingers
        self._hands = hands
        self._hand_ns = np.array([frame_ns(one) for one in hands])

    def angles(self, when_ns: int) -> npt.NDArray[np.float64]:
        """(7,) of the hand's last reading then [deg]."""
        at = max(int(np.searchsorted(self._hand_ns, when_ns, side="right")) - 1, 0)
        return np.asarray(self._hands[at].position_deg, np.float64)

    def closed_m(self, since_ns: int, when_ns: int) -> float:
        """By how much the fingertips have come closer between two times."""
        before, now = (gap_m(self.angles(one), self._fingers) for one in (since_ns, when_ns))
        return max(before - now, 0.0)

    def links(self, when_ns: int) -> list[Capsule]:
        """Fingers and palm, camera frame."""
        return moved(hand_capsules(self.angles(when_ns)), self.T_camera_hand)

    def fingertip(self, when_ns: int) -> FloatArray:
        """(3,) the middle of the pad of the finger that is nearer to the camera, camera frame [m]."""
        angles, found = self.angles(when_ns), []
        for finger in self._fingers:
            points = finger_points(angles, finger)
            found.append(points[1] + PAD_ALONG_M / DISTAL_LINK_M * (points[2] - points[1]))
        tips = self._moved(np.stack(found))
        return np.asarray(tips[int(tips[:, 2].argmin())])

    def median_m(self, images: Sequence[DepthFrame]) -> FloatArray:
        """(H, W) of images taken together [m], nan where nothing was seen in any of them."""
        depths = np.stack([depth_m(one.depth.astype(np.uint16, copy=False), one.unit_m) for one in images])
        depths = np.where(depths > 0.0, depths, np.nan).astype(np.float64)
        return median_of(depths)

    def excluded(self, depth: FloatArray, when_ns: int, dent: bool) -> BoolArray:
        """(H, W) pixels of the hand, and of the dent of the nearer finger."""
        covered = hand_pixels(depth, self.camera, self.links(when_ns))
        if dent:
            tip = self.fingertip(when_ns)
            center = tip[:2] / tip[2] * np.array(self.camera.focal_px) + np.array(self.camera.centre_px)
            radius_px = DENT_M / tip[2] * float(np.mean(self.camera.focal_px))
            covered |= around(center, (depth.shape[0], depth.shape[1]), radius_px)
        return covered

    def _moved(self, points: FloatArray) -> FloatArray:
        return np.asarray(points @ self.T_camera_hand[:3, :3].T + self.T_camera_hand[:3, 3])


def _with_vision(
    frames: SqueezeFrames,
    geometry: SqueezeGeometry,
    events: SqueezeEvents,
    hands: Sequence[HandFrame],
    features: SqueezeFeatures,
) -> TrialFeatures:
    """Located before the first contact, tracked from there, compared at the steady state."""
    seen = _Seen(frames, geometry, hands)
    renderer = ModelRenderer(container_model(geometry.container), seen.camera)
    before = [one for one in seen.images if frame_ns(one) < events.first_interval_ns[0]][-REST_IMAGES:]
    steady = [one for one in seen.images if frame_ns(one) >= events.steady_ns][:STEADY_IMAGES]
    if not before or not steady:
        raise InputError("depth images before first contact and at steady state", f"{len(before)} and {len(steady)}")
    tracked: list[tuple[int, TrackedContainer]] = []
    poses: list[PoseEstimate] = []
    small: list[tuple[int, FloatArray]] = []

    def keep(image: DepthFrame, pose: PoseEstimate) -> None:
        edges = outline_px(renderer.model, seen.camera, pose.T_camera_container)
        shown = TrackedContainer(
            image.index,
            pose.T_camera_container,
            pose.good,
            pose.reason,
            pose.observed.astype(np.float64),
            pose.agreeing,
            edges,
            (frame_ns(image) - events.first_ns) / 1e9,
        )
        tracked.append((frame_ns(image), shown))
        poses.append(pose)

    def found(features: SqueezeFeatures) -> TrialFeatures:
        return TrialFeatures(events, features, tuple(tracked), tuple(poses), _small_series(small, events))

    def changed(depth: FloatArray, when_ns: int, pose: PoseEstimate) -> DepthChange:
        change = depth_change(
            renderer,
            pose.T_camera_container,
            depth,
            seen.fingertip(when_ns),
            excluded=hand_pixels(depth, seen.camera, seen.links(when_ns)),
            closed_m=seen.closed_m(events.first_interval_ns[0], when_ns),
        )
        small.append((when_ns, filled(change.small_m).ravel()))
        return change

    depth = seen.median_m(before)
    when_ns = frame_ns(before[-1])
    guess = seen.T_camera_hand @ geometry.T_hand_container
    rest = locate(renderer, depth, guess, yaws_deg=(0.0,), excluded=seen.excluded(depth, when_ns, dent=False))
    keep(before[-1], rest)
    if not rest.good:
        return found(dataclasses.replace(features, reason=f"before: {rest.reason}"))
    changed(depth, when_ns, rest)
    pose = rest
    for image in _between(seen.images, events):
        depth = seen.median_m([image])
        pose = _next_pose(renderer, seen, depth, frame_ns(image), pose, rest)
        keep(image, pose)
        if pose.good:
            changed(depth, frame_ns(image), pose)
    depth = seen.median_m(steady)
    pose = _next_pose(renderer, seen, depth, frame_ns(steady[0]), pose, rest)
    keep(steady[0], pose)
    if not pose.good:
        return found(dataclasses.replace(features, reason=pose.reason))
    change = changed(depth, frame_ns(steady[0]), pose)
    return found(_seen_features(features, change))


def _small_series(small: Sequence[tuple[int, FloatArray]], events: SqueezeEvents) -> FloatArray | None:
    """(k, 121) the newest small change of depth at each step since first contact."""
    if not small or small[-1][0] < events.first_ns:
        return None
    time_s = np.array([(when_ns - events.first_ns) / 1e9 for when_ns, _ in small])
    return series_of(time_s, np.stack([one for _, one in small]))[1]


def _seen_features(features: SqueezeFeatures, change: DepthChange) -> SqueezeFeatures:
    return dataclasses.replace(
        features,
        vision=change.change_m,
        vision_small=change.small_m,
        missing=change.missing,
        noise_m=change.noise_m,
        patch_px=change.center_px,
        patch_width_m=change.width_m,
    )


def _between(images: Sequence[DepthFrame], events: SqueezeEvents) -> list[DepthFrame]:
    """From the first contact to the steady state, TRACK_HZ."""
    found: list[DepthFrame] = []
    for image in images:
        due_ns = events.first_ns if not found else frame_ns(found[-1]) + 1e9 / TRACK_HZ
        if due_ns <= frame_ns(image) < events.steady_ns:
            found.append(image)
    return found


def _next_pose(
    renderer: ModelRenderer, seen: _Seen, depth: FloatArray, when_ns: int, before: PoseEstimate, rest: PoseEstimate
) -> PoseEstimate:
    """From the last good pose; directions that the image does not observe keep the rest pose."""
    start = before if before.good else rest
    excluded = seen.excluded(depth, when_ns, dent=True)
    return track(renderer, depth, start.T_camera_container, rest=rest.T_camera_container, excluded=excluded)
