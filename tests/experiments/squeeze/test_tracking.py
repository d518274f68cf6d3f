"""The container is tracked in every image while the hand squeezes it: known motions, what is not observed, what is
refused, how a slow tracker keeps up, and that it is computed again from a recording."""

import dataclasses
import re
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.experiments.squeeze.features import SqueezeGeometry, container_tracker
from deformscope.experiments.squeeze.frames import SqueezeFrames, TactileSource
from deformscope.experiments.squeeze.live import LiveTracking, RecordedTracking, live_tracking
from deformscope.experiments.squeeze.tracking import REST_IMAGES, ContainerImage, TrackedImage
from deformscope.frames import DepthFrame, HandFrame
from deformscope.rig.sections import ContainerSection, HandSection
from deformscope.robot.setup import CameraView
from deformscope.session import Inline
from deformscope.stages.see.cloud import axial_noise_m
from deformscope.stages.squeeze.events import EventRule
from deformscope.stages.squeeze.trial import ContentPosterior
from deformscope_drivers.clock import Stamp
from deformscope_drivers.memory import SimulatedClock
from studies.reproduce.squeeze_truth import pose_error
from tests.stages.squeeze.views import CAMERA, PIXELS, SHAPE, looking, moved

T_CAMERA_HAND = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.1], [1.0, 0.0, 0.0, 0.9], [0.0, 0.0, 0.0, 1.0]])
OPEN_DEG = np.array([90.0, -30.0, 10.0, -70.0, 0.0, -30.0, 10.0])
START_NS, PERIOD_NS, HAND_NS = 1_000_000_000, 33_333_333, 20_000_000
BOX = ContainerSection(size_m=(0.07, 0.09, 0.16))
CYLINDER = ContainerSection(shape="cylinder", size_m=(0.08, 0.08, 0.16))
MS = 1_000_000


