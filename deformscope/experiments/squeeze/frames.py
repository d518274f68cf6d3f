"""Device items of a squeeze, stored for its features in the same way during a run and in a replay."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.experiments.squeeze.tracking import TrackedImage
from deformscope.frames import ArmFrame, DepthFrame, Frame, HandFrame, Item, PadLayout, Stream, TactileFrame
from deformscope.robot.squeeze_plan import CLOSING_AXES
from deformscope.session import Moment, SessionRecorder, Step, measuring, with_costs
from deformscope.stages.see.tactile import tactile_contact
from deformscope.stages.squeeze.events import EventRule, OnsetDetector, SqueezeEvents, squeeze_events
from deformscope.stages.squeeze.patch import filled
from deformscope.stages.squeeze.physical import End, tactile_feature
from deformscope.stages.squeeze.trial import ContainerChange, ContentPosterior, FingertipPressure

BEFORE_S = 1.0
"""Depth images are stored from this long before the first contact."""
AIR, OPEN = "air", "open"
"""The phases in which the open fingertips are in the air, at rest, and in which they open again."""
POSTERIOR_S = 0.1
"""Period of computing the posterior."""

FrameT = TypeVar("FrameT", TactileFrame, HandFrame, DepthFrame)

Predict = Callable[[float, Mapping[str, FloatArray]], tuple[str, tuple[str, ...], FloatArray]]
"""Predicts from a time since first contact [s] and the features then, by modality: (72,) `tactile` and, if known,
(121,) `vision_small`. Returns the modalities used, labels, and probabilities (k,)."""


@dataclass(frozen=True, slots=True)
class TactileSource:
    """The squeezing fingertips among a device's pads. pads: their places among them; texel_m: (width, height) [m]"""

    device: str
    pads: tuple[int, ...]
    texel_m: tuple[float, float]

    @classmethod
    def of(cls, streams: Sequence[Stream], device: str, fingers: Sequence[int]) -> "TactileSource":
        """Raises InputError if the device lacks such pads."""
        known = next(stream.pads for stream in streams if stream.device == device and stream.kind == "tactile")
        places = [_distal(known, finger, device) for finger in fingers]
        return cls(device, tuple(places), known[places[0]].texel_m)

    def counts(self, frame: TactileFrame) -> list[IntArray]:
        """(rows, columns) of each fingertip."""
        sizes = np.cumsum([0, *(pad.size for pad in frame.pressure_pa)])
        return [frame.counts[sizes[at] : sizes[at + 1]].reshape(frame.pressure_pa[at].shape) for at in self.pads]

    def pressure_pa(self, frame: TactileFrame) -> list[FloatArray]:
        """(rows, columns) of each fingertip [Pa]."""
        return [frame.pressure_pa[at] for at in self.pads]


def _distal(pads: Sequence[PadLayout], finger: int, device: str) -> int:
    for pad in pads:
        if pad.finger == finger and pad.part == 1:
            return pad.index
    raise InputError(f"a fingertip array of finger {finger}", f"{len(pads)} others", where=device)


@dataclass
class SqueezeFrames:
    """Frames of one squeeze, in the order in which they came. air_ns: time from which the open fingertips were in the
    air, at rest; open_ns: when they opened again, after which no frame is used; 0 = not yet
    arm: last state of the arm that carries the hand, before the squeeze; arm_now: its newest
    T_hand_container: (4, 4) pose of the container where an arm has placed the hand [m]; None: as in the setup
    all_images: depth images are stored from `air_ns`, even long before the first contact"""

    tactile_source: TactileSource
    hand: str
    camera: str
    rule: EventRule
    air_ns: int = 0
    open_ns: int = 0
    tactile: list[TactileFrame] = field(default_factory=list)
    hands: list[HandFrame] = field(default_factory=list)
    depth: list[DepthFrame] = field(default_factory=list)
    arm: ArmFrame | None = None
    arm_now: ArmFrame | None = None
    T_hand_container: FloatArray | None = None
    all_images: bool = False

    def add(self, item: Item, first_ns: int) -> None:
        """Store the items of its devices. first_ns: time of the first contact, 0 = not yet"""
        if isinstance(item, TactileFrame) and item.device == self.tactile_source.device:
            self.tactile.append(item)
        elif isinstance(item, HandFrame) and item.device == self.hand:
            self.hands.append(item)
        elif isinstance(item, ArmFrame):
            self.arm_now = item
            if not self.air_ns or item.stamp.host_ns < self.air_ns:
                self.arm = item
        elif isinstance(item, DepthFrame) and item.device == self.camera:
            self.depth.append(item)
            oldest_ns = item.stamp.host_ns - BEFORE_S * 1e9
            oldest_ns = min(oldest_ns, self.air_ns) if self.all_images and self.air_ns else oldest_ns
            while not first_ns and self.depth[0].stamp.host_ns < oldest_ns:
                self.depth.pop(0)

    def during(self, frames: Sequence[FrameT]) -> list[FrameT]:
        """The frames from the time when the fingertips were in the air until they opened, in order of time."""
        until_ns = self.open_ns or np.inf
        return sorted((one for one in frames if self.air_ns <= frame_ns(one) < until_ns), key=frame_ns)

    def events(self) -> SqueezeEvents:
        """First contact and steady state, from all frames since the command to close, in order of time."""
        tactile, hands = self.during(self.tactile), self.during(self.hands)
        sums = [[float(pad.sum(dtype=np.int64)) for pad in self.tactile_source.counts(one)] for one in tactile]
        return squeeze_events(
            np.array([frame_ns(one) for one in tactile], np.int64),
            np.array(sums).reshape(len(tactile), len(self.tactile_source.pads)),
            np.array([frame_ns(one) for one in hands], np.int64),
            np.array([one.position_deg[list(CLOSING_AXES)] for one in hands]).reshape(len(hands), len(CLOSING_AXES)),
            self.rule,
        )


