"""Results as text: the same words and digits in the terminal, a notebook, recordings, pictures and reports."""

from collections.abc import Sequence

from deformscope.pictures.report import Table
from deformscope.stages.fit.estimate import Choice, Doubt, Estimate, explained_text
from deformscope.stages.map.exploration import InclusionsResult, MapEstimate, StageFailure


def counted(number: int, word: str) -> str:
    """A number with its noun, as in "1 touch", "2 touches"."""
    ending = "es" if word.endswith("ch") else "s"
    return f"{number} {word}{'' if number == 1 else ending}"


def format_verdict(maps: MapEstimate) -> str:
    """How many regions there are, if any."""
    return "gradual: no regions" if maps.verdict == "gradual" else format_regions(maps)


def format_regions(maps: MapEstimate) -> str:
    """Number of regions, and their levels."""
    return "at least " * maps.more_possible + counted(maps.region_count, "region")


ENDED = {
    "budget": "the allowed number of touches is reached",
    "nothing above the threshold": "the map's variance is below the threshold everywhere",
    "little left to learn": "one more touch would hardly change the map",
    "nowhere to go": "no place is left that may be touched",
    "no lump missed": "it is unlikely that an inclusion of the requested size was missed",
}
"""Why a plan makes no further touch, by its stop reason (`stages.map.plan.StopReason`)."""


def format_stop(stop_reason: str) -> str:
    """Why no further touch was made; reasons that do not come from a plan are texts already."""
    return ENDED.get(stop_reason, stop_reason or "before its plan was carried out")


def stiffness_kind(maps: MapEstimate) -> str:
    """Kind of the map's stiffness."""
    return "apparent" if maps.levelled_m is None else f"as on a level layer {100 * maps.levelled_m:.2g} cm thick"


def format_travel(travel_m: float) -> str:
    """Travel of the tip over the surface, in words."""
    return f"travel {travel_m:.2f} m over the surface"


def format_iou(maps: MapEstimate) -> str:
    """Quality of the map, and its reference; empty without a known truth."""
    return "" if maps.iou is None else f"IoU {maps.iou:.3f} with the truth"


def format_inclusions(found: InclusionsResult) -> str:
    """How many inclusions were found."""
    return counted(len(found), "inclusion") if len(found) else "no inclusion found"


def format_failure(failed: StageFailure) -> str:
    """A failure, and its reason."""
    where = f"touch {failed.touch}: " if failed.touch else ""
    return f"{where}{failed.stage} failed: {failed.reason}"


def estimate_tables(estimate: Estimate, title: str) -> list[Table]:
    """Tables of the numbers, and of the ways of fitting that were tried, if any."""
    tables = [Table(estimate_rows(estimate), caption=title)]
    if estimate.selection:
        ways = list(map(_choice_row, estimate.selection))
        tables.append(Table(ways, caption="Error on particles left out, for each model that was fitted"))
    return tables


def _choice_row(one: Choice) -> tuple[str, str]:
    pace = "static" if one.alpha is None else f"alpha {one.alpha:g}, dt {one.dt:g} s"
    name = f"{one.cluster_size} a side, {','.join(one.held)}, {pace}"
    value = f"{one.held_out:.3g} ± {one.scatter:.2g} (fitted {one.fit:.3g}, at {one.value:.3g})"
    return name, value + (" <- used" if one.chosen else "")


def estimate_rows(estimate: Estimate) -> list[tuple[str, str]]:
    """An estimate as names and values."""
    found = estimate.settings
    rows = [
        *value_rows(estimate),
        *estimate.stiffness_rows(),
        *least_aee_rows(estimate),
        ("error, all particles", format_length(estimate, estimate.aee)),
        ("error, free particles", format_length(estimate, estimate.aee_free)),
        ("noise of a position", format_length(estimate, found.get("noise"))),
    ]
    if estimate.explained is not None:
        rows.append(("explained", explained_text(estimate.explained, estimate.reasons)))
    if not found.get("pose_held", True):
        rows.append(("pose", "the held particles leave the body free to turn: hold more for a reliable value"))
    if lost := found.get("lost"):
        every = int(str(found["particles"]))
        many = "; so many that the tracking may have failed: check the picture" if int(str(lost)) * 3 > every else ""
        rows.append(("lost particles", f"{lost} of {every}: left out of the fit{many}"))
    if moved := found.get("held_moved"):
        parts = ", ".join(moved) if isinstance(moved, list) else str(moved)
        rows.append(("held elsewhere", f"{parts}: lost there; the outermost row or column still seen is held"))
    if found.get("whole_motion"):
        rows.append(("frames fitted", _frames_text(estimate)))
    if estimate.selection_text:
        rows.append(("chosen", estimate.selection_text))
    return [*rows, ("converged", "yes" if estimate.converged else "NO: do not rely on the value")]


def value_rows(estimate: Estimate) -> list[tuple[str, str]]:
    """Value, interval, verdict and the reasons to doubt it."""
    low, high = estimate.interval
    return [
        (estimate.parameter, f"{estimate.value:.4g}"),
        (f"{estimate.level:.0%} interval", f"{low:.4g} to {high:.4g}"),
        ("verdict", estimate.verdict_text()),
        *reason_rows(estimate.reasons, besides=estimate.verdict_text()),
    ]


def least_aee_rows(estimate: Estimate) -> list[tuple[str, str]]:
    """The thesis's value, that of the least mean distance, if it was searched."""
    if estimate.least_aee is None:
        return []
    value, aee = estimate.least_aee
    return [("least AEE (thesis)", f"{format_length(estimate, aee)} at {estimate.parameter} {value:.4g}")]


def reason_rows(reasons: Sequence[Doubt], besides: str = "") -> list[tuple[str, str]]:
    """The reasons to doubt a value, one per row, without those that other text reports. besides: these"""
    return [(f"reason: {one.code}", one.text) for one in reasons if one.text not in besides]


def _frames_text(estimate: Estimate) -> str:
    found = estimate.settings
    rho, worth = found["frames_correlation"], float(str(found["frames_worth"]))
    if found["frames_fitted"] == 1 or not isinstance(rho, list):
        return "1"
    shared = f"errors shared: {float(rho[0]):.0%}, at most {float(rho[1]):.0%}"
    return f"{found['frames_fitted']}, worth {worth:.2g} of the best one ({shared})"


def format_length(estimate: Estimate, value: object) -> str:
    """A length in pixels where it was measured in them, and in millimetres where the scale is known."""
    if not isinstance(value, float):
        return "not known"
    parts = [f"{value:.3g} px"] if estimate.unit == "px" else []
    if estimate.metres_per_unit is not None:
        parts.append(f"{1e3 * value * estimate.metres_per_unit:.3g} mm")
    return ", ".join(parts)
