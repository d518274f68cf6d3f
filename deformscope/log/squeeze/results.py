"""The recording and views of a squeeze: its devices as those of any rig, and every result without loss, with views for
people.

    squeeze/phase|stopped|events|features   one row a result, every field of it a component of the same name
    squeeze/fingertips|container|change|content    likewise, at the time of the frame that it is of
    squeeze/sighting|placement              the container as in the image, the grasp drawn, where an arm places
    display/place/scene|image|words         the same on the table, over the image, and in words
    display/tactile/DEVICE/contact          centre of pressure and principal axis, on the picture of the hand (fig. 2.4)
    display/squeeze/force|content           force of each fingertip [N], probability of each content, over time
    display/squeeze/container               the tracked model's edges over the depth image, before and after (fig. 2.8)
    display/squeeze/change                  the depth change around the fingertip, data minus model (fig. 2.6)
    display/squeeze/measured|named measurements, and the classification of the content, as text"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deformscope.arrays import FloatArray
from deformscope.frames import Stream
from deformscope.log.canvas import TEXT
from deformscope.log.exploration.scene import SURFACE_FRAME, log_base
from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.blueprint import blueprint_of, plot_view, rig_views, space_view, tactile_view
from deformscope.log.rig.columns import Batch, Sink, log_series, root, states
from deformscope.log.rig.numbers import plotted
from deformscope.log.rig.tactile import Hand
from deformscope.log.stages.over_image import CENTER, MARK_MM
from deformscope.log.views import SOMETIMES, ShownStage, Views, views_of
from deformscope.pictures.figures import depth_change_png
from deformscope.pictures.palette import BACKGROUND, BAD, HELD, IDLE, OBSERVED, REST, SIMULATED, WARN, Rgb, tints_of
from deformscope.rows import ENTITIES
from deformscope.stages.squeeze import trial
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.placement import ContainerFit, ContainerSighting, HandPlacement
from deformscope.stages.squeeze.trial import SqueezePhase
from deformscope_drivers.sdh.kinematics import AXIS_NAMES, FINGERS

MEASURED, CONTENT, NAMED, CHANGE, CONTAINER = (
    f"display/squeeze/{what}" for what in ("measured", "content", "named", "change", "container")
)
BEFORE_PX, AFTER_PX = 1.4, 0.5
"""Half the width of a container's line: where it did not move, both are seen."""
SQUEEZE_PHASES: dict[str, Rgb] = {
    "pre-shape": (110, 115, 125),
    "place": (150, 120, 220),
    "look": (0, 190, 200),
    "travel": (120, 100, 190),
    "approach": (204, 121, 167),
    "retreat": (150, 110, 150),
    "back off": (215, 140, 0),
    "air": (86, 180, 233),
    "close": (230, 159, 0),
    "squeeze": (213, 94, 0),
    "hold": (0, 158, 115),
    "open": (150, 155, 165),
    "stopped": BAD,
}


