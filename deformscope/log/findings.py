"""Results of a study or a command, as views: its pictures and bodies, and its tables as text."""

import json
import math
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deformscope.frames import Stream
from deformscope.log.blueprint import blueprint, deep_view
from deformscope.log.canvas import Canvas, deep_bar, log_color_bar, log_deep_legend, log_place, sides_of
from deformscope.log.layout import PictureLayout
from deformscope.log.rig.blueprint import blueprint_of
from deformscope.pictures.close_up import RELIEF
from deformscope.pictures.palette import Rgb, colors, round_down, round_up
from deformscope.pictures.report import ColoredBody, ComparedSurfaces, Figure, Findings, table_markdown
from deformscope.plain import plain
from deformscope.rows import to_columns
from deformscope.stages.see.triangulation import spacing_of, triangulate


@dataclass(frozen=True, slots=True)
class RigFindings:
    """Results of devices that are recorded in the same file. streams: streams of the devices, whose views are below"""

    found: Findings
    streams: tuple[Stream, ...]


BODY = "on_body/points"
"""Entity of a result on its body."""
UNKNOWN: Rgb = (150, 155, 165)
STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)
"""Possible ends of the colour scale."""
ACROSS = 3
"""Most pictures next to each other."""
SHORT = 8
"""Most rows of tables that are shown below pictures, not next to them."""


def log_findings(rec: rr.RecordingStream, found: Findings, below: rrb.Blueprint | None = None) -> None:
    """Log pictures, bodies, the tables as Markdown for people and as JSON for programs, and their views. below:
    existing views"""
    for number, figure in enumerate(found.figures):
        _log_picture(rec, figure, f"found/picture/{number}")
    for number, body in enumerate(found.bodies):
        _log_body(rec, body, f"found/body/{number}", f"found/body/{number}/legend", _around(body))
    _log_tables(rec, found, "found/tables")
    rec.send_blueprint(findings_blueprint(found, below))


def log_evidence(rec: rr.RecordingStream, found: Findings, canvas: Canvas) -> None:
    """Log findings next to particles: the first picture and the tables replace those of an estimate."""
    whole = bool(canvas.image)  # what is found of a sequence belongs to all of it
    _log_tables(rec, found, "calibration/summary", whole=whole)
    if not found.figures:
        return
    _log_picture(rec, found.figures[0], "calibration/chart", whole=whole)
    layout: PictureLayout = "images" if whole else "pair" if canvas.flat else "pair-3d"
    caption = ""
    for body in found.bodies[:1]:
        caption = body.caption
        log_place(rec, canvas, BODY)
        _log_body(rec, body, BODY, "on_body/legend", canvas)
    rec.send_blueprint(blueprint(layout, canvas, chart=found.figures[0].caption, body=caption))


def log_numbers(rec: rr.RecordingStream, estimate: object, canvas: Canvas) -> None:
    """Every field of a material's result, for `replay` to compare."""
    kind = type(estimate).__name__
    values = {name: column.values for name, column in to_columns([estimate]).items()}  # typed where they are empty
    numbers = rr.DynamicArchetype(kind, components=values)
    rec.log("calibration/estimate", numbers, static=bool(canvas.image))


def _log_picture(rec: rr.RecordingStream, figure: Figure, path: str, *, whole: bool = False) -> None:
    image = rr.EncodedImage(contents=figure.png, media_type="image/png")
    rec.log(path, image, rr.AnyValues(caption=figure.caption), static=whole)


def _log_tables(rec: rr.RecordingStream, found: Findings, path: str, *, whole: bool = False) -> None:
    text = "\n\n".join(table_markdown(one) for one in found.tables)
    rec.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=whole)
    rec.log(path, rr.AnyValues(json=json.dumps(plain(found.tables))), static=whole)


