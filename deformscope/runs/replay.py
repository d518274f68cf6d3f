"""Computes a recording again: the same stages on its inputs, compared with its numbers. The bytes of a rig are decoded
again and compared with its frames.

An exploration is computed from its recorded depth images, wire forces and states of the arm. All results (surface,
plans with their maps, touches, maps) must be equal to the last bit."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from deformscope.config import ReplayConfig
from deformscope.errors import InputError
from deformscope.pictures.messages import format_failure
from deformscope.pictures.report import Table
from deformscope.plain import Json
from deformscope.recording.items import ITEMS, read_estimates, read_streams
from deformscope.recording.reader import Replay, read_rows
from deformscope.runs.replay_result import Different, ReplayResult, compare
from deformscope.runs.skeleton import wait_for_enter
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.terminal import Progress

if TYPE_CHECKING:
    from deformscope.page.server.page_server import PageServer
    from deformscope.recording.reader import Replay

TRUTH = ("truth_labels", "iou", "boundary_m", "truth_m", "reason")
"""Fields that are not compared: the truth is no input, and a plan's reason puts numbers into words that are compared
elsewhere."""


def replay_exploration(recording: "Replay", config: ReplayConfig, page: "PageServer | None" = None) -> ReplayResult:
    """Compute and compare; raises Different. A stage that failed when it was recorded is reported, not computed again:
    whether it fails may depend on the machine. page: page that plays it, and shows results with other settings next to
    the recorded ones"""
    import msgspec

    from deformscope.experiments.explore import explore
    from deformscope.experiments.explore.explorer import ExplorationStages, UnseenSurface
    from deformscope.experiments.explore.options import ExploreOptions
    from deformscope.experiments.explore.recorded_touches import recorded_inputs
    from deformscope.experiments.explore.robot_geometry import AsMeasured, FromFrames
    from deformscope.experiments.measured import SetupGeometry
    from deformscope.pictures.messages import format_failure
    from deformscope.recording.items import read_results, read_series
    from deformscope.session import run
    from deformscope.stages.map import exploration
    from deformscope.stages.map.measured import SurfaceMeasurement
    from deformscope.stages.map.perception import ForcePose, LookPerception, TouchPerception

    settings, path = recording.settings, config.recording
    changes = _changes(config.set, get_type_hints(ExploreOptions))
    options = dataclasses.replace(msgspec.convert(settings["explore"], ExploreOptions), **changes)
    geometry = SetupGeometry.from_json(settings.get("setup", {}))
    kinds: tuple[type, ...] = (
        exploration.SurfaceEstimate,
        exploration.PlannedTouch,
        exploration.TouchEstimate,
        exploration.MapEstimate,
        exploration.InclusionsResult,
    )
    if not changes:
        kinds = (*kinds, LookPerception, TouchPerception)
    rows = list(read_results(path, kinds, trust=True))
    recorded = [row.item for row in rows]
    failed = [row.item for row in read_results(path, (exploration.StageFailure,), trust=True)]
    given = recorded_inputs(path)
    measured = bool(given) and isinstance(given[0], SurfaceMeasurement)
    failed_before = [] if changes else failed
    unseen = UnseenSurface(geometry.size_m, options, geometry.arm, failed=failed_before, error=geometry.touch_error)
    stages = ExplorationStages(unseen, AsMeasured(geometry.size_m) if measured else FromFrames(geometry, options))
    computed, found = _Heard(), explore.Exploration()
    steering = explore.RecordedSteering(
        [row.item for row in read_results(path, (exploration.SteeringDecision,), trust=True)]
    )
    explored = explore.explore(lambda: 0, explore.within_loop(stages), found, steering=steering)
    run([], explored, computed, explore.AtOnce(explore.RecordedRobot(given)))
    again = [one for one in computed.results if isinstance(one, kinds)]
    if changes:
        if page is not None:
            from deformscope.page.playback import show_comparison

            show_comparison(page, recording, rows, again, geometry.size_m, _format_settings(changes))
        return _compared(recorded, again, changes, path, page)
    for fresh in (one for one in found.failures if one not in failed):
        raise Different("the recorded numbers", format_failure(fresh), where=path)
    cut_short = bool(recording.outcome.get("stopped"))
    compare(recorded, again, path, lambda before: TRUTH, cut_short=cut_short)
    poses = [one for one in computed.results if isinstance(one, ForcePose)]
    compare(read_series(path, ForcePose, trust=True), poses, path, what="series of force and pose", cut_short=cut_short)
    start = "measurements" if measured else "depth images, forces and states of the arm"
    return ReplayResult(
        {"results": len(recorded), "identical": True, "failures": failed},
        verdict=f"replay: {len(recorded)} results from {start}, identical to the recorded numbers",
        notes=tuple(f"failed during the recording: {format_failure(one)}" for one in failed),
    )


class _Heard:
    """A recorder that keeps the results."""

    def __init__(self) -> None:
        self.results: list[object] = []

    def write(self, items: object) -> None:
        self.results += getattr(items, "results", ())


def _changes(words: Sequence[str], hints: Mapping[str, Any]) -> dict[str, Any]:
    """KEY=VALUE, each of a field with this type. Raises InputError."""
    import msgspec

    known, found = {name: hint for name, hint in hints.items() if not dataclasses.is_dataclass(hint)}, {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals or name not in known:
            raise InputError(f"--set KEY=VALUE, KEY one of {', '.join(known)}", repr(word))
        try:
            found[name] = msgspec.convert(text, known[name], strict=False)
        except msgspec.ValidationError as error:
            raise InputError(f"a value of {name}", f"{text!r} ({error})") from error
    return found


def _compared(
    recorded: list[Any], again: list[Any], changes: dict[str, Any], path: Path, page: "PageServer | None"
) -> ReplayResult:
    """Results of other settings, with the recorded ones; the robot touched the recorded places."""
    from deformscope.pictures.messages import format_verdict
    from deformscope.stages.map import exploration

    def rows(results: list[Any]) -> dict[str, str]:
        found = {}
        for one in results:
            if isinstance(one, exploration.TouchEstimate):
                beta = "no beta" if one.beta is None else f"beta {one.beta:.2f}"
                found[f"touch {one.number}"] = f"{one.stiffness_text} ({one.interval_text}), {beta}"
            elif isinstance(one, exploration.MapEstimate):
                found["map"] = f"{format_verdict(one)} (probability {one.probability:.2f})"
        return found

    before, now = rows(recorded), rows(again)
    changed = _format_settings(changes)
    shown = [(name, f"{now.get(name, 'not computed')}; recorded: {before.get(name, 'none')}") for name in before | now]
    if page is not None:  # the newest is above
        for name, words in reversed(shown):
            page.session.remark(f"{name}, with {changed}: {words}")
    found: Json = {"identical": None, "set": changes, "recorded": before, "computed": now}
    return ReplayResult(found, (Table(shown, caption=f"{path} with {changed}"),))


def _format_settings(changes: dict[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in changes.items())


if TYPE_CHECKING:
    from deformscope.files.sources import Source
    from deformscope.stages.fit.estimate import Estimate
    from deformscope.stages.poke.indentation import IndentEstimate

CUT_SHORT = "the recording holds no result (its run was interrupted): nothing to compare"


def replay_on(config: ReplayConfig, progress: Progress | None = None) -> ReplayResult:
    """Replay a recording with these options. Raises `Different` for numbers that differ from the recorded ones, unless
    the result allows it."""
    quiet_warp()
    recording = Replay(config.recording)
    settings = recording.settings
    page = None
    if config.output.viewer == "page" and settings.keys() & {"explore", "squeezed", "rig"}:
        from deformscope.page.playback import play_on_page

        page = play_on_page(config.recording)
    if "explore" in settings:
        return replay_exploration(recording, config, page)
    if "squeezed" in settings:
        from deformscope.runs.replay_squeeze import replay_squeeze

        return replay_squeeze(recording)
    if config.set:
        raise InputError("--set with a recorded exploration", "a recording of another kind", where=config.recording)
    if "rig" in settings:
        return _replay_rig(recording)
    recorded, found = (_one if settings.keys() & {"material", "indented"} else _fits)(recording, config, progress)
    every = [one.to_dict() for one in found]
    result = ReplayResult(every[0] if len(every) == 1 else every, tuple(found), CUT_SHORT)
    if not recorded:
        return result
    estimates = found[0].curves if "indented" in settings else [one.estimate for one in found]
    distance = None if "material" in settings else _apart if "indented" in settings else _distance
    try:  # the settings name the machine's own device
        worst = compare(recorded, estimates, config.recording, lambda before: ("settings",), distance=distance)
    except Different as error:
        return dataclasses.replace(result, verdict="", different=error)
    same = "identical to" if worst is None else f"within {worst:.1g} (of the interval or error) of"
    return dataclasses.replace(result, verdict=f"replay: {same} the recorded numbers")


def _frames(recording: Replay, config: ReplayConfig) -> "Source":
    from deformscope.files.sources import Source

    return Source(
        str(config.recording),
        lambda: recording.frames(config.pace, lambda frame: wait_for_enter(f"frame {frame.index}")),
        recording.frame_count,
    )


def _one(recording: Replay, config: ReplayConfig, progress: Progress | None) -> tuple[Sequence[Any], Sequence[Any]]:
    """The result of a material or of curves, as recorded and computed again."""
    from deformscope.runs.indentation import replay_indent
    from deformscope.runs.materials import replay_material

    if "indented" in recording.settings:
        recorded, curves = replay_indent(recording, config.output)
        return recorded, [curves]
    before, found = replay_material(recording, _frames(recording, config), config.output, progress=progress)
    return before[:1], [found]


def _fits(recording: Replay, config: ReplayConfig, progress: Progress | None) -> tuple[Sequence[Any], Sequence[Any]]:
    """Estimates of a calibration, as recorded and computed again."""
    import msgspec

    from deformscope.experiments.fit.poke_files import LayersOptions
    from deformscope.experiments.fit.push_force import PushOptions
    from deformscope.experiments.fit.whole_motion import ParticleOptions, Selectable
    from deformscope.runs.force_log import kept_force
    from deformscope.runs.image_calibration import run_images
    from deformscope.runs.pair_calibration import calibrate_pair_bytes
    from deformscope.stages.fit.calibrate import FitOptions
    from deformscope.stages.msm.solver import pick_device

    settings = dict(recording.settings)
    try:
        fit = msgspec.convert(settings.pop("fit"), FitOptions)
        particles = msgspec.convert(settings.pop("particles", {}), ParticleOptions)
        motion = settings.pop("motion", None)
        select = None if motion is None else msgspec.convert(motion["select"], tuple[Selectable, ...])
        push = settings.pop("push", None)
        push = None if push is None else msgspec.convert(push, PushOptions)
    except (KeyError, msgspec.ValidationError) as error:
        raise InputError(
            "a recording of a calibration, with its inputs",
            "settings of another command",
            f"open it, or `deformscope report {config.recording}`",
            config.recording,
        ) from error
    if fit.model.device != "cpu":  # the recording's GPU may not be here
        fit = dataclasses.replace(fit, model=dataclasses.replace(fit.model, device=pick_device("auto")))
    recorded = read_estimates(recording)
    if not (pairs := recording.read_numbered("pair")):
        with _frames(recording, config) as source:
            given = source, recording.mask, fit, particles, settings, config.output, select, progress
            return recorded, [run_images(*given, push, kept_force(recording))]
    names = list(settings.get("sources", [])) or [f"pair {index}" for index in range(len(pairs))]
    return recorded, calibrate_pair_bytes(
        list(zip(names, pairs, strict=True)),
        fit,
        config.output,
        noise_m=settings.get("noise_m"),
        joint=bool(settings.get("joint")),
        layers=msgspec.convert(settings["layers"], LayersOptions) if "layers" in settings else None,
        progress=progress,
    )


def _distance(before: "Estimate", now: "Estimate") -> float:
    """The largest difference of two estimates' headline numbers, in the units of `CLOSE`."""
    same = ("parameter", "unit", "metres_per_unit")
    if any(getattr(before, name) != getattr(now, name) for name in same):
        return math.inf
    low, high = before.interval
    width = max(high - low, 1e-6)
    ends = zip((before.value, low, high), (now.value, *now.interval), strict=True)
    errors = ((before.aee, now.aee), (before.aee_free, now.aee_free))
    return max(*(abs(b - n) / width for b, n in ends), *(abs(b - n) / max(abs(b), 1e-12) for b, n in errors))


