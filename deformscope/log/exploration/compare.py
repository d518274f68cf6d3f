"""Other settings' results for a recorded exploration, as a layer over it: in the recording's views, in two colours.

display/scene/beside   where the regions end, on the surface in space: recorded, and with the other settings
display/beside/... the same as a picture, and the result of each touch"""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from deformscope.frames import Stream
from deformscope.log.exploration.blueprint import COMPARED_REGIONS, COMPARED_TOUCHES, exploration_blueprint
from deformscope.log.exploration.scene import LINE_M, SCENE
from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.columns import Batch
from deformscope.pictures import exploration as pictures
from deformscope.pictures.messages import format_verdict
from deformscope.stages.map.exploration import MapEstimate, SurfaceEstimate, TouchEstimate

ABOVE_M, APART_M = 0.002, 0.07
"""How far the lines are above the surface, and their names above its far edge and each other."""
WIDTHS_M = 3 * LINE_M, LINE_M
"""Line widths, chosen so that both lines are visible where they coincide."""


def comparison_rrd(
    identity: tuple[str, str],
    streams: Sequence[Stream],
    size_m: tuple[float, float],
    recorded: Sequence[tuple[int, object]],
    again: Sequence[object],
    name: str,
) -> bytes:
    """rerun data that a viewer lays over a recording, with views of both.

    identity, streams, size_m: identity, streams and size of the recording and its surface; recorded: its results with
    their time since its start [ns]; again: results with other settings; name: name of these"""
    rec = rr.RecordingStream(identity[0], recording_id=identity[1], send_properties=False)
    encoded = rr.binary_stream(rec)
    truth = any(isinstance(one, MapEstimate) and one.truth_labels is not None for _, one in recorded)
    views = exploration_blueprint(streams, size_m, truth=truth, tabs=True, compared=name)
    rec.send_blueprint(views)
    _batch_of(recorded, again, name).send(rec)
    return encoded.read() or b""


def _batch_of(recorded: Sequence[tuple[int, object]], again: Sequence[object], name: str) -> Batch:
    batch = Batch()
    before: list[TouchEstimate] = []
    others = [one for one in again if isinstance(one, TouchEstimate)]
    maps = {one.touches: one for one in again if isinstance(one, MapEstimate)}
    surface = next((one for _, one in recorded if isinstance(one, SurfaceEstimate)), None)
    for path in (COMPARED_REGIONS, *COMPARED_TOUCHES.values()):
        ResultBatch(batch, 0).show_png(path, pictures.text_png, "no touch yet")
    for session_ns, result in recorded:
        now = ResultBatch(batch, session_ns)
        if isinstance(result, TouchEstimate):
            before.append(result)
            now_known = [one for one in others if one.number <= result.number]
            for quantity, path in COMPARED_TOUCHES.items():
                now.show_png(path, pictures.touch_comparison_png, quantity, before, now_known, name)
        elif isinstance(result, MapEstimate) and (other := maps.get(result.touches)) is not None:
            now.show_png(COMPARED_REGIONS, pictures.region_comparison_png, result, other, name)
            _log_edges(now, (result, other), name, surface)
    return batch


def _log_edges(
    now: ResultBatch, maps: tuple[MapEstimate, MapEstimate], name: str, surface: SurfaceEstimate | None
) -> None:
    """On the surface, and above its far edge their names in the same colours."""
    names = ("recorded", name)
    for place, (one, color, whose) in enumerate(zip(maps, (pictures.RECORDED, pictures.OTHER), names, strict=True)):
        edges = pictures.region_edges(one.labels, one.cell_m)
        height_m = np.zeros(edges.shape[:2])
        if surface is not None:
            rows, columns = surface.height_m.shape
            x, y = (
                np.minimum(edges[..., axis] / surface.cell_m, (columns, rows)[axis] - 1).astype(int) for axis in (0, 1)
            )
            height_m = surface.height_m[y, x]
        lines = np.concatenate([edges, (height_m + (1 + place) * ABOVE_M)[..., None]], axis=-1)
        path = f"{SCENE}/beside/{('recorded', 'other')[place]}"
        now.show_lines(path, lines, color, WIDTHS_M[place])
        y_m = one.labels.shape[0] * one.cell_m
        words = f"{whose}: {format_verdict(one)}"
        now.show_points(f"{path}/name", np.array([[0.0, y_m, (1 + place) * APART_M]]), color, 2 * LINE_M, [words])
