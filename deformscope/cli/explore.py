"""`deformscope explore`: map how soft a surface is, and where, by looking and touching.

deformscope explore --list-scenarios
deformscope explore lab:two-60-150 --seed 3 --record r.rrd --picture map.png
deformscope explore lab:two-60-150 --fault force-silent@2 --record stopped.rrd
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from deformscope.api.result import open_recorder
from deformscope.cli.common import EXIT_LOSSES, quiet_warp, say, status_line
from deformscope.cli.explored import ExplorationEnd, report
from deformscope.cli.exploring import Watch, leave, permitted
from deformscope.cli.rigs import until_interrupted
from deformscope.cli.setups import setup_of
from deformscope.config import ExploreConfig

if TYPE_CHECKING:
    from deformscope.cli.rigs import Interruption
    from deformscope.experiments.explore import Exploration
    from deformscope.experiments.options import ExploreOptions
    from deformscope.experiments.touching_robot import TouchingRobot
    from deformscope.lab.faults import FaultsToCome
    from deformscope.recording.recorder import Recorder
    from deformscope.robot.setup import Setup
    from deformscope.session import RigExperiment, Step
    from deformscope.stages.map.exploration import MapEstimate


def run(config: ExploreConfig) -> int:
    """Explore a simulated scene, or what is before a rig. Returns the command's exit status."""
    if config.list_scenarios:
        _list()
        return 0
    found, _ = explore_on(config) or ({}, None)
    if not found.get("losses") or config.output.record is None:
        return 0
    from deformscope.recording.losses import named

    say(f"deformscope: the recording is whole, with losses: {named(found['losses'])}")
    return EXIT_LOSSES


def explore_on(config: ExploreConfig) -> tuple[dict[str, Any], MapEstimate | None] | None:
    """Explore a simulated scene, or with the devices of a rig file; what was found, as in the JSON, and the maps; None
    where nothing was begun. Whatever ends it, the arm is halted, and what is known is reported before the recording is
    closed."""
    from deformscope.experiments.explore import Exploration
    from deformscope.experiments.measured import SetupGeometry
    from deformscope.experiments.options import ExploreOptions
    from deformscope.lab.faults import FaultAt, FaultsToCome

    quiet_warp()
    options = ExploreOptions(
        planner=config.planner,
        budget=config.touches,
        threshold=config.threshold,
        beta_model=config.beta_model,
        seed=config.output.seed,
    )
    faults = [FaultAt.parse(text, options.budget) for text in config.fault]
    opening = setup_of(config.rig, options, config.set_force, trusted=config.trust_rig)
    setup, options = opening.setup, opening.options
    to_come = FaultsToCome(opening.faulty_lab, faults, options.seed) if faults else None
    settings = {"explore": dataclasses.asdict(options), "seed": options.seed, "simulated": setup.simulated}
    settings |= {"setup": SetupGeometry.of(setup).as_json(), **opening.settings}
    found, ending = Exploration(), ExplorationEnd()
    with (
        until_interrupted() as asked,
        open_recorder(config.output, settings, "exploration", real_time=setup.runs_itself) as recorder,
    ):
        try:
            _run(config, setup, options, found, recorder, asked, to_come, ending)
        except BaseException as error:
            ending.error = error
        if found.stop is not None:
            recorder.stopped_because(f"{found.stop.kind}: {found.stop.reason}")
        worth = ending.began_s > 0.0 or found.stop is not None
        reported = report(config, setup, options, found, recorder, ending, to_come) if worth else None
        if ending.error is not None:
            raise ending.error
    for fault in to_come.waiting if to_come is not None else ():
        say(f"--fault {fault.injected.word}@{fault.touch} did not strike: there was no such moment")
    if found.stop is not None or asked.is_set():
        recording = recorder.summary().path
        leave(found.stop, len(found.touches), asked.signal_number, recording, arm_stopped=ending.arm_stopped)
    ending.raise_unwritten()
    return None if reported is None else (reported, found.maps)


