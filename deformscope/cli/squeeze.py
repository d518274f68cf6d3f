"""`deformscope squeeze`: squeeze a container once, for a data set or to name its content.

deformscope squeeze lab:containers --content rice --container box-07 --record r.rrd
deformscope squeeze lab:containers --content rice --container box-07 --dataset squeezes
deformscope squeeze lab:containers --model contents.npz --seed 5
"""

from __future__ import annotations

import dataclasses
import datetime
import select
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.api.result import open_recorder
from deformscope.cli.common import EXIT_LOSSES, say, show_table, status_line, write_json
from deformscope.cli.exploring import POLL_S, Watch, signal_word
from deformscope.cli.rigs import until_interrupted
from deformscope.cli.setups import LAB, squeeze_setup_of
from deformscope.config import SqueezeConfig
from deformscope.errors import InputError

if TYPE_CHECKING:
    from deformscope.arrays import FloatArray
    from deformscope.cli.rigs import Interruption
    from deformscope.cli.setups import SqueezeOpening
    from deformscope.experiments.squeeze import Squeezed
    from deformscope.experiments.squeeze_frames import Predict
    from deformscope.files.squeeze_dataset import SqueezeDataset, TrialEntry
    from deformscope.recording.recorder import Recorder
    from deformscope.robot.squeeze_setup import SqueezeSetup
    from deformscope.session import RigExperiment
    from deformscope.stages.squeeze.model import ContentModel

MODEL_INPUT = "model.npz"
"""The model, as an input in the recording."""
TACTILE_BYTES, DEPTH_SHARE, TRIAL_S = 4_000, 0.19, 4.6
"""Of a recorded tactile frame; of a depth image's pixels two bytes each as PNG; of a trial. Estimates, measured on
recordings of lab:containers."""


def run(config: SqueezeConfig) -> int:
    """Squeeze, keep, report. Returns the command's exit status."""
    from deformscope.experiments.squeeze import Squeezed
    from deformscope.experiments.squeeze_trial import entry_of, feature_settings, recorded_settings, row_of
    from deformscope.files.squeeze_dataset import SqueezeDataset

    session = config.session or ("lab-0" if config.rig.startswith(LAB) else f"{datetime.date.today():%Y%m%d}")
    dataset = None if config.dataset is None else SqueezeDataset(config.dataset)
    seed = config.output.seed + _trials_before(dataset, config.container, session)
    model = _model(config.model)
    opening = squeeze_setup_of(config.rig, config.content, config.container, session, seed, trusted=config.trust_rig)
    if model is not None and model.settings and dict(model.settings) != feature_settings(opening.setup):
        raise InputError("a model of features with this rig's settings", f"{dict(model.settings)}", where=config.model)
    entry = entry_of(opening.setup, opening.content, opening.container, session, seed)
    entry = dataclasses.replace(entry, fill=config.fill, operator=config.operator)
    file = config.output.record
    if dataset is not None and config.keep == "trial" and file is None:
        file = dataset.recording_path(entry.trial)
        file.parent.mkdir(parents=True, exist_ok=True)
    if file is not None:
        say(_size_words(opening.setup))
    found = Squeezed()
    settings = {"seed": seed, **opening.settings, "trial": dataclasses.asdict(entry)}
    with (
        until_interrupted() as asked,
        open_recorder(
            dataclasses.replace(config.output, record=file),
            settings | recorded_settings(opening.setup),
            "squeeze",
            real_time=opening.setup.runs_itself,
        ) as recorder,
    ):
        told = _run(config, opening, model, found, recorder, asked)
        if found.stop is not None:
            recorder.stopped_because(f"{found.stop.kind}: {found.stop.reason}")
    path = recorder.summary().path
    entry = _finished(entry, found, told, dataset, path)
    if dataset is not None:
        SqueezeDataset(dataset.folder, feature_settings(opening.setup)).add([row_of(entry, found.features)])
    _report(config, opening, entry, found, told, path)
    if found.stop is not None:
        return _leave(found, asked, path, told)
    return EXIT_LOSSES if told["losses"] and path is not None else 0


