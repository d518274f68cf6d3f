"""Triangles between particles: areas and skins of known size, holes that stay open, dents that are not bridged."""

import numpy as np
import pytest

from deformscope.stages.see.triangulation import is_surface, raster, spacing_of, triangulate


def grid(*counts: int) -> np.ndarray:
    """Points one apart."""
    axes = np.meshgrid(*(np.arange(count, dtype=float) for count in counts), indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, len(counts))


def area(points: np.ndarray, triangles: np.ndarray) -> float:
    corners = np.pad(points, [(0, 0), (0, 3 - points.shape[1])])[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(0.5 * np.linalg.norm(normal, axis=1).sum())


def test_area_in_the_plane_with_a_hole_and_a_notch() -> None:
    points = grid(9, 7)
    assert area(points, triangulate(points)) == pytest.approx(8 * 6)
    inside = (np.abs(points[:, 0] - 4) < 1.5) & (np.abs(points[:, 1] - 3) < 1.5)
    holed = points[~inside]
    assert area(holed, triangulate(holed)) == pytest.approx(8 * 6 - 16 + 4 * 0.5)  # its corners are cut
    notched = points[~((np.abs(points[:, 0] - 4) < 1.5) & (points[:, 1] > 1.5))]
    assert area(notched, triangulate(notched)) == pytest.approx(8 * 6 - 4 * 5 + 2 * 0.5)


def test_a_stretched_grid_is_whole() -> None:
    points = grid(6, 9) * [3.0, 1.0]
    assert area(points, triangulate(points)) == pytest.approx(5 * 3 * 8)


def test_skin_of_a_volume_is_closed() -> None:
    points = grid(5, 4, 3)
    triangles = triangulate(points)
    assert not is_surface(points)
    assert area(points, triangles) == pytest.approx(2 * (4 * 3 + 4 * 2 + 3 * 2))
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count % 2 == 0).all()
    assert not np.isin(np.ravel_multi_index((2, 1, 1), (5, 4, 3)), triangles)  # a particle inside


def test_a_surface_in_space_that_is_tilted_and_bent() -> None:
    flat = grid(12, 9)
    bent = np.column_stack([flat, 0.02 * flat[:, 0] ** 2])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert is_surface(bent @ turn.T)
    assert len(triangulate(bent @ turn.T)) == 2 * 11 * 8


def test_nothing_where_there_is_no_area() -> None:
    assert triangulate(grid(5, 1)).shape == (0, 3)
    assert triangulate(grid(2, 1)).shape == (0, 3)
    flat = grid(8, 8)
    folded = np.concatenate([np.column_stack([flat, np.zeros(64)]), np.column_stack([flat, np.full(64, 5.0)])])
    assert triangulate(folded).shape == (0, 3)


def test_raster_of_a_linear_function_is_exact_and_moves_with_the_particles() -> None:
    rest = grid(7, 5)
    place = rest @ np.array([[1.1, 0.1], [0.05, 0.9]]).T + [10.0, -3.0]
    value, low, side = raster(rest, place, 2.0 * place[:, 0] - 0.5 * place[:, 1], 60)
    rows, columns = np.nonzero(np.isfinite(value))
    x, y = low[0] + (columns + 0.5) * side, low[1] + (rows + 0.5) * side
    np.testing.assert_allclose(value[rows, columns], 2.0 * x - 0.5 * y, atol=1e-9)
    determinant = 1.1 * 0.9 - 0.1 * 0.05
    assert len(rows) * side**2 == pytest.approx(6 * 4 * determinant, rel=0.02)
    assert value.shape[1] == 60


def test_raster_does_not_fill_a_dent_in_the_edge() -> None:
    rest = grid(9, 5)
    top = rest[:, 1] == 4
    place = rest.copy()
    place[top, 1] -= 0.9 * np.exp(-((rest[top, 0] - 4) ** 2))
    value, low, side = raster(rest, place, np.ones(len(rest)), 160)
    over_the_dent = value[int((3.4 - low[1]) / side), int((4.0 - low[0]) / side)]
    beside_it = value[int((3.4 - low[1]) / side), int((0.5 - low[0]) / side)]
    assert np.isnan(over_the_dent)
    assert beside_it == 1.0


def test_raster_of_too_little_is_empty() -> None:
    assert np.isnan(raster(grid(2, 1), grid(2, 1), np.ones(2), 8)[0]).all()
    assert np.isnan(raster(grid(6, 1), grid(6, 1), np.ones(6), 8)[0]).all()


def test_spacing() -> None:
    assert spacing_of(grid(4, 4) * 3.0) == 3.0
    assert spacing_of(np.zeros((1, 2))) == 0.0
    assert spacing_of(np.concatenate([grid(4, 4), np.full((3, 2), np.nan)])) == 1.0
