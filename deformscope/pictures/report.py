"""Results as texts, tables and pictures: for a terminal, a notebook, a recording; and as one HTML file, which needs no
other."""

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import printable
from deformscope.pictures.palette import Rgb

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; color: #1c2430;
  background: #fff; margin: 0 auto; max-width: 66rem; padding: 1.5rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; margin: 0 0 .75rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; padding-bottom: .25rem; border-bottom: 1px solid #d9dee6; }
p { margin: .5rem 0; max-width: 48rem; }
.verdict { border-left: .4rem solid; padding: .5rem .9rem; margin: .8rem 0; background: #f5f7fa; }
.verdict strong { display: block; font-size: 1.2rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: .4rem 0; }
caption, figcaption { color: #4a5566; font-size: .92rem; text-align: left; padding: .2rem 0; }
th, td { text-align: left; padding: .3rem .9rem .3rem 0; border-bottom: 1px solid #e5e9ef; vertical-align: top;
  font-variant-numeric: tabular-nums; }
th { font-weight: 600; }
figure { margin: 1rem 0; }
img { max-width: min(100%, 46rem); height: auto; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(22rem, 1fr)); gap: 0 1.2rem; }
pre { background: #f5f7fa; padding: .7rem .9rem; overflow-x: auto; font-size: .9rem; }
@media print { body { max-width: none; } h2 { break-after: avoid; } figure, table { break-inside: avoid; } }
""".strip()


@dataclass(frozen=True, slots=True)
class ReportVerdict:
    """The result, in plain words, before everything else. color: `#rrggbb`."""

    headline: str
    words: tuple[str, ...]
    color: str = "#4a5566"


@dataclass(frozen=True, slots=True)
class Link:
    """A cell that leads to a file or a page. to: address as in a URL, relative to the page; png: picture above the
    text"""

    text: str
    to: str
    png: bytes = b""

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True, slots=True)
class Table:
    """names: names of the columns, empty = a table of names and values; rows: their cells, shown as `str` shows
    them."""

    rows: Sequence[Sequence[object]]
    names: Sequence[str] = ()
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture with its description, which is also the text for screen readers."""

    png: bytes
    caption: str


@dataclass(frozen=True, slots=True)
class Code:
    """Lines of code."""

    text: str


Part = str | ReportVerdict | Table | Figure | Code | tuple[Figure, ...]
"""A part of a section; figures in a tuple are placed next to each other if there is room."""


@dataclass(frozen=True, slots=True)
class Section:
    """parts: parts in order; a str is a paragraph; title: its title, empty = none"""

    title: str
    parts: Sequence[Part]


def escape(text: str, quote: bool = True) -> str:
    """Printable text, escaped for HTML."""
    return html.escape(printable(text), quote)


def html_report(title: str, sections: Sequence[Section]) -> str:
    """A whole HTML page. All text is escaped; pictures are inside the page, and it needs no script."""
    body = "\n".join(_section(one) for one in sections)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{escape(title)}</title>\n'
        f"<style>\n{STYLE}\n</style>\n</head>\n<body>\n<h1>{escape(title)}</h1>\n{body}\n</body>\n</html>\n"
    )


def html_parts(parts: Sequence[Part]) -> str:
    """HTML of the parts of a page, without the page."""
    return "\n".join(_part(one) for one in parts)


def _section(section: Section) -> str:
    heading = f"<h2>{escape(section.title)}</h2>\n" if section.title else ""
    return f"<section>\n{heading}{html_parts(section.parts)}\n</section>"


def _part(part: Part) -> str:
    match part:
        case str():
            return f"<p>{escape(part)}</p>"
        case ReportVerdict():
            words = "".join(f"<p>{escape(one)}</p>" for one in part.words)
            color = escape(part.color, quote=True)
            return (
                f'<div class="verdict" style="border-color: {color}">'
                f'<strong style="color: {color}">{escape(part.headline)}</strong>{words}</div>'
            )
        case Table():
            caption = f"<caption>{escape(part.caption)}</caption>" if part.caption else ""
            head = ""
            if part.names:
                head = (
                    "<thead><tr>"
                    + "".join(f'<th scope="col">{escape(name)}</th>' for name in part.names)
                    + "</tr></thead>"
                )
            rows = []
            for row in part.rows:
                cells = [_link(cell) if isinstance(cell, Link) else escape(str(cell)) for cell in row]
                first = f"<td>{cells[0]}</td>" if part.names else f'<th scope="row">{cells[0]}</th>'
                rows.append(f"<tr>{first}" + "".join(f"<td>{cell}</td>" for cell in cells[1:]) + "</tr>")
            return f'<div class="scroll"><table>{caption}{head}<tbody>' + "\n".join(rows) + "</tbody></table></div>"
        case Figure():
            return _figure(part)
        case Code():
            return f"<pre><code>{escape(part.text)}</code></pre>"
        case tuple():
            return '<div class="pair">\n' + "\n".join(_figure(one) for one in part) + "\n</div>"


def _link(link: Link) -> str:
    shown = f"{_image(link.png, link.text)}<br>" if link.png else ""
    return f'<a href="{escape(link.to)}">{shown}{escape(link.text)}</a>'


def _image(png: bytes, caption: str) -> str:
    data = base64.b64encode(png).decode("ascii")
    return f'<img src="data:image/png;base64,{data}" alt="{escape(caption)}">'


def _figure(figure: Figure) -> str:
    image = _image(figure.png, figure.caption)
    return f"<figure>{image}<figcaption>{escape(figure.caption)}</figcaption></figure>"


@dataclass(frozen=True, slots=True)
class ColoredBody:
    """Points (K, d) [m], d = 2 or 3, coloured by a value (K,) each, which the caption names with its unit."""

    caption: str
    points: FloatArray
    value: FloatArray


@dataclass(frozen=True, slots=True)
class ComparedSurfaces:
    """The same points (K, 3) [m] of a surface from several sources: of each its name, positions and colour."""

    caption: str
    parts: tuple[tuple[str, FloatArray, Rgb], ...]

    @property
    def points(self) -> FloatArray:
        """(n, 3) all of them [m]."""
        return np.concatenate([points for _, points, _ in self.parts])


@dataclass(frozen=True, slots=True)
class Findings:
    """Tables, pictures and bodies, each with its caption, the most important ones first."""

    tables: tuple[Table, ...]
    figures: tuple[Figure, ...] = ()
    bodies: tuple[ColoredBody | ComparedSurfaces, ...] = ()

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
    cells = (" | ".join(str(cell).replace("|", "\\|") for cell in row) for row in lines)
    return "\n".join([f"### {table.caption}", "", *(f"| {row} |" for row in cells)])
