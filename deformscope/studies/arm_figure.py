"""How much an arm gives way, as a picture: each touch with its deviation, and what is concluded from all."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deformscope.experiments.arm_compliance import ArmGive


def compliance_png(found: ArmGive) -> bytes:
    """Compliance [mm/N] over the touches, with one deviation up and down."""
    figure = Figure(figsize=(5.2, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
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
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=130)
    return file.getvalue()
