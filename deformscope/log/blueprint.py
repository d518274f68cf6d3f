"""The first view of an opened recording: one glance, no tabs, no empty views."""

import rerun.blueprint as rrb

from deformscope.log.canvas import COLUMN_SHARE, ROW_SHARE, Canvas
from deformscope.log.layout import PictureLayout
from deformscope.log.rig.blueprint import LEGEND, blueprint_of, space_view

NAMES = {
    "particles": "Particles",
    "flow": "Optical flow since the frame before",
    "residual": "Residuals: from simulated to observed",
    "heat": "Where the model is wrong: error over the body",
}
"""Names of the views, by the entity that they show."""
CHART = "Error and posterior over the parameter"

PAPER = [232, 235, 240]
"""Background of particles without an image: all their colours are visible on it."""
FLAT_CLOSER = 0.82
"""Factor on the distance of the eye for a flat body, which fills a view from nearer."""
WIDE_FROM = 3.0
"""Width over height from which pictures are placed below each other, not next to each other."""


def blueprint(layout: PictureLayout, canvas: Canvas, chart: str = CHART, body: str = "") -> rrb.Blueprint:
    """The views for a layout over this picture. chart: content of the chart next to the particles; body: view of the
    body, before the view of the model's error; empty = none"""
    if layout == "flow":
        root: rrb.Container | rrb.View = rrb.Horizontal(
            _flat_view("flow", canvas), _summary_view(), column_shares=[3, 1]
        )
    elif layout == "images":
        root = _images(canvas, chart, body)
    else:
        root = _pair(canvas, chart, body)
    return blueprint_of(root, "frame", fps=8.0)


def _images(canvas: Canvas, chart: str, body: str) -> rrb.Container:
    pictures: list[rrb.View | rrb.Container] = [_flat_view(name, canvas) for name in ("particles", "flow", "residual")]
    pictures.append(_last_view(canvas, body))
    errors = rrb.TimeSeriesView(origin="/error", name="Average error in each frame", plot_legend=LEGEND)
    numbers = [_chart_view(chart), errors, _summary_view()]
    if canvas.height > canvas.width:
        return rrb.Horizontal(*pictures, rrb.Vertical(*numbers, row_shares=[5, 3, 5]), column_shares=[3, 3, 3, 3, 5])
    if canvas.width > WIDE_FROM * canvas.height:
        return rrb.Horizontal(
            rrb.Vertical(*pictures), rrb.Vertical(*numbers, row_shares=[5, 3, 5]), column_shares=[3, 2]
        )
    return rrb.Vertical(rrb.Horizontal(*pictures), rrb.Horizontal(*numbers, column_shares=[4, 4, 3]))


def _pair(canvas: Canvas, chart: str, body: str) -> rrb.Container:
    pictures: list[rrb.View | rrb.Container]
    if canvas.flat:
        pictures = [_flat_view(name, canvas) for name in ("particles", "residual")]
    else:
        pictures = [
            deep_view("Particles: rest, observed, simulated", ["+ /particles/**", "+ /residual/lines"], canvas),
            deep_view(NAMES["residual"], ["+ /residual/**"], canvas),
        ]
    pictures.append(_last_view(canvas, body))
    numbers = rrb.Horizontal(_chart_view(chart), _summary_view(), column_shares=[4, 3])
    if canvas.flat and canvas.width > WIDE_FROM * canvas.height:
        return rrb.Horizontal(
            rrb.Vertical(*pictures), rrb.Vertical(_chart_view(chart), _summary_view()), column_shares=[3, 2]
        )
    return rrb.Vertical(rrb.Horizontal(*pictures), numbers)


def _last_view(canvas: Canvas, body: str) -> rrb.View | rrb.Container:
    """Where the model is wrong; before it what lies on the body."""
    views: list[rrb.View] = []
    for what, name in ([("on_body", body)] if body else []) + [("heat", NAMES["heat"])]:
        some = f"+ /{what}/**"
        views.append(_flat_view(what, canvas, name) if canvas.flat else deep_view(name, [some], canvas))
    return rrb.Tabs(*views, active_tab=0) if body else views[0]


def _flat_view(what: str, canvas: Canvas, name: str = "") -> rrb.View:
    contents = [*([f"+ /{canvas.image}"] if canvas.image else []), f"+ /{what}/**"]
    (x0, y0), (x1, y1) = canvas.low[:2], canvas.high[:2]
    margin = 0.02 * max(x1 - x0, y1 - y0) + canvas.rim
    if canvas.has_side_legend:
        x1 += COLUMN_SHARE * (x1 - x0)
    else:
        y1 += ROW_SHARE * max(x1 - x0, y1 - y0)
    return rrb.Spatial2DView(
        name=name or NAMES[what],
        contents=contents,
        visual_bounds=rrb.VisualBounds2D(x_range=[x0 - margin, x1 + margin], y_range=[y0 - margin, y1 + margin]),
        background=PAPER,
    )


def _chart_view(name: str = CHART) -> rrb.View:
    return rrb.Spatial2DView(origin="/calibration/chart", name=name, background=[255, 255, 255])


def _summary_view() -> rrb.View:
    return rrb.TextDocumentView(origin="/calibration/summary", name="Estimate")


def deep_view(name: str, contents: list[str], canvas: Canvas) -> rrb.View:
    """A view from above and the side, far enough away to show everything."""
    low, high = list(canvas.low), list(canvas.high)
    low[1] -= 0.32 * max(canvas.width, canvas.height)  # the legend
    middle = [(first + last) / 2 for first, last in zip(low, high, strict=True)]
    size = sum((last - first) ** 2 for first, last in zip(low, high, strict=True)) ** 0.5 or 1.0
    size *= FLAT_CLOSER if high[2] - low[2] < 0.5 * max(canvas.width, canvas.height) else 1.0
    away = [middle[0] + 0.5 * size, middle[1] - 0.85 * size, middle[2] + 0.55 * size]
    return space_view(name, contents, away, middle, background=PAPER)
