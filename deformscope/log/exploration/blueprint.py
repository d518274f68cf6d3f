"""The view of an exploration in one window: the robot at the left, its estimates at the right."""

from collections.abc import Sequence
from typing import Literal

import rerun.blueprint as rrb

from deformscope.frames import Stream
from deformscope.log.exploration import display
from deformscope.log.exploration.perception import ERROR, PIXELS
from deformscope.log.exploration.perception import MAPS as FIELD_MAPS
from deformscope.log.exploration.scene import DENT, SCENE, SURFACE_FRAME
from deformscope.log.rig.blueprint import FLOOR, LEGEND, blueprint_of, depth_view, named, space_view
from deformscope.log.rig.columns import root
from deformscope.log.rig.numbers import plotted
from deformscope.pictures.exploration import FIELDS
from deformscope.pictures.palette import BACKGROUND
from deformscope.rows import ENTITIES
from deformscope.stages.map.exploration import PhaseStart

PAPER = [255, 255, 255]
COMPARED_REGIONS = "display/beside/regions"
COMPARED_TOUCHES: dict[Literal["stiffness", "beta"], str] = {
    "stiffness": "display/beside/stiffness",
    "beta": "display/beside/beta",
}
"""Results of other settings with the recorded ones (`deformscope.log.exploration.compare`)."""
TITLES = {
    "stiffness": "Stiffness field",
    "stiffness_deviation": "Stiffness field: deviation",
    "beta": "Beta-field",
    "beta_deviation": "Beta-field: deviation",
    "regions": "Regions found",
    "truth": "Truth",
}


def exploration_blueprint(
    streams: Sequence[Stream],
    size_m: tuple[float, float] = (0.6, 0.4),
    *,
    truth: bool = True,
    inclusions: bool = False,
    tabs: bool = False,
    compared: str = "",
) -> rrb.Blueprint:
    """The views of an exploration with these devices.

    size_m: size of the surface along x and y; truth: whether the truth is known: otherwise the surface's height is
    shown instead; inclusions: whether inclusions are sought: they replace beta
    tabs: most views are tabs, for a page, which has panels at both sides and may have to draw without a GPU
    compared: other settings, whose results are shown with the recorded ones (`tabs` alone)"""
    maps = {name: _picture(path, title) for (name, title), path in zip(TITLES.items(), display.MAPS, strict=True)}
    if inclusions:
        maps |= {
            "beta": _picture(display.INCLUSIONS, "Inclusions"),
            "beta_deviation": _picture(display.MISSED, "What may be missed"),
        }
    gain, force = (
        _picture(display.GAIN, "Gain of each place for the next touch"),
        _picture(display.FORCE, "Force over depth"),
    )
    truly = maps["truth"] if truth else _picture(display.HEIGHT, "Surface")
    words = display.INCLUSIONS_SUMMARY if inclusions else display.SUMMARY
    summary = rrb.TextDocumentView(contents=[f"+ /{words}"], origin=words, name="What is known")
    if tabs:
        fields = rrb.Tabs(maps["stiffness"], maps["stiffness_deviation"], maps["beta"], maps["beta_deviation"])
        regions, touches = [maps["regions"], truly], [force]
        if compared:
            regions.insert(0, _picture(COMPARED_REGIONS, f"Regions: recorded, {compared}"))
            touches[:0] = [
                _picture(path, f"{name.capitalize()}: recorded, {compared}") for name, path in COMPARED_TOUCHES.items()
            ]
        known = rrb.Vertical(rrb.Tabs(*regions), fields, rrb.Tabs(gain, summary))
        at_touch = rrb.Tabs(*touches, *_sections(), *_looks(streams), _pixels(), *_over_time(streams))
        robot = rrb.Vertical(_scenes(streams, size_m), at_touch, row_shares=[4, 3])
        views = rrb.Horizontal(robot, known, column_shares=[5, 4])
        return blueprint_of(views, play="paused" if compared else "following")
    known = rrb.Vertical(
        rrb.Horizontal(maps["stiffness"], maps["stiffness_deviation"], gain),
        rrb.Horizontal(maps["beta"], maps["beta_deviation"], force),
        rrb.Horizontal(maps["regions"], truly, summary),
    )
    return blueprint_of(rrb.Horizontal(_robot(streams, size_m), known, column_shares=[4, 6]))


