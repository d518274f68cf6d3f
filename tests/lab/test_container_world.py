"""Fingers on a container: balances, limits, rates and repeatability."""

import dataclasses

import numpy as np
import pytest

from deformscope.lab.container_constants import CONTENTS, EMPTY, PAD_STIFFNESS_PA_M, RICE, WATER, Content
from deformscope.lab.container_shell import BOX, CYLINDER, ContainerShape, shell_of
from deformscope.lab.container_world import TEXEL_M2, ContainerDraw, ContainerWorld, hand_from_container, misplaced

OPEN_DEG = np.array([90.0, -14.0, 5.3, -70.0, 0.0, -14.0, 5.3])
TORQUE_NM = np.array([0.0, 0.5, 1.0, 0.5, 1.0, 0.5, 1.0])
STEP_S = 0.01
SPEED_DEG_S = 10.0


def nominal(**changes: object) -> ContainerDraw:
    """A trial without any chance in it."""
    plain = ContainerDraw(hand_from_container(), 0.9, 1.0, 0.0, 0.0, np.zeros(7))
    return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]


class Squeezed:
    """A container that was squeezed for some time by both proximal joints; work_j: what the joints did"""

    def __init__(
        self,
        content: Content,
        trial: ContainerDraw | None = None,
        shape: ContainerShape = BOX,
        speed: float = SPEED_DEG_S,
        steps: int = 150,
    ) -> None:
        self.world = ContainerWorld(shape, content, trial or nominal())
        self.position, self.work_j = OPEN_DEG.copy(), 0.0
        self.goes_on(speed, steps)

    def goes_on(self, speed: float, steps: int, torque_nm: np.ndarray = TORQUE_NM) -> None:
        for _ in range(steps):
            wanted = self.position.copy()
            wanted[[1, 5]] += speed * STEP_S
            before = self.world.torque_nm
            reached = self.world.reach_deg(self.position, wanted, torque_nm, STEP_S)
            turned = np.radians(reached - self.position)
            self.work_j += float((before + self.world.torque_nm) @ turned / 2)
            self.position = reached


