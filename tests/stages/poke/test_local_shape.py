"""A touch of uneven foam, as it would be on a level layer: against finite elements, and what must hold of any shape."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.scenes import Piece, Scene, initial_modulus_pa
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld
from deformscope.stages.poke.local_shape import LocalShape, shape_of, shape_shift
from deformscope.stages.regions.levels import RegionPrior
from studies.touching import force_curve

RADIUS_M, FORCE_N, REFERENCE_M = 0.01, 3.0, 0.04
STEP_M = 0.01
AROUND = STEP_M * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])


def _slab(thickness_m: float, rise_m: float = 0.0, wave_m: float = 0.06) -> Scene:
    """Foam of 60 kPa with a crest or a hollow of an egg-crate at (0.3, 0.2)."""

    def bumps(xy: FloatArray) -> FloatArray:
        turned = 2.0 * np.pi / wave_m * (np.asarray(xy) - (0.3, 0.2))
        return np.asarray(rise_m * np.cos(turned[..., 0]) * np.cos(turned[..., 1]))

    slab = Scene("homogeneous", 0, (Piece("foam", 60e3),), {}, thickness_m=thickness_m)
    return slab if rise_m == 0.0 else replace(slab, _bumps=bumps)


def _dent_m(scene: Scene, xy_m: FloatArray) -> float:
    """Of the ball at the force, in finite elements [m]."""
    normal = scene.normal(xy_m)
    rest = np.append(xy_m, scene.foam_height_m(xy_m)) + RADIUS_M * normal
    depth_m, force_n = force_curve(SlabWorld(scene), RigidTip(radius=RADIUS_M), rest, normal, 1.1 * FORCE_N, 0.015)
    return float(np.interp(FORCE_N, force_n, depth_m))


@pytest.fixture(scope="module")
def level_m() -> float:
    """The dent in a level layer of the reference thickness [m]."""
    return _dent_m(_slab(REFERENCE_M), np.array([0.3, 0.2]))


@pytest.mark.parametrize(
    ("scene", "xy_m", "felt_apart"),
    [
        (_slab(0.02), (0.3, 0.2), 0.05),  # half as thick
        (_slab(REFERENCE_M), (0.01, 0.2), 0.09),  # 1 cm from the edge
        (_slab(REFERENCE_M, 0.005), (0.3, 0.2), 0.1),  # a crest
        (_slab(REFERENCE_M, -0.005), (0.3, 0.2), 0.1),  # a hollow
        (_slab(REFERENCE_M, 0.005), (0.315, 0.2), 0.0),  # a flank
    ],
    ids=["thin", "edge", "crest", "hollow", "flank"],
)
def test_touch_of_uneven_foam_compares_as_on_a_level_layer(
    scene: Scene, xy_m: tuple[float, float], felt_apart: float, level_m: float
) -> None:
    place = np.array(xy_m)
    felt_m = _dent_m(scene, place)
    shape = shape_of(scene.foam_height_m(place + AROUND), np.full(5, 1e-4), STEP_M, float(place.min()), least_m=0.005)
    shift = shape_shift(shape, felt_m, reference_m=REFERENCE_M, radius_m=RADIUS_M)
    off = np.log(level_m / felt_m)  # what it is stiffer by
    assert abs(off) >= felt_apart
    assert abs(off + shift.log) < max(0.02, 2.0 * shift.sd)


@pytest.mark.slow  # 30 meshes
def test_edge_is_corrected_from_1_cm_on(capsys: pytest.CaptureFixture[str]) -> None:
    """Prints what is felt less than inside, before and after: the table of docs/results/maps.md."""
    away_m = (0.01, 0.015, 0.02, 0.03)
    felt, left = [], []
    for thickness_m in (0.02, 0.035, 0.05):
        for modulus_pa in (37e3, 93e3):
            slab = replace(_slab(thickness_m), pieces=(Piece("foam", modulus_pa),))
            dents_m = [_dent_m(slab, np.array([one, 0.2])) for one in (0.3, *away_m)]
            shapes = [LocalShape(thickness_m, edge_m=one) for one in away_m]
            felt.append(np.log(dents_m[0] / np.array(dents_m[1:])))
            shifts = [shape_shift(*one, reference_m=thickness_m) for one in zip(shapes, dents_m[1:], strict=True)]
            left.append(felt[-1] + [one.log for one in shifts])
    with capsys.disabled():
        print()
        for at_m, before, after in zip(away_m, np.transpose(felt), np.transpose(left), strict=True):
            ranges = " ".join(f"{one.min():+.3f} to {one.max():+.3f}" for one in (before, after))
            print(f"{1e3 * at_m:.0f} mm: {ranges}")
    assert np.min(felt) < -0.1
    assert np.abs(left).max() < 0.015


@pytest.mark.slow  # 12 meshes
def test_border_between_two_foams_is_felt_as_maps_take_it(capsys: pytest.CaptureFixture[str]) -> None:
    """60 and 150 N, by the distance to their border: what is felt of the other, and what maps expect of it."""
    away_m, border_m = (0.005, 0.01, 0.015, 0.02, 0.03), 0.3
    soft, firm = (Piece("foam", initial_modulus_pa(one)) for one in (60.0, 150.0))
    inside = [-np.log(_dent_m(replace(_slab(0.05), pieces=(one,)), np.array([0.3, 0.2]))) for one in (soft, firm)]
    glued = replace(
        _slab(0.05), pieces=(soft, firm), _label=lambda xy: (np.asarray(xy)[..., 0] > border_m).astype(np.int64)
    )
    for own, other, side in ((*inside, -1.0), (*inside[::-1], 1.0)):
        places = [np.array([border_m + side * one, 0.2]) for one in away_m]
        felt = np.array([-np.log(_dent_m(glued, place)) - own for place in places])
        share = ndtr(-np.array(away_m) / RegionPrior().blur_m)
        expected = np.log(1.0 - share + share * np.exp(other - own))
        with capsys.disabled():
            print(f"{'soft' if side < 0.0 else 'firm'}: felt {felt.round(3)}, expected {expected.round(3)}")
        assert np.abs(felt - expected).max() < 0.04


def test_level_layer_of_the_reference_thickness_is_left_as_it_is() -> None:
    shift = shape_shift(LocalShape(0.05), 0.004, reference_m=0.05)
    assert (shift.log, shift.sd) == (0.0, 0.0)


def test_thickness_there_and_back_cancels() -> None:
    down = shape_shift(LocalShape(0.02), 0.004, reference_m=0.05)
    deeper_m = 0.004 * float(np.exp(-down.log))  # the same force on the thicker layer
    up = shape_shift(LocalShape(0.05), deeper_m, reference_m=0.02)
    assert down.log < 0.0
    assert down.log + up.log == pytest.approx(0.0, abs=1e-6)


def test_doubt_grows_with_what_is_corrected_and_with_a_thickness_that_is_not_known() -> None:
    little, much = (shape_shift(LocalShape(one), 0.004, reference_m=0.05).sd for one in (0.04, 0.02))
    assert 0.0 < little < much
    assert shape_shift(LocalShape(0.04, thickness_sd_m=0.01), 0.004, reference_m=0.05).sd > little


def test_shape_of_a_ball_s_top_and_of_a_slope() -> None:
    radius_m = 0.2
    found = shape_of(np.sqrt(radius_m**2 - (AROUND**2).sum(axis=1)), np.full(5, 1e-3), STEP_M, -0.01, least_m=0.005)
    assert found.curvature_per_m == pytest.approx(1.0 / radius_m, rel=0.01)
    assert found.slope == pytest.approx(0.0)
    assert (found.edge_m, found.thickness_sd_m) == (0.0, 1e-3)
    slope = shape_of(0.03 + AROUND @ (0.3, 0.4), np.zeros(5), STEP_M, 0.1, least_m=0.005)
    assert slope.slope == pytest.approx(0.5)
    assert slope.curvature_per_m == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("thickness_m", [0.0, -0.01, float("nan")])
def test_no_thickness_is_refused(thickness_m: float) -> None:
    with pytest.raises(InputError, match="thickness"):
        LocalShape(thickness_m)