def frame_ns(frame: Frame) -> int:
    """Arrival of a frame, on the host's clock [ns]."""
    return frame.stamp.host_ns


class Tracking:
    """The tracker of the container (`deformscope.experiments.squeeze.live`); this class does not track.

    found: all tracked poses; failed: why tracking stopped, or empty; waiting: the last image that is being computed"""

    waiting: Future[Any] | None = None

    def __init__(self) -> None:
        self.found: list[TrackedImage] = []
        self.failed = ""

    def go_on(self, first_ns: int) -> Sequence[TrackedImage]:
        """New results since the last call. first_ns: time of first contact, 0 = not yet"""
        return ()

    def newest(self, tactile_index: int, now_ns: int) -> ContainerChange | None:
        """The change of depth that is known with a tactile frame."""
        return None


class SqueezeObserver:
    """Receives device items in order of time, stores them for the features, and computes results for the views of each
    frame.

    predict: computes a model's posterior from the features so far, None = no model; tracking: may be set. The results
    are functions of the frames, of the time when the fingers opened in the air (`phase`), and of the images tracked by
    each time. All of them are recorded, so that a replay gives the same results."""

    def __init__(self, frames: SqueezeFrames, end: End, predict: Predict | None) -> None:
        self.frames, self.tracking = frames, Tracking()
        self._end, self._predict = end, predict
        self._onset = OnsetDetector(frames.rule)
        self._shown_s = -np.inf
        self.latest: ContentPosterior | None = None

    def phase(self, name: str, now_ns: int) -> None:
        """Note that the hand begins a phase."""
        if name == AIR:
            self.frames.air_ns = now_ns
        elif name == OPEN:
            self.frames.open_ns = now_ns

    def observe(self, item: Item) -> Step | None:
        """Add an item, and return its view, None = nothing."""
        self.frames.add(item, self._onset.first_ns)
        if isinstance(item, TactileFrame) and item.device == self.frames.tactile_source.device:
            results, costs = with_costs("fingertips", self._pressures, item)
            return Step(results, moment=Moment(item.stamp.host_ns), costs=tuple(costs))
        return None

    def tracked(self) -> list[Step]:
        """The present view of the container; tracking of the arrived images begins."""
        known = self.tracking.go_on(self._onset.first_ns)
        return [Step((one.container, one.change), moment=Moment(one.when_ns), costs=one.costs) for one in known]

    def _pressures(self, frame: TactileFrame) -> tuple[object, ...]:
        source = self.frames.tactile_source
        counts = source.counts(frame)
        results: list[object] = [fingertip_pressure(frame, source)]
        now_ns, air_ns, open_ns = frame.stamp.host_ns, self.frames.air_ns, self.frames.open_ns
        if not air_ns or now_ns < air_ns or (open_ns and now_ns >= open_ns):
            return tuple(results)
        self._onset.feed(now_ns, np.array([float(pad.sum(dtype=np.int64)) for pad in counts]))
        since_s = (now_ns - self._onset.first_ns) / 1e9
        if self._predict is None or not self._onset.first_ns or since_s - self._shown_s < POSTERIOR_S:
            return tuple(results)
        self._shown_s = since_s
        change = self.tracking.newest(frame.index, now_ns)
        known: dict[str, FloatArray] = {"tactile": tactile_feature(counts, self._end)}
        if change is not None and change.small_m is not None:
            known["vision_small"] = filled(change.small_m).ravel()
        with measuring("posterior"):
            named, labels, probability = self._predict(since_s, known)
        seen = change.index if change is not None and "vision_small" in named else None
        self.latest = ContentPosterior(since_s, named, labels, probability, frame.index, seen)
        return (*results, self.latest)


class ObservedRecorder:
    """A recorder that passes all device items to an observer, in recorded order, and then records the observer's
    views."""

    def __init__(self, recorder: SessionRecorder, observer: SqueezeObserver) -> None:
        self._recorder, self._observer = recorder, observer

    def write(self, items: object) -> None:
        """See `Recorder.write`."""
        self._recorder.write(items)
        if isinstance(items, Sequence):
            tracked = self._observer.tracked()
            steps = [self._observer.observe(one) for one in items if isinstance(one, Item)]
            for step in (*tracked, *filter(None, steps), *self._observer.tracked()):
                self._recorder.write(step)


def fingertip_pressure(frame: TactileFrame, source: TactileSource) -> FingertipPressure:
    """Centre, orientation, force and area of each fingertip's pressure."""
    from deformscope.stages.squeeze.physical import pressure_axis

    pressures = source.pressure_pa(frame)
    contact = tactile_contact(pressures, [source.texel_m] * len(pressures))
    axes = [pressure_axis(pressure, source.texel_m) for pressure in pressures]
    return FingertipPressure(
        frame.index,
        contact.center_m,
        np.array([angle for angle, _ in axes]),
        np.array([elongation for _, elongation in axes]),
        contact.force_n,
        contact.area_m2,
    )
