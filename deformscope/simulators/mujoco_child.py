"""Presses a slab in MuJoCo: a process of its own, which needs mujoco and numpy alone.

    python mujoco_child.py < requests > replies        one JSON object a line

    {"do": "version"}  ->  {"version": "4.0.0"}
    {"do": "press", "asset": "slab.xml", "parameters": {"young": [...], "poisson", "contact"}, "timestep_s", "pokes":
      [{"at_m": [x, y], "tip": "sphere" | "disc" | "flat", "size_m": [...], "slips": true, "depth_m": [...]}]}
      ->  a line for each poke: {"force_n": [...], "penetration_m": [...], "rest_m": [[x, y, z]...], "moved_m": [...],
          "step_s": seconds a step, "how": {"steps"}}
    {"do": "hold", "asset", "parameters", "timestep_s", "by_m": [[x, y, z] of each mocap node...]}
      ->  {"moved_m": [[x, y, z]...], "force_n": [[x, y, z]...]} of each node; forces are from outside

or {"error": "one line"}. A tip is a mocap body that sinks into the slab step by step; the force is that of its contacts
along z, when it no longer changes; `moved_m` are the vertices under the deepest poke less those at rest, which lie as
gravity leaves them."""

import itertools
import json
import os
import sys
import time
from collections.abc import Iterator
from typing import Any

RAMP, LONGEST, AVERAGED = 12, 80, 6
"""Steps in which the tip goes from one depth to the next; most steps until the force no longer changes; steps that are
averaged."""
TILES = 6
"""Boxes along each side of a flat tip. MuJoCo keeps 50 contacts for a geom on such a flex, and few at a box's edges:
with one box the force depends more on where the flex's vertices are."""
BEYOND = 0.5
"""A cell that a flat tip's edge crosses is held down as far as its outer nodes: on average half a cell beyond the edge.
The tip is narrower by that on each side."""
FARTHEST = 5.0
"""A vertex that moves this many depths is thrown out."""
HEAVY_KG = 1e3
"""Mass of a node that is moved."""
STILL, STILL_SHARE = 1e-3, 1e-5
"""Relative change between averaged forces, and share of the way in a step, below which it stays."""


def scene(mujoco: Any, asked: dict[str, Any], poke: dict[str, Any]) -> tuple[Any, Any, float]:
    """Model and data of the slab with these parameters and the tip, and the height of the tip's middle over a surface
    that it touches [m]."""
    import numpy as np

    spec, given = mujoco.MjSpec.from_file(asked["asset"]), asked["parameters"]
    shape, half = poke["tip"], [0.5 * one for one in poke["size_m"]]
    for flex in spec.flexes:
        material = int(flex.name.removeprefix("material").partition("_")[0])
        flex.young, flex.poisson = given["young"][material], given["poisson"]
        flex.solref = [-given["contact"], -2.0 * given["contact"] ** 0.5]
        flex.condim, flex.friction = (1, [0.0] * 3) if poke["slips"] else (3, [10.0, 0.005, 0.0001])
    spec.option.timestep = asked["timestep_s"]
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC  # with pyramids, friction of 10 lets the tip through
    places = np.array([body.pos for body in spec.bodies[1:]]).round(6)
    above = half[0]
    if shape != "sphere":
        half = [one - BEYOND * float(np.diff(np.unique(places[:, axis])).min()) for axis, one in enumerate(half)]
    kind, size = {
        "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, [half[0], 0.0, 0.0]),
        "disc": (mujoco.mjtGeom.mjGEOM_CYLINDER, [half[0], above, 0.0]),
        "flat": (mujoco.mjtGeom.mjGEOM_BOX, [half[0] / TILES, half[-1] / TILES, above]),
    }[shape]
    tip = spec.worldbody.add_body(name="tip", mocap=True, pos=[*poke["at_m"], 1.0])
    tiles = [(2 * one + 1) / TILES - 1.0 for one in range(TILES)] if shape == "flat" else [0.0]
    for x, y in itertools.product(tiles, tiles):
        tip.add_geom(type=kind, size=size, pos=[x * half[0], y * half[-1], 0.0], condim=flex.condim)
    model = spec.compile()
    return model, mujoco.MjData(model), above + float(flex.radius)


