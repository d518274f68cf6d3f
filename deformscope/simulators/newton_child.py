"""Presses a slab in Newton: a process of its own, which needs newton and its importer of USD alone.

    python newton_child.py < requests > replies        one JSON object a line

    {"do": "version"}  ->  {"version": "1.8.0"}
    {"do": "press", "asset": "slab.usda", "parameters": {"young": [...], "poisson", "contact"}, "timestep_s", "pokes"}
      ->  a line for each poke, with "how": {"steps", "iterations", "residual"}

Otherwise as `mujoco_child.py`. The body is the USD's, read by Newton's own importer, with its lowest vertices held; the
solver is VBD. A tip is a static shape that is set deeper; `contact` is the stiffness of a vertex against it [N/m]; the
force is the solver's own sum of these contacts. A step begins at `gravity * timestep^2` below the last one, and what
its iterations do not take back remains, so that iterations are doubled until the force stays."""

import json
import os
import sys
import time
from collections.abc import Iterator
from typing import Any

RADIUS_M = 1e-4
"""Radius of a particle; Newton's default is .1 m."""
GAP_M = 0.005
"""Contacts are looked for this far from the tip."""
ITERATIONS, MOST = 20, 320
"""Iterations of the first steps, and the most."""
RAMP, WINDOW, LONGEST = 10, 5, 200
"""Steps in which the tip goes from one depth to the next: a vertex that is far inside it is pushed out sideways; steps
over which the force must stay; most steps at a depth."""
STILL, RESIDUAL = 5e-4, 2e-3
"""Relative change of the force in a window, and with twice the iterations, below which it stays."""
STILL_M = 1e-6
"""Largest motion in a window of what is still."""
STICKS, CREEP_M_S = 10.0, 1e-3
"""Friction of a tip that sticks, and the speed up to which it is only proportional to the speed: at rest it is 0, but
single precision loses what is slower than 1e-5."""
FARTHEST = 5.0
"""A vertex that moves this many depths is thrown out."""


def cells_of_materials(asset: str) -> list[Any]:
    """The cells of each material, by the USD's subsets; Newton's importer does not read them."""
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(asset)
    subsets = [UsdGeom.Subset(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Subset)]
    return [list(one.GetIndicesAttr().Get()) for one in subsets]