def log_measured(now: ResultBatch, results: Sequence[object]) -> None:
    """Log events and features as a table; they are known at the same time."""
    rows: list[tuple[str, str]] = []
    for one in results:
        if isinstance(one, SqueezeEvents):
            first_ms, steady_ms = (
                0.5e-6 * (high - low) for low, high in (one.first_interval_ns, one.steady_interval_ns)
            )
            rows.append(("first contact", f"within \u00b1{first_ms:.0f} ms"))
            took_s = (one.steady_ns - one.first_ns) / 1e9
            rows.append(("steady state", f"{took_s:.2f} s later, \u00b1{steady_ms:.0f} ms"))
        if isinstance(one, trial.SqueezeFeatures):
            rows += _physical(one.by_name)
            change = f"none: {one.reason or 'no camera'}"
            if one.vision is not None:
                change = f"{100 * (1.0 - one.missing):.0f} % of {100 * one.patch_width_m:.1f} cm"
            rows.append(("depth change", change))
    if rows:
        table = "\n".join(["| measured | |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in rows)])
        now.show_text(MEASURED, table)


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


def log_content(now: ResultBatch, posterior: trial.ContentPosterior) -> None:
    """Log a line for each content during the squeeze; the final posterior of all features is only text."""
    if posterior.index >= 0:
        tints = tints_of(len(posterior.labels))
        lines = rr.SeriesLines(names=list(posterior.labels), colors=tints, widths=[2.0] * len(tints))
        now.batch.log(CONTENT, lines, static=True)
        now.show(CONTENT, rr.Scalars(posterior.probability))
    order = np.argsort(posterior.probability)[::-1]
    rows = [f"| {posterior.labels[at]} | {100 * posterior.probability[at]:.0f} % |" for at in order]
    head = [f"# {posterior.content}", "", f"{posterior.since_s:.1f} s after first contact, by {posterior.modality}", ""]
    text = "\n".join([*head, "| content | probability |", "| --- | --- |", *rows])
    now.show_text(NAMED, text)


def log_container_change(now: ResultBatch, change: trial.ContainerChange) -> None:
    """Log the change of depth during the squeeze; a refused image is reported as text, and the last picture stays."""
    _show(now, change.change_m, change.width_m, change.missing, change.reason)


def log_change(now: ResultBatch, features: trial.SqueezeFeatures) -> None:
    _show(now, features.vision, features.patch_width_m, features.missing, features.reason or "no camera")


def _show(now: ResultBatch, change_m: FloatArray | None, width_m: float, missing: float, reason: str) -> None:
    if change_m is None:
        now.show_words(f"{CHANGE}/words", f"no visual feature: {reason}", "WARN")
    else:
        now.show_png(CHANGE, depth_change_png, change_m, width_m, missing)


def log_container(now: ResultBatch, tracked: trial.TrackedContainer) -> None:
    """Log the container: green at rest, which stays; red during the squeeze, like everything simulated; darker if the
    track is bad."""
    before = not tracked.since_s >= 0.0
    color = BAD if not tracked.good else REST if before else SIMULATED
    when = "before contact" if before else f"{tracked.since_s:.1f} s after contact"
    words = f"refused: {tracked.reason}"
    if tracked.good:
        words = f"{100 * tracked.agreeing:.0f} % of the pixels agree"
    if tracked.directions is not None:
        words += f"\ndegrees of freedom: {tracked.degrees}"
    if tracked.lag_s is not None and tracked.live:
        words += f"; {1e3 * tracked.lag_s:.0f} ms behind" + f", {tracked.skipped} left out" * bool(tracked.skipped)
    edges = tracked.edges_px.astype(np.float32)
    path = f"{CONTAINER}/{'before' if before else 'after'}"
    width, order = (BEFORE_PX, 79.0) if before else (AFTER_PX, 80.0)
    now.show(path, rr.LineStrips2D(edges, radii=width, colors=color, draw_order=order))
    points = edges.reshape(-1, 2) if len(edges) else np.zeros((1, 2), np.float32)
    low, high = points.min(axis=0), points.max(axis=0)
    place = [0.5 * (low[0] + high[0]), low[1] - (0.45 if before else 0.3) * (high[1] - low[1])]
    label = [f"{when}: {words}"]
    now.show(
        f"{path}/words", rr.Points2D([place], radii=0.01, colors=TEXT, labels=label, show_labels=True, draw_order=81.0)
    )


FORCE = "display/squeeze/force"
AXIS_MM = 16.0
"""Length of the principal axis of pressures on a line; for a round distribution it is 0."""


@dataclass(frozen=True, slots=True)
class Fingertips:
    """stream: the tactile device; pads: places of the squeezing fingertips among its pads"""

    stream: Stream
    pads: tuple[int, ...]


def log_fingertips(now: ResultBatch, tips: trial.FingertipPressure, fingertips: Fingertips) -> None:
    now.show(FORCE, rr.Scalars(tips.force_n))
    hand = Hand.of(fingertips.stream.pads)
    touched = [at for at in range(len(fingertips.pads)) if tips.area_m2[at] > 0.0]
    centers, lines, labels = [], [], []
    for at in touched:
        top, left = hand.corners[fingertips.pads[at]]
        center = np.array([left, top]) * hand.texel_mm + tips.center_m[at] * 1e3
        half = 0.5 * AXIS_MM * tips.elongation[at] * np.array([np.cos(tips.axis_rad[at]), np.sin(tips.axis_rad[at])])
        centers.append(center)
        lines.append(np.nan_to_num(np.stack([center - half, center + half]), nan=0.0))
        labels.append(f"{tips.force_n[at]:.2f} N, {tips.area_m2[at] * 1e4:.1f} cm2")
    path = root("display/tactile", fingertips.stream.device)
    points = np.array(centers).reshape(-1, 2)
    now.show(
        f"{path}/contact",
        rr.Points2D(points, radii=MARK_MM, colors=CENTER, labels=labels, show_labels=True, draw_order=70.0),
    )
    strips = np.array(lines).reshape(-1, 2, 2)
    now.show(f"{path}/axis", rr.LineStrips2D(strips, radii=0.4 * MARK_MM, colors=CENTER, draw_order=65.0))


# An arm that places the hand: container found, grasps that were drawn, the arm and its way, in the table's frame

PLACE, IMAGE, WORDS = "display/place/scene", "display/place/image", "display/place/words"
LOOKS: dict[str, Rgb] = {"before": REST, "asked": REST, "placed": HELD, "after": OBSERVED}
"""Colours of the found container."""
HAND_M, BAR_M, LINE_M = 0.14, 0.06, 0.0015
"""A grasp is drawn from the palm to between the pads, and across, as the fingers close [m]."""
FLOOR: Rgb = (52, 56, 64)


def log_place_start(rec: Sink, streams: Sequence[Stream], base_from_table: FloatArray | None) -> None:
    """Pose of the arm in the table's frame."""
    for stream in streams:
        if stream.kind == "arm" and stream.urdf is not None and base_from_table is not None:
            log_base(rec, stream, base_from_table)


def log_sighting(now: ResultBatch, seen: ContainerSighting) -> None:
    """Log the container at its measured place, in space and over the image; its change as text."""
    changed = seen.change is not None and seen.change.changed
    color = BAD if changed else LOOKS[seen.when]
    level = "WARN" if changed or seen.fit is None else "INFO"
    now.show_words(f"{WORDS}/{seen.when}", f"container {seen.when}: {seen.words}", level)
    if seen.fit is None:
        return
    now.show(f"{PLACE}/container/{seen.when}", _solid(seen.fit, color))
    edges = seen.edges_px.astype(np.float32)
    now.show(f"{IMAGE}/{seen.when}", rr.LineStrips2D(edges, radii=1.0, colors=color, draw_order=80.0))


def log_placement(now: ResultBatch, placed: HandPlacement) -> None:
    """Log all grasps that were drawn, the grasp that the arm reaches, and its path."""
    strips, colors, widths = [], [], []
    for T, refused in zip(placed.T_table_hands, placed.refused, strict=True):
        palm, middle, aside = T[:3, 3], T[:3, 3] + HAND_M * T[:3, 2], 0.5 * BAR_M * T[:3, 0]
        strips += [[palm, middle], [middle - aside, middle + aside]]
        colors += [IDLE if refused else WARN] * 2
        widths += [LINE_M if refused else 2.5 * LINE_M] * 2
    now.show(f"{PLACE}/grasps", rr.LineStrips3D(np.array(strips, np.float32), colors=colors, radii=widths))
    if len(placed.path_m):
        now.show_lines(f"{PLACE}/way", placed.path_m[None], OBSERVED, LINE_M)
    why = ", ".join(placed.reasons) or "none refused"
    at = f"along {1e3 * placed.along_m:.0f} mm, tilt {placed.tilt_deg:.0f} deg, turn {placed.turn_deg:.0f} deg"
    words = f"{placed.by} came to: {placed.reached or 'planned'}; {len(placed.refused)} drawn, {why}; {at}"
    now.show_words(f"{WORDS}/grasp", words, "INFO")


def place_views(streams: Sequence[Stream], camera: str) -> rrb.Container:
    """The arm, the container and the grasps in space; the container over the image; events as text."""
    arms = [stream for stream in streams if stream.kind == "arm"]
    simulated = " (SIMULATED)" if any(arm.simulated for arm in arms) else ""
    shown = [f"+ /{root('display/arm', arm.device)}/**" for arm in arms if arm.urdf is not None]
    title = f"table [m]: grasp orange, refused grey, way blue{simulated}"
    eye, target = [0.75, -0.75, 0.75], [0.0, -0.1, 0.12]
    scene = space_view(title, [f"+ /{PLACE}/**", *shown], eye, target, frame=SURFACE_FRAME, floor=FLOOR)
    image = rrb.Spatial2DView(
        contents=[f"+ /{root('depth', camera)}", f"+ /{IMAGE}/**"],
        name=f"{camera}: container before (green), placed (yellow), after (blue){simulated}",
    )
    words = rrb.TextLogView(contents=[f"+ /{WORDS}/**"], origin=WORDS, name="what was found")
    right = rrb.Vertical(image, words, row_shares=[2.0, 1.0])
    return rrb.Horizontal(scene, right, column_shares=[1.4, 1.0], name="Placing")


def _solid(fit: ContainerFit, color: Rgb) -> rr.AsComponents:
    pose = fit.T_table_container
    turn = rr.Quaternion(xyzw=[0.0, 0.0, np.sin(0.5 * fit.yaw_rad), np.cos(0.5 * fit.yaw_rad)])
    if fit.shape == "cylinder":
        return rr.Cylinders3D(
            lengths=[fit.size_m[2]], radii=[0.5 * fit.size_m[0]], centers=[pose[:3, 3]], colors=color, line_radii=LINE_M
        )
    return rr.Boxes3D(
        half_sizes=[0.5 * fit.size_m], centers=[pose[:3, 3]], quaternions=[turn], colors=color, radii=LINE_M
    )


# The view of a squeeze in one window: the pads and the container, changes, and the classification of its content

WINDOW_S = 6.0
"""How far back the plots show: a squeeze from the air on."""
CLOSING = [axis in (FINGERS[0].proximal_axis, FINGERS[2].proximal_axis) for axis in range(len(AXIS_NAMES))]
"""Which axes close."""


def squeeze_blueprint(
    streams: Sequence[Stream],
    tactile: str,
    camera: str,
    around_px: tuple[float, float, float, float] | None = None,
    *,
    named: bool = False,
    placed: bool = False,
) -> rrb.Blueprint:
    """The views of a squeeze with these devices; the devices' own views in a second tab.

    around_px: left, top, right, bottom of the depth image that is shown, None = all; named: a model names the content
    placed: an arm placed the hand"""
    hand = next(stream for stream in streams if stream.device == tactile)
    simulated = " (SIMULATED)" if hand.simulated else ""
    pictures: list[rrb.View] = [tactile_view(hand)]
    shares = [1.0]
    if camera:
        contents = [f"+ /{root('depth', camera)}", f"+ /{CONTAINER}/**"]
        bounds = None
        if around_px is not None:
            left, top, right, bottom = around_px
            bounds = rrb.VisualBounds2D(x_range=[left, right], y_range=[top, bottom])
        name = f"{camera}: depth [m], model before (green), after (red){simulated}"
        pictures.append(rrb.Spatial2DView(contents=contents, name=name, visual_bounds=bounds))
        about = f"depth change: data minus model{simulated}"
        pictures.append(rrb.Spatial2DView(contents=[f"+ /{CHANGE}"], name=about, background=list(BACKGROUND)))
        shares += [1.1, 0.9]
    hands = [
        plot_view(
            path,
            "closing axes [deg]: finger 0 orange, 2 pink",
            window_s=WINDOW_S,
            plot_legend=rrb.PlotLegend(visible=False),
            overrides={path: rr.SeriesLines(names=list(AXIS_NAMES), visible_series=CLOSING)},
        )
        for stream in streams
        if stream.kind == "hand"
        for path, _ in plotted(stream)
    ]
    lanes = rrb.StateTimelineView(contents=[f"+ /{ENTITIES[SqueezePhase]}"], origin="squeeze", name="phases")
    plots = [plot_view(FORCE, f"force of the fingertips [N]{simulated}", window_s=WINDOW_S), *hands]
    below: list[rrb.View] = [rrb.TextDocumentView(origin=MEASURED, name="what was measured")]
    if named:
        share = rrb.ScalarAxis(range=(0.0, 1.0), zoom_lock=True)
        plots.append(
            plot_view(CONTENT, "probability of each content, by touch and vision", window_s=WINDOW_S, axis_y=share)
        )
        below.append(rrb.TextDocumentView(origin=NAMED, name="content of the container"))
    numbers = rrb.Horizontal(
        rrb.Vertical(rrb.Horizontal(*plots), lanes, row_shares=[3.0, 1.0]),
        *below,
        column_shares=[1.1 * len(plots), *[1.1, 0.9][: len(below)]],
    )
    above = rrb.Horizontal(*pictures, column_shares=shares)
    shown = rrb.Vertical(above, numbers, row_shares=[3.0, 2.2], name="Squeeze")
    devices = rrb.Vertical(rig_views(streams), name="Devices")
    return blueprint_of(rrb.Tabs(shown, *([place_views(streams, camera)] if placed else []), devices, active_tab=0))


CAMERA = "squeezed.names.camera"
PHASE, STOPPED = ShownStage("phase", 0, "state of the hand"), ShownStage("stopped", 0, "why", when=SOMETIMES)
SIGHTING = ShownStage("sighting", 2, "the container in the depth image", when=SOMETIMES)
PLACEMENT = ShownStage("placement", 2, "the drawn grasp, and the arm's path to it", when=SOMETIMES)
FINGERTIPS = ShownStage("fingertips", 2, "force, area, centre and axis of pressure (fig. 2.4)")
EVENTS = ShownStage("events", 2, "first contact and steady state")
TRACK = ShownStage("track", 2, "pose of the rigid model in a depth image (fig. 2.8)", when=CAMERA)
FEATURES = ShownStage("features", 2, "tactile and physical, at steady state (fig. 2.7)")
DEPTH_CHANGE = ShownStage("depth change", 2, "data minus model (fig. 2.6)", field="change_m", when=CAMERA)
POSTERIOR = ShownStage("posterior", 2, "probability of each content", when=SOMETIMES)


def log_squeeze_start(rec: rr.RecordingStream, fingertips: Fingertips | None) -> None:
    """Log constants: colours of the phases, names of the plots; and empty results."""
    rec.log(ENTITIES[trial.SqueezePhase], states(SQUEEZE_PHASES), static=True)
    if fingertips is not None:
        names = [f"{fingertips.stream.pads[place].name} [N]" for place in fingertips.pads]
        log_series(rec, FORCE, names, tints_of(len(names)))
    batch = Batch()
    start = ResultBatch(batch, 0)
    start.show_text(MEASURED, "*Numbers follow once the fingers are at rest.*")
    start.show_text(NAMED, "*Classified from the first contact on.*")
    batch.send(rec)


def prepare_squeeze_results(results: Sequence[object], session_ns: int, fingertips: Fingertips | None) -> Batch:
    """Prepare results for one stream or several. session_ns: time since the recording's start [ns].

    Raises TypeError if it is no result of a squeeze."""
    batch = Batch()
    now = ResultBatch(batch, session_ns)
    views = squeeze_views(fingertips)
    for result in results:
        shown = views_of(type(result), views)
        now.record(result)
        for view in shown:
            view(now, result)
    log_measured(now, results)
    return batch


def squeeze_views(fingertips: Fingertips | None) -> Views[ResultBatch]:
    """The view of each result; events are in the table of `log_measured`."""
    return {
        trial.SqueezePhase: (PHASE, partial(ResultBatch.show_phase, known=SQUEEZE_PHASES)),
        trial.SqueezeStop: (STOPPED, ResultBatch.show_stop),
        trial.FingertipPressure: (
            FINGERTIPS,
            *(() if fingertips is None else [partial(log_fingertips, fingertips=fingertips)]),
        ),
        trial.TrackedContainer: (TRACK, log_container),
        trial.ContainerChange: (DEPTH_CHANGE, log_container_change),
        trial.SqueezeFeatures: (FEATURES, log_change),
        trial.ContentPosterior: (POSTERIOR, log_content),
        SqueezeEvents: (EVENTS,),
        ContainerSighting: (SIGHTING, log_sighting),
        HandPlacement: (PLACEMENT, log_placement),
    }
