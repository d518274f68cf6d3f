"""Thesis chapter 2: squeeze a container, and compute the features of its content.

`squeeze` is an experiment (`deformscope.session`): it commands a hand, requests the features, and yields them."""

import contextlib
import dataclasses
import datetime
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.squeeze import squeezing_hand
from deformscope.experiments.squeeze.features import SqueezeGeometry, TrialFeatures, trial_features
from deformscope.experiments.squeeze.frames import SqueezeObserver
from deformscope.files.squeeze_dataset import TrialEntry, TrialRow
from deformscope.robot.squeeze_setup import SqueezeSetup
from deformscope.session import Compute, Moment, RigExperiment, Step, ask
from deformscope.stages.squeeze.patch import SIDE_PX
from deformscope.stages.squeeze.placement import ContainerSighting, HandPlacement
from deformscope.stages.squeeze.trial import PHYSICAL, ContentPosterior, SqueezePhase, SqueezeStop
from deformscope.version import __version__

Name = Callable[[dict[str, FloatArray]], tuple[str, tuple[str, ...], FloatArray]]
"""Names a content from all features by modality: the modalities used, labels, and their probabilities (k,)."""

FEATURES_FAILED = "features not computed"


@dataclass
class Squeezed:
    """The outcome so far, valid however the squeeze ends.

    features: features and events, None if there are none; posterior: a model's classification of its content
    stop, stop_ns: why and when it ended early; untracked: why tracking of the container ended, or empty; placement,
    sightings: placement and sightings of an arm that placed the hand; withdrawal: why the arm stopped on its way back
    """

    features: TrialFeatures | None = None
    posterior: ContentPosterior | None = None
    stop: SqueezeStop | None = None
    stop_ns: int = 0
    placement: HandPlacement | None = None
    sightings: list[ContainerSighting] = field(default_factory=list)
    withdrawal: SqueezeStop | None = None
    untracked: str = ""


def squeeze(
    clock: Callable[[], int],
    observer: SqueezeObserver,
    geometry: SqueezeGeometry,
    found: Squeezed,
    name: Name | None = None,
    permitted: RigExperiment[None] | None = None,
    placed: RigExperiment[None] | None = None,
    withdrawn: RigExperiment[None] | None = None,
) -> RigExperiment[None]:
    """Pre-shape, squeeze once, compute the features; `found` collects the results.

    clock: the devices' clock [ns]; name: function that names the content, None = none
    permitted: steps before the hand may move; placed: steps before the hand closes; withdrawn: called when the hand has
    opened again. The function returns also when the hand must stop: `found.stop` has the reason."""
    frames = observer.frames
    try:
        if permitted is not None:
            yield from permitted
        yield from ask(squeezing_hand.PreShape())
        if placed is not None:
            yield from placed
        if found.placement is not None:
            frames.T_hand_container = found.placement.T_hand_container
        yield from _tracked(observer)  # what tracks has begun
        yield from ask(squeezing_hand.SqueezeOnce())
    except squeezing_hand.SqueezeEnded as ended:
        found.stop, found.stop_ns = ended.stop, ended.time_ns
        stopped = SqueezePhase(f"stopped: {ended.stop.kind}"), ended.stop
        came_to = () if found.placement is None else (found.placement,)
        yield from ask(squeezing_hand.HandWait(squeezing_hand.AFTER_S), (*stopped, *came_to), Moment(ended.time_ns))
        return
    try:
        if withdrawn is not None:
            yield from withdrawn
    except squeezing_hand.SqueezeEnded as ended:  # what was squeezed holds
        found.withdrawal = ended.stop
        came_to = () if found.placement is None else (found.placement,)
        yield Step((ended.stop, *came_to), moment=Moment(ended.time_ns))
    yield from ask(squeezing_hand.HandWait(0.0))  # what the devices gave last is taken in
    yield from _tracked(observer)
    found.untracked, tracked = observer.tracking.failed, tuple(observer.tracking.found)
    try:
        computed: TrialFeatures = yield from ask(Compute(trial_features, (frames, geometry, tracked), "features"))
        posterior = None if name is None else posterior_of(computed, name)
    except Exception as error:
        words = " ".join(str(error).split())
        reason = words if isinstance(error, InputError) else f"{type(error).__name__}: {words}"
        found.stop = SqueezeStop(FEATURES_FAILED, reason, "the recording: deformscope replay", True, True)
        found.stop_ns = clock()
        yield Step((found.stop,), moment=Moment(found.stop_ns))
        return
    found.features, found.posterior = computed, posterior
    for when_ns, results in computed.steps():
        yield Step(results, moment=Moment(when_ns))
    if posterior is not None:
        # once the last answer by touch alone was given, so that this one stays in view
        yield Step((posterior,), moment=Moment(frames.open_ns))


def _tracked(observer: SqueezeObserver) -> RigExperiment[None]:
    """Until all that came is tracked."""
    while (waiting := observer.tracking.waiting) is not None:
        with contextlib.suppress(Exception):  # `failed` then says why
            yield from ask(waiting)  # what is recorded meanwhile is taken in


def posterior_of(computed: TrialFeatures, name: Name) -> ContentPosterior:
    """A model's posterior of the content, by all features."""
    events = computed.events
    modalities, labels, probability = name(computed.modalities)
    return ContentPosterior((events.steady_ns - events.first_ns) / 1e9, modalities, labels, probability, -1)


# A squeeze as a trial of a data set, and as the settings of its recording


def feature_settings(setup: SqueezeSetup) -> dict[str, Any]:
    """Settings of a data set's features: features compare only if their settings are equal."""
    return {"tactile_end": setup.hand.tactile_end, "patch_px": SIDE_PX, "physical": list(PHYSICAL)}


def recorded_settings(setup: SqueezeSetup) -> dict[str, Any]:
    """Settings that a recording needs so that its results can be computed again."""
    recorded = {"names": dataclasses.asdict(setup.names), "rule": dataclasses.asdict(squeezing_hand.rule_of(setup))}
    recorded |= {"squeeze": dataclasses.asdict(setup.squeeze), "features": feature_settings(setup)}
    return {"squeezed": recorded | {"geometry": SqueezeGeometry.of(setup).as_json()}, "simulated": setup.simulated}


def entry_of(setup: SqueezeSetup, content: str, container: str, session: str, seed: int) -> TrialEntry:
    """The trial's entry before it was squeezed."""
    return TrialEntry(
        trial=f"{session}-{container or 'container'}-{seed:05d}",
        content=content,
        container=container,
        container_type=setup.container.kind,
        session=session,
        T_hand_container=tuple(map(float, setup.grasp.T_hand_container.ravel())),
        seed=seed,
        software=f"deformscope {__version__}",
        recorded_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    )


def row_of(entry: TrialEntry, features: TrialFeatures | None) -> TrialRow:
    """The entry with its features, if there are any."""
    if features is None:
        return TrialRow(entry)
    return TrialRow(entry, features.modalities, features.series)
