"""A squeeze from its options to its result: devices opened, container squeezed, hand stopped, trial stored."""

import dataclasses
import datetime
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.errors import InputError
from deformscope.log.layout import SQUEEZE, SqueezeLayout
from deformscope.runs import skeleton
from deformscope.runs.opened_devices import LAB, squeeze_setup_of
from deformscope.runs.result import open_recorder
from deformscope.runs.skeleton import agree, at_terminal, open_run
from deformscope.runs.squeeze_result import SqueezeResult
from deformscope.terminal import say, until_interrupted

if TYPE_CHECKING:
    from deformscope.arrays import FloatArray
    from deformscope.config import SqueezeConfig
    from deformscope.experiments.squeeze.frames import Predict
    from deformscope.experiments.squeeze.placing import Squeezed
    from deformscope.files.squeeze_dataset import SqueezeDataset, TrialEntry
    from deformscope.page.devices import ShownDevices
    from deformscope.page.robot_page import PageSqueezing
    from deformscope.page.server.page_session import PageSession
    from deformscope.recording.recorder import Recorder
    from deformscope.robot.checks import Preflight
    from deformscope.robot.squeeze_setup import SqueezeSetup
    from deformscope.runs.opened_devices import SqueezeOpening
    from deformscope.session import RigExperiment
    from deformscope.stages.squeeze.model import ContentModel
    from deformscope.terminal import Interruption

MODEL_INPUT = "model.npz"
"""The model, as an input in the recording."""
TACTILE_BYTES, DEPTH_SHARE, TRIAL_S = 4_000, 0.19, 4.6
"""Size of a recorded tactile frame; share of two bytes a pixel that a depth PNG takes; time of a trial. Estimates,
measured on recordings of lab:containers."""


@dataclasses.dataclass(frozen=True, slots=True)
class SqueezeOutcome:
    """Outcome of a squeeze. asked: who requested the end, if a person did"""

    result: SqueezeResult
    asked: "Interruption"

    @property
    def interrupted(self) -> bool:
        """Whether an interruption ended it."""
        from deformscope.robot.squeeze_supervisor import SqueezeFault

        stop = self.result.stop or self.result.withdrawal
        return self.asked.is_set() and stop is not None and stop.kind == SqueezeFault.ASKED


def squeeze_on(config: "SqueezeConfig", report: Callable[[SqueezeResult], None]) -> SqueezeOutcome:
    """Squeeze, with the laboratory or the devices of a rig file; store the trial; report the results."""
    from deformscope.experiments.squeeze.placing import Squeezed, entry_of, feature_settings, recorded_settings, row_of
    from deformscope.files.squeeze_dataset import SqueezeDataset

    session = config.session or ("lab-0" if config.rig.startswith(LAB) else f"{datetime.date.today():%Y%m%d}")
    dataset = None if config.dataset is None else SqueezeDataset(config.dataset)
    seed = config.output.seed + _trials_before(dataset, config.container, session)
    model = _model(config.model)
    opening = squeeze_setup_of(
        config.rig, config.content, config.container, session, seed, trusted=config.trust_rig, place=config.place
    )
    if model is not None and model.settings and dict(model.settings) != feature_settings(opening.setup):
        raise InputError("a model of features with this rig's settings", f"{dict(model.settings)}", where=config.model)
    entry = entry_of(opening.setup, opening.content, opening.container, session, seed)
    entry = dataclasses.replace(entry, fill=config.fill, operator=config.operator)
    file = config.output.record
    if dataset is not None and config.keep == "trial" and file is None:
        file = dataset.recording_path(entry.trial)
        file.parent.mkdir(parents=True, exist_ok=True)
    if file is not None:
        say(_format_size(opening.setup))
    found = Squeezed()
    settings = {"seed": seed, **opening.settings, "trial": dataclasses.asdict(entry)}
    with (
        until_interrupted() as asked,
        open_recorder(
            dataclasses.replace(config.output, record=file),
            settings | recorded_settings(opening.setup),
            SQUEEZE,
            real_time=opening.setup.runs_itself,
        ) as recorder,
    ):
        ended = _run(config, opening, model, found, recorder, asked, seed)
        if found.stop is not None:
            recorder.stopped_because(f"{found.stop.kind}: {found.stop.reason}")
    path = recorder.summary().path
    entry = _finished(entry, found, ended, dataset, path)
    if dataset is not None:
        SqueezeDataset(dataset.folder, feature_settings(opening.setup)).add([row_of(entry, found.features)])
    result = SqueezeResult(
        rig=config.rig,
        simulated=opening.setup.simulated,
        trial=entry.trial,
        content=entry.content,
        content_given=bool(config.content),
        container=entry.container,
        stop=found.stop,
        start_ns=ended["start_ns"],
        computed=found.features,
        untracked=found.untracked,
        answer=found.posterior,
        hand_stands=ended["hand_stands"],
        arm_stands=ended["arm_stands"],
        limits_restored=ended["limits_restored"],
        placement=found.placement,
        sightings=tuple(found.sightings),
        withdrawal=found.withdrawal,
        losses=ended["losses"],
        truth=ended.get("truth"),
        dataset=config.dataset,
        recording=path,
    )
    report(result)
    if recorder.page is not None:
        from deformscope.page.robot_page import show_squeezed

        show_squeezed(recorder.page.session, result.rows())
    return SqueezeOutcome(result, asked)