@pytest.mark.parametrize("shape", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_a_stalled_joint_has_the_torque_of_its_motor(shape: ContainerShape) -> None:
    done = Squeezed(RICE, shape=shape, steps=200)
    assert done.world.torque_nm[[1, 5]] == pytest.approx([0.5, 0.5], rel=0.02)
    # force times its lever about the proximal joint, which is somewhere along the pad
    lever_m = done.world.torque_nm[[1, 5]] / done.world.force_n
    assert ((lever_m > 0.0865 + 0.015) & (lever_m < 0.0865 + 0.066)).all()
    with_less = done.world.torque_nm[[2, 6]] / done.world.force_n
    assert with_less == pytest.approx(lever_m - 0.0865, abs=0.003)


def test_twice_the_current_presses_twice_as_hard() -> None:
    done = Squeezed(RICE, steps=150)
    single = done.world.force_n
    done.goes_on(SPEED_DEG_S, 150, 2 * TORQUE_NM)
    assert done.world.force_n == pytest.approx(2 * single, rel=0.1)


def test_the_table_takes_what_the_fingers_differ_by_and_no_more_than_friction() -> None:
    aside = nominal(T_hand_container=misplaced(hand_from_container(), 0.0, 0.0015, 0.0))
    for content in (EMPTY, RICE):
        done = Squeezed(content, aside, steps=110)
        difference = float(np.diff(done.world.force_n)[0])
        friction_n = 0.35 * done.world.mass_kg * 9.81
        assert abs(difference) <= friction_n * 1.01 + 1e-3
        slid_m = (done.world.T_hand_container - aside.T_hand_container)[0, 3]
        assert slid_m < 0.0  # finger 0 touched first, and pushed
        if content is EMPTY:
            assert slid_m == pytest.approx(-0.0015, abs=3e-4)  # a light box comes to the middle between both


def test_work_of_the_joints_is_stored_in_wall_pads_and_gas_where_nothing_is_lost() -> None:
    done = Squeezed(EMPTY, speed=4.0, steps=400)
    state = done.world._state
    wall_j = 0.5 * float(state.loads @ state.y)
    pads_j = 0.5 * float((state.force_n**2).sum()) / (PAD_STIFFNESS_PA_M * TEXEL_M2)
    gas_j = 101_325.0 * BOX.volume_m3 * -np.log(1 - state.y[-1] / BOX.volume_m3) - 101_325.0 * state.y[-1]
    assert wall_j + pads_j + gas_j == pytest.approx(done.work_j, rel=0.03)


def test_squeezing_rice_loses_work_and_an_empty_box_gives_it_back() -> None:
    lost = {}
    for name in ("empty", "rice"):
        done = Squeezed(CONTENTS[name], speed=4.0, steps=300)
        most_j = done.work_j
        done.goes_on(-4.0, 300)
        assert done.world.force_n == pytest.approx([0.0, 0.0], abs=1e-9)
        lost[name] = done.work_j / most_j
    assert abs(lost["empty"]) < 0.05
    assert 0.1 < lost["rice"] < 1.0


def test_a_filling_never_makes_the_container_softer() -> None:
    """At equal force. Liquids and air both give way by walls that bulge, so that they may be close."""
    dents = {name: Squeezed(content).world.dent_m.mean() for name, content in CONTENTS.items()}
    for name in ("water", "yogurt", "flour", "rice"):
        assert dents[name] < dents["empty"] * 1.02
    assert dents["yogurt"] < dents["water"]  # the same bulk, and a yield stress besides
    assert max(dents["flour"], dents["rice"]) < 0.9 * dents["empty"]


def gas_pa(world: ContainerWorld) -> float:
    """Pressure of the air within, over the outside."""
    return world._gas.pressure_pa(float(world._state.y[-1]))[0]


def test_less_air_above_a_liquid_makes_it_harder() -> None:
    half = Squeezed(WATER, nominal(fill=0.5)).world
    full = Squeezed(WATER, nominal(fill=0.95)).world
    assert gas_pa(full) > gas_pa(half)
    assert full.dent_m.mean() < half.dent_m.mean()


def test_yogurt_resists_a_fast_squeeze_more_and_relaxes_and_rice_does_not() -> None:
    force, relaxed = {}, {}
    for name in ("yogurt", "rice"):
        for speed in (2.0, 20.0):
            done = Squeezed(CONTENTS[name], speed=speed, steps=0)
            done.goes_on(speed, round(11.0 / speed / STEP_S), 10 * TORQUE_NM)
            force[name, speed] = done.world.force_n.mean()
            done.goes_on(0.0, 100)
            relaxed[name, speed] = force[name, speed] - done.world.force_n.mean()
    assert force["yogurt", 20.0] > force["yogurt", 2.0] + 0.01
    assert relaxed["yogurt", 20.0] > 0.015 > relaxed["yogurt", 2.0] > 0.002
    assert force["rice", 20.0] == pytest.approx(force["rice", 2.0], abs=1e-4)
    assert relaxed["rice", 20.0] == pytest.approx(0.0, abs=1e-4)


def test_a_liquid_bulges_the_wall_most_near_the_bottom_before_it_is_touched() -> None:
    inward = ContainerWorld(BOX, WATER, nominal()).inward_m()
    lowest = np.unravel_index(inward.argmin(), inward.shape)
    assert inward.min() < -0.002
    assert 0.02 < shell_of(BOX).z_m[lowest[1]] < 0.08
    assert ContainerWorld(BOX, EMPTY, nominal()).inward_m() == pytest.approx(0.0, abs=1e-4)


def test_a_warm_container_stands_under_pressure_as_its_walls_allow() -> None:
    world = ContainerWorld(BOX, EMPTY, nominal(warming_k=2.0))
    grown = 2.0 / 293.15 * BOX.volume_m3
    _, across = shell_of(BOX).filling_compliance
    stiffness = 1.0 / (across[-1, -1] + BOX.volume_m3 / 101_325.0)
    assert gas_pa(world) == pytest.approx(grown * stiffness, rel=0.02)


def test_draws_depend_on_seed_instance_and_session_and_repeat() -> None:
    first, again = (ContainerDraw.draw(BOX, 3, instance=7, session=1) for _ in range(2))
    np.testing.assert_array_equal(first.T_hand_container, again.T_hand_container)
    other = ContainerDraw.draw(BOX, 4, instance=7, session=1)
    assert other.softness == first.softness
    assert other.fill != first.fill
    assert ContainerDraw.draw(BOX, 3, instance=8, session=1).softness != first.softness
    assert ContainerDraw.draw(BOX, 3, instance=7, session=2).room_k != first.room_k
    given = hand_from_container(along_m=0.02)
    placed = ContainerDraw.draw(BOX, 3, instance=7, grasp=given).T_hand_container
    assert np.abs(placed[:3, 3] - given[:3, 3]).max() <= 0.004
    np.testing.assert_allclose(placed[:3, :3] @ placed[:3, :3].T, np.eye(3), atol=1e-12)