class Camera:
    """Images of a container that moves in its own frame, 30 a second, with the noise of such cameras. true: its poses

    step_m, step_deg: from one image to the next"""

    def __init__(
        self,
        section: ContainerSection,
        count: int = 12,
        step_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        step_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.rest = looking(0.9, 25.0, 60.0)
        expected = np.linalg.inv(T_CAMERA_HAND) @ self.rest
        view = CameraView(CAMERA.focal_px, CAMERA.centre_px, rate_hz=30.0)
        self.geometry = SqueezeGeometry(HandSection(), section, view, expected, T_CAMERA_HAND)
        tracker, random = container_tracker(self.geometry), np.random.default_rng(3)
        steps = np.maximum(np.arange(count) - REST_IMAGES + 1, 0)
        self.true = [moved(self.rest, at * np.array(step_m), at * np.array(step_deg)) for at in steps]
        self.frames: list[DepthFrame] = []
        for at, pose in enumerate(self.true):
            depth = tracker.renderer.render(pose, PIXELS).depth_m
            depth = np.where(np.isfinite(depth), depth, 1.3)
            noisy = np.rint(1e4 * (depth + axial_noise_m(depth) * random.normal(size=SHAPE))).astype(np.uint16)
            self.frames.append(DepthFrame(Stamp(START_NS + at * PERIOD_NS), at, noisy, 1e-4, device="camera"))

    def images(self) -> list[ContainerImage]:
        """From the first one on that can be located, each with those before it."""
        ends = range(REST_IMAGES, len(self.frames) + 1)
        return [
            ContainerImage(
                tuple(self.frames[end - REST_IMAGES : end]), OPEN_DEG, T_CAMERA_HAND, self.geometry.T_hand_container
            )
            for end in ends
        ]

    def hide(self, at: int, rows: slice) -> None:
        """Something stands before these rows of an image."""
        depth = self.frames[at].depth.copy()
        depth[rows] = 4000
        self.frames[at] = dataclasses.replace(self.frames[at], depth=depth)


def tracked(camera: Camera) -> list[TrackedImage]:
    tracker = container_tracker(camera.geometry)
    return [tracker.track(image) for image in camera.images()]


@pytest.mark.parametrize("section", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_known_motions_are_found_in_every_image_within_a_millimetre_and_a_degree(section: ContainerSection) -> None:
    camera = Camera(section, 14, (0.0006, -0.0004, 0.0005), (0.3, 0.0, 0.3))
    found = tracked(camera)
    assert [one.container.index for one in found] == list(range(REST_IMAGES - 1, 14))
    for one, true in zip(found, camera.true[REST_IMAGES - 1 :], strict=True):
        assert one.container.good, one.container.reason
        error = pose_error(one.pose, true)
        assert error.shift_m < 0.001
        assert error.turn_deg < 1.0


def test_the_turn_of_a_cylinder_about_its_axis_is_said_not_to_be_observed() -> None:
    camera = Camera(CYLINDER, step_deg=(0.0, 0.0, 2.0))
    found = tracked(camera)
    assert {one.container.degrees for one in found} == {"5 of 6 observed, not rotation about z"}
    last = found[-1].container
    assert last.directions is not None
    np.testing.assert_array_equal(last.observed, last.deviation_m < 0.001)
    turn = Rotation.from_matrix(camera.rest[:3, :3].T @ last.T_camera_container[:3, :3]).as_rotvec(degrees=True)
    assert abs(turn[2]) < 0.5  # it keeps the rest pose, where the container has turned by 14 degrees
    box = Camera(BOX, REST_IMAGES)
    assert container_tracker(box.geometry).track(box.images()[0]).container.degrees == "6 of 6 observed"


def test_a_hidden_image_is_refused_with_its_reason_and_the_next_one_is_tracked_again() -> None:
    camera = Camera(BOX, 8, (0.0005, 0.0, 0.0))
    camera.hide(6, slice(None))
    found = tracked(camera)
    assert [one.container.good for one in found] == [True, True, False, True]
    hidden = found[2]
    assert "of the container seen, 150 needed" in hidden.container.reason
    assert hidden.change.change_m is None
    assert hidden.change.reason == hidden.container.reason
    assert pose_error(found[3].pose, camera.true[7]).shift_m < 0.001


def test_a_jump_is_refused() -> None:
    camera = Camera(BOX, 7, (0.0, 0.0, 0.0))
    far = Camera(BOX, REST_IMAGES + 1, (0.0, 0.018, 0.0)).frames[-1]
    camera.frames[-1] = dataclasses.replace(far, index=6, stamp=camera.frames[-1].stamp)
    found = tracked(camera)
    assert [one.container.good for one in found] == [True, True, False]
    assert re.fullmatch(r"a jump of 1\d mm from the pose before, 10 mm at most", found[2].container.reason)


def test_the_change_of_depth_around_the_fingertip_is_data_minus_model() -> None:
    camera = Camera(BOX, 6)
    tracker, (rest, dented) = container_tracker(camera.geometry), camera.images()
    before = tracker.track(rest)
    depth = dented.frames[-1].depth.copy()
    assert before.change.center_px is not None
    left, top = (before.change.center_px - 8).astype(int)
    depth[top : top + 16, left : left + 16] += 60  # 6 mm
    pressed = dataclasses.replace(dented.frames[-1], depth=depth)
    image = dataclasses.replace(dented, frames=(*dented.frames[:-1], pressed), first_ns=START_NS, closed_m=0.02)
    after = tracker.track(image).change
    middle = slice(26, 35), slice(26, 35)
    assert np.nanmedian(before.change.change_m[middle]) == pytest.approx(0.0, abs=0.0007)
    assert np.nanmedian(after.change_m[middle]) == pytest.approx(0.006, abs=0.0007)
    assert after.since_s == pytest.approx(5 * PERIOD_NS / 1e9)
    assert np.isnan(before.change.since_s)


class Slow(Executor):
    """Is done with what it was given when it is told so."""

    def __init__(self) -> None:
        self.given: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.given.append((Future(), lambda: fn(*args, **kwargs)))
        return self.given[-1][0]

    def be_done(self) -> None:
        """The next of what was not given up."""
        future, call = self.given.pop(0)
        if not future.set_running_or_notify_cancel():
            return self.be_done()
        try:
            future.set_result(call())
        except RuntimeError as error:
            future.set_exception(error)


class Squeeze:
    """Frames of a squeeze that come in time order, and what tracks beside them."""

    def __init__(self, camera: Camera, executor: Executor, job: Any = None) -> None:
        self.camera, self.clock = camera, SimulatedClock(START_NS)
        self.frames = SqueezeFrames(TactileSource("pads", (0, 1), (0.0034, 0.0034)), "hand", "camera", EventRule())
        self.frames.air_ns = START_NS
        track = job or container_tracker(camera.geometry).track
        self.tracking = LiveTracking(self.frames, camera.geometry, executor, track, self.clock)
        self.indices: list[int] = []

    def until(self, now_ns: int) -> None:
        """All that the devices gave until then."""
        every: list[DepthFrame | HandFrame] = [*self.camera.frames]
        for at in range(60):
            stamp = Stamp(START_NS + at * HAND_NS)
            every.append(HandFrame(stamp, at, OPEN_DEG, np.zeros(7), np.zeros(9), ("idle",) * 7))
        for item in sorted(every, key=lambda one: one.stamp.host_ns):
            if self.clock() < item.stamp.host_ns <= now_ns or (item.stamp.host_ns == self.clock() == START_NS):
                self.frames.add(item, 0)
        self.clock.advance_to(now_ns)
        self.indices += [one.container.index for one in self.tracking.go_on(0)]


def test_what_keeps_up_tracks_every_image_and_says_how_old_it_is() -> None:
    squeeze = Squeeze(Camera(BOX, 12), Inline())
    for at in range(1, 6):
        squeeze.until(START_NS + 100 * at * MS)
    assert squeeze.indices == list(range(REST_IMAGES - 1, 12))
    found = squeeze.tracking.found
    assert {one.container.skipped for one in found} == {0}
    lags_s = [one.container.lag_s for one in found]
    ends_ns = [START_NS + 100 * MS * -(-(one.when_ns - START_NS) // (100 * MS)) for one in found]
    assert lags_s[0] == pytest.approx((200 * MS - 4 * PERIOD_NS) / 1e9)
    assert lags_s == pytest.approx([(end - one.when_ns) / 1e9 for end, one in zip(ends_ns, found, strict=True)])


def test_what_does_not_keep_up_takes_the_newest_image_and_says_how_many_it_left_out() -> None:
    executor = Slow()
    squeeze = Squeeze(Camera(BOX, 20), executor)
    executor.be_done()  # it has begun
    squeeze.until(START_NS + 180 * MS)  # image 4, and 5 whose reading of the hand is known
    executor.be_done()
    squeeze.until(START_NS + 200 * MS)
    assert squeeze.indices == [4]
    assert squeeze.tracking.found[0].container.lag_s == pytest.approx(0.2 - 4 * PERIOD_NS / 1e9)
    squeeze.until(START_NS + 500 * MS)  # image 5 is too old by now
    executor.be_done()
    squeeze.until(START_NS + 520 * MS)
    assert squeeze.indices == [4, 15]
    last = squeeze.tracking.found[-1].container
    assert last.skipped == 10
    assert last.lag_s == pytest.approx(0.520 - 15 * PERIOD_NS / 1e9)
    assert len([one for one, _ in executor.given if not one.cancelled()]) == 0


def test_a_tracker_that_breaks_says_why_and_nothing_waits_for_it() -> None:
    def broken(image: Any) -> Any:
        raise RuntimeError("the process has ended")

    executor = Slow()
    squeeze = Squeeze(Camera(BOX, 8), executor, broken)
    executor.be_done()
    squeeze.until(START_NS + 220 * MS)
    executor.be_done()
    squeeze.until(START_NS + 230 * MS)
    assert "the process has ended" in squeeze.tracking.failed
    assert squeeze.tracking.waiting is None
    assert all(one.cancelled() for one, _ in executor.given)
    before = len(executor.given)
    squeeze.until(START_NS + 300 * MS)
    assert len(executor.given) == before


def test_the_images_that_were_tracked_are_tracked_again_to_the_last_bit() -> None:
    executor = Slow()
    squeeze = Squeeze(Camera(BOX, 20, (0.0004, 0.0, 0.0003), (0.1, 0.0, 0.2)), executor)
    for at in range(1, 9):  # an image takes 0.1 s, three come meanwhile
        squeeze.until(START_NS + 100 * at * MS)
        if executor.given:
            executor.be_done()
    while executor.given:
        executor.be_done()
        squeeze.until(squeeze.clock() + MS)
    live = squeeze.tracking.found
    assert 3 <= len(live) < 16
    assert any(one.container.skipped for one in live)
    posterior = ContentPosterior(0.1, "tactile and vision_small", ("a", "b"), np.ones(2) / 2, 7, live[1].change.index)
    again = RecordedTracking(squeeze.frames, squeeze.camera.geometry, [one.container for one in live], [posterior])
    for before, now in zip(live, again.found, strict=True):
        for part in ("container", "change"):
            one, other = (dataclasses.asdict(getattr(each, part)) for each in (before, now))
            np.testing.assert_equal(one, other)
    assert again.newest(7, 0) is again.found[1].change
    assert again.newest(8, 0) is None


def test_an_old_change_of_depth_says_nothing_of_now() -> None:
    squeeze = Squeeze(Camera(BOX, 6), Inline())
    squeeze.until(START_NS + 300 * MS)
    last_ns = squeeze.tracking.found[-1].when_ns
    assert squeeze.tracking.newest(0, last_ns + 400 * MS) is squeeze.tracking.found[-1].change
    assert squeeze.tracking.newest(0, last_ns + 600 * MS) is None


def test_a_camera_that_cannot_be_modelled_is_said_at_once_and_nothing_is_tracked() -> None:
    squeeze = Squeeze(Camera(BOX, 1), Inline())
    geometry = squeeze.camera.geometry
    for view, why in (
        (dataclasses.replace(geometry.camera, focal_px=None), "focal_px and center_px"),
        (dataclasses.replace(geometry.camera, distortion=(0.1, 0.0)), "a camera without distortion"),
    ):
        told = dataclasses.replace(geometry, camera=view)
        with live_tracking(squeeze.frames, told, squeeze.clock, real_time=True) as tracking:
            assert why in tracking.failed
            assert tracking.waiting is None
            assert list(tracking.go_on(0)) == []
