"""How the simulated hand moves: durations and angles that can be worked out by hand."""

import math
from collections.abc import Sequence

import pytest

from deformscope_drivers.sdh.codes import AxisState, Controller, VelocityProfile
from deformscope_drivers.sdh.motion import AMBIENT_C, CYCLE_NS, Motion

SECOND_NS = 1_000_000_000


def motion(**settings) -> Motion:
    made = Motion()
    for axis in range(7):
        made.power(axis, True)
        for name, value in settings.items():
            setattr(made.axes[axis], name, value)
    return made


def run(moved: Motion, until_s: float) -> None:
    moved.advance(round(until_s * SECOND_NS))


def targets(**by_axis: float) -> list[float | None]:
    return [by_axis.get(f"axis{axis}") for axis in range(7)]


# Schunk's trace of old firmware: 8.31 deg at 40 deg/s -> T=0.42s, num_points: 42; 45.06 deg -> T=4.51s (so 20 deg/s).
@pytest.mark.parametrize(("distance", "velocity", "duration_s"), [(8.31, 40.0, 0.42), (45.06, 20.0, 4.51), (20, 40, 1)])
def test_sin_square_takes_twice_the_way_over_the_velocity(distance: float, velocity: float, duration_s: float) -> None:
    moved = motion()
    assert moved.start(targets(axis1=distance), [velocity] * 7) == pytest.approx(duration_s)
    run(moved, duration_s / 2)
    assert moved.axes[1].position_deg == pytest.approx(distance / 2, rel=0.02)
    assert moved.axes[1].velocity_deg_s == pytest.approx(velocity, rel=0.02)
    assert moved.axes[1].state is AxisState.POSITIONING
    run(moved, duration_s - 2 * CYCLE_NS / SECOND_NS)
    assert moved.axes[1].state is AxisState.POSITIONING
    run(moved, duration_s + CYCLE_NS / SECOND_NS)
    assert moved.axes[1].state is AxisState.IDLE
    assert moved.axes[1].position_deg == distance
    assert moved.axes[1].velocity_deg_s == 0


@pytest.mark.parametrize(
    ("distance", "duration_s"),
    [(40.0, 1.4), (4.0, 0.4), (16.0, 0.8)],  # 40/40 + 40/100; 2 sqrt(4/100): never at 40 deg/s; just at it
)
def test_ramp_speeds_up_goes_on_and_slows_down(distance: float, duration_s: float) -> None:
    moved = motion()
    moved.profile = VelocityProfile.RAMP
    assert moved.start(targets(axis2=distance), [40.0] * 7) == pytest.approx(duration_s)
    run(moved, 0.1)
    assert moved.axes[2].position_deg == pytest.approx(100 * 0.1**2 / 2)
    run(moved, duration_s / 2)
    assert moved.axes[2].position_deg == pytest.approx(distance / 2)
    run(moved, duration_s)
    assert moved.axes[2].position_deg == distance


def test_all_axes_start_and_end_together() -> None:
    moved = motion()
    assert moved.start([10.0, -40.0, 20.0, 0.0, 5.0, -5.0, 0.5], [40.0] * 7) == pytest.approx(2.0)
    run(moved, 1.0)
    assert [axis.position_deg for axis in moved.axes] == pytest.approx([5, -20, 10, 0, 2.5, -2.5, 0.25])
    assert [axis.state for axis in moved.axes].count(AxisState.POSITIONING) == 6
    run(moved, 2.0)
    assert [axis.position_deg for axis in moved.axes] == [10.0, -40.0, 20.0, 0.0, 5.0, -5.0, 0.5]
    assert not moved.moving


def test_stop_slows_down_by_the_acceleration() -> None:
    moved = motion()
    moved.start(targets(axis1=80.0), [40.0] * 7)  # 4 s; at 2 s it is half way at 40 deg/s
    run(moved, 2.0)
    moved.stop()
    run(moved, 2.2)
    assert moved.axes[1].velocity_deg_s == pytest.approx(20.0, rel=0.02)
    run(moved, 3.0)
    assert moved.axes[1].position_deg == pytest.approx(40 + 40**2 / (2 * 100), rel=0.01)
    assert moved.axes[1].state is AxisState.IDLE


