"""How much an arm yields, as a picture: each touch with its deviation, and what is concluded from all."""

from __future__ import annotations

import numpy as np

from deformscope.experiments.arm_compliance import ArmGive
from deformscope.pictures.figures import canvas, png_of


def compliance_png(found: ArmGive) -> bytes:
    """Compliance [mm/N] over the touches, with one deviation up and down."""
    figure = canvas(5.2, 4.2, layout="constrained")
    axis = figure.subplots()
    number = np.arange(1, len(found.touches) + 1)
    each = [1e3 * one.found.compliance_m_per_n for one in found.touches]
    spread = [1e3 * one.found.compliance_sd for one in found.touches]
    mean, sd = 1e3 * found.compliance_m_per_n, 1e3 * found.compliance_sd
    axis.errorbar(number, each, yerr=spread, fmt="o", capsize=5, color="tab:blue", label="touch")
    axis.axhspan(mean - sd, mean + sd, color="tab:orange", alpha=0.3, label=f"{mean:.3f} ± {sd:.3f} mm/N")
    axis.set_xticks(number)
    axis.set(xlabel="touch", ylabel="compliance [mm/N]", ylim=(0.0, 1.5 * max(*each, mean + sd)))
    axis.grid(alpha=0.3)
    axis.legend()
    return png_of(figure, 130)
