"""The container tracked while the hand squeezes it, beside the loop, and what was tracked when it is replayed."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from typing import Any

from deformscope.errors import InputError
from deformscope.experiments.squeeze_features import SqueezeGeometry, SqueezeImages, container_sight, track_images
from deformscope.experiments.squeeze_frames import SqueezeFrames, frame_ns
from deformscope.experiments.squeeze_tracking import ContainerImage, ContainerSight, PoseChain, TrackedImage
from deformscope.processes import computing
from deformscope.session import Inline
from deformscope.stages.squeeze.trial import ContainerChange, ContentPosterior, TrackedContainer

BEHIND_S = 0.25
"""Where an image waits for longer than this, all but the newest one are left out. Devices' items come every 0.1 s."""
FRESH_S = 0.5
"""A change of depth that is older says nothing of now."""

Job = Callable[[PoseChain | None, Sequence[ContainerImage]], tuple[PoseChain | None, tuple[TrackedImage, ...]]]

_sight: ContainerSight | None = None


@contextlib.contextmanager
def live_tracking(
    frames: SqueezeFrames, geometry: SqueezeGeometry, clock: Callable[[], int], *, real_time: bool
) -> Iterator[LiveTracking | None]:
    """What tracks: a process of low priority beside devices that go on by themselves, else within the loop. None where
    there is no camera, or its projection is not known."""
    frames.all_images = True
    if not frames.camera or geometry.camera.focal_px is None or geometry.camera.center_px is None:
        yield None
    elif real_time:
        with computing(_begin, geometry) as executor:
            yield LiveTracking(frames, geometry, executor, _track, clock)
    else:
        sight = container_sight(geometry)
        yield LiveTracking(frames, geometry, Inline(), lambda chain, images: track_images(sight, chain, images), clock)


def _begin(geometry: SqueezeGeometry) -> None:
    """In the process, first of all."""
    global _sight
    _sight = container_sight(geometry)


def _track(
    chain: PoseChain | None, images: Sequence[ContainerImage]
) -> tuple[PoseChain | None, tuple[TrackedImage, ...]]:
    assert _sight is not None
    return track_images(_sight, chain, images)


class LiveTracking:
    """Has the images of a squeeze tracked in their order as they come; when it does not keep up, the newest one.

    found: all that was tracked; waiting: what is being computed; failed: why it does not go on, or empty
    """

    def __init__(
        self, frames: SqueezeFrames, geometry: SqueezeGeometry, executor: Executor, job: Job, clock: Callable[[], int]
    ) -> None:
        self.found: list[TrackedImage] = []
        self.failed = ""
        self._frames, self._geometry, self._executor, self._job, self._clock = frames, geometry, executor, job, clock
        self._chain: PoseChain | None = None
        self.waiting: Future[Any] | None = executor.submit(job, None, ())  # it takes seconds to begin
        self._asked_ns = self._skipped = 0

    def go_on(self, first_ns: int) -> Sequence[TrackedImage]:
        """What has become known since the last call; what came meanwhile is begun with. first_ns: of first contact, 0 =
        not yet"""
        known = self._known()
        try:
            self._begin(first_ns)
        except (InputError, RuntimeError) as error:  # a process that has ended is a RuntimeError
            self.failed = str(error)
        return [*known, *self._known()]

    def newest(self, tactile_index: int, now_ns: int) -> ContainerChange | None:
        """The last change of depth that is known, unless it is old. now_ns: of the tactile frame of this index"""
        seen = (one for one in reversed(self.found) if one.change.small_m is not None)
        last = next(seen, None)
        return None if last is None or now_ns - last.when_ns > FRESH_S * 1e9 else last.change

    def _known(self) -> list[TrackedImage]:
        if self.waiting is None or not self.waiting.done():
            return []
        done, self.waiting = self.waiting, None
        if (error := done.exception()) is not None:
            self.failed = f"{type(error).__name__}: {error}"
            return []
        self._chain, tracked = done.result()
        now_ns, skipped = self._clock(), (self._skipped, *[0] * len(tracked))
        known = [
            one.after((now_ns - one.when_ns) / 1e9, left_out) for one, left_out in zip(tracked, skipped, strict=False)
        ]
        self.found += known
        return known

    def _begin(self, first_ns: int) -> None:
        if self.waiting is not None or self.failed or not self._frames.air_ns or not self._frames.depth:
            return
        seen = SqueezeImages(self._frames, self._geometry)
        places = [at for at in seen.due(first_ns) if frame_ns(seen.frames[at]) > self._asked_ns]
        if not places:
            return
        behind = self._clock() - frame_ns(seen.frames[places[0]]) > BEHIND_S * 1e9
        chosen = places[-1:] if behind else places
        self._skipped, self._asked_ns = len(places) - len(chosen), frame_ns(seen.frames[chosen[-1]])
        images = [seen.image(at, first_ns) for at in chosen]
        self.waiting = self._executor.submit(self._job, self._chain or seen.chain, images)


class RecordedTracking:
    """The same from a recording: the images that were tracked are tracked again, each from what was known then.

    found: all that was tracked; the median at the steady state is no image
    """

    def __init__(
        self,
        frames: SqueezeFrames,
        geometry: SqueezeGeometry,
        containers: Sequence[TrackedContainer],
        posteriors: Sequence[ContentPosterior],
    ) -> None:
        """frames: all of them; containers, posteriors: as they were recorded"""
        self.found: list[TrackedImage] = []
        self.failed = ""
        self.waiting: Future[Any] | None = None
        self._of = {one.index: one.vision_index for one in posteriors if one.index >= 0}
        if not containers:
            return
        seen, sight, first_ns, steady_ns = SqueezeImages(frames, geometry), container_sight(geometry), 0, 0
        with contextlib.suppress(InputError):  # it was stopped before there were enough frames
            first_ns, steady_ns = (events := frames.events()).first_ns, events.steady_ns
        places, chain = {one.index: at for at, one in enumerate(seen.frames)}, seen.chain
        for before in containers:
            if (at := places.get(before.index)) is None:  # lost: it is missed where results are compared
                continue
            if before.lag_s is None and frame_ns(seen.frames[at]) >= steady_ns:
                continue
            chain, one = sight.track(chain, seen.image(at, 0 if math.isnan(before.since_s) else first_ns))
            self.found.append(one if before.lag_s is None else one.after(before.lag_s, before.skipped or 0))

    def go_on(self, first_ns: int) -> Sequence[TrackedImage]:
        """Nothing becomes known: all is."""
        return ()

    def newest(self, tactile_index: int, now_ns: int) -> ContainerChange | None:
        """The change that the recorded posterior is of."""
        wanted = self._of.get(tactile_index)
        return next((one.change for one in self.found if one.change.index == wanted), None)
