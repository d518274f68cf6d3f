"""What a command is told to explore with, as a robot to be opened: a simulated scene, or the devices of a rig file."""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.errors import InputError

if TYPE_CHECKING:
    from deformscope.experiments.explore import ExploreOptions
    from deformscope.experiments.explore_wired import Bench

LAB = "lab:"


def bench_of(
    name: str, options: ExploreOptions, set_force_n: float | None, *, trusted: bool
) -> tuple[Bench, ExploreOptions, dict[str, Any]]:
    """The bench of `lab:NAME` or of a rig file, closed; how to explore on it; and what is to be told of it.

    set_force_n: None = as the rig file says; trusted: as for `deformscope.rig.rig_file.load_rig`
    """
    if name.startswith(LAB):
        from deformscope.experiments.explore_wired import LabBench
        from deformscope.lab.scenes import built_in

        scene = built_in(name.removeprefix(LAB), options.seed)
        options = dataclasses.replace(options, thickness_m=scene.thickness_m)
        if set_force_n is not None:
            options = dataclasses.replace(options, set_force_n=set_force_n)
        return LabBench(scene, options), options, {"scene": scene.name}
    from deformscope.experiments.explore_rig import RigBench, options_of
    from deformscope.rig.rig_file import load_rig

    if not Path(name).exists() and _is_scene(name):
        raise InputError("a rig file, or lab:NAME", repr(name), f"{LAB}{name}")
    rig = load_rig(name, trusted=trusted)
    options = options_of(rig, options, set_force_n)
    return RigBench(rig, options), options, {"rig": rig.text, "rig_name": rig.name, "scene": rig.surface.scene}


def _is_scene(name: str) -> bool:
    from deformscope.lab.scenes import built_in

    with contextlib.suppress(InputError):
        built_in(name)
        return True
    return False


def lab_of(bench: Bench) -> Any:
    """The simulated laboratory, whose faults can be asked for. Raises InputError for other benches."""
    lab = getattr(bench, "lab", None)
    if lab is None:
        raise InputError("--fault with a simulated scene alone", "a rig", "lab:two-60-150")
    return lab
