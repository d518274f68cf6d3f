"""Distances of an arm from the table and from itself, against dense sampling; it is stopped before it hits."""

import dataclasses

import numpy as np
import pytest

from deformscope.robot.clearance import ArmBox, ArmClearance, segment_distance
from deformscope.robot.description import LINK_RADIUS_M
from deformscope.robot.latch import Action
from deformscope.robot.placement import Placement
from deformscope.robot.readings import ArmSample, ForceSample, RobotObservation
from deformscope.robot.setup import T_BASE_SURFACE
from deformscope.robot.supervisor import Fault, Limits, Supervisor
from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.arms import chains

CHAINS = chains()

PERIOD_NS = 10_000_000


def test_distances_of_segments_are_those_of_dense_points() -> None:
    a, b, c, d = np.random.default_rng(2).normal(size=(4, 200, 3))
    b[:20], d[10:30] = a[:20], c[10:30]  # points among them
    share = np.linspace(0.0, 1.0, 201)[:, None, None]
    one, other = a + share * (b - a), c + share * (d - c)
    dense = np.array([np.linalg.norm(one[:, None, k] - other[None, :, k], axis=-1).min() for k in range(200)])
    found = segment_distance(a, b, c, d)
    assert np.all(found <= dense + 1e-9)
    np.testing.assert_allclose(found, dense, atol=0.02)


@pytest.mark.parametrize("chain", CHAINS.values(), ids=list(CHAINS))
def test_an_arm_at_home_is_clear(chain: Chain) -> None:
    clearance = ArmClearance(Placement(T_BASE_SURFACE), chain.forward(chain.home_deg))
    links = chain.forward(chain.home_deg)
    assert clearance.over_table_m(links) > 0.3
    assert clearance.to_itself_m(links) > 0.03


def driven(
    chain: Chain, start_deg: FloatArray, rates_deg_s: FloatArray, seconds: float, box: ArmBox | None = None
) -> tuple[Fault, ArmSample]:
    """What a supervisor says of an arm that turns so, and where it then was."""
    placement = Placement(T_BASE_SURFACE)
    clearance = ArmClearance(placement, chain.forward(chain.home_deg))
    limits = Limits(speed_m_s=9.0, turn_deg_s=900.0, arm_box=box)
    supervisor = Supervisor(limits, 0, placement.T_ee_center, chain, clearance=clearance)
    sample = ArmSample(0, chain.end_effector(start_deg), tuple(start_deg))
    for number in range(1, round(100 * seconds)):
        now_ns = number * PERIOD_NS
        joints_deg = start_deg + 0.01 * number * rates_deg_s
        sample = ArmSample(now_ns, chain.end_effector(joints_deg), tuple(joints_deg))
        force = ForceSample(now_ns, np.zeros(3), pattern=number)
        verdict = supervisor.judge(RobotObservation(now_ns, (force,), (sample,)))
        if verdict.action is not Action.GO_ON:
            return verdict.fault, sample
    return Fault.NONE, sample


INTO = [
    ("j2n6s300", 90.0, 1, -1, Fault.TABLE),
    ("j2n6s300", 167.0, 1, 1, Fault.TABLE),
    ("j2n6s300", 90.0, 2, 1, Fault.TABLE),
    ("kr6r900sixx", -45.0, 1, 1, Fault.TABLE),
    ("j2n6s300", 90.0, 2, -1, Fault.ITSELF),
    ("j2n6s300", 120.0, 4, 1, Fault.ITSELF),
    ("j2n6s300", 167.0, 4, 1, Fault.ITSELF),
]
"""Arm at home but for its second joint [deg], joint that turns and which way, and what it comes near to."""


@pytest.mark.parametrize(("model", "second_deg", "joint", "way", "fault"), INTO)
@pytest.mark.parametrize("rate_deg_s", [2.0, 20.0, 36.0])
def test_an_arm_is_stopped_before_it_hits(
    model: str, second_deg: float, joint: int, way: int, fault: Fault, rate_deg_s: float
) -> None:
    """Two control periods later, where it stands, it still has not hit."""
    chain = CHAINS[model]
    start_deg, rates_deg_s = chain.home_deg.copy(), np.zeros(chain.joint_count)
    start_deg[1], rates_deg_s[joint] = second_deg, way * rate_deg_s
    clearance = ArmClearance(Placement(T_BASE_SURFACE), chain.forward(start_deg))
    degrees = 0
    while min(clearance.over_table_m(links := chain.forward(start_deg)), clearance.to_itself_m(links)) > 0.0:
        start_deg[joint], degrees = start_deg[joint] + way, degrees + 1
    start_deg[joint] -= way * min(degrees, 20)
    noticed, sample = driven(chain, start_deg, rates_deg_s, 20.0 / rate_deg_s)
    assert noticed is fault
    links = chain.forward(np.array(sample.joints_deg) + 0.02 * rates_deg_s)
    assert min(clearance.over_table_m(links), clearance.to_itself_m(links)) > 0.0


