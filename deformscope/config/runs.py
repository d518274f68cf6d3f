"""`deformscope demo` and `deformscope replay`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from deformscope.config.options import OutputOptions, RecordedOptions


@dataclass(frozen=True, slots=True)
class DemoConfig(RecordedOptions):
    """The main job on what is built in: a simulated arm maps the stiffness of a table with three materials, by looking
    and touching. Leaves runs/demo-<stamp>.rrd, or what --record names."""

    images: bool = False
    """Measure the images that ship instead: a specimen under tension, filmed."""

    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class ReplayConfig(RecordedOptions):
    """Run the same stages on a recording's inputs, and compare with the numbers that it holds."""

    recording: Annotated[Path, Positional, arg(metavar="FILE.rrd")]
    """The recording."""
    pace: Literal["fast", "real", "step"] = "fast"
    """As fast as possible, as it was recorded, or frame by frame at each Enter."""
    set: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="KEY=VALUE", help_behavior_hint="(repeatable)")] = ()
    """Another setting than the recorded one, of an exploration: what comes of it is printed beside what was recorded,
    and not compared to the bit. Several: --set beta_model=none --set threshold=0.1"""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def reads(self) -> tuple[str, ...]:
        return (str(self.recording),)