def _run(
    config: SqueezeConfig,
    opening: SqueezeOpening,
    model: ContentModel | None,
    found: Squeezed,
    recorder: Recorder,
    asked: Interruption,
) -> dict[str, Any]:
    """Open the devices, squeeze, close them; what is known beside `found`."""
    from deformscope.experiments.squeeze import squeeze
    from deformscope.experiments.squeeze_features import SqueezeGeometry, around_px
    from deformscope.experiments.squeeze_frames import ObservedRecorder, SqueezeFrames, SqueezeObserver, TactileSource
    from deformscope.experiments.squeezing_hand import SqueezingHand, computing_beside, rule_of
    from deformscope.frames import InputFile
    from deformscope.recording.losses import losses_of
    from deformscope.session import finish
    from deformscope.session import run as run_session

    setup = opening.setup
    told: dict[str, Any] = {"losses": {}, "start_ns": 0}
    with setup.open_source() as source, status_line() as show:
        told["start_ns"] = source.start_ns
        names = setup.names
        tactile = TactileSource.of(source.streams, names.tactile, setup.hand.fingers)
        frames = SqueezeFrames(tactile, names.hand, names.camera, rule_of(setup))
        observer = SqueezeObserver(frames, setup.hand.tactile_end, None if model is None else tactile_posterior(model))
        geometry = SqueezeGeometry.of(setup)
        recorder.start_squeeze(
            source.streams,
            source.start_ns,
            names.tactile,
            tactile.pads,
            names.camera,
            around_px=around_px(geometry),
            named=model is not None,
        )
        if config.model is not None:
            recorder.write(InputFile(MODEL_INPUT, config.model.read_bytes()))
        observed = ObservedRecorder(recorder, observer)
        watch = Watch(asked, show)
        hand = SqueezingHand(setup, source, observer, watch)
        experiment = squeeze(
            setup.clock,
            observer,
            geometry,
            found,
            None if model is None else final_posterior(model),
            _permitted(setup, asked, yes=config.yes),
            None if setup.placed else _placed(config, setup, asked),
        )
        try:
            with computing_beside(setup, hand) as beside, watch.halts(hand):
                run_session(source, experiment, observed, hand, beside)
        finally:
            told |= {"hand_stands": hand.stands, "limits_restored": hand.restored}
        if setup.truth is not None:
            truth = setup.truth()
            told["truth"] = {
                name: (when_ns - source.start_ns) / 1e9 if when_ns else None
                for name, when_ns in (("first_s", truth.first_ns), ("steady_s", truth.steady_ns))
            }
        told["losses"] = losses_of(finish(source, observed))
        observed.rest()
    for name, reason in source.failures.items():
        say(f"deformscope: device {name} failed: {reason}")
    return told


# Who decides --------------------------------------------------------------------------------------------------------


def _permitted(setup: SqueezeSetup, asked: Interruption, *, yes: bool) -> RigExperiment[None]:
    """Within the experiment: ask before a real hand moves. Raises InputError unless somebody says yes."""
    if setup.simulated:
        return
    squeeze = setup.squeeze
    say(
        f"The hand will now open, turn its fingers towards each other and, once it is placed, close with "
        f"{squeeze.current_a:g} A at most.\nThis program is no safety function: keep the hand's switch within reach."
    )
    if yes:
        return
    if not sys.stdin.isatty():
        raise InputError("somebody who says yes", "no terminal to ask at", "--yes")
    answered = yield from _line("Type yes to begin: ", asked)
    if answered != "yes":
        raise InputError("yes", "something else: nothing has moved")


