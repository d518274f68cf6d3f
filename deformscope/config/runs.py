"""`deformscope demo` and `deformscope replay`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config.options import OutputOptions, RecordedOptions


@dataclass(frozen=True, slots=True)
class DemoConfig(RecordedOptions):
    """Measure the sample that ships: real images of a specimen under tension. Leaves runs/demo-<stamp>.rrd, or what
    --record names."""

    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class ReplayConfig(RecordedOptions):
    """Run the same stages on a recording's inputs, and compare with the numbers that it holds."""

    recording: Annotated[Path, Positional, arg(metavar="FILE.rrd")]
    """The recording."""
    pace: Literal["fast", "real", "step"] = "fast"
    """As fast as possible, as it was recorded, or frame by frame at each Enter."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def reads(self) -> tuple[str, ...]:
        return (str(self.recording),)
