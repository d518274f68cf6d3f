"""Flags of `deformscope bench`."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope.config import flags
from deformscope.config.options import CommandOptions


@dataclass(frozen=True, slots=True)
class BenchConfig(CommandOptions):
    """Measure the cost of MSM on this machine. Ctrl-C ends it and prints the measurements so far."""

    quick: bool = False
    """Smaller and fewer cases, in about 20 s."""
    only: flags.CasesFlag = None
    """Measure only these, of step, call, memory, relax, sweep, gradient, fit and cold."""
    sizes: flags.SizesFlag = None
    """Particles of the cubes that are stepped and relaxed; default: 216 to a million, on a GPU to ten."""
    repeats: flags.SomeFlag = None
    """Rounds of every comparison; default: as many as fit into a few seconds, 9 at most."""
    against: flags.FileFlag = None
    """The JSON of an earlier bench: each row's time is compared with it."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    json: flags.JsonFlag = None
    """Write all results as JSON; with -, stdout is the JSON alone. An existing file is replaced."""
