"""What studies write: tables of rows, CSV, and figures as PNG."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from deformscope.pictures.figures import canvas
from deformscope.pictures.report import Figure, Table, cell_text


def dict_table(rows: Sequence[Mapping[str, object]], caption: str = "") -> Table:
    """A table of rows that have the same names."""
    return Table([[cell_text(value) for value in row.values()] for row in rows], list(rows[0]) if rows else (), caption)


def write_rows(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write a CSV table of rows with the same names; floats have six significant digits, None is an empty field."""
    if not rows:
        return
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, list(rows[0]))
        out.writeheader()
        for row in rows:
            out.writerow({name: f"{one:.6g}" if isinstance(one, float) else one for name, one in row.items()})


def pictures_of(drawn: Mapping[str, Path]) -> tuple[Figure, ...]:
    """PNG files that a study has drawn, by their titles."""
    return tuple(Figure(path.read_bytes(), caption) for caption, path in drawn.items())


@contextmanager
def figure(path: Path, columns: int, rows: int = 1, *, share_y: bool = False) -> Iterator[Any]:
    """Axes (rows, columns) to draw on; written to `path` as PNG at the end. Unused axes (without a title) are
    removed."""
    drawn = canvas(4.6 * columns, 3.9 * rows, layout="constrained")
    axes = drawn.subplots(rows, columns, squeeze=False, sharey=share_y)
    yield axes
    for one in axes.flat:
        one.set_visible(bool(one.get_title()))
        one.grid(alpha=0.25)
    drawn.savefig(path, dpi=140)
