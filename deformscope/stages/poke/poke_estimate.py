"""Result of a fit of layers to pokes: beta with its interval and verdict, stiffness, and a model for predictions."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import logsumexp

from deformscope.arrays import FloatArray
from deformscope.stages.fit.doubts import found_in_numbers, ordered
from deformscope.stages.fit.estimate import (
    Comparison,
    Curve,
    Estimate,
    Identifiability,
    Posterior,
    relative_verdict,
    verdict,
)
from deformscope.stages.fit.force import secant
from deformscope.stages.fit.model import FORCE_SHARE, distances, nearest_error
from deformscope.stages.fit.noise import independent
from deformscope.stages.fit.search import beta_of
from deformscope.stages.msm.poke import Law, Tip
from deformscope.stages.poke.closed_form import half_space
from deformscope.stages.poke.fitted import FittedModel, Rival
from deformscope.stages.poke.poke_fit import DOWN, PokesFit, PosedPoke
from deformscope.stages.poke.stiffness_field import fit_field

NEIGHBOUR_STEPS = (-0.9, -0.45, -0.2, 0.0, 0.2, 0.45, 0.9)
"""Values of -log(1 - beta) around the estimate at which the error curve is computed."""

NEXT_TO = 0.01
"""A value within this of an end of the range is not distinguished from the end."""

BEYOND, CLEAR = 5, 2.5
"""Number of values from there to the end of the range, if the error has not risen to this multiple of the lowest: high
betas converge slowly."""

FINE, THETAS = 161, 21
"""Values of -log(1 - beta) and of theta at which the posterior is taken."""

THETA_STEP = 0.05
LEAST_AFFECTED = 0.1
"""The least beta at which theta's effect is evaluated: it is proportional to beta, and near 0 only rounding remains."""

NUMERICS = 1e-3
"""Error that contact and lattice are solved to, as a share of the depth."""

RIVAL = 1.5
"""A cluster size whose error is within this factor of the best one's is a rival."""

LEAST_MISFIT = 0.02
"""Relative deviation that a stiffness has at least: of the force's lattice and tip, seen with finite elements."""


@dataclass(frozen=True, slots=True)
class ApparentModulus:
    """The Young's modulus of the same force [Pa]: of a half-space with this tip (E*, no thickness), and of a uniform
    strain in the middle of the lattice (`continuum`). Neither is a material's."""

    half_space: float
    continuum: float


@dataclass(frozen=True, slots=True)
class PokeRow:
    """One poke as in the JSON. left_out_error: relative error of its stiffness predicted from the others;
    surface_error: root mean square distance near it, as a share of its depth, held out: with beta and theta fitted to
    the others. None where it is not known."""

    xy_m: tuple[float, float]
    tip: Tip
    depth_m: float
    force_n: float | None
    stiffness_n_per_m: float | None
    apparent_modulus_pa: ApparentModulus | None
    left_out_error: float | None
    surface_error: float | None
    surface_error_held_out: float | None


@dataclass(frozen=True, slots=True)
class PokesResult:
    """The estimate, a comparison of the surface for each poke that beta was fitted to, the fit, and the model."""

    estimate: Estimate
    comparisons: tuple[Comparison, ...]
    fit: PokesFit
    model: FittedModel

    def rows(self) -> list[PokeRow]:
        """Each poke: place, depth, force, stiffness there and how well it is followed."""
        measured, k = self.fit.stiffness(self.fit.best)
        by_poke = dict(zip(measured.tolist(), k.tolist(), strict=True))
        left_out = dict(zip(measured.tolist(), self.model.left_out.tolist(), strict=True))
        error = dict(zip(self.fit.shaped.tolist(), self.fit.best.surface_error.tolist(), strict=True))
        held_out = dict(zip(self.fit.shaped.tolist(), self.fit.best.held_out.tolist(), strict=True))
        rows = []
        for index, poke in enumerate(self.fit.pokes):
            k_here = by_poke.get(index)
            modulus = None
            if k_here is not None and poke.force is not None:
                modulus = ApparentModulus(
                    half_space(poke.tip, poke.depth, poke.force).modulus,
                    continuum(self.fit.best.law, k_here, self.fit.spacing)[0],
                )
            errors = (
                None if one is None or not np.isfinite(one) else one
                for one in (each.get(index) for each in (left_out, error, held_out))
            )
            xy_m = float(poke.at[0]), float(poke.at[1])
            rows.append(PokeRow(xy_m, poke.tip, poke.depth, poke.force, k_here, modulus, *errors))
        return rows

    def tried_json(self) -> list[dict[str, object]]:
        """JSON of every cluster size that was tried, the best first."""
        return [
            {
                "cluster_size": one.law.cluster_size,
                "beta": one.law.beta,
                "theta": one.law.theta,
                "error": one.score,
                "surface_error": float(np.sqrt(np.mean(one.surface_error**2))),
                "converged": one.converged,
            }
            for one in self.fit.tried
        ]


