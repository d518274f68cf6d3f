"""Two recordings in the same plots, each in one colour, on a timeline that is zero at the first contact of each.

aligned/QUANTITY/a|b/DEVICE    a series of the first, of the second recording"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deformscope.arrays import FloatArray, IntArray
from deformscope.log.rig.blueprint import LEGEND, blueprint_of
from deformscope.log.rig.columns import log_series, root, scalars
from deformscope.pictures.exploration import OTHER, RECORDED

CONTACT_TIMELINE = "contact"
COLORS = RECORDED, OTHER


@dataclass(frozen=True, slots=True, eq=False)
class AlignedSeries:
    """Measurements of a device of one of the recordings.

    quantity: quantity with its unit; each has a plot; name: name of recording and device; which: 0 the first recording,
    1 the second; since_ns: (n,) time since the recording's first contact [ns]; values: (n,)"""

    quantity: str
    name: str
    which: int
    since_ns: IntArray
    values: FloatArray


def aligned_rrd(series: Sequence[AlignedSeries], names: tuple[str, str]) -> bytes:
    """Both recordings as rerun data, with their views. names: names of the two recordings"""
    rec = rr.RecordingStream("deformscope-aligned", send_properties=False)
    encoded = rr.binary_stream(rec)
    quantities = list(dict.fromkeys(one.quantity for one in series))
    views = [
        rrb.TimeSeriesView(
            contents=[f"+ /{root('aligned', quantity)}/**"],
            name=f"{quantity}: {names[0]} blue, {names[1]} orange",
            plot_legend=LEGEND,
            axis_x=rrb.archetypes.TimeAxis(link="LinkToGlobal"),
        )
        for quantity in quantities
    ]
    rec.send_blueprint(blueprint_of(rrb.Vertical(*views), CONTACT_TIMELINE, play="paused"))
    for one in series:
        path = root("aligned", one.quantity, "ab"[one.which], rr.escape_entity_path_part(one.name))
        log_series(rec, path, [one.name], [COLORS[one.which]])
        since = rr.TimeColumn(CONTACT_TIMELINE, duration=one.since_ns.astype("timedelta64[ns]"))
        rec.send_columns(path, [since], scalars(list(np.asarray(one.values)[:, None])))
    return encoded.read() or b""