@pytest.mark.parametrize(
    ("target", "wall", "state"), [(40, 15, AxisState.CW_BLOCKED), (-40, -15, AxisState.CCW_BLOCKED)]
)
def test_an_obstacle_holds_one_axis_and_lets_the_others_go_on(target: float, wall: float, state: AxisState) -> None:
    moved = motion()
    if wall > 0:
        moved.axes[1].obstacle_high_deg = wall
    else:
        moved.axes[1].obstacle_low_deg = wall
    moved.start(targets(axis1=float(target), axis2=20.0), [40.0] * 7)
    run(moved, 5.0)
    assert moved.axes[1].position_deg == wall
    assert moved.axes[1].state is state
    assert moved.axes[2].position_deg == 20.0
    moved.start(targets(axis1=0.0), [40.0] * 7)
    run(moved, 10.0)
    assert moved.axes[1].position_deg == 0.0
    assert moved.axes[1].state is AxisState.IDLE


def test_a_velocity_goes_on_to_the_end_of_the_range() -> None:
    moved = motion()
    moved.set_controller(Controller.VELOCITY)
    assert {axis.target_velocity_deg_s for axis in moved.axes} == {0.0}
    moved.axes[3].target_velocity_deg_s = 30.0
    moved.follow_velocities()
    run(moved, 1.0)
    assert moved.axes[3].position_deg == pytest.approx(30.0)
    assert moved.axes[3].state is AxisState.SPEED_MODE
    assert moved.axes[2].state is AxisState.IDLE
    run(moved, 4.0)
    assert moved.axes[3].position_deg == 90.0
    assert moved.axes[3].state is AxisState.LIMITS_REACHED
    moved.axes[3].target_velocity_deg_s = -10.0
    run(moved, 5.0)
    assert moved.axes[3].position_deg == pytest.approx(80.0)


def test_a_velocity_with_ramp() -> None:
    moved = motion()
    moved.set_controller(Controller.VELOCITY_ACCELERATION)
    moved.axes[5].target_velocity_deg_s = -50.0
    moved.follow_velocities()
    run(moved, 0.25)
    assert moved.axes[5].reference_deg_s == pytest.approx(-25.0)
    assert moved.axes[5].position_deg == pytest.approx(-100 * 0.25**2 / 2)
    run(moved, 1.0)
    assert moved.axes[5].velocity_deg_s == pytest.approx(-50.0)
    moved.stop()
    run(moved, 2.0)
    assert moved.axes[5].position_deg == pytest.approx(-12.5 - 25 - 12.5, rel=0.01)
    assert not moved.moving


def test_axes_that_are_off_do_not_move() -> None:
    moved = motion()
    moved.power(4, False)
    moved.start([10.0] * 7, [40.0] * 7)
    run(moved, 2.0)
    assert moved.axes[4].position_deg == 0.0
    assert moved.axes[4].state is AxisState.DISABLED
    assert moved.axes[3].position_deg == 10.0


def test_motors_warm_up_slowly_and_most_where_they_are_blocked() -> None:
    moved = motion()
    moved.axes[1].obstacle_high_deg = 5.0
    moved.start(targets(axis1=20.0), [40.0] * 7)
    run(moved, 5.0)
    after = [axis.temperature_c for axis in moved.axes]
    run(moved, 605.0)  # a time constant further, in one step
    assert all(AMBIENT_C < temperature < AMBIENT_C + 0.5 for temperature in after[1:])
    assert moved.axes[1].temperature_c == pytest.approx(AMBIENT_C + 30 * 0.5**2 * (1 - math.exp(-1)), abs=0.2)
    assert moved.axes[2].temperature_c < AMBIENT_C + 1


