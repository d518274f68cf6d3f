"""A replay of an exploration from its recorded depth images, wire forces and states of the arm. All results (surface,
plans with their maps, touches, maps) are computed again and must be equal to the last bit."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from deformscope.config import ReplayConfig
from deformscope.errors import InputError
from deformscope.pictures.report import Table
from deformscope.plain import Json
from deformscope.runs.replay_result import Different, ReplayResult, compare

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
