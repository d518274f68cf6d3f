"""Measurements of a rig's set-up, as pictures: residuals, the offset of clocks, and the compliance of an arm."""

from collections.abc import Sequence

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.pictures.figures import COLOURS, canvas, png_of
from deformscope.pictures.report import Figure
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.setup.timing import TimeOffset


def off_figure(off: FloatArray, names: Sequence[str], unit: str, sd: float, *, each: str, caption: str) -> Figure:
    """Distance of each measurement (n,) from the solution, with the estimated standard deviation. each: name of one
    measurement, for the text under the bars"""
    drawn = canvas(5.2, 4.2, layout="constrained")
    axis = drawn.subplots()
    axis.bar(np.arange(len(off)), off, color=COLOURS[0])
    axis.axhline(sd, color=COLOURS[1], linestyle="--", label=f"standard deviation {sd:.2g} {unit}")
    axis.set_xticks(np.arange(len(off)), names, rotation=45 if sum(map(len, names)) > 60 else 0)
    axis.set(title=caption, xlabel=each, ylabel=f"off by [{unit}]")
    axis.set_ylim(0.0, 1.2 * max(float(off.max(initial=0.0)), sd) or 1.0)  # room for the legend
    axis.grid(alpha=0.3, axis="y")
    axis.legend(loc="upper right")
    return Figure(png_of(drawn, 130), caption)


def offset_figure(found: TimeOffset, device: str, reference: str) -> Figure:
    """The posterior of the offset between two devices, and its interval."""
    caption = f"Delay of {device} against {reference}"
    drawn = canvas(5.2, 4.2, layout="constrained")
    axis = drawn.subplots()
    axis.plot(1e3 * found.offsets_s, found.density / 1e3, color=COLOURS[0])
    axis.axvspan(1e3 * found.low_s, 1e3 * found.high_s, color=COLOURS[1], alpha=0.3, label="90 % interval")
    around = max(found.high_s - found.low_s, 2e-3)
    axis.set(title=caption, xlabel="offset [ms]", ylabel="probability density [1/ms]")
    axis.set_xlim(1e3 * (found.low_s - 2 * around), 1e3 * (found.high_s + 2 * around))
    axis.grid(alpha=0.3)
    axis.legend()
    return Figure(png_of(drawn, 130), caption)


def compliance_png(touches: Sequence[ArmCompliance], concluded: ArmCompliance) -> bytes:
    """Compliance [mm/N] over the touches, with one deviation up and down."""
    figure = canvas(5.2, 4.2, layout="constrained")
    axis = figure.subplots()
    number = np.arange(1, len(touches) + 1)
    each = [1e3 * one.compliance_m_per_n for one in touches]
    spread = [1e3 * one.compliance_sd for one in touches]
    mean, sd = 1e3 * concluded.compliance_m_per_n, 1e3 * concluded.compliance_sd
    axis.errorbar(number, each, yerr=spread, fmt="o", capsize=5, color="tab:blue", label="touch")
    axis.axhspan(mean - sd, mean + sd, color="tab:orange", alpha=0.3, label=f"{mean:.3f} ± {sd:.3f} mm/N")
    axis.set_xticks(number)
    axis.set(xlabel="touch", ylabel="compliance [mm/N]", ylim=(0.0, 1.5 * max(*each, mean + sd)))
    axis.grid(alpha=0.3)
    axis.legend()
    return png_of(figure, 130)
