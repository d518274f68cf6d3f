"""The body of cells: known answers, derivatives against differences, and beta's energy against the engine's."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.materials import cell_model
from deformscope.stages.msm.clusters import lattice
from deformscope.stages.msm.solver import Msm
from studies.independent.orthotropic_elements import OrthotropicLaw
from tests.cases import slow


def grid(shape: tuple[int, ...], spacing: float = 0.01) -> FloatArray:
    axes = np.meshgrid(*[np.arange(n) * spacing for n in shape], indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, len(shape))


def pulled(shape: tuple[int, ...]) -> tuple[FloatArray, IntArray, IntArray, FloatArray]:
    """Rest, cells, held and displacements of a lattice that is pulled and sheared at its ends."""
    rest = grid(shape)
    ends = np.flatnonzero((rest[:, 0] == 0.0) | (rest[:, 0] == rest[:, 0].max()))
    moved = np.zeros(rest.shape)
    moved[:, 0], moved[:, 1] = 0.05 * rest[:, 0], 0.03 * rest[:, 0]
    return rest, cell_model.lattice_cells(shape, np.arange(len(rest))), ends, moved


@pytest.mark.parametrize("law", ["elastic", "beta"])
@pytest.mark.parametrize("shape", [(5, 4), (4, 3, 3)])
def test_derivatives_are_those_of_differences(law: cell_model.Law, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    rest, cells, ends, moved = pulled(shape)
    model = cell_model.CellModel(rest, cells, ends, law)
    p = 0.5 * rng.standard_normal(len(cells)) - 1.0
    state = model.state(p, moved)
    step = 1e-5
    for cell in (0, len(cells) // 2):
        change = step * (np.arange(len(cells)) == cell)
        ahead, behind = (model.state(p + sign * change, moved).moved.ravel() for sign in (1.0, -1.0))
        by_difference = (ahead - behind) / (2.0 * step)
        assert np.abs(state.slope[:, cell] - by_difference).max() < 1e-6 * np.abs(by_difference).max()
    ahead, behind = (model.state(p, moved, 0.3 + sign * step).moved.ravel() for sign in (1.0, -1.0))
    assert np.abs(state.by_nu - (ahead - behind) / (2.0 * step)).max() < 1e-6 * np.abs(moved).max()
    other = moved + 0.01 * rng.standard_normal(moved.shape) * np.isin(np.arange(len(rest)), ends)[:, None]
    change = model.state(p, other).moved.ravel() - state.moved.ravel()
    held = (ends[:, None] * rest.shape[1] + np.arange(rest.shape[1])).ravel()
    assert np.allclose(change, state.response @ (other - moved).ravel()[held], atol=1e-12)


@pytest.mark.parametrize("shape", [(5, 4), slow((4, 3, 3))])
def test_derivatives_by_what_makes_it_anisotropic_are_those_of_differences(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    rest, cells, ends, moved = pulled(shape)
    model, d = cell_model.CellModel(rest, cells, ends), len(shape)
    bent = 0.4 * rng.standard_normal(d * (d + 1) * (d * (d + 1) + 2) // 8)
    state, step = model.state(np.zeros(len(cells)), moved, 0.3, bent), 1e-5
    for number in (0, 1, len(bent) - 1):
        change = step * (np.arange(len(bent)) == number)
        ahead, behind = (
            model.state(np.zeros(len(cells)), moved, 0.3, bent + sign * change).moved.ravel() for sign in (1.0, -1.0)
        )
        by_difference = (ahead - behind) / (2.0 * step)
        assert np.abs(state.by_bent[:, number] - by_difference).max() < 1e-6 * np.abs(moved).max()


def test_an_anisotropic_law_has_the_moduli_of_its_directions() -> None:
    """Against compliances of an orthotropic sheet, turned by hand; nothing bent is the plain law."""
    along = np.array([[1.0, 0.0], [0.0, 1.0], [0.6, 0.8]])
    sheet = OrthotropicLaw(stiff=3.0, soft=1.2, nu=0.25, shear=0.7, angle=0.0)
    found = cell_model.directional_modulus(sheet.matrix(), along)
    slant = 0.6**4 / 3.0 + 0.8**4 / 1.2 + (0.6 * 0.8) ** 2 * (1.0 / 0.7 - 2.0 * 0.25 / 3.0)
    assert found == pytest.approx([3.0, 1.2, 1.0 / slant])
    for d in (2, 3):
        size = d * (d + 1) // 2
        nothing = np.zeros(size * (size + 1) // 2)
        assert cell_model.elasticity(d, 0.3, nothing) == pytest.approx(cell_model.elasticity(d, 0.3))
        assert cell_model.directional_modulus(cell_model.elasticity(d, 0.3), np.eye(d)) == pytest.approx(np.ones(d))
        bent = cell_model.elasticity(d, 0.3, np.random.default_rng(d).standard_normal(len(nothing)))
        assert np.linalg.eigvalsh(bent).min() > 0.0
    # turned axes are the same material: eigenvalues of the law stay (Mandel's basis)
    turned = OrthotropicLaw(stiff=3.0, soft=1.2, nu=0.25, shear=0.7, angle=0.7)
    mandel = np.diag([1.0, 1.0, np.sqrt(2.0)])
    values = [np.linalg.eigvalsh(mandel @ one.matrix() @ mandel) for one in (sheet, turned)]
    assert values[0] == pytest.approx(values[1])


@pytest.mark.parametrize("shape", [(3, 3), (3, 3, 3)])
def test_rigid_motion_takes_no_energy_and_strain_that_of_its_modulus(shape: tuple[int, ...]) -> None:
    rest = grid(shape, 1.0)
    d = len(shape)
    corner = rest[cell_model.lattice_cells(shape, np.arange(len(rest)))]
    turn = np.zeros((d, d))
    turn[0, 1], turn[1, 0] = 1.0, -1.0
    for stiffness in (cell_model.elastic_cells(corner, 0.3), sum(cell_model.beta_cells(corner))):
        for motion in (np.ones(corner.shape), corner @ turn):
            assert np.abs(np.einsum("cab,cb->ca", stiffness, motion.reshape(len(corner), -1))).max() < 1e-12
    stretch = np.zeros((d, d))
    stretch[0, 0] = 0.01
    u = (corner @ stretch).reshape(len(corner), -1)
    across = 1.0 / (1.0 - 0.3**2) if d == 2 else 0.7 / (1.3 * 0.4)
    assert np.allclose(np.einsum("ca,cab,cb->c", u, cell_model.elastic_cells(corner, 0.3), u), across * 0.01**2)
    strain, left = cell_model.beta_cells(corner)
    # half the corners stand on each side of the middle, half a cell away
    assert np.allclose(np.einsum("ca,cab,cb->c", u, strain, u), 2**d * (0.5 * 0.01) ** 2)
    assert np.allclose(np.einsum("ca,cab,cb->c", u, left, u), 0.0)


def test_two_materials_in_series_share_a_stretch_by_their_stiffness() -> None:
    rest, cells, ends, moved = pulled((9, 3))
    model = cell_model.CellModel(rest, cells, ends)
    moved[:, 1] = 0.0
    stiff = rest[cells].mean(axis=1)[:, 0] > 0.04
    state = model.state(np.log(np.where(stiff, 3.0, 1.0)), moved, 0.0)
    assert np.allclose(state.moved[rest[:, 0] == 0.04, 0], 0.75 * 0.05 * 0.08)
    assert np.allclose(state.force[rest[:, 0] == 0.08].sum(axis=0), -state.force[rest[:, 0] == 0.0].sum(axis=0))


@pytest.mark.parametrize("shape", [(5, 4), (4, 3, 3)])
def test_small_deformations_are_those_of_the_engine_with_a_beta_for_each_cluster(shape: tuple[int, ...]) -> None:
    rest, cells, ends, moved = pulled(shape)
    moved *= 1e-4
    beta = np.random.default_rng(0).uniform(0.1, 0.9, len(cells))
    ours = cell_model.CellModel(rest, cells, ends, "beta").state(np.log1p(-beta), moved).moved
    grouped = lattice(rest, shape, np.arange(len(rest)), 2)
    assert all(np.array_equal(np.sort(one), np.sort(other)) for one, other in zip(grouped, cells, strict=True))
    engine = Msm(rest, grouped, ends, precision="float64").relax((rest + moved)[ends], beta[None])
    # what is left is of second order in the strain
    assert np.abs(engine.position[0] - rest - ours).max() < 1e-3 * np.abs(moved).max()


def test_particles_of_no_whole_cell_are_refused() -> None:
    rest, cells, ends, _ = pulled((4, 4))
    with pytest.raises(InputError, match="corners of whole cells"):
        cell_model.CellModel(rest, cells[1:], ends)