def press(asked: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Replies to a request to press, poke by poke."""
    import mujoco
    import numpy as np

    def step() -> tuple[float, float]:
        """Force along z [N] and penetration [m] after a step."""
        mujoco.mj_step(model, data)
        if not np.isfinite(data.qpos).all() or data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise ArithmeticError(f"the slab is not stable with steps of {asked['timestep_s']:g} s")
        force, inside, wrench = 0.0, 0.0, np.zeros(6)
        for number, contact in enumerate(data.contact):
            mujoco.mj_contactForce(model, data, number, wrench)
            force += abs(float(wrench[:3] @ contact.frame.reshape(3, 3)[:, 2]))
            inside = max(inside, -float(contact.dist))
        return force, inside

    for poke in asked["pokes"]:
        model, data, above = scene(mujoco, asked, poke)
        mujoco.mj_kinematics(model, data)
        nodes = slice(1, model.nbody - 1)  # one body each; the tip is the last
        height = data.xpos[nodes, 2].copy()
        upper = height >= height.max() - 1e-9
        for _ in range(RAMP):  # under its own weight, which moves the vertices below each other sideways too
            step()
        rest = data.xpos[nodes].copy()
        aside = np.linalg.norm(rest[upper, :2] - poke["at_m"], axis=1)
        touching = float(rest[upper, 2][aside.argmin()]) + above
        forces, depths, now, at, steps = [], [], np.zeros(2), 0.0, 0
        began = time.perf_counter()
        for depth in poke["depth_m"]:
            found: list[tuple[float, float]] = []
            while len(found) < RAMP + LONGEST:
                sunk = at + (depth - at) * min(1.0, (len(found) + 1) / RAMP)
                data.mocap_pos[0] = [*poke["at_m"], touching - sunk]
                found.append(step())
                now, before = (np.mean(found[-AVERAGED * n :][:AVERAGED], axis=0) for n in (1, 2))
                if len(found) >= RAMP + 2 * AVERAGED and abs(now[0] - before[0]) <= STILL * now[0]:
                    break
            forces.append(float(now[0]))
            depths.append(float(now[1]))
            at, steps = depth, steps + len(found)
        moved = data.xpos[nodes] - rest
        if np.abs(moved).max() > FARTHEST * at:
            raise ArithmeticError(
                f"the slab bursts with steps of {asked['timestep_s']:g} s, or its cells are too coarse"
            )
        yield {
            "force_n": forces,
            "penetration_m": depths,
            "rest_m": rest.tolist(),
            "moved_m": moved.tolist(),
            "step_s": (time.perf_counter() - began) / steps,
            "how": {"steps": steps},
        }


def hold(asked: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The reply to a request to move the mocap nodes, where the others are still."""
    import mujoco
    import numpy as np

    spec, by, moved, held = mujoco.MjSpec.from_file(asked["asset"]), np.array(asked["by_m"]), np.inf, []
    (spec.flexes[0].young,), spec.flexes[0].poisson = asked["parameters"]["young"], asked["parameters"]["poisson"]
    spec.option.timestep = asked["timestep_s"]
    for number, node in enumerate(spec.bodies[1:]):
        if node.mocap:  # which gives no force: it becomes one that nothing but this moves
            node.mocap, node.mass, node.explicitinertial, node.inertia = False, HEAVY_KG, True, [1.0] * 3
            held.append(number)
            for axis in np.eye(3):
                node.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    model = spec.compile()
    data = mujoco.MjData(model)
    place, speed, force = (one.reshape(-1, 3) for one in (data.qpos, data.qvel, data.qfrc_passive))
    for number in range(1, RAMP + LONGEST):
        place[held], speed[held] = min(1.0, number / RAMP) * by, 0.0
        mujoco.mj_step(model, data)
        moved, before = place.copy(), moved
        if number > RAMP and np.abs(moved - before).max() <= STILL_SHARE * np.abs(by).max():
            break
    else:
        raise ArithmeticError(f"the body is not still after {number} steps of {asked['timestep_s']:g} s")
    yield {"moved_m": moved.tolist(), "force_n": (-force).tolist()}


def version(asked: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The target's version."""
    import mujoco

    yield {"version": mujoco.__version__}


def main() -> None:
    """Answer each line; libraries that print on stdout do so on stderr."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        asked = json.loads(line)
        try:
            for reply in {"press": press, "hold": hold, "version": version}[asked["do"]](asked):
                print(json.dumps(reply), file=replies, flush=True)
        except Exception as error:
            said = " ".join(f"{type(error).__name__}: {error}".split())[:400]
            print(json.dumps({"error": said}), file=replies, flush=True)


if __name__ == "__main__":
    main()