def _robot(streams: Sequence[Stream], size_m: tuple[float, float]) -> rrb.Container:
    dent, *depths = _looks(streams)
    *plots, lanes = _over_time(streams)
    close = rrb.Horizontal(dent, _tabbed([*depths, _pixels()]))
    over_time = rrb.Vertical(*plots, lanes, row_shares=[*[1.6] * len(plots), 1.0])
    below = rrb.Horizontal(_tabbed(_sections()), over_time, column_shares=[1.0, 1.05])
    return rrb.Vertical(_scenes(streams, size_m), close, below, row_shares=[3.6, 2.7, 2.9])


def _tabbed(views: Sequence[rrb.View]) -> rrb.Container | rrb.View:
    return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else views[0]


def _sections() -> list[rrb.View]:
    return [_picture(display.SECTION, "The dent in section"), _picture(ERROR, "Error over beta")]


def _pixels() -> rrb.View:
    """Which pixels were used."""
    names = "blue used, grey outside, yellow lone, red to pink robot"
    return rrb.Spatial2DView(contents=[f"+ /{PIXELS}"], name=f"Pixels: {names}", background=list(BACKGROUND))


def _scenes(streams: Sequence[Stream], size_m: tuple[float, float]) -> rrb.Container | rrb.View:
    """The scene, and each map on the surface."""
    names = {quantity: f"{quantity.replace('_', ': ').capitalize()} on the surface" for quantity in FIELDS}
    maps = [_scene((), size_m, f"{FIELD_MAPS}/{one}", name) for one, name in names.items()]
    return _tabbed([_scene(streams, size_m), *maps])


def _looks(streams: Sequence[Stream]) -> list[rrb.View]:
    name = "The dent: observed blue, simulated red"
    dent = space_view(name, [f"+ /{DENT}/**"], [0.5, -1.95, 0.95], [0.0, -0.2, -0.15])
    return [dent, *(depth_view(stream) for stream in streams if stream.kind == "depth")]


def _over_time(streams: Sequence[Stream]) -> list[rrb.View]:
    """Forces, and last the phases."""
    plots = [
        rrb.TimeSeriesView(contents=[f"+ /{path}"], origin=path, name=named(stream, title), plot_legend=LEGEND)
        for stream in streams
        if stream.kind == "wrench"
        for path, title in plotted(stream)
        if "force" in title
    ]
    return [*plots, rrb.StateTimelineView(contents=[f"+ /{ENTITIES[PhaseStart]}"], origin="exploration", name="Phases")]


def _scene(
    streams: Sequence[Stream], size_m: tuple[float, float], what: str = f"{SCENE}/**", name: str = ""
) -> rrb.View:
    """Seen from the front, above and to the side, near enough that surface and arm fit."""
    simulated = " (SIMULATED)"
    arms = [stream for stream in streams if stream.kind == "arm" and stream.urdf is not None]
    x, y = size_m
    wide = max(x, y)
    return space_view(
        name or f"Surface{''.join(f' and {arm.device}{simulated * arm.simulated}' for arm in arms)}",
        [f"+ /{what}", *(f"+ /{root('display/arm', arm.device)}/**" for arm in arms)],
        [x / 2 + 0.25 * wide, y / 2 - 1.05 * wide, (0.85 if arms else 0.75) * wide],
        [x / 2, y / 2 + 0.05 * wide, (0.17 if arms else 0.0) * wide],
        frame=SURFACE_FRAME,
        floor=FLOOR,
    )


def _picture(path: str, name: str) -> rrb.View:
    return rrb.Spatial2DView(contents=[f"+ /{path}"], name=name, background=PAPER)
