"""A command's results as views: the same tables and pictures for a terminal, a notebook, a recording and a page."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from deformscope.arrays import FloatArray
from deformscope.pictures.report import Figure, Table, html_parts


@dataclass(frozen=True, slots=True)
class ColoredBody:
    """Points (K, d) [m], d = 2 or 3, coloured by a value (K,) each, which the caption names with its unit."""

    caption: str
    points: FloatArray
    value: FloatArray


@dataclass(frozen=True, slots=True)
class Findings:
    """Tables, pictures and bodies, each with its caption, the most important ones first."""

    tables: tuple[Table, ...]
    figures: tuple[Figure, ...] = ()
    bodies: tuple[ColoredBody, ...] = ()

    def __str__(self) -> str:
        return "\n".join(table_text(one) for one in self.tables)

    def html(self) -> str:
        """A part of a page: tables, and pictures inside it."""
        return html_parts([*self.tables, *self.figures])


def cell_text(value: object) -> str:
    """A value as a cell of a table shows it."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    return ", ".join(map(cell_text, value)) if isinstance(value, list | tuple) else str(value)


def table_text(table: Table) -> str:
    """The table as plain lines, which are never wrapped: a divided path or number is useless in a pipe."""
    lines = [list(map(str, row)) for row in ((table.names, *table.rows) if table.names else table.rows)]
    widths = [max(map(len, column)) for column in zip(*(row[:-1] for row in lines), strict=True)] if lines else []
    shown = ("  ".join([*map(str.ljust, row, widths), row[-1]]).rstrip() for row in lines)
    return "\n".join([table.caption, *(f"  {line}" for line in shown)])


def table_markdown(table: Table) -> str:
    """The table for a text view; `|` within a cell is escaped."""
    width = max((len(row) for row in table.rows), default=len(table.names) or 1)
    names = table.names or [""] * width
    lines = [names, ["---"] * len(names), *table.rows]
    return "\n".join([f"### {table.caption}", "", *(f"| {_markdown_cells(row)} |" for row in lines)])


def _markdown_cells(row: Iterable[object]) -> str:
    return " | ".join(str(cell).replace("|", "\\|") for cell in row)
