"""The finite element shell against closed solutions of plates and cylinders."""

import dataclasses

import numpy as np
import pytest

from deformscope.lab import container_shell
from deformscope.lab.container_constants import PLASTIC
from deformscope.lab.container_shell import BOX, CYLINDER, ContainerShape, Shell, shell_of

ISOTROPIC = dataclasses.replace(PLASTIC, poisson=0.3, shear_pa=PLASTIC.young_pa[0] / 2.6)


def under_pressure(shell: Shell) -> np.ndarray:
    """(along s, along z) displacement outwards under 1 Pa from within."""
    return -shell.at_nodes(shell.solve(-shell.volume_row[:, None])[:, 0])


def test_a_square_box_under_pressure_is_four_plates_with_two_edges_built_in_and_two_supported() -> None:
    side_m = 0.1
    shell = Shell(ContainerShape("box", (side_m / 2,) * 3, ISOTROPIC))
    bending = ISOTROPIC.young_pa[0] * ISOTROPIC.thickness_m**3 / (12 * (1 - 0.3**2))
    # Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, table 29: 0.00192 q a^4 / D
    assert under_pressure(shell).max() == pytest.approx(
        0.00192 * side_m**4 / bending, rel=0.02
    )  # no node in the very middle


def test_a_long_cylinder_under_pressure_widens_as_a_membrane() -> None:
    radius_m = 0.03
    shell = Shell(ContainerShape("cylinder", (radius_m, radius_m, 0.15), ISOTROPIC))
    widened = under_pressure(shell)[:, len(shell.z_m) // 2]
    np.testing.assert_allclose(widened, radius_m**2 / (ISOTROPIC.young_pa[0] * ISOTROPIC.thickness_m), rtol=0.01)


def test_a_finer_mesh_gives_the_same_compliance_under_a_finger(monkeypatch: pytest.MonkeyPatch) -> None:
    def compliance(shell: Shell) -> float:
        around = np.linspace(-0.008, 0.008, 5)
        s_m, z_m = (axis.ravel() for axis in np.meshgrid(around, 0.08 + around))
        rows = shell.rows(s_m, z_m)
        load = rows.T @ np.full(len(s_m), 1.0 / len(s_m))
        return float((rows @ shell.solve(load[:, None])[:, 0]).mean())

    coarse = compliance(shell_of(BOX))
    monkeypatch.setattr(container_shell, "FINE_M", 0.005)
    monkeypatch.setattr(container_shell, "COARSE_M", 0.005)
    assert compliance(Shell(BOX)) == pytest.approx(coarse, rel=0.02)


@pytest.mark.parametrize("shape", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_what_one_place_does_to_another_the_other_does_to_it(shape: ContainerShape) -> None:
    shell = shell_of(shape)
    rows = shell.rows(np.array([0.0, 0.01, shape.perimeter_m / 2]), np.array([0.08, 0.09, 0.07]))
    compliance = rows @ shell.solve(rows.T.toarray())
    np.testing.assert_allclose(compliance, compliance.T, rtol=1e-6)
    assert (np.linalg.eigvalsh(compliance) > 0).all()


@pytest.mark.parametrize("shape", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_patches_and_pressure_act_on_their_areas(shape: ContainerShape) -> None:
    shell = shell_of(shape)
    level = np.zeros((2 * len(shell.s_m), 2 * len(shell.z_m)))
    level[::2, ::2] = 1.0  # displaced by 1 m everywhere, without slopes
    np.testing.assert_allclose(shell.patch_rows @ level.ravel(), shell.patch_area_m2, rtol=1e-9)
    assert shell.volume_row @ level.ravel() == pytest.approx(shape.perimeter_m * shape.height_m)
    low = shell.pressure_row(0.0, 0.1, slope=True) @ level.ravel()
    assert low == pytest.approx(shape.perimeter_m * 0.1**2 / 2)


@pytest.mark.parametrize("shape", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_points_of_the_wall_lie_on_it(shape: ContainerShape) -> None:
    s_m = np.linspace(0.0, shape.perimeter_m, 200, endpoint=False)
    points, normals = shape.place(s_m, np.full(200, 0.05))
    np.testing.assert_allclose(points[:, 2], 0.05 - shape.half_m[2])
    walked = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    assert walked.sum() == pytest.approx(shape.perimeter_m * 199 / 200, rel=0.02)
    assert ((points * normals).sum(axis=1) > 0.02).all()
    for side in (1, -1):
        on_side = np.flatnonzero((normals[:, 0] * side > 0.9) & (np.abs(points[:, 1]) < 0.999 * shape.half_m[1]))
        found_s, found_z, found_normal, on_wall = shape.under(points[on_side], side)
        np.testing.assert_allclose(np.mod(found_s, shape.perimeter_m), s_m[on_side], atol=1e-12)
        np.testing.assert_allclose(found_normal, normals[on_side], atol=1e-12)
        np.testing.assert_allclose(shape.depth_m(points[on_side], side), 0.0, atol=1e-12)
        assert on_wall.all()
        np.testing.assert_allclose(found_z, 0.05)
