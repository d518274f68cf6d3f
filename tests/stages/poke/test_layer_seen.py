"""How thick foam is, and what of its modulus follows: said, seen over the table beside it, or not known."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.poke.contact import layer_modulus
from deformscope.stages.poke.layer_seen import KnownLayer, TableSeen, find_table, known_layer, modulus_of

SIZE_M = (0.6, 0.4)
LEVEL = np.full(50, 0.05)


def around(height_m: float, noise_m: float = 0.0) -> FloatArray:
    """Points of a slab of 5 cm and of what it lies on, as high as that."""
    x, y = (one.ravel() for one in np.meshgrid(np.linspace(-0.12, 0.72, 120), np.linspace(-0.12, 0.52, 90)))
    inside = (x > 0.0) & (x < SIZE_M[0]) & (y > 0.0) & (y < SIZE_M[1])
    noise = np.random.default_rng(1000).normal(0.0, noise_m, len(x)) if noise_m else 0.0
    return np.column_stack([x, y, np.where(inside, 0.05, height_m) + noise])


@pytest.mark.parametrize("height_m", [0.0, -0.004, 0.006])
def test_table_is_seen_beside_the_surface_as_high_as_it_is(height_m: float) -> None:
    found = find_table(around(height_m, 1e-3), SIZE_M)
    assert found.height_m == pytest.approx(height_m, abs=1e-4)
    assert found.sd_m == pytest.approx(1e-3, rel=0.1)


def test_no_table_is_made_up_from_the_surface_or_from_what_stands_beside_it() -> None:
    points = around(0.0)
    on_it = (points[:, :2] > 0.0).all(axis=1) & (points[:, :2] < SIZE_M).all(axis=1)
    assert find_table(points[on_it], SIZE_M) is None
    assert find_table(around(0.05), SIZE_M) is None
    assert find_table(np.zeros((0, 3)), SIZE_M) is None


def test_stated_thickness_is_that_of_a_level_surface_and_the_seen_one_counts_where_it_is_uneven() -> None:
    assert known_layer(LEVEL, None, stated_m=0.05) == KnownLayer(0.05)
    assert known_layer(np.linspace(0.02, 0.05, 9), None, stated_m=0.05).uneven
    assert known_layer(LEVEL, None, stated_m=0.03).uneven  # not as thick as stated


def test_thickness_that_nobody_stated_is_taken_from_the_table_or_is_not_known() -> None:
    assert known_layer(LEVEL, TableSeen(-0.004, 0.001), stated_m=None).thickness_m == pytest.approx(0.054)
    assert known_layer(LEVEL, None, stated_m=None) == KnownLayer(None)
    assert known_layer(np.full(9, 0.001), TableSeen(0.0, 0.001), stated_m=None) == KnownLayer(None)


def test_modulus_has_an_interval_by_stiffness_and_by_thickness_and_is_not_known_without() -> None:
    def found(layer: KnownLayer) -> tuple[float, float, float]:
        modulus = modulus_of(layer, 0.6, (0.57, 0.63), force_n=3.0, radius_m=0.01)
        return modulus.interval_pa[0], modulus.pa, modulus.interval_pa[1]

    ends = [layer_modulus(1e-3 * 3.0 / one, 3.0, thickness_m=0.03) for one in (0.57, 0.6, 0.63)]
    assert found(KnownLayer(0.03)) == pytest.approx(ends, rel=1e-9)
    low, middle, high = found(KnownLayer(0.03, sd_m=0.005))
    assert middle == pytest.approx(ends[1])
    assert low < ends[0]
    assert high > ends[2]
    assert modulus_of(KnownLayer(None), 0.6, (0.57, 0.63), force_n=3.0, radius_m=0.01) is None
