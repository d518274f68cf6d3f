"""Linear elasticity against closed forms, equilibrium, and another solver."""

from pathlib import Path

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab import elasticity
from deformscope.lab.elasticity import ElasticBox, Element, Solved
from tests.cases import Patch

YOUNG = 750e3


def graded(length: float, count: int) -> FloatArray:
    """An axis whose elements grow along it."""
    return length * np.linspace(0.0, 1.0, count) ** 1.3


def uneven_box(poisson: float, element: Element = "serendipity", young: elasticity.PerElement = YOUNG) -> ElasticBox:
    return ElasticBox(graded(0.1, 4), graded(0.08, 5), graded(0.05, 3), young=young, poisson=poisson, element=element)


def outside(box: ElasticBox) -> np.ndarray:
    return np.any([box.plane(d, end) for d in range(3) for end in (box.axes[d][0], box.axes[d][-1])], axis=0)


def every_component(nodes: np.ndarray) -> np.ndarray:
    return np.repeat(nodes[:, None], 3, axis=1)


def pressed_cube(
    poisson: float, corners: int, push: float = 0.01, element: Element = "serendipity"
) -> tuple[ElasticBox, Solved]:
    """The cube of Thesis 5.1: bottom fixed, top moved down without motion sideways."""
    axis = np.linspace(0.0, 0.1, corners)
    box = ElasticBox(axis, axis, axis, young=YOUNG, poisson=poisson, element=element)
    top = box.plane(2, 0.1)
    moved = np.zeros(box.nodes.shape)
    moved[top, 2] = -push
    return box, box.hold(every_component(top | box.plane(2, 0.0))).solve(moved)


@pytest.mark.parametrize("element", ["serendipity", "quadratic", "trilinear"])
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.49])
def test_a_uniform_strain_on_the_surface_is_uniform_inside(element: Element, poisson: float) -> None:
    box = uneven_box(poisson, element)
    wanted = box.nodes @ np.array([[0.01, 0.004, -0.002], [0.0, -0.02, 0.003], [0.001, 0.0, 0.015]]).T
    np.testing.assert_allclose(box.hold(every_component(outside(box))).solve(wanted).displacement, wanted, atol=1e-14)


@pytest.mark.parametrize("element", ["serendipity", "quadratic"])
def test_pure_bending_is_exact(element: Element) -> None:
    """The stress c E y along x: displacements are quadratic, which both elements hold."""
    poisson, curvature = 0.3, 0.2
    box = uneven_box(poisson, element)
    x, y, z = box.nodes.T
    wanted = curvature * np.stack([x * y, -(x**2) / 2 - poisson * (y**2 - z**2) / 2, -poisson * y * z], axis=1)
    found = box.hold(every_component(box.plane(0, 0.0) | box.plane(0, 0.1))).solve(wanted)
    np.testing.assert_allclose(found.displacement, wanted, atol=1e-12)


def test_a_block_between_plates_without_friction_is_uniaxial() -> None:
    """Stress E e, width grown by nu e: the top is moved along z alone, and free to slide."""
    poisson, push = 0.4, 0.002
    box = uneven_box(poisson)
    x, y, z = box.nodes.T
    top = box.plane(2, 0.05)
    held = np.zeros(box.nodes.shape, dtype=bool)
    held[box.plane(2, 0.0) | top, 2] = True
    held[box.plane(0, 0.0), 0] = True
    held[box.plane(1, 0.0), 1] = True
    moved = np.zeros(held.shape)
    moved[top, 2] = -push
    found = box.hold(held).solve(moved)
    strain = push / 0.05
    np.testing.assert_allclose(
        found.displacement, strain * np.stack([poisson * x, poisson * y, -z], axis=1), atol=1e-14
    )
    np.testing.assert_allclose(found.force[top].sum(axis=0), [0.0, 0.0, -YOUNG * strain * 0.1 * 0.08], atol=1e-8)


