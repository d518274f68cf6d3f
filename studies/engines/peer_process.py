"""The other engines, each in a process of its own: `python -m studies.engines.peer_process ENGINE SIDE DEVICE`.

A child process, because pypbd is one global simulation and takes its number of threads from the environment, and
because these libraries print, change warp's settings and may crash. Lines on stdout: one JSON object about the body
that was built. Then, for every number of steps on stdin, the seconds of wall clock and of processor time.

Every body is a lattice of SIDE^3 particles whose bottom layer is held."""

import json
import os
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.bench.bodies import cube

Start = Callable[[], None]
"""A function that brings the body to the start of a run; its time is not measured."""
Step = Callable[[int], None]
Built = tuple[dict[str, object], Start, Step, Callable[[], FloatArray]]
"""Facts, the function for the start, that for steps, and that for the particles' positions (K, 3) [spacings]."""

CELL_M = 1.0
"""pypbd has absolute epsilons that drop constraints of small bodies: a metre between particles is its best case."""


def pypbd(side: int) -> Built:
    """Shape matching constraints on the same clusters, one iteration a step, with both plates held as in
    deformscope."""
    import pypbd as pbd

    body = cube(side)
    simulation = pbd.Simulation.getCurrent()
    simulation.initDefault()
    model = simulation.getModel()
    model.init()
    particles = model.getParticles()
    for point in body.rest * CELL_M:
        particles.addVertex(point)
    free = np.ones(len(body.rest))
    free[body.held] = 0.0
    for particle, mass in enumerate(free):
        particles.setMass(particle, mass)  # 0: held. Before the constraints, which copy it
    clusters = body.clusters(3)
    count = clusters.cluster_counts()
    for members in clusters:
        model.addShapeMatchingConstraint(len(members), members.tolist(), count[members].tolist(), 1.0)

    stepper, controller = simulation.getTimeStep(), pbd.TimeStepController
    stepper.setValueUInt(controller.NUM_SUB_STEPS, 1)
    stepper.setValueUInt(controller.MAX_ITERATIONS, 1)
    stepper.setValueUInt(controller.MAX_ITERATIONS_V, 0)
    # Gravity cannot be turned off from Python. It moves a particle by g dt^2, which such a step makes nothing; without
    # other forces the step changes nothing else.
    pbd.TimeManager.getCurrent().setTimeStepSize(1e-6)

    def start() -> None:
        simulation.reset()
        for particle, point in zip(body.held, body.held_position * CELL_M, strict=True):
            particles.setPosition(int(particle), point)

    def step(steps: int) -> None:
        for _ in range(steps):
            stepper.step(model)

    def position() -> FloatArray:
        return np.array([particles.getPosition(i) for i in range(len(body.rest))]) / CELL_M

    simulation.reset()  # as before every run
    kept = len(model.getConstraints())
    facts: dict[str, object] = {"clusters": clusters.count, "constraints_kept": kept, "precision": "float64"}
    return facts, start, step, position


def mujoco(side: int) -> Built:
    """A flex of tetrahedra with linear elasticity, explicit, without contacts; its top starts pressed."""
    import mujoco as mj

    spacing_m = 0.1
    model: Any = mj.MjModel.from_xml_string(
        f"""<mujoco>
          <option timestep="0.001" solver="CG" tolerance="1e-6" gravity="0 0 0"><flag contact="disable"/></option>
          <size memory="1G"/>
          <worldbody>
            <flexcomp name="body" type="grid" dim="3" count="{side} {side} {side}"
                      spacing="{spacing_m} {spacing_m} {spacing_m}" radius=".005" mass="{side**3}">
              <elasticity young="5e4" poisson="0.3"/>
              <contact selfcollide="none"/>
              <pin gridrange="0 0 0 0 {side - 1} {side - 1}"/>
            </flexcomp>
          </worldbody>
        </mujoco>"""
    )
    data: Any = mj.MjData(model)

    def start() -> None:
        mj.mj_resetData(model, data)
        data.qpos[-3 * side * side :: 3] = -0.1 * (side - 1) * spacing_m
        mj.mj_forward(model, data)

    def step(steps: int) -> None:
        for _ in range(steps):
            mj.mj_step(model, data)

    def position() -> FloatArray:
        return np.array(data.flexvert_xpos).reshape(-1, 3) / spacing_m

    return {"degrees_of_freedom": int(model.nv)}, start, step, position


def newton(side: int, solver_name: str = "SolverXPBD", device: str = "cpu") -> Built:
    """A soft grid of tetrahedra under XPBD or VBD, one iteration a step, captured as a graph, as in deformscope; its
    top starts pressed."""
    import newton as nt
    import warp as wp

    spacing_m, dt = 0.1, 1e-3
    builder = nt.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_soft_grid(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        vel=wp.vec3(0.0, 0.0, 0.0),
        dim_x=side - 1,
        dim_y=side - 1,
        dim_z=side - 1,
        cell_x=spacing_m,
        cell_y=spacing_m,
        cell_z=spacing_m,
        density=1e3,
        k_mu=2e4,
        k_lambda=2e4,
        k_damp=0.0,
        fix_bottom=True,
        add_surface_mesh_edges=False,
        particle_radius=0.1 * spacing_m,  # its default pushes these particles apart
    )
    if solver_name == "SolverVBD":
        builder.color()
    model: Any = builder.finalize(device=device)
    solver = getattr(nt.solvers, solver_name)(model, iterations=1)
    state, other, control = model.state(), model.state(), model.control()
    rest = state.particle_q.numpy()
    pressed = rest.copy()
    pressed[rest[:, 1] > (side - 1.5) * spacing_m, 1] -= 0.1 * (side - 1) * spacing_m

    def two() -> None:
        for before, after in ((state, other), (other, state)):
            before.clear_forces()
            solver.step(before, after, control, None, dt)

    two()
    with wp.ScopedCapture(device=device) as capture:
        two()

    def start() -> None:
        state.particle_q.assign(pressed)
        state.particle_qd.zero_()

    def step(steps: int) -> None:
        for _ in range(-(-steps // 2)):
            wp.capture_launch(capture.graph)
        wp.synchronize_device(device)

    def position() -> FloatArray:
        return np.asarray(state.particle_q.numpy(), dtype=np.float64) / spacing_m

    return {"tetrahedra": int(model.tet_count), "steps_in_twos": True}, start, step, position


ENGINES: dict[str, Callable[[int, str], Built]] = {
    "pypbd": lambda side, _device: pypbd(side),
    "mujoco": lambda side, _device: mujoco(side),
    "newton": lambda side, device: newton(side, "SolverXPBD", device),
    "newton VBD": lambda side, device: newton(side, "SolverVBD", device),
}


def main(engine: str, side: int, device: str) -> None:
    """Build, report, and step on request. device: "cpu" or "cuda:0", for newton."""
    lines = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever the engine prints
    facts, start, step, position = ENGINES[engine](side, device)
    start()
    before = position()
    step(2)
    moved = float(np.sqrt(np.mean((position() - before) ** 2)))
    print(
        json.dumps({"version": version(engine.split()[0]), "moved_spacings_rms": moved, **facts}),
        file=lines,
        flush=True,
    )
    for line in sys.stdin:
        start()
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        step(int(line))
        wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
        print(f"{wall_s} {cpu_s}", file=lines, flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
