"""beta of one touch: our own model's comes back from raw heights, foam's lies at the bound whatever its modulus."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab import slab
from deformscope.stages.map.surface import HeightProcess, fit_surface
from deformscope.stages.map.touch_beta import BallContact, fit_touch
from deformscope.stages.msm.poke import Law, Poke, Tip, press
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_fit import scene_below
from deformscope.stages.see.cloud import contact_radius_m

THICKNESS, RADIUS, AT = 0.05, 0.01, np.array([0.1, 0.1])


def world(noise: float = 0.0, seed: int = 0) -> HeightProcess:
    """The surface before: level, 0.2 x 0.2 m."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(size=(2000, 2)) * 0.2
    heights = THICKNESS + rng.normal(size=2000) * max(noise, 1e-6)
    return fit_surface(np.column_stack([places, heights]), within_m=((0.0, 0.0), (0.2, 0.2)))


def touch(depth: float) -> BallContact:
    return BallContact(np.array([*AT, THICKNESS - depth]), RADIUS, depth, 3.0)


def seen(rng: np.random.Generator, places: FloatArray, sunk: FloatArray, noise: float) -> FloatArray:
    """Raw points of the surface, those under the stick missing."""
    points = np.column_stack([places, THICKNESS + sunk + rng.normal(size=len(places)) * noise])
    return points[np.linalg.norm(places - AT, axis=1) > 0.012]


def of_our_own(beta: float, depth: float, noise: float = 0.0) -> FloatArray:
    """Points of a surface that is our model at a known law, where they came to stand, sideways too."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(*2 * [np.linspace(0.0, 0.2, 41)], indexing="ij")
    ground = MeasuredSurface(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, THICKNESS)]), THICKNESS)
    spacing = contact_radius_m(RADIUS, depth)
    tip = Tip("disc", (spacing,), slips=False)
    scene, layers = scene_below(ground, AT, tip, spacing, 3)
    corners = np.linalg.norm(scene.rest[scene.open][:, :2] - AT, axis=1) < spacing
    rise = RADIUS - np.sqrt(RADIUS**2 - 0.5 * spacing**2)
    wide = dataclasses.replace(tip, shape="flat", size=(spacing, spacing))
    found = press(scene, Law(beta), Poke(np.array([*AT, THICKNESS]), wide, depth=depth - rise))
    assert set(scene.open[corners]) == set(found.touched)
    places = AT + rng.uniform(-0.06, 0.06, size=(2500, 2))
    weights, _ = layers.interpolation(places)
    moved = weights @ (found.position - scene.rest)
    return seen(rng, places + moved[:, :2], moved[:, 2], noise)


@pytest.fixture(scope="module")
def level() -> HeightProcess:
    return world()


@pytest.mark.parametrize("beta", [0.3, 0.7])
def test_a_known_beta_comes_back_from_heights_alone(level: HeightProcess, beta: float) -> None:
    found = fit_touch(level, of_our_own(beta, 0.006), touch(0.006), thickness_m=THICKNESS)
    assert found.estimate.value == pytest.approx(beta, abs=0.06)
    assert found.estimate.interval[0] - 0.02 <= beta <= found.estimate.interval[1] + 0.02
    assert found.estimate.converged
    assert len(found.fit.posed[0].touched) == 4
    away = np.linalg.norm(found.simulated_m[:, :2] - AT, axis=1)
    sunk = THICKNESS - found.simulated_m[:, 2]
    assert 0.004 < sunk[away < 0.008].min() < sunk[away < 0.008].max() < 0.006  # held to the ball
    assert np.abs(sunk[away > 0.06]).max() < 5e-4  # and still far away


@pytest.mark.slow
def test_noise_widens_the_interval_and_it_still_holds_the_truth(level: HeightProcess) -> None:
    widths = []
    for noise in (1e-4, 1e-3):
        found = fit_touch(level, of_our_own(0.6, 0.006, noise), touch(0.006), thickness_m=THICKNESS)
        low, high = found.estimate.interval
        assert low <= 0.6 <= high
        widths.append(high - low)
        assert found.sd < high - low
    assert widths[0] < widths[1]


@pytest.mark.slow
def test_on_linear_foam_beta_is_at_its_bound_for_soft_and_firm_alike() -> None:
    """Finite elements, a ball with 3 N: dents of two depths, and no trend with firmness."""
    x, y = np.meshgrid(*2 * [np.arange(0.05, 0.15, 0.002)], indexing="ij")
    places = np.column_stack([x.ravel(), y.ravel()])
    surface = np.column_stack([places, np.full(len(places), THICKNESS)])
    before = world(1e-4)
    for young in (20e3, 60e3):
        foam = slab.Slab((0.2, 0.2, THICKNESS), young, 0.3)
        dent = slab.press(foam, (0.1, 0.1), slab.RigidTip(radius=RADIUS), surface, force=3.0)
        after = seen(np.random.default_rng(2), places, dent.displaced[:, 2], 1e-4)
        reported = fit_touch(before, after, touch(dent.depth), thickness_m=THICKNESS).estimate
        assert reported.verdict == "at-bound"
        assert reported.interval[0] == 0.0
        assert reported.value < 0.2


def test_the_foams_edge_ends_the_lattice(level: HeightProcess) -> None:
    after = of_our_own(0.5, 0.006)
    whole = fit_touch(level, after, touch(0.006), thickness_m=THICKNESS)
    narrower = dataclasses.replace(level, box_m=((0.06, 0.0), (0.2, 0.2)))
    cut = fit_touch(narrower, after, touch(0.006), thickness_m=THICKNESS)
    assert cut.fit.posed[0].scene.rest[:, 0].min() >= 0.06 - 1e-9
    assert len(cut.fit.posed[0].scene.rest) < len(whole.fit.posed[0].scene.rest)


def test_too_few_points_and_touches_that_did_not_sink_in_are_refused(level: HeightProcess) -> None:
    with pytest.raises(InputError, match="points around the touch"):
        fit_touch(level, np.zeros((5, 3)), touch(0.004), thickness_m=THICKNESS)
    with pytest.raises(InputError, match="sunk in"):
        touch(0.0)
    elsewhere = BallContact(np.array([0.9, 0.9, 0.04]), RADIUS, 0.004)
    with pytest.raises(InputError):
        fit_touch(level, of_our_own(0.5, 0.006) + np.array([0.8, 0.8, 0.0]), elsewhere, thickness_m=THICKNESS)
