"""Results as pictures with axes and colour bars: `deformscope.pictures.exploration` draws them."""

from __future__ import annotations

from deformscope.arrays import FloatArray
from deformscope.log.exploration.moment import ResultBatch
from deformscope.pictures import exploration as pictures
from deformscope.stages.map.exploration import MapEstimate, PlannedTouch, SurfaceEstimate, TouchEstimate

HEIGHT, GAIN = "display/surface/height", "display/plan/gain"
FORCE, SECTION = "display/touch/force", "display/touch/section"
MAPS = {
    "display/maps/stiffness": pictures.stiffness_png,
    "display/maps/stiffness_deviation": pictures.stiffness_deviation_png,
    "display/maps/beta": pictures.beta_png,
    "display/maps/beta_deviation": pictures.beta_deviation_png,
    "display/maps/regions": pictures.regions_png,
    "display/maps/truth": pictures.truth_png,
}


def log_nothing_known(now: ResultBatch) -> None:
    """Words where there will be pictures."""
    for path, words in {**dict.fromkeys([*MAPS, FORCE, SECTION], "no touch yet"), GAIN: "no plan yet"}.items():
        now.show_png(path, pictures.words_png(words))


def log_height(now: ResultBatch, surface: SurfaceEstimate) -> None:
    now.show_png(HEIGHT, pictures.height_png(surface))


def log_maps(now: ResultBatch, maps: MapEstimate) -> None:
    for path, draw in MAPS.items():
        now.show_png(path, draw(maps))


def log_gain(now: ResultBatch, plan: PlannedTouch, cell_m: float, contacts_m: FloatArray | None) -> None:
    now.show_png(GAIN, pictures.gain_png(plan, cell_m, contacts_m))


def log_curves(now: ResultBatch, touch: TouchEstimate) -> None:
    now.show_png(FORCE, pictures.force_png(touch))
    now.show_png(SECTION, pictures.section_png(touch))
