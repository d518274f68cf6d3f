"""What is known so far, in words and numbers."""

from __future__ import annotations

import numpy as np
import rerun as rr

from deformscope.exploration_pictures import travel_m
from deformscope.log.exploration.moment import Moment
from deformscope.stages.exploration import MapsKnown

SUMMARY = "display/summary"
SURE = 0.9


def log_summary(now: Moment, maps: MapsKnown) -> None:
    now.send(SUMMARY, rr.TextDocument.columns(text=[summary(maps)], media_type=["text/markdown"]))


def log_no_summary(now: Moment) -> None:
    now.send(SUMMARY, rr.TextDocument.columns(text=["# No touch yet"], media_type=["text/markdown"]))


def summary(maps: MapsKnown) -> str:
    """Markdown: the verdict first, then the regions and the numbers."""
    gradual = maps.verdict == "gradual"
    counted = f"{maps.region_count} region{'' if maps.region_count == 1 else 's'}"
    scored = "" if maps.iou is None else f"; IoU with the truth **{maps.iou:.2f}**"
    lines = [
        f"# {'Gradual: no regions' if gradual else counted}",
        "",
        f"after **{maps.touches}** touches, {travel_m(maps):.2f} m from one to the next",
        "",
        f"{100 * float(np.mean(maps.label_probability > SURE)):.0f} % of the cells are sure (p > {SURE:g}){scored}",
        "",
    ]
    if gradual:
        return "\n".join(lines)
    lines += ["| region | stiffness [N/mm] | area [cm²] |", "| --- | --- | --- |"]
    for label in range(maps.region_count):
        inside = maps.labels == label
        if inside.any():
            lines.append(f"| {label + 1} | {maps.level_words(label)} | {inside.sum() * (100 * maps.cell_m) ** 2:.0f} |")
    return "\n".join(lines)
