"""Poses go there and back, and the laboratory's table is within the arm's reach."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.touch_lab import READY_NEAR_DEG, T_BASE_SURFACE
from deformscope.rig import Tool
from deformscope.robot.placement import Placement, reach
from deformscope_drivers.jaco.kinematics import CHAINS, J2N6S300, Chain, rotation_from_rpy, transform

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


def test_the_whole_table_is_within_reach_but_for_a_margin() -> None:
    placement = Placement(T_BASE_SURFACE)
    xs, ys = np.meshgrid(np.linspace(0.02, 0.58, 6), np.linspace(0.02, 0.38, 4))
    start_deg = J2N6S300.inverse(placement.T_base_ee((0.3, 0.2, 0.2), (0, 0, 1)), READY_NEAR_DEG).joints_deg
    for height_m in (0.05, 0.09, 0.2):
        centers_m = np.stack([xs.ravel(), ys.ravel(), np.full(xs.size, height_m)], axis=1)
        found = reach(J2N6S300, placement, centers_m, start_deg=start_deg)

        assert found.reached.all()
        assert found.least_singular.min() > 0.05


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
