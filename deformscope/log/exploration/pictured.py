"""Results as pictures with axes and colour bars: `deformscope.pictures.exploration` draws them."""

from __future__ import annotations

from deformscope.arrays import FloatArray
from deformscope.log.exploration.moment import ResultBatch
from deformscope.pictures import exploration as pictures
from deformscope.stages.map.exploration import MapEstimate, PlannedTouch, SurfaceEstimate, TouchEstimate

HEIGHT, GAIN = "display/surface/height", "display/plan/gain"
FORCE, SECTION = "display/touch/force", "display/touch/section"
MAPS = {f"display/maps/{quantity}": quantity for quantity in pictures.MAP_DRAWINGS}


def log_nothing_known(now: ResultBatch) -> None:
    """Words where there will be pictures."""
    for path, words in {**dict.fromkeys([*MAPS, FORCE, SECTION], "no touch yet"), GAIN: "no plan yet"}.items():
        now.show_png(path, pictures.words_png(words))


def log_height(now: ResultBatch, surface: SurfaceEstimate) -> None:
    now.show_png(HEIGHT, pictures.height_png(surface))


def log_maps(now: ResultBatch, maps: MapEstimate) -> None:
    for path, quantity in MAPS.items():
        now.show_png(path, pictures.map_png(quantity, maps))


def log_gain(now: ResultBatch, plan: PlannedTouch, cell_m: float, contacts_m: FloatArray | None) -> None:
    now.show_png(GAIN, pictures.gain_png(plan, cell_m, contacts_m))


def log_curves(now: ResultBatch, touch: TouchEstimate) -> None:
    now.show_png(FORCE, pictures.force_png(touch))
    now.show_png(SECTION, pictures.section_png(touch))
