"""A slab of two materials: in MuJoCo as finite elements, in Newton as columns beside each other and as layers."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.lab.elasticity import ElasticBox
from deformscope.simulators.body_files import write_body
from deformscope.simulators.target_process import target_process
from deformscope.stages.simulate.slab_mesh import slab_mesh
from deformscope.stages.simulate.target_fit import TargetParameters
from tests.cli.test_simulate_command import WITH_TARGETS, has

AXES = (np.linspace(0.0, 0.04, 5), np.linspace(0.0, 0.04, 5), np.linspace(0.0, 0.03, 4))
SOFT, FIRM, DEPTH = 20e3, 80e3, 0.001
FORCES = """
import json, sys, mujoco, numpy as np
model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
data.qpos[:] = 1e-8 * np.sin(np.arange(model.nq))
mujoco.mj_forward(model, data)
print(json.dumps([model.nflex, data.ncon, data.qfrc_passive.tolist()]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not has("mujoco"), reason="needs mujoco, or DEFORMSCOPE_TARGETS_PYTHON with it")
def test_flexes_with_common_nodes_are_finite_elements_of_two_materials(tmp_path: Path) -> None:
    """Any displacement is resisted as by trilinear elements; MuJoCo loads the file alone, and no flex hits another."""
    material = np.zeros((4, 4, 3), np.int64)
    material[1:3, 1:, 1:] = 1
    mesh = slab_mesh(AXES, material)
    body = write_body("mujoco", tmp_path, mesh, TargetParameters(SOFT, 0.3, 1e5, (FIRM / SOFT,)), 100.0, 0.005)
    ended = subprocess.run(
        [WITH_TARGETS, "-I", "-c", FORCES, str(body)], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    flexes, contacts, force = json.loads(ended.stdout.splitlines()[-1])
    assert flexes == len(mesh.boxes()) > 2
    assert contacts == 0

    def young(centres: FloatArray) -> FloatArray:
        cell = [np.searchsorted(axis, centres[:, at]) - 1 for at, axis in enumerate(AXES)]
        return np.where(material, FIRM, SOFT)[tuple(cell)]

    box = ElasticBox(*AXES, young=young, poisson=0.3, element="trilinear")
    free = mesh.vertices[:, 2] > 0.0
    moved = np.zeros(mesh.vertices.shape)
    moved[free] = 1e-8 * np.sin(np.arange(len(force))).reshape(-1, 3)
    at_nodes = np.zeros_like(moved)
    at_nodes[box.corners] = moved
    known = box.hold(np.ones(moved.shape, bool)).solve(at_nodes).force[box.corners][free]
    assert np.abs(np.reshape(force, (-1, 3)) + known).max() < 1e-4 * np.abs(known).max()


@pytest.mark.slow
@pytest.mark.skipif(not has("newton, pxr, newton_usd_schemas"), reason="needs newton, or DEFORMSCOPE_TARGETS_PYTHON")
@pytest.mark.parametrize(
    ("firm", "mean"),
    [
        ((slice(2, None), slice(None), slice(None)), 0.5 * (SOFT + FIRM)),
        ((slice(1, 3), slice(1, 3), slice(None)), 0.75 * SOFT + 0.25 * FIRM),
        ((slice(None), slice(None), slice(0, 1)), 3.0 / (2.0 / SOFT + 1.0 / FIRM)),
    ],
)
def test_materials_beside_each_other_add_and_layers_give_way_in_turn(firm: Any, mean: float, tmp_path: Path) -> None:
    """Under a tip wider than the slab, without Poisson's ratio, the force is mean modulus * area * strain."""
    material = np.zeros((4, 4, 3), np.int64)
    material[firm] = 1
    mesh = slab_mesh(AXES, material)
    body = write_body("newton", tmp_path, mesh, TargetParameters(1e4, 0.1, 1.0, (1.0,)), 100.0, 0.002)
    poke = {"at_m": [0.02, 0.02], "tip": "flat", "size_m": [0.06, 0.06], "slips": True, "depth_m": [DEPTH]}
    given = {"young": [SOFT, FIRM], "poisson": 0.0, "contact": 1e5}
    request: dict[str, object] = {"do": "press", "asset": str(body), "parameters": given, "timestep_s": 0.002}
    with target_process("newton", Path(WITH_TARGETS)) as process:
        (found,) = process.ask(request | {"pokes": [poke]})
    sunk = DEPTH - found["penetration_m"][0]
    assert found["force_n"][0] == pytest.approx(mean * 0.04**2 * sunk / 0.03, rel=0.02)
    rest, moved = np.array(found["rest_m"]), np.array(found["moved_m"])
    np.testing.assert_allclose(rest, mesh.vertices, atol=1e-4)
    assert np.abs(moved[rest[:, 2] < 1e-4]).max() < 1e-9
