"""The tip goes as commanded by joint rates, and stops where joints or a singularity would lead it elsewhere."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot.checks import Check, Preflight
from deformscope.robot.motion import CommandedRotation, rates_for_twist, to_singularity_deg, within_limits
from deformscope.robot.placement import best_joints
from deformscope.robot.readings import RobotObservation
from deformscope.robot.robot import JointRates, Robot, RobotStopped, TipVelocity
from deformscope.robot.supervisor import Fault, Limits, SafetyDecision
from deformscope.robot.touch import Phase, run_touch
from deformscope.robot.travel import move_joints, move_tip
from deformscope_drivers.arm.kinematics import Chain, FloatArray, least_singular, off_course
from deformscope_drivers.arms import chain_of
from deformscope_drivers.jaco.chains import CHAINS, J2N6S300, J2S7S300
from deformscope_drivers.jaco.structures import PositionType
from studies.springy_foam import SpringyFoam
from tests.cases import slow_but
from tests.robot.quick_touch import quick_scene

FREE_BOX = Limits(low_m=(-1.0, -1.0, -0.5), high_m=(1.0, 1.0, 1.5))
PASSED = Preflight((Check("all", True, "", ""),))
LIMITS_DEG_S = np.full(6, 20.0)
FAR_DEG = np.array([265.0, 228.5, 135.9, 326.6, 105.8, -38.4])
"""The tip over (0.3, -0.05), 10 cm from where the arm is stretched out."""


class Bench:
    """A robot in the laboratory that may move, and what each period's pose was."""

    def __init__(self, model: str = "j2n6s300", start_deg: FloatArray | None = None, limits: Limits = FREE_BOX) -> None:
        tool = Tool()
        foam = SpringyFoam(60e3, (0.3, 0.2, 0.02), (0.0, 0.0, 1.0), tool)
        self.lab = TouchLab(foam, tool=tool, arm_model=model, start_deg=start_deg)
        self.lab.open()
        self.poses: list[FloatArray] = []
        self.kinds: set[int] = set()
        spoiled, send = self.lab.functions, self.lab.arm_double.function("SendBasicTrajectory")

        def kept(point: object) -> int:
            self.kinds.add(point.Position.Type)  # type: ignore[attr-defined]
            return send(point)

        function = spoiled.function
        spoiled.function = lambda name: kept if name == "SendBasicTrajectory" else function(name)  # type: ignore[method-assign]
        self.robot = Robot(
            self.lab.arm,
            self.lab.force,
            self.lab.placement,
            limits,
            clock=self.lab.clock,
            wait_until=self.lab.wait_until,
            watch=self._watch,
        )
        self.robot.cycle()
        self.robot.let_move(PASSED)

    def _watch(self, seen: RobotObservation, verdict: SafetyDecision) -> None:
        self.poses.append(self.lab.arm_double.T_base_end_effector)

    def until_stopped(self, command: TipVelocity | JointRates) -> Fault:
        """Send the same until the supervisor stops it; why."""
        try:
            for _ in range(1000):
                self.robot.cycle(command)
        except RobotStopped as stopped:
            return stopped.verdict.fault
        return Fault.NONE

    @property
    def centers_m(self) -> FloatArray:
        """(n, 3) of the tip, in each period, surface frame."""
        return np.array([self.lab.placement.T_surface_center(pose)[:3, 3] for pose in self.poses])

    def tilts_deg(self, normal: FloatArray) -> FloatArray:
        """(n,) of the stick against -normal, in each period."""
        sticks = np.array([self.lab.placement.T_surface_center(pose)[:3, 2] for pose in self.poses])
        return np.degrees(np.arccos(np.clip(-sticks @ normal, -1.0, 1.0)))


@pytest.fixture(params=slow_but(["j2n6s300", "j2s7s300"], sorted(CHAINS)))
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    chain, start_deg = CHAINS[request.param], None
    if chain is not J2N6S300:
        placement = TouchLab(SpringyFoam(1e4, (0, 0, 0), (0, 0, 1), Tool())).placement
        start_deg = best_joints(chain, [placement.T_base_ee((0.3, 0.2, 0.2), (0, 0, 1))])
    made = Bench(chain.name, start_deg)
    yield made
    made.lab.close()


