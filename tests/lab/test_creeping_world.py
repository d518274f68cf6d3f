"""Foam with a memory: against the closed form of a relaxation test, and against foam without one."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.scene_lab import CreepingWorld, Relaxation
from deformscope.lab.scenes import built_in
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld

SCENE, TIP = built_in("homogeneous-60"), RigidTip(radius=0.01)
REST_M = np.array([0.3, 0.2, SCENE.thickness_m + 0.01])
PRESSED_M, ABOVE_M = REST_M - np.array([0.0, 0.0, 0.003]), REST_M + np.array([0.0, 0.0, 0.01])
MIDDLE_M = np.array([[0.3, 0.2]])


def test_a_dent_that_is_held_relaxes_as_the_material_does_and_recovers_slowly() -> None:
    """Dented at once, every force is the elastic one times E(t) / E0 (correspondence principle), whatever the steps."""
    world, elastic = CreepingWorld(SCENE, Relaxation((0.2, 0.1), (0.5, 2.0))), SlabWorld(SCENE).press(TIP, PRESSED_M)
    world.at(1e-9)
    assert world.press(TIP, PRESSED_M).normal_force_n == pytest.approx(elastic.normal_force_n, rel=1e-6)
    for time_s in (0.01, 0.1, 0.5, 0.6, 3.0):
        world.at(time_s)
        world.press(TIP, ABOVE_M)  # a look at another place at the same time changes nothing
        contact = world.press(TIP, PRESSED_M)
        left = 0.7 + 0.2 * np.exp(-time_s / 0.5) + 0.1 * np.exp(-time_s / 2.0)
        assert contact.normal_force_n == pytest.approx(left * elastic.normal_force_n, rel=1e-5)
    dent = world.displaced_m(contact, MIDDLE_M)[0, 2]
    assert dent == pytest.approx(-0.003, abs=1e-4)
    dents = []
    for time_s in (3.01, 4.0, 20.0):
        world.at(time_s)
        contact = world.press(TIP, ABOVE_M)
        assert contact.normal_force_n == 0.0
        dents.append(world.displaced_m(contact, MIDDLE_M)[0, 2])
    assert dent < dents[0] < dents[1] < dents[2] < 0.0
    assert dents[0] < -2e-4
    assert dents[2] > -1e-5


@pytest.mark.slow
def test_foam_that_does_not_relax_is_the_elastic_one() -> None:
    world, elastic = CreepingWorld(SCENE, Relaxation()), SlabWorld(SCENE)
    for time_s, center_m in ((0.1, PRESSED_M), (0.2, 0.5 * (PRESSED_M + REST_M)), (0.3, PRESSED_M)):
        world.at(time_s)
        assert world.press(TIP, center_m).normal_force_n == pytest.approx(elastic.press(TIP, center_m).normal_force_n)


def test_what_a_foam_keeps_of_a_dent_stays_and_the_way_in_is_softer_by_it() -> None:
    world, elastic = CreepingWorld(SCENE, Relaxation(keeps=0.3)), SlabWorld(SCENE).press(TIP, PRESSED_M)
    for step in range(1, 16):  # what it keeps follows a step behind
        world.at(0.1 * step)
        down_m = min(step / 12, 1.0)
        contact = world.press(TIP, (1.0 - down_m) * REST_M + down_m * PRESSED_M)
    assert contact.normal_force_n == pytest.approx(0.7 * elastic.normal_force_n, rel=1e-6)
    world.at(9.0)
    assert world.displaced_m(world.press(TIP, ABOVE_M), MIDDLE_M)[0, 2] == pytest.approx(-0.3 * 0.003, rel=0.02)


def test_what_makes_no_sense_is_refused() -> None:
    world = CreepingWorld(SCENE, Relaxation((0.3,), (1.0,)))
    world.at(2.0)
    with pytest.raises(InputError, match="not before the last"):
        world.at(1.0)
    for shares, times_s in (((0.3,), ()), ((0.6, 0.5), (1.0, 1.0)), ((0.3,), (0.0,)), ((-0.1,), (1.0,))):
        with pytest.raises(InputError, match="shares above 0"):
            Relaxation(shares, times_s)
    with pytest.raises(InputError, match="a permanent share of a dent"):
        Relaxation(keeps=1.0)
