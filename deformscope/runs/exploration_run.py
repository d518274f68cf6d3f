"""An exploration from its options to its result: devices opened, surface touched, arm stopped, results recorded."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope.errors import InputError
from deformscope.experiments.explore.explore import TouchPlanner as TouchPlanner
from deformscope.lab.scenes import OwnScene as OwnScene
from deformscope.lab.scenes import scene_of
from deformscope.log.layout import EXPLORATION, ExplorationLayout
from deformscope.results.render import to_line
from deformscope.runs.exploration_result import NOT_KNOWN, ExplorationResult, LayerThickness, TouchOutcome, TruthScore
from deformscope.runs.opened_devices import LAB, own_wrench, setup_of
from deformscope.runs.result import open_recorder
from deformscope.runs.skeleton import leave_arm, open_run, permitted
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.terminal import say, until_interrupted
from deformscope.version import __version__

if TYPE_CHECKING:
    from deformscope.arrays import FloatArray
    from deformscope.config import ExploreConfig
    from deformscope.experiments.explore.explore import Exploration
    from deformscope.experiments.explore.options import ExploreOptions
    from deformscope.experiments.explore.recorded_touches import RecordedTouches
    from deformscope.lab.faults import FaultsToCome
    from deformscope.page.devices import ShownDevices
    from deformscope.page.server.page_session import PageSession
    from deformscope.page.steering import PageSteering
    from deformscope.recording.recorder import Recorder
    from deformscope.robot.setup import Setup
    from deformscope.session import RigExperiment, Step
    from deformscope.stages.map.exploration import TouchEstimate
    from deformscope.terminal import Interruption


INCLUSION_FORCE_N = 5.0
"""Force in the laboratory in a search for inclusions, unless given: with a larger force a touch reaches deeper."""


@dataclass
class ExplorationEnd:
    """Why and when an exploration ended; completed during the run.

    error: the error that ended it, other than a stop; start_ns: start of the session, on the robot's clock
    arm_stopped: whether the arm could be stopped; began_s: when it could first move, 0 = never [s]
    session_s: duration by the robot's clock [s]; gaps_s: (n,) times from each check of its supervisor to the next [s]
    largest_force_n: largest force that the sensor measured in a touch [N]
    losses: losses of each device that lost something (`deformscope.recording.losses`)"""

    error: BaseException | None = None
    start_ns: int = 0
    arm_stopped: bool = True
    began_s: float = 0.0
    session_s: float = 0.0
    gaps_s: "FloatArray | None" = None
    largest_force_n: float = 0.0
    losses: dict[str, dict[str, float]] = field(default_factory=dict)


def explore_on(
    config: "ExploreConfig",
    report: Callable[[ExplorationResult], None],
    planner: TouchPlanner | None = None,
    scene: OwnScene | None = None,
) -> ExplorationResult | None:
    """Explore a simulated scene, or with the devices of a rig file; None if it ended before the arm could move.

    planner: planner that replaces the built-in one; scene: scene of the rig's name, if that is not built in. In any
    case the arm is halted, and the results are reported before the recording is closed."""
    from deformscope.config.explore import ExploreFlags
    from deformscope.experiments.explore.explore import DRY_RUN, Exploration
    from deformscope.experiments.explore.options import DRY_RUN_M, ExploreOptions
    from deformscope.experiments.measured import SetupGeometry
    from deformscope.lab.faults import FaultAt, FaultsToCome
    from deformscope.stages.map.plan import INCLUSION_M

    quiet_warp()
    inclusions = config.goal == "inclusions"
    given = {one.name: getattr(config, one.name) for one in dataclasses.fields(ExploreFlags)}
    options = ExploreOptions(
        **given,
        perception=config.output.record is not None or config.output.viewer != "none",
        seed=config.output.seed,
        inclusion_m=config.smallest_inclusion_m or (0.02 if inclusions else INCLUSION_M),
        lift_m=DRY_RUN_M if config.dry_run else 0.0,
        go_on=planner is not None,
    )
    faults = [FaultAt.parse(text, options.budget) for text in config.fault]
    opening = setup_of(
        config.rig,
        options,
        INCLUSION_FORCE_N
        if config.set_force_n is None and inclusions and config.rig.startswith(LAB)
        else config.set_force_n,
        trusted=config.trust_rig,
        clean=config.clean,
        camera=config.camera,
        robot=config.robot,
        removal=config.removal,
        tangential=config.tangential,
        scene=None if scene is None else scene_of(scene, options.seed),
        corrected=config.corrected,
        arm=config.arm,
        own=None if config.wrench is None else own_wrench(config.wrench),
    )
    setup, options = opening.setup, opening.options
    setup.check_force(options.set_force_n)
    _check_first(config, setup)
    if planner is not None and (opening.recorded is not None or config.output.viewer == "page"):
        raise InputError("a robot without a page, for a planner of one's own", "a recording, or a page")
    if opening.recorded is not None and (config.dry_run or config.output.viewer == "page"):
        raise InputError("a robot, for --dry-run and --viewer page", "a recording", "deformscope replay --viewer page")
    to_come = FaultsToCome(opening.faulty_lab, faults, options.seed) if faults else None
    settings = {"explore": dataclasses.asdict(options), "seed": options.seed, "simulated": setup.simulated}
    settings |= {"setup": SetupGeometry.of(setup).as_json(), **opening.settings}
    found, ending = Exploration(), ExplorationEnd()
    explored: ExplorationResult | None = None
    with (
        until_interrupted() as asked,
        open_recorder(config.output, settings, EXPLORATION, real_time=setup.runs_itself) as recorder,
    ):
        try:
            _run(config, setup, options, found, recorder, asked, to_come, ending, opening.recorded, planner)
        except BaseException as error:
            ending.error = error
        if found.stop is not None:
            recorder.stopped_because(f"{found.stop.kind}: {found.stop.reason}")
        if ending.began_s > 0.0 or found.stop is not None:
            laboratory = opening.settings.get("laboratory")
            explored = _result(config, setup, options, found, recorder, ending, to_come, laboratory)
            explored = dataclasses.replace(explored, recorded=opening.recorded is not None)
            report(explored)
            _say_on_page(recorder, explored)
        if ending.error is not None:
            raise ending.error
    for fault in to_come.waiting if to_come is not None else ():
        say(f"--fault {fault.injected.word}@{fault.touch} was not injected: its moment did not occur")
    for fault, _ in to_come.struck if to_come is not None and found.stop is None else ():
        say(f"--fault {fault.injected.word}@{fault.touch} was injected, and stopped nothing")
    if found.stop is not None and found.stop.kind == DRY_RUN and not asked.is_set():
        say(f"dry run: {found.stop.reason}; the arm is at rest. Without --dry-run it touches.")
        return explored
    if found.stop is not None or asked.is_set():
        path, stands = recorder.summary().path, ending.arm_stopped
        leave_arm(found.stop, len(found.touches), asked, path, arm_stopped=stands)
    return explored


def _check_first(config: "ExploreConfig", setup: "Setup") -> None:
    """Raises InputError for a first touch outside the surface, and for a dry run of an arm that a person places."""
    if config.first_m is not None:
        (x, y), (width, height) = config.first_m, setup.size_m
        if not (0.0 < x < width and 0.0 < y < height):
            raise InputError(f"--first on the surface: between 0,0 and {width:g},{height:g} m", f"{x:g},{y:g}")
    if config.dry_run and setup.person is not None:
        raise InputError(
            "an arm that moves on commands, for --dry-run", "one that a person places", "explore without it"
        )


def _run(
    config: "ExploreConfig",
    setup: "Setup",
    options: "ExploreOptions",
    found: "Exploration",
    recorder: "Recorder",
    asked: "Interruption",
    to_come: "FaultsToCome | None",
    ending: ExplorationEnd,
    recorded: "RecordedTouches | None",
    planner: TouchPlanner | None,
) -> None:
    """Open the devices, explore, close them; `found` and `ending` have the results, also if this raises. recorded:
    touches that were made before: nothing moves"""
    from deformscope.experiments.explore.explore import AT_END, PlannedBy, explore
    from deformscope.experiments.explore.stage_executor import stage_executor
    from deformscope.experiments.explore.touching_robot import TouchingRobot, touching_robot
    from deformscope.pictures.render_process import render_process
    from deformscope.session import run as run_session

    def steering(session: "PageSession", shown: "ShownDevices") -> "PageSteering":
        from deformscope.page.steering import PageSteering

        return PageSteering(
            session,
            asked,
            setup.clock,
            shown,
            arm=f"{setup.names[0]}{' (simulated)' * setup.simulated}",
            set_force_n=options.set_force_n,
            budget=options.budget,
            compliance_m_per_n=setup.compliance_m_per_n,
            paused=config.paused,
        )

    def permit(robot: TouchingRobot, page: "PageSteering | None") -> "RigExperiment[None]":
        yield from permitted(robot, setup, options, setup.calibrated, asked, yes=config.yes, page=page)
        ending.began_s = time.perf_counter()

    with open_run(setup.open_source(), recorder) as run:
        ending.start_ns = run.source.start_ns
        truth = setup.truth is not None and setup.truth.labels is not None
        layout = ExplorationLayout(
            run.source.streams,
            setup.size_m,
            setup.placement.T_base_surface,
            truth,
            options.goal == "inclusions",
            T_surface_camera=setup.camera.T_surface_camera,
        )
        recorder.start(layout, ending.start_ns)
        if recorded is not None:
            ending.began_s, ending.largest_force_n = time.perf_counter(), recorded.largest_force_n
            recorded.asked = asked.is_set
            with stage_executor(setup, options) as (executor, stage):
                experiment = _with_messages(explore(setup.clock, stage, found), run.line, 0)
                run_session(run.source, experiment, run.recorded, recorded, executor)
            if found.stop is not None and found.stop.kind == AT_END:  # after a touch that gave no estimate
                found.stop, found.stop_reason = None, AT_END
            while items := recorded.rest():
                recorder.write(items)
            ending.session_s = (setup.clock() - ending.start_ns) / 1e9
            return
        page = run.open_page(recorder, config, steering)
        watch = run.watch(asked, page)
        with (
            touching_robot(setup, run.source, options, watch) as robot,
            stage_executor(setup, options) as (executor, stage),
            render_process() if setup.runs_itself else nullcontext(),
        ):
            try:
                with watch.halts(robot):
                    if to_come is not None:
                        robot.on_phase = to_come.phase_began
                    if page is not None:
                        robot.reason_to_stand = page.reason_to_stand
                    steered = page if planner is None else PlannedBy(planner, found)
                    explored = explore(setup.clock, stage, found, permit(robot, page), steered)
                    experiment = _with_messages(explored, run.line, options.budget, page)
                    run_session(run.source, experiment, run.recorded, robot, executor)
            finally:
                ending.arm_stopped, ending.gaps_s = watch.arm_stopped, robot.gaps_s
                ending.largest_force_n = robot.largest_force_n
                ending.session_s = (setup.clock() - ending.start_ns) / 1e9
    ending.losses = run.losses()


def _say_on_page(recorder: "Recorder", explored: ExplorationResult) -> None:
    """Print the outcome, if there is a page, which may outlive the exploration."""
    if recorder.page is None:
        return
    rows = explored.rows()
    for name, words in reversed([row for row in rows if row[0].startswith(("region", "truth"))]):
        recorder.page.session.remark(f"{name}: {words}")
    known = dict(rows)
    recorder.page.session.enter("stopped", f"{known['verdict']}; touches: {known['touches']}; {known['ended']}")


def _with_messages(
    experiment: "RigExperiment[None]", show: Callable[[str], None], budget: int, page: "PageSteering | None" = None
) -> "RigExperiment[None]":
    """The same experiment; its results are printed, and shown on the page, during the run. budget: touches at most, 0 =
    they were made before, by any plan"""
    from deformscope.stages.map.exploration import TouchEstimate

    given: Any = None
    made, began_s = 0, 0.0
    answer: Callable[[Any], Step] = experiment.send
    while True:
        try:
            step = answer(given)
        except StopIteration:
            return
        if page is not None:
            page.on_results(step.results)
        lines = []
        for result in step.results:
            began_s = began_s or time.perf_counter()  # what is found first is the surface
            made += isinstance(result, TouchEstimate)
            remarks = list(_remarks(result, made, budget, time.perf_counter() - began_s))
            lines += remarks
            if page is not None and _for_page(result):
                for line in remarks:
                    page.session.remark(line)
        if lines:
            show("")
            for line in lines:
                say(line)
        try:
            given, answer = (yield step), experiment.send
        except Exception as error:
            given, answer = error, experiment.throw


def _for_page(result: object) -> bool:
    """Whether a page is to say it: plans and answers of its own it shows elsewhere."""
    from deformscope.stages.map.exploration import InclusionsResult, MapEstimate, StageFailure, TouchEstimate

    return isinstance(result, TouchEstimate | MapEstimate | InclusionsResult | StageFailure)


def _remarks(result: object, made: int, budget: int, spent_s: float) -> Iterator[str]:
    """Printed lines of a result. made: touches so far, of `budget` at most; spent_s: on them [s]"""
    from deformscope.pictures import messages
    from deformscope.stages.map.exploration import (
        InclusionsResult,
        MapEstimate,
        PlannedTouch,
        StageFailure,
        SteeringDecision,
        TouchEstimate,
        TouchForecast,
    )

    if isinstance(result, PlannedTouch) and budget:
        if result.target_m is None or result.stop_reason:
            why = messages.format_stop(result.stop_reason) if result.stop_reason else result.reason
            yield f"no further touch: {why}"
        else:
            left = f"; about {spent_s / made * (budget - made):.0f} s left for all {budget}" if made else ""
            yield f"touch {made + 1} of at most {budget}, at {_cm(result.target_m)} cm: {result.reason}{left}"
    elif isinstance(result, TouchForecast):
        low, high = result.stiffness_interval
        expected = f"{result.stiffness_n_per_mm:.2g} N/mm expected ({low:.2g} to {high:.2g})"
        yield f"requested: a touch at {_cm(result.xyz_m[:2])} cm, {expected}"
    elif isinstance(result, SteeringDecision):
        yield f"decided: {result.kind} at {_cm(result.xy_m)} cm{': ' * bool(result.reason)}{result.reason}"
    elif isinstance(result, TouchEstimate):
        yield f"  measured at {_cm(result.xyz_m[:2])} cm: {to_line(result)}"
        if result.creep is not None:
            at = "" if result.speed_m_s is None else f", detected at {1e3 * result.speed_m_s:.2g} mm/s"
            yield f"  creep{at}: {result.creep.text}"
    elif isinstance(result, MapEstimate):
        truth = f", {messages.format_iou(result)}" if messages.format_iou(result) else ""
        yield f"  map so far: {messages.format_verdict(result)} (probability {result.probability:.2f}){truth}"
    elif isinstance(result, InclusionsResult):
        smallest = f"{100.0 * result.smallest_m:g} cm radius or more"
        missed = f"is missed with a probability of {result.missed_smallest:.1%}"
        yield f"  {messages.format_inclusions(result)}; one of {smallest} {missed}"
    elif isinstance(result, StageFailure):
        yield f"deformscope: {messages.format_failure(result)}"


def _cm(xy_m: Any) -> str:
    return f"({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f})"


def _result(
    config: "ExploreConfig",
    setup: "Setup",
    options: "ExploreOptions",
    exploration: "Exploration",
    recorder: "Recorder",
    ending: ExplorationEnd,
    faults: "FaultsToCome | None",
    laboratory: dict[str, Any] | None,
) -> ExplorationResult:
    from deformscope.experiments.measured import SetupGeometry

    exploration.failures += recorder.not_shown
    if ending.error is not None:
        exploration.stop_reason = f"error: {' '.join(str(ending.error).split()) or type(ending.error).__name__}"
    maps = exploration.maps
    truth = None
    if setup.truth is not None:  # a gradient has no regions, and none to compare with
        labels = setup.truth.labels
        count = 0 if labels is None else int(labels.max()) + 1
        truth = TruthScore(count, None if maps is None else maps.iou, None if maps is None else maps.boundary_m)
    return ExplorationResult(
        scenario=config.rig,
        seed=options.seed,
        version=__version__,
        set_force_n=options.set_force_n,
        more_force_n=SetupGeometry.of(setup).more_force_n(options),
        feel=options.feel,
        thickness=_thickness(exploration, options),
        touches=tuple(_touch(exploration, one, ending.start_ns) for one in exploration.touches),
        probability=exploration.region_probability,
        truth=truth,
        travel_m=exploration.travel_m,
        max_force_n=setup.max_force_n,
        measured_max_force_n=ending.largest_force_n,
        seconds={
            "compute": exploration.compute_s,
            "slowest": exploration.slowest_s,
            "session": ending.session_s,
            "wall": time.perf_counter() - ending.began_s if ending.began_s else 0.0,
        },
        supervisor_gaps_ms=_gaps_ms(ending.gaps_s),
        stop_reason=exploration.stop_reason,
        inclusions=exploration.inclusions,
        missed=exploration.missed,
        arm_stands=ending.arm_stopped,
        failures=tuple(exploration.failures),
        losses=ending.losses,
        # after an error it keeps the name of an unfinished one
        recording=config.output.record if ending.error is None else recorder.summary().path,
        fault=_fault(exploration, ending, faults),
        laboratory=laboratory,
        estimate=maps,
        simulated=setup.simulated,
        certificate=(setup.certificate + ", which is taken out" * config.corrected) or None,
    )


def _thickness(exploration: "Exploration", options: "ExploreOptions") -> LayerThickness:
    surface = exploration.surface
    known_m = None if surface is None else surface.layer_m
    by = "stated" if options.thickness_stated else NOT_KNOWN if known_m is None else "measured from the table around it"
    return LayerThickness(known_m, None if surface is None else surface.layer_sd_m, by)


def _touch(exploration: "Exploration", one: "TouchEstimate", start_ns: int) -> TouchOutcome:
    number, at = one.number, one.number - 1
    return TouchOutcome(
        one,
        ended_s=(exploration.ended_ns[at] - start_ns) / 1e9,
        iou=exploration.iou[at] if at < len(exploration.iou) else None,
        failed=exploration.failed(number),
        asked_for=number in exploration.asked,
    )


def _fault(exploration: "Exploration", ending: ExplorationEnd, faults: "FaultsToCome | None") -> dict[str, Any] | None:
    """Why it was stopped, and how long after the laboratory's fault; None where it was not."""
    from deformscope.experiments.explore.explore import DRY_RUN

    stop = exploration.stop
    if stop is None or stop.kind == DRY_RUN:
        return None
    struck = faults.struck if faults is not None else ()
    struck_ns = [struck_ns for _, struck_ns in struck if struck_ns <= exploration.stop_ns]
    return {
        "kind": stop.kind,
        "reason": stop.reason,
        "time_s": (exploration.stop_ns - ending.start_ns) / 1e9,
        "noticed_after_s": (exploration.stop_ns - struck_ns[-1]) / 1e9 if struck_ns else None,
    }


def _gaps_ms(gaps_s: "FloatArray | None") -> dict[str, float] | None:
    """From one look of the supervisor to the next, None where the arm never could move [ms]."""
    if gaps_s is None or not len(gaps_s):
        return None
    shares = {"p50": 50.0, "p99": 99.0, "p99_9": 99.9, "max": 100.0}
    return {"count": len(gaps_s)} | {name: 1e3 * float(np.percentile(gaps_s, share)) for name, share in shares.items()}
