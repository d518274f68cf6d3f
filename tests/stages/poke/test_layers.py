"""Layers below a surface: where the particles stand, and what lies between their columns."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.msm import clusters
from deformscope.stages.poke.layers import FlatEdge, MeasuredSurface, below


def surface_points(height: float = 0.05, slope: float = 0.0, spacing: float = 0.01) -> FloatArray:
    x, y = np.meshgrid(np.arange(21) * spacing, np.arange(13) * spacing, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), height + slope * x.ravel()])


def test_a_flat_surface_becomes_an_even_lattice_whose_lowest_layer_is_the_ground() -> None:
    layers = below(MeasuredSurface(surface_points(), 0.03), spacing=0.01)
    assert layers.shape == (21, 13, 4)
    np.testing.assert_allclose(layers.rest[layers.top, 2], 0.05)
    np.testing.assert_allclose(layers.rest[layers.bottom, 2], 0.02)
    np.testing.assert_allclose(np.unique(layers.rest[:, 2].round(12)), [0.02, 0.03, 0.04, 0.05])
    found = clusters.find_lattice(layers.rest)
    assert found[0] == layers.shape
    np.testing.assert_array_equal(found[1], layers.cell)


def test_layers_divide_the_thickness_evenly_and_are_two_at_least() -> None:
    assert below(MeasuredSurface(surface_points(), 0.032), spacing=0.01).shape[2] == 4
    assert below(MeasuredSurface(surface_points(), 0.002), spacing=0.01).shape[2] == 2


def test_a_column_stands_at_the_centre_and_the_lattice_ends_at_the_reach_and_at_the_edge() -> None:
    layers = below(MeasuredSurface(surface_points(), 0.03), spacing=0.007, centre=np.array([0.19, 0.06]), reach=0.03)
    place = layers.rest[layers.top, :2]
    assert np.linalg.norm(place - [0.19, 0.06], axis=1).min() < 1e-12
    assert place[:, 0].min() >= 0.16 - 1e-9
    assert place[:, 0].max() <= 0.2 + 1e-9
    assert np.ptp(place[:, 1]) == pytest.approx(8 * 0.007)


def test_a_tilted_surface_is_a_plane_and_a_wavy_one_is_followed() -> None:
    tilted = below(MeasuredSurface(surface_points(slope=0.2), 0.03), spacing=0.01)
    np.testing.assert_allclose(tilted.rest[tilted.top, 2], 0.05 + 0.2 * tilted.rest[tilted.top, 0], atol=1e-12)
    wavy = surface_points()
    wavy[:, 2] += 0.004 * np.sin(60.0 * wavy[:, 0])
    layers = below(MeasuredSurface(wavy, 0.03), spacing=0.01)
    np.testing.assert_allclose(layers.rest[layers.top, 2], wavy[:, 2], atol=1e-9)
    np.testing.assert_allclose(layers.rest[layers.top, 2] - layers.rest[layers.bottom, 2], 0.03)


def test_noise_of_the_scan_does_not_make_the_lattice_uneven() -> None:
    noisy = surface_points()
    noisy[:, 2] += np.random.default_rng(0).normal(0.0, 2e-4, len(noisy))
    layers = below(MeasuredSurface(noisy, 0.03), spacing=0.01)
    assert np.ptp(layers.rest[layers.top, 2]) < 2e-4


def test_a_surface_with_a_notch_has_no_material_there_only_where_its_hull_ends() -> None:
    triangle = surface_points()
    triangle = triangle[triangle[:, 1] <= 0.6 * triangle[:, 0] + 1e-9]
    layers = below(MeasuredSurface(triangle, 0.03), spacing=0.01)
    place = layers.rest[layers.top, :2]
    assert (place[:, 1] <= 0.6 * place[:, 0] + 1e-6).all()
    assert len(layers.cell) == 4 * len(place) < np.prod(layers.shape)


def test_values_between_columns_are_bilinear_and_beyond_them_are_reported() -> None:
    layers = below(MeasuredSurface(surface_points(), 0.03), spacing=0.01)
    place = np.random.default_rng(1).uniform([0.0, 0.0], [0.2, 0.12], (50, 2))
    weights, inside = layers.interpolation(np.vstack([place, [[0.25, 0.05], [-0.01, 0.02]]]))
    x, y = layers.rest[:, 0], layers.rest[:, 1]
    found = weights @ (1.0 + 2.0 * x - 3.0 * y + 40.0 * x * y)
    expected = 1.0 + 2.0 * place[:, 0] - 3.0 * place[:, 1] + 40.0 * place[:, 0] * place[:, 1]
    np.testing.assert_allclose(found[:50], expected, rtol=1e-9)
    assert inside[:50].all()
    assert not inside[50:].any()


def test_beside_a_flat_tip_values_fall_as_the_root_of_the_distance() -> None:
    layers = below(MeasuredSurface(surface_points(), 0.03), spacing=0.01)
    edge = FlatEdge(np.array([0.1, 0.06]), np.array([0.02, 0.01]))
    under = (np.abs(layers.rest[:, :2] - edge.middle) <= edge.half + 1e-9).all(axis=1)
    place = np.array([[0.1, 0.06], [0.12, 0.06], [0.1225, 0.06], [0.0775, 0.06], [0.1, 0.0725], [0.1225, 0.1]])
    weights, _ = layers.interpolation(place, edge)
    np.testing.assert_allclose(weights @ np.where(under, 1.0, 0.2), [1.0, 1.0, 0.6, 0.6, 0.6, 0.2], atol=1e-4)
    far = FlatEdge(edge.middle, np.array([0.025, 0.01]))  # between columns: full depth up to the edge itself
    weights, _ = layers.interpolation(np.array([[0.124, 0.06], [0.12625, 0.06]]), far)
    np.testing.assert_allclose(weights @ np.where(under, 1.0, 0.2), [1.0, 0.6], atol=1e-4)


def test_the_outermost_columns_stand_for_what_is_less_than_a_cell_beyond_them() -> None:
    layers = below(MeasuredSurface(surface_points(), 0.03), spacing=0.01, centre=np.array([0.005, 0.005]))
    weights, inside = layers.interpolation(np.array([[0.0, 0.005], [0.0, 0.0]]))
    assert inside.all()
    np.testing.assert_allclose(weights @ layers.rest[:, 0], 0.005)


@pytest.mark.parametrize(
    ("points", "thickness", "said"),
    [
        (np.zeros((3, 3)), 0.03, "at least 4 points"),
        (surface_points(), 0.0, "thickness above 0"),
        (np.column_stack([np.linspace(0, 1, 9), np.linspace(0, 2, 9), np.zeros(9)]), 0.03, "above one line"),
        (np.vstack([surface_points(), surface_points() - [0.0, 0.0, 0.01]]), 0.03, "one height at each place"),
        (np.where(np.arange(3) == 2, np.nan, surface_points()), 0.03, "finite"),
    ],
)
def test_what_is_no_surface_is_refused(points: FloatArray, thickness: float, said: str) -> None:
    with pytest.raises(InputError, match=said):
        MeasuredSurface(points, thickness)


def test_a_place_beside_the_surface_is_refused() -> None:
    with pytest.raises(InputError, match="a place within"):
        below(MeasuredSurface(surface_points(), 0.03), spacing=0.01, centre=np.array([0.9, 0.9]), reach=0.02)
