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
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.cli.benches import bench_of, lab_of
from deformscope.cli.common import quiet_warp, replacing, resolve_viewer, say, show_table, status_line, write_json
from deformscope.cli.exploring import Companion, leave, let_move
from deformscope.cli.rigs import until_interrupted
from deformscope.config import ExploreConfig

if TYPE_CHECKING:
    from deformscope.experiments.explore import ExploreOptions, Explorer, Moment, Robot
    from deformscope.experiments.explore_wired import Bench
    from deformscope.lab.faults import FaultsToCome
    from deformscope.recorder import Recorder
    from deformscope.stages.exploration import MapsKnown, Stopped


def run(config: ExploreConfig) -> None:
    """Explore a simulated scene, or what is before a rig."""
    if config.list_scenarios:
        _list()
        return
    from deformscope.experiments.explore import ExploreOptions

    quiet_warp()
    options = ExploreOptions(
        planner=config.planner,
        budget=config.touches,
        threshold=config.threshold,
        beta_model=config.beta_model,
        seed=config.output.seed,
    )
    explore_on(config, options)


def explore_on(config: ExploreConfig, options: ExploreOptions) -> dict[str, Any]:
    """Explore a simulated scene, or with the devices of a rig file; what was found, as in the JSON."""
    from deformscope.experiments.explore import ExplorationStopped, Explorer
    from deformscope.lab.faults import FaultAt, FaultsToCome
    from deformscope.recorder import Recorder
    from deformscope.session import watching

    faults = [FaultAt.parse(text, options.budget) for text in config.fault]
    bench, options, told = bench_of(config.rig, options, config.set_force, trusted=config.trust_rig)
    to_come = FaultsToCome(lab_of(bench), faults, options.seed) if faults else None
    settings = {"explore": dataclasses.asdict(options), "seed": options.seed, "simulated": bench.simulated, **told}
    settings |= {"size_m": list(bench.size_m), "arm": dataclasses.asdict(bench.arm)}
    viewer = resolve_viewer(config.output.viewer)
    record = config.output.record
    stop, stop_ns = None, 0
    with (
        until_interrupted() as asked,
        Recorder(
            record,
            viewer,
            settings,
            layout="exploration",
            overwrite=config.output.overwrite,
            real_time=bench.runs_itself,
        ) as recorder,
    ):
        with bench.source() as source, status_line() as show:
            recorder.start_exploration(
                source.streams, source.start_ns, bench.size_m, bench.placement.T_base_surface, truth=_has_regions(bench)
            )
            companion = Companion(
                None if bench.runs_itself else source, recorder, asked, show, to_come.phase_began if to_come else None
            )
            with (
                watching(source, recorder) if bench.runs_itself else contextlib.nullcontext() as recorded,
                bench.robot(companion) as robot,
            ):
                explorer = Explorer(robot.size_m, options, robot.arm, bench.truth)
                seconds = {"compute": 0.0, "slowest": 0.0}
                began = time.perf_counter()
                try:
                    companion.follow(robot, recorded)
                    let_move(robot, bench, options, bench.calibrated, asked, yes=config.yes)
                    _explore(robot, explorer, recorder, companion, show, seconds)
                except ExplorationStopped as error:
                    stop, stop_ns = companion.stopped(error), error.time_ns
                    explorer.stop_reason = f"stopped: {stop.kind}"
                except BaseException as error:
                    robot.halt(f"the exploration failed: {type(error).__name__}")
                    raise
                seconds["wall"] = time.perf_counter() - began
            recorder.write_items(source.take(0.0))
            seconds["session"] = (bench.clock() - source.start_ns) / 1e9
        recorder.write_items([*source.rest(), source.look()])
    failures = dict(source.failures)
    found = _found(config, explorer, seconds, bench, recorder.summary().path)
    found["fault"] = _fault(stop, stop_ns, source.start_ns, to_come)
    _tell(config, explorer, found, simulated=bench.simulated)
    for fault in to_come.waiting if to_come is not None else ():
        say(f"--fault {fault.injected.word}@{fault.touch} did not strike: there was no such moment")
    for name, reason in failures.items():
        say(f"deformscope: device {name} failed: {reason}")
    if stop is not None or asked.is_set():
        leave(stop, len(explorer.told), asked.signal_number, found["recording"], arm_told=companion.arm_told)
    return found