def _placed(config: SqueezeConfig, setup: SqueezeSetup, asked: Interruption) -> RigExperiment[None]:
    """Within the experiment: have the hand placed where the grasp was drawn."""
    from deformscope.session import Moment, Step
    from deformscope.stages.squeeze.trial import SqueezePhase

    grasp = setup.grasp
    yield Step((SqueezePhase("place"),), moment=Moment(setup.clock()))
    how = "move the arm by its joystick" if setup.names.arm else "place the hand"
    side = "above" if grasp.along_m > 0 else "below"
    say(
        f"Now {how}, the container between the fingertips: {abs(1e3 * grasp.along_m):.0f} mm {side} the middle of its "
        f"longest edge, tilted by {grasp.tilt_deg:.0f} deg; nothing may touch the fingertips."
    )
    if not config.yes or sys.stdin.isatty():
        yield from _line("Press Enter when it stands still: ", asked)


def _line(prompt: str, asked: Interruption) -> RigExperiment[str]:
    """What somebody at the terminal says; frames pass meanwhile. Empty once they end it by Ctrl-C, or hang up."""
    from deformscope.session import Step

    print(prompt, end="", file=sys.stderr, flush=True)
    while not asked.is_set():
        if select.select([sys.stdin], [], [], POLL_S)[0]:
            return sys.stdin.readline().strip().lower()
        yield Step()
    return ""


# A model -------------------------------------------------------------------------------------------------------------


def _model(path: Path | None) -> ContentModel | None:
    if path is None:
        return None
    from deformscope.files.classifier_file import load_classifier

    return load_classifier(path)


def tactile_posterior(model: ContentModel) -> Predict | None:
    """What the model makes of the tactile feature as the squeeze goes on; None where it has no tactile modality."""
    if "tactile" not in model.modalities:
        return None

    def predict(since_s: float, feature: FloatArray) -> tuple[tuple[str, ...], FloatArray]:
        if "tactile" in model.steps:
            step = round(since_s / model.step_s)
            return model.labels, model.predict_step("tactile", step, feature[None])[0]
        return model.labels, model.predict_proba({"tactile": feature[None]})[0]

    return predict


def final_posterior(
    model: ContentModel,
) -> Callable[[dict[str, FloatArray]], tuple[str, tuple[str, ...], FloatArray]]:
    """What the model makes of all features that it knows: (modalities, labels, probabilities)."""

    def predict(features: dict[str, FloatArray]) -> tuple[str, tuple[str, ...], FloatArray]:
        known = {name: features[name][None] for name in model.modalities if name in features}
        return " and ".join(known), model.labels, model.predict_proba(known)[0]

    return predict


# The trial -----------------------------------------------------------------------------------------------------------


def _trials_before(dataset: SqueezeDataset | None, container: str, session: str) -> int:
    """Each trial of a container has a grasp of its own."""
    if dataset is None or not dataset.exists:
        return 0
    return sum((one.container, one.session) == (container, session) for one in dataset.entries())


def _finished(
    entry: TrialEntry, found: Squeezed, told: dict[str, Any], dataset: SqueezeDataset | None, path: Path | None
) -> TrialEntry:
    """The entry with what came of the squeeze."""
    recording = ""
    if path is not None and dataset is not None:
        inside = path.is_relative_to(dataset.folder)
        recording = str(path.relative_to(dataset.folder) if inside else path.resolve())
    start_ns = told["start_ns"]
    events = found.features.events if found.features is not None else None
    return dataclasses.replace(
        entry,
        recording=recording,
        first_s=float("nan") if events is None else (events.first_ns - start_ns) / 1e9,
        steady_s=float("nan") if events is None else (events.steady_ns - start_ns) / 1e9,
        discarded=None if found.stop is None else f"{found.stop.kind}: {found.stop.reason}",
    )


def _size_words(setup: SqueezeSetup) -> str:
    """What a recording will take."""
    pixels = 640 * 480 if setup.names.camera else 0
    bytes_s = 30 * TACTILE_BYTES + setup.camera.rate_hz * pixels * 2 * DEPTH_SHARE
    return f"a recording of some {TRIAL_S:g} s will take about {bytes_s * TRIAL_S / 1e6:.0f} MB"


