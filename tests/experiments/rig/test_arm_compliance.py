"""How an arm gives way is found again from touches of something rigid, with what is not known of it."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.experiments.explore.explore import AtOnce
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import AsMeasured, Touch
from deformscope.experiments.rig.arm_compliance import (
    COMMON_SD,
    ComplianceTouch,
    combine_compliance,
    touch_places,
    touched_rigid,
)
from deformscope.session import run
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement

GIVES_M_PER_N = 3e-4
HEIGHT_M, OFF_M = 0.05, 0.002
DOME = 2e-3 / 40.0 ** (2.0 / 3.0)


class RigidTable:
    """A rigid block seen OFF_M too high, touched by an arm that gives."""

    def __init__(self, scatter: float = 0.0) -> None:
        self.size_m = (0.3, 0.2)
        self._random = np.random.default_rng(5)
        self._scatter = scatter

    def look(self) -> SurfaceMeasurement:
        x, y = np.meshgrid(np.linspace(0.0, 0.3, 61), np.linspace(0.0, 0.2, 41))
        points_m = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, HEIGHT_M + OFF_M)])
        points_m[:, 2] += 1e-4 * self._random.standard_normal(x.size)
        return SurfaceMeasurement(points_m, np.full(x.size, 1e-4))

    def touch(self, command: Touch) -> TouchMeasurement:
        xy_m, normal = command.xy_m, command.normal
        gives = GIVES_M_PER_N * (1.0 + self._scatter * self._random.standard_normal())
        force_n = np.clip(np.linspace(-2.0, 3.0, 250), 0.0, None)
        approach_m = np.linspace(0.008, 0.0, 250).clip(0.0032) - 0.0032  # in the air, then only the arm gives
        height = HEIGHT_M + 0.01 + np.where(force_n > 0.0, -gives * force_n, approach_m)
        place_m = np.column_stack([np.full(250, xy_m[0]), np.full(250, xy_m[1]), height])
        place_m[:, 2] += 1e-5 * self._random.standard_normal(250)
        felt_n = np.outer(force_n + 0.005 * self._random.standard_normal(250), [0.0, 0.0, 1.0])
        return TouchMeasurement(xy_m, normal, np.arange(250) * 0.01, place_m, felt_n, np.zeros((0, 3)), True)


def touched(table: RigidTable, touches: int) -> list[ComplianceTouch]:
    made: list[ComplianceTouch] = []
    recorder: Any = SimpleNamespace(write=lambda step: None)
    geometry, place_m = AsMeasured(table.size_m), np.array([0.15, 0.1])
    options = ExploreOptions()
    experiment = touch_places(
        geometry,
        np.tile(place_m, (touches, 1)),
        lambda measured, height_m: made.append(touched_rigid(measured, height_m, options)),
    )
    run([], experiment, recorder, AtOnce(table))
    return made


def test_it_is_found_again_and_so_is_where_the_camera_is_off() -> None:
    found = combine_compliance(touched(RigidTable(), 3))
    assert len(found.touches) == 3
    assert found.compliance_m_per_n == pytest.approx(GIVES_M_PER_N, rel=0.02)
    assert found.compliance_sd == pytest.approx(COMMON_SD * GIVES_M_PER_N, rel=0.1)
    assert found.off_m == pytest.approx(OFF_M, abs=1.5e-4)


def test_touches_that_differ_are_told() -> None:
    made = touched(RigidTable(scatter=0.2), 8)
    found = combine_compliance(made)
    each = np.array([one.found.compliance_m_per_n for one in made])
    assert found.compliance_sd > 0.9 * each.std(ddof=1) / np.sqrt(8)
    assert abs(found.compliance_m_per_n - GIVES_M_PER_N) < 3.0 * found.compliance_sd


def test_nothing_tells_nothing() -> None:
    with pytest.raises(InputError):
        combine_compliance([])


class FoamTable(RigidTable):
    """Foam where a rigid block should be: a ball sinks with the power 2/3 of the force."""

    def touch(self, command: Touch) -> TouchMeasurement:
        made = super().touch(command)
        force_n = made.force_n[:, 2].clip(0.0)
        place_m = made.position_m.copy()
        place_m[:, 2] = np.where(force_n > 0.02, HEIGHT_M + 0.01 - 3e-3 * force_n ** (2.0 / 3.0), place_m[:, 2])
        return dataclasses.replace(made, position_m=place_m)


class DomedTable(RigidTable):
    """The rigid block under a force sensor's rubber dome, which yields 2 mm at 40 N (Hertz)."""

    def __init__(self, gives_m_per_n: float) -> None:
        super().__init__()
        self._more = gives_m_per_n - GIVES_M_PER_N

    def touch(self, command: Touch) -> TouchMeasurement:
        made = super().touch(command)
        force_n = made.force_n[:, 2].clip(0.0)
        place_m = made.position_m.copy()
        place_m[:, 2] -= np.where(force_n > 0.02, self._more * force_n + DOME * force_n ** (2.0 / 3.0), 0.0)
        return dataclasses.replace(made, position_m=place_m)


@pytest.mark.parametrize("stiffness_n_per_mm", [5.0, 10.0, 30.0])
def test_a_rubber_dome_on_a_stiff_arm_is_no_foam_and_not_the_arm_s(stiffness_n_per_mm: float) -> None:
    """At 3 N it yields 0.36 mm, an arm of 10 N/mm 0.3 mm. The two laws are much alike: the interval says so."""
    gives_m_per_n = 1e-3 / stiffness_n_per_mm
    found = combine_compliance(touched(DomedTable(gives_m_per_n), 4))
    assert abs(found.compliance_m_per_n - gives_m_per_n) < 2.0 * found.compliance_sd
    assert found.compliance_sd < 2e-5
    assert found.dome == pytest.approx(DOME, rel=0.2)
    at_3_n = found.compliance_m_per_n * 3.0 + found.dome * 3.0 ** (2.0 / 3.0)
    assert at_3_n == pytest.approx(gives_m_per_n * 3.0 + DOME * 3.0 ** (2.0 / 3.0), rel=0.02)
    assert found.off_m == pytest.approx(OFF_M, abs=1.5e-4)


def test_a_rigid_tip_has_no_dome() -> None:
    assert combine_compliance(touched(RigidTable(), 3)).dome < 1e-5


def test_foam_is_not_taken_for_something_rigid() -> None:
    with pytest.raises(InputError, match="something rigid"):
        touched(FoamTable(), 1)
