#!/usr/bin/env bash
# MuJoCo 4.0.0 gives one elastic flex another law by its degrees of freedom: with dof="full" the force follows the
# St Venant-Kirchhoff solid (quadratic strain, softer the more it is pressed), with dof="trilinear" or "quadratic" it
# is proportional to the stretch. A cube pressed to half its height pushes back with .375 of what the other says. The
# compiler also warns that such a flex has "no equality constraints or passive forces", while these forces act.
# Guess before: `young` and `poisson` mean one material, and a warning of no forces means none.
# Seen, 2026-11-29, Python 3.11: force over young x strain x area, poisson 0, strains -.5, -.2, .2
#   full .375 .720 1.320; trilinear 1.000 1.000 1.000; quadratic 1.000 1.000 1.000; 3 warnings
# Fails when that changes. Writes into a temporary folder only.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" --quiet --disable-pip-version-check install mujoco==4.0.0
cat > "$folder/press.py" <<'PY'
import mujoco

YOUNG, SIDE, COUNT = 5e4, 0.1, 4
for dof in ("full", "trilinear", "quadratic"):
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco><option gravity="0 0 0" integrator="Euler"/><worldbody>
  <flexcomp name="cube" type="grid" dim="3" dof="{dof}" count="{COUNT} {COUNT} {COUNT}" mass="0.1" radius="0.001"
            spacing="{SIDE / (COUNT - 1)} {SIDE / (COUNT - 1)} {SIDE / (COUNT - 1)}">
    <contact selfcollide="none"/><elasticity young="{YOUNG}" poisson="0"/>
  </flexcomp></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    nodes = [body for body in range(1, model.nbody) if model.body_jntnum[body] == 3]
    height = {body: data.xpos[body][2] + SIDE / 2 for body in nodes}
    said = []
    for strain in (-0.5, -0.2, 0.2):
        for body in nodes:  # all of it is stretched alike: the exact field of a free cube with poisson 0
            data.qpos[model.jnt_qposadr[model.body_jntadr[body]] + 2] = strain * height[body]
        mujoco.mj_forward(model, data)
        top = [model.jnt_dofadr[model.body_jntadr[body]] + 2 for body in nodes if height[body] > 0.99 * SIDE]
        said.append(-sum(data.qfrc_passive[at] for at in top) / (YOUNG * strain * SIDE**2))
    print(dof, *(f"{one:.3f}" for one in said))
PY
cd "$folder" && "$folder/venv/bin/python" press.py > said 2> warned
cat said
printf '%s\n' 'full 0.375 0.720 1.320' {trilinear,quadratic}' 1.000 1.000 1.000' | cmp -s - said &&
    [ "$(cat said warned | grep -c 'has no equality constraints or passive forces')" = 3 ] || { echo changed >&2; exit 1; }
