"""Whether a tip slid, on touches whose sliding is known."""

import numpy as np
import pytest

from deformscope.stages.poke.creep import SlipFit, fit_slip

STICK, TURN = 0.8, np.array([0.6, 0.8])


def touch(lean: float, friction: float, tilt: float = 0.0) -> SlipFit:
    """A ball that goes aside by `lean` of its way down, 6 mm, on foam on which it sticks until friction is reached."""
    random = np.random.default_rng(0)
    dent_m = np.concatenate([np.zeros(20), np.linspace(0.0, 0.006, 80), np.full(100, 0.006)])
    force_n = 3.0 * (dent_m / 0.006) ** 1.5
    across_n, aside_m = np.zeros(len(dent_m)), lean * dent_m
    for i in range(1, len(dent_m)):
        stiff = STICK * force_n[i] / max(dent_m[i], 1e-6)
        limit = friction * force_n[i]
        across_n[i] = np.clip(across_n[i - 1] + stiff * (aside_m[i] - aside_m[i - 1]), -limit, limit)
    across = (across_n + tilt * force_n)[:, None] * TURN + 0.02 * random.standard_normal((len(dent_m), 2))
    aside = aside_m[:, None] * TURN + 1e-4 * random.standard_normal((len(dent_m), 2))
    return fit_slip(aside, across, dent_m, force_n, 0.02)


def test_a_tip_that_slides_is_told_and_how_far() -> None:
    fit = touch(0.5, 0.06)
    assert fit.probability > 0.95
    assert fit.friction == pytest.approx(0.06, rel=0.3)
    # sticking would come to 2/3 STICK lean of the force
    assert 1e-3 < fit.slid_m < 0.5 * 0.006


@pytest.mark.parametrize(("lean", "tilt"), [(0.4, 0.0), (0.0, 0.0), (0.0, 0.05), (0.3, 0.05)])
def test_a_tip_that_sticks_or_is_tilted_does_not_slide(lean: float, tilt: float) -> None:
    assert touch(lean, 5.0, tilt).probability < 0.5
