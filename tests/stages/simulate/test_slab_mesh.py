"""The mesh of a slab for other simulators."""

from dataclasses import replace

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.model import Observation
from deformscope.stages.msm.poke import Tip
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_fit import SeenPoke
from deformscope.stages.simulate.slab_mesh import block_of, slab_around, slab_mesh

AXES = (np.linspace(0.0, 0.1, 5), np.linspace(-0.02, 0.05, 4), np.linspace(0.01, 0.03, 4))
NONE = np.zeros((0, 3))


def surface(side: float = 0.2, hole: float = 0.0) -> MeasuredSurface:
    axis = np.arange(0.0, side + 1e-9, 0.005)
    points = np.stack(np.meshgrid(axis, axis, [0.03], indexing="ij"), axis=-1).reshape(-1, 3)
    return MeasuredSurface(points[np.linalg.norm(points[:, :2] - 0.5 * side, axis=1) >= hole], 0.03)


def poke(at: tuple[float, float]) -> SeenPoke:
    return SeenPoke(np.array([*at, 0.03]), Tip("sphere", (0.02,)), 0.002, NONE, NONE, NONE, NONE, None, 1.0)


def test_the_tetrahedra_fill_the_slab_and_its_outside_is_closed() -> None:
    mesh = slab_mesh(AXES)
    edges = mesh.vertices[mesh.elements[:, 1:]] - mesh.vertices[mesh.elements[:, :1]]
    volumes = np.linalg.det(edges) / 6.0
    assert (volumes > 0.0).all()
    assert volumes.sum() == pytest.approx(0.1 * 0.07 * 0.02, rel=1e-12)
    faces = mesh.outside()
    along = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert {tuple(one) for one in along} == {tuple(one[::-1]) for one in along}
    assert len({tuple(one) for one in along}) == len(along)
    # by the divergence theorem the outside encloses the volume, with its normals outwards
    corner = mesh.vertices[faces]
    inside = np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() / 6.0
    assert inside == pytest.approx(volumes.sum(), rel=1e-12)


