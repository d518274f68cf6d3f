"""The table in closed form feels as the formulas say, and looks as deep as it is pressed."""

import numpy as np
import pytest

from deformscope.lab.live_lab import LayerWorld
from deformscope.lab.scenes import built_in

RADIUS_M = 0.01


def test_a_small_dent_is_hertz() -> None:
    scene = built_in("homogeneous-60", 0)
    modulus_pa = float(scene.modulus_pa(np.array([0.3, 0.2])))
    depth_m = 1e-5  # the layer is then as good as endless: chi = 0.006
    force_n = LayerWorld(scene, RADIUS_M).press(np.array([0.3, 0.2, 0.05 + RADIUS_M - depth_m]))
    hertz_n = 4.0 / 3.0 * modulus_pa / (1.0 - scene.poisson**2) * np.sqrt(RADIUS_M) * depth_m**1.5
    assert force_n == pytest.approx([0.0, 0.0, hertz_n], rel=0.02)


def test_firmer_foam_pushes_more_and_a_border_is_between() -> None:
    scene = built_in("two-60-150", 1)
    world = LayerWorld(scene, RADIUS_M)
    row = np.column_stack([np.linspace(0.05, 0.55, 51), np.full(51, 0.2)])
    forces_n = np.array([world.press(np.array([*xy, 0.05 + RADIUS_M - 0.003]))[2] for xy in row])
    moduli_pa = scene.modulus_pa(row)
    assert forces_n.max() / forces_n.min() == pytest.approx(moduli_pa.max() / moduli_pa.min(), rel=1e-9)
    assert np.all(np.diff(forces_n) >= -1e-9) or np.all(np.diff(forces_n) <= 1e-9)
    assert len(np.unique(forces_n.round(9))) > 2


@pytest.mark.parametrize("center_m", [(0.3, 0.2, 0.0601), (-0.01, 0.2, 0.055), (0.3, 0.41, 0.055)])
def test_above_and_beside_there_is_nothing(center_m: tuple[float, float, float]) -> None:
    world = LayerWorld(built_in("homogeneous-60", 0), RADIUS_M)
    assert world.press(np.array(center_m)) == pytest.approx(np.zeros(3))
    assert not world.displaced_m(np.array([center_m[:2]])).any()


def test_the_dent_is_the_ball_and_fades_away() -> None:
    world = LayerWorld(built_in("homogeneous-60", 0), RADIUS_M)
    depth_m = 0.004
    world.press(np.array([0.3, 0.2, 0.05 + RADIUS_M - depth_m]))
    aside_m = np.array([0.0, 0.002, 0.02, 0.04])
    edges_m = np.sqrt(RADIUS_M * depth_m) * np.array([1.0 - 1e-9, 1.0 + 1e-9])
    moved_m = world.displaced_m(np.column_stack([0.3 + aside_m, np.full(4, 0.2)]))[:, 2]
    edge_m = world.displaced_m(np.column_stack([0.3 + edges_m, np.full(2, 0.2)]))[:, 2]
    assert moved_m[0] == pytest.approx(-depth_m)
    assert moved_m[1] == pytest.approx(-depth_m + 0.002**2 / (2 * RADIUS_M))
    assert edge_m[0] == pytest.approx(edge_m[1], abs=1e-9)
    assert 0.0 > moved_m[3] > moved_m[2] > -0.3 * depth_m