def _apart(before: "IndentEstimate", now: "IndentEstimate") -> float:
    """As `_distance`, of moduli."""
    (value, low, high), again = ((one.modulus_pa, *one.modulus_interval_pa) for one in (before, now))
    return max(abs(a - b) for a, b in zip((value, low, high), again, strict=True)) / (high - low)


def _replay_rig(recording: Replay) -> ReplayResult:
    """`different` if a frame differs from its bytes, or a stage's result from its frames."""
    from deformscope.experiments.live.replay_stages import replay_stages
    from deformscope.rig.decoded import compare_with_bytes
    from deformscope.rig.rig_file import parse_rig

    settings, path = recording.settings, recording.path
    streams = read_streams(path, trust=True)
    others = [one.device for one in streams]
    rig = parse_rig(settings["rig"], settings.get("rig_name", "rig"), others=others) if settings["rig"] else None
    items = (row.item for row in read_rows(recording, ITEMS, lambda encoded, which: encoded))
    found = compare_with_bytes(rig, streams, items)
    rows = []
    for one in found:
        result = f"{one.compared} of {one.frames} frames decoded again" if one.compared else f"{one.frames} frames"
        result += f"; DIFFERENT: {one.difference}" if one.difference else ", identical" if one.compared else ""
        rows.append((one.device, result + (f"; not compared: {one.left_out}" if one.left_out else "")))
    report: dict[str, Any] = {"devices": [dataclasses.asdict(one) for one in found], "identical": True}
    different: Different | None = None
    notes: tuple[str, ...] = ()
    if "stages" in settings:
        stages = replay_stages(path, trust=True)
        wrong = {name: share for name, share in stages.different.items() if share > 0.0}
        words = {name: f"DIFFERENT by {share:.2g}" for name, share in wrong.items()}
        rows += [(f"stage {name}", words.get(name, "computed again, identical")) for name in stages.different]
        rows += [("failed when recorded", format_failure(one)) for one in stages.failures]
        report["stages"] = dataclasses.asdict(stages)
        notes = (f"replay: {stages.results} results of stages computed again, identical to the recorded ones",)
        if wrong:
            came = ", ".join(f"{name} that differs by {share:.2g}" for name, share in wrong.items())
            different = Different("the recorded results of every stage, to the last bit", came, where=path)
    from deformscope.runs.arm_calibration import replay_found

    try:
        if again := replay_found(recording, rig):
            notes = (*notes, f"replay: {again}, identical to the recorded one")
    except Different as error:
        different = error
    if differences := [one.difference for one in found if one.difference]:
        more = f" (and of {len(differences) - 1} more devices)" if len(differences) > 1 else ""
        different = Different("frames equal to their bytes", differences[0] + more, where=path)
    report["identical"] = different is None
    compared = sum(one.compared for one in found)
    verdict = f"replay: {compared} frames decoded again{', identical to the recorded ones' if compared else ''}"
    return ReplayResult(report, (Table(rows, caption=f"replay of {path}"),), verdict, notes, different)