def _has_regions(bench: Bench) -> bool:
    return bench.truth is not None and bench.truth.labels is not None


def _explore(
    robot: Robot,
    explorer: Explorer,
    recorder: Recorder,
    companion: Companion,
    show: Callable[[str], None],
    seconds: dict[str, float],
) -> None:
    """Run it to its end; the explorer holds what was found, `seconds` what computing took."""
    from deformscope.experiments.explore import explore

    for moment in explore(robot, explorer):
        companion.write()
        for name, content in explorer.new_inputs():
            recorder.write_input(name, content)
        seconds["compute"] += moment.compute_s
        seconds["slowest"] = max(seconds["slowest"], moment.compute_s)
        recorder.write_results(moment.results, moment.now_ns, moment.touch, explorer.plan_cell_m, moment.seen_ns)
        show("")
        for line in _remarks(moment):
            say(line)


def _fault(stop: Stopped | None, stop_ns: int, start_ns: int, faults: FaultsToCome | None) -> dict[str, Any] | None:
    """Why it was stopped, and how long after the laboratory's fault; None where it was not."""
    if stop is None:
        return None
    struck = faults.struck if faults is not None else ()
    struck_ns = [struck_ns for _, struck_ns in struck if struck_ns <= stop_ns]
    return {
        "kind": stop.kind,
        "reason": stop.reason,
        "time_s": (stop_ns - start_ns) / 1e9,
        "noticed_after_s": (stop_ns - struck_ns[-1]) / 1e9 if struck_ns else None,
    }


def _remarks(moment: Moment) -> Iterator[str]:
    from deformscope.stages.exploration import MapsKnown, NextTouch, TouchTold

    for result in moment.results:
        if isinstance(result, NextTouch):
            where = "" if result.target_m is None else f"next touch at {_cm(result.target_m)} cm: "
            yield where + result.reason
        elif isinstance(result, TouchTold):
            more = "more than " if result.rigid else ""
            low, high = result.stiffness_interval
            yield (
                f"touch {result.number + 1} at {_cm(result.xyz_m[:2])} cm: {more}{result.stiffness_n_per_mm:.3g} N/mm"
                + ("" if result.rigid else f" ({low:.3g} to {high:.3g})")
                + f", dent {1e3 * result.depth_m:.1f} mm at {result.peak_force_n:.2f} N"
            )
        elif isinstance(result, MapsKnown):
            known = "" if result.iou is None else f", {result.iou:.2f} of the truth (IoU)"
            regions = f"{result.region_count} region{'s' * (result.region_count > 1)}"
            yield f"  map: {'gradual' if result.verdict == 'gradual' else regions}{known}"


def _found(
    config: ExploreConfig,
    explorer: Explorer,
    seconds: dict[str, float],
    bench: Bench,
    recording: Path | None,
) -> dict[str, Any]:
    """The JSON of design 5."""
    maps = explorer.maps() if explorer.told else None
    regions = explorer.region_map() if explorer.told else None
    touches = [
        {
            "xy_m": told.xyz_m[:2],
            "beta": told.beta,
            "beta_interval": told.beta_interval,
            "beta_verdict": told.beta_verdict,
            "apparent_stiffness_n_per_mm": told.stiffness_n_per_mm,
            "apparent_stiffness_interval": told.stiffness_interval,
            "rigid": told.rigid,
            "modulus_pa": told.modulus_pa,
            "depth_m": told.depth_m,
            "peak_force_n": told.peak_force_n,
        }
        for told in explorer.told
    ]
    truth = None
    if bench.truth is not None:  # a gradient has no regions, and none to compare with
        labels = bench.truth.labels
        count = 0 if labels is None else int(labels.max()) + 1
        iou, boundary_m = (None, None) if maps is None else (maps.iou, explorer.boundary_m())
        truth = {"region_count": count, "iou": iou, "boundary_m": boundary_m}
    return {
        "scenario": config.rig,
        "verdict": None if maps is None else maps.verdict,
        "touches": touches,
        "region_count": None if maps is None else maps.region_count,
        "regions": []
        if regions is None
        else [
            {"log_stiffness": level, "interval": interval, "rigid": bool(rigid)}
            for level, interval, rigid in zip(regions.level, regions.level_interval, regions.rigid, strict=True)
        ],
        "probability": None if regions is None else regions.probability,
        "truth": truth,
        "travel_m": explorer.travel_m,
        "max_force_n": bench.max_force_n,
        "seconds": seconds,
        "stop_reason": explorer.stop_reason,
        "recording": recording,
    }


