"""`deformscope explore`: map how soft a surface is, and where, by looking and touching.

deformscope explore --list-scenarios
deformscope explore lab:two-60-150 --seed 3 --record r.rrd --picture map.png
deformscope explore lab:two-60-150 --fault force-silent@2 --record stopped.rrd
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import EXIT_LOSSES, quiet_warp, resolve_viewer, say, status_line
from deformscope.cli.explored import ExplorationEnd, report
from deformscope.cli.exploring import Companion, leave, let_move
from deformscope.cli.rigs import until_interrupted
from deformscope.cli.setups import setup_of
from deformscope.config import ExploreConfig

if TYPE_CHECKING:
    from deformscope.cli.rigs import Interruption
    from deformscope.experiments.explore import ExploreOptions, Explorer, Moment
    from deformscope.experiments.touching_robot import TouchingRobot
    from deformscope.lab.faults import FaultsToCome
    from deformscope.recording.recorder import Recorder
    from deformscope.robot.setup import Setup


def run(config: ExploreConfig) -> int:
    """Explore a simulated scene, or what is before a rig. Returns the command's exit status."""
    if config.list_scenarios:
        _list()
        return 0
    from deformscope.experiments.explore import ExploreOptions

    quiet_warp()
    options = ExploreOptions(
        planner=config.planner,
        budget=config.touches,
        threshold=config.threshold,
        beta_model=config.beta_model,
        seed=config.output.seed,
    )
    found = explore_on(config, options)
    if found is None or not found["losses"] or config.output.record is None:
        return 0
    from deformscope.recording.losses import named

    say(f"deformscope: the recording is whole, with losses: {named(found['losses'])}")
    return EXIT_LOSSES


def explore_on(config: ExploreConfig, options: ExploreOptions) -> dict[str, Any] | None:
    """Explore a simulated scene, or with the devices of a rig file; what was found, as in the JSON, None where nothing
    was begun. Whatever ends it, the arm is halted, and what is known is reported before the recording is closed."""
    from deformscope.experiments.explore import Explorer
    from deformscope.lab.faults import FaultAt, FaultsToCome
    from deformscope.recording.recorder import Recorder
    from deformscope.stages.poke.contact import ArmCompliance

    faults = [FaultAt.parse(text, options.budget) for text in config.fault]
    opening = setup_of(config.rig, options, config.set_force, trusted=config.trust_rig)
    setup, options = opening.setup, opening.options
    to_come = FaultsToCome(opening.faulty_lab, faults, options.seed) if faults else None
    arm = ArmCompliance(setup.compliance_m_per_n, setup.compliance_sd)
    settings = {"explore": dataclasses.asdict(options), "seed": options.seed, "simulated": setup.simulated}
    settings |= {"size_m": list(setup.size_m), "arm": dataclasses.asdict(arm), **opening.settings}
    output = config.output
    explorer = Explorer(setup.size_m, options, arm, setup.truth)
    ending = ExplorationEnd()
    with (
        until_interrupted() as asked,
        Recorder(
            output.record,
            resolve_viewer(output.viewer),
            settings,
            layout="exploration",
            overwrite=output.overwrite,
            real_time=setup.runs_itself,
        ) as recorder,
    ):
        try:
            _run(config, setup, explorer, recorder, asked, to_come, ending)
        except BaseException as error:
            ending.error = error
        found = report(config, setup, explorer, recorder, ending, to_come) if ending.worth_a_report else None
        if ending.error is not None:
            raise ending.error
    for fault in to_come.waiting if to_come is not None else ():
        say(f"--fault {fault.injected.word}@{fault.touch} did not strike: there was no such moment")
    if ending.stop is not None or asked.is_set():
        recording = recorder.summary().path
        leave(ending.stop, len(explorer.told), asked.signal_number, recording, arm_told=ending.arm_told)
    ending.raise_unwritten()
    return found


def _run(
    config: ExploreConfig,
    setup: Setup,
    explorer: Explorer,
    recorder: Recorder,
    asked: Interruption,
    to_come: FaultsToCome | None,
    ending: ExplorationEnd,
) -> None:
    """Open the devices, explore, close them; `explorer` and `ending` hold what is known, also where this raises."""
    from deformscope.experiments.explore import ExplorationStopped
    from deformscope.experiments.touching_robot import touching_robot
    from deformscope.recording.losses import losses_of
    from deformscope.session import watching

    with setup.open_source() as source, status_line() as show:
        ending.start_ns = source.start_ns
        recorder.start_exploration(
            source.streams, source.start_ns, setup.size_m, setup.placement.T_base_surface, truth=_has_regions(setup)
        )
        companion = Companion(
            None if setup.runs_itself else source, recorder, asked, show, to_come.phase_began if to_come else None
        )
        with (
            watching(source, recorder) if setup.runs_itself else contextlib.nullcontext() as recorded,
            touching_robot(setup, source, explorer.options, companion) as robot,
        ):
            try:
                with companion.halts(robot):
                    companion.follow(robot, recorded)
                    let_move(robot, setup, explorer.options, setup.calibrated, asked, yes=config.yes)
                    ending.began_s = time.perf_counter()
                    _explore(robot, explorer, recorder, companion, show, ending)
            except ExplorationStopped as error:
                ending.stop, ending.stop_ns = error.stop, error.time_ns
                explorer.stop_reason = f"stopped: {error.stop.kind}"
                companion.stopped(error, robot)
            finally:
                ending.arm_told = companion.arm_told
                ending.session_s = (setup.clock() - source.start_ns) / 1e9
        recorder.write_items(source.take(0.0))
    last = source.look()
    ending.losses = losses_of(last)
    recorder.write_items([*source.rest(), last])
    for name, reason in source.failures.items():
        say(f"deformscope: device {name} failed: {reason}")


def _has_regions(setup: Setup) -> bool:
    return setup.truth is not None and setup.truth.labels is not None


def _explore(
    robot: TouchingRobot,
    explorer: Explorer,
    recorder: Recorder,
    companion: Companion,
    show: Callable[[str], None],
    ending: ExplorationEnd,
) -> None:
    """Run it to its end."""
    from deformscope.experiments.explore import explore

    for moment in explore(robot, explorer):
        companion.write()
        for name, content in explorer.new_inputs():
            recorder.write_input(name, content)
        ending.compute_s += moment.compute_s
        ending.slowest_s = max(ending.slowest_s, moment.compute_s)
        recorder.write_results(moment.results, moment.now_ns, moment.touch, explorer.plan_cell_m, moment.seen_ns)
        show("")
        for line in _remarks(moment):
            say(line)


def _remarks(moment: Moment) -> Iterator[str]:
    from deformscope.pictures.words import (
        dent_words,
        failed_words,
        interval_words,
        iou_words,
        stiffness_words,
        verdict_words,
    )
    from deformscope.stages.map.exploration import MapEstimate, PlannedTouch, StageFailure, TouchEstimate

    for result in moment.results:
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
