"""A table of estimated quantities: how far off they are, and how often their intervals hold the truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from deformscope.pictures.report import Table
from studies.coverage import rate_json
from studies.quantities import QuantityRow


def quantity_table(rows: Sequence[QuantityRow], tried: str, title: str) -> Table:
    """A line a quantity. tried: what was, in the plural"""
    lines = [
        (
            row.quantity,
            row.held.cases,
            f"{row.error:.1%}",
            f"{row.near.rate:.2f}",
            "{:.2f} ({:.2f} to {:.2f})".format(row.held.rate, *row.held.band),
            f"{row.width:.0%}",
        )
        for row in rows
    ]
    names = ("quantity", tried, "off (rms)", "within 10 %", "held (95 % band)", "width")
    return Table(lines, names, f"90 % intervals, {title}")


def row_json(row: QuantityRow) -> dict[str, object]:
    return dataclasses.asdict(row) | {"near": rate_json(row.near), "held": rate_json(row.held)}
