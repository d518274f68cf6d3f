"""A replay of a squeeze from its recorded tactile frames, angles and depth images. All results (pressures, events,
tracked container, features, posteriors) are computed again and must be equal to the last bit."""

import dataclasses
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.errors import InputError
from deformscope.runs.replay_result import Different, ReplayResult, compare

if TYPE_CHECKING:
    from deformscope.experiments.squeeze.features import SqueezeGeometry, TrialFeatures
    from deformscope.recording.reader import Replay
    from deformscope.stages.squeeze.model import ContentModel
    from deformscope.stages.squeeze.placement import ContainerSighting


@dataclasses.dataclass
class SqueezeAgain:
    """Results of a recorded squeeze, computed again. features: None without features; `failure` states why

    results: results of every kind, in the order in which they are computed"""

    results: list[object] = dataclasses.field(default_factory=list)
    features: "TrialFeatures | None" = None
    failure: str = ""


def replay_squeeze(recording: "Replay") -> ReplayResult:
    """Compute and compare; raises Different."""
    from deformscope.recording.items import read_results
    from deformscope.stages.squeeze.trial import SqueezeStop

    path = recording.path
    again = squeeze_again(recording)
    kinds = tuple(dict.fromkeys(map(type, again.results)))
    stops = [one.item for one in read_results(path, (SqueezeStop,), trust=True)]
    compared = 0
    for kind in kinds:
        before = _by_frame([one.item for one in read_results(path, (kind,), trust=True)])
        now = _by_frame([one for one in again.results if type(one) is kind])
        last = max(before, default=(-1, 0))
        within = [now[frame] for frame in sorted(now) if frame in before or frame <= last]
        compare([before[frame] for frame in sorted(before)], within, path, what=kind.__name__)
        compared += len(before)
    if again.failure and not stops:
        raise Different("the recorded features", again.failure, where=path)
    counted = ", ".join(kind.__name__ for kind in kinds)
    return ReplayResult(
        {"results": compared, "identical": True, "stopped": stops},
        verdict=f"replay: {compared} results from raw frames ({counted}), identical to the recorded numbers",
        notes=tuple(f"stopped during the recording: {stop.kind}: {stop.reason}" for stop in stops),
    )


def _by_frame(results: list[Any]) -> dict[tuple[int, int], Any]:
    """Results by their frame, or by their order, and their count before it; the median of several is the last. Items
    after the hand had opened were recorded, but not evaluated: recorded results may be fewer at the end."""
    counted: defaultdict[int, Iterator[int]] = defaultdict(count)
    of = [getattr(one, "index", order) for order, one in enumerate(results)]
    return {(frame, next(counted[frame])): one for frame, one in zip(of, results, strict=True)}


def squeeze_again(recording: "Replay") -> SqueezeAgain:
    """All results of a recorded squeeze, computed from its raw frames. Raises InputError if it is no such recording, or
    a phase is missing."""
    import msgspec

    from deformscope.experiments.squeeze.features import SqueezeGeometry, trial_features
    from deformscope.experiments.squeeze.frames import SqueezeFrames, SqueezeObserver, TactileSource
    from deformscope.experiments.squeeze.live import RecordedTracking
    from deformscope.experiments.squeeze.placing import posterior_of
    from deformscope.frames import ArmFrame, DepthFrame, HandFrame, TactileFrame
    from deformscope.recording.items import read_results, read_streams
    from deformscope.recording.reader import read_rows
    from deformscope.runs.squeeze_run import final_posterior, step_posterior
    from deformscope.stages.squeeze.events import EventRule
    from deformscope.stages.squeeze.placement import HandPlacement
    from deformscope.stages.squeeze.trial import ContentPosterior, SqueezePhase, TrackedContainer

    squeezed, path = recording.settings["squeezed"], recording.path
    geometry = SqueezeGeometry.from_json(squeezed["geometry"])
    names = squeezed["names"]
    source = TactileSource.of(read_streams(path, trust=True), names["tactile"], geometry.hand.fingers)
    frames, every = (
        SqueezeFrames(source, names["hand"], names["camera"], msgspec.convert(squeezed["rule"], EventRule))
        for _ in range(2)
    )
    model = _recorded_model(recording)
    rows = list(read_rows(recording, (SqueezePhase, TactileFrame, HandFrame, DepthFrame, ArmFrame)))
    start_ns = next(
        (row.item.stamp.host_ns - row.session_ns for row in rows if not isinstance(row.item, SqueezePhase)), 0
    )
    containers, posteriors = (
        [one.item for one in read_results(path, (kind,), trust=True)] for kind in (TrackedContainer, ContentPosterior)
    )
    predict = None if model is None else step_posterior(model)
    before, observer = (SqueezeObserver(one, geometry.hand.tactile_end, predict) for one in (every, frames))
    placements = [one.item for one in read_results(path, (HandPlacement,), trust=True)]
    for one in (before, observer):
        one.frames.T_hand_container = placements[-1].T_hand_container if placements else None
        one.frames.all_images = any(container.lag_s is not None for container in containers)
        for row in rows:
            if isinstance(row.item, SqueezePhase):
                one.phase(row.item.name, row.session_ns + start_ns)
    items = [row.item for row in rows if not isinstance(row.item, SqueezePhase)]
    for item in items:
        before.observe(item)
    observer.tracking = tracking = RecordedTracking(every, geometry, containers, posteriors)
    steps = [observer.observe(item) for item in items]
    found = SqueezeAgain([result for step in filter(None, steps) for result in step.results])
    found.results += sighted_again(recording, [row.item for row in rows], geometry)
    found.results += [each for one in tracking.found if one.container.live for each in (one.container, one.change)]
    try:
        found.features = trial_features(frames, geometry, tracking.found)
    except InputError as error:
        found.failure = str(error)
        return found
    found.results += [result for _, results in found.features.steps() for result in results]
    if model is not None:
        found.results.append(posterior_of(found.features, final_posterior(model)))
    return found


def sighted_again(recording: "Replay", items: list[Any], geometry: "SqueezeGeometry") -> "list[ContainerSighting]":
    """The container, located again in each image in which it was searched; empty if a person placed the hand."""
    from deformscope.experiments.squeeze.placing import sight
    from deformscope.frames import ArmFrame, DepthFrame, HandFrame
    from deformscope.recording.items import read_results
    from deformscope.stages.squeeze.placement import ContainerSighting

    recorded = [one.item for one in read_results(recording.path, (ContainerSighting,), trust=True)]
    if not recorded:
        return []
    camera = recording.settings["squeezed"]["names"]["camera"]
    images = {one.index: one for one in items if isinstance(one, DepthFrame) and one.device == camera}
    arms = {one.stamp.host_ns: one for one in items if isinstance(one, ArmFrame)}
    hands = {one.stamp.host_ns: one for one in items if isinstance(one, HandFrame)}
    found: list[ContainerSighting] = []
    for one in recorded:
        before = found[0].fit if found else None
        taken = [images[int(index)] for index in one.images]
        found.append(sight(taken, arms[one.arm_ns], hands[one.hand_ns], geometry, one.when, before, one.near))
    return found


def _recorded_model(recording: "Replay") -> "ContentModel | None":
    from deformscope.files.classifier_file import load_classifier
    from deformscope.runs.squeeze_run import MODEL_INPUT

    content: Any = recording.read_inputs().get(MODEL_INPUT)
    if content is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / MODEL_INPUT
        file.write_bytes(content)
        return load_classifier(file)
