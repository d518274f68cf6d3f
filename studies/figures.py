"""The figures of Thesis chapter 3 that show the model itself: 3.5, 3.7, 3.8 and 3.13, and three searches for one beta.

    python -m studies figures --out figures

Motions are in the recording of `python -m studies reproduce shapes`; these are its pictures, lengths in centimetres.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.config import flags
from deformscope.pictures.figures import COLOURS, canvas, png_of
from deformscope.pictures.report import Figure
from deformscope.stages.msm.clusters import held_mask
from studies.output import dict_table
from studies.reproduce.pressed_cubes import Cube, thesis_cubes
from studies.reproduce.searches import SearchOutcome, compare_searches
from studies.reproduce.shapes import BETAS, CUBE_BETA, HeldLattice, column, cube, sheet
from studies.reproduce.state_sweep import StateSweep
from studies.runner import Study, StudyOptions, StudyReport, Trials

DPI = 140
PUSH_M, PUSH_MOST = 1e-3, 20_000
"""For figure 3.13 (c): force over mass times the squared time step [m] of each pushed particle; steps at most."""
SHEARED, THETAS, PUSHED = (0.0, 0.9, 0.99), (0.99, 0.3, 0.0), (0.1, 0.9)
"""Betas of figure 3.5 (a) to (c), which the thesis does not print; thetas of 3.7 (b) to (d), betas of 3.13 (c)."""
KNOWN_BETA, NOISE_M = 0.7, 2e-4


@dataclass(frozen=True, slots=True)
class FiguresConfig(StudyOptions):
    """Draw them."""

    out: flags.Folder = Path("runs/figures")
    """Folder for the figures (PNG); files there are replaced."""


def search_known(seed: int) -> tuple[SearchOutcome, ...]:
    """For the beta of the pressed sheet, whose positions have noise."""
    body = sheet()
    held = body.seen.held
    state = body.model.body(body.seen).relax(body.seen.deformed[held], KNOWN_BETA).position[0]
    noisy = state + NOISE_M * np.random.default_rng(seed).standard_normal(state.shape)
    noisy[held] = state[held]
    seen = dataclasses.replace(body.seen, deformed=noisy)
    return compare_searches(seen, body.model, (0.0, float(BETAS[-1])))


def report(options: FiguresConfig, _: float, searched: Sequence[tuple[SearchOutcome, ...]]) -> StudyReport:
    drawn = {
        "3.5": (draw_beta(), "A body whose ends are held, by beta"),
        "3.7": (draw_theta(), "The middle layer of a pressed cube, by theta"),
        "3.8": (draw_mesh(thesis_cubes((0.4,), (6,), (0.03,))[0][0]), "The finite elements, whose nodes are particles"),
        "3.13": (draw_push(), "A particle that is held elsewhere, and one push at two betas"),
    }
    rows = [dataclasses.asdict(one) for outcomes in searched for one in outcomes]
    caption = f"Searches for a beta of {KNOWN_BETA:g}, seen with noise of {1e3 * NOISE_M:g} mm"
    figures = [Figure(png, f"Figure {number}: {words}") for number, (png, words) in drawn.items()]
    files: dict[Path | None, bytes] = {options.out / f"figure-{name}.png": png for name, (png, _) in drawn.items()}
    return StudyReport([dict_table(rows, caption)], rows, figures, files)


def pushed(body: HeldLattice, beta: float) -> tuple[FloatArray, FloatArray]:
    """(K, 2) equilibrium of a sheet on its ground under a push down on the middle three of its top, the fixed point of
    x = g(x + f dt^2 / m) with alpha = 1; and (3, 2) rest positions of these."""
    rest, (columns, rows) = body.seen.rest, body.shape
    ground = np.flatnonzero(rest[:, 1] == 0.0)
    model = body.model.body(body.seen).holding(ground)
    held = held_mask(len(rest), ground)[:, None]
    middle = (columns // 2 + np.array([-1, 0, 1])) * rows + rows - 1
    offset = np.zeros_like(rest)
    offset[middle, 1] = -PUSH_M
    at = goal = rest
    for _ in range(PUSH_MOST):
        goal = np.where(held, rest, at + offset + model.residual(at + offset, beta)[0])
        if np.abs(goal - at).max() < 1e-8:
            break
        at = goal
    return goal, rest[middle]


# Figures -------------------------------------------------------------------------------------------------------------


def draw_beta() -> bytes:
    """Figure 3.5: (a) to (c) with rising beta, (d) where the body may deform quadratically."""
    linear, quadratic = (column(basis).sweep(BETAS) for basis in ("linear", "quadratic"))
    shown = [(f"({name}) linear, beta = {beta:g}", linear, beta) for name, beta in zip("abc", SHEARED, strict=True)]
    shown.append((f"(d) quadratic, beta = {SHEARED[-1]:g}", quadratic, SHEARED[-1]))
    drawn = canvas(13.0, 4.6, layout="constrained")
    panels = drawn.subplots(1, len(shown), sharey=True)
    for panel, (title, sweep, beta) in zip(panels, shown, strict=True):
        _draw(panel, sweep, _at(sweep, beta), title)
        panel.set_xlim(-0.5, 11.5)
    panels[0].legend(fontsize=7, loc="lower right")
    return png_of(drawn, DPI)


def draw_theta() -> bytes:
    """Figure 3.7: (a) at rest, (b) to (d) pressed from above with falling theta."""
    sweep = cube().sweep(0.01 * np.arange(101))
    drawn = canvas(15.0, 4.2, layout="constrained")
    panels = drawn.subplots(1, 1 + len(THETAS), sharex=True, sharey=True)
    _draw(panels[0], sweep, sweep.rest, "(a) at rest")
    for panel, name, theta in zip(panels[1:], "bcd", THETAS, strict=True):
        volume = float(np.interp(theta, sweep.value, sweep.measure))
        _draw(panel, sweep, _at(sweep, theta), f"({name}) theta = {theta:g}: {volume:.0f} % of the volume")
    panels[0].set(xlim=(-1.5, 11.5))
    panels[1].legend(fontsize=7, loc="upper right")
    drawn.suptitle(f"one quadratic cluster, beta = {CUBE_BETA:g}", fontsize=9)
    return png_of(drawn, DPI)


def draw_push() -> bytes:
    """Figure 3.13: (a) the particle that is manipulated, (b) held elsewhere, (c) the same push at two betas."""
    body = sheet()
    sweep = body.sweep(BETAS)
    drawn = canvas(14.0, 4.0, layout="constrained")
    panels = drawn.subplots(1, 3, sharey=True)
    _draw(panels[0], sweep, sweep.rest, "(a) the particle h_i")
    _draw(panels[1], sweep, _at(sweep, 0.7), "(b) held at x_hi, beta = 0.7")
    for panel, position, name in ((panels[0], body.seen.rest, "h_i"), (panels[1], body.seen.deformed, "x_hi")):
        at = tuple(100.0 * position[7 * 7 + 6])
        panel.annotate(name, at, (0, 18), textcoords="offset points", arrowprops={"arrowstyle": "->"}, ha="center")
    for beta, mark, colour in zip(PUSHED, "o*", COLOURS, strict=False):
        position, middle = pushed(body, beta)
        panels[2].plot(*100.0 * position.T, mark, color=colour, ms=5, label=f"beta = {beta:g}")
        for x, y in 100.0 * middle:
            panels[2].annotate("", (x, y + 0.3), (x, y + 1.5), arrowprops={"arrowstyle": "->"})
    _finish(panels[2], "(c) the same force down on three particles")
    panels[2].set_ylim(-0.5, 9.5)
    for panel, size in ((panels[0], 7), (panels[2], 8)):
        panel.legend(fontsize=size, loc="upper right")
    return png_of(drawn, DPI)


def draw_mesh(pressed: Cube) -> bytes:
    """Figure 3.8: the hexahedra of the finite elements at rest and pressed."""
    shape = pressed.seen.shape
    assert shape is not None
    drawn = canvas(9.6, 4.6, layout="constrained")
    edge = [np.isin(index, (0, size - 1)) for index, size in zip(np.indices(shape), shape, strict=True)]
    poses = (pressed.seen.rest, "at rest"), (pressed.seen.deformed, f"pressed by {100.0 * pressed.depth:g} cm")
    for number, (points, title) in enumerate(poses, start=1):
        axes: Any = drawn.add_subplot(1, 2, number, projection="3d")
        grid = 100.0 * points.reshape(*shape, 3)
        for axis in range(3):  # lines along each axis on the outside
            lines = np.moveaxis(grid, axis, -2)
            rows, columns = lines.shape[:2]
            for row, place in np.ndindex(rows, columns):
                if row in (0, rows - 1) or place in (0, columns - 1):
                    axes.plot(*lines[row, place].T, color="0.45", lw=0.7)
        axes.scatter(*grid[np.logical_or.reduce(edge)].T, s=7, color=COLOURS[0], label="nodes, which are the particles")
        axes.set(xlabel="x [cm]", ylabel="y [cm]", zlabel="z [cm]", xlim=(-2, 12), ylim=(-2, 12), zlim=(0, 10))
        axes.set_title(f"{title}, Poisson's ratio {pressed.poisson:g}")
        axes.set_box_aspect((14, 14, 10))
        axes.view_init(elev=18.0, azim=-60.0)
    drawn.axes[0].legend(fontsize=7, loc="upper left")
    return png_of(drawn, DPI)


def _at(sweep: StateSweep, value: float) -> FloatArray:
    """(rows, columns, 2) at the swept value nearest to it."""
    return np.asarray(sweep.position[int(np.abs(sweep.value - value).argmin())])


def _draw(panel: Any, sweep: StateSweep, position: FloatArray, title: str) -> None:
    """The lattice's net at rest and where it is, and the particles. position: (rows, columns, 2)"""
    for grid, colour, width in ((sweep.rest, "0.75", 0.6), (position, COLOURS[0], 0.8)):
        for line in (*grid, *grid.swapaxes(0, 1)):
            panel.plot(*100.0 * line.T, color=colour, lw=width)
    panel.plot([], [], color="0.75", label="at rest")
    panel.plot(*100.0 * position[~sweep.held].T, "o", color=COLOURS[0], ms=3.5, label="simulated")
    panel.plot(*100.0 * position[sweep.held].T, "s", color=COLOURS[1], ms=4, label="held")
    _finish(panel, title)


def _finish(panel: Any, title: str) -> None:
    panel.set(title=title, xlabel="x [cm]", ylabel="height [cm]", aspect="equal")
    panel.title.set_fontsize(9)
    panel.grid(alpha=0.25)


def trials(options: FiguresConfig) -> list[Trials[int, tuple[SearchOutcome, ...]]]:
    return [Trials("searches", search_known, [options.output.seed])]


STUDY = Study(FiguresConfig, trials, report)
