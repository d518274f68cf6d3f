"""An arm that places the hand: container found, grasps that were drawn, the arm and its way, in the table's frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deformscope.arrays import FloatArray
from deformscope.frames import Stream
from deformscope.log.exploration.scene import SURFACE_FRAME, log_base
from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.blueprint import space_view
from deformscope.log.rig.columns import Sink, root
from deformscope.pictures.palette import BAD, HELD, IDLE, OBSERVED, REST, WARN, Rgb
from deformscope.stages.squeeze.placement import ContainerFit, ContainerSighting, HandPlacement

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
