"""The recording and views of stages that run with the devices, and their frames.

A result has the time, and the place on `frame`, of the newest frame from which it was computed.

    stage/NAME/DEVICE            one row a result: every field of it, the frames it used, how many were passed over
    display/stage/NAME/... views: marks over the image, pictures, the verdict as text
    display/stage/plot/...       numbers over time: lag [ms], beta, force [N], area [cm2], torque [N m]
    display/tactile/DEVICE/contact   the centres of pressure, on the picture of the hand
    display/stage/summary        a table: newest results, how many, how far behind"""

from collections.abc import Callable, Sequence

import numpy as np
import rerun as rr

from deformscope.frames import StageResult, Stream
from deformscope.log.rig.columns import Batch, log_series, moments, recorded, root, scalars
from deformscope.log.stages.over_image import (
    PLOTS,
    WORDS,
    StageGroup,
    log_flow_arrows,
    log_moments,
    log_pads,
    log_wrench,
)
from deformscope.log.views import SOMETIMES, ShownStage, Views, views_of
from deformscope.pictures.exploration import force_png, height_png
from deformscope.pictures.palette import AXES, JOINTS, tints_of
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.map.exploration import StageFailure, SurfaceEstimate, TouchEstimate
from deformscope.stages.poke.tip_wrench import TipWrench
from deformscope.stages.see.arrows import FlowArrows
from deformscope.stages.see.tactile import TactileContact


def log_stage_streams(rec: rr.RecordingStream, stages: Sequence[tuple[str, str]], streams: Sequence[Stream]) -> None:
    """Log constants: names, units and colours of the plots. stages: (name, device)"""
    for number, (name, device) in enumerate(stages):
        log_series(rec, f"{PLOTS}/lag/{name}", [f"{name} [ms]"], [JOINTS[number % len(JOINTS)]])
        if name == "beta":
            names = ["lower end", name, "upper end"]
            log_series(rec, f"{PLOTS}/beta", names, [(120, 120, 130), (235, 45, 45), (120, 120, 130)])
        if name == "wrench":
            log_series(rec, f"{PLOTS}/force/{device}", [f"F{axis} [N]" for axis in "xyz"], AXES)
            log_series(rec, f"{PLOTS}/torque/{device}", [f"M{axis} [N m]" for axis in "xyz"], AXES)
        if name == "tactile":
            pads = next(one.pads for one in streams if (one.kind, one.device) == ("tactile", device))
            for quantity, unit in (("force", "N"), ("area", "cm2")):
                names = [f"{pad.name} [{unit}]" for pad in pads]
                log_series(rec, f"{PLOTS}/{quantity}/{device}", names, tints_of(len(names)))


def prepare_stage_results(
    results: Sequence[StageResult],
    start_ns: int,
    streams: Sequence[Stream],
    latest: dict[str, StageResult] | None = None,
    *,
    newest_pictures: bool = False,
) -> Batch:
    """Prepare results for one stream or several. The cost is for each stage; a single result costs little, unless
    pictures are drawn.

    start_ns: host time at which `session` is 0 [ns]; latest: newest result of every stage, reused from call to call
    newest_pictures: draw and mark only the newest result of each stage"""
    batch = Batch()
    known = {(stream.kind, stream.device): stream for stream in streams}
    found: dict[tuple[str, str, type], list[StageResult]] = {}
    for one in results:
        found.setdefault((one.stage, one.used[-1].device, type(one.result)), []).append(one)
    for (stage, device, kind), group in found.items():
        times = moments([one.host_ns for one in group], start_ns)
        places = rr.TimeColumn("frame", sequence=np.array([one.used[-1].last for one in group], np.int64))
        columns = [*recorded(group, ("result",)), *recorded([one.result for one in group])]
        batch.send_columns(root(f"stage/{stage}", device), [*times, places], columns)
        late_ms = [np.array([one.late_s * 1e3]) for one in group]
        batch.send_columns(f"{PLOTS}/lag/{stage}", times, scalars(late_ms))
        drawn = group[-1:] if newest_pictures else group
        some = StageGroup(known.get(("tactile", device)), device, group, drawn, start_ns)
        for view in views_of(kind, STAGE_VIEWS):
            view(batch, some)
    _log_tables(batch, results, start_ns, {} if latest is None else latest, newest_alone=newest_pictures)
    return batch


