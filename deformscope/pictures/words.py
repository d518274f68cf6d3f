"""What was found, in words: the same words and digits in the terminal, the panel of a viewer and the pictures."""

from __future__ import annotations

from deformscope.stages.map.exploration import MapEstimate, StageFailure, TouchEstimate


def counted(number: int, word: str) -> str:
    """As in "1 touch", "2 touches"."""
    ending = "es" if word.endswith("ch") else "s"
    return f"{number} {word}{'' if number == 1 else ending}"


def verdict_words(maps: MapEstimate) -> str:
    """How many regions there are, if any."""
    return "gradual: no regions" if maps.verdict == "gradual" else counted(maps.region_count, "region")


def level_words(maps: MapEstimate, region: int) -> str:
    """A region's stiffness [N/mm], without its unit."""
    return f"{'> ' * bool(maps.level_rigid[region])}{maps.level_n_per_mm[region]:.3g}"


def region_words(maps: MapEstimate, region: int) -> str:
    """A region's stiffness with its interval."""
    if maps.level_rigid[region]:
        return f"{level_words(maps, region)} N/mm"
    low, high = maps.level_interval_n_per_mm[region]
    return f"{level_words(maps, region)} N/mm ({low:.3g} to {high:.3g})"


def travel_words(travel_m: float) -> str:
    """How far it was over the surface."""
    return f"travel {travel_m:.2f} m over the surface"


def iou_words(maps: MapEstimate) -> str:
    """How good the map is; empty where the truth is not known."""
    return "" if maps.iou is None else f"IoU {maps.iou:.3f}"


def stiffness_words(touch: TouchEstimate) -> str:
    """What a touch measured, without its interval."""
    if not touch.usable:
        return "no contact fitted"
    return f"{'> ' * touch.rigid}{touch.stiffness_n_per_mm:.3g} N/mm"


def interval_words(touch: TouchEstimate) -> str:
    """The interval of a touch's stiffness; empty where there is none."""
    if not touch.usable or touch.rigid:
        return ""
    low, high = touch.stiffness_interval
    return f"{low:.3g} to {high:.3g}"


def dent_words(touch: TouchEstimate) -> str:
    """The dent and the force that made it; the force alone where no contact was fitted."""
    force = f"{touch.peak_force_n:.2f} N"
    return f"{1e3 * touch.depth_m:.1f} mm at {force}" if touch.usable else force


def failed_words(failed: StageFailure) -> str:
    """What failed, and why."""
    where = f"touch {failed.touch}: " if failed.touch else ""
    return f"{where}{failed.stage} failed: {failed.reason}"