def test_layers_in_series_share_one_stress() -> None:
    """A soft layer on a stiff one, nu = 0: strains are as compliances."""
    box = uneven_box(0.0, young=lambda centre: np.where(centre[:, 2] < 0.02, 90e3, 30e3))
    z = box.axes[2]
    top = box.plane(2, z[-1])
    moved = np.zeros(box.nodes.shape)
    moved[top, 2] = -0.001
    found = box.hold(every_component(top | box.plane(2, 0.0))).solve(moved)
    middle = z[1]  # elements below 0.02 m are stiff: the first layer
    pressure = 0.001 / (middle / 90e3 + (z[-1] - middle) / 30e3)
    assert found.force[top, 2].sum() == pytest.approx(-pressure * 0.1 * 0.08)
    np.testing.assert_allclose(found.displacement[box.plane(2, middle), 2], -pressure * middle / 90e3)


def test_forces_balance_and_nothing_pulls_where_nothing_holds() -> None:
    box, found = pressed_cube(0.4, 5)
    moment = np.cross(box.nodes, found.force).sum(axis=0)
    assert found.force[box.plane(2, 0.1), 2].sum() == pytest.approx(-found.force[box.plane(2, 0.0), 2].sum())
    np.testing.assert_allclose(found.force.sum(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(moment, 0.0, atol=1e-10)
    assert not found.force[~(box.plane(2, 0.0) | box.plane(2, 0.1))].any()


def test_work_of_the_plates_is_twice_the_energy() -> None:
    box, found = pressed_cube(0.25, 4)
    u = found.displacement.ravel()
    assert (found.force * found.displacement).sum() == pytest.approx(u @ (box.stiffness @ u))


def test_a_load_is_carried_to_the_support() -> None:
    box = uneven_box(0.3)
    load = np.zeros(box.nodes.shape)
    load[box.corners[-1]] = [1.0, -2.0, 3.0]
    found = box.hold(every_component(box.plane(2, 0.0))).solve(np.zeros(load.shape), load)
    np.testing.assert_allclose(found.force.sum(axis=0), [-1.0, 2.0, -3.0], atol=1e-9)
    assert (found.displacement[box.corners[-1]] * load[box.corners[-1]] > 0.0).all()


def test_nearly_incompressible_keeps_its_volume_and_trilinear_locks() -> None:
    """The volume that the plates take away comes out at the sides, up to (1 - 2 nu) of it; a locked cube is stiffer."""
    forces = {}
    for element in ("serendipity", "quadratic", "trilinear"):
        box, found = pressed_cube(0.49, 5, element=element)
        forces[element] = -found.force[box.plane(2, 0.1), 2].sum()
        # a rule exact for products of cubics on each face
        node, weight = np.polynomial.legendre.leggauss(3)
        place = (0.0125 + 0.025 * np.arange(4)[:, None] + 0.0125 * node).ravel()
        weights = np.outer(np.tile(weight, 4), np.tile(weight, 4)).ravel() * 0.0125**2
        a, b = (grid.ravel() for grid in np.meshgrid(place, place, indexing="ij"))
        flux = 0.0
        for axis, end, sign in ((0, 0.1, 1.0), (0, 0.0, -1.0), (1, 0.1, 1.0), (1, 0.0, -1.0)):
            points = np.stack([a, a, b], axis=1)
            points[:, axis] = end
            flux += sign * float(weights @ box.sample(found.displacement, points)[:, axis])
        if element != "trilinear":
            assert flux == pytest.approx(0.1**2 * 0.01, rel=0.08)
            assert flux < 0.1**2 * 0.01
    assert forces["quadratic"] < forces["serendipity"] < 1.01 * forces["quadratic"]
    assert forces["trilinear"] > 1.3 * forces["quadratic"]


def test_any_displacement_of_an_element_is_sampled_between_its_nodes() -> None:
    """A field that quadratic elements hold exactly, at points anywhere, on their boundaries and corners too."""
    box = uneven_box(0.3, "quadratic")
    points = np.concatenate([np.random.default_rng(4).uniform(0.0, 1.0, (200, 3)) * [0.1, 0.08, 0.05], box.nodes])

    def field(x: np.ndarray) -> np.ndarray:
        return np.stack([x[:, 0] ** 2 * x[:, 1], x[:, 2] ** 2 - x[:, 0], x[:, 0] * x[:, 1] * x[:, 2]], axis=1)

    sampled = box.sample(np.stack([field(box.nodes), -field(box.nodes)]), points)
    np.testing.assert_allclose(sampled, [field(points), -field(points)], atol=1e-15)
    np.testing.assert_allclose(
        box.nodes[box.corners].reshape(4, 5, 3, 3)[2, 3, 1],
        [axis[i] for axis, i in zip(box.axes, (2, 3, 1), strict=True)],
    )


def test_one_factorisation_serves_many_displacements_and_conjugate_gradients_agree(monkeypatch: Patch) -> None:
    box = uneven_box(0.45)
    held = every_component(box.plane(2, 0.0))
    tip = box.nodes[:, 2] >= 0.05 - 1e-9
    held[tip, 0] = True
    moved = np.zeros((3, *held.shape))
    moved[:, tip, 0] = np.array([0.001, -0.002, 0.0005])[:, None] * box.nodes[tip, 1] / 0.08
    together = box.hold(held).solve(moved)
    monkeypatch.setattr(elasticity, "MOST_FACTORISED", 0)
    iterated = box.hold(held).solve(moved)
    for row in range(3):
        alone = box.hold(held).solve(moved[row])
        np.testing.assert_allclose(together.displacement[row], alone.displacement, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(iterated.displacement, together.displacement, atol=1e-11)
    np.testing.assert_allclose(together.displacement[1], -2.0 * together.displacement[0], atol=1e-14)


def test_a_box_that_is_held_everywhere_has_the_forces_of_its_strain() -> None:
    """Without a free node there is nothing to solve."""
    box, poisson, strain = uneven_box(0.3), 0.3, 0.01
    found = box.hold(np.ones(box.nodes.shape, bool)).solve(box.nodes * [strain, 0.0, 0.0])
    stress = YOUNG * (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson)) * strain
    end = box.plane(0, box.axes[0][-1])
    assert found.force[end, 0].sum() == pytest.approx(stress * np.ptp(box.axes[1]) * np.ptp(box.axes[2]), rel=1e-9)


def test_what_cannot_be_solved_is_refused() -> None:
    axis = np.linspace(0.0, 0.1, 3)
    box = ElasticBox(axis, axis, axis, young=1e4, poisson=0.3)
    sliding = np.zeros(box.nodes.shape, dtype=bool)
    sliding[box.plane(2, 0.0), 2] = True
    with pytest.raises(InputError, match="rigid motion"):
        box.hold(sliding)
    with pytest.raises(InputError, match=r"below 0\.5"):
        ElasticBox(axis, axis, axis, young=1e4, poisson=0.5)
    with pytest.raises(InputError, match="rising"):
        ElasticBox(axis, axis[::-1], axis, young=1e4, poisson=0.3)
    with pytest.raises(InputError, match="one per element"):
        ElasticBox(axis, axis, axis, young=np.ones(3), poisson=0.3)
    with pytest.raises(InputError, match="points within"):
        box.sample(np.zeros(box.nodes.shape), np.array([[0.0, 0.0, 0.2]]))


@pytest.mark.parametrize("poisson", [0.0, 0.25, 0.49])
def test_the_thesis_cube_is_as_another_solver_has_it(poisson: float, shared_data: Path) -> None:
    """CalculiX's 20-node elements on the same mesh."""
    with np.load(shared_data / "fem" / f"cube_lin_n06_d3cm_nu{poisson:.2f}.npz") as file:
        place, wanted, force = file["X"], file["u"], float(file["top_force"])
    box, found = pressed_cube(poisson, 6, push=0.03)
    np.testing.assert_allclose(box.sample(found.displacement, place), wanted, atol=2e-7)
    assert found.force[box.plane(2, 0.1), 2].sum() == pytest.approx(force, rel=1e-5)