class Spring:
    """A spring on axis 1 from an angle on; a motor gives torque_nm_per_a of it."""

    def __init__(self, from_deg: float, nm_per_deg: float, nm_per_a: float = 2.0) -> None:
        self.from_deg, self.nm_per_deg, self.nm_per_a = from_deg, nm_per_deg, nm_per_a
        self.calls = 0

    def reach_deg(
        self, position_deg: Sequence[float], wanted_deg: Sequence[float], current_a: Sequence[float], step_s: float
    ) -> Sequence[float]:
        self.calls += 1
        assert step_s == CYCLE_NS / SECOND_NS
        reached = list(wanted_deg)
        balance = self.from_deg + current_a[1] * self.nm_per_a / self.nm_per_deg
        reached[1] = min(wanted_deg[1], max(balance, position_deg[1]))
        return reached


def test_an_axis_presses_something_soft_as_far_as_its_current_lets_it() -> None:
    moved = motion(move_current_a=0.1)
    moved.compliance = Spring(10.0, 0.1)
    moved.start(targets(axis1=40.0, axis5=40.0), [40.0] * 7)
    run(moved, 3.0)
    assert moved.axes[1].position_deg == pytest.approx(12.0)  # 0.2 Nm over 0.1 Nm/deg
    assert moved.axes[1].state is AxisState.CW_BLOCKED
    assert moved.axes[1].velocity_deg_s == 0.0
    assert moved.axes[5].position_deg == 40.0
    assert moved.axes[5].state is AxisState.IDLE
    for axis in moved.axes:
        axis.move_current_a = 0.2
    run(moved, 3.2)  # it goes on, at no more than its set speed
    assert 12.0 < moved.axes[1].position_deg < 14.0 + 1e-9
    run(moved, 4.0)
    assert moved.axes[1].position_deg == pytest.approx(14.0)


def test_what_yields_lets_the_axis_go_on_to_its_target() -> None:
    moved = motion(move_current_a=0.1)
    spring = Spring(10.0, 0.1)
    moved.compliance = spring
    moved.start(targets(axis1=15.0), [40.0] * 7)
    run(moved, 1.0)
    spring.from_deg = 12.0
    run(moved, 1.5)
    assert moved.axes[1].position_deg == pytest.approx(14.0)
    assert moved.axes[1].state is AxisState.CW_BLOCKED
    spring.from_deg = 20.0
    run(moved, 3.0)
    assert moved.axes[1].position_deg == 15.0
    assert moved.axes[1].state is AxisState.IDLE


def test_a_stopped_axis_no_longer_presses_on() -> None:
    moved = motion(move_current_a=0.1)
    spring = Spring(10.0, 0.1)
    moved.compliance = spring
    moved.start(targets(axis1=40.0), [40.0] * 7)
    run(moved, 2.0)
    moved.stop()
    spring.from_deg = 30.0
    run(moved, 3.0)
    assert moved.axes[1].position_deg == pytest.approx(12.0, abs=0.1)
    assert moved.axes[1].state is AxisState.IDLE
    assert spring.calls == pytest.approx(300, abs=1)  # also while nothing moves


def test_a_velocity_presses_too() -> None:
    moved = motion(move_current_a=0.1)
    moved.compliance = Spring(10.0, 0.1)
    moved.set_controller(Controller.VELOCITY)
    moved.axes[1].target_velocity_deg_s = 20.0
    moved.follow_velocities()
    run(moved, 0.4)
    assert moved.axes[1].state is AxisState.SPEED_MODE
    run(moved, 2.0)
    assert moved.axes[1].position_deg == pytest.approx(12.0)
    assert moved.axes[1].state is AxisState.CW_BLOCKED
    moved.axes[1].target_velocity_deg_s = -20.0
    run(moved, 2.2)
    assert moved.axes[1].position_deg < 11.0
    assert moved.axes[1].state is AxisState.SPEED_MODE