def continuum(law: Law, stiffness: float, spacing: float) -> tuple[float, float]:
    """Young's modulus [Pa] and Poisson's ratio of an even strain in the middle of a 3D lattice of these clusters.

    A window of s^3 particles at spacing h has second moments s^3 (s^2 - 1) h^2 / 12, and one window starts at each
    particle. Its energy is (1 - beta) |e|^2, and with volume conserved beta theta tr(e)^2 / 3, times half of these
    moments and k. Therefore mu = k m (1 - beta) / 2 h and lambda = k m beta theta / 3 h with m = s^3 (s^2 - 1) / 12.
    Near a free face fewer windows overlap and the lattice is softer: an apparent modulus, not a material's."""
    s = law.cluster_size or 1
    m = stiffness * s**3 * (s**2 - 1) / 12.0 / spacing
    mu, lame = 0.5 * m * (1.0 - law.beta), m * law.beta * law.theta / 3.0
    if mu <= 0.0:
        return 0.0, 0.5
    return mu * (3.0 * lame + 2.0 * mu) / (lame + mu), 0.5 * lame / (lame + mu)


def conclude(
    fit: PokesFit, *, level: float, settings: Mapping[str, object], provenance: Mapping[str, object]
) -> PokesResult:
    """The estimate of beta, whose interval allows for theta, noise and misfit, and the model. The misfit of several
    pokes is of one kind and does not average out: likelihoods are averaged, not multiplied."""
    best = fit.best
    bounds = fit.beta_range
    profile = Profile(fit)
    posterior, rise = profile.posterior()
    ends = posterior.shortest(level, best.law.beta)
    comparisons = tuple(_comparison(one, best.law) for one in fit.posed)
    free = [np.setdiff1d(np.flatnonzero(c.seen), c.held) for c in comparisons]
    every = np.concatenate([distances(c.simulated, c.observed)[c.seen] for c in comparisons])
    pairs = zip(comparisons, free, strict=True)
    apart = np.concatenate([distances(c.simulated, c.observed)[some] for c, some in pairs])
    left = float(sum(np.sum(one.residual(one.settle([best.law])) ** 2) for one in fit.posed))
    moved = float(sum(np.sum(one.weighed(one.poke.moved) ** 2) for one in fit.posed))
    misfit = float(np.sqrt(np.mean(best.surface_error**2))) * float(np.mean([poke.depth for poke in fit.pokes]))
    identified = Identifiability(
        rise=rise,
        explained=1.0 - left / moved,
        deviation=posterior.deviation(),
        misfit=misfit / np.sqrt(fit.pokes[0].components),
    )
    reasons = ordered(found_in_numbers("beta", ends, identified, converged=best.converged))
    k = _stiffness(fit, profile, posterior, level)
    force, depth = (np.array(each) for each in zip(*((one.force or 0.0, one.depth) for one in fit.pokes), strict=True))
    model = model_of(fit, provenance)
    estimate = Estimate(
        parameter="beta",
        value=best.law.beta,
        interval=ends,
        level=level,
        bounds=bounds,
        verdict=verdict(ends, bounds, identified, reasons),
        stiffness_verdict="unidentified" if k is None else relative_verdict(*k),
        aee=float(every.mean()),
        aee_free=float(apart.mean()),
        nearest=float(np.mean([nearest_error(c.simulated[c.seen], c.observed[c.seen]) for c in comparisons])),
        unit="m",
        curve=Curve(profile.beta, profile.aee),
        converged=best.converged,
        settings={
            "cluster_size": best.law.cluster_size,
            "mode": best.law.basis,
            "theta": best.law.theta,
            "theta_fitted": fit.theta_fitted,
            "volume": "project",
            "spacing_m": fit.spacing,
            "thickness_m": fit.surface.thickness,
            "tip_slips": fit.pokes[0].tip.slips,
            "noise": misfit,
            **settings,
        },
        stiffness=k,
        contact_stiffness=secant(force, depth, FORCE_SHARE * force, np.zeros(len(force)), level),
        metres_per_unit=1.0,
        posterior=posterior,
        identifiability=identified,
        reasons=reasons,
    )
    return PokesResult(estimate=estimate, comparisons=comparisons, fit=fit, model=model)


