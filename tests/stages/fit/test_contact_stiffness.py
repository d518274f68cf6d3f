"""Stiffness at the contact: force over the distance that the contact moved."""

import dataclasses

import numpy as np
import pytest

from deformscope.stages.fit.force import contact_stiffness, secant
from deformscope.stages.fit.model import Observation

LEVEL = 0.9


def pressed(force_n: float | None, depth: float, **more: object) -> Observation:
    """A sheet of 4 x 3 particles, 1 cm apart, whose top row went down by `depth` and whose bottom row is fixed."""
    y, x = np.divmod(np.arange(12), 4)
    rest = 0.01 * np.column_stack([x, y]).astype(float)
    deformed = rest - np.array([0.0, depth]) * (y / 2.0)[:, None]
    held = np.concatenate([np.arange(4), np.arange(8, 12)])
    seen = Observation(rest, deformed, held, np.ones(12, dtype=bool), force_n=force_n)
    return dataclasses.replace(seen, **more)  # type: ignore[arg-type]


def test_two_newtons_at_six_millimetres() -> None:
    found = contact_stiffness([pressed(2.0, 0.006, force_noise_n=0.1)], LEVEL)
    assert found is not None
    value, (low, high) = found
    assert value == pytest.approx(2.0 / 6.0)
    assert (value - low, high - value) == pytest.approx(2 * (1.6449 * 0.05 * value,), rel=1e-3)


def test_pixels_become_millimetres() -> None:
    found = contact_stiffness([pressed(2.0, 0.006, metres_per_unit=0.5, unit="px")], LEVEL)
    assert found[0] == pytest.approx(2.0 / 3.0)


@pytest.mark.parametrize(
    "seen", [pressed(None, 0.006), pressed(2.0, 0.006, metres_per_unit=None, unit="px"), pressed(2.0, 0.0)]
)
def test_not_known_without_force_scale_or_motion(seen: Observation) -> None:
    assert contact_stiffness([seen], LEVEL) is None


def test_forces_that_scatter_more_than_their_noise_widen_the_interval() -> None:
    depth, sd, none = np.full(2, 0.005), np.full(2, 0.01), np.zeros(2)
    alike, unlike = (secant(np.array(force), depth, sd, none, LEVEL) for force in ((2.0, 2.0), (1.0, 3.0)))
    assert np.ptp(unlike[1]) > 50 * np.ptp(alike[1])
    assert min(unlike[1]) >= 0.0


def test_interval_holds_the_true_stiffness_as_often_as_it_says() -> None:
    rng, true, held = np.random.default_rng(5), 0.4, 0
    for _ in range(2000):
        depth = rng.uniform(0.003, 0.008, 3)
        noise_n, noise_m = np.full(3, 0.05), np.full(3, 1e-4)
        force = 1e3 * true * depth + rng.normal(0.0, noise_n)
        found = secant(force, depth + rng.normal(0.0, noise_m), noise_n, noise_m, LEVEL)
        held += found[1][0] <= true <= found[1][1]
    assert 0.87 < held / 2000 < 0.97  # Birge's ratio widens it, never narrows it
