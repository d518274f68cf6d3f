"""`deformscope explore`: map how soft a surface is, and where, by looking and touching.

deformscope explore --list-scenarios
deformscope explore lab:two-60-150 --seed 3 --record r.rrd --picture map.png
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import quiet_warp, replacing, resolve_viewer, say, show_table, write_json
from deformscope.config import ExploreConfig
from deformscope.errors import InputError

if TYPE_CHECKING:
    from deformscope.experiments.explore import ExploreOptions, Explorer, Moment, Robot, Truth
    from deformscope.recorder import Recorder
    from deformscope.rig_source import RigSource

LAB = "lab:"
RECORD_EVERY = 50
"""Control periods."""


def run(config: ExploreConfig) -> None:
    """Explore a simulated scene."""
    if config.list_scenarios:
        _list()
        return
    from deformscope.experiments.explore import ExploreOptions

    quiet_warp()
    options = ExploreOptions(
        planner=config.planner,
        budget=config.touches,
        threshold=config.threshold,
        set_force_n=config.set_force,
        beta_model=config.beta_model,
        seed=config.output.seed,
    )
    if not config.rig.startswith(LAB):
        raise InputError("lab:NAME (no real arm is moved by this version)", repr(config.rig), "--list-scenarios")
    explore_lab(config, options)


def explore_lab(config: ExploreConfig, options: ExploreOptions) -> dict[str, Any]:
    """Explore a simulated scene through the real drivers on doubles; what was found, as in the JSON."""
    from deformscope.experiments.explore_wired import LabBench
    from deformscope.lab.scenes import built_in
    from deformscope.recorder import Recorder

    scene = built_in(config.rig.removeprefix(LAB), options.seed)
    options = dataclasses.replace(options, thickness_m=scene.thickness_m)
    bench = LabBench(scene, options)
    settings = {"explore": dataclasses.asdict(options), "scene": scene.name, "seed": options.seed, "simulated": True}
    settings |= {"size_m": list(scene.size_m), "arm": dataclasses.asdict(bench.arm)}
    viewer = resolve_viewer(config.output.viewer)
    record = config.output.record
    with Recorder(record, viewer, settings, layout="exploration", overwrite=config.output.overwrite) as recorder:
        with bench.source() as source:
            recorder.start_exploration(
                source.streams, source.start_ns, scene.size_m, bench.placement.T_base_surface, truth=bool(scene.pieces)
            )
            with bench.robot(_pump(source, recorder)) as robot:
                say(robot.preflight({"camera to surface": True, "arm's compliance": True}).table())
                explorer, seconds = _explore(robot, options, bench.truth, recorder)
            recorder.write_items(source.take(0.0))
            seconds["session"] = (bench.clock() - source.start_ns) / 1e9
        recorder.write_items([*source.rest(), source.look()])
    found = _found(config, explorer, seconds, bench.max_force_n, recorder.summary().path, scene.region_count)
    _tell(config, explorer, found)
    return found


def _pump(source: RigSource, recorder: Recorder) -> Callable[[], None]:
    """What records what the devices gave, twice a second of their clock: each time costs bytes and seconds."""
    state = {"at": 0}

    def pump() -> None:
        state["at"] += 1
        if state["at"] % RECORD_EVERY == 0:
            recorder.write_items(source.take(0.0))

    return pump


def _explore(
    robot: Robot, options: ExploreOptions, truth: Truth | None, recorder: Recorder
) -> tuple[Explorer, dict[str, float]]:
    """Run it to its end; the explorer holds what was found, the dictionary the seconds that computing took."""
    from deformscope.experiments.explore import Explorer, explore

    explorer = Explorer(robot.size_m, options, robot.arm, truth)
    compute_s = worst_s = 0.0
    began = time.perf_counter()
    for moment in explore(robot, explorer):
        for name, content in explorer.new_inputs():
            recorder.write_input(name, content)
        compute_s += moment.compute_s
        worst_s = max(worst_s, moment.compute_s)
        recorder.write_results(moment.results, moment.now_ns, moment.touch, explorer.plan_cell_m, moment.seen_ns)
        for line in _remarks(moment):
            say(line)
    seconds = {"compute": compute_s, "slowest": worst_s, "wall": time.perf_counter() - began}
    return explorer, seconds


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
    max_force_n: float,
    recording: Path | None,
    true_count: int,
) -> dict[str, Any]:
    """The JSON of design 5."""
    maps = explorer.maps()
    regions = explorer.region_map()
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
    if maps.truth_labels is not None:
        truth = {"region_count": true_count, "iou": maps.iou, "boundary_m": explorer.boundary_m()}
    return {
        "scenario": config.rig,
        "verdict": maps.verdict,
        "touches": touches,
        "region_count": maps.region_count,
        "regions": [
            {"log_stiffness": level, "interval": interval, "rigid": bool(rigid)}
            for level, interval, rigid in zip(regions.level, regions.level_interval, regions.rigid, strict=True)
        ],
        "probability": regions.probability,
        "truth": truth,
        "travel_m": explorer.travel_m,
        "max_force_n": max_force_n,
        "seconds": seconds,
        "stop_reason": explorer.stop_reason,
        "recording": recording,
    }


def _tell(config: ExploreConfig, explorer: Explorer, found: dict[str, Any]) -> None:
    import math

    from deformscope.exploration_pictures import result_png

    maps = explorer.maps()
    regions = explorer.region_map()
    kind = "gradual: no regions, the stiffness changes smoothly" if maps.verdict == "gradual" else ""
    rows = [("verdict", kind or f"{maps.region_count} region{'s' * (maps.region_count > 1)}")]
    for number, (level, interval, rigid) in enumerate(
        zip(regions.level, regions.level_interval, regions.rigid, strict=True), start=1
    ):
        low, high = (math.exp(bound) for bound in interval)
        told = f"stiffer than {low:.3g} N/mm" if rigid else f"{math.exp(level):.3g} N/mm ({low:.3g} to {high:.3g})"
        rows.append((f"region {number}", f"{told} at {config.set_force:g} N"))
    if found["truth"] is not None:
        truth = found["truth"]
        off = "" if truth["boundary_m"] is None else f", border {100 * truth['boundary_m']:.1f} cm off"
        rows.append(("truth", f"{truth['region_count']} regions; IoU {truth['iou']:.3f}{off}"))
    betas = [told.beta_verdict for told in explorer.told if told.beta is not None]
    if betas:
        common = max(set(betas), key=betas.count)
        rows.append(("beta", f"{common} in {betas.count(common)} of {len(betas)} touches"))
    rows += [
        ("touches", f"{len(explorer.told)}, travel {explorer.travel_m:.2f} m; stopped: {found['stop_reason']}"),
        ("largest force", f"{found['max_force_n']:.2f} N"),
        ("time", f"{found['seconds']['session']:.0f} s of the robot, {found['seconds']['wall']:.0f} s here"),
    ]
    if found["recording"] is not None:
        rows.append(("recording", str(found["recording"])))
    if config.picture is not None:
        with replacing(config.picture) as file:
            file.write(result_png(maps, config.rig))
        rows.append(("picture", str(config.picture)))
    show_table(f"{config.rig} (simulated)", rows)
    write_json(found, config.output.json)


def _cm(xy_m: Any) -> str:
    return f"({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f})"


def _list() -> None:
    from deformscope.lab.scenes import BUILT_IN, DRAWN

    print("simulated scenes; other hardnesses in newtons go as well (lab:two-80-200):")
    for name in BUILT_IN:
        kind = next((kind for kind in DRAWN if name.startswith(kind)), name)
        drawn = ", ".join(f"{one.what} {one.low:g} to {one.high:g}" for one in DRAWN[kind])
        print(f"  lab:{name:<22} {drawn or 'nothing is drawn'}")
