"""Results as pictures, which `deformscope.pictures.exploration` draws, as lanes over time and as lines of text."""

from __future__ import annotations

import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.log.exploration.perception import log_on_surface
from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.columns import Sink, states
from deformscope.pictures import exploration as pictures
from deformscope.pictures.messages import counted, format_failure, format_inclusions
from deformscope.pictures.palette import BAD, Rgb
from deformscope.pictures.render_process import render
from deformscope.rows import ENTITIES
from deformscope.stages.map.exploration import (
    ExplorationStop,
    InclusionsResult,
    MapEstimate,
    PhaseStart,
    PlannedTouch,
    StageFailure,
    SurfaceEstimate,
    TouchEstimate,
)

HEIGHT, GAIN = "display/surface/height", "display/plan/gain"
FORCE, SECTION = "display/touch/force", "display/touch/section"
LUMPS, MISSED, INCLUSIONS_SUMMARY = (f"display/lumps/{what}" for what in ("map", "missed", "summary"))
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


def log_nothing_known(now: ResultBatch) -> None:
    """Log texts in place of pictures that do not exist yet."""
    for path, words in {**dict.fromkeys([*MAPS, FORCE, SECTION], "no touch yet"), GAIN: "no plan yet"}.items():
        now.show_png(path, pictures.text_png, words)


def log_height(now: ResultBatch, surface: SurfaceEstimate) -> None:
    now.show_png(HEIGHT, pictures.height_png, surface)


def log_maps(now: ResultBatch, maps: MapEstimate) -> None:
    for path, quantity in MAPS.items():
        drawn = render(pictures.draw_map, quantity, maps)
        now.show(path, rr.EncodedImage(contents=drawn.png, media_type="image/png"))
        if drawn.values.size:
            log_on_surface(now, quantity, drawn)


def log_inclusions(now: ResultBatch, found: InclusionsResult) -> None:
    now.show_png(LUMPS, pictures.inclusions_png, found)
    now.show_png(MISSED, pictures.miss_probability_png, found)
    text = "\n\n".join(f"**{name}**: {words}" for name, words in found.rows)
    title = f"# {format_inclusions(found)} after {counted(len(found.contacts_m), 'touch')}"
    now.show_text(INCLUSIONS_SUMMARY, f"{title}\n\n{text}")


def log_gain(now: ResultBatch, plan: PlannedTouch, cell_m: float, contacts_m: FloatArray | None) -> None:
    now.show_png(GAIN, pictures.gain_png, plan, cell_m, contacts_m)


def log_curves(now: ResultBatch, touch: TouchEstimate) -> None:
    now.show_png(FORCE, pictures.force_png, touch)
    now.show_png(SECTION, pictures.section_png, touch)


def log_phase_colors(rec: Sink) -> None:
    rec.log(ENTITIES[PhaseStart], states(PHASES), static=True)


def log_phase(now: ResultBatch, phase: PhaseStart) -> None:
    now.show_phase(phase, PHASES)


def log_failed(now: ResultBatch, failed: StageFailure) -> None:
    """Failures on a touch, with their place in the code."""
    now.show_words(ENTITIES[StageFailure], f"{format_failure(failed)}\n{failed.trace}".strip(), "ERROR")


def log_stopped(now: ResultBatch, stop: ExplorationStop) -> None:
    now.show_words(ENTITIES[ExplorationStop], f"{stop.kind}: {stop.reason}", "ERROR")
