"""The newest results, as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deformscope.frames import StageResult
from deformscope.stages.fit.moment import FieldMoment, MomentFit, ParticleMoment
from deformscope.stages.map.exploration import StageFailure, SurfaceEstimate, TouchEstimate
from deformscope.stages.see.arrows import FlowArrows
from deformscope.stages.see.tactile import TactileContact


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
        case ParticleMoment():
            moved = np.hypot(*(result.position_px - result.rest_px)[result.seen].T)
            median = f"median motion {np.median(moved):.2g} px" if moved.size else "none followed"
            return f"{np.count_nonzero(result.seen)} of {len(result.seen)} particles seen, {median}"
        case FieldMoment():
            low, high = result.ratio_interval
            determined = f"{np.count_nonzero(result.determined)} of {len(result.determined)} places determined"
            ratio = f"stiffest over softest {result.ratio:.3g} ({low:.3g} to {high:.3g})"
            return f"**{result.verdict}**, {ratio}, {determined}"
        case TactileContact():
            touched = int(np.count_nonzero(result.area_m2))
            area_cm2 = result.area_m2.sum() * 1e4
            return f"**{result.force_n.sum():.3g} N** on {area_cm2:.3g} cm2, {touched} of {len(result.area_m2)} pads"
        case SurfaceEstimate():
            middle_mm, deviation_mm = np.median(result.height_m) * 1e3, np.median(result.deviation_m) * 1e3
            return f"median height {middle_mm:.4g} mm, deviation {deviation_mm:.2g} mm, {len(result.points_m)} points"
        case TouchEstimate():
            return result.stiffness_text
    raise TypeError(f"no text for a {type(result).__name__}")
