"""Effect of beta and theta on a body, as it is recorded: its static states on timelines of the parameters (Thesis
figures 3.5, 3.7 and 3.13)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deformscope.arrays import BoolArray, FloatArray
from deformscope.log.blueprint import PAPER
from deformscope.log.canvas import LABEL
from deformscope.log.rig.blueprint import blueprint_of
from deformscope.log.views import OwnView
from deformscope.pictures.palette import HELD, JOINTS, REST, SIMULATED

STEPS = 100
"""Steps of a parameter's timeline from 0 to 1, which counts whole steps."""
GUIDE = f"""\
### What beta and theta do

Particles are held where they are yellow, come to rest where they are red, and were where they are green. Scrub the
timeline **beta** or **theta**: the bottom left chooses it, and it counts {STEPS} steps from 0 to 1. A body moves on the
timeline that its view's title begins with, and rests on the other.
"""
FPS = 20.0
UNIT_M, MARGIN = 0.01, 0.12
"""Unit of the ruler [m]; margin around a body, as a share of its size."""


@dataclass(frozen=True, slots=True)
class StateSweep:
    """A lattice of particles in the plane, or one layer of one in space, seen from the side.

    over: name of the parameter; value: (n,) values of it; rest: (rows, columns, 2), position: (n, rows, columns, 2)
    [m]; held: (rows, columns) particles whose position is prescribed; measure: (n,) measure of the body (`measured`)"""

    name: str
    over: Literal["beta", "theta"]
    value: FloatArray
    rest: FloatArray
    position: FloatArray
    held: BoolArray
    measured: str
    measure: FloatArray

    def to_text(self) -> str:
        """The measured values at both ends of the parameter, as text."""
        ends = (f"{self.measure[at]:.1f} at {self.over} {self.value[at]:g}" for at in (0, -1))
        return f"{self.name}: {self.measured}: {', '.join(ends)}"


@dataclass(frozen=True, slots=True)
class StateSweeps(OwnView):
    """Several sweeps, for one view."""

    sweeps: tuple[StateSweep, ...]

    def log(self, rec: rr.RecordingStream) -> None:
        """Each body's particles, net and number at each value of its parameter; on the other's timeline it rests."""
        text = "\n".join([GUIDE, *(f"- {sweep.to_text()}" for sweep in self.sweeps)])
        rec.log("guide", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
        for number, sweep in enumerate(self.sweeps):
            _log_sweep(rec, sweep)
            rec.log(f"plot/{_path(sweep)}", rr.SeriesLines(names=sweep.name, colors=JOINTS[number]), static=True)
        title = "; ".join({f"{sweep.over}: {sweep.measured}": None for sweep in self.sweeps})
        legend = rrb.PlotLegend(corner=rrb.Corner2D.LeftBottom)
        plot = rrb.TimeSeriesView(origin="/plot", name=title, plot_legend=legend)
        guide = rrb.TextDocumentView(origin="/guide", name="What there is to see")
        below = rrb.Horizontal(plot, guide, column_shares=[2, 1])
        root = rrb.Vertical(rrb.Horizontal(*map(_view, self.sweeps)), below, row_shares=[3, 2])
        rec.send_blueprint(blueprint_of(root, self.sweeps[0].over, play="paused", fps=FPS))


def _path(sweep: StateSweep) -> str:
    return f"{sweep.over}/{sweep.name.replace(', ', '-').replace(' ', '-')}"


def _log_sweep(rec: rr.RecordingStream, sweep: StateSweep) -> None:
    path, count = _path(sweep), len(sweep.value)
    times = [rr.TimeColumn(sweep.over, sequence=np.round(STEPS * sweep.value).astype(np.int64))]
    spacing = float(np.linalg.norm(sweep.rest[1, 0] - sweep.rest[0, 0]))
    corner = sweep.rest.min(axis=(0, 1)) - [0.0, 1.2 * UNIT_M]
    rec.log(path, rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)  # views in the plane have y downwards
    rec.log(f"{path}/rest", rr.Points2D(sweep.rest.reshape(-1, 2), radii=0.09 * spacing, colors=REST), static=True)
    ruler = rr.LineStrips2D([[corner, (corner[0] + UNIT_M, corner[1])]], colors=(70, 75, 85), labels=["1 cm"])
    rec.log(f"{path}/ruler", ruler, static=True)
    for name, chosen, tint, share in (("particles", ~sweep.held, SIMULATED, 0.16), ("held", sweep.held, HELD, 0.2)):
        rec.log(f"{path}/{name}", rr.Points2D.from_fields(colors=tint, radii=share * spacing), static=True)
        places = sweep.position[:, chosen]
        columns = rr.Points2D.columns(positions=places.reshape(-1, 2)).partition([places.shape[1]] * count)
        rec.send_columns(f"{path}/{name}", times, columns)
    rec.log(f"{path}/net", rr.LineStrips2D.from_fields(colors=SIMULATED, radii=0.03 * spacing), static=True)
    strips = [strip for grid in sweep.position for strip in (*grid, *grid.swapaxes(0, 1))]
    net = rr.LineStrips2D.columns(strips=strips).partition([sum(sweep.held.shape)] * count)
    rec.send_columns(f"{path}/net", times, net)
    rec.send_columns(f"plot/{path}", times, rr.Scalars.columns(scalars=sweep.measure))
    words = [f"{sweep.over} {value:.2f}" for value in sweep.value]
    at = (float(sweep.rest[..., 0].mean()), float(corner[1]) - UNIT_M)
    rec.log(f"{path}/label", rr.Points2D.from_fields(colors=LABEL, radii=0.02 * spacing, show_labels=True), static=True)
    rec.send_columns(f"{path}/label", times, rr.Points2D.columns(positions=[at] * count, labels=words))


def _view(sweep: StateSweep) -> rrb.View:
    every = np.concatenate([sweep.rest[None], sweep.position]).reshape(-1, 2)
    every = np.vstack([every, every.min(axis=0) - [0.0, 3.0 * UNIT_M]]) * [1.0, -1.0]
    low, high = every.min(axis=0), every.max(axis=0)
    margin = MARGIN * float((high - low).max())
    x_range, y_range = ([float(a) - margin, float(b) + margin] for a, b in zip(low, high, strict=True))
    bounds = rrb.VisualBounds2D(x_range=x_range, y_range=y_range)
    name, contents = f"{sweep.over}: {sweep.name}", [f"+ /{_path(sweep)}/**"]
    return rrb.Spatial2DView(name=name, contents=contents, visual_bounds=bounds, background=PAPER)
