"""What a rig's set-up was measured from, as pictures: how far each measurement is off, and the offset of clocks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.pictures.figures import COLOURS, canvas, png_of
from deformscope.stages.setup.timing import TimeOffset


def off_png(off: FloatArray, names: Sequence[str], unit: str, sd: float) -> bytes:
    """How far each measurement (n,) is from where the solution has it, with the deviation that was found."""
    drawn = canvas(5.2, 4.2, layout="constrained")
    axis = drawn.subplots()
    axis.bar(np.arange(len(off)), off, color=COLOURS[0])
    axis.axhline(sd, color=COLOURS[1], linestyle="--", label=f"deviation {sd:.2g} {unit}")
    axis.set_xticks(np.arange(len(off)), names, rotation=45 if len(off) > 6 else 0)
    axis.set(ylabel=f"off by [{unit}]")
    axis.grid(alpha=0.3, axis="y")
    axis.legend()
    return png_of(drawn, 130)


def offset_png(found: TimeOffset) -> bytes:
    """The posterior of an offset, and its interval."""
    drawn = canvas(5.2, 4.2, layout="constrained")
    axis = drawn.subplots()
    axis.plot(1e3 * found.offsets_s, found.density / 1e3, color=COLOURS[0])
    axis.axvspan(1e3 * found.low_s, 1e3 * found.high_s, color=COLOURS[1], alpha=0.3, label="90 % interval")
    around = max(found.high_s - found.low_s, 2e-3)
    axis.set(xlabel="offset [ms]", ylabel="density [1/ms]")
    axis.set_xlim(1e3 * (found.low_s - 2 * around), 1e3 * (found.high_s + 2 * around))
    axis.grid(alpha=0.3)
    axis.legend()
    return png_of(drawn, 130)
