"""Poses go there and back, and the laboratory's table is within the arm's reach."""

from typing import Any

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.touch_lab import READY_NEAR_DEG
from deformscope.rig.rig_file import Tool
from deformscope.robot.placement import PLAN_MARGIN_DEG, Placement, follow
from deformscope.robot.setup import T_BASE_SURFACE
from deformscope_drivers.arm.kinematics import Chain, FloatArray, rotation_from_rpy, transform
from deformscope_drivers.jaco.chains import CHAINS, J2N6S300
from studies.reach import reach

TURNED = transform(rotation_from_rpy(0.0, 0.0, 0.4), (-0.2, -0.5, 0.05))


@pytest.mark.parametrize(
    "tool",
    [
        Tool(),
        Tool(tip="flat"),
        Tool(T_ee_tip=tuple(map(tuple, transform(rotation_from_rpy(0.1, 0.2, 0.3), (0.01, 0.0, 0.12)).tolist()))),
    ],
)
def test_there_and_back(tool: Tool) -> None:
    placement = Placement(TURNED, tool)
    normal = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    T = placement.T_surface_center(placement.T_base_ee((0.1, 0.2, 0.3), normal))
    assert T[:3, 3] == pytest.approx([0.1, 0.2, 0.3])
    assert T[:3, 2] == pytest.approx(-normal)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


def test_a_straight_stick_points_down_from_above() -> None:
    placement = Placement(np.eye(4), Tool(length_m=0.1, radius_m=0.01))
    # the sphere's centre is a radius before the stick's end
    assert placement.T_base_ee((0.3, 0.0, 0.2), (0, 0, 1))[:3, 3] == pytest.approx([0.3, 0.0, 0.29])


def ready_deg(placement: Placement) -> FloatArray:
    """Joint angles of an arm that stands above the middle of the laboratory's table."""
    return J2N6S300.inverse(placement.T_base_ee((0.3, 0.2, 0.2), (0, 0, 1)), READY_NEAR_DEG).joints_deg


def test_the_tip_is_led_down_all_over_the_table_but_for_its_edge_at_the_arm() -> None:
    placement = Placement(T_BASE_SURFACE)
    start_deg = ready_deg(placement)
    xs, ys = np.meshgrid(np.linspace(0.02, 0.58, 6), [0.02, 0.14, 0.26, 0.32])
    for x, y in zip(xs.flat, ys.flat, strict=True):
        assert follow(J2N6S300, placement, np.array([[x, y, 0.2], [x, y, 0.025]]), start_deg=start_deg).all(), (x, y)
    at_the_arm_m = np.array([[0.3, 0.38, 0.2], [0.3, 0.38, 0.03]])
    assert follow(J2N6S300, placement, at_the_arm_m, start_deg=start_deg).tolist() == [True, False]


def test_planned_poses_keep_a_margin_to_joint_limits() -> None:
    """At the edge by the arm its third joint is folded: 1 deg from its limit."""
    placement = Placement(T_BASE_SURFACE)
    start_deg = ready_deg(placement)
    target = placement.T_base_ee((0.3, 0.38, 0.05), (0, 0, 1))
    near = J2N6S300.inverse(target, start_deg, starts=1)
    assert near.converged
    assert J2N6S300.to_limits_deg(near.joints_deg).min() < 2.0
    inside = J2N6S300.inverse(target, start_deg, margin_deg=PLAN_MARGIN_DEG)
    assert J2N6S300.to_limits_deg(inside.joints_deg).min() >= PLAN_MARGIN_DEG - 1e-9


def test_a_way_past_a_singularity_that_turns_the_arm_about_is_refused() -> None:
    """Both ends are well reached, but between them the wrist is stretched out, 12 deg beside its way."""
    placement = Placement(T_BASE_SURFACE)
    start_deg = ready_deg(placement)
    refused = []
    for azimuth in np.radians([0.0, 90.0, 180.0, 270.0]):
        angle = np.radians(12.0)
        normal = np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])
        for x in (0.1, 0.2, 0.3, 0.4, 0.5):
            point_m = np.array([x, 0.3, 0.06])
            down_m = np.array([point_m + 0.06 * normal, point_m - 0.035 * normal])
            led = follow(J2N6S300, placement, down_m, normal, start_deg=start_deg)
            ends = reach(J2N6S300, placement, down_m, normal, start_deg=start_deg)
            if ends.reached.all() and ends.least_singular.min() > 0.03 and not led.all():
                refused.append((x, azimuth))
    assert refused


def test_what_is_not_rigid_is_refused() -> None:
    with pytest.raises(InputError, match="rigid"):
        Placement(2.0 * np.eye(4))


@pytest.mark.parametrize("chain", CHAINS.values(), ids=list(CHAINS))
def test_what_is_farther_than_all_links_together_is_not_sought(chain: Chain, monkeypatch: pytest.MonkeyPatch) -> None:
    """A large surface has thousands of such places, each of which would cost many searches."""
    sought: list[object] = []
    inverse = Chain.inverse

    def counted(chain: Chain, *told: Any, **more: Any) -> Any:
        sought.append(told)
        return inverse(chain, *told, **more)

    monkeypatch.setattr(Chain, "inverse", counted)
    found = reach(chain, Placement(T_BASE_SURFACE), np.array([[0.3, 0.2, 0.06], [1.9, 1.9, 0.06]]))
    assert found.reached.tolist() == [True, False]
    assert len(sought) == 1