def _log_tables(
    batch: Batch, results: Sequence[StageResult], start_ns: int, latest: dict[str, StageResult], *, newest_alone: bool
) -> None:
    """Log a table of all that was known with every result."""
    ordered = sorted(results, key=lambda one: one.host_ns)
    tables = []
    for one in ordered:
        latest[one.stage] = one
        tables.append(summary(list(latest.values())))
    shown = slice(-1, None) if newest_alone else slice(None)
    if tables:
        columns = rr.TextDocument.columns(text=tables[shown], media_type=["text/markdown"] * len(tables[shown]))
        batch.send_columns(WORDS, moments([one.host_ns for one in ordered[shown]], start_ns), columns)


def _log_pictures(batch: Batch, group: StageGroup, stage: str, draw: Callable[..., bytes], *more: object) -> None:
    """A picture of each result that is drawn."""
    pngs = [draw(one.result, *more) for one in group.drawn]
    columns = rr.EncodedImage.columns(blob=pngs, media_type=["image/png"] * len(pngs))
    times = moments([one.host_ns for one in group.drawn], group.start_ns)
    batch.send_columns(f"display/stage/{stage}", times, columns)


FLOW, BETA, TACTILE, SURFACE, CONTACT, WRENCH = (
    ShownStage(name, chapter, gives, entity=f"stage/{name}", field=field, when=f"stages.names={name}")
    for name, chapter, gives, field in (
        ("flow", 3, "optical flow between the images used", "flow_px"),
        ("beta", 3, "observed and simulated particles (eq. 3.13)", "rest_px"),
        ("tactile", 2, "force, area and centre of pressure of each pad", "force_n"),
        ("surface", 4, "its height and deviation (eq. 4.3, 4.4)", "height_m"),
        ("contact", 4, "force over depth of an approach", "approach_m"),
        ("wrench", 4, "force and torque at the tip", "force_n"),
    )
)
STAGE_VIEWS: Views[Batch] = {
    FlowArrows: (FLOW, log_flow_arrows),
    MomentFit: (BETA, log_moments),
    TactileContact: (TACTILE, log_pads),
    SurfaceEstimate: (SURFACE, lambda batch, group: _log_pictures(batch, group, "surface", height_png)),
    TouchEstimate: (CONTACT, lambda batch, group: _log_pictures(batch, group, "contact", force_png, "Approach")),
    TipWrench: (WRENCH, log_wrench),
    StageFailure: (ShownStage("failed", 0, "a stage that failed", entity="stage", field="reason", when=SOMETIMES),),
}
"""The view of the results of each type, those of one device together (`StageGroup`); a failure is in the table."""


def summary(latest: Sequence[StageResult]) -> str:
    """The newest result of every stage, as a table in Markdown."""
    lines = ["| stage | newest result | of frame | skipped before it | lag |", "| --- | --- | --- | --- | --- |"]
    for one in latest:
        used = one.used[-1]
        cells = (one.stage, format_result(one.result), f"{used.device} {used.last}", str(one.skipped))
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} | **{one.late_s * 1e3:.0f} ms** |")
    return "\n".join(lines)


def format_result(result: object) -> str:
    """One result in a line."""
    match result:
        case StageFailure():
            return f"**FAILED**: {result.reason}"
        case FlowArrows():
            length = np.hypot(*result.flow_px[np.isfinite(result.flow_px).all(axis=1)].T)
            return f"median motion {np.median(length):.2g} px, largest {length.max(initial=0.0):.2g} px"
        case MomentFit():
            seen = f"{np.count_nonzero(result.seen)} of {len(result.seen)} particles seen"
            value = "" if np.isnan(result.value) else f"**{result.parameter} = {result.value:.3g}**, "
            return f"{value}{result.verdict_text}; {seen}"
        case TactileContact():
            touched = int(np.count_nonzero(result.area_m2))
            area_cm2 = result.area_m2.sum() * 1e4
            return f"**{result.force_n.sum():.3g} N** on {area_cm2:.3g} cm2, {touched} of {len(result.area_m2)} pads"
        case SurfaceEstimate():
            middle_mm, deviation_mm = np.median(result.height_m) * 1e3, np.median(result.deviation_m) * 1e3
            return f"median height {middle_mm:.4g} mm, deviation {deviation_mm:.2g} mm, {len(result.points_m)} points"
        case TipWrench():
            torque = (
                "" if result.torque_nm is None else f", **{np.linalg.norm(result.torque_nm):.3g} N m** about the tip"
            )
            return f"**{np.linalg.norm(result.force_n):.3g} N**{torque or ', no torque: three axes'}"
        case TouchEstimate():
            return result.stiffness_text
    raise TypeError(f"no text for a {type(result).__name__}")
