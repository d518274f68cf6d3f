"""A body of cells fitted to one deformation: Gauss-Newton, the noise that is likeliest, and blocks left out.

Before the data, the logarithms of stiffness are either a Gaussian random field of standard deviation `SPREAD` (a factor
of 3), or one number for each of a few materials.

Neighbours share errors of measurement, as in optical flow, and held positions are measured too. Their covariance is
white noise or a random field, with the reach and smoothness of highest evidence, and a size that is found the same way.
Left-out data are judged with the errors that they share with the others."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial.distance import cdist
from scipy.special import expit, ndtri

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.held_out import blocks_of
from deformscope.stages.fit.model import Observation
from deformscope.stages.gaussian_process import correlation, gaussian_between
from deformscope.stages.materials.cell_model import CellModel, CellState, Law, lattice_cells

SPREAD = float(np.log(3.0))
"""Deviation of a place's log stiffness before the data."""

NOISE_ROUGH, NOISE_SMOOTH = 0.02, 0.002
"""Share of the variance of errors that reach far which does not, of rougher and of smoother ones."""

BORDER_SPREAD = 0.35
"""Deviation of the log stiffness of a cell at a border from its material's: the border may pass through it."""

SHIFT = 1.0
"""Deviation of a wide border's place from where a step was found [spacings]."""

SIZES = np.exp(np.linspace(np.log(1e-6), np.log(1.0), 401))
"""Deviations of an error that are tried, as shares of the deformation's largest displacement."""

STATED_SPREAD = 1.0
"""Log-normal deviation of the true noise about a stated one."""

Rival = Literal["none", "anisotropic", "smooth error"]
"""Explanations of the observation other than places."""

NU, NU_SPREAD = 0.3, 0.15
"""Poisson's ratio before the data. In the plane it is the part that the thickness leaves of it."""

BENT_SPREAD = 0.5
"""Deviation of the logarithms of an anisotropic material's stiffness before the data: two moduli differ by a factor of
two (one deviation)."""

ERROR_SPREADS = (0.1, 0.03)
"""Smooth errors of the observation, as shares of the largest displacement: linear in place (the camera's scale, a drift
of one side) and quadratic (a lens)."""

ODDS, ODDS_SPREAD = float(np.log(0.4)), 1.0
"""log((1 - beta) / beta) of the whole body before the data."""

ROUNDS, SETTLED = 30, 1e-3
"""Gauss-Newton's largest number of steps, and the change of chi2 below which it ends. The parameters are then within a
thirtieth of their standard deviation, also along directions that the data hardly determine."""

MOST_STEP = 1.5
"""Largest change of a log stiffness in one step."""

LEAST_MOTION = 1e-6
"""Smallest motion that counts as deformation, as a share of a spacing."""

