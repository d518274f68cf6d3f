"""Which particles form a cluster."""

import itertools

import numpy as np
import pytest

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm import clusters
from deformscope.stages.msm.clusters import LatticeClusters
from tests.stages.bodies import lattice


def test_windows_of_a_full_lattice() -> None:
    found = clusters.lattice(lattice((3, 4)), (3, 4), np.arange(12), 2)
    assert found.count == 2 * 3
    assert sorted(next(iter(found))) == [0, 1, 4, 5]
    # a corner is in one window, an edge in two, the inside in four
    assert found.cluster_counts().reshape(3, 4).tolist() == [[1, 2, 2, 1], [2, 4, 4, 2], [1, 2, 2, 1]]


def test_window_is_clipped_to_a_thin_lattice() -> None:
    found = clusters.lattice(lattice((2, 6)), (2, 6), np.arange(12), 5)
    assert found.count == 2
    assert all(len(row) == 10 for row in found)


def test_every_particle_beside_a_hole_is_in_a_cluster_that_spans_the_plane() -> None:
    full = lattice((6, 6))
    cell = np.setdiff1d(np.arange(36), [7, 8, 13, 14, 19, 26])
    found = clusters.lattice(full[cell], (6, 6), cell, 3)
    assert found.cluster_counts().min() >= 1
    assert all(clusters.rank(full[cell][row]) == 2 for row in found)


def test_a_particle_that_no_window_keeps_is_given_neighbours() -> None:
    full = lattice((2, 5))
    cell = np.array([0, 1, 5, 6, 2, 3, 4])  # a 2x2 block and a thin tail of one row
    found = clusters.lattice(full[cell], (2, 5), cell, 2)
    assert found.cluster_counts().min() >= 1
    tail = [row for row in found if 6 in row]
    assert tail
    assert all(clusters.rank(full[cell][row]) == 2 for row in tail)


def test_a_flat_sheet_in_space_keeps_its_flat_windows() -> None:
    assert clusters.lattice(np.column_stack([lattice((4, 4)), np.zeros(16)]), (4, 4, 1), np.arange(16), 3).count == 4


SHAPES = [(5,), (1, 6), (6, 1), (5, 6), (9, 3), (1, 4, 5), (4, 1, 5), (4, 5, 1), (3, 4, 5), (5, 5, 5), (2, 2, 9)]


def _windows_by_loop(
    rest: FloatArray, shape: tuple[int, ...], cell: IntArray, size: int
) -> list[tuple[tuple[int, ...], list[int]]]:
    """Corner and particles of every window that spans as many directions as a full one, looked up cell by cell."""
    directions = min(sum(n > 1 for n in shape), rest.shape[1])
    particle_of = {int(c): i for i, c in enumerate(cell)}
    width = [min(size, n) for n in shape]
    found = []
    for corner in itertools.product(*(range(n - w + 1) for n, w in zip(shape, width, strict=True))):
        row = []
        for step in itertools.product(*(range(w) for w in width)):
            place = int(np.ravel_multi_index(tuple(a + b for a, b in zip(corner, step, strict=True)), shape))
            if place in particle_of:
                row.append(particle_of[place])
        if len(row) > directions and clusters.rank(rest[row]) >= directions:
            found.append((corner, row))
    return found


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [0.0, 0.05, 0.25])
@pytest.mark.parametrize("size", [2, 3, 4, 9])
def test_windows_are_those_found_cell_by_cell(shape: tuple[int, ...], share: float, size: int) -> None:
    """Full lattices, and such with holes, particles in any order; a particle in no window is adopted by another."""
    rng = np.random.default_rng([*shape, size, int(100 * share)])
    full = lattice(shape)
    cell = rng.permutation(len(full))[: max(4, round(len(full) * (1.0 - share)))]
    rest = full[cell]
    found = clusters.lattice(rest, shape, cell, size)
    expected = _windows_by_loop(rest, shape, cell, size)
    counts = np.bincount(
        np.concatenate([np.zeros(0, int), *(row for _, row in expected)]).astype(int), minlength=len(cell)
    )
    if counts.min() == 0:
        assert not isinstance(found, LatticeClusters)
        assert [row.tolist() for row in found][: len(expected)] == [row for _, row in expected]
        assert found.count == len(expected) + np.count_nonzero(counts == 0)
        assert found.cluster_counts().min() >= 1
        return
    assert isinstance(found, LatticeClusters)
    assert found.count == len(expected)
    assert [tuple(place) for place in np.argwhere(found.corner)] == [corner for corner, _ in expected]
    np.testing.assert_array_equal(found.cluster_counts(), counts)  # before the lists are made, and after
    assert [row.tolist() for row in found] == [row for _, row in expected]
    np.testing.assert_array_equal(found.offsets, np.cumsum([0, *(len(row) for _, row in expected)]))
    np.testing.assert_array_equal(found.members, np.concatenate([row for _, row in expected]))
    assert found.members.dtype == found.offsets.dtype == np.int32
    np.testing.assert_array_equal(np.bincount(found.members, minlength=len(cell)), counts)


