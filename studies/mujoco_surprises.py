"""What one would not guess of MuJoCo's soft bodies, seen in MuJoCo: needs mujoco and numpy alone.

python studies/mujoco_surprises.py        a JSON list of [what, guess, seen]
"""

import itertools
import json
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

SIDE, YOUNG, DEPTH = 0.1, 5e4, 0.004
STEP_S, STIFF = 0.005, 'condim="1" solimp=".9999 .9999 .001" solref="-1e5 -632"'
SHARE, TIME_S, RAMP_S, HELD_S = 0.3, 1.0, 0.5, 3.0
"""Share of a foam's modulus that relaxes and its time, as in the laboratory; how long a press and its hold last."""
DAMPINGS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
Row = tuple[str, str, str]


def flex(
    dof: str = "trilinear", cells: int = 3, integrator: str = "discrete", contact: str = "", damping: float = 0.01
) -> str:
    """MJCF of a cube, pinned below, without gravity."""
    axis = SIDE * np.linspace(0.0, 1.0, cells + 1)
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    steps, elements = np.array([(cells + 1) ** 2, cells + 1, 1]), []
    for low in itertools.product(range(cells), repeat=3):
        for order in itertools.permutations(range(3)):
            corners = np.cumsum([np.array(low) @ steps, *steps[list(order)]])
            odd = order in ((0, 2, 1), (1, 0, 2), (2, 1, 0))
            elements.append(corners[[0, 1, 3, 2]] if odd else corners)
    count = f"{cells} {cells} {cells}" if dof == "trilinear" else "1 1 1"
    pinned = f'<pin gridrange="0 0 0 {cells} {cells} 0"/>' if dof == "trilinear" else ""
    text = " ".join(f"{one:g}" for one in places.ravel())
    return f"""<mujoco><option gravity="0 0 0" integrator="{integrator}" solver="CG" timestep="{STEP_S}"/><worldbody>
      <flexcomp name="cube" type="direct" dim="3" dof="{dof}" cellcount="{count}" mass="0.1" radius="1e-4"
        point="{text}" element="{" ".join(str(one) for one in np.ravel(elements))}">
        <elasticity young="{YOUNG}" poisson="0" damping="{damping}"/>{pinned}
        <contact selfcollide="none" priority="1" {contact or 'condim="1"'}/></flexcomp></worldbody></mujoco>"""


def stretched(model: Any, strain: float, heights: np.ndarray, top: float) -> float:
    """Force at the upper nodes over the linear one, all nodes moved as in a column with Poisson's ratio 0."""
    data = mujoco.MjData(model)
    data.qpos[2::3] = strain * heights
    mujoco.mj_forward(model, data)
    return float(-data.qfrc_passive[2::3][heights > top].sum() / (YOUNG * strain * SIDE**2))


def law() -> Row:
    found = []
    for dof in ("trilinear", "full"):
        model = mujoco.MjModel.from_xml_string(flex(dof))
        heights = model.body_pos[1:, 2] if dof == "trilinear" else model.body_pos[-64:, 2]
        found.append(stretched(model, -0.2, heights, 0.99 * SIDE))
    said = f"`trilinear` {found[0]:.2f} of the linear force, `full` {found[1]:.2f}"
    return ("`young` of a cube that is pressed by 20 %", "the same body for each `dof`", said)


def unequal_cells() -> Row:
    spec = mujoco.MjSpec.from_string(flex())
    nodes = np.reshape(spec.flexes[0].node, (-1, 3))
    nodes[:, 0] **= 2
    nodes[:, 0] /= SIDE
    spec.flexes[0].node = nodes.ravel()
    for body in spec.bodies[1:]:
        body.pos[0] **= 2
        body.pos[0] /= SIDE
    model = spec.compile()
    share = stretched(model, 0.01, model.body_pos[1:, 2], 0.99 * SIDE)
    return ("a cube with cells of unequal widths", "its modulus is the same", f"{share:.2f} of the force, no message")