def test_neighbouring_cells_share_their_diagonals() -> None:
    """A face inside belongs to exactly two tetrahedra; the mesh is conforming."""
    elements = slab_mesh(AXES).elements
    faces = np.sort(elements[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1)
    _, count = np.unique(faces, axis=0, return_counts=True)
    assert set(count.tolist()) == {1, 2}


def test_values_of_the_surface_are_interpolated_and_beyond_it_nothing_moves() -> None:
    mesh = slab_mesh(AXES)
    linear: FloatArray = mesh.vertices @ np.array([[1.0, 0.0, 2.0], [0.0, 3.0, 0.0], [5.0, 0.0, 0.0]])
    places = np.array([[0.033, 0.011], [0.1, 0.05], [0.2, 0.0]])
    expected = np.column_stack([places, [0.03] * 3]) @ np.array([[1.0, 0.0, 2.0], [0.0, 3.0, 0.0], [5.0, 0.0, 0.0]])
    expected[2] = 0.0
    np.testing.assert_allclose(mesh.at_surface(linear, places), expected, atol=1e-12)


def test_the_slab_is_the_part_around_the_pokes_with_about_so_many_vertices() -> None:
    mesh = slab_around(surface(), [poke((0.1, 0.1)), poke((0.11, 0.09))], None, 800)
    assert 400 <= len(mesh.vertices) <= 1000
    assert mesh.size[2] == pytest.approx(0.03)
    assert mesh.axes[0][0] < 0.1 - 0.01 - 0.02
    assert mesh.axes[0][-1] > 0.11 + 0.01 + 0.02
    width, height = (float(np.diff(mesh.axes[axis])[0]) for axis in (0, 2))
    assert 1.0 < height / width < 2.5
    assert slab_around(surface(), [poke((0.1, 0.1))], 0.01, 800).cells[2] == 3
    assert slab_around(surface(), [poke((0.015, 0.1))], None, 800).axes[0][0] == 0.0
    wider = slab_around(surface(), [poke((0.1, 0.1))], None, 800, beyond=0.06)
    np.testing.assert_allclose(wider.size[:2], 2.0 * (poke((0.1, 0.1)).tip.half + 0.06))


def test_what_cannot_be_meshed_is_refused() -> None:
    for body, at, spacing, said in (
        (surface(), (0.25, 0.1), None, "one at (0.25, 0.1) m"),
        (surface(), (0.195, 0.1), None, "pokes on the surface"),
        (surface(hole=0.045), (0.1, 0.16), None, "a hole"),
        (surface(), (0.1, 0.1), 0.001, "a larger --spacing-m"),
    ):
        with pytest.raises(InputError, match=said.replace("(", r"\(").replace(")", r"\)")):
            slab_around(body, [poke(at)], spacing, 800)


def test_boxes_of_one_material_fill_the_slab_once() -> None:
    material = np.zeros((4, 3, 3), np.int64)
    material[1:3, 1:, :] = 1
    material[0, 0, 2] = 2
    mesh = slab_mesh(AXES, material)
    filled = np.zeros(material.shape, np.int64)
    for one, box in mesh.boxes():
        filled[box] += 1
        assert (material[box] == one).all()
    assert (filled == 1).all()
    assert len(slab_mesh(AXES).boxes()) == 1
    middle = mesh.vertices[mesh.elements].mean(axis=1)
    cell = [np.searchsorted(axis, middle[:, at]) - 1 for at, axis in enumerate(AXES)]
    np.testing.assert_array_equal(mesh.element_material(), material[tuple(cell)])


def test_the_material_of_a_cell_is_that_at_its_middle() -> None:
    def material(places: FloatArray) -> np.ndarray:
        return (places[:, 0] > 0.1).astype(np.int64)

    mesh = slab_around(surface(), [poke((0.1, 0.1))], None, 1000, material)
    middle = 0.5 * (mesh.axes[0][1:] + mesh.axes[0][:-1])
    for layer in range(mesh.cells[2]):
        np.testing.assert_array_equal(mesh.material[:, 0, layer], middle > 0.1)


def block(count: tuple[int, ...], order: bool = False) -> Observation:
    """A block of particles .01 m apart, pulled along its first axis. order: particles in any order, with their cells"""
    rest = 0.01 * np.stack(np.meshgrid(*(np.arange(one) for one in count), indexing="ij"), -1).reshape(-1, len(count))
    cell = np.random.default_rng(3).permutation(len(rest)) if order else np.arange(len(rest))
    rest = rest[cell]
    ends = np.flatnonzero(rest[:, 0] == rest[:, 0].max())
    seen = np.ones(len(rest), bool)
    return Observation(rest, 1.01 * rest, ends, seen, shape=count, cell=cell)


@pytest.mark.parametrize("order", [False, True])
def test_a_blocks_vertices_are_its_particles(order: bool) -> None:
    seen = block((3, 4, 2), order)
    noise = 2e-4 * np.sin(np.arange(seen.rest.size)).reshape(-1, 3)
    mesh, particle = block_of(replace(seen, rest=seen.rest + noise))
    assert mesh.cells == (2, 3, 1)
    np.testing.assert_allclose(mesh.vertices, seen.rest[particle], atol=3e-4)
    for axis in mesh.axes:  # MuJoCo's cells are all alike
        np.testing.assert_allclose(np.diff(axis), np.diff(axis)[0], rtol=1e-12)


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (block((4, 3)), "got a sheet"),
        (block((4, 3, 1)), "got a sheet"),
        (replace(block((4, 3, 3)), shape=None, cell=None), "got particles in other rows, or none"),
        (replace(block((4, 3, 3)), shape=(3, 3, 4)), "got particles in other rows, or none"),
        (replace(block((4, 3, 3)), shape=(5, 3, 3)), "got particles in other rows, or none"),
    ],
)
def test_what_is_no_block_is_refused(seen: Observation, said: str) -> None:
    with pytest.raises(InputError, match=said):
        block_of(seen)
