"""What a stiffness that changes with the force does to the fitted law."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.poke.contact import CONTACTS, LEAST_SHARE, ContactFit, fit_approach, law_response

FORCE_N, DEPTH_M = 5.0, 0.009
UP = np.array([0.0, 0.0, 1.0])


def fitted(shift: FloatArray, exponent_sd: float) -> ContactFit:
    """Of an approach without noise, whose log stiffness is higher by `shift` (3,) under CONTACTS."""
    force = np.linspace(0.0, 1.01 * FORCE_N, 4000)
    contact = (force / FORCE_N) ** (1.0 / 3.0)
    sunk = DEPTH_M * (force / FORCE_N) ** (2.0 / 3.0) * np.exp(-np.polyval(np.polyfit(CONTACTS, shift, 2), contact))
    gone = np.arange(-0.003, np.interp(FORCE_N, force, sunk), 1e-4)
    felt = np.interp(gone, sunk, force)
    position = -gone[:, None] * UP
    return fit_approach(
        0.01 * np.arange(len(gone)),
        position,
        felt[:, None] * UP,
        UP,
        set_force_n=FORCE_N,
        exponent_sd=exponent_sd,
        least_share=LEAST_SHARE,
    )


def test_the_same_at_every_force_is_stiffness_alone() -> None:
    to_log, to_exponent = law_response()
    assert to_log.sum() == pytest.approx(1.0)
    assert to_exponent.sum() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("shift", [(0.0, 0.02, 0.04), (0.02, 0.03, 0.05), (0.0, -0.01, -0.03)])
def test_as_the_fit_itself_has_it(shift: tuple[float, float, float]) -> None:
    """Given and free exponents, to a tenth of what changes: the law is not linear, and the fit weighs its samples."""
    more, none = np.array(shift), np.zeros(3)
    to_log, to_exponent = law_response()
    given = fitted(more, 1e-4).log_stiffness - fitted(none, 1e-4).log_stiffness
    free = fitted(more, 1.0).exponent - fitted(none, 1.0).exponent
    assert given == pytest.approx(float(to_log @ more), rel=0.1)
    assert free == pytest.approx(float(to_exponent @ more), rel=0.15)


def test_stiffness_of_a_given_exponent_follows_from_a_free_fit() -> None:
    """By what both are off by together."""
    free, given = fitted(np.array([0.0, 0.02, 0.04]), 1.0), fitted(np.array([0.0, 0.02, 0.04]), 1e-4)
    goes_with = free.exponent_related / free.exponent_sd**2
    assert free.log_stiffness - goes_with * (free.exponent - 1.5) == pytest.approx(given.log_stiffness, abs=0.002)
    assert abs(free.log_stiffness - given.log_stiffness) > 0.004
