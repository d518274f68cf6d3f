"""The exploration's results so far, as text and numbers."""

from __future__ import annotations

import numpy as np

from deformscope.log.result_batch import ResultBatch
from deformscope.pictures.messages import (
    counted,
    format_claim,
    format_iou,
    format_travel,
    format_verdict,
    stiffness_kind,
)
from deformscope.stages.map.exploration import MapEstimate

SUMMARY = "display/summary"
SURE = 0.9


def log_summary(now: ResultBatch, maps: MapEstimate) -> None:
    now.show_text(SUMMARY, summary(maps))


def summary(maps: MapEstimate) -> str:
    """Markdown: the verdict first, then the regions and the numbers."""
    verdict = format_verdict(maps)
    scored = f"; **{format_iou(maps)}**" if maps.iou is not None else ""
    lines = [
        f"# {verdict[0].upper()}{verdict[1:]} ({format_claim(maps.claimed)})",
        "",
        f"after **{counted(maps.touches, 'touch')}**, {format_travel(maps.travel_m)}",
        "",
        f"{100 * float(np.mean(maps.label_probability > SURE)):.0f} % of the cells are sure (p > {SURE:g}){scored}",
        "",
    ]
    if not maps.region_count:
        return "\n".join(lines)
    if maps.levelled_m is not None:
        lines += [f"stiffness {stiffness_kind(maps)}", ""]
    lines += ["| region | stiffness [N/mm] | area [cm²] |", "| --- | --- | --- |"]
    for label, region in enumerate(maps.regions):
        area_cm2 = (maps.labels == label).sum() * (100 * maps.cell_m) ** 2
        level = region.level_text + (f" ({region.modulus_text})" if region.modulus_text else "")
        lines.append(f"| {label + 1} | {level} | {area_cm2:.0f} |")
    return "\n".join(lines)