def _report(
    config: SqueezeConfig,
    opening: SqueezeOpening,
    entry: TrialEntry,
    found: Squeezed,
    told: dict[str, Any],
    path: Path | None,
) -> None:
    from deformscope.stages.squeeze.physical import PHYSICAL

    computed, posterior, stop = found.features, found.posterior, found.stop
    rows = [
        ("content", entry.content if config.content else "not given"),
        ("container", entry.container or "not given"),
    ]
    result: dict[str, Any] = {"trial": entry.trial, "content": entry.content, "container": entry.container}
    result["discarded"] = None if stop is None else dataclasses.asdict(stop)
    if computed is not None:
        events, features = computed.events, computed.features
        took_s = (events.steady_ns - events.first_ns) / 1e9
        wide_ms = [(high - low) / 1e6 for low, high in (events.first_interval_ns, events.steady_interval_ns)]
        rows.append(("first contact", f"at {entry.first_s:.2f} s, known to {wide_ms[0]:.0f} ms"))
        rows.append(("steady state", f"{took_s:.2f} s later, known to {wide_ms[1]:.0f} ms"))
        physical = dict(zip(PHYSICAL, features.physical.tolist(), strict=True))
        rows.append(("force of a finger", f"{physical['force_n']:.2f} N, {physical['stiffness_n_per_m']:.0f} N/m"))
        seen = f"{1e2 * features.patch_width_m:.1f} cm wide, {100 * features.missing:.0f} % missing"
        rows.append(("depth change", f"none: {features.reason}" if features.vision is None else seen))
        start_ns = told["start_ns"]
        result["events"] = {
            "first_s": entry.first_s,
            "first_interval_s": [(when - start_ns) / 1e9 for when in events.first_interval_ns],
            "steady_s": entry.steady_s,
            "steady_interval_s": [(when - start_ns) / 1e9 for when in events.steady_interval_ns],
        }
        result["features"] = {name: len(values) for name, values in computed.modalities.items()}
        result |= {"physical": physical, "vision_missing": features.missing, "vision_reason": features.reason}
    if posterior is not None:
        words = ", ".join(
            f"{label} {100 * share:.0f} %"
            for label, share in sorted(
                zip(posterior.labels, posterior.probability, strict=True), key=lambda one: -one[1]
            )
        )
        rows.append(("named", f"{posterior.content} by {posterior.modality} ({words})"))
        result["named"] = posterior.content
        result["posterior"] = dict(zip(posterior.labels, posterior.probability.tolist(), strict=True))
    if config.model is not None and opening.setup.simulated and not config.content:
        rows.append(("truth", opening.content))
    if stop is not None:
        rows.append(("discarded", f"{stop.kind}: {stop.reason}"))
    rows.append(("hand", hand_words(told)))
    result |= {name: told[name] for name in ("hand_stands", "limits_restored", "losses")}
    result |= {"truth": told.get("truth"), "dataset": config.dataset, "recording": path}
    rows += [(name, str(where)) for name, where in (("data set", config.dataset), ("recording", path)) if where]
    write_json(result, config.output.json)
    show_table(f"{config.rig} (simulated)" if opening.setup.simulated else config.rig, rows)


def hand_words(told: dict[str, Any]) -> str:
    """Whether the hand stands, and may be used again as it was."""
    if not told["hand_stands"]:
        return "COULD NOT BE STOPPED: it may still press; switch it off"
    return "stands" if told["limits_restored"] else "stands; ITS CURRENT LIMITS ARE NOT AS THEY WERE: switch it off"


def _leave(found: Squeezed, asked: Interruption, path: Path | None, told: dict[str, Any]) -> int:
    """End the command as the stop demands. Raises InputError with the reason and what to see to."""
    assert found.stop is not None
    if asked.is_set():
        kept = "" if path is None else f"; the recording is whole: {path}"
        say(f"deformscope: ended by {signal_word(asked.signal_number)}; the hand {hand_words(told)}{kept}")
        return 128 + asked.signal_number
    came = f"{found.stop.kind} ({found.stop.reason.split(' | ')[0]}); the hand {hand_words(told)}"
    hint = f"see to {found.stop.advice}, then squeeze again" if found.stop.advice else "squeeze again"
    raise InputError("a squeeze that comes to its steady state", came, hint, path or "")