def _run(
    config: "SqueezeConfig",
    opening: "SqueezeOpening",
    model: "ContentModel | None",
    found: "Squeezed",
    recorder: "Recorder",
    asked: "Interruption",
    seed: int,
) -> dict[str, Any]:
    """Open the devices, squeeze, close them; other results besides `found`."""
    from deformscope.experiments.squeeze.features import SqueezeGeometry, around_px
    from deformscope.experiments.squeeze.frames import ObservedRecorder
    from deformscope.experiments.squeeze.live import live_tracking
    from deformscope.experiments.squeeze.placing import squeeze
    from deformscope.experiments.squeeze.squeezing_hand import SqueezingHand, feature_executor, observer_of
    from deformscope.frames import InputFile
    from deformscope.robot.squeeze_plan import grasp_at
    from deformscope.session import run as run_session

    setup = opening.setup
    names, geometry = setup.names, SqueezeGeometry.of(setup)

    def squeezing(session: "PageSession", shown: "ShownDevices") -> "PageSqueezing":
        from deformscope.page.robot_page import PageSqueezing

        return PageSqueezing(session, asked, shown)

    with open_run(setup.open_source(), recorder) as run:
        source = run.source
        ended: dict[str, Any] = {"start_ns": source.start_ns}
        observer = observer_of(setup, source, None if model is None else step_posterior(model))
        pads, around = observer.frames.tactile_source.pads, around_px(geometry)
        table = None if setup.placing is None else setup.placing.placement.T_base_surface
        named = model is not None
        layout = SqueezeLayout(source.streams, names.tactile, pads, names.camera, around, named, table)
        recorder.start(layout, source.start_ns)
        if config.model is not None:
            recorder.write(InputFile(MODEL_INPUT, config.model.read_bytes()))
        page = run.open_page(recorder, config, squeezing)
        run.recorded = observed = ObservedRecorder(run.recorded, observer)
        watch = run.watch(asked, page)

        def looked_after() -> None:
            if page is not None and watch.robot is not None and (why := page.reason_to_stand()):
                watch.robot.ask_to_stop(why)
            watch()

        hand = SqueezingHand(setup, source, observer, looked_after)
        placing = None
        if setup.placing is not None:
            from deformscope.experiments.squeeze.placing import Placing, PlacingArm

            hand.arm = arm = PlacingArm(setup, source, hand.begin, hand.cycled)
            grasp = None
            if config.grasp is not None:
                grasp = grasp_at(setup.container, setup.squeeze, 1e-3 * config.grasp[0], *config.grasp[1:])
            permit = partial(_arm_permitted, config, setup, asked, page)
            placing = Placing(setup, observer.frames, geometry, arm, seed, found, permit, grasp)
        placed = None if setup.placed else _placed(config, setup, asked, page)
        experiment = squeeze(
            setup.clock,
            observer,
            geometry,
            found,
            None if model is None else final_posterior(model),
            _permitted(config, setup, asked, page),
            placed if placing is None else placing.before(),
            None if placing is None else placing.after(),
        )
        try:
            tracking = live_tracking(observer.frames, geometry, setup.clock, real_time=setup.runs_itself)
            with feature_executor(setup, hand) as executor, tracking as observer.tracking, watch.halts(hand):
                run_session(source, experiment, observed, hand, executor)
        finally:
            arm_stands = hand.arm is None or hand.arm.stands
            ended |= {"hand_stands": hand.stands, "arm_stands": arm_stands, "limits_restored": hand.restored}
        if setup.truth is not None:
            truth = setup.truth()
            ended["truth"] = {
                name: (when_ns - source.start_ns) / 1e9 if when_ns else None
                for name, when_ns in (("first_s", truth.contact_ns), ("steady_s", truth.steady_ns))
            }
    ended["losses"] = run.losses()
    return ended


# Who decides --------------------------------------------------------------------------------------------------------


def _permitted(
    config: "SqueezeConfig", setup: "SqueezeSetup", asked: "Interruption", page: "PageSqueezing | None"
) -> "RigExperiment[None]":
    """Within the experiment: ask before a real hand moves, and where it begins paused. Raises InputError unless a
    person says yes."""
    current_a = setup.squeeze.current_a
    moves = f"open, turn its fingers towards each other and, once it is placed, close with {current_a:g} A at most"
    if not setup.simulated:
        say(f"The hand will now {moves}.\nThis program is no safety function: keep the hand's switch within reach.")
    if not config.yes and (config.paused or not setup.simulated):
        yield from agree(asked, page, f"the hand{' (simulated)' * setup.simulated} will {moves}")
    if page is not None:
        page.go_on()


