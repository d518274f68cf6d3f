"""The view of a rig: pictures above, plots and the devices' health below, only for existing devices."""

from collections.abc import Sequence
from typing import Any, Literal

import rerun.blueprint as rrb

from deformscope.frames import Stream
from deformscope.log.rig.arm import shape_of
from deformscope.log.rig.columns import root
from deformscope.log.rig.numbers import plotted
from deformscope.log.rig.tactile import Hand
from deformscope.pictures.palette import BACKGROUND

WINDOW_S = 10.0
"""How far back the plots show."""
FLOOR = [88, 94, 104]
LEGEND = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)
PICTURES_A_ROW, PLOTS_A_ROW, FEW = 4, 3, 2
ON_A_PAGE, ROWS_ON_A_PAGE = (2, 3), 3
"""Views in a row between the panels of a page: 2, or 3 where 2 would take more than 3 rows. A plot less than 220 pixels
high may have no label at its axis but 0: the viewer labels powers of ten alone, 20 pixels apart or more."""


def rig_blueprint(streams: Sequence[Stream], *, health: bool = True) -> rrb.Blueprint:
    """The views of these devices; those of doubles are marked SIMULATED. health: False if a page shows it outside the
    viewer"""
    return blueprint_of(rig_views(streams, with_health=health))


def rig_views(streams: Sequence[Stream], *, with_health: bool = True) -> rrb.Container:
    """Pictures, plots and health of these devices."""
    pictures = [view for stream in streams for view in _pictures(stream)]
    plots = [plot_view(path, named(stream, title)) for stream in streams for path, title in plotted(stream)]
    health = [_health(streams)] if streams and with_health else []
    if 1 <= len(pictures) <= FEW and len(plots) <= FEW:
        numbers = rrb.Vertical(*plots, *health, row_shares=[1.0] * len(plots) + [1.4] * len(health))
        return rrb.Horizontal(*pictures, numbers, column_shares=[1.0] * len(pictures) + [1.1])
    if not with_health and (pictures or plots):
        views = [*pictures, *plots]
        return rrb.Vertical(_rows(views, ON_A_PAGE[len(views) > ON_A_PAGE[0] * ROWS_ON_A_PAGE]))
    # pictures in rows above, plots and health side by side below them; without pictures health is below the plots
    health_share = min(max(3.0, 0.73 * len(streams)), 6.0)  # room for a row and a lane each
    plots_share = max(3.0 * _row_count(plots, PLOTS_A_ROW), health_share)
    laid = [_rows(plots, PLOTS_A_ROW)] if plots else []
    if not pictures:
        return rrb.Vertical(*laid, *health, row_shares=[plots_share] * len(laid) + [health_share] * len(health))
    above, beneath = _rows(pictures, PICTURES_A_ROW), [*laid, *health]
    shares = [min(len(plots), PLOTS_A_ROW) + 1.0, 2.5] if laid else [1.0]
    below = rrb.Horizontal(*beneath, column_shares=shares[: len(beneath)])
    return rrb.Vertical(above, below, row_shares=[4.0 * _row_count(pictures, PICTURES_A_ROW), plots_share])


