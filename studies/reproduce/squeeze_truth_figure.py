"""Errors of events, poses and changes of depth of simulated squeezes, as a picture."""

from collections.abc import Sequence

import numpy as np

from deformscope.pictures.figures import COLOURS, canvas, png_of
from studies.reproduce.squeeze_truth import PERIODS, SHIFT_M, TURN_DEG, Numbers, numbers_of


def truth_png(every: Sequence[Numbers]) -> bytes:
    """Four panels, each with the tolerance as dotted lines."""
    squeezed = [one for one in every if "stopped" not in one]
    figure = canvas(10.4, 7.0, layout="constrained")
    events, lost, poses, depth = figure.subplots(2, 2).flat
    bins = np.arange(-6.25, 6.5, 0.5)
    for axis, ending, words in ((events, "", "all frames"), (lost, "_lost", "frames lost")):
        for color, name, event in ((COLOURS[0], "first", "first contact"), (COLOURS[1], "steady", "steady state")):
            off = np.clip(numbers_of(squeezed, f"{name}{ending}"), bins[0], bins[-1])
            axis.hist(off[np.isfinite(off)], bins, color=color, alpha=0.6, label=event)
        for end in (-PERIODS, PERIODS):
            axis.axvline(end, color="tab:gray", linestyle=":")
        axis.set(xlabel="found less true [sample periods]", ylabel="squeezes", title=f"Events, {words}")
        axis.legend(fontsize=8)
    poses.scatter(numbers_of(squeezed, "shift_mm"), numbers_of(squeezed, "turn_deg"), s=14, color=COLOURS[0])
    poses.axvline(1e3 * SHIFT_M, color="tab:gray", linestyle=":")
    poses.axhline(TURN_DEG, color="tab:gray", linestyle=":")
    poses.set(
        xlabel="shift where observed [mm]", ylabel="turn where observed [deg]", title="Worst pose of each squeeze"
    )
    poses.set(xlim=(0, None), ylim=(0, None))
    noise = numbers_of(squeezed, "noise_mm")
    for index, content in enumerate(sorted({str(one["content"]) for one in squeezed})):
        own = np.array([one["content"] == content for one in squeezed])
        mean, rms = numbers_of(squeezed, "depth_mean_mm")[own], numbers_of(squeezed, "depth_rms_mm")[own]
        depth.scatter(mean, rms, s=14, color=COLOURS[index % len(COLOURS)], label=content)
    if np.isfinite(noise).any():
        depth.axhline(float(np.nanmean(noise)), color="tab:gray", linestyle=":", label="noise of a pixel")
    depth.set(
        xlabel="mean [mm]", ylabel="root mean square [mm]", title="Change of depth, measured less true", ylim=(0, None)
    )
    depth.legend(fontsize=8)
    for axis in (events, lost, poses, depth):
        axis.grid(alpha=0.25)
    return png_of(figure, 110)