def _tell(config: ExploreConfig, explorer: Explorer, found: dict[str, Any], *, simulated: bool) -> None:
    from deformscope.exploration_pictures import result_png

    maps = explorer.maps() if explorer.told else None
    rows = [("verdict", "none: nothing was touched")] if maps is None else _region_rows(explorer, maps)
    if found["truth"] is not None and found["truth"]["iou"] is not None:
        truth = found["truth"]
        off = "" if truth["boundary_m"] is None else f", border {100 * truth['boundary_m']:.1f} cm off"
        rows.append(("truth", f"{truth['region_count']} regions; IoU {truth['iou']:.3f}{off}"))
    elif found["truth"] is not None and not found["truth"]["region_count"]:
        rows.append(("truth", "no regions: the stiffness changes smoothly"))
    betas = [told.beta_verdict for told in explorer.told if told.beta is not None]
    if betas:
        common = max(set(betas), key=betas.count)
        rows.append(("beta", f"{common} in {betas.count(common)} of {len(betas)} touches"))
    largest = found["max_force_n"]
    if largest is None:
        largest = max((told.peak_force_n for told in explorer.told), default=0.0)
    rows += [
        ("touches", f"{len(explorer.told)}, travel {explorer.travel_m:.2f} m; {_ended(found['stop_reason'])}"),
        ("largest contact force", f"{largest:.2f} N, {'true' if simulated else 'measured'}"),
        ("time", f"{found['seconds']['session']:.0f} s of the robot, {found['seconds']['wall']:.0f} s here"),
    ]
    if found["recording"] is not None:
        rows.append(("recording", str(found["recording"])))
    if config.map is not None and maps is not None:
        with replacing(config.map) as file:
            file.write(_map_file(maps))
        rows.append(("map", str(config.map)))
    if config.picture is not None and maps is not None:
        with replacing(config.picture) as file:
            file.write(result_png(maps, config.rig))
        rows.append(("picture", str(config.picture)))
    show_table(f"{config.rig} (simulated)" if simulated else config.rig, rows)
    write_json(found, config.output.json)


def _region_rows(explorer: Explorer, maps: MapsKnown) -> list[tuple[str, str]]:
    import math

    regions = explorer.region_map()
    kind = "gradual: no regions, the stiffness changes smoothly" if maps.verdict == "gradual" else ""
    told = f"{maps.region_count} region{'s' * (maps.region_count > 1)}"
    sure = regions.probability["gradual" if kind else str(maps.region_count)]
    rows = [("verdict", f"{kind or told} (probability {sure:.2f})")]
    for number, (level, interval, rigid) in enumerate(
        zip(regions.level, regions.level_interval, regions.rigid, strict=True), start=1
    ):
        low, high = (math.exp(bound) for bound in interval)
        told = f"stiffer than {low:.3g} N/mm" if rigid else f"{math.exp(level):.3g} N/mm ({low:.3g} to {high:.3g})"
        rows.append((f"region {number}", f"{told} at {explorer.options.set_force_n:g} N"))
    return rows


def _map_file(maps: MapsKnown) -> bytes:
    """The maps as arrays (.npz): rows along y, columns along x, cells of cell_m with the surface's corner at (0, 0)."""
    import io

    import numpy as np

    arrays = {
        "cell_m": maps.cell_m,
        "stiffness_n_per_mm": maps.stiffness_n_per_mm,
        "stiffness_log_sd": maps.stiffness_log_sd,
        "labels": maps.labels,
        "label_probability": maps.label_probability,
        "contacts_m": maps.contacts_m,
        "beta": maps.beta,
        "beta_sd": maps.beta_sd,
        "truth_labels": maps.truth_labels,
    }
    file = io.BytesIO()
    known = {name: np.asarray(value) for name, value in arrays.items() if value is not None}
    np.savez_compressed(file, allow_pickle=False, **known)
    return file.getvalue()


def _cm(xy_m: Any) -> str:
    return f"({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f})"


def _ended(reason: str) -> str:
    return reason if reason.startswith("stopped") else f"stopped: {reason}"


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