class PressedSlab:
    """The slab with its parameters, and one tip above it."""

    def __init__(self, asked: dict[str, Any], poke: dict[str, Any]) -> None:
        import newton
        import numpy as np
        import warp as wp

        given, half = asked["parameters"], [0.5 * one for one in poke["size_m"]]
        poisson = given["poisson"]
        lame = poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
        builder = newton.ModelBuilder()
        builder.default_particle_radius = RADIUS_M
        builder.add_usd(asked["asset"])
        young = np.full(builder.tet_count, given["young"][0])
        for one, cells in zip(given["young"], cells_of_materials(asked["asset"]), strict=False):
            young[cells] = one
        builder.tet_materials = [(one / (2.0 + 2.0 * poisson), one * lame, 0.0) for one in young.tolist()]
        self.first = np.array([list(one) for one in builder.particle_q])
        for one in np.flatnonzero(self.first[:, 2] <= self.first[:, 2].min() + RADIUS_M):
            builder.particle_mass[one] = 0.0  # glued to the ground
        mu = 0.0 if poke["slips"] else STICKS
        shape = newton.ModelBuilder.ShapeConfig(ke=given["contact"], kd=0.0, mu=mu)
        pose = wp.transform((*poke["at_m"], 1.0), wp.quat_identity())
        if poke["tip"] == "sphere":
            builder.add_shape_sphere(-1, xform=pose, radius=half[0], cfg=shape)
        elif poke["tip"] == "disc":
            builder.add_shape_cylinder(-1, xform=pose, radius=half[0], half_height=half[0], cfg=shape)
        else:
            builder.add_shape_box(-1, xform=pose, hx=half[0], hy=half[-1], hz=half[0], cfg=shape)
        builder.color()
        self.model = newton_model = builder.finalize()
        newton_model.soft_contact_ke, newton_model.soft_contact_kd = given["contact"], 0.0
        newton_model.soft_contact_mu = mu
        self._pipeline = newton.CollisionPipeline(newton_model, soft_contact_gap=GAP_M)
        self._contacts = self._pipeline.contacts()
        self.solver = newton.solvers.SolverVBD(newton_model, iterations=ITERATIONS, friction_epsilon=CREEP_M_S)
        self._seen = self.solver.observables(["contact_f"], contacts=self._contacts)
        self._now, self._next, self._control = newton_model.state(), newton_model.state(), newton_model.control()
        self._cells = newton_model.tet_indices.numpy()
        self._timestep_s, self.steps = asked["timestep_s"], 0
        aside = np.linalg.norm(self.first[:, :2] - poke["at_m"], axis=1)
        self._below = np.flatnonzero(aside <= aside.min() + 1e-6)
        self.above = half[0] + RADIUS_M

    def place(self) -> Any:
        """(n, 3) the vertices [m]."""
        return self._now.particle_q.numpy().copy()  # else it changes with the next step

    def put(self, place: Any) -> None:
        """Set the vertices to these places [m], at rest."""
        self._now.particle_q.assign(place.astype("float32"))
        self._now.particle_qd.zero_()

    def top(self) -> float:
        """Height of the surface below the tip's axis [m]."""
        return float(self.place()[self._below, 2].max())

    def step(self, height: float) -> float:
        """Force along z [N] after a step with the tip's middle at this height."""
        poses = self.model.shape_transform.numpy()
        poses[0, 2] = height
        self.model.shape_transform.assign(poses)
        self._pipeline.collide(self._now, self._contacts)
        step = (self._now, self._next, self._control, self._contacts, self._timestep_s)
        self.solver.step(*step, observables=self._seen)
        self._now, self._next = self._next, self._now
        self.steps += 1
        return float(self._seen.contact_f.numpy()[:, 2].sum())

    def settle(self, start: float, height: float) -> tuple[float, float]:
        """Force along z [N] and penetration [m] where the tip's middle went from one height to another, and stays."""
        import numpy as np

        for number in range(1, RAMP if start != height else 0):
            self.step(start + (height - start) * number / RAMP)
        force, place = self.step(height), self.place()
        for _ in range(LONGEST // WINDOW):
            before, last = force, place
            for _ in range(WINDOW):
                force = self.step(height)
            place = self.place()
            edges = place[self._cells[:, 1:]] - place[self._cells[:, :1]]
            if not np.isfinite(place).all() or np.linalg.det(edges).min() <= 0.0:
                raise ArithmeticError(f"cells turn inside out with steps of {self._timestep_s:g} s")
            if abs(force - before) <= STILL * force and np.abs(place - last).max() <= STILL_M:
                break
        count = int(self._contacts.soft_contact_count.numpy()[0])
        who = self._contacts.soft_contact_indices.numpy()[:count, 0]
        apart = self.place()[who] - self._contacts.soft_contact_body_pos.numpy()[:count]
        distance = np.sum(apart * self._contacts.soft_contact_normal.numpy()[:count], axis=1)
        return force, max(0.0, RADIUS_M - float(distance.min(initial=RADIUS_M)))


def press(asked: dict[str, Any], known: dict[str, Any] = {}) -> Iterator[dict[str, Any]]:  # noqa: B006  # kept on purpose
    """Replies to a request to press, poke by poke. known: iterations, and places at rest and at each depth, of a poke
    when it was pressed before: with other parameters, the slab begins there."""
    import numpy as np

    for poke in asked["pokes"]:
        slab, name = PressedSlab(asked, poke), json.dumps([asked["asset"], asked["timestep_s"], poke])
        away = slab.first[:, 2].max() + 2.0 * slab.above + GAP_M
        slab.solver.iterations, places = known.get(name, (ITERATIONS, []))
        while True:
            if places:
                slab.put(places[0])
            slab.settle(away, away)  # under its own weight
            rest, touching = slab.place(), slab.top() + slab.above
            began, slab.steps, found, pressed = time.perf_counter(), 0, [], [rest]
            for number, depth in enumerate(poke["depth_m"], start=1):
                start = touching - (poke["depth_m"][number - 2] if number > 1 else 0.0)
                if places:
                    slab.put(rest + places[number] - places[0])
                    start = touching - depth
                found.append(slab.settle(start, touching - depth))
                pressed.append(slab.place())
            moved, places, iterations = pressed[-1] - rest, pressed, slab.solver.iterations
            seconds, steps = time.perf_counter() - began, slab.steps
            slab.solver.iterations *= 2
            more = slab.settle(touching - depth, touching - depth)
            residual = abs(more[0] / found[-1][0] - 1.0)
            if residual <= RESIDUAL or slab.solver.iterations > MOST:
                break
        known[name] = iterations, places
        if np.abs(moved).max() > FARTHEST * poke["depth_m"][-1]:
            raise ArithmeticError(f"the slab bursts with steps of {asked['timestep_s']:g} s")
        yield {
            "force_n": [one[0] for one in found],
            "penetration_m": [one[1] for one in found],
            "rest_m": rest.tolist(),
            "moved_m": moved.tolist(),
            "step_s": seconds / steps,
            "how": {"steps": steps, "iterations": iterations, "residual": residual},
        }


def version(asked: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The target's version; its importer of USD is needed, too."""
    import newton
    import newton_usd_schemas  # noqa: F401
    import pxr  # noqa: F401

    yield {"version": newton.__version__}


def main() -> None:
    """Answer each line; libraries that print on stdout do so on stderr."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        asked = json.loads(line)
        try:
            for reply in {"press": press, "version": version}[asked["do"]](asked):
                print(json.dumps(reply), file=replies, flush=True)
        except Exception as error:
            said = " ".join(f"{type(error).__name__}: {error}".split())[:400]
            print(json.dumps({"error": said}), file=replies, flush=True)


if __name__ == "__main__":
    main()
