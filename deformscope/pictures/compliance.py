"""The compliance of an arm as a picture: each touch with its deviation, and the estimate from all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deformscope.pictures.figures import canvas, png_of
from deformscope.stages.poke.contact import ArmCompliance


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