def tilted(angle_deg: float) -> FloatArray:
    angle = np.radians(angle_deg)
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


def test_the_stick_turns_to_where_it_is_sent_and_never_away(bench: Bench) -> None:
    """Rotation in the base frame, sent to an arm that takes it in its own, tilted the stick by 74 deg here."""
    goal = tilted(10.0)
    start_m = bench.robot.center_m
    move_tip(bench.robot, start_m, goal, 0.05)
    tilts_deg = bench.tilts_deg(goal)
    assert tilts_deg[0] == pytest.approx(10.0, abs=0.5)
    assert np.all(np.diff(tilts_deg) < 0.02)
    assert tilts_deg[-1] < 0.3
    assert np.linalg.norm(bench.centers_m - start_m, axis=1).max() < 1e-3  # about the tip's centre
    assert bench.kinds == {PositionType.ANGULAR_VELOCITY}


def test_the_tip_goes_straight_and_the_stick_stays(bench: Bench) -> None:
    start_m = bench.robot.center_m
    for _ in range(300):
        bench.robot.cycle(TipVelocity(np.array([0.03, -0.02, -0.02])))
    moved_m = bench.centers_m[-1] - start_m
    along = np.array([0.03, -0.02, -0.02]) / np.linalg.norm([0.03, -0.02, -0.02])
    assert moved_m == pytest.approx([0.09, -0.06, -0.06], abs=1.5e-3)
    across_m = bench.centers_m - start_m - np.outer((bench.centers_m - start_m) @ along, along)
    assert np.linalg.norm(across_m, axis=1).max() < 1e-3
    assert bench.tilts_deg(np.array([0.0, 0.0, 1.0])).max() < 0.2


def test_through_a_whole_touch_the_stick_is_within_a_degree_of_the_normal() -> None:
    scene = quick_scene(3, tilt_deg=12.0)
    phases: list[Phase] = []
    tilts_deg: list[float] = []

    def watch(seen: RobotObservation, verdict: SafetyDecision) -> None:
        if phases and phases[-1] is not Phase.TRAVEL:
            stick = scene.robot.placement.T_surface_center(scene.lab.arm_double.T_base_end_effector)[:3, 2]
            tilts_deg.append(float(np.degrees(np.arccos(-stick @ scene.plan.normal))))

    scene.robot.watch = watch
    run_touch(scene.robot, scene.plan, on_phase=lambda phase, time_ns: phases.append(phase))
    scene.lab.close()
    assert Phase.DWELL in phases
    assert len(tilts_deg) > 300
    assert max(tilts_deg) < 1.0


def test_joints_on_their_way_turn_tip_and_tool_no_faster_than_the_supervisor_allows() -> None:
    """15 deg/s of the first joint alone move a tip 0.5 m away at 0.13 m/s."""
    bench = Bench()
    goal_deg = np.array(bench.robot.pose.joints_deg) + np.array([20.0, -3.0, 3.0, 15.0, -15.0, 25.0])
    move_joints(bench.robot, goal_deg)
    assert bench.robot.pose.joints_deg == pytest.approx(goal_deg, abs=0.15)
    speeds_m_s = np.linalg.norm(np.diff(bench.centers_m, axis=0), axis=1) / 0.01
    assert 0.04 < speeds_m_s.max() < 0.055
    bench.lab.close()


def test_a_joint_slows_down_before_its_limit_and_stops_at_its_margin() -> None:
    joints_deg = J2N6S300.home_deg.copy()
    rates_deg_s = np.array([0.0, 0.0, -10.0, 5.0, 0.0, 0.0])
    shares = []
    for left_deg in (40.0, 15.0, 10.0, 6.0):
        joints_deg[2] = J2N6S300.lower_deg[2] + left_deg
        motion = within_limits(J2N6S300, joints_deg, rates_deg_s, LIMITS_DEG_S, 5.0)
        assert motion.fault is Fault.NONE
        assert motion.rates_deg_s == pytest.approx(motion.share * rates_deg_s)  # the direction stays
        shares.append(motion.share)
    assert shares == pytest.approx([1.0, 1.0, 1.0, 0.2])  # 20 deg/s at 15 deg, 2 deg/s at 6 deg
    joints_deg[2] = J2N6S300.lower_deg[2] + 5.1
    blocked = within_limits(J2N6S300, joints_deg, rates_deg_s, LIMITS_DEG_S, 5.0)
    assert blocked.fault is Fault.JOINT_LIMIT
    assert "joint 3 at 24.1 deg" in blocked.reason
    assert not np.any(blocked.rates_deg_s)
    back = within_limits(J2N6S300, joints_deg, -rates_deg_s, LIMITS_DEG_S, 5.0)
    assert back.rates_deg_s == pytest.approx(-rates_deg_s)