def _run(
    config: ExploreConfig,
    setup: Setup,
    options: ExploreOptions,
    found: Exploration,
    recorder: Recorder,
    asked: Interruption,
    to_come: FaultsToCome | None,
    ending: ExplorationEnd,
) -> None:
    """Open the devices, explore, close them; `found` and `ending` hold what is known, also where this raises."""
    from deformscope.experiments.beside import stages_beside
    from deformscope.experiments.explore import explore
    from deformscope.experiments.touching_robot import touching_robot
    from deformscope.recording.losses import losses_of
    from deformscope.session import finish, run

    with setup.open_source() as source, status_line() as show:
        ending.start_ns = source.start_ns
        truth = setup.truth is not None and setup.truth.labels is not None
        place = setup.size_m, setup.placement.T_base_surface
        recorder.start_exploration(source.streams, source.start_ns, *place, truth=truth)
        watch = Watch(asked, show)
        with touching_robot(setup, source, options, watch) as robot, stages_beside(setup, options) as (beside, stage):
            try:
                with watch.halts(robot):
                    if to_come is not None:
                        robot.on_phase = to_come.phase_began
                    permit = _permitted(robot, setup, options, asked, ending, yes=config.yes)
                    experiment = _said(explore(setup.clock, stage, found, permit), show)
                    run(source, experiment, recorder, robot, beside)
            finally:
                ending.arm_stopped, ending.gaps_s = watch.arm_stopped, robot.gaps_s
                ending.session_s = (setup.clock() - source.start_ns) / 1e9
        ending.losses = losses_of(finish(source, recorder))
    for name, reason in source.failures.items():
        say(f"deformscope: device {name} failed: {reason}")


def _permitted(
    robot: TouchingRobot,
    setup: Setup,
    options: ExploreOptions,
    asked: Interruption,
    ending: ExplorationEnd,
    *,
    yes: bool,
) -> RigExperiment[None]:
    yield from permitted(robot, setup, options, setup.calibrated, asked, yes=yes)
    ending.began_s = time.perf_counter()


def _said(experiment: RigExperiment[None], show: Callable[[str], None]) -> RigExperiment[None]:
    """The same experiment; what it finds is printed as it comes."""
    given: Any = None
    answer: Callable[[Any], Step] = experiment.send
    while True:
        try:
            step = answer(given)
        except StopIteration:
            return
        if lines := [line for result in step.results for line in _remarks(result)]:
            show("")
            for line in lines:
                say(line)
        try:
            given, answer = (yield step), experiment.send
        except Exception as error:
            given, answer = error, experiment.throw


def _remarks(result: object) -> Iterator[str]:
    from deformscope.pictures.words import (
        dent_words,
        failed_words,
        interval_words,
        iou_words,
        stiffness_words,
        verdict_words,
    )
    from deformscope.stages.map.exploration import MapEstimate, PlannedTouch, StageFailure, TouchEstimate

    if isinstance(result, PlannedTouch):
        where = "" if result.target_m is None else f"next touch at {_cm(result.target_m)} cm: "
        yield where + result.reason
    elif isinstance(result, TouchEstimate):
        between = interval_words(result)
        yield (
            f"touch {result.number + 1} at {_cm(result.xyz_m[:2])} cm: {stiffness_words(result)}"
            + (f" ({between})" if between else "")
            + f", dent {dent_words(result)}"
        )
    elif isinstance(result, MapEstimate):
        yield "  map: " + ", ".join(one for one in (verdict_words(result), iou_words(result)) if one)
    elif isinstance(result, StageFailure):
        yield f"deformscope: {failed_words(result)}"


def _cm(xy_m: Any) -> str:
    return f"({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f})"


def _list() -> None:
    from deformscope.lab.faults import Injected
    from deformscope.lab.scenes import BUILT_IN, DRAWN

    print("simulated scenes; other hardnesses in newtons go as well (lab:two-80-200):")
    for name in BUILT_IN:
        kind = next((kind for kind in DRAWN if name.startswith(kind)), name)
        drawn = ", ".join(f"{one.what} {one.low:g} to {one.high:g}" for one in DRAWN[kind])
        print(f"  lab:{name:<22} {drawn or 'nothing is drawn'}")
    print("what can go wrong in them (--fault KIND@TOUCH):")
    for injected in Injected:
        print(f"  {injected.word:<26} {injected}")
