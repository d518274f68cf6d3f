"""What beta and theta do to a body: its static states on timelines of the parameters, to be scrubbed."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deformscope.log.blueprint import PAPER
from deformscope.log.canvas import TEXT
from deformscope.log.rig.blueprint import blueprint_of
from deformscope.pictures.palette import HELD, OBSERVED, REST, SIMULATED
from deformscope.stages.msm.state_sweep import StateSweep, StateSweeps

STEPS = 100
"""Of a parameter's timeline from 0 to 1, which counts whole steps."""
FPS = 20.0
UNIT_M, MARGIN = 0.01, 0.12
PLOTS = {
    "moved": "Mean displacement of the particles that are not held [mm], colours as beside",
    "size": "Area or volume [% of that at rest]",
}


def log_states(rec: rr.RecordingStream, states: StateSweeps) -> None:
    """Each body's particles, held ones, net and numbers at each value of its parameter; nothing of it on the other's
    timeline but the body at rest."""
    rec.log("guide", rr.TextDocument(states.text, media_type=rr.MediaType.MARKDOWN), static=True)
    for sweep in states.sweeps:
        _log_sweep(rec, sweep)
    rec.send_blueprint(_blueprint(states))


def _path(sweep: StateSweep) -> str:
    return f"{sweep.over}/{sweep.lattice.name.replace(', ', '-').replace(' ', '-')}"


def _log_sweep(rec: rr.RecordingStream, sweep: StateSweep) -> None:
    path, lattice, count = _path(sweep), sweep.lattice, len(sweep.value)
    times = [rr.TimeColumn(sweep.over, sequence=np.round(STEPS * sweep.value).astype(np.int64))]
    rest, seen = lattice.seen(lattice.rest), lattice.seen(sweep.position)
    spacing = float(np.linalg.norm(rest[1, 0] - rest[0, 0]))
    held = np.isin(lattice.shown, lattice.held)
    rec.log(path, rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)  # views in the plane have y downwards
    rec.log(f"{path}/rest", rr.Points2D(rest.reshape(-1, 2), radii=0.09 * spacing, colors=REST), static=True)
    ruler = rest.reshape(-1, 2).min(axis=0) - [0.0, 1.2 * UNIT_M]
    across = np.stack([ruler, ruler + UNIT_M * np.eye(2)[0]])
    line = rr.LineStrips2D([across], colors=TEXT, labels=["1 cm"], show_labels=True)
    rec.log(f"{path}/ruler", line, static=True)
    for name, chosen, tint, share in (("particles", ~held, SIMULATED, 0.16), ("held", held, HELD, 0.2)):
        rec.log(f"{path}/{name}", rr.Points2D.from_fields(colors=tint, radii=share * spacing), static=True)
        places = seen[:, chosen]
        columns = rr.Points2D.columns(positions=places.reshape(-1, 2)).partition([places.shape[1]] * count)
        rec.send_columns(f"{path}/{name}", times, columns)
    rec.log(f"{path}/net", rr.LineStrips2D.from_fields(colors=SIMULATED, radii=0.03 * spacing), static=True)
    strips = [strip for grid in seen for strip in (*grid, *grid.swapaxes(0, 1))]
    net = rr.LineStrips2D.columns(strips=strips).partition([sum(rest.shape[:2])] * count)
    rec.send_columns(f"{path}/net", times, net)
    numbers = {"moved": 1e3 * sweep.moved_m, "size": 1e2 * sweep.size}
    for name, values in numbers.items():
        rec.log(f"plot/{name}/{path}", rr.SeriesLines(names=lattice.name, colors=_tint(sweep)), static=True)
        rec.send_columns(f"plot/{name}/{path}", times, rr.Scalars.columns(scalars=values))
    words = [
        f"{sweep.over} {value:.2f}: {moved:.1f} mm, {size:.0f} %"
        for value, moved, size in zip(sweep.value, *numbers.values(), strict=True)
    ]
    label = np.array([rest[..., 0].mean(), ruler[1] - UNIT_M])
    rec.log(f"{path}/label", rr.Points2D.from_fields(colors=TEXT, radii=0.02 * spacing, show_labels=True), static=True)
    rec.send_columns(f"{path}/label", times, rr.Points2D.columns(positions=[label] * count, labels=words))


def _tint(sweep: StateSweep) -> tuple[int, int, int]:
    if sweep.lattice.cluster_size is not None:
        return HELD
    return OBSERVED if sweep.lattice.basis == "quadratic" else SIMULATED


def _blueprint(states: StateSweeps) -> rrb.Blueprint:
    views = [_view(sweep) for sweep in states.sweeps]
    plots = [
        rrb.TimeSeriesView(
            origin=f"/plot/{name}",
            name=title,
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftBottom, visible=name == "size"),
        )
        for name, title in PLOTS.items()
    ]
    guide = rrb.TextDocumentView(origin="/guide", name="What there is to see")
    root = rrb.Vertical(rrb.Horizontal(*views), rrb.Horizontal(*plots, guide), row_shares=[3, 2])
    return blueprint_of(root, states.sweeps[0].over, play="paused", fps=FPS)


def _view(sweep: StateSweep) -> rrb.View:
    lattice = sweep.lattice
    every = np.concatenate([lattice.seen(lattice.rest)[None], lattice.seen(sweep.position)]).reshape(-1, 2)
    every = np.vstack([every, every.min(axis=0) - [0.0, 3.0 * UNIT_M]]) * [1.0, -1.0]
    low, high = every.min(axis=0), every.max(axis=0)
    margin = MARGIN * float((high - low).max())
    ranges = [[float(a) - margin, float(b) + margin] for a, b in zip(low, high, strict=True)]
    return rrb.Spatial2DView(
        name=f"{sweep.over}: {lattice.name}",
        contents=[f"+ /{_path(sweep)}/**"],
        visual_bounds=rrb.VisualBounds2D(x_range=ranges[0], y_range=ranges[1]),
        background=PAPER,
    )