@pytest.mark.parametrize("chain", CHAINS.values(), ids=list(CHAINS))
def test_what_cannot_have_come_near_is_left_out_with_the_same_verdicts(chain: Chain) -> None:
    """Alarms of a wandering arm, with distances in each period and with those that may matter alone."""
    placement, rng = Placement(T_BASE_SURFACE), np.random.default_rng(4)
    clearances = [ArmClearance(placement, chain.forward(chain.home_deg)) for _ in range(2)]
    computed = [0, 0]
    for which, one in enumerate(clearances):

        def counted(links: FloatArray, which: int = which, to_itself_m=one.to_itself_m) -> float:
            computed[which] += 1
            return to_itself_m(links)

        one.to_itself_m = counted  # type: ignore[method-assign]
    clearances[1].reach_m = np.inf
    limits = Limits(speed_m_s=99.0, turn_deg_s=9000.0, joint_margin_deg=1e-3, itself_m=0.05, table_m=0.1)
    box = (-0.4, -0.4, -0.1), (0.4, 0.4, 1.5)
    limits = dataclasses.replace(limits, arm_box=box)
    watching = [Supervisor(limits, 0, placement.T_ee_center, chain, clearance=one) for one in clearances]
    lower, upper = (np.clip(end, -170.0, 170.0) for end in (chain.lower_deg + 10.0, chain.upper_deg - 10.0))
    joints_deg, found = chain.clip(chain.home_deg), [list[str](), list[str]()]
    for number in range(1, 2000):
        if number % 200 == 1:
            rates_deg_s = rng.uniform(-20.0, 20.0, chain.joint_count)
        joints_deg = np.clip(joints_deg + 0.01 * rates_deg_s, lower, upper)
        sample = ArmSample(number * PERIOD_NS, chain.end_effector(joints_deg), tuple(joints_deg))
        for alarms, supervisor in zip(found, watching, strict=True):
            alarms += [f"{number} {fault} {why}" for _, fault, why in supervisor._motion(sample)]
    assert found[0] == found[1]
    assert found[1]
    assert computed[0] < computed[1]


def test_an_arm_may_move_away_from_the_table() -> None:
    chain = CHAINS["kr6r900sixx"]
    low_deg = np.array([0.0, 10.0, 60.0, 0.0, 20.0, 0.0])
    clearance = ArmClearance(Placement(T_BASE_SURFACE), chain.forward(low_deg))
    assert clearance.over_table_m(chain.forward(low_deg)) < LINK_RADIUS_M
    noticed, _ = driven(chain, low_deg, np.array([0.0, -10.0, 0.0, 0.0, 0.0, 0.0]), 1.0)
    assert noticed is Fault.NONE


@pytest.mark.parametrize("model", ["j2n6s300", "kr6r900sixx"])
@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_an_arm_is_stopped_before_it_leaves_its_box(model: str, way: float) -> None:
    """A wall beside the arm that it would meet as it turns by 30 deg about its foot."""
    chain = CHAINS[model]
    placement, rates_deg_s = Placement(T_BASE_SURFACE), np.zeros(chain.joint_count)
    rates_deg_s[0] = 20.0 * way
    clearance = ArmClearance(placement, chain.forward(chain.home_deg))
    here, met = chain.forward(chain.home_deg), chain.forward(chain.home_deg + 1.5 * rates_deg_s)

    def wall(side: int, at_m: float) -> ArmBox:
        corners = [-3.0] * 3 + [3.0] * 3
        corners[side] = at_m if side > 2 else -at_m
        return (corners[0], corners[1], corners[2]), (corners[3], corners[4], corners[5])

    out_m = [[-clearance.in_box_m(links, wall(side, 0.0)) for side in (0, 1, 3, 4)] for links in (here, met)]
    nearing = int(np.argmax(np.subtract(*out_m[::-1])))
    box = wall((0, 1, 3, 4)[nearing], 0.5 * (out_m[0][nearing] + out_m[1][nearing]))
    assert clearance.in_box_m(here, box) > 0 > clearance.in_box_m(met, box)
    assert clearance.in_box_m(here, None) == float("inf")
    noticed, sample = driven(chain, chain.home_deg, rates_deg_s, 3.0, box)
    assert noticed is Fault.ARM_BOX
    then_deg = np.array(sample.joints_deg) + 0.02 * rates_deg_s
    assert clearance.in_box_m(chain.forward(then_deg), box) > 0
