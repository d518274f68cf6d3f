"""What one would not guess of Newton's soft bodies, seen in Newton: needs newton, its importer of USD and numpy alone.

python studies/newton_surprises.py        a JSON list of [what, guess, seen]
"""

import json
import logging
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import newton
import numpy as np
import warp as wp

SIDE, CELLS, YOUNG, DENSITY = 0.04, 4, 5e4, 100.0
Row = tuple[str, str, str]
TETRAHEDRON = """#usda 1.0
(
    metersPerUnit = {unit}
    upAxis = "Z"
)
def TetMesh "Body" (prepend apiSchemas = ["PhysicsVolumeDeformableSimAPI"])
{{
    point3f[] points = [(0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10)]
    int4[] tetVertexIndices = [(0, 1, 2, 3)]
}}
"""
FLEX = """<mujoco><worldbody>
<flexcomp name="f" type="grid" dim="3" count="3 3 3" spacing=".1 .1 .1" mass="1" radius=".01">
<elasticity young="5e4" poisson="0"/></flexcomp></worldbody></mujoco>"""


def grid() -> Any:
    """A cube of a soft grid, glued below, Poisson's ratio 0."""
    builder = newton.ModelBuilder()
    cell, placed = SIDE / CELLS, {"pos": wp.vec3(), "rot": wp.quat_identity(), "vel": wp.vec3(), "fix_bottom": False}
    dims = {f"dim_{axis}": CELLS for axis in "xyz"} | {f"cell_{axis}": cell for axis in "xyz"}
    builder.add_soft_grid(**placed, **dims, density=DENSITY, k_mu=0.5 * YOUNG, k_lambda=0.0, k_damp=0.0)
    return builder


def masses() -> Row:
    share = sum(grid().particle_mass) / (DENSITY * SIDE**3)
    return ("mass of `add_soft_grid`", "its density times its volume", f"{share:.2f} of that")


def at_rest(timestep_s: float, iterations: int) -> tuple[float, bool]:
    """How far VBD lets the cube's upper face sink under its weight [m], and whether a cell is inside out."""
    builder = grid()
    heights = np.array([one[2] for one in builder.particle_q])
    for number in np.flatnonzero(heights < 1e-6):
        builder.particle_mass[number] = 0.0
    builder.color()
    model = builder.finalize()
    solver = newton.solvers.SolverVBD(model, iterations=iterations)
    now, after, control = model.state(), model.state(), model.control()
    for _ in range(60):
        solver.step(now, after, control, None, timestep_s)
        now, after = after, now
    place = now.particle_q.numpy()
    cells = place[model.tet_indices.numpy()]
    inside_out = bool((np.linalg.det(cells[:, 1:] - cells[:, :1]) <= 0.0).any())
    return float((heights - place[:, 2])[heights > SIDE - 1e-6].mean()), inside_out


def gravity() -> Iterator[Row]:
    shown = [f"{1e6 * at_rest(step, 10)[0]:.0f} um at {1e3 * step:g} ms" for step in (0.01, 0.005, 0.001)]
    guess = f"{1e6 * 2.0 * DENSITY * 9.81 * SIDE**2 / (2.0 * YOUNG):.0f} um, with any time step"
    yield ("how far a cube sinks under VBD, at rest, with 10 iterations a step", guess, ", ".join(shown))
    turned = at_rest(0.1, 10)[1]
    yield (
        "the same with steps of 100 ms, which gravity makes longer than the cube",
        "an error, or a cube",
        "cells stay inside out, no message" if turned else "a cube",
    )


def files() -> Iterator[Row]:
    warnings.simplefilter("ignore")
    logging.disable()
    with tempfile.TemporaryDirectory() as folder:
        bodies = []
        for unit in (1.0, 0.01):
            path = Path(folder) / f"{unit}.usda"
            path.write_text(TETRAHEDRON.format(unit=unit), encoding="utf-8")
            builder = newton.ModelBuilder()
            builder.add_usd(str(path))
            bodies.append(builder)
        metres, centimetres = (max(one[2] for one in body.particle_q) for body in bodies)
        mjcf = Path(folder) / "flex.xml"
        mjcf.write_text(FLEX, encoding="utf-8")
        builder = newton.ModelBuilder()
        builder.add_mjcf(str(mjcf))
    yield (
        "a body 10 units high, in a USD stage of centimetres",
        f"a hundredth of its {metres:g} m in a stage of metres",
        f"{centimetres:g} m",
    )
    yield ("radius of its particles", "small next to its cells", f"{bodies[0].particle_radius[0]:g} m")
    yield ("particles of an MJCF's `flexcomp` of 27 points", "27", f"{builder.particle_count}, no message")


def main() -> None:
    print(json.dumps([masses(), *gravity(), *files()]))


if __name__ == "__main__":
    main()