def test_each_joint_keeps_its_own_rate_and_the_direction_stays() -> None:
    limits_deg_s = np.array([36.0, 36.0, 36.0, 8.0, 48.0, 48.0])
    motion = within_limits(J2N6S300, J2N6S300.home_deg, np.array([20.0, 0, 0, 16.0, 10.0, 0]), limits_deg_s, 5.0)
    assert motion.rates_deg_s == pytest.approx([10.0, 0, 0, 8.0, 5.0, 0])
    assert motion.share == pytest.approx(0.5)


@pytest.mark.parametrize("chain", CHAINS.values(), ids=list(CHAINS))
def test_joint_rates_make_the_twist(chain: Chain) -> None:
    twist = np.array([0.02, -0.01, 0.015, 0.05, -0.1, 0.02])
    motion = rates_for_twist(chain, chain.home_deg, twist, chain.velocity_deg_s, 5.0)
    step_s = 1e-4
    before, after = chain.end_effector(chain.home_deg), chain.end_effector(chain.home_deg + step_s * motion.rates_deg_s)
    assert motion.share == 1.0
    assert (after[:3, 3] - before[:3, 3]) / step_s == pytest.approx(twist[:3], abs=1e-4)
    turned = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec() / step_s
    assert turned == pytest.approx(twist[3:], abs=1e-3)


def test_a_seventh_joint_turns_the_others_away_from_their_limits_and_the_hand_stays() -> None:
    joints_deg = J2S7S300.home_deg.copy()
    joints_deg[1:3] = J2S7S300.lower_deg[1] + 12.0, 40.0  # the elbow out of the plane of shoulder and hand
    start, creep = J2S7S300.end_effector(joints_deg), np.array([1e-4, 0, 0, 0, 0, 0])
    for _ in range(200):
        motion = rates_for_twist(J2S7S300, joints_deg, creep, np.full(7, 20.0), 5.0)
        assert motion.fault is Fault.NONE
        joints_deg = joints_deg + 0.01 * motion.rates_deg_s
    end = J2S7S300.end_effector(joints_deg)
    assert J2S7S300.to_limits_deg(joints_deg)[1] > 13.0
    assert end[:3, 3] == pytest.approx(start[:3, 3] + [2e-4, 0, 0], abs=3e-4)
    assert np.degrees(Rotation.from_matrix(end[:3, :3] @ start[:3, :3].T).magnitude()) < 0.1


def test_a_way_into_a_singularity_is_refused_and_a_way_along_it_is_not() -> None:
    """Stretched out, the arm cannot go further out, but well across."""
    joints_deg = np.array([180.0, 240.0, 181.0, 20.0, 60.0, 0.0])
    jacobian = J2N6S300.jacobian(joints_deg)
    left, values, _ = np.linalg.svd(jacobian)
    assert values[-1] < 0.02 < values[-2]
    weak, strong = 0.02 * left[:, -1], 0.02 * left[:, 0]
    refused = rates_for_twist(J2N6S300, joints_deg, weak, LIMITS_DEG_S, 5.0)
    taken = rates_for_twist(J2N6S300, joints_deg, strong, LIMITS_DEG_S, 5.0)
    assert refused.fault is Fault.SINGULAR
    assert "singular value" in refused.reason
    assert taken.fault is Fault.NONE
    assert off_course(jacobian, np.radians(taken.rates_deg_s), taken.share * strong) < 0.01


