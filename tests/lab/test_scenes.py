"""The laboratory's scenes: what is where, drawn from a seed within the stated ranges."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.scenes import BUILT_IN, DRAWN, RIGID_PA, built_in, initial_modulus_pa

SEEDS = range(20)


@pytest.mark.parametrize(("hardness_n", "modulus_pa"), [(60, 37e3), (110, 68e3), (150, 93e3)])
def test_hardness_becomes_the_initial_modulus(hardness_n: float, modulus_pa: float) -> None:
    assert initial_modulus_pa(hardness_n) == pytest.approx(modulus_pa, rel=0.01)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_seed_is_a_layout(name: str) -> None:
    """Every seed another one, the same seed the same one."""
    cells = built_in(name).cells_m()
    fields = [built_in(name, seed).modulus_pa(cells) for seed in SEEDS]
    for seed, field in enumerate(fields):
        np.testing.assert_array_equal(built_in(name, seed).modulus_pa(cells), field)
        assert all((field != other).any() for other in fields[:seed])


@pytest.mark.parametrize("name", BUILT_IN)
def test_what_is_drawn_lies_within_its_table(name: str) -> None:
    kind = next(kind for kind in sorted(DRAWN, key=len, reverse=True) if name.startswith(kind))
    ranges = {one.what: one for one in DRAWN[kind]}
    for seed in SEEDS:
        drawn = built_in(name, seed).drawn
        assert drawn.keys() == ranges.keys()
        assert all(ranges[what].low <= value <= ranges[what].high for what, value in drawn.items())


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "gradient"])
def test_every_region_is_there(name: str) -> None:
    """None is smaller than the soft spot, and each has one modulus, which differs from the others'."""
    for seed in SEEDS:
        scene = built_in(name, seed)
        truth, modulus = scene.truth(), scene.modulus_pa(scene.cells_m())
        labels, counts = np.unique(truth, return_counts=True)
        assert truth.shape == (80, 120)
        np.testing.assert_array_equal(labels, np.arange(scene.region_count))
        assert counts.min() > 0.9 * np.pi * 0.05**2 / 0.005**2
        assert len({float(modulus[truth == label][0]) for label in labels}) == scene.region_count
        assert all(np.ptp(modulus[truth == label]) == 0.0 for label in labels)


def test_both_ways_round_occur() -> None:
    corner = np.array([0.01, 0.01])
    firm_left = [built_in("two-60-150", seed).modulus_pa(corner) > 80e3 for seed in SEEDS]
    assert 4 <= sum(firm_left) <= 16
    patterns = [built_in("three-60-110-rigid", seed).drawn["pattern"] < 1.0 for seed in SEEDS]
    assert 4 <= sum(patterns) <= 16


def test_a_border_is_sharp_and_where_it_was_drawn() -> None:
    scene = built_in("two-60-150", 3)
    x, y = scene.drawn["border x"], scene.size_m[1] / 2
    left, right = scene.modulus_pa(np.array([[x - 1e-6, y], [x + 1e-6, y]]))
    assert {left, right} == {initial_modulus_pa(60), initial_modulus_pa(150)}


def test_the_rigid_region_is_known() -> None:
    scene = built_in("three-60-110-rigid", 5)
    (label,) = scene.rigid
    assert (scene.modulus_pa(scene.cells_m())[scene.truth() == label] == RIGID_PA).all()
    assert built_in("two-60-150").rigid == ()


