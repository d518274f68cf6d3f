"""`deformscope bench`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deformscope.config.flags import CasesFlag, CountFlag, JsonFlag, SizesFlag
from deformscope.config.options import JsonOptions
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class BenchConfig(JsonOptions):
    """Measure what MSM costs on this machine, beside NumPy. Ctrl-C ends it and shows what has been measured."""

    peers: bool = False
    """Run other engines too: pypbd, and mujoco and newton where they are installed (deformscope[peers])."""
    quick: bool = False
    """Less of everything, in some 20 s."""
    only: CasesFlag = None
    """Measure these alone, out of step, memory, relax, sweep, theta, gradient, fit and cold."""
    sizes: SizesFlag = None
    """Particles of the cubes that are stepped and relaxed; default: 216 to a million, on a GPU to ten."""
    repeats: CountFlag = None
    """Rounds of every comparison; default: what fits into a few seconds, 9 at most."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    json: JsonFlag = None
    """Write all of it as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        if self.repeats is not None and self.repeats < 1:
            raise InputError("--repeats of 1 or more", str(self.repeats))