def blueprint_of(
    views: rrb.Container | rrb.View,
    timeline: str = "session",
    *,
    play: Literal["following", "paused"] | None = "following",
    fps: float | None = None,
) -> rrb.Blueprint:
    """Views over a timeline, without rerun's panels. fps: frames a second at which it plays"""
    time = rrb.TimePanel(timeline=timeline, state="collapsed", play_state=play, fps=fps)
    return rrb.Blueprint(views, rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden"), time)


def _row_count(views: Sequence[rrb.View], most: int) -> int:
    return -(-len(views) // most)


def _rows(views: Sequence[rrb.View], most: int) -> rrb.Container | rrb.View:
    """Side by side; in more than one row where there are too many for one, and then evenly."""
    wide = -(-len(views) // _row_count(views, most))
    lines = [views[first : first + wide] for first in range(0, len(views), wide)]
    laid = [rrb.Horizontal(*line) if len(line) > 1 else line[0] for line in lines]
    return rrb.Vertical(*laid) if len(laid) > 1 else laid[0]


def _pictures(stream: Stream) -> list[rrb.View]:
    if stream.kind == "arm" and stream.urdf is not None:
        return [_arm_view(stream)]
    if stream.kind == "tactile":
        return [tactile_view(stream)]
    if stream.kind == "color":
        return [rrb.Spatial2DView(origin=root("color", stream.device), name=named(stream, "color"))]
    if stream.kind == "depth":
        return [depth_view(stream)]
    return []


def named(stream: Stream, what: str) -> str:
    return f"{stream.device}: {what}{' (SIMULATED)' if stream.simulated else ''}"


def plot_view(origin: str, name: str, *, below: bool = False, window_s: float = WINDOW_S, **more: Any) -> rrb.View:
    """below: show also entities below it; window_s: how far back it shows; more: more of the view"""
    now = rrb.TimeRangeBoundary.cursor_relative()
    window = rrb.TimeRangeBoundary.cursor_relative(seconds=-window_s)
    return rrb.TimeSeriesView(
        contents=[f"+ /{origin}{'/**' if below else ''}"],
        origin=origin,
        name=name,
        time_ranges=[rrb.VisibleTimeRange("session", start=window, end=now)],
        axis_x=rrb.archetypes.TimeAxis(view_range=rrb.TimeRange(start=window, end=now)),
        **({"plot_legend": LEGEND} | more),
    )


def depth_view(stream: Stream) -> rrb.View:
    contents = [f"+ /{root('depth', stream.device)}", f"+ /{root('display/depth', stream.device)}"]
    return rrb.Spatial2DView(contents=contents, name=named(stream, "depth [m]"))


def tactile_view(stream: Stream) -> rrb.View:
    bounds = None
    if stream.pads:
        x_mm, y_mm = Hand.of(stream.pads).bounds_mm
        bounds = rrb.VisualBounds2D(x_range=list(x_mm), y_range=list(y_mm))
    return rrb.Spatial2DView(
        origin=root("display/tactile", stream.device),
        name=named(stream, "pressure [kPa]"),
        visual_bounds=bounds,
        background=list(BACKGROUND),
    )


def _arm_view(stream: Stream) -> rrb.View:
    """Seen from the front and above, near enough that the stretched arm just fits."""
    assert stream.urdf is not None
    shape = shape_of(stream.urdf, stream.device)
    reach = shape.reach_m
    eye = [0.9 * reach, -0.85 * reach, 0.75 * reach]
    arm, target = root("display/arm", stream.device), [0.0, 0.0, 0.36 * reach]
    return space_view(named(stream, "pose"), (), eye, target, frame=shape.base, floor=FLOOR, origin=arm)


def space_view(
    name: str,
    contents: Sequence[str],
    position: Sequence[float],
    look_target: Sequence[float],
    *,
    frame: str | None = None,
    floor: Sequence[int] | None = None,
    **more: Any,
) -> rrb.View:
    """A view in space, z upwards. contents: shown entities, empty = those below `origin`; position, look_target: (3,)
    place of the eye, and the place that it looks at; frame: the frame that it shows; floor: RGB of lines on the ground,
    each 0.1, None = no lines; more: more of the view"""
    grid = rrb.LineGrid3D(visible=False)
    if floor is not None:
        grid = rrb.LineGrid3D(visible=True, spacing=0.1, color=list(floor))
    return rrb.Spatial3DView(
        name=name,
        spatial_information=None if frame is None else rrb.SpatialInformation(target_frame=frame),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=position, look_target=look_target, eye_up=[0.0, 0.0, 1.0]
        ),
        line_grid=grid,
        **({"background": list(BACKGROUND)} | ({"contents": list(contents)} if contents else {}) | more),
    )


def _health(streams: Sequence[Stream]) -> rrb.Container:
    table = rrb.TextDocumentView(contents=["+ /health"], origin="health", name="Devices")
    devices = sorted({stream.device for stream in streams})
    lanes = rrb.StateTimelineView(
        contents=[f"+ /{root('health', device)}" for device in devices], origin="health", name="State over time"
    )
    return rrb.Vertical(table, lanes, row_shares=[len(devices) + 3.8, 1.75 * len(devices) + 2.5])
