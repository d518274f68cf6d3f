"""Measurements of a squeeze, as text and numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import rerun as rr

from deformscope.log.result_batch import ResultBatch
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.trial import SqueezeFeatures

MEASURED = "display/squeeze/measured"


def log_not_measured(now: ResultBatch) -> None:
    text = "*Numbers follow once the fingers are at rest.*"
    now.show(MEASURED, rr.TextDocument(text, media_type="text/markdown"))


def log_measured(now: ResultBatch, results: Sequence[object]) -> None:
    """Events and features as a table; they come together."""
    rows: list[tuple[str, str]] = []
    for one in results:
        if isinstance(one, SqueezeEvents):
            first_ms, steady_ms = (
                0.5e-6 * (high - low) for low, high in (one.first_interval_ns, one.steady_interval_ns)
            )
            rows.append(("first contact", f"within \u00b1{first_ms:.0f} ms"))
            took_s = (one.steady_ns - one.first_ns) / 1e9
            rows.append(("steady state", f"{took_s:.2f} s later, \u00b1{steady_ms:.0f} ms"))
        if isinstance(one, SqueezeFeatures):
            rows += _physical(one.by_name)
            change = f"none: {one.reason or 'no camera'}"
            if one.vision is not None:
                change = f"{100 * (1.0 - one.missing):.0f} % of {100 * one.patch_width_m:.1f} cm"
            rows.append(("depth change", change))
    if rows:
        table = "\n".join(["| measured | |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in rows)])
        now.show(MEASURED, rr.TextDocument(table, media_type="text/markdown"))


def _physical(of: dict[str, float]) -> list[tuple[str, str]]:
    """Rows of name and value with unit, of the physical features that a person can picture."""
    named = (
        ("force of a finger", "force_n", 1.0, "N"),
        ("contact area", "contact_area_m2", 1e4, "cm\u00b2"),
        ("highest pressure", "peak_pa", 1e-3, "kPa"),
        ("indentation", "indentation_m", 1e3, "mm"),
        ("stiffness of a wall", "stiffness_n_per_m", 1.0, "N/m"),
        ("force lost in the hold", "relaxation", 100.0, "%"),
    )
    return [
        (words, f"{factor * of[name]:.3g} {unit}" if math.isfinite(of[name]) else "not measured")
        for words, name, factor, unit in named
    ]
