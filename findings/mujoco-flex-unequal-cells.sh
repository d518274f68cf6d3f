#!/usr/bin/env bash
# MuJoCo 4.0.0 gives every cell of a trilinear flex the stiffness of its first cell, without a message, where the nodes
# are at unequal distances. MJCF's <flex node="..." cellcount="..."> takes nodes anywhere, so that a grid can be made
# finer below a contact; a block stretched alike then pulls with the force of another one.
# Guess before: the stiffness of a cell follows from its own nodes, and the force is that of the block's area.
# Seen, 2026-11-30, Python 3.11: force over young x strain x area, poisson 0, 3 cells of widths w across a cube
#   w = 1/3 1/3 1/3: 1.000; w = 1/9 3/9 5/9: 0.333; w = 5/9 3/9 1/9: 1.667
# Fails when that changes. Writes into a temporary folder only.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" --quiet --disable-pip-version-check install mujoco==4.0.0
cat > "$folder/stretch.py" <<'PY'
import itertools

import mujoco

YOUNG, SIDE, STRAIN = 5e4, 0.1, 1e-3
THIRDS = (0.0, 1 / 3, 2 / 3, 1.0)
for name, across in (("even", THIRDS), ("rising", (0.0, 1 / 9, 4 / 9, 1.0)), ("falling", (0.0, 5 / 9, 8 / 9, 1.0))):
    bodies, names, places, tetrahedra = [], [], [], []
    for i, j, k in itertools.product(range(4), repeat=3):
        pos = f"{SIDE * across[i]} {SIDE * THIRDS[j]} {SIDE * THIRDS[k]}"
        slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
        inertia = '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-7 1e-7 1e-7"/>'
        bodies.append(f'<body name="n{i}{j}{k}" pos="{pos}">{inertia}{slides}</body>')
        names.append(f"n{i}{j}{k}")
        places.append(f"{SIDE * THIRDS[i]} {SIDE * THIRDS[j]} {SIDE * THIRDS[k]}")
    for i, j, k in itertools.product(range(3), repeat=3):
        for steps in itertools.permutations((16, 4, 1)):
            corners = list(itertools.accumulate((16 * i + 4 * j + k, *steps)))
            odd = steps in ((16, 1, 4), (4, 16, 1), (1, 4, 16))
            tetrahedra += [corners[n] for n in ((0, 1, 3, 2) if odd else (0, 1, 2, 3))]
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco><option gravity="0 0 0" integrator="discrete"/><worldbody>{"".join(bodies)}</worldbody><deformable>
  <flex name="cube" dim="3" dof="trilinear" cellcount="3 3 3" body="{" ".join(["world"] * 64)}" radius="1e-4"
    node="{" ".join(names)}" vertex="{" ".join(places)}" element="{" ".join(map(str, tetrahedra))}">
    <contact selfcollide="none"/><elasticity young="{YOUNG}" poisson="0"/></flex></deformable></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[2::3] = STRAIN * model.body_pos[1:, 2]
    mujoco.mj_forward(model, data)
    top = model.body_pos[1:, 2] > 0.99 * SIDE
    print(name, f"{-data.qfrc_passive[2::3][top].sum() / (YOUNG * STRAIN * SIDE**2):.3f}")
PY
cd "$folder" && "$folder/venv/bin/python" stretch.py > said
cat said
printf '%s\n' 'even 1.000' 'rising 0.333' 'falling 1.667' | cmp -s - said || { echo changed >&2; exit 1; }
