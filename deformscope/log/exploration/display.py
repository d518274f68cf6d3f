"""Results as pictures, which `deformscope.pictures.exploration` draws, as lanes over time and as lines of text."""

import numpy as np
import rerun as rr

from deformscope.log.exploration.perception import log_on_surface
from deformscope.log.result_batch import ResultBatch
from deformscope.pictures import exploration as pictures
from deformscope.pictures import messages
from deformscope.pictures.palette import BAD, Rgb
from deformscope.pictures.render_process import render
from deformscope.rows import ENTITIES
from deformscope.stages.map.exploration import InclusionsResult, MapEstimate, StageFailure

HEIGHT, GAIN = "display/surface/height", "display/plan/gain"
FORCE, SECTION = "display/touch/force", "display/touch/section"
INCLUSIONS, MISSED, INCLUSIONS_SUMMARY = (f"display/lumps/{what}" for what in ("map", "missed", "summary"))
MAPS = {f"display/maps/{quantity}": quantity for quantity in pictures.MAP_DRAWINGS}

PHASES: dict[str, Rgb] = {
    "look": (86, 180, 233),
    "plan": (150, 120, 220),
    "travel": (110, 115, 125),
    "tare": (120, 160, 160),
    "approach": (230, 159, 0),
    "press": (213, 94, 0),
    "dwell": (0, 158, 115),
    "press more": (180, 70, 0),
    "dwell more": (0, 120, 90),
    "back off": (200, 60, 120),
    "retreat": (150, 155, 165),
    "paused": (190, 190, 190),
    "stopped": BAD,
}
"""States of the robot, each with its colour."""


def log_maps(now: ResultBatch, maps: MapEstimate) -> None:
    for path, quantity in MAPS.items():
        drawn = render(pictures.draw_map, quantity, maps)
        now.show(path, rr.EncodedImage(contents=drawn.png, media_type="image/png"))
        if drawn.values.size:
            log_on_surface(now, quantity, drawn)


def log_inclusions(now: ResultBatch, found: InclusionsResult) -> None:
    now.show_png(INCLUSIONS, pictures.inclusions_png, found)
    now.show_png(MISSED, pictures.miss_probability_png, found)
    text = "\n\n".join(f"**{name}**: {words}" for name, words in found.rows)
    title = f"# {messages.format_inclusions(found)} after {messages.counted(len(found.contacts_m), 'touch')}"
    now.show_text(INCLUSIONS_SUMMARY, f"{title}\n\n{text}")


def log_failed(now: ResultBatch, failed: StageFailure) -> None:
    """Failures on a touch, with their place in the code."""
    now.show_words(ENTITIES[StageFailure], f"{messages.format_failure(failed)}\n{failed.trace}".strip(), "ERROR")


SUMMARY = "display/summary"
SURE = 0.9


def log_summary(now: ResultBatch, maps: MapEstimate) -> None:
    now.show_text(SUMMARY, summary(maps))


def summary(maps: MapEstimate) -> str:
    """Markdown: the verdict first, then the regions and the numbers."""
    verdict = messages.format_verdict(maps)
    scored = f"; **{messages.format_iou(maps)}**" if maps.iou is not None else ""
    lines = [
        f"# {verdict[0].upper()}{verdict[1:]} (probability {maps.probability:.2f})",
        "",
        f"after **{messages.counted(maps.touches, 'touch')}**, {messages.format_travel(maps.travel_m)}",
        "",
        f"{100 * float(np.mean(maps.label_probability > SURE)):.0f} % of the cells are sure (p > {SURE:g}){scored}",
        "",
    ]
    if not maps.region_count:
        return "\n".join(lines)
    if maps.levelled_m is not None:
        lines += [f"stiffness {messages.stiffness_kind(maps)}", ""]
    lines += ["| region | stiffness [N/mm] | area [cm²] |", "| --- | --- | --- |"]
    for label, region in enumerate(maps.regions):
        area_cm2 = (maps.labels == label).sum() * (100 * maps.cell_m) ** 2
        level = region.level_text + (f" ({region.modulus_text})" if region.modulus_text else "")
        lines.append(f"| {label + 1} | {level} | {area_cm2:.0f} |")
    return "\n".join(lines)