def _arm_permitted(
    config: "SqueezeConfig",
    setup: "SqueezeSetup",
    asked: "Interruption",
    page: "PageSqueezing | None",
    preflight: "Preflight",
) -> "RigExperiment[bool]":
    """Within the experiment: print the table of checks, and ask before a real arm moves; whether a person was asked.
    Raises InputError unless they say yes."""
    say(preflight.table())
    asks = not setup.simulated and not config.yes and preflight.passed
    if asks:
        say("The arm will now bring the hand to the container: keep the emergency stop in your hand.")
        yield from agree(asked, page, "the arm brings the hand to the container")
        if page is not None:
            page.go_on()
    return asks


def _placed(
    config: "SqueezeConfig", setup: "SqueezeSetup", asked: "Interruption", page: "PageSqueezing | None"
) -> "RigExperiment[None]":
    """Within the experiment: have the hand placed where the grasp was drawn."""
    from deformscope.session import Moment, Step
    from deformscope.stages.squeeze.trial import SqueezePhase

    grasp = setup.grasp
    yield Step((SqueezePhase("place"),), moment=Moment(setup.clock()))
    how = "move the arm by its joystick" if setup.names.arm else "place the hand"
    side = "above" if grasp.along_m > 0 else "below"
    words = (
        f"Now {how}, the container between the fingertips: {abs(1e3 * grasp.along_m):.0f} mm {side} the middle of its "
        f"longest edge, tilted by {grasp.tilt_deg:.0f} deg; nothing may touch the fingertips."
    )
    say(words)
    if not config.yes or at_terminal():
        if page is not None:
            page.session.remark(words)
        yield from agree(asked, page, "the hand closes", enter_when="when it is at rest")
        if page is not None:
            page.go_on()


# A model -------------------------------------------------------------------------------------------------------------


def _model(path: Path | None) -> "ContentModel | None":
    if path is None:
        return None
    from deformscope.files.classifier_file import load_classifier

    return load_classifier(path)


def step_posterior(model: "ContentModel") -> "Predict | None":
    """The model's posterior during the squeeze; None without a tactile modality."""
    if "tactile" not in model.modalities:
        return None

    def predict(since_s: float, features: "Mapping[str, FloatArray]") -> "tuple[str, tuple[str, ...], FloatArray]":
        known, probability = model.predict_at(since_s, {name: values[None] for name, values in features.items()})
        return " and ".join(known), model.labels, probability[0]

    return predict


def final_posterior(
    model: "ContentModel",
) -> "Callable[[dict[str, FloatArray]], tuple[str, tuple[str, ...], FloatArray]]":
    """The model's posterior from all its features: (modalities, labels, probabilities)."""

    def predict(features: "dict[str, FloatArray]") -> "tuple[str, tuple[str, ...], FloatArray]":
        known = {name: features[name][None] for name in model.modalities if name in features}
        return " and ".join(known), model.labels, model.predict_proba(known)[0]

    return predict


# The trial -----------------------------------------------------------------------------------------------------------


def _trials_before(dataset: "SqueezeDataset | None", container: str, session: str) -> int:
    """Each trial of a container has a grasp of its own."""
    if dataset is None or not dataset.exists:
        return 0
    return sum((one.container, one.session) == (container, session) for one in dataset.entries())


def _finished(
    entry: "TrialEntry", found: "Squeezed", ended: dict[str, Any], dataset: "SqueezeDataset | None", path: Path | None
) -> "TrialEntry":
    """The entry with the outcome of the squeeze."""
    recording = ""
    if path is not None and dataset is not None:
        inside = path.is_relative_to(dataset.folder)
        recording = str(path.relative_to(dataset.folder) if inside else path.resolve())
    start_ns = ended["start_ns"]
    events = found.features.events if found.features is not None else None
    if found.placement is not None:
        entry = dataclasses.replace(entry, T_hand_container=tuple(map(float, found.placement.T_hand_container.ravel())))
    return dataclasses.replace(
        entry,
        recording=recording,
        first_s=float("nan") if events is None else (events.first_ns - start_ns) / 1e9,
        steady_s=float("nan") if events is None else (events.steady_ns - start_ns) / 1e9,
        discarded=None if found.stop is None else f"{found.stop.kind}: {found.stop.reason}",
    )


def _format_size(setup: "SqueezeSetup") -> str:
    """Expected size of a recording."""
    pixels = 640 * 480 if setup.names.camera else 0
    bytes_s = 30 * TACTILE_BYTES + setup.camera.rate_hz * pixels * 2 * DEPTH_SHARE
    return f"a recording of about {TRIAL_S:g} s will take about {bytes_s * TRIAL_S / 1e6:.0f} MB"


def leave(squeezed: SqueezeOutcome) -> None:
    """After a stop, raises InputError with the reason and the advice, SystemExit if a person ended it."""
    result = squeezed.result
    stop = result.stop or result.withdrawal
    if stop is None:
        return
    state, expected, again = (
        f"; the hand {result.hand_text}",
        "a squeeze that reaches its steady state",
        "squeeze again",
    )
    skeleton.leave(stop, state, squeezed.asked, result.recording, expected, again, ended=squeezed.interrupted)
