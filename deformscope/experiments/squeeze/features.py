"""From the frames of a squeeze to its features: the same function while the hand squeezes and in a replay."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.squeeze.frames import SqueezeFrames, frame_ns
from deformscope.experiments.squeeze.tracking import REST_IMAGES, ContainerImage, ContainerTracker, TrackedImage
from deformscope.frames import HandFrame
from deformscope.results.render import reported
from deformscope.rig.sections import ContainerSection, HandSection
from deformscope.robot.setup import CameraView
from deformscope.robot.squeeze_setup import SqueezeSetup
from deformscope.robot.squeeze_supervisor import gap_m
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.patch import filled
from deformscope.stages.squeeze.physical import physical_features, series_of, tactile_feature
from deformscope.stages.squeeze.trial import SqueezeFeatures
from deformscope_drivers.arm.kinematics import rotation_from_euler_xyz, transform

STEADY_IMAGES = 3
"""Number of depth images from the steady state whose median is used."""
AROUND = 0.6
"""Margin on each side of the container in a picture, as a share of its larger side."""


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeGeometry:
    """Information for the features besides the frames; a recording's settings have it.

    T_camera_hand: (4, 4), None = unknown, or given by the arm: T_arm_hand (hand to the arm's end) and T_arm_camera
    T_hand_container: (4, 4) where the container is expected; arm_model, T_arm_table: model and pose of the arm that
    places the hand, and the table's frame to its base; empty, None = none does"""

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
    def of(cls, setup: SqueezeSetup) -> "SqueezeGeometry":
        """The geometry of a setup."""
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
        """The geometry for a recording's settings."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return msgspec.json.decode(msgspec.json.encode(values, enc_hook=lambda array: array.tolist()))  # type: ignore[no-any-return]

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> "SqueezeGeometry":
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
    """Results of a squeeze. tracked: tracked images in order of time, then that of the steady state; vision_series: (k,
    121) the small change of depth every 0.1 s since first contact, None = none"""

    events: SqueezeEvents
    features: SqueezeFeatures = field(metadata=reported(flat=True))
    tracked: tuple[TrackedImage, ...] = ()
    vision_series: FloatArray | None = None

    @property
    def series(self) -> dict[str, FloatArray]:
        """Features every 0.1 s since first contact, by modality (k, p)."""
        seen = {} if self.vision_series is None else {"vision_small": self.vision_series}
        return {"tactile": self.features.series, **seen}

    @property
    def modalities(self) -> dict[str, FloatArray]:
        """(p,) features of each modality for classifiers: missing depth changes [m] are filled as in `patch.filled`."""
        found = {"tactile": self.features.tactile, "physical": self.features.physical}
        if self.features.vision is not None and self.features.vision_small is not None:
            found["vision"] = filled(self.features.vision).ravel()
            found["vision_small"] = filled(self.features.vision_small).ravel()
        return found

    def steps(self) -> list[tuple[int, tuple[object, ...]]]:
        """Results that were computed after the squeeze, and their times on the devices' clock."""
        found = [(one.when_ns, (one.container, one.change)) for one in self.tracked if not one.container.live]
        return [*found, (self.events.steady_ns, (self.events, self.features))]


def trial_features(
    frames: SqueezeFrames, geometry: SqueezeGeometry, tracked: Sequence[TrackedImage] = ()
) -> TrialFeatures:
    """The events and features of a squeeze. Raises InputError without a first contact or a steady state.

    tracked: images in which the container was tracked before, in order of time; none = it is tracked in all of them
    Without a camera, or with a bad track, there is no visual feature, but the reason for it."""
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
        return _with_vision(frames, geometry, events, features, tracked)
    except InputError as error:
        return TrialFeatures(events, replace(features, reason=str(error)), tuple(tracked))


def _gaps(hands: Sequence[HandFrame], geometry: SqueezeGeometry, when_ns: Sequence[int]) -> FloatArray:
    """(n,) between the fingertips at these times, straight between the hand's readings [m]."""
    known = np.array([frame_ns(one) for one in hands], np.float64)
    gaps = np.array([gap_m(np.asarray(one.position_deg, np.float64), geometry.hand.fingers) for one in hands])
    return np.asarray(np.interp(np.array(when_ns, np.float64) - known[0], known - known[0], gaps))


def around_px(geometry: SqueezeGeometry) -> tuple[float, float, float, float] | None:
    """Left, top, right and bottom of the part of an image to show: the container at its expected place, and the same
    size around it. Region of the image around the container [px]; None without the camera's pose or projection."""
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


def container_tracker(geometry: SqueezeGeometry) -> ContainerTracker:
    """The tracker for the camera in front of the container. Raises InputError if its projection is unknown."""
    camera = geometry.camera
    if camera.focal_px is None or camera.center_px is None:
        raise InputError("[camera] focal_px and center_px", "none")
    seen_by = Intrinsics(camera.focal_px, camera.center_px, camera.distortion)
    return ContainerTracker(geometry.container, geometry.hand.fingers, seen_by)


class SqueezeImages:
    """The depth images of a squeeze so far, each with the hand's pose. frames: frames in order of time, until the
    fingers open again"""

    def __init__(self, frames: SqueezeFrames, geometry: SqueezeGeometry) -> None:
        """Raises InputError where there is no image, or it is not known where the hand is in them."""
        if not frames.depth:
            raise InputError("depth images of the squeeze", "none")
        if (T_camera_hand := geometry.camera_from_hand(frames)) is None:
            raise InputError("[hand] T_camera_hand, or T_arm_hand and [camera] T_arm_camera", "neither")
        self._T_camera_hand = T_camera_hand
        placed = frames.T_hand_container
        self._T_hand_container = geometry.T_hand_container if placed is None else placed
        self.frames = frames.during(frames.depth)
        self._hands, self._fingers = frames.during(frames.hands), geometry.hand.fingers
        self._hand_ns = np.array([frame_ns(one) for one in self._hands])

    def due(self, first_ns: int) -> range:
        """Indices of the images to track, each after the hand's next reading has arrived. They begin with enough images
        to locate the container, or with the last one before first contact [ns], 0 = not yet."""
        before = sum(frame_ns(one) < first_ns for one in self.frames) if first_ns else REST_IMAGES
        known_ns = self._hand_ns[-1] if len(self._hand_ns) else 0
        known = sum(frame_ns(one) <= known_ns for one in self.frames)
        return range(max(min(before, REST_IMAGES) - 1, 0), known)

    def image(self, at: int, first_ns: int, since_ns: int = 0, together: int = REST_IMAGES) -> ContainerImage:
        """The images up to index `at`, `together` of them at most, as the tracker takes them.

        first_ns: time of first contact, 0 = not known; since_ns: time from which the closing of the fingertips counts,
        default first contact"""
        when_ns = frame_ns(self.frames[at])
        frames = tuple(replace(one, color=None) for one in self.frames[max(at + 1 - together, 0) : at + 1])
        closed_m = 0.0
        if first_ns:
            before, now = (gap_m(self._angles(one), self._fingers) for one in (since_ns or first_ns, when_ns))
            closed_m = max(before - now, 0.0)
        return ContainerImage(
            frames, self._angles(when_ns), self._T_camera_hand, self._T_hand_container, first_ns, closed_m
        )

    def _angles(self, when_ns: int) -> npt.NDArray[np.float64]:
        """(7,) of the hand's last reading then [deg]."""
        at = max(int(np.searchsorted(self._hand_ns, when_ns, side="right")) - 1, 0)
        return np.asarray(self._hands[at].position_deg, np.float64)


def _with_vision(
    frames: SqueezeFrames,
    geometry: SqueezeGeometry,
    events: SqueezeEvents,
    features: SqueezeFeatures,
    tracked: Sequence[TrackedImage],
) -> TrialFeatures:
    """Located before the first contact, tracked from there, compared at the steady state."""
    seen = SqueezeImages(frames, geometry)
    before = [one for one in seen.frames if frame_ns(one) < events.first_interval_ns[0]]
    held = sum(frame_ns(one) < events.steady_ns for one in seen.frames)
    steady = tuple(seen.frames[held : held + STEADY_IMAGES])
    if not before or not steady:
        raise InputError("depth images before first contact and at steady state", f"{len(before)} and {len(steady)}")
    found, tracker = [*tracked], container_tracker(geometry)
    for at in () if tracked else seen.due(events.first_ns):
        found.append(tracker.track(seen.image(at, events.first_ns)).after(math.nan))
        if tracker.rest is None and found[-1].when_ns >= events.first_ns:
            break
    tracker = container_tracker(geometry)
    for one in found:
        if one.when_ns < frame_ns(steady[0]):
            tracker.follow(one)
    if tracker.rest is None or tracker.rest.when_ns > events.first_ns:
        reason = next((one.pose.reason for one in found if not one.pose.good), "not located before first contact")
        return TrialFeatures(events, replace(features, reason=f"before: {reason}"), tuple(found))
    image = seen.image(held, events.first_ns, events.first_interval_ns[0])
    found.append(last := tracker.track_median(image, steady, 0))
    return TrialFeatures(events, _seen_features(features, last), tuple(found), _small_series(found, events))


def _small_series(tracked: Sequence[TrackedImage], events: SqueezeEvents) -> FloatArray | None:
    """(k, 121) the newest small change of depth at each step since first contact."""
    seen = [(one.when_ns, one.measured.small_filled_m) for one in tracked[:-1] if one.measured is not None]
    time_s = np.array([(when_ns - events.first_ns) / 1e9 for when_ns, _ in seen])
    if not seen or time_s[-1] < 0.0:
        return None
    return series_of(time_s, np.stack([small_m for _, small_m in seen]))[1]


def _seen_features(features: SqueezeFeatures, last: TrackedImage) -> SqueezeFeatures:
    if (change := last.measured) is None:
        return replace(features, reason=last.change.reason)
    return replace(
        features,
        vision=change.change_m,
        vision_small=change.small_m,
        missing=change.missing,
        noise_m=change.noise_m,
        patch_px=change.center_px,
        patch_width_m=change.width_m,
    )
