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
STEP_S, DEPTH, RADIUS, STIFF = 0.005, 0.002, 1e-4, 2000.0
SHARE, TIME_S, RAMP_S, HELD_S = 0.3, 1.0, 0.5, 3.0
"""Share of a foam's modulus that relaxes and its time, as in the laboratory; how long a press and its hold last."""
DAMPINGS = (0.0, 0.02, 0.05, 0.1, 0.2)
"""4 `k_damp` over Young's modulus [s]: at a Poisson's ratio of 0 the time by which strain lags."""
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


def grid(poisson: float = 0.0, damping_s: float = 0.0) -> Any:
    """A cube of a soft grid."""
    builder = newton.ModelBuilder()
    cell, placed = SIDE / CELLS, {"pos": wp.vec3(), "rot": wp.quat_identity(), "vel": wp.vec3(), "fix_bottom": False}
    dims = {f"dim_{axis}": CELLS for axis in "xyz"} | {f"cell_{axis}": cell for axis in "xyz"}
    mu = 0.5 * YOUNG / (1.0 + poisson)
    law = {"k_mu": mu, "k_lambda": 2.0 * mu * poisson / (1.0 - 2.0 * poisson), "k_damp": 0.25 * damping_s * YOUNG}
    builder.add_soft_grid(**placed, **dims, density=DENSITY, **law)
    return builder


def finished(builder: Any) -> Any:
    """Its model, glued below."""
    for number, (_, _, height) in enumerate(builder.particle_q):
        if height < 1e-6:
            builder.particle_mass[number] = 0.0
    builder.color()
    return builder.finalize()


def masses() -> Row:
    share = sum(grid().particle_mass) / (DENSITY * SIDE**3)
    return ("mass of `add_soft_grid`", "its density times its volume", f"{share:.2f} of that")


def at_rest(timestep_s: float, iterations: int) -> tuple[float, bool]:
    """How far VBD lets the cube's upper face sink under its weight [m], and whether a cell is inside out."""
    builder = grid()
    heights, model = np.array([one[2] for one in builder.particle_q]), finished(builder)
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


def press(damping_s: float, contact: float, poisson: float) -> tuple[np.ndarray, float]:
    """Force along z [N] of a plate on the cube after each step, and how far the plate is inside at last [m]."""
    builder, half = grid(poisson, damping_s), 0.01
    builder.particle_radius = [RADIUS] * builder.particle_count
    shape = newton.ModelBuilder.ShapeConfig(ke=contact, kd=0.0, mu=0.0)
    pose = wp.transform((0.5 * SIDE, 0.5 * SIDE, 1.0), wp.quat_identity())
    builder.add_shape_box(-1, xform=pose, hx=SIDE, hy=SIDE, hz=half, cfg=shape)
    builder.gravity = (0.0, 0.0, 0.0)
    model = finished(builder)
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = contact, 0.0, 0.0
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=0.005)
    contacts, solver = pipeline.contacts(), newton.solvers.SolverVBD(model, iterations=20)
    seen = solver.observables(["contact_f"], contacts=contacts)
    now, after, control, forces = model.state(), model.state(), model.control(), []
    place = model.shape_transform.numpy()
    ramp = round(RAMP_S / STEP_S)
    for step in range(ramp + round(HELD_S / STEP_S)):
        place[0, 2] = SIDE + half + RADIUS - DEPTH * min(1.0, step / ramp)
        model.shape_transform.assign(place)
        pipeline.collide(now, contacts)
        solver.step(now, after, control, contacts, STEP_S, observables=seen)
        now, after = after, now
        forces.append(float(seen.contact_f.numpy()[:, 2].sum()))
    return np.array(forces), float(now.particle_q.numpy()[:, 2].max() - place[0, 2] + half + RADIUS)


def relaxation() -> Iterator[Row]:
    ramp, held = round(RAMP_S / STEP_S), round(HELD_S / STEP_S)
    time = STEP_S * np.arange(ramp + held)
    pressed = np.minimum(time, RAMP_S)
    late = TIME_S * (1.0 - np.exp(-pressed / TIME_S)) * np.exp(-(time - pressed) / TIME_S)
    foam, later = (1.0 - SHARE) * pressed + SHARE * late, ramp + round(0.1 / STEP_S)  # standard linear solid

    def off(force: np.ndarray) -> float:
        """rms error with the best modulus, as a share of the peak."""
        return float(np.sqrt(np.mean((force * (force @ foam) / (force @ force) - foam) ** 2)) / foam.max())

    forces = {one: press(one, STIFF, 0.3)[0] for one in DAMPINGS}
    best = min(DAMPINGS, key=lambda one: off(forces[one]))
    yield (
        f"a foam of whose modulus {SHARE:g} relaxes in {TIME_S:g} s, pressed for {RAMP_S:g} s and held in that place",
        "the right `k_damp` repeats its force",
        f"off by {off(forces[best]):.1%} of the peak, rms, with the best of {len(DAMPINGS)} ({best:g} s), "
        f"{off(forces[0.0]):.1%} without; 0.1 s after the stop {forces[best][later] / forces[best][-1]:.2f} of the "
        f"last force, the foam's {foam[later] / foam[-1]:.2f}",
    )
    column = YOUNG * SIDE  # a spring and a damper, in series with a soft contact: the relaxing solid itself
    contact = column * SHARE / (1.0 - SHARE)
    soft, inside = press(TIME_S / (1.0 - SHARE), contact / (CELLS + 1) ** 2, 0.0)
    yield (
        "the same with a contact so soft that it takes part",
        "the dent stays",
        f"off by {off(soft):.1%}; the plate ends {inside / DEPTH:.2f} of the depth inside the body",
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
    print(json.dumps([masses(), *gravity(), *relaxation(), *files()]))


if __name__ == "__main__":
    main()