MOST_CELLS = 2500
"""Cells that are fitted at most: time grows with their cube, and 2500 take minutes."""


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Errors of measurement. reach: distance over which neighbours share errors [spacings], 0 = independent errors;
    size: deviation of a coordinate [spacings]; smooth: their correlation is Gaussian, else Matern 3/2; own: share of
    the variance that no neighbour shares"""

    reach: float
    size: float
    smooth: bool = False
    own: float = NOISE_ROUGH

    def correlation(self, distance: FloatArray) -> FloatArray:
        """(n, n) of particles at distances (n, n) [spacings]."""
        white = np.eye(len(distance))
        if self.reach == 0.0:
            return white
        shared = correlation("gaussian" if self.smooth else "matern", distance / self.reach)
        return np.asarray((1.0 - self.own) * shared + self.own * white)


NOISES = (
    *(NoiseModel(reach, 1.0) for reach in (0.0, 0.6, 1.0, 1.4, 2.0, 3.0, 6.0)),
    *(NoiseModel(reach, 1.0, True, own) for own in (NOISE_ROUGH, NOISE_SMOOTH) for reach in (1.0, 1.4, 2.0, 2.8, 4.0)),
)
"""Kernels that are tried, of size 1: filtered images are smoother than a Matern field."""


@dataclass(frozen=True, slots=True)
class StiffnessPrior:
    """Prior of all parameters, those of the cells and the common ones (Poisson's ratio, or the whole body's level, and
    a rival's).

    mean: (C + 1 + m,); root: (C + 1 + m, q) root of the covariance"""

    mean: FloatArray
    root: FloatArray


class FieldFit:
    """One observation, to which cells of one law are fitted.

    Parameters (C + 1 + m,) are of each cell the logarithm of its modulus, and Poisson's ratio; or of each cell the odds
    of 1 - beta, and the part of these that all cells share. The m others are a rival's: of "anisotropic" the material's
    anisotropy (`cell_model.elasticity`), of "smooth error" the displacements that are errors (`smooth_modes`).

    cells: (C, 2^d); place: (C, d) [unit]; held: (n,) particles whose displacement is prescribed; displacement: (K, d)
    displacement without the rigid motion [spacings]; rows: (m,) indices of its numbers that are judged; target: (m,)"""

    def __init__(self, seen: Observation, law: Law, rival: Rival = "none") -> None:
        cells = _cells_of(seen)
        self.seen, self.law, self.cells, self.rival = seen, law, cells, rival
        self.spacing = float(np.median(np.linalg.norm(seen.rest[cells[:, 1]] - seen.rest[cells[:, 0]], axis=1)))
        self.place = seen.rest[cells].mean(axis=1)
        self.held = np.union1d(seen.held, _next_to_tool(seen, cells))
        # what presses the tool's particles reaches the others through those next to it, which are prescribed too
        self.whole_touched = np.union1d(seen.touched, np.setdiff1d(self.held, seen.held))
        self.model = CellModel(seen.rest, cells, self.held, law)
        self.displacement = without_rigid(seen) / self.spacing
        d = seen.rest.shape[1]
        judged = np.setdiff1d(np.flatnonzero(seen.free_observed), self.held)
        if not judged.size:
            raise InputError("particles that are free and were seen", "all held, or next to the tool", "a finer grid")
        self.rows = (judged[:, None] * d + np.arange(d)).ravel()
        self.target = self.displacement.ravel()[self.rows]
        self.size = max(float(np.abs(self.displacement[seen.observed]).max()), LEAST_MOTION)
        self._reach = cdist(seen.rest, seen.rest) / self.spacing
        self._modes, spread = smooth_modes(seen.rest)
        roots = {"anisotropic": BENT_SPREAD * bent_root(d), "smooth error": self.size * np.diag(spread)}
        self._rival_root: FloatArray = roots.get(rival, np.zeros((0, 0)))

    def prior(self, reach: float) -> StiffnessPrior:
        """A smooth field. reach: [spacings]"""
        covariance = SPREAD**2 * correlation("matern", cdist(self.place, self.place) / self.spacing / reach)
        root = np.linalg.cholesky(covariance + 1e-9 * np.eye(len(covariance)))
        return self._with_common(root)

    def levels(self, label: IntArray, border: IntArray | None = None) -> StiffnessPrior:
        """One number for each material. label: (C,) its index, from 0; border: cells that a border may pass through"""
        root = 2.0 * SPREAD * np.eye(int(label.max()) + 1)[label]
        if border is not None:
            root = np.hstack([root, BORDER_SPREAD * np.eye(len(label))[:, border]])
        return self._with_common(root)

    def wide_levels(self, label: IntArray, level: FloatArray, width: float) -> StiffnessPrior:
        """One number for each material, whose borders are normal distribution functions of deviation `width` [spacings]
        about `SHIFT` away from where steps were found. label: (C,) from the softest; level: (k,) their approximate log
        stiffness, in which a border's shift is linear"""
        near = gaussian_between(self.place, self.place, width * self.spacing)
        member = near @ np.eye(len(level))[label] / near.sum(axis=1, keepdims=True)
        stiffer = np.clip(member[:, ::-1].cumsum(axis=1)[:, -2::-1], 1e-9, 1.0 - 1e-9)
        slope = np.exp(-0.5 * ndtri(stiffer) ** 2) / (np.sqrt(2.0 * np.pi) * width)
        return self._with_common(np.hstack([2.0 * SPREAD * member, SHIFT * np.diff(level) * slope]))

    def _with_common(self, root: FloatArray) -> StiffnessPrior:
        """The prior of parameters (C + 1,): of cells with root (C, q), and of Poisson's ratio; of `beta`, a level that
        all share."""
        (count, own), more = root.shape, len(self._rival_root)
        full = np.zeros((count + 1 + more, own + 1 + more))
        full[:count, :own], full[count, own] = root, NU_SPREAD
        full[count + 1 :, own + 1 :] = self._rival_root
        mean = np.concatenate([np.zeros(count), [NU], np.zeros(more)])
        if self.law == "beta":
            full[:, own] = ODDS_SPREAD
            mean[:] = ODDS
        return StiffnessPrior(mean, full)

    def state(self, at: FloatArray) -> tuple[CellState, FloatArray, FloatArray]:
        """The displacements of parameters (p,), those that are judged (n,), smooth errors included, and their
        derivatives (n, p)."""
        count, held = len(self.cells), self.displacement
        # of the held particles too, which are where they were seen less their error
        fixed = np.zeros_like(self._modes) if self.seen.held_measured is False else self._modes
        if error := self.rival == "smooth error":
            held = held - (fixed @ at[count + 1 :]).reshape(held.shape)
        state = self.model.state(self.log_stiffness(at), held, self.nu(at), self.bent(at))
        moved = state.moved.ravel()[self.rows]
        slope = state.slope * (1.0 - expit(at[:count])) if self.law == "beta" else state.slope
        columns = [slope[self.rows], (self._bend(at) * state.by_nu)[self.rows, None], state.by_bent[self.rows]]
        if error:
            moved = moved + self._modes[self.rows] @ at[count + 1 :]
            columns.append(self._modes[self.rows] - state.response[self.rows] @ fixed[self.model.fixed])
        return state, moved, np.concatenate(columns, axis=1)

    def log_stiffness(self, at: FloatArray) -> FloatArray:
        """(C,) factor of the cells' energies: of a modulus 1, or 1 - beta."""
        p = at[: len(self.cells)]
        return np.asarray(-np.logaddexp(0.0, -p) if self.law == "beta" else p)

    def bent(self, at: FloatArray) -> FloatArray | None:
        """(m,) anisotropy of the material of parameters (p,); None without one."""
        return at[len(self.cells) + 1 :] if self.rival == "anisotropic" else None

    def nu(self, at: FloatArray) -> float:
        """Poisson's ratio of parameters (p,): the first after the cells', bent near its bounds (a clipped ratio has no
        derivative, and the fit does not converge)."""
        return self._half * (1.0 + float(np.tanh(at[len(self.cells)] / self._half - 1.0)))

    def nu_sd(self, at: FloatArray, sd: float) -> float:
        """Standard deviation of Poisson's ratio at parameters (p,), from the deviation of its parameter."""
        return self._bend(at) * sd

    @property
    def _half(self) -> float:
        return 0.45 if self.displacement.shape[1] == 2 else 0.245

    def _bend(self, at: FloatArray) -> float:
        """Slope of Poisson's ratio by its parameter, of (p,)."""
        return 1.0 - float(np.tanh(at[len(self.cells)] / self._half - 1.0)) ** 2

    def noise_root(self, noise: NoiseModel, response: FloatArray) -> FloatArray:
        """(n, n) Cholesky factor of the covariance of errors. response: (K d, n d) response to the held positions"""
        d = self.displacement.shape[1]
        one = noise.correlation(self._reach)
        if self.seen.held_measured is False:
            exact = np.zeros(len(one), dtype=bool)
            exact[self.seen.held] = True
            one = np.where(exact[:, None] | exact, 1e-9 * np.eye(len(one)), one)
        free = np.unique(self.rows // d)
        whole = np.kron(one[np.ix_(free, free)], np.eye(d))
        cross = np.kron(one[np.ix_(free, self.held)], np.eye(d))
        own = np.kron(one[np.ix_(self.held, self.held)], np.eye(d))
        by_held = response[self.rows]
        part = cross @ by_held.T
        total = whole - part - part.T + by_held @ own @ by_held.T
        return np.asarray(noise.size * np.linalg.cholesky(total + 1e-9 * np.eye(len(total))))

    def fit(self, prior: StiffnessPrior, noise: NoiseModel, start: FloatArray | None = None) -> "FieldPoint":
        """The likeliest parameters (p,) under a prior and a noise. start: (p,) parameters from which they are sought"""
        z: FloatArray = np.zeros(prior.root.shape[1])
        if start is not None:
            z = np.asarray(np.linalg.lstsq(prior.root, start - prior.mean, rcond=1e-6)[0])
        at = prior.mean + prior.root @ z
        state, moved, slope = self.state(at)
        root = self.noise_root(noise, state.response)
        best, step, converged = np.inf, np.zeros_like(z), False
        for _ in range(ROUNDS):
            left = solve_triangular(root, self.target - moved, lower=True)
            cost = float(left @ left + z @ z)
            if cost > best * (1.0 + 1e-9) and np.abs(step).max() > 1e-9:
                step = 0.5 * step  # went too far
                z = z - step
            else:
                best = cost
                whitened = solve_triangular(root, slope @ prior.root, lower=True)
                downhill = whitened.T @ left - z
                step = np.linalg.solve(whitened.T @ whitened + np.eye(len(z)), downhill)
                if float(step @ downhill) < SETTLED:
                    converged = True
                    break
                change = float(np.abs(prior.root @ step)[: len(self.cells)].max(initial=0.0))
                step *= min(1.0, MOST_STEP / max(change, 1e-12))
                z = z + step
            at = prior.mean + prior.root @ z
            state, moved, slope = self.state(at)
        return FieldPoint(at=at, state=state, moved=moved, slope=slope, converged=converged)


@dataclass(frozen=True, slots=True)
class FieldPoint:
    """A fit, and its linearization. at: (p,); moved: (n,); slope: (n, p)"""

    at: FloatArray
    state: CellState
    moved: FloatArray
    slope: FloatArray
    converged: bool

    def linear(self, target: FloatArray) -> FloatArray:
        """(n,) target of the derivatives times the parameters."""
        return np.asarray(target - self.moved + self.slope @ self.at)


def smooth_modes(rest: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(K d, m) displacements of points (K, d) that are linear and quadratic in place, one at the farthest, and (m,) how
    large each may be."""
    d = rest.shape[1]
    x = rest - 0.5 * (rest.max(axis=0) + rest.min(axis=0))
    x = x / np.abs(x).max()
    quadratic = [x[:, i] * x[:, j] for i in range(d) for j in range(i, d)]
    shapes = np.stack([*x.T, *quadratic], axis=1)
    spread = np.repeat(ERROR_SPREADS, [d, len(quadratic)])
    return np.kron(shapes, np.eye(d)), np.repeat(spread, d)


def bent_root(d: int) -> FloatArray:
    """(m, m) root of the covariance of an anisotropic law's numbers (`cell_model.elasticity`) without a preferred
    direction; their geometric mean is unchanged, which positions do not determine."""
    size = d * (d + 1) // 2
    row, column = np.triu_indices(size)
    root = np.diag(np.where(row == column, 1.0, np.sqrt(0.5)))
    own = row == column
    root[np.ix_(own, own)] -= 1.0 / size
    return root


def without_rigid(seen: Observation) -> FloatArray:
    """(K, d) displacements, less the rigid motion of the particles that were seen."""
    some = seen.observed
    rest, now = seen.rest - seen.rest[some].mean(axis=0), seen.deformed - seen.deformed[some].mean(axis=0)
    u, _, vt = np.linalg.svd(now[some].T @ rest[some])
    flip = np.ones(rest.shape[1])
    flip[-1] = np.sign(np.linalg.det(u @ vt))
    return np.asarray(np.nan_to_num(now @ ((u * flip) @ vt) - rest))


def in_whole_cells(seen: Observation) -> Observation:
    """The same without particles that are corners of no whole cell, at ragged borders and holes."""
    used = np.zeros(len(seen.rest), dtype=bool)
    used[_cells_of(seen)] = True
    if used.all():
        return seen
    new = np.cumsum(used) - 1

    def kept(some: IntArray | None) -> IntArray | None:
        return None if some is None else np.asarray(new[some[used[some]]])

    return replace(
        seen,
        rest=seen.rest[used],
        deformed=seen.deformed[used],
        held=new[seen.held[used[seen.held]]],
        observed=seen.observed[used],
        noise=None if seen.noise is None else seen.noise[used],
        cell=None if seen.cell is None else seen.cell[used],
        contact=kept(seen.contact),
        loose=kept(seen.loose),
    )


def _next_to_tool(seen: Observation, cells: IntArray) -> IntArray:
    """Indices (n,) of particles next to a tool that covers a part of a face, by cells (C, 2^d). Cells as coarse as
    particles cannot follow the displacement at its edge, which falls anywhere between two: the observation around it is
    prescribed instead."""
    touched = np.isin(np.arange(len(seen.rest)), seen.touched)
    for axis in seen.rest.T:
        near = 1e-3 * np.ptp(axis)
        for end in (axis.min(), axis.max()):
            if touched[np.abs(axis - end) <= near].all():
                return np.array([], dtype=np.int64)
    near_tool = cells[touched[cells].any(axis=1)]
    return np.asarray(np.unique(near_tool[seen.observed[near_tool]]))


def _cells_of(seen: Observation) -> IntArray:
    """(C, 2^d) particles at the corners of each cell. Raises InputError where particles are on no lattice."""
    if seen.shape is None or seen.cell is None:
        hint = "give `shape` (last axis fastest), and `cell` where the lattice has holes"
        raise InputError("particles on a lattice", "points without one", hint)
    if len(seen.shape) != seen.rest.shape[1]:
        came = f"a lattice {'x'.join(map(str, seen.shape))} in {seen.rest.shape[1]} dimensions"
        hint = "a surface alone: calibrate beta --thickness-m"
        raise InputError("a lattice that fills the plane, or space", came, hint)
    cells = lattice_cells(seen.shape, seen.cell)
    if not 4 <= len(cells) <= MOST_CELLS:
        raise InputError(f"a lattice of 4 to {MOST_CELLS} cells", str(len(cells)), "another --grid, or a cut of it")
    return cells


# What is chosen ------------------------------------------------------------------------------------------------------


def likeliest_noise(
    fit: FieldFit, prior: StiffnessPrior, point: FieldPoint, near: NoiseModel | None = None
) -> tuple[NoiseModel, float]:
    """Errors with the highest evidence for any field, and its logarithm: the density with which every number was
    predicted from those before it. near: noise whose reach, or the next reaches of its kind, are tried; None = any"""
    noises = NOISES
    if near is not None:
        kind = [one.reach for one in NOISES if (one.smooth, one.own) == (near.smooth, near.own)]
        at = kind.index(near.reach)
        low, high = kind[max(at - 1, 0)], kind[min(at + 1, len(kind) - 1)]
        noises = tuple(one for one in NOISES if low <= one.reach <= high)
    wanted = point.linear(fit.target) - point.slope @ prior.mean
    stated = None if fit.seen.noise is None else float(np.median(fit.seen.noise)) / fit.spacing
    sizes = SIZES * fit.size
    best, found = -np.inf, NoiseModel(0.0, sizes[-1])
    for noise in noises:
        root = fit.noise_root(noise, point.state.response)
        u, s, _ = np.linalg.svd(solve_triangular(root, point.slope @ prior.root, lower=True), full_matrices=False)
        y = solve_triangular(root, wanted, lower=True)
        along = u.T @ y
        across = max(float(y @ y - along @ along), 0.0)
        variance = s[None] ** 2 + sizes[:, None] ** 2
        value = -0.5 * (np.log(variance).sum(axis=1) + (along**2 / variance).sum(axis=1))
        value -= 0.5 * ((len(y) - len(s)) * np.log(sizes**2) + across / sizes**2) + np.log(np.diag(root)).sum()
        if stated:
            value -= 0.5 * (np.log(sizes / stated) / STATED_SPREAD) ** 2
        at = int(value.argmax())
        if value[at] > best:
            best, found = float(value[at]), replace(noise, size=float(sizes[at]))
    return found, best


@dataclass(frozen=True, slots=True)
class LeftOutError:
    """Squared errors of blocks left out, of one way to describe the field. block: (b,) mean of each; total: total of
    all"""

    block: FloatArray
    total: float


class Folds:
    """Rows that are left out in turn, and factors of the noise in which the trained rows come first: left-out data are
    then judged with the errors that they share with the trained ones."""

    def __init__(self, fit: FieldFit, noise: NoiseModel, response: FloatArray) -> None:
        d = fit.displacement.shape[1]
        block, fold = blocks_of(fit.seen.rest, fit.spacing, 0.0)
        particle = fit.rows // d
        self.block, fold_of = block[particle], fold[particle]
        root = fit.noise_root(noise, response)
        covariance = root @ root.T
        self.parts = []
        for one in np.unique(fold_of):
            order = np.argsort(fold_of == one, kind="stable")
            factor = np.linalg.cholesky(covariance[np.ix_(order, order)])
            self.parts.append((order, int((fold_of != one).sum()), factor))

    def whitened(self, part: int, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows (n, ...) in units of the noise: those trained, and those left out."""
        order, count, root = self.parts[part]
        found = solve_triangular(root, rows[order], lower=True)
        return found[:count], found[count:]

    def judge(
        self, point: FieldPoint, target: FloatArray, find: Callable[[FloatArray, FloatArray], FloatArray]
    ) -> LeftOutError:
        """Distance of left-out data from their prediction by the others. find: gives parameters (p,) for targets (n,)
        and derivatives (n, p), whitened"""
        wanted = point.linear(target)
        square = np.empty(len(wanted))
        for part, (order, count, _) in enumerate(self.parts):
            (w, w_out), (y, y_out) = self.whitened(part, point.slope), self.whitened(part, wanted)
            square[order[count:]] = (y_out - w_out @ find(y, w)) ** 2
        each = np.asarray(np.bincount(self.block, weights=square), dtype=np.float64)
        return LeftOutError(each, float(each.sum()))


def smooth_mean(prior: StiffnessPrior, y: FloatArray, w: FloatArray) -> FloatArray:
    """(p,) posterior mean of the parameters, from their prior and whitened rows: y (n,) targets, w (n, p)
    derivatives."""
    own = w @ prior.root
    z = np.linalg.solve(own.T @ own + np.eye(own.shape[1]), own.T @ (y - w @ prior.mean))
    return np.asarray(prior.mean + prior.root @ z)


def posterior(fit: FieldFit, prior: StiffnessPrior, noise: NoiseModel, point: FieldPoint) -> FloatArray:
    """(p, q) root of the parameters' covariance after the data."""
    root = fit.noise_root(noise, point.state.response)
    w = solve_triangular(root, point.slope @ prior.root, lower=True)
    inner = np.linalg.cholesky(w.T @ w + np.eye(w.shape[1]))
    return np.asarray(solve_triangular(inner, prior.root.T, lower=True).T)
