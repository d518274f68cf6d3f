"""beta of a touch, from the dent that the camera saw during the press, by the model in the options."""

from dataclasses import dataclass, field

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.seen_surface import SeenSurface
from deformscope.stages.fit.estimate import Curve
from deformscope.stages.map.measured import TouchMeasurement
from deformscope.stages.map.touch_beta import BallContact, fit_touch
from deformscope.stages.poke.contact import ArmCompliance, ContactFit


@dataclass(frozen=True, slots=True)
class BetaEstimate:
    """verdict: verdict, or why there is no value; value, interval: value and interval of beta, None if there is none;
    sd: deviation of the value, nan if unknown; simulated_m: (p, 3) particles of the fitted model
    curve: error over beta, None where nothing was fitted"""

    verdict: str
    value: float | None = None
    interval: tuple[float, float] | None = None
    sd: float = float("nan")
    simulated_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    curve: Curve | None = None


def fit_beta(
    touched: TouchMeasurement, fit: ContactFit, surface: SeenSurface, arm: ArmCompliance, options: ExploreOptions
) -> BetaEstimate:
    """Beta of a touch whose contact was fitted. Raises InputError where the dent does not determine it."""
    if options.beta_model == "none":
        return BetaEstimate("not asked for")
    if fit.rigid:
        return BetaEstimate("rigid: no dent to fit")
    if surface.layer.thickness_m is None:
        return BetaEstimate("not fitted: the foam's thickness is not known")
    ball = ball_at_depth(touched, fit, arm, options.tip_radius_m)
    found = fit_touch(surface.process, touched.after_m, ball, thickness_m=surface.layer.thickness_m)
    return BetaEstimate(
        found.estimate.verdict,
        value=found.estimate.value,
        interval=found.estimate.interval,
        sd=found.sd,
        simulated_m=found.simulated_m,
        curve=found.estimate.curve,
    )


def ball_at_depth(touched: TouchMeasurement, fit: ContactFit, arm: ArmCompliance, radius_m: float) -> BallContact:
    """Position of the ball at its greatest depth."""
    deepest = int(np.argmax(-(touched.position_m @ touched.normal)))
    bent_m = arm.compliance_m_per_n * fit.peak_force_n  # the arm reports it that much deeper
    return BallContact(
        lowest_m=touched.position_m[deepest] - (radius_m - bent_m) * touched.normal,
        radius_m=radius_m,
        depth_m=fit.dent_m(fit.peak_force_n),
        force_n=fit.peak_force_n,
    )
