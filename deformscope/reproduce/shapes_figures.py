"""Figures 3.5, 3.7, 3.8 and 3.13 of the thesis, from our own bodies; lengths in centimetres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.pictures.figures import COLOURS, canvas, figure
from deformscope.reproduce.cubes import Cube
from deformscope.reproduce.shapes import CUBE_BETA, middle_of, pushed
from deformscope.stages.msm.state_sweep import PressedLattice, StateSweep

REST_COLOUR = "0.75"
ROUND, STAR = COLOURS[0], COLOURS[1]
BETAS, THETAS = (0.0, 0.9, 0.99), (0.99, 0.3, 0.0)
"""Of figure 3.5 (a) to (c), whose values the thesis does not print, and of figure 3.7 (b) to (d)."""
PUSHED_BETAS = (0.1, 0.9)


def draw_beta(path: Path, linear: StateSweep, quadratic: StateSweep) -> None:
    """Figure 3.5: a body whose ends are held, (a) to (c) with rising beta, (d) where it may deform quadratically."""
    shown = [(f"({name}) linear, beta = {beta:g}", linear, beta) for name, beta in zip("abc", BETAS, strict=True)]
    shown.append((f"(d) quadratic, beta = {BETAS[-1]:g}", quadratic, BETAS[-1]))
    with figure(path, len(shown), share_y=True) as axes:
        for panel, (title, sweep, beta) in zip(axes[0], shown, strict=True):
            _draw(panel, sweep.lattice, sweep.at(beta))
            _finish(panel, title)
            panel.set_xlim(-0.5, 11.5)
        axes[0, 0].legend(fontsize=7, loc="lower right")


def draw_theta(path: Path, sweep: StateSweep) -> None:
    """Figure 3.7: the middle layer of a cube, (a) at rest, (b) to (d) pressed from above with falling theta."""
    with figure(path, 1 + len(THETAS), share_y=True) as axes:
        _draw(axes[0, 0], sweep.lattice, sweep.lattice.rest)
        _finish(axes[0, 0], "(a) at rest")
        for panel, name, theta in zip(axes[0, 1:], "bcd", THETAS, strict=True):
            _draw(panel, sweep.lattice, sweep.at(theta))
            volume = 1e2 * float(sweep.size[int(np.abs(sweep.value - theta).argmin())])
            _finish(panel, f"({name}) theta = {theta:g}: {volume:.0f} % of the volume")
        axes[0, 1].legend(fontsize=7, loc="upper right")
        axes[0, 0].figure.suptitle(f"one quadratic cluster, beta = {CUBE_BETA:g}", fontsize=9)


def draw_push(path: Path, sweep: StateSweep) -> None:
    """Figure 3.13: (a) the particle that is manipulated, (b) held elsewhere, (c) the same push at two betas."""
    lattice = sweep.lattice
    place = int(np.argmax(np.linalg.norm(lattice.target - lattice.rest[lattice.held], axis=1)))
    with figure(path, 3, share_y=True) as axes:
        for panel, position, name in ((axes[0, 0], lattice.rest, "h_i"), (axes[0, 1], sweep.at(0.7), "x_hi")):
            _draw(panel, lattice, position)
            at = 100.0 * position[lattice.held[place]]
            panel.annotate(name, at, (0, 16), textcoords="offset points", arrowprops={"arrowstyle": "->"}, ha="center")
        _finish(axes[0, 0], "(a) the particle h_i")
        _finish(axes[0, 1], "(b) held at x_hi, beta = 0.7")
        panel = axes[0, 2]
        for beta, mark, colour in zip(PUSHED_BETAS, "o*", (ROUND, STAR), strict=True):
            panel.plot(*100.0 * pushed(lattice, beta).T, mark, color=colour, ms=5, label=f"beta = {beta:g}")
        for x, y in 100.0 * lattice.rest[middle_of(lattice)]:
            panel.annotate("", (x, y + 0.3), (x, y + 1.5), arrowprops={"arrowstyle": "->", "color": "k"})
        _finish(panel, "(c) the same force down on three particles")
        panel.set_ylim(-0.5, 9.5)
        panel.legend(fontsize=8, loc="upper right")
        axes[0, 0].legend(fontsize=7, loc="upper right")


def draw_mesh(path: Path, cube: Cube) -> None:
    """Figure 3.8: the hexahedra of the finite elements, whose corners the particles are, at rest and pressed."""
    shape = cube.seen.shape
    assert shape is not None
    drawn = canvas(9.6, 4.6, layout="constrained")
    for number, (points, title) in enumerate(
        ((cube.seen.rest, "at rest"), (cube.seen.deformed, f"pressed by {100.0 * cube.depth:g} cm")), start=1
    ):
        axes: Any = drawn.add_subplot(1, 2, number, projection="3d")
        grid = 100.0 * points.reshape(*shape, 3)
        for axis in range(3):  # lines along each axis on the faces that are seen
            lines = np.moveaxis(grid, axis, -2)
            rows, columns = lines.shape[:2]
            for row, column in np.ndindex(rows, columns):
                if row in (0, rows - 1) or column in (0, columns - 1):
                    axes.plot(*lines[row, column].T, color="0.45", lw=0.7)
        edge = [np.isin(index, (0, size - 1)) for index, size in zip(np.indices(shape), shape, strict=True)]
        axes.scatter(*grid[np.logical_or.reduce(edge)].T, s=7, color=COLOURS[0], label="nodes, which are the particles")
        axes.set(xlabel="x [cm]", ylabel="y [cm]", zlabel="z [cm]", xlim=(-2, 12), ylim=(-2, 12), zlim=(0, 10))
        axes.set_title(f"{title}, Poisson's ratio {cube.poisson:g}")
        axes.set_box_aspect((14, 14, 10))
        axes.view_init(elev=18.0, azim=-60.0)
        axes.legend(fontsize=7, loc="upper left") if number == 1 else None
    drawn.savefig(path, dpi=140)


def _draw(panel: Any, lattice: PressedLattice, position: FloatArray) -> None:
    """The lattice's net at rest and where it is, and the particles."""
    rest, seen = 100.0 * lattice.seen(lattice.rest), 100.0 * lattice.seen(position)
    held = np.isin(lattice.shown, lattice.held)
    for grid, colour, width in ((rest, REST_COLOUR, 0.6), (seen, ROUND, 0.8)):
        for line in (*grid, *grid.swapaxes(0, 1)):
            panel.plot(*line.T, color=colour, lw=width)
    panel.plot([], [], color=REST_COLOUR, label="at rest")
    panel.plot(*seen[~held].T, "o", color=ROUND, ms=3.5, label="simulated")
    panel.plot(*seen[held].T, "s", color=STAR, ms=4, label="held")


def _finish(panel: Any, title: str) -> None:
    panel.set(title=title, xlabel="x [cm]", ylabel="height [cm]", aspect="equal")
    panel.title.set_fontsize(9)