def test_a_tip_sent_ever_farther_stops_near_the_singularity_still_on_its_way() -> None:
    bench = Bench(start_deg=FAR_DEG)
    start_m, away = bench.robot.center_m, np.array([0.0, -1.0, 0.0])
    assert bench.until_stopped(TipVelocity(0.04 * away)) is Fault.SINGULAR
    moved_m = bench.centers_m - start_m
    assert (moved_m @ away)[-1] > 0.02
    across_m = moved_m - np.outer(moved_m @ away, away)
    assert np.linalg.norm(across_m, axis=1).max() < 2e-3
    assert bench.tilts_deg(np.array([0.0, 0.0, 1.0])).max() < 2.0
    assert least_singular(J2N6S300.jacobian(bench.lab.arm_double.joints_deg)) > 0.005
    assert bench.lab.arm_double.fifo_count == 0
    bench.lab.close()


def test_a_tip_sent_towards_a_joints_limit_stops_at_its_margin() -> None:
    """A margin of 20 degrees: at 5 the folded arm would have met itself before."""
    bench = Bench(
        start_deg=np.array([260.0, 200.0, 51.0, 340.0, 65.0, -28.0]), limits=replace(FREE_BOX, joint_margin_deg=20.0)
    )
    assert bench.until_stopped(JointRates(np.array([0.0, 0.0, -12.0, 0.0, 0.0, 0.0]))) is Fault.JOINT_LIMIT
    assert 20.0 < J2N6S300.to_limits_deg(bench.lab.arm_double.joints_deg).min() < 21.0
    bench.lab.close()


def test_a_held_orientation_is_brought_back() -> None:
    held, measured = CommandedRotation(), np.eye(3)
    held.advance(np.zeros(3), 0.01, measured, follows=False)
    pushed = Rotation.from_rotvec([0.0, 0.05, 0.0]).as_matrix()
    for _ in range(200):
        held.advance(np.zeros(3), 0.01, pushed, follows=False)
        pushed = Rotation.from_rotvec(0.01 * held.back_rad_s(pushed)).as_matrix() @ pushed
    assert held.rotation == pytest.approx(np.eye(3))
    assert Rotation.from_matrix(pushed).magnitude() < 1e-3


def test_points_that_are_left_out_do_not_add_up_and_turning_by_itself_does() -> None:
    """An arm that makes 90 % of a rate stays near what is commanded; one that turns on top of it does not."""
    rate = np.array([0.0, 0.0, 0.3])
    errors_deg = []
    for made in (0.9 * rate, rate + np.array([0.5, 0.0, 0.0])):
        commanded, measured = CommandedRotation(), np.eye(3)
        for _ in range(500):
            commanded.advance(rate, 0.01, measured, follows=True)
            measured = Rotation.from_rotvec(0.01 * made).as_matrix() @ measured
        errors_deg.append(np.degrees(Rotation.from_matrix(measured @ commanded.rotation.T).magnitude()))
    assert errors_deg[0] < 2.5
    assert errors_deg[1] > 20.0


@pytest.mark.parametrize("fifth_deg", [18.0, 14.0, 9.0, 6.0])
def test_what_leads_into_a_singularity_slows_down_within_15_degrees_of_it(fifth_deg: float) -> None:
    """A KUKA's wrist is singular where its fifth axis is 0: turned straight towards it, what is found beforehand is the
    angle that is left."""
    chain = chain_of("kr6r900sixx")
    joints = np.array([0.0, -90.0, 100.0, 0.0, fifth_deg, 0.0])
    jacobian = chain.jacobian(joints)
    towards = np.array([0.0, 0.0, 0.0, 0.0, -1.0, 0.0])
    twist = jacobian @ np.radians(5.0 * towards)
    left_deg = to_singularity_deg(chain, joints, jacobian, np.radians(5.0 * towards))
    assert left_deg == pytest.approx(fifth_deg, rel=0.15)
    motion = rates_for_twist(chain, joints, twist, np.full(6, 100.0), 5.0)
    assert motion.fault is Fault.NONE
    assert motion.share == pytest.approx(min(1.0, max(1 / 3, left_deg / 15.0)), rel=1e-3)
    np.testing.assert_allclose(motion.rates_deg_s, 5.0 * motion.share * towards, atol=0.05)
    assert rates_for_twist(chain, joints, -twist, np.full(6, 100.0), 5.0).share == 1.0
