"""The container tracked during the squeeze, outside the loop, and the recorded tracks in a replay."""

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from typing import Any

from deformscope.errors import InputError
from deformscope.experiments.squeeze.features import SqueezeGeometry, SqueezeImages, container_tracker
from deformscope.experiments.squeeze.frames import SqueezeFrames, Tracking, frame_ns
from deformscope.experiments.squeeze.tracking import REST_IMAGES, ContainerImage, ContainerTracker, TrackedImage
from deformscope.processes import computing
from deformscope.session import Inline, with_costs
from deformscope.stages.squeeze.trial import ContainerChange, ContentPosterior, TrackedContainer

BEHIND_S = 0.25
"""Largest delay of an image, after which all except the newest one are left out. Devices' items come every 0.1 s."""
FRESH_S = 0.5
"""Age of a change of depth from which it does not describe the present."""

_tracker: ContainerTracker | None = None


@contextlib.contextmanager
def live_tracking(
    frames: SqueezeFrames, geometry: SqueezeGeometry, clock: Callable[[], int], *, real_time: bool
) -> Iterator[Tracking]:
    """The tracker: a process of low priority for devices on their own clock, else within the loop. None without a
    camera, or if camera or container have no model; `failed` then has the reason."""
    frames.all_images, none, tracker = True, Tracking(), None
    try:
        tracker = container_tracker(geometry) if frames.camera else None
    except InputError as error:
        none.failed = str(error)
    if tracker is None:
        yield none
    elif real_time:
        with computing(_begin, geometry) as executor:
            yield LiveTracking(frames, geometry, executor, _track, clock)
    else:
        yield LiveTracking(frames, geometry, Inline(), tracker.track, clock)


def _begin(geometry: SqueezeGeometry) -> None:
    """In the process, first of all."""
    global _tracker
    _tracker = container_tracker(geometry)


def _track(image: ContainerImage) -> TrackedImage:
    assert _tracker is not None
    return _tracker.track(image)


class LiveTracking(Tracking):
    """Tracks the images of a squeeze in their order while they come; if it is too slow, only the newest one."""

    def __init__(
        self,
        frames: SqueezeFrames,
        geometry: SqueezeGeometry,
        executor: Executor,
        job: Callable[[ContainerImage], TrackedImage],
        clock: Callable[[], int],
    ) -> None:
        super().__init__()
        self._frames, self._geometry, self._executor, self._job, self._clock = frames, geometry, executor, job, clock
        self.waiting = executor.submit(bool)  # a process takes seconds to begin
        self._asked: deque[tuple[Future[Any], int]] = deque([(self.waiting, 0)])
        self._newest_ns = self._skipped = 0

    def go_on(self, first_ns: int) -> Sequence[TrackedImage]:
        """Begin to track the images that have arrived."""
        known = self._known()
        try:
            self._ask(first_ns)
        except (InputError, RuntimeError) as error:  # a process that has ended is a RuntimeError
            self._fail(str(error))
        known += self._known()
        self.waiting = self._asked[-1][0] if self._asked else None
        return known

    def newest(self, tactile_index: int, now_ns: int) -> ContainerChange | None:
        """The last change of depth, unless it is old."""
        fresh = (one.change for one in reversed(self.found) if now_ns - one.when_ns <= FRESH_S * 1e9)
        return next((one for one in fresh if one.small_m is not None), None)

    def _known(self) -> list[TrackedImage]:
        known: list[TrackedImage] = []
        while self._asked and self._asked[0][0].done():
            done, _ = self._asked.popleft()
            if done.cancelled():
                self._skipped += 1
            elif (error := done.exception()) is not None:
                self._fail(f"{type(error).__name__}: {error}")
            elif done.result():
                one, costs = done.result()
                known.append(one.after((self._clock() - one.when_ns) / 1e9, self._skipped, tuple(costs)))
                self._skipped = 0
        self.found += known
        return known

    def _fail(self, why: str) -> None:
        self.failed = why
        while self._asked:
            self._asked.pop()[0].cancel()

    def _ask(self, first_ns: int) -> None:
        if self.failed or not self._frames.air_ns or not self._frames.depth:
            return
        seen = SqueezeImages(self._frames, self._geometry)
        together = 1 if any(one.pose.good for one in self.found) else REST_IMAGES
        for at in seen.due(first_ns):
            if (when_ns := frame_ns(seen.frames[at])) > self._newest_ns:
                self._newest_ns, image = when_ns, seen.image(at, first_ns, together=together)
                self._asked.append((self._executor.submit(with_costs, "track", self._job, image), when_ns))
        oldest_ns = next((when_ns for _, when_ns in self._asked if when_ns), self._clock())
        if self._clock() - oldest_ns > BEHIND_S * 1e9:
            for one, _ in list(self._asked)[:-1]:
                one.cancel()  # unless it has begun


class RecordedTracking(Tracking):
    """Tracking in a replay: the tracked images are tracked again, each from the information of its time. The median at
    the steady state does not count as an image."""

    def __init__(
        self,
        frames: SqueezeFrames,
        geometry: SqueezeGeometry,
        containers: Sequence[TrackedContainer],
        posteriors: Sequence[ContentPosterior],
    ) -> None:
        """frames: all of them; containers, posteriors: as they were recorded"""
        super().__init__()
        self._of = {one.index: one.vision_index for one in posteriors if one.index >= 0}
        if not containers:
            return
        seen, tracker, first_ns, steady_ns = SqueezeImages(frames, geometry), container_tracker(geometry), 0, 0
        with contextlib.suppress(InputError):  # it was stopped before there were enough frames
            first_ns, steady_ns = (events := frames.events()).first_ns, events.steady_ns
        places = {one.index: at for at, one in enumerate(seen.frames)}
        for before in containers:
            at = places.get(before.index)  # None = lost: it is missed where results are compared
            if at is None or (before.lag_s is None and frame_ns(seen.frames[at]) >= steady_ns):
                continue
            one = tracker.track(seen.image(at, 0 if math.isnan(before.since_s) else first_ns))
            self.found.append(one if before.lag_s is None else one.after(before.lag_s, before.skipped or 0))

    def newest(self, tactile_index: int, now_ns: int) -> ContainerChange | None:
        """The tracked image to which the recorded posterior belongs."""
        wanted = self._of.get(tactile_index)
        return next((one.change for one in self.found if one.change.index == wanted), None)
