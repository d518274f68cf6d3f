"""What every arm owes its users, beside what every device does (`tests.drivers.contract`).

A subclass gives `bench`: an arm that is closed, and how time passes. On a simulated clock, so that nothing depends on
the machine."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from deformscope_drivers.arm import Arm, ArmState, CartesianVelocity, JointVelocity, MotionStopped, NotMovedByCommands
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.errors import NotConnected, OutOfLimits

RATE_DEG_S = 4.0
AT_ONCE_S = 0.05
"""A velocity that has ended moves the arm for so long at most: two cycles of the slowest, and some."""


@dataclass(frozen=True, slots=True)
class ArmBench:
    """arm: closed; advance: lets time pass [s]; true_pose: (4, 4) where its end truly is; open_arm: opens it without a
    thread of its own"""

    arm: Arm[Any]
    advance: Callable[[float], None]
    true_pose: Callable[[], FloatArray]


class ArmContract:
    """Every arm passes this."""

    @pytest.fixture
    def bench(self) -> ArmBench:
        raise NotImplementedError("a contract test gives the fixture `bench`")

    @pytest.fixture
    def arm(self, bench: ArmBench) -> Iterator[Arm[Any]]:
        with bench.arm.open(own_thread=False) as arm:
            bench.advance(0.2)
            yield arm

    def states(self, bench: ArmBench, seconds: float) -> list[ArmState]:
        with bench.arm.readings() as queue:
            bench.advance(seconds)
            return list(queue.take())

    def test_a_state_says_where_its_end_is(self, bench: ArmBench, arm: Arm[Any]) -> None:
        (*_, state) = self.states(bench, 0.2)
        np.testing.assert_allclose(state.T_base_end_effector, bench.true_pose(), atol=1e-4)
        if not arm.by_hand:
            np.testing.assert_allclose(arm.chain.end_effector(state.joints_deg), bench.true_pose(), atol=1e-4)
            assert len(state.rates_deg_s) == arm.chain.joint_count == len(state.joints_deg)

    def test_it_reports_as_often_as_it_says(self, bench: ArmBench, arm: Arm[Any]) -> None:
        assert len(self.states(bench, 1.0)) == pytest.approx(arm.state_hz, rel=0.1)

    def test_nothing_moves_unasked(self, bench: ArmBench, arm: Arm[Any]) -> None:
        before = bench.true_pose()
        bench.advance(1.0)
        np.testing.assert_array_equal(bench.true_pose(), before)

    def test_a_closed_arm_takes_nothing(self, bench: ArmBench) -> None:
        with pytest.raises((NotConnected, NotMovedByCommands)):
            bench.arm.set_velocity(JointVelocity((0.0,) * 6))
        with pytest.raises(NotConnected):
            bench.arm.halt("closed")

    def test_an_arm_of_a_person_takes_no_velocity(self, bench: ArmBench, arm: Arm[Any]) -> None:
        if not arm.by_hand:
            pytest.skip("it moves by itself")
        with pytest.raises(NotMovedByCommands, match="a person places"):
            arm.set_velocity(JointVelocity((0.0,) * 6))
        with pytest.raises(NotMovedByCommands, match="a person places"):
            arm.chain  # noqa: B018

    def rates(self, arm: Arm[Any]) -> JointVelocity:
        if arm.by_hand:
            pytest.skip("a person places it")
        return JointVelocity((RATE_DEG_S,) + (0.0,) * (arm.chain.joint_count - 1))

    def test_a_joint_turns_as_fast_as_it_is_asked_to(self, bench: ArmBench, arm: Arm[Any]) -> None:
        rates = self.rates(arm)
        before = self.states(bench, 0.1)[-1]
        for _ in range(50):
            arm.set_velocity(rates, 0.05)
            bench.advance(0.02)
        turned_deg = np.subtract(self.states(bench, 0.1)[-1].joints_deg, before.joints_deg)
        assert turned_deg[0] == pytest.approx(RATE_DEG_S * 1.0, rel=0.06)
        assert np.abs(turned_deg[1:]).max() < 1e-3

    def test_the_end_goes_where_it_is_asked_to(self, bench: ArmBench, arm: Arm[Any]) -> None:
        self.rates(arm)
        before = bench.true_pose()
        for _ in range(50):
            arm.set_velocity(CartesianVelocity((0.0, 0.0, 0.02)), 0.05)
            bench.advance(0.02)
        bench.advance(0.2)
        way_m = bench.true_pose()[:3, 3] - before[:3, 3]
        np.testing.assert_allclose(way_m, [0.0, 0.0, 0.02], atol=1.5e-3)
        np.testing.assert_allclose(bench.true_pose()[:3, :3], before[:3, :3], atol=2e-3)

    def test_a_velocity_that_is_not_set_again_ends(self, bench: ArmBench, arm: Arm[Any]) -> None:
        arm.set_velocity(self.rates(arm), 0.1)
        bench.advance(0.1 + AT_ONCE_S)
        stands = bench.true_pose()
        bench.advance(1.0)
        np.testing.assert_array_equal(bench.true_pose(), stands)
        assert np.abs(self.states(bench, 0.1)[-1].rates_deg_s).max() < 1e-6

    def test_stop_stops_and_the_next_command_moves(self, bench: ArmBench, arm: Arm[Any]) -> None:
        arm.set_velocity(self.rates(arm), 10.0)
        bench.advance(0.2)
        arm.stop()
        bench.advance(AT_ONCE_S)
        stands = bench.true_pose()
        bench.advance(0.5)
        np.testing.assert_array_equal(bench.true_pose(), stands)
        arm.set_velocity(self.rates(arm), 0.1)
        bench.advance(0.2)
        assert not np.array_equal(bench.true_pose(), stands)

    def test_halt_refuses_until_it_is_acknowledged(self, bench: ArmBench, arm: Arm[Any]) -> None:
        rates = None if arm.by_hand else self.rates(arm)
        if rates is not None:
            arm.set_velocity(rates, 10.0)
            bench.advance(0.2)
        arm.halt("enough")
        bench.advance(AT_ONCE_S)
        stands = bench.true_pose()
        assert arm.stopped_because == "enough"
        arm.halt("again")
        assert arm.stopped_because == "enough"
        if rates is not None:
            with pytest.raises(MotionStopped, match="enough"):
                arm.set_velocity(rates, 1.0)
        bench.advance(0.5)
        np.testing.assert_array_equal(bench.true_pose(), stands)
        arm.acknowledge_stop()
        assert not arm.stopped_because
        if rates is not None:
            arm.set_velocity(rates, 0.1)
            bench.advance(0.2)
            assert not np.array_equal(bench.true_pose(), stands)

    @pytest.mark.parametrize("rate", [math.nan, math.inf, 1000.0])
    def test_a_velocity_beyond_the_limits_is_not_sent(self, rate: float, bench: ArmBench, arm: Arm[Any]) -> None:
        good = self.rates(arm)
        before = bench.true_pose()
        with pytest.raises(OutOfLimits):
            arm.set_velocity(JointVelocity((rate, *good.rates_deg_s[1:])), 1.0)
        with pytest.raises(OutOfLimits):
            arm.set_velocity(good, rate)
        with pytest.raises(OutOfLimits):
            arm.set_velocity(CartesianVelocity((rate, 0.0, 0.0)), 1.0)
        bench.advance(0.5)
        np.testing.assert_array_equal(bench.true_pose(), before)

    def test_closing_ends_a_motion(self, bench: ArmBench, arm: Arm[Any]) -> None:
        arm.set_velocity(self.rates(arm), 10.0)
        bench.advance(0.2)
        arm.close()
        bench.advance(AT_ONCE_S)
        stands = bench.true_pose()
        bench.advance(0.5)
        np.testing.assert_array_equal(bench.true_pose(), stands)
