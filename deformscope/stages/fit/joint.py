"""beta and theta together: their joint posterior on a grid that is narrowed until it resolves it.

Volume is conserved by projection here: with eq. 3.17 overlapping clusters at high beta and theta diverge. Simulated
states between knots are cubic splines in -log(1 - beta) and theta; the likelihood is that for one parameter."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.calibrate import TURNED, check_observations, check_range, estimate_of, shape_doubts
from deformscope.stages.fit.distance import distances
from deformscope.stages.fit.doubts import bulging, swapped_axes
from deformscope.stages.fit.estimate import Comparison, Curve, Doubt, Estimate, Parameter, Posterior
from deformscope.stages.fit.force import contact_stiffness, stiffness_interval
from deformscope.stages.fit.inference import Inferred, misfit_outweighs, white_noise
from deformscope.stages.fit.model import FitOptions, Model, Observation
from deformscope.stages.fit.noise import few
from deformscope.stages.fit.outliers import LeftOut, left_out_json, without_outliers
from deformscope.stages.fit.residuals import DROP, Explanation, Residuals
from deformscope.stages.fit.search import Progress, beta_of
from deformscope.stages.fit.two_materials import FittedBody, two_materials
from deformscope.stages.msm.solver import Relaxed

KNOTS = (17, 11)
BETWEEN = 3
"""Candidates of beta and of theta over their ranges, and steps of the grid from one to the next."""

RESOLVED, NARROWEST, ZOOMS = 0.3, 1e-7, 8
"""The grid is narrowed until the posterior fills this share of it, or to this range, at most so often."""

JOINTLY: tuple[Parameter, Parameter] = ("beta", "theta")

SUMMARIES = 5
"""Most directions that represent the effect of beta and theta on the particles."""

DRAWN = 24
"""Number of draws of the posterior for the stiffness."""

THETA_STEP = 0.02
"""Step of theta for a derivative."""

POLISH = 6
"""Number of successive grids of 5 x 5 around the lowest error."""


@dataclass(frozen=True, slots=True)
class JointOptions:
    """How beta and theta are found within their bounds; model: its own beta and theta are not used."""

    model: Model = Model(volume="project")  # noqa: RUF009
    beta_bounds: tuple[float, float] = (0.0, 0.99)
    theta_bounds: tuple[float, float] = (0.0, 1.0)
    level: float = 0.9
    seed: int = 0


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """The most likely beta and theta, and their posterior.

    beta, theta: each with its marginal posterior; `least_aee` of both is of one pair; its curve is the least error
    over the other
    density: (b, t) joint posterior over `beta.posterior.parameter` and `theta.posterior.parameter`, whose integral is 1
    correlation: correlation of the two in the posterior"""

    beta: Estimate
    theta: Estimate
    density: FloatArray
    correlation: float

    def as_json(self) -> dict[str, object]:
        """The public form: common values as in the estimate of one parameter, and those of each under `parameters`."""
        own = ("value", "least_aee", "interval", "bounds", "verdict", "verdict_text", "reasons", "curve")
        each = {one.parameter: one.as_json() for one in (self.beta, self.theta)}
        shared = {k: v for k, v in each["beta"].items() if k not in (*own, "parameter", "posterior")}
        assert self.beta.posterior is not None
        assert self.theta.posterior is not None
        return {
            "parameters": {name: {key: one[key] for key in own} for name, one in each.items()},
            "posterior": {
                "beta": self.beta.posterior.parameter.tolist(),
                "theta": self.theta.posterior.parameter.tolist(),
                "density": self.density.tolist(),
            },
            "correlation": self.correlation,
            **shared,
        }


def calibrate_both(
    seen: Sequence[Observation], options: JointOptions, *, progress: Progress | None = None
) -> tuple[JointEstimate, tuple[Comparison, ...]]:
    """Fit beta and theta to observations that share them."""
    check_observations(seen)
    check_range("beta", options.beta_bounds)
    check_range("theta", options.theta_bounds)
    if options.model.volume != "project":
        raise InputError("volume conserved by projection for beta and theta together", options.model.volume)
    with threadpool_limits(1):
        spacing = [options.model.body(one).scale for one in seen]
        seen, left_out = without_outliers(seen, spacing, partial(_fitted, options))
        return _Joint(seen, options, left_out).run(progress)


def _fitted(options: JointOptions, seen: Sequence[Observation]) -> list[FloatArray]:
    """Positions (K, d) of each observation at the lowest error of all."""
    joint = _Joint(seen, options)
    grid = np.meshgrid(joint.shrink(np.linspace(*joint.ends, KNOTS[0])), np.linspace(*options.theta_bounds, KNOTS[1]))
    joint.simulate(grid[0].ravel(), grid[1].ravel())
    beta, theta, _ = joint.best()
    return [state[0] for state in joint.simulate(np.array([beta]), np.array([theta]))]


class _Joint:
    """The grid over both, and the errors of all that was simulated."""

    def __init__(self, seen: Sequence[Observation], options: JointOptions, left_out: Sequence[LeftOut] = ()) -> None:
        self.seen, self.options, self.left_out = list(seen), options, left_out
        self.bodies = [options.model.body(one) for one in seen]
        rng = np.random.default_rng(options.seed)
        self.parts = [Residuals(one, body, rng) for one, body in zip(self.seen, self.bodies, strict=True)]
        self.converged = True
        self.tried = np.empty((0, 3))  # beta, theta, error
        self.evidence: list[tuple[FloatArray, FloatArray]] = []

    def simulate(self, beta: FloatArray, theta: FloatArray) -> list[FloatArray]:
        """States (g, K, d) of every observation; their errors are remembered."""
        states, total, count = [], np.zeros(len(beta)), 0
        for one, body in zip(self.seen, self.bodies, strict=True):
            state = body.relax(one.deformed[one.held], beta, theta, volume="project")
            self.converged &= bool(state.converged.all())
            states.append(state.position)
            total += distances(state.position[:, one.observed], one.deformed[one.observed]).sum(axis=1)
            count += int(one.observed.sum())
        self.tried = np.concatenate([self.tried, np.column_stack([beta, theta, total / count])])
        return states

    def over(
        self, b: tuple[float, float], t: tuple[float, float], *, explain: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Grids of stretched beta and of theta, and the log likelihood (b, t) there: of all residuals, for their
        explanations, or of the part that the parameters can change."""
        knots = [np.linspace(*ends, count) for ends, count in zip((b, t), KNOTS, strict=True)]
        fine = [np.linspace(*ends, (count - 1) * BETWEEN + 1) for ends, count in zip((b, t), KNOTS, strict=True)]
        beta, theta = (each.ravel() for each in np.meshgrid(self.shrink(knots[0]), knots[1], indexing="ij"))
        corners = np.array([0, KNOTS[1] - 1, (KNOTS[0] - 1) * KNOTS[1], KNOTS[0] * KNOTS[1] - 1])
        u, v = (np.linspace(0.0, 1.0, len(each)) for each in fine)
        share = np.stack([np.outer(x, y).ravel() for x in (1.0 - u, u) for y in (1.0 - v, v)])
        spline = np.kron(*(CubicSpline(x, np.eye(len(x)))(at) for x, at in zip(knots, fine, strict=True)))
        total = np.zeros(share.shape[1])
        self.evidence = []
        for part, state in zip(self.parts, self.simulate(beta, theta), strict=True):
            responses = [self._response(part, float(beta[at]), float(theta[at]), state[at]) for at in corners]
            if explain:
                best = int(self.tried[-len(beta) :, 2].argmin())
                some = np.unique(np.concatenate([[best], np.linspace(0, len(beta) - 1, 12).round().astype(int)]))
                part.choose(state[some], self._response(part, float(beta[best]), float(theta[best]), state[best]))
            residual, mix = few(part.left(state), spline)
            if explain:
                found = [part.errors.evidence(residual, response, part.chosen, mix) for response in responses]
                likelihood = np.sum(share[:, None] * np.stack([one.log_likelihood for one in found]), axis=0)
                scale = np.sum(share[:, None] * np.stack([one.log_scale for one in found]), axis=0)
                self.evidence.append((likelihood, scale))
                total += logsumexp(likelihood, axis=0)
            else:
                residual = np.tensordot(mix, residual, 1)
                onto, amplitude = part.summary(residual, responses[len(responses) // 2], SUMMARIES)
                each = [part.log_summary(residual, onto, amplitude, one) for one in responses]
                total += np.sum(share * np.stack(each), axis=0)
        return fine[0], fine[1], total.reshape(len(fine[0]), len(fine[1]))

    def narrowed(
        self, progress: Progress | None, *, explain: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray, list[float]]:
        """The grid that resolves the posterior, beta (b,) and theta (t,), its logarithm (b, t), and the number of
        standard deviations that separate, for each parameter, the most likely value of the whole range from the least
        likely."""
        b, t, total = self.over(self.ends, self.options.theta_bounds, explain=explain)
        rise = [float(np.sqrt(2.0 * np.ptp(total.max(axis=axis)))) for axis in (1, 0)]
        for zoom in range(ZOOMS):
            if progress is not None:
                progress("joint posterior", zoom, ZOOMS)
            alive = total >= total.max() - DROP
            ends = [self._ends(grid, alive.any(axis=axis)) for grid, axis in ((b, 1), (t, 0))]
            share = [(e[1] - e[0]) / (g[-1] - g[0]) for e, g in zip(ends, (b, t), strict=True)]
            if min(share) >= RESOLVED or max(e[1] - e[0] for e in ends) < NARROWEST:
                break
            b, t, total = self.over(*ends, explain=explain)
        return b, t, total, rise

    def run(self, progress: Progress | None) -> tuple[JointEstimate, tuple[Comparison, ...]]:
        b, t, total, rise = self.narrowed(progress, explain=True)
        over = (np.exp(total - total.max()) * np.gradient(self.shrink(b))[:, None] * np.gradient(t)).ravel()
        for part, (likelihood, scale) in zip(self.parts, self.evidence, strict=True):
            part.weigh(likelihood, scale, over / over.sum())
        if misfit_outweighs(self.parts):
            b, t, total, rise = self.narrowed(progress, explain=False)
        *least, least_aee = self.best()
        beta, theta = self._mode(b, t, total)
        grid = self.shrink(b)
        density = np.exp(total - total.max())
        density /= np.trapezoid(np.trapezoid(density, t, axis=1), grid)
        each = (grid, np.trapezoid(density, t, axis=1)), (t, np.trapezoid(density, grid, axis=0))
        over = (density * np.gradient(grid)[:, None] * np.gradient(t)).ravel()
        explanations = tuple(part.explanation for part in self.parts)
        states = self.simulate(np.array([beta]), np.array([theta]))
        aee = float(self.tried[-1, 2])
        comparisons = tuple(
            Comparison(s.rest, s.deformed, state[0], s.observed, s.held, s.unit)
            for s, state in zip(self.seen, states, strict=True)
        )
        noise = white_noise(explanations, self.parts)
        k = self._stiffness(grid, t, density, (beta, theta), explanations)
        found = [
            Inferred(Posterior(*marginal), explanations, noise, separation, self.converged)
            for marginal, separation in zip(each, rise, strict=True)
        ]
        doubts = [*shape_doubts(self.seen), *(self._in_residuals(beta, theta, comparisons) if self.converged else ())]
        closest = [state[0] for state in self.simulate(*(np.array([one]) for one in least))]
        of_beta, of_theta = (
            self._estimate(name, value, (at, least_aee), closest, one, comparisons, aee, k, doubts)
            for name, value, at, one in zip(JOINTLY, (beta, theta), least, found, strict=True)
        )
        mean_b, mean_t = (float(np.sum(over * x) / over.sum()) for x in self._flat(grid, t))
        gb, gt = self._flat(grid - mean_b, t - mean_t)
        spread = np.sqrt(np.sum(over * gb**2) * np.sum(over * gt**2))
        correlation = float(np.sum(over * gb * gt) / spread) if spread > 0.0 else 0.0
        return JointEstimate(of_beta, of_theta, density, correlation), comparisons

    def _mode(self, b: FloatArray, t: FloatArray, total: FloatArray) -> tuple[float, float]:
        """The most likely beta and theta, between the grid's values (b,), (t,) by splines. total: (b, t)"""
        row, column = divmod(int(total.argmax()), len(t))
        near = [np.linspace(x[max(i - 1, 0)], x[min(i + 1, len(x) - 1)], 41) for x, i in ((b, row), (t, column))]
        fine = RectBivariateSpline(b, t, np.maximum(total, total.max() - DROP))(*near)
        row, column = divmod(int(fine.argmax()), len(near[1]))
        return float(self.shrink(near[0][row])), float(near[1][column])

    def best(self) -> tuple[float, float, float]:
        """beta, theta and the error where it is lowest: the best tried, then grids of 5 x 5 around it, ever finer."""
        bounds = (self.options.beta_bounds, self.options.theta_bounds)
        reach = [float(-np.log1p(-bounds[0][1])) / KNOTS[0], (bounds[1][1] - bounds[1][0]) / KNOTS[1]]
        for _ in range(POLISH):
            beta, theta, _ = self.tried[self.tried[:, 2].argmin()]
            b = self.shrink(-np.log1p(-beta) + np.linspace(-1.0, 1.0, 5) * reach[0])
            t = np.clip(theta + np.linspace(-1.0, 1.0, 5) * reach[1], *bounds[1])
            around = np.stack(np.meshgrid(np.unique(b), np.unique(t), indexing="ij"), axis=-1).reshape(-1, 2)
            self.simulate(around[:, 0], around[:, 1])
            reach = [0.4 * one for one in reach]
        beta, theta, error = self.tried[self.tried[:, 2].argmin()]
        return float(beta), float(theta), float(error)

    def _in_residuals(self, beta: float, theta: float, comparisons: Sequence[Comparison]) -> Iterator[Doubt]:
        """What simulations with other axes, and with two betas, show of the residuals of the best."""
        bounds = self.options.beta_bounds
        low, high = (float(-np.log1p(-end)) for end in bounds)
        tried = np.append(self.shrink(np.linspace(low, high, TURNED)), beta)
        # theta of the data as they are may be far from that of the data put right
        betas, thetas = np.tile(tried, 2), np.repeat([self.options.theta_bounds[0], theta], len(tried))

        def simulate(shapes: Sequence[FloatArray]) -> list[FloatArray]:
            each = zip(self.seen, self.bodies, shapes, strict=True)
            return [body.relax(shape[one.held], betas, thetas, volume="project").settled for one, body, shape in each]

        yield from swapped_axes(self.seen, simulate, bulging(self.seen, self.bodies, tried))
        grouped = [self.options.model.grouping(one) for one in self.seen]
        if any(one.count < 2 for one in grouped):
            return
        around = np.clip(theta + np.array([-1.0, 1.0]) * THETA_STEP, *self.options.theta_bounds)
        bodies = []
        for row, (part, group, compared) in enumerate(zip(self.parts, grouped, comparisons, strict=True)):
            held = self.seen[row].deformed[self.seen[row].held]
            by_theta = self.bodies[row].relax(held, beta, around, volume="project", start=compared.simulated).position
            slope = (by_theta[1] - by_theta[0])[part.judged] / np.ptp(around)

            def changed(stretched: FloatArray, row: int = row, held: FloatArray = held) -> FloatArray:
                start = comparisons[row].simulated
                found = self.bodies[row].relax(held, -np.expm1(-stretched), theta, volume="project", start=start)
                return found.settled

            response = self._response(part, beta, theta, compared.simulated)
            bodies.append(FittedBody(part, group, compared.simulated, response, slope[None], changed))
        yield from two_materials(bodies, beta, bounds[1])

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest -log(1 - beta)."""
        low, high = self.options.beta_bounds
        return float(-np.log1p(-low)), float(-np.log1p(-high))

    def shrink(self, stretched: FloatArray) -> FloatArray:
        """beta (n,) of values of -log(1 - beta), within its bounds."""
        return beta_of(stretched, self.options.beta_bounds)

    def _response(self, part: Residuals, beta: float, theta: float, base: FloatArray) -> FloatArray:
        """The effect of one observation's held positions at base (K, d): see `Residuals.response`."""

        def relax(held: FloatArray, start: FloatArray, tolerance: float) -> Relaxed:
            return part.body.relax(held, beta, theta, volume="project", start=start, tolerance=tolerance)

        return part.response((beta, theta), base, relax)

    @staticmethod
    def _ends(grid: FloatArray, alive: FloatArray) -> tuple[float, float]:
        """The ends of the grid (n,) that hold what is alive (n,), one step wider where the grid goes on."""
        inside = np.flatnonzero(alive)
        return float(grid[max(inside[0] - 1, 0)]), float(grid[min(inside[-1] + 1, len(grid) - 1)])

    @staticmethod
    def _flat(beta: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """beta and theta (b * t,) of every pair out of (b,) and (t,)."""
        b, t = np.meshgrid(beta, theta, indexing="ij")
        return b.ravel(), t.ravel()

    def _estimate(
        self,
        name: Parameter,
        value: float,
        least_aee: tuple[float, float],
        closest: Sequence[FloatArray],
        inferred: Inferred,
        comparisons: Sequence[Comparison],
        aee: float,
        k: tuple[float, tuple[float, float]] | None,
        doubts: Sequence[Doubt],
    ) -> Estimate:
        options = self.options
        bounds = options.beta_bounds if name == "beta" else options.theta_bounds
        first, column = self.tried[: KNOTS[0] * KNOTS[1]], 0 if name == "beta" else 1
        values = np.unique(first[:, column])
        # the least error over the other parameter, of the values first tried
        least = np.array([first[first[:, column] == one, 2].min() for one in values])
        return estimate_of(
            self.seen,
            comparisons,
            inferred,
            (name, value, inferred.posterior.shortest(options.level, value)),
            FitOptions(options.model, bounds, level=options.level),
            floor=max(part.measured.floor for part in self.parts),
            least_aee=least_aee,
            closest=closest,
            converged=self.converged,
            found=doubts,
            stiffness=k,
            contact_stiffness=contact_stiffness(self.seen, options.level),
            aee=aee,
            curve=Curve(values, least),
            settings={
                "cluster_size": options.model.cluster_size,
                "mode": options.model.basis,
                "volume": options.model.volume,
                "noise": inferred.noise,
                "seed": options.seed,
                **left_out_json(self.left_out),
            },
        )

    def _stiffness(
        self,
        beta: FloatArray,
        theta: FloatArray,
        density: FloatArray,
        best: tuple[float, float],
        explanations: Sequence[Explanation],
    ) -> tuple[float, tuple[float, float]] | None:
        """Stiffness k with its interval over draws of the joint posterior. beta: (b,); theta: (t,); density: (b, t)"""
        if all(one.force_n is None for one in self.seen):
            return None
        over = (density * np.gradient(beta)[:, None] * np.gradient(theta)).ravel()
        drawn = np.random.default_rng(self.options.seed).choice(over.size, DRAWN, p=over / over.sum())
        b, t = (np.append(each[drawn], last) for each, last in zip(self._flat(beta, theta), best, strict=True))
        share = np.append(np.full(DRAWN, 1.0 / DRAWN), 1e-3)
        states = self.simulate(b, t)
        return stiffness_interval(self.seen, self.options.model, states, b, t, share, explanations, self.options.level)