def _log_body(
    rec: rr.RecordingStream, body: ColoredBody | ComparedSurfaces, path: str, legend: str, canvas: Canvas
) -> None:
    """Points in their colours, grey without a value, and the legend that the canvas has room for."""
    if isinstance(body, ComparedSurfaces):
        _log_surfaces(rec, body, path, legend, canvas)
        return
    known, largest = np.isfinite(body.value), float(np.nanmax(body.value, initial=0.0)) or 1.0
    end = round_up(largest, STEPS) if canvas.spacing else largest
    tints, radius = np.where(known[:, None], colors(body.value / end), UNKNOWN), 0.3 * spacing_of(body.points)
    values = rr.AnyValues(value=body.value)
    if canvas.flat:
        rec.log(path, rr.Points2D(body.points, radii=radius, colors=tints, draw_order=40.0), values)
        log_color_bar(rec, legend, canvas, end, "")
        return
    flat = body.points.shape[1] == 2
    points = np.column_stack([body.points, np.zeros(len(body.points))]) if flat else body.points
    rec.log(path, rr.Points3D(points, radii=radius, colors=tints), values)
    log_deep_legend(rec, legend, canvas, deep_bar(lambda share: f"{end * share:.2g}"))


def _log_surfaces(rec: rr.RecordingStream, body: ComparedSurfaces, path: str, legend: str, canvas: Canvas) -> None:
    """Points and nets between them in metres, drawn with magnified heights."""
    spacing = spacing_of(body.parts[0][1])
    for number, (name, points, tint) in enumerate(body.parts):
        log_place(rec, canvas, f"{path}/{name}")
        rec.log(f"{path}/{name}", rr.Points3D(points, radii=(0.08 - 0.01 * number) * spacing, colors=tint))
        net = points[sides_of(triangulate(points[:, :2]))]
        rec.log(f"{path}/{name}/net", rr.LineStrips3D(net, radii=0.02 * spacing, colors=tint))
    log_deep_legend(rec, legend, canvas, [(0.5 * at, name, tint) for at, (name, _, tint) in enumerate(body.parts)])
    if canvas.heights:
        log_deep_legend(rec, f"{legend}/heights", canvas, [(0.5, canvas.heights.strip(", "), UNKNOWN)], row=1)


def _around(body: ColoredBody | ComparedSurfaces) -> Canvas:
    low, high = body.points.min(axis=0), body.points.max(axis=0)
    if isinstance(body, ComparedSurfaces):
        *sides, deep = high - low
        scale = np.array([1.0, 1.0, max(round_down(RELIEF * max(sides) / deep), 1.0) if deep > 0.0 else 1.0])
        middle, half = 0.5 * (low + high), 0.5 * (high - low) * scale
        low, high, origin, times = (tuple(one.tolist()) for one in (-half, half, middle, scale))
        return Canvas(low, high, origin=origin, scale=times)
    ground = (0.0,) * (3 - len(low))
    return Canvas(low=(*map(float, low), *ground), high=(*map(float, high), *ground))


def findings_blueprint(found: Findings, below: rrb.Blueprint | None = None) -> rrb.Blueprint:
    """Bodies and pictures with the tables."""
    bodies = [
        deep_view(body.caption, [f"+ /found/body/{number}/**"], _around(body))
        for number, body in enumerate(found.bodies)
    ]
    pictures = [
        rrb.Spatial2DView(origin=f"/found/picture/{number}", name=figure.caption, background=[255, 255, 255])
        for number, figure in enumerate(found.figures)
    ]
    views = [*([rrb.Horizontal(*bodies)] if len(bodies) > 1 else bodies), *pictures]
    root: rrb.Container | rrb.View = rrb.TextDocumentView(origin="/found/tables", name="Numbers")
    if views:
        short = sum(len(one.rows) for one in found.tables) <= SHORT
        across = min(ACROSS, math.ceil(math.sqrt(len(views)))) if short or len(views) >= ACROSS else 1
        grid = rrb.Grid(*views, grid_columns=across)
        root = (
            rrb.Vertical(grid, root, row_shares=[2, 1]) if short else rrb.Horizontal(grid, root, column_shares=[3, 2])
        )
    if below is not None:
        root = rrb.Vertical(root, below.root_container)
    return blueprint_of(root, "frame" if below is None else "session", play=None)
