"""The process that presses a slab in Newton, against what is known of the slab: its mass, and uniform compression."""

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from deformscope.plain import Json
from deformscope.simulators.body_files import write_body
from deformscope.simulators.target_process import TargetFailed, target_process
from deformscope.stages.simulate.slab_mesh import slab_mesh
from deformscope.stages.simulate.target_fit import TargetParameters
from tests.cli.test_simulate_command import WITH_TARGETS, has

MESH = slab_mesh((np.linspace(0.0, 0.04, 5), np.linspace(0.0, 0.04, 5), np.linspace(0.0, 0.03, 4)))
YOUNG, CONTACT = 50e3, 1e5
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not has("newton, pxr, newton_usd_schemas"), reason="needs newton, or DEFORMSCOPE_TARGETS_PYTHON"
    ),
]


def answered(
    folder: Path, poisson: float, depths: Sequence[float], timestep_s: float = 0.002, side: float = 0.06
) -> Json:
    """The answer to a flat tip above the slab's middle."""
    asset = write_body("newton", folder, MESH, TargetParameters(1e4, 0.1, 1.0), 100.0, timestep_s)
    poke = {"at_m": [0.02, 0.02], "tip": "flat", "size_m": [side, side], "slips": True, "depth_m": list(depths)}
    given = {"young": [YOUNG], "poisson": poisson, "contact": CONTACT}
    request: Json = {"do": "press", "asset": str(asset), "parameters": given, "timestep_s": timestep_s}
    with target_process("newton", Path(WITH_TARGETS)) as target:
        (answer,) = target.ask(request | {"pokes": [poke]})
    return answer


def test_a_slab_under_a_wider_tip_is_a_column(tmp_path: Path) -> None:
    """Without Poisson's ratio nothing moves sideways, and the force is E * area * strain, whatever the elements are."""
    found = answered(tmp_path, 0.0, (0.0005, 0.001))
    sunk = np.array([0.0005, 0.001]) - found["penetration_m"]
    np.testing.assert_allclose(found["force_n"], YOUNG * 0.04**2 * sunk / 0.03, rtol=0.01)
    rest, moved = np.array(found["rest_m"]), np.array(found["moved_m"])
    np.testing.assert_allclose(moved[:, 2], -sunk[-1] * rest[:, 2] / 0.03, atol=0.03 * sunk[-1])
    assert found["how"]["residual"] < 0.002


def test_the_modulus_in_the_file_is_replaced_and_the_sides_bulge(tmp_path: Path) -> None:
    found = answered(tmp_path, 0.3, (0.001,))
    column = YOUNG * 0.04**2 * (0.001 - found["penetration_m"][0]) / 0.03
    confined = column * 0.7 / (1.3 * 0.4)  # between a column's and that of a layer that cannot bulge
    assert column < found["force_n"][0] < confined
    rest, moved = np.array(found["rest_m"]), np.array(found["moved_m"])
    side = (rest[:, 0] > 0.0399) & (rest[:, 2] > 0.01)
    assert (moved[side, 0] > 1e-5).all()


def test_a_slab_that_was_pressed_before_answers_as_a_new_one_in_fewer_steps(tmp_path: Path) -> None:
    """A fit presses the same pokes with parameters that change; each press begins where the last one ended."""
    asset = write_body("newton", tmp_path, MESH, TargetParameters(1e4, 0.1, 1.0), 100.0, 0.001)
    poke = {"at_m": [0.02, 0.02], "tip": "flat", "size_m": [0.024, 0.024], "slips": True, "depth_m": [0.0005, 0.001]}
    asked: Json = {"do": "press", "asset": str(asset), "timestep_s": 0.001, "pokes": [poke]}
    last = asked | {"parameters": {"young": [50e3], "poisson": 0.3, "contact": 2e4}}
    with target_process("newton", Path(WITH_TARGETS)) as target:
        list(target.ask(asked | {"parameters": {"young": [40e3], "poisson": 0.26, "contact": 3e4}}))
        (warm,) = target.ask(last)
    with target_process("newton", Path(WITH_TARGETS)) as target:
        (new,) = target.ask(last)
    assert warm["how"]["steps"] < 0.7 * new["how"]["steps"]
    np.testing.assert_allclose(warm["force_n"], new["force_n"], rtol=2e-3)
    np.testing.assert_allclose(warm["moved_m"], new["moved_m"], atol=2e-6)
    np.testing.assert_allclose(warm["rest_m"], new["rest_m"], atol=2e-6)


def test_steps_so_long_that_gravity_turns_cells_inside_out_are_an_error(tmp_path: Path) -> None:
    """Newton itself goes on with such cells without a word."""
    with pytest.raises(TargetFailed, match=r"inside out with steps of 0.1 s"):
        answered(tmp_path, 0.3, (0.001,), timestep_s=0.1)


def test_newton_alone_loads_the_body_with_its_mass_and_modulus(tmp_path: Path) -> None:
    asset = write_body("newton", tmp_path, MESH, TargetParameters(40e3, 0.25, 1.0), 120.0, 0.002)
    load = "import sys, json, newton; b = newton.ModelBuilder(); b.add_usd(sys.argv[1]); print(json.dumps([" + (
        "b.particle_count, b.tet_count, float(sum(b.particle_mass)), *map(float, b.tet_materials[0])]))"
    )
    ended = subprocess.run(
        [WITH_TARGETS, "-I", "-c", load, str(asset)], capture_output=True, text=True, check=True, cwd="/"
    )
    vertices, cells, mass, shear, lame, _ = json.loads(ended.stdout.splitlines()[-1])
    assert (vertices, cells) == (len(MESH.vertices), len(MESH.elements))
    assert mass == pytest.approx(120.0 * 0.04 * 0.04 * 0.03, rel=1e-4)
    assert shear == pytest.approx(40e3 / 2.5, rel=1e-5)
    assert lame == pytest.approx(40e3 * 0.25 / (1.25 * 0.5), rel=1e-5)
