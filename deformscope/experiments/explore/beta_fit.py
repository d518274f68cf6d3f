"""beta of a touch, from the dent that the camera saw during the press, by the model in the options."""

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.seen_surface import SeenSurface
from deformscope.stages.fit.estimate import Curve
from deformscope.stages.map.measured import TouchMeasurement
from deformscope.stages.map.perception import Hyperparameters, SeenDent, TouchSurface
from deformscope.stages.map.surface import fit_surface
from deformscope.stages.map.thesis import dent_of, thesis_beta
from deformscope.stages.map.touch_beta import BallContact, fit_touch
from deformscope.stages.poke.contact import ArmCompliance, ContactFit
from deformscope.stages.regions.touches import MapGrid
from deformscope.stages.see.cloud import tactile_points

THESIS_ROI_M, TACTILE_NOISE_M = 0.08, 2e-4
"""Half the side of the square that the thesis's process of a dent sees, and the noise of its virtual points."""


@dataclass(frozen=True, slots=True)
class BetaEstimate:
    """verdict: verdict, or why there is no value; value, interval: value and interval of beta, None if there is none;
    sd: deviation of the value, nan if unknown; simulated_m: (p, 3) particles of the fitted model
    dented_m, surface: (m, 2) places that the touch dented, and the surface under it, for the thesis's model; curve:
    error over beta, None where nothing was fitted"""

    verdict: str
    value: float | None = None
    interval: tuple[float, float] | None = None
    sd: float = float("nan")
    simulated_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    dented_m: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    surface: TouchSurface | None = None
    curve: Curve | None = None

    @property
    def dent(self) -> SeenDent | None:
        """The dent in a square around the touch, for the thesis's model."""
        return None if self.surface is None else self.surface.dent


def fit_beta(
    touched: TouchMeasurement, fit: ContactFit, surface: SeenSurface, arm: ArmCompliance, options: ExploreOptions
) -> BetaEstimate:
    """Beta of a touch whose contact was fitted. Raises InputError where the dent does not determine it."""
    if options.beta_model == "none":
        return BetaEstimate("not asked for")
    as_thesis = options.planner == "thesis"
    if fit.rigid and as_thesis:  # nothing moved, so every beta fits: the first of the sweep, where the tip was
        radius = options.tip_radius_m
        grid = MapGrid((4.0 * radius, 4.0 * radius), options.cell_m)
        dented = np.linalg.norm(grid.centres_m - 2.0 * radius, axis=1) <= radius
        dented_m = touched.xy_m - 2.0 * radius + grid.centres_m[dented]
        return BetaEstimate("rigid: nothing was dented", value=0.0, dented_m=dented_m)
    if fit.rigid:
        return BetaEstimate("rigid: no dent to fit")
    if options.beta_model == "thesis":
        under = touch_surface(touched, fit, surface, arm, options)
        swept = thesis_beta(under.dent, step=options.thesis.beta_step)
        return BetaEstimate(
            f"thesis: {swept.note}",
            value=swept.beta,
            simulated_m=swept.simulated_m,
            dented_m=under.dent.dented_m,
            surface=under,
            curve=swept.curve,
        )
    if surface.layer.thickness_m is None:
        return BetaEstimate("not fitted: the foam's thickness is not known")
    ball = _ball(touched, fit, arm, options.tip_radius_m)
    found = fit_touch(surface.process, touched.after_m, ball, thickness_m=surface.layer.thickness_m)
    made = BetaEstimate(
        found.estimate.verdict,
        value=found.estimate.value,
        interval=found.estimate.interval,
        sd=found.sd,
        simulated_m=found.simulated_m,
        curve=found.estimate.curve,
    )
    if not as_thesis:
        return made
    under = touch_surface(touched, fit, surface, arm, options)
    return dataclasses.replace(made, dented_m=under.dent.dented_m, surface=under)


def touch_surface(
    touched: TouchMeasurement,
    fit: ContactFit,
    surface: SeenSurface,
    arm: ArmCompliance,
    options: ExploreOptions,
    before: Hyperparameters | None = None,
) -> TouchSurface:
    """The surface under a touch that is not rigid, and the dent as in the thesis: from the touch surface's own process,
    with virtual points where the ball is. before: hyper-parameters under the touch before"""
    ball = _ball(touched, fit, arm, options.tip_radius_m)
    tactile = tactile_points(ball.lowest_m, ball.radius_m, ball.depth_m, normal=touched.normal)
    near = np.abs(touched.after_m[:, :2] - touched.xy_m).max(axis=1) < THESIS_ROI_M
    noise_m = np.full(len(tactile), TACTILE_NOISE_M)
    pressed = fit_surface(touched.after_m[near], known_m=tactile, known_noise_m=noise_m, like=before)
    dent = dent_of(surface.process, pressed, touched.xy_m, options.thesis.beta_grid_m)
    return TouchSurface(dent, tactile, pressed.learned)


def _ball(touched: TouchMeasurement, fit: ContactFit, arm: ArmCompliance, radius_m: float) -> BallContact:
    """Position of the ball at its greatest depth."""
    deepest = int(np.argmax(-(touched.position_m @ touched.normal)))
    bent_m = arm.compliance_m_per_n * fit.peak_force_n  # the arm reports it that much deeper
    return BallContact(
        lowest_m=touched.position_m[deepest] - (radius_m - bent_m) * touched.normal,
        radius_m=radius_m,
        depth_m=fit.dent_m(fit.peak_force_n),
        force_n=fit.peak_force_n,
    )