class Profile:
    """Residuals, errors and reactions over beta, theta as fitted.

    stretched: (g,) values of -log(1 - beta), rising, over the probable range; beta: (g,) the same as beta
    residual: (g, n, 3) residuals near each poke [m]; errors: (g, q) mean distance over each poke [m]; aee: (g,)
    reaction: (g, q) per unit of k [m]"""

    def __init__(self, fit: PokesFit) -> None:
        self.fit = fit
        law = fit.best.law
        low, high = (float(-np.log1p(-end)) for end in fit.beta_range)
        self.stretched = np.empty(0)
        self.residual: list[FloatArray] = [np.empty((0, len(one.places), 3)) for one in fit.posed]
        self.reaction, self.errors = np.empty((0, len(fit.posed))), np.empty((0, len(fit.posed)))
        self._take(neighbouring_values(float(-np.log1p(-law.beta)), low, high))
        for place, end in ((0, low), (-1, high)):
            taken = self.stretched[place]
            # an error that is still so low at the end of what was taken: values beyond it may be likely
            if taken != end and self.errors.mean(axis=1)[place] < CLEAR * self.errors.mean(axis=1).min():
                self._take(np.linspace(taken, end, BEYOND + 1)[1:])
        self.aee = self.errors.mean(axis=1)
        self.affected = max(law.beta, min(LEAST_AFFECTED, fit.beta_range[1]))
        slopes = fit.theta_fitted and self.affected > 0.0
        self.by_theta = [self._slope(one, law) for one in fit.posed] if slopes else None

    @property
    def beta(self) -> FloatArray:
        """(n,) beta of each pair, from -log(1 - beta)."""
        return beta_of(self.stretched, self.fit.beta_range)

    def _take(self, stretched: FloatArray) -> None:
        """Simulate values (n,) of -log(1 - beta), none of which was before."""
        law = self.fit.best.law
        laws = [dataclasses.replace(law, beta=float(beta)) for beta in beta_of(stretched, self.fit.beta_range)]
        reaction, errors = [], []
        for column, one in enumerate(self.fit.posed):
            one.settle([law])
            state = one.settle(laws)
            self.residual[column] = np.concatenate([self.residual[column], one.residual(state) * one.poke.depth])
            reaction.append(one.reaction(state))
            errors.append(distances(one.moved(state), one.poke.moved).mean(axis=1))
        one.settle([law])
        every = np.concatenate([self.stretched, stretched])
        order = np.argsort(every)
        self.stretched = every[order]
        self.residual = [one[order] for one in self.residual]
        self.reaction = np.concatenate([self.reaction, np.stack(reaction, axis=1)])[order]
        self.errors = np.concatenate([self.errors, np.stack(errors, axis=1)])[order]

    def _slope(self, one: PosedPoke, law: Law) -> FloatArray:
        """Change of the residual near a poke by theta, at the beta `affected`, (n, 3) [m]."""
        step = THETA_STEP if law.theta < 0.5 else -THETA_STEP
        law = dataclasses.replace(law, beta=self.affected)
        one.settle([self.fit.best.law])
        here, there = one.residual(one.settle([law, dataclasses.replace(law, theta=law.theta + step)]))
        return np.asarray((there - here) * one.poke.depth / step)

    def posterior(self) -> tuple[Posterior, float]:
        """Posterior of beta with theta integrated, and by how many deviations the data separate its likeliest value
        from the least.

        The residual of the best law is misfit more than noise, and points of a surface share it. The number of
        independent points is that of patches of the size of the tip. Several pokes share it too: they count as one."""
        from scipy.interpolate import CubicSpline

        fine = np.linspace(self.stretched[0], self.stretched[-1], FINE)
        beta, law = beta_of(fine, self.fit.beta_range), self.fit.best.law
        thetas = np.linspace(0.0, 1.0, THETAS) if self.by_theta is not None else np.array([law.theta])
        squares = np.zeros((len(thetas), FINE))
        values = 0.0  # that are independent
        for place, one in enumerate(self.fit.posed):
            along = CubicSpline(self.stretched, self.residual[place], axis=0)(fine)
            patches = independent(one.places, one.poke.misfit_over or one.poke.tip.width)
            values += one.poke.components * patches / len(self.fit.posed)
            for row, theta in enumerate(thetas):
                shifted = along
                if self.by_theta is not None:
                    share = (beta / self.affected)[:, None, None]  # at beta = 0 theta does nothing
                    shifted = along + share * (theta - law.theta) * self.by_theta[place]
                squares[row] += np.mean(np.sum(shifted**2, axis=2), axis=1) / one.poke.depth**2
        squares += NUMERICS**2
        # Gaussian errors of unknown size: its integral leaves a power of the sum of squares
        value = logsumexp(-0.5 * values * np.log(squares), axis=0)
        density = np.exp(value - value.max())
        density /= np.trapezoid(density, beta)
        return Posterior(beta, density), float(np.sqrt(2.0 * (value.max() - value.min())))