def press(
    boxes: int,
    contact: str,
    cone: Any = mujoco.mjtCone.mjCONE_PYRAMIDAL,
    damping: float = 0.01,
    ramp: int = 20,
    held: int = 40,
    cells: int = 11,
) -> tuple[np.ndarray, int]:
    """Force along z [N] of a flat tip of boxes x boxes geoms after each step, and its number of contacts at last."""
    spec = mujoco.MjSpec.from_string(flex(cells=cells, contact=contact, damping=damping))
    spec.option.cone = cone
    half, middle = 0.04, 0.5 * SIDE
    tip = spec.worldbody.add_body(name="tip", mocap=True, pos=[middle, middle, 1.0])
    for x, y in itertools.product(range(boxes), repeat=2):
        place = [half * ((2 * one + 1) / boxes - 1.0) for one in (x, y)]
        size = [half / boxes, half / boxes, half]
        tip.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=[*place, 0.0], condim=1)
    model = spec.compile()
    data, wrench, forces = mujoco.MjData(model), np.zeros(6), np.zeros(ramp + held)
    for step in range(ramp + held):
        data.mocap_pos[0, 2] = SIDE + half - DEPTH * min(1.0, step / ramp)
        mujoco.mj_step(model, data)
        for number, contact_ in enumerate(data.contact):
            mujoco.mj_contactForce(model, data, number, wrench)
            forces[step] += abs(wrench[:3] @ contact_.frame.reshape(3, 3)[:, 2])
    return forces, data.ncon


def relaxation() -> Row:
    ramp, held = round(RAMP_S / STEP_S), round(HELD_S / STEP_S)
    time = STEP_S * np.arange(ramp + held)
    pressed = np.minimum(time, RAMP_S)
    late = TIME_S * (1.0 - np.exp(-pressed / TIME_S)) * np.exp(-(time - pressed) / TIME_S)
    foam, errors = (1.0 - SHARE) * pressed + SHARE * late, {}  # standard linear solid
    for damping in DAMPINGS:
        force = press(6, STIFF, mujoco.mjtCone.mjCONE_ELLIPTIC, damping, ramp, held, 5)[0]
        off = force * (force @ foam) / (force @ force) - foam  # with the best modulus
        errors[damping] = float(np.sqrt(np.mean(off**2))) / foam.max(), force[ramp + 20] / force[-1]
    best = min(DAMPINGS, key=errors.__getitem__)
    (first, _), (least, left) = errors[DAMPINGS[0]], errors[best]
    return (
        f"a foam of whose modulus {SHARE:g} relaxes in {TIME_S:g} s, pressed for {RAMP_S:g} s and held in that place",
        "the right `damping` repeats its force",
        f"off by {least:.1%} of the peak, rms, with the best of {len(DAMPINGS)} ({best:g} s), {first:.1%} with "
        f"{DAMPINGS[0]:g} s; {20 * STEP_S:g} s after the stop {left:.2f} of the last force, the foam's "
        f"{foam[ramp + 20] / foam[-1]:.2f}",
    )


def contacts() -> Iterator[Row]:
    found = [press(6, STIFF), press(1, STIFF), press(6, "")]
    (many, number), (one, most), (soft, _) = ((forces[-1], count) for forces, count in found)
    yield (
        "contacts of one box as a flat tip",
        f"those of 36 boxes, {number}",
        f"{most}, and {one / many:.2f} of the force",
    )
    yield (
        "the default `solref` and `solimp`",
        "a contact that hardly gives way",
        f"{soft / many:.2f} of a stiff one's force",
    )


def friction() -> Row:
    shares = []
    for ratio in (0.5, 1.0, 3.0, 10.0):
        contact = f'condim="3" friction="{ratio} .005 .0001" solimp=".95 .95 .001" solref="-1e5 -632"'
        pyramid, ellipse = (
            press(6, contact, cone)[0][-1] for cone in (mujoco.mjtCone.mjCONE_PYRAMIDAL, mujoco.mjtCone.mjCONE_ELLIPTIC)
        )
        shares.append(f"{pyramid / ellipse:.2f}")
    said = f'{", ".join(shares)} of that with `cone="elliptic"`'
    return ("force with a friction of 0.5, 1, 3 and 10, with the default cone", "the same where nothing slides", said)


def integrators() -> Row:
    try:
        mujoco.MjModel.from_xml_string(flex(integrator="implicitfast"))
        said = "it compiles"
    except ValueError as error:
        said = " ".join(str(error).split())[:160]
    return ('a flex with `integrator="implicitfast"`', "it is implicit, and stiff bodies ask for that", said)


def main() -> None:
    print(json.dumps([law(), unequal_cells(), *contacts(), friction(), integrators(), relaxation()]))


if __name__ == "__main__":
    main()