def test_a_gradient_has_no_regions_and_is_even_in_the_logarithm() -> None:
    scene = built_in("gradient", 2)
    field = np.log(scene.modulus_pa(scene.cells_m()))
    assert scene.region_count == 0
    assert (scene.truth() == -1).all()
    np.testing.assert_allclose(np.diff(field, 2, axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.diff(field, 2, axis=1), 0.0, atol=1e-9)
    corners = scene.modulus_pa(np.array([[0, 0], [0.6, 0], [0, 0.4], [0.6, 0.4]]))
    assert corners.min() == pytest.approx(initial_modulus_pa(scene.drawn["softest"]))
    assert corners.max() == pytest.approx(initial_modulus_pa(scene.drawn["firmest"]))


UNEVEN = {"wedge", "step", "egg-crate", "thin-thick"}


def test_only_the_bumpy_surface_and_those_named_for_it_are_not_flat() -> None:
    middle = np.array([0.31, 0.17])
    for name in BUILT_IN.keys() - UNEVEN:
        scene = built_in(name, 1)
        height = scene.height_m(scene.cells_m())
        if name != "bumpy":
            assert np.ptp(height) == 0.0
            np.testing.assert_array_equal(scene.normal(middle), [0.0, 0.0, 1.0])
            continue
        assert 0.005 < np.ptp(height) < 0.024
        along = np.array([1e-3, 2e-3])
        chord = np.append(2 * along, scene.height_m(middle + along) - scene.height_m(middle - along))
        assert abs(scene.normal(middle) @ chord) < 1e-3 * np.linalg.norm(chord)
        assert np.linalg.norm(scene.normal(middle)) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", [1000, 1001])
@pytest.mark.parametrize(
    ("name", "lowest_m", "highest_m"),
    [("wedge", 0.02, 0.05), ("step", 0.02, 0.05), ("thin-thick", 0.02, 0.05), ("egg-crate", 0.045, 0.055)],
)
def test_uneven_slabs_are_as_thin_and_as_thick_as_they_are_said_to_be(
    name: str, lowest_m: float, highest_m: float, seed: int
) -> None:
    scene = built_in(name, seed)
    height = scene.height_m(scene.cells_m())
    assert (height.min(), height.max()) == (pytest.approx(lowest_m, abs=1e-3), pytest.approx(highest_m, abs=1e-3))
    if name == "thin-thick":
        softer = scene.truth() == 0
        assert height[softer].mean() < 0.03 < 0.04 < height[~softer].mean()


def test_beside_the_slab_there_is_nothing() -> None:
    scene = built_in("two-60-150")
    beside = np.array([[-0.001, 0.2], [0.3, 0.401]])
    np.testing.assert_array_equal(scene.label(beside), -1)
    np.testing.assert_array_equal(scene.height_m(beside), 0.0)


def test_other_hardnesses_come_by_name() -> None:
    assert [piece.name for piece in built_in("three-40-rigid-200").pieces] == ["40", "rigid", "200"]
    assert built_in("disc-80-160", 1).region_count == 2


@pytest.mark.parametrize(
    "name", ["", "two", "two-60", "homogeneous-60-70", "gradient-3", "disk", "two-0-60", "Two-6-7"]
)
def test_what_is_no_scene_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="expected"):
        built_in(name)


def test_a_ring_has_a_hole() -> None:
    """Of the material around it; the foam between two circles is another."""
    for seed in SEEDS:
        scene = built_in("ring", seed)
        middle, radius, width = (
            np.array([scene.drawn["centre x"], scene.drawn["centre y"]]),
            *(scene.drawn[name] for name in ("radius", "width")),
        )
        along = middle + np.outer([0.0, radius - width - 1e-3, radius - width / 2, radius + 1e-3], [0.0, 1.0])
        hole, inner, ring, around = scene.label(along)
        assert hole == inner == around != ring


def test_a_zigzag_runs_straight_between_its_points() -> None:
    scene = built_in("zigzag", 1)
    border = np.abs(np.diff(scene.truth(), axis=1)).argmax(axis=1) * 5e-3  # of one crossing in each row
    aside = border + np.tan(np.deg2rad(scene.drawn["border tilt"])) * 5e-3 * np.arange(len(border))
    height, length = scene.drawn["wave height"], scene.drawn["wave length"]
    assert np.ptp(aside) == pytest.approx(2 * height, rel=0.25)
    slope = np.abs(aside[10:] - aside[:-10]) / 0.05
    assert np.median(slope) == pytest.approx(4 * height / length, rel=0.25)


def test_a_lump_lies_on_either_side_of_the_border() -> None:
    around = set()
    for seed in SEEDS:
        scene = built_in("lump", seed)
        middle = np.array([scene.drawn["centre x"], scene.drawn["centre y"]])
        assert scene.label(middle) == 2
        assert scene.rigid == (2,)
        around |= set(scene.label(middle + 0.061 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])).tolist())
    assert around == {0, 1}