def neighbouring_values(at: float, low: float, high: float) -> FloatArray:
    """(n,) values `NEIGHBOUR_STEPS` from one of -log(1 - beta) that lie in [low, high], rising. The ends of the range
    replace values beyond or next to them, so that the difference of two values is never only rounding."""
    values = at + np.array(NEIGHBOUR_STEPS)
    next_to = min(NEXT_TO, 0.25 * (high - low))
    inner = values[(values > low + next_to) & (values < high - next_to)]
    ends = [end for end, there in ((low, values[0] <= low + next_to), (high, values[-1] >= high - next_to)) if there]
    return np.sort(np.concatenate([inner, ends]))


def _stiffness(
    fit: PokesFit, profile: Profile, posterior: Posterior, level: float
) -> tuple[float, tuple[float, float]] | None:
    """k and its interval over beta's posterior, the misfit of the surface and the scatter among the pokes."""
    measured, k = fit.stiffness(fit.best)
    if not measured.size:
        return None
    value = float(np.median(k))
    tail = 0.5 * (1.0 - level)
    betas = posterior.quantile(np.linspace(tail, 1.0 - tail, 15))
    mean = profile.reaction.mean(axis=1)
    ratio = np.interp(fit.best.law.beta, profile.beta, mean) / np.interp(betas, profile.beta, mean)
    scatter = float(np.std(np.log(k), ddof=1)) if len(k) > 1 else 0.0
    misfit = float(np.sqrt(np.mean(fit.best.surface_error**2)))
    wide = 1.645 * float(np.hypot(scatter, max(misfit, LEAST_MISFIT)))
    low, high = min(1.0, float(ratio.min())), max(1.0, float(ratio.max()))
    return value, (value * low * float(np.exp(-wide)), value * high * float(np.exp(wide)))


def _comparison(one: PosedPoke, law: Law) -> Comparison:
    """The surface as it was seen and as it is simulated."""
    poke, moved = one.poke, one.moved(one.settle([law]))[0]
    held = np.flatnonzero(cKDTree(poke.touched).query(poke.points)[0] <= 1e-12)
    seen = np.ones(len(poke.points), dtype=bool)
    return Comparison(poke.points, poke.points + poke.moved, poke.points + moved, seen, held, unit="m")


def model_of(fit: PokesFit, provenance: Mapping[str, object]) -> FittedModel:
    """The model that predicts other pokes; of `conclude`, without its result of beta."""
    measured, k = fit.stiffness(fit.best)
    places = np.array([fit.pokes[i].at for i in measured]).reshape(-1, 3)
    field = fit_field(places[:, :2], k, fit.pokes[0].tip.width) if measured.size else None
    near = [one for one in fit.tried[1:] if one.converged and one.score <= RIVAL * fit.best.score]
    rivals = [Rival(one.law, fit.stiffness(one)[1], one.score) for one in near]
    held_out = fit.best.held_out
    return FittedModel(
        body="layers",
        rest=fit.surface.points,
        law=fit.best.law,
        spacing=fit.spacing,
        toward=DOWN,
        tip=fit.pokes[0].tip,
        thickness=fit.surface.thickness,
        places=places,
        stiffness=k,
        field_kind=field.kind if field is not None else "uniform",
        left_out=field.left_out if field is not None else np.zeros(0),
        surface_error=float(np.sqrt(np.mean(fit.best.surface_error**2))),
        held_out=float(np.sqrt(np.mean(held_out**2))) if np.isfinite(held_out).all() else float("nan"),
        fitted_depth=max(poke.depth for poke in fit.pokes),
        fitted_strain=max(poke.depth / poke.tip.width for poke in fit.pokes),
        rivals=tuple(rivals),
        residual=fit.best.residual,
        provenance=provenance,
    )
