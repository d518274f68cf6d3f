"""What an exploration leaves, however it ends: the table, the JSON, the maps, the picture, and what the arm does."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope import __version__
from deformscope.api.exploration import exploration_rows
from deformscope.cli.common import say, show_table, write_file, write_json
from deformscope.errors import InputError
from deformscope.pictures import exploration as pictures

if TYPE_CHECKING:
    from deformscope.arrays import FloatArray
    from deformscope.config import ExploreConfig
    from deformscope.experiments.explore import Exploration
    from deformscope.experiments.options import ExploreOptions
    from deformscope.lab.faults import FaultsToCome
    from deformscope.recording.recorder import Recorder
    from deformscope.robot.setup import Setup
    from deformscope.stages.map.exploration import MapEstimate, TouchEstimate

UNITS = {
    "cell_m": "m",
    "stiffness_n_per_mm": "N/mm",
    "stiffness_log_sd": "natural logarithm",
    "labels": "region from 0, the softest; -1: no regions",
    "label_probability": "1",
    "contacts_m": "m, (x, y)",
    "beta": "1",
    "beta_sd": "1",
    "truth_labels": "region from 0",
}
"""Of the arrays in a file of maps."""
JSON_UNITS = {
    "apparent_stiffness_n_per_mm": "N/mm",
    "beta": "1",
    "depth_m": "m",
    "log_stiffness": "natural logarithm of N/mm",
    "max_force_n": "N",
    "modulus_pa": "Pa",
    "peak_force_n": "N",
    "set_force_n": "N",
    "seconds": "s",
    "travel_m": "m",
    "xy_m": "m",
}


@dataclass
class ExplorationEnd:
    """Why and when an exploration ended; filled in as it goes on.

    error: that ended it, other than a stop; start_ns: of the session, on the robot's clock
    arm_stopped: whether the arm could be stopped; began_s: when it could first move, 0 = never [s]
    session_s: by the robot's clock [s]; gaps_s: (n,) from each look of its supervisor to the next [s]
    losses: of each device that lost something (`deformscope.recording.losses`)
    unwritten: outputs that could not be written, and why
    """

    error: BaseException | None = None
    start_ns: int = 0
    arm_stopped: bool = True
    began_s: float = 0.0
    session_s: float = 0.0
    gaps_s: FloatArray | None = None
    losses: dict[str, dict[str, float]] = field(default_factory=dict)
    unwritten: list[InputError] = field(default_factory=list)

    def raise_unwritten(self) -> None:
        """Raises the first output that could not be written, once all else is done."""
        if self.unwritten:
            raise self.unwritten[0]


def report(
    config: ExploreConfig,
    setup: Setup,
    options: ExploreOptions,
    exploration: Exploration,
    recorder: Recorder,
    ending: ExplorationEnd,
    faults: FaultsToCome | None,
) -> dict[str, Any]:
    """Write and print what is known; returns the JSON of design 5. What cannot be written does not keep the rest from
    being written, and is in `ending.unwritten`."""
    exploration.failures += recorder.not_shown
    if ending.error is not None:
        exploration.stop_reason = f"error: {' '.join(str(ending.error).split()) or type(ending.error).__name__}"
    # after an error it keeps the name of an unfinished one
    recording = config.output.record if ending.error is None else recorder.summary().path
    found = _found(config, options, exploration, setup, ending, recording)
    found["fault"] = _fault(exploration, ending, faults)
    written = []
    if (maps := exploration.maps) is not None:
        if config.map is not None and _write(ending, config.map, lambda: _map_file(config, maps)):
            written.append(("map", str(config.map)))
        if config.picture is not None and _write(ending, config.picture, lambda: pictures.result_png(maps, config.rig)):
            written.append(("picture", str(config.picture)))
    try:
        write_json(found, config.output.json)
    except OSError as error:
        ending.unwritten.append(_unwritten(config.output.json or "", error))
    title = f"{config.rig} (simulated)" if setup.simulated else config.rig
    show_table(title, [*exploration_rows(found), *written])
    for one in ending.unwritten:
        say(f"deformscope: not written: {one}")
    return found


def _write(ending: ExplorationEnd, path: Path, make: Callable[[], bytes]) -> bool:
    try:
        write_file(path, make())
    except Exception as error:
        ending.unwritten.append(_unwritten(path, error))
        return False
    return True


def _unwritten(path: Path | str, error: Exception) -> InputError:
    words = error.strerror if isinstance(error, OSError) and error.strerror else f"{type(error).__name__}: {error}"
    return InputError("an output that can be written", " ".join(words.split()).lower(), where=path)


def _found(
    config: ExploreConfig,
    options: ExploreOptions,
    exploration: Exploration,
    setup: Setup,
    ending: ExplorationEnd,
    recording: Path | None,
) -> dict[str, Any]:
    maps = exploration.maps
    truth = None
    if setup.truth is not None:  # a gradient has no regions, and none to compare with
        labels = setup.truth.labels
        truth = {
            "region_count": 0 if labels is None else int(labels.max()) + 1,
            "iou": None if maps is None else maps.iou,
            "boundary_m": None if maps is None else maps.boundary_m,
        }
    return {
        "scenario": config.rig,
        "seed": options.seed,
        "version": __version__,
        "units": JSON_UNITS,
        "set_force_n": options.set_force_n,
        "verdict": None if maps is None else maps.verdict,
        "verdict_probability": None if maps is None else maps.probability,
        "touches": [_touch(one, exploration.failed(one.number + 1)) for one in exploration.touches],
        "region_count": None if maps is None else maps.region_count,
        "regions": [
            {
                "log_stiffness": float(np.log(maps.level_n_per_mm[region])),
                "interval": np.log(maps.level_interval_n_per_mm[region]),
                "rigid": bool(maps.level_rigid[region]),
            }
            for region in range(0 if maps is None else maps.region_count)
            if maps is not None
        ],
        "probability": exploration.region_probability,
        "truth": truth,
        "travel_m": exploration.travel_m,
        "max_force_n": setup.max_force_n,
        "seconds": {
            "compute": exploration.compute_s,
            "slowest": exploration.slowest_s,
            "session": ending.session_s,
            "wall": time.perf_counter() - ending.began_s if ending.began_s else 0.0,
        },
        "supervisor_gaps_ms": _gaps_ms(ending.gaps_s),
        "stop_reason": exploration.stop_reason,
        "arm_stands": ending.arm_stopped,
        "failures": [{"stage": one.stage, "touch": one.touch, "reason": one.reason} for one in exploration.failures],
        "losses": ending.losses,
        "recording": recording,
    }


def _touch(one: TouchEstimate, failed: list[str]) -> dict[str, Any]:
    same = ("beta", "beta_interval", "beta_verdict", "rigid", "modulus_pa", "depth_m", "peak_force_n")
    return {
        "xy_m": one.xyz_m[:2],
        "apparent_stiffness_n_per_mm": one.stiffness_n_per_mm,
        "apparent_stiffness_interval": one.stiffness_interval,
        **{name: getattr(one, name) for name in same},
        "failed": failed,
    }


def _fault(exploration: Exploration, ending: ExplorationEnd, faults: FaultsToCome | None) -> dict[str, Any] | None:
    """Why it was stopped, and how long after the laboratory's fault; None where it was not."""
    stop = exploration.stop
    if stop is None:
        return None
    struck = faults.struck if faults is not None else ()
    struck_ns = [struck_ns for _, struck_ns in struck if struck_ns <= exploration.stop_ns]
    return {
        "kind": stop.kind,
        "reason": stop.reason,
        "time_s": (exploration.stop_ns - ending.start_ns) / 1e9,
        "noticed_after_s": (exploration.stop_ns - struck_ns[-1]) / 1e9 if struck_ns else None,
    }


def _gaps_ms(gaps_s: FloatArray | None) -> dict[str, float] | None:
    """From one look of the supervisor to the next, None where the arm never could move [ms]."""
    if gaps_s is None or not len(gaps_s):
        return None
    shares = {"p50": 50.0, "p99": 99.0, "p99_9": 99.9, "max": 100.0}
    return {"count": len(gaps_s)} | {name: 1e3 * float(np.percentile(gaps_s, share)) for name, share in shares.items()}


def map_arrays(maps: MapEstimate) -> dict[str, np.ndarray]:
    """Those that are known: rows along y, columns along x, cells of cell_m with the surface's corner at (0, 0)."""
    return {name: np.asarray(value) for name in UNITS if (value := getattr(maps, name)) is not None}


def _map_file(config: ExploreConfig, maps: MapEstimate) -> bytes:
    made_by: dict[str, Any] = {"scenario": config.rig, "seed": config.output.seed, "version": __version__}
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, units=json.dumps(UNITS), **map_arrays(maps), **made_by)
    return file.getvalue()