@pytest.mark.parametrize("kind", ["uneven", "even", "mirrored", "flat", "turned", "hole", "shuffled"])
def test_spacing_of_a_lattice_is_that_of_a_search(kind: str) -> None:
    rng = np.random.default_rng(len(kind))
    for shape in [(5, 4, 3), (6, 7), (2, 2, 9), (3, 3)]:
        dims = (1, *shape[1:]) if kind == "flat" else shape
        steps = [np.full(n, 0.0123) if kind == "even" else rng.uniform(0.5, 1.5, n) for n in dims]
        axes = [np.cumsum(step) * (-1.0 if kind == "mirrored" else 1.0) + rng.normal() for step in steps]
        rest = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(dims))
        cell = np.arange(len(rest))
        if kind == "turned":
            rest = rest @ np.linalg.qr(rng.normal(size=(len(dims), len(dims))))[0]
        elif kind in ("hole", "shuffled"):
            cell = np.delete(cell, 2) if kind == "hole" else rng.permutation(cell)
            rest = rest[cell]
        found = LatticeClusters(dims, cell, tuple(min(2, n) for n in dims), np.ones(dims, dtype=bool))
        assert found.spacing(rest) == clusters.spacing(rest)


def test_lists_are_kept_as_given() -> None:
    found = clusters.Clusters([np.array([3, 1]), np.array([0, 1, 2])], 4)
    assert [row.tolist() for row in found] == [[3, 1], [0, 1, 2]]


@pytest.mark.parametrize("shape", [(7, 15), (3, 4, 5), (4, 1, 6)])
def test_lattice_is_found_in_any_order_and_despite_jitter(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    rest = lattice(shape)
    order = rng.permutation(len(rest))
    jitter = rng.uniform(-0.004, 0.004, rest.shape) * 0.01
    found = clusters.find_lattice(rest[order] + jitter)
    assert found[0] == shape
    assert np.array_equal(found[1], order)


@pytest.mark.parametrize("what", ["cloud", "hole", "bent"])
def test_no_lattice_is_claimed_where_there_is_none(what: str) -> None:
    rng = np.random.default_rng(2)
    rest = lattice((5, 6))
    if what == "cloud":
        rest = rng.uniform(0, 0.1, (30, 2))
    elif what == "hole":
        rest = np.delete(rest, 12, axis=0)
    else:
        rest[:, 0] += 3.0 * (rest[:, 1] - 0.025) ** 2
    assert clusters.find_lattice(rest) is None


def test_nearest_clusters_cover_a_cloud() -> None:
    found = clusters.nearest(np.random.default_rng(3).uniform(0, 0.1, (50, 3)), 27)
    assert found.cluster_counts().min() >= 1
    assert {len(row) for row in found} == {27}
