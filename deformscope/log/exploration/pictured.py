"""Results as pictures with axes and colour bars: `deformscope.exploration_pictures` draws them."""

from __future__ import annotations

from deformscope import exploration_pictures as pictures
from deformscope.arrays import FloatArray
from deformscope.log.exploration.moment import Moment
from deformscope.stages.exploration import MapsKnown, NextTouch, SurfaceSeen, TouchTold

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


def log_nothing_known(now: Moment) -> None:
    """Words where there will be pictures."""
    for path, words in {**dict.fromkeys([*MAPS, FORCE, SECTION], "no touch yet"), GAIN: "no plan yet"}.items():
        now.show_png(path, pictures.words_png(words))


def log_height(now: Moment, surface: SurfaceSeen) -> None:
    now.show_png(HEIGHT, pictures.height_png(surface))


def log_maps(now: Moment, maps: MapsKnown) -> None:
    for path, draw in MAPS.items():
        now.show_png(path, draw(maps))


def log_gain(now: Moment, plan: NextTouch, cell_m: float, contacts_m: FloatArray | None) -> None:
    now.show_png(GAIN, pictures.gain_png(plan, cell_m, contacts_m))


def log_curves(now: Moment, touch: TouchTold) -> None:
    now.show_png(FORCE, pictures.force_png(touch))
    now.show_png(SECTION, pictures.section_png(touch))
