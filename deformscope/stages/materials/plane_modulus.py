"""Young's modulus and Poisson's ratio of a body in a picture, by the force on its contact.

The body is the union of its particles' cells, each meshed by elements of nine nodes: the particles are nodes in their
middles, so that the mesh reaches half a spacing beyond the outermost ones. The held particles' measured positions are
prescribed, and nodes between neighbouring held ones are interpolated: a lone node would have no reaction in the limit.
The law is a compressible neo-Hookean one (Bonet and Wood 2008, 6.28), P = mu (F - F^-T) + lambda ln J F^-T, in plane
stress or plane strain. The reaction is proportional to the modulus E, so that one solution for each Poisson's ratio
gives E = F / (thickness R). The ratio follows from the free particles, and is marginalised where they do not show
it.

The force at a video's frames is found by a log whose clock, zero and lag are its own. At the right time the log is a
smooth function of the depth that starts at zero: a cubic polynomial, as a display with a time constant shows it. The
likeliest offset and time constant are the estimate; their probability has the errors' own correlation in time, the
readings' scatter and step, and `LIKELY`: a lag and a later offset explain a rise alike."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import splu
from scipy.spatial.distance import cdist

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.doubts import known_of, little_explained
from deformscope.stages.fit.estimate import Doubt, Plane, Posterior, WithInterval
from deformscope.stages.fit.force import FLOW_WINDOW_PX, lattice_step, pushed_along
from deformscope.stages.fit.model import Observation, explained_share, unexplained
from deformscope.stages.materials.press_cycle import PressForce

RATIOS = np.array([0.0, 0.08, 0.16, 0.24, 0.32, 0.4, 0.45, 0.49])
"""Poisson's ratios that are simulated; quantities between them are interpolated."""
DRAWS = 4000
FEWEST = 4.0
"""Independent errors that even a smooth field of them has, in particles."""
RATIO_SD = 0.015
"""Standard deviation of a Poisson's ratio that no residual shows, by perspective and the mesh: its error in 16 drawn
pictures of tools and plates, 3 degrees off (`studies.seeds.TUNING`, 1000 to 1023)."""
BESIDE = 2
"""Particles on each side of the contact whose measured positions are prescribed too: part of the force is theirs."""
ROUNDS, LEFT = 40, 1e-9
"""Newton's steps, and residual as a share of the largest reaction at which they end."""
MANY_CELLS = 900
"""Bodies of more cells are not meshed a second time with half the element size."""
SOFT_PA = 300.0, 2e7
"""Range of the modulus of soft things: of the softest gels and foams, and of hard rubber [Pa]."""
FLAT, DEEP = 0.05, 3.0
"""Least and largest thickness of a body, as a share of its size in the picture, that is likely."""
SHARED, RISEN = 0.8, 0.5
"""Share of the depth whose rise must lie in what both have seen, and which the fit must explain; the same of the force,
which a slow display may not have shown in full at the last frame."""
DEGREE = 3
LAGS_S = np.append(0.0, np.geomspace(0.1, 1.5, 16))
"""Time constants of a display: 0, and those of kitchen scales; less than these looks like a delay."""
LIKELY = np.append(1.0, 0.3 * (_falling := np.exp(-LAGS_S[1:] / 0.3)) / _falling.sum())
"""Probability of each, up to a factor: three of four displays show at once, and long lags are rare."""
UNSHOWN = 1.2
"""Largest force at the last frame, as a share of what the log shows at any time."""
TRIED, FINE = 6000, 1201
"""Most offsets that are tried at first, and near the best of them."""
NEAR_S = 2.5
"""How far around the first best offset others are tried: a lag looks like a delay at first."""
HINT = "--force-offset-s with the log's time at the first frame, or a log of the whole push"


@dataclass(frozen=True, slots=True)
class ForceOffset:
    """The log's time at the first frame [s], and its interval; lag_s: time constant of its display

    force_n: (T,) force at each frame, less the log's zero and lag [N]; force_sd_n: standard deviation of the last, by
    offset and lag"""

    value: float
    interval: tuple[float, float]
    lag_s: float
    force_n: FloatArray
    force_sd_n: float


def find_offset(
    time_s: FloatArray, depth: FloatArray, log: PressForce, level: float, given: float | None = None
) -> ForceOffset:
    """The force of a log. time_s, depth: (T,) time after the first frame, and depth of the push in any unit; given: the
    offset, if it is known. Raises InputError where it is not determined: both share no rise, or no edge of one."""
    log = _SmoothForce(log.time_s, log.force_n, log.zero_sd_n)
    steps = [float(np.median(np.diff(one))) for one in (time_s, log.time_s)]
    step = min(steps)
    if given is None:
        begin, end = float(log.time_s[0]) - float(time_s[-1]), float(log.time_s[-1])
        offsets = np.linspace(begin, end, min(TRIED, int((end - begin) / step) + 2))
        errors, _ = _errors(offsets, time_s, _lagged(time_s, depth, 0.0), log)
        if not np.isfinite(errors).any() or not np.ptp(log.force_n):
            came = f"one of {np.ptp(log.force_n):.2g} N over {np.ptp(log.time_s):.3g} s that does not overlap with it"
            raise InputError("a force log that has the push of the video", came, HINT)
        offsets = offsets[int(np.nanargmin(errors))] + np.linspace(-NEAR_S, 0.2 * NEAR_S, FINE)
    else:
        offsets = np.array([given])
    columns = [_lagged(time_s, depth, float(lag)) for lag in LAGS_S]
    least = 1.0 if given is None else 0.0
    both = np.stack([_errors(offsets, time_s, one, log, least) for one in columns])
    errors, forces = both[:, 0], both[:, 1]  # (lags, offsets)
    errors[forces > UNSHOWN * np.ptp(log.force_n)] = np.nan
    if not np.isfinite(errors).any():
        return ForceOffset(float(offsets[0]), (float(offsets[0]),) * 2, 0.0, log.at(time_s + offsets[0]), 0.0)
    lag, at = np.unravel_index(int(np.nanargmin(errors)), errors.shape)
    _, left, _ = _at(float(offsets[at]), time_s, columns[lag], log)
    worth = 0.5 * len(left) * (1.0 - _correlation(left)) / (1.0 + _correlation(left))
    reading = log.zero_sd_n**2 + np.diff(np.unique(log.force_n)).min(initial=np.inf) ** 2 / 12.0
    noise = reading + (2e-4 * float(np.ptp(log.force_n))) ** 2
    chance = np.log(LIKELY)[:, None] - worth * np.log(np.where(np.isfinite(errors), errors + noise, np.inf))
    chance = np.exp(chance - chance.max())
    lag, at = np.unravel_index(int(chance.argmax()), chance.shape)
    order = np.argsort(forces[chance > 1e-4])
    weights, ends = chance[chance > 1e-4][order], forces[chance > 1e-4][order]
    ends = np.interp([0.16, 0.84], np.cumsum(weights) / weights.sum(), ends)
    spread, best = 0.5 * float(ends[1] - ends[0]), float(offsets[at])
    measured, _, force_n = _at(best, time_s, columns[lag], log)
    if given is not None:
        return ForceOffset(given, (given, given), float(LAGS_S[lag]), force_n, spread)
    density = chance.sum(axis=0)
    low, high = Posterior(offsets, density / np.trapezoid(density, offsets)).shortest(level, best)
    rising = time_s[(depth > 0.1 * depth.max()) & (depth < 0.9 * depth.max())]
    share = 1.0 - float(errors[lag, at]) / max(float(np.var(measured)), 1e-300)
    if share < SHARED or high - low > max(float(np.ptp(rising)) if len(rising) else 0.0, 2.0 * step):
        came = f"not determined: {low:.3g} to {high:.3g} s, of which {max(share, 0.0):.0%} of the force is explained"
        raise InputError("a force log whose rise is that of the motion", came, HINT)
    half = 0.25 * max(steps)  # what happens between readings, or frames, is not known
    return ForceOffset(best, (low - half, high + half), float(LAGS_S[lag]), force_n, spread)


@dataclass(frozen=True)
class _SmoothForce(PressForce):
    """A log between whose readings lies a smooth curve: straight lines would cut the corners of a slow scale."""

    @cached_property
    def _curve(self) -> PchipInterpolator:
        return PchipInterpolator(self.time_s, self.force_n)

    def at(self, time_s: FloatArray) -> FloatArray:
        return np.asarray(self._curve(np.clip(time_s, self.time_s[0], self.time_s[-1])))

    def has(self, time_s: FloatArray) -> BoolArray:
        """Which times (n,) lie within the log."""
        return np.asarray((time_s >= self.time_s[0]) & (time_s <= self.time_s[-1]))


def _lagged(time_s: FloatArray, depth: FloatArray, lag_s: float) -> FloatArray:
    """(T, 2 DEGREE + 1) powers of the depth from 1 on as a display with a time constant shows them, 1, and the powers
    themselves."""
    share = depth / max(float(np.abs(depth).max()), 1e-300)
    powers = np.stack([share**power for power in range(1, DEGREE + 1)], axis=1)
    shown = powers.copy()
    for row in range(1, len(shown)) if lag_s else ():
        gap = time_s[row] - time_s[row - 1]
        behind = (powers[row] - powers[row - 1]) * lag_s / gap
        shown[row] = powers[row] - behind + (shown[row - 1] - powers[row - 1] + behind) * np.exp(-gap / lag_s)
    return np.column_stack([shown, np.ones(len(share)), powers])


def _at(
    offset: float, time_s: FloatArray, columns: FloatArray, log: _SmoothForce
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n,) the log at the frames that it has, and errors of the best polynomial there; and (T,) the log at each frame,
    less its zero, and with what its display has not shown yet."""
    inside = log.has(time_s + offset)
    shown, powers = columns[:, : DEGREE + 1], columns[:, DEGREE + 1 :]
    measured = log.at(time_s[inside] + offset)
    found = np.linalg.lstsq(shown[inside], measured, rcond=None)[0]
    force = log.at(time_s + offset) - found[-1] + (powers - shown[:, :DEGREE]) @ found[:-1]
    return measured, measured - shown[inside] @ found, np.asarray(force)


def _errors(
    offsets: FloatArray, time_s: FloatArray, columns: FloatArray, log: PressForce, least: float = 1.0
) -> FloatArray:
    """(2, n) mean squared error at each offset [N^2], NaN where log and video do not share the rise, and the force at
    the last frame of `_at` [N]. least: 0 = they may share any part"""
    first = np.searchsorted(time_s, log.time_s[0] - offsets - 1e-9)
    last = np.searchsorted(time_s, log.time_s[-1] - offsets + 1e-9, side="right")
    errors, forces = np.full((2, len(offsets)), np.nan)
    unshown = np.append((columns[-1, DEGREE + 1 :] - columns[-1, :DEGREE]), -1.0)
    for begin, end in np.unique(np.stack([first, last], axis=1), axis=0):
        rows = np.flatnonzero((first == begin) & (last == end))
        some, depth = columns[begin:end, : DEGREE + 1], columns[begin:end, DEGREE + 1]
        if end - begin <= DEGREE + 3 or not np.ptp(depth) >= least * SHARED * np.ptp(columns[:, DEGREE + 1]):
            continue
        measured = log.at(time_s[begin:end] + offsets[rows, None])
        found = measured @ np.linalg.pinv(some).T
        left = measured - found @ some.T
        forces[rows] = log.at(time_s[-1] + offsets[rows]) + found @ unshown
        enough = np.ptp(measured, axis=1) >= least * RISEN * np.ptp(log.force_n)
        errors[rows] = np.where(enough, np.mean(left**2, axis=1), np.nan)
    return np.stack([errors, forces])


def _correlation(left: FloatArray) -> float:
    """Correlation of neighbouring errors, 0 to 0.95."""
    size = float(left @ left)
    return float(np.clip(left[1:] @ left[:-1] / size, 0.0, 0.95)) if size else 0.0


@dataclass(frozen=True, slots=True)
class PlaneModulus:
    """modulus: Young's modulus [Pa]; poisson: Poisson's ratio, each with its interval; explained: share of the motion
    that elasticity explains; reasons: reasons to doubt the modulus"""

    modulus: WithInterval
    poisson: WithInterval
    explained: float
    reasons: tuple[Doubt, ...]


def plane_modulus(
    seen: Observation, thickness_m: float, thickness_sd: float, plane: Plane, level: float, seed: int
) -> PlaneModulus:
    """The modulus by one observation with a lattice, a force and a scale.

    thickness_m: thickness of the body at rest, along the view; thickness_sd: its standard deviation, as a share. The
    interval has the noise of the prescribed positions, of force, scale and thickness, Poisson's ratio, the element
    size, and what elasticity does not explain. Raises InputError where nothing but the contact is held, and for a
    motion that turns the material inside out."""
    assert seen.force_n is not None
    assert seen.metres_per_unit is not None
    push = pushed_along(seen)
    if push is None or not len(np.setdiff1d(seen.held, seen.touched)):
        raise InputError("a still part among --held, for a modulus", "the contact alone", "--held bottom,contact")
    body = _Body(seen, plane, push[0])
    judged = seen.free_observed & body.meshed & ~body.measured
    each, start = [], None
    for ratio in RATIOS:
        start = body.solve(float(ratio), start)
        each.append((start, body.reaction(start, float(ratio))))
    left = np.stack([(body.particles(u) - seen.deformed)[judged] for u, _ in each])
    reaction = np.array([one for _, one in each])
    if not (reaction > 0.0).all():
        raise InputError(
            "a contact that is pushed into the body", "one that is pulled", "the frames in order, or --held"
        )
    posterior = _ratio_posterior(seen, judged, left)
    best = float(posterior.parameter[posterior.density.argmax()])
    near = int(np.abs(RATIOS - best).argmin())
    state, log_reaction = body.solve(best, each[near][0]), np.log(reaction)
    at_best = float(np.log(body.reaction(state, best)))
    finer = 0.0
    if len(seen.rest) <= MANY_CELLS:
        fine = _Body(seen, plane, push[0], fine=2)
        finer = float(np.log(fine.reaction(fine.solve(best), best))) - at_best
    noise = body.reaction_noise(state, best) / float(np.exp(at_best))
    beyond = unexplained(seen.rest, seen.deformed, body.particles(state), judged, known_of(seen))
    share = max(explained_share([beyond], float(np.ptp(seen.rest, axis=0).max())), 0.0)
    shares = seen.force_sd_n / seen.force_n, seen.scale_sd, thickness_sd, noise, finer, 1.0 - share
    variance = np.sum(np.square(shares))
    rng = np.random.default_rng(seed)
    nu = posterior.quantile(rng.random(DRAWS))
    scale = thickness_m * seen.metres_per_unit
    log_modulus = np.log(seen.force_n / scale) - finer - CubicSpline(RATIOS, log_reaction)(nu)
    drawn = np.exp(log_modulus + np.sqrt(variance) * rng.standard_normal(DRAWS))
    low, value, high = (float(one) for one in np.quantile(drawn, [0.5 - 0.5 * level, 0.5, 0.5 + 0.5 * level]))
    reasons = (*little_explained(share, left_is_noise=False, seen=[seen]), *_implausible(seen, value, thickness_m))
    return PlaneModulus((value, (low, high)), (best, posterior.shortest(level, best)), share, reasons)


def _implausible(seen: Observation, modulus_pa: float, thickness_m: float) -> Iterator[Doubt]:
    low, high = SOFT_PA
    if not low <= modulus_pa <= high:
        text = f"a modulus of {modulus_pa:.2g} Pa is not that of a soft thing: grams for newtons, or a wrong scale?"
        yield Doubt("units", text, "weak")
    size_m = float(np.ptp(seen.rest, axis=0).max()) * float(seen.metres_per_unit or 1.0)
    if not FLAT <= thickness_m / size_m <= DEEP:
        text = f"the body is {size_m:.2g} m large in the picture and {thickness_m:.2g} m thick: is the scale right?"
        yield Doubt("units", text, "weak")


def _ratio_posterior(seen: Observation, judged: BoolArray, left: FloatArray) -> Posterior:
    """Of Poisson's ratio, even before the data. left: (n, k, 2) errors of the judged particles at `RATIOS`; smooth ones
    (flow's within its window, a picture's perspective) are shared, so that only so many particles count"""
    count = int(judged.sum())
    step = lattice_step(seen)
    noise = 0.0 if seen.noise is None else float(np.mean(seen.noise[judged] ** 2))
    grid = np.linspace(RATIOS[0], RATIOS[-1], 491)
    errors = CubicSpline(RATIOS, left)(grid)
    squares = np.sum(errors**2, axis=(1, 2))
    apart = _independent(seen.rest[judged], errors[squares.argmin()], step)
    apart = min(apart, float(np.prod(np.minimum(step / FLOW_WINDOW_PX, 1.0)))) if seen.unit == "px" else apart
    variance = max(noise, float(squares.min()) / (2 * count), 1e-12 * float(step @ step))
    log_density = -0.5 * apart * squares / variance
    density = ndimage.gaussian_filter1d(np.exp(log_density - log_density.max()), RATIO_SD / (grid[1] - grid[0]))
    return Posterior(grid, density / np.trapezoid(density, grid))


def _independent(at: FloatArray, errors: FloatArray, step: FloatArray) -> float:
    """Share of errors (k, 2) at places (k, 2) that count as independent, by the correlation of neighbours: that of an
    exponential decay, whose integral over the plane is 2 pi times its length squared."""
    apart = cdist(at / step, at / step)
    first, second = np.nonzero(np.triu(apart < 1.1, 1))
    power = float(np.mean(np.sum(errors**2, axis=1)))
    if not len(first) or power <= 0.0:
        return 1.0
    alike = float(np.mean(np.sum(errors[first] * errors[second], axis=1))) / power
    share = float(np.log(1.0 / np.clip(alike, 1e-6, 0.999))) ** 2 / (2.0 * np.pi)
    return min(max(share, FEWEST / len(at)), 1.0)


class _Body:
    """The mesh. fine: elements along a side of a cell; meshed, measured: (K,) particles whose cell it has, and those
    whose measured position is prescribed"""

    def __init__(self, seen: Observation, plane: Plane, toward: FloatArray, *, fine: int = 1) -> None:
        assert seen.shape is not None
        assert seen.cell is not None
        self._seen, self._plane, self._toward = seen, plane, toward
        rows, columns = np.divmod(seen.cell, seen.shape[1])
        particle = np.full(seen.shape, -1)
        particle[rows, columns] = np.arange(len(rows))
        pieces, _ = ndimage.label(particle >= 0)
        piece = pieces[rows, columns]
        self.meshed: BoolArray = np.isin(piece, piece[seen.held])
        particle[rows[~self.meshed], columns[~self.meshed]] = -1
        self._particle = particle
        step, side = lattice_step(seen), 2 * fine
        origin = np.median(seen.rest - step * np.column_stack([columns, rows]), axis=0) - 0.5 * step
        height, width = side * seen.shape[0] + 1, side * seen.shape[1] + 1
        corners = [
            ((side * row + 2 * i) * width + side * column + 2 * j)
            for row, column in np.argwhere(particle >= 0)
            for i in range(fine)
            for j in range(fine)
        ]
        nine = (np.arange(3)[:, None] * width + np.arange(3)).ravel()
        used, flat = np.unique(np.add.outer(corners, nine), return_inverse=True)
        self._elements: IntArray = flat.reshape(-1, 9)
        at = np.column_stack([used % width, used // width])
        self._rest: FloatArray = origin + at * step / side
        places = np.full(height * width, -1)
        places[used] = np.arange(len(used))
        middle = np.where(self.meshed, (side * rows + fine) * width + side * columns + fine, used[0])
        self._middle: IntArray = places[middle]
        self._slopes, self._weights = _nine_nodes(step / fine)
        line = _contact_line(seen, rows, columns, toward) & self.meshed
        self.measured: BoolArray = np.isin(np.arange(len(rows)), seen.held) & self.meshed | line
        fixed, weights, touching = [], [], []
        for node, place in enumerate(at / side - 0.5):
            if found := self._between(place[::-1]):
                fixed.append(node)
                weights += [(len(fixed) - 1, one, weight) for one, weight in found.items()]
                touching.append(all(line[one] for one in found))
        self.fixed: IntArray = np.array(fixed)
        self._touching: BoolArray = np.array(touching)
        row, column, weight = zip(*weights, strict=True)
        self._of_held = csr_matrix((weight, (row, column)), shape=(len(fixed), len(rows)))
        self._free: IntArray = np.setdiff1d(np.arange(2 * len(used)), (2 * self.fixed[:, None] + np.arange(2)).ravel())

    def _between(self, place: FloatArray) -> dict[int, float]:
        """Weights of the measured particles that prescribe a place (row, column) of the lattice; none where it is free.
        A line of them goes on to the body's edge."""
        ways: list[list[tuple[dict[int, float], int | None]]] = []
        for value in place:
            low = int(np.floor(value))
            share = float(value - low)
            some: list[tuple[dict[int, float], int | None]] = [({low: 1.0 - share, low + 1: share}, None)]
            some = some if share else [({low: 1.0}, None)]
            some += [({low: 1.0 + share, low - 1: -share}, low + 1)] if 0.0 < share <= 0.5 else []
            some += [({low + 1: 2.0 - share, low + 2: share - 1.0}, low)] if share >= 0.5 else []
            ways.append(some)
        for by_row, past_row in ways[0]:
            for by_column, past_column in ways[1]:
                found = {self._at(row, column): a * b for row, a in by_row.items() for column, b in by_column.items()}
                if -1 in found or not all(self.measured[one] for one in found):
                    continue
                is_edge = all(self._at(past_row, one) < 0 for one in by_column) if past_row is not None else True
                if past_column is not None:
                    is_edge &= all(self._at(one, past_column) < 0 for one in by_row)
                if is_edge:
                    return found
        return {}

    def _at(self, row: int, column: int) -> int:
        inside = 0 <= row < self._particle.shape[0] and 0 <= column < self._particle.shape[1]
        return int(self._particle[row, column]) if inside else -1

    def particles(self, moved: FloatArray) -> FloatArray:
        """(K, 2) positions of the particles, of displacements (n, 2)."""
        return np.asarray(self._seen.rest + moved[self._middle])

    def solve(self, ratio: float, start: FloatArray | None = None) -> FloatArray:
        """(n, 2) displacements of the nodes at rest. start: those of a similar ratio"""
        seen = self._seen
        wanted = self._of_held @ (seen.deformed - seen.rest)
        steps = 1
        while steps <= 16:
            moved = np.zeros_like(self._rest) if start is None or steps > 1 else start.copy()
            for share in np.arange(1, steps + 1) / steps:
                ahead = np.zeros_like(moved)
                ahead[self.fixed] = share * wanted - moved[self.fixed]
                if not self._relax(moved, ahead, ratio):
                    break
            else:
                return moved
            steps *= 4
        raise InputError("a motion of elastic material", "one that turns it inside out", "--held and --roi on the body")

    def _relax(self, moved: FloatArray, ahead: FloatArray, ratio: float) -> bool:
        """Newton's method, in place; whether it converged. ahead: (n, 2) what prescribed nodes still have to move"""
        stiff = ahead.ravel()
        for _ in range(ROUNDS):
            force, tangent = self._forces(moved, ratio)
            if not np.isfinite(force).all():
                return False
            if not stiff.any() and np.abs(force[self._free]).max() <= LEFT * max(np.abs(force).max(), 1e-300):
                return True
            step = stiff.copy()
            rows = tangent[self._free]
            step[self._free] = -splu(rows[:, self._free].tocsc()).solve(force[self._free] + rows @ stiff)
            if not np.isfinite(step).all():
                return False
            size = 1.0
            # no element folds
            while size > 1e-3 and np.linalg.det(self._gradient(moved + size * step.reshape(-1, 2))).min() <= 0.05:
                size *= 0.5
            moved += size * step.reshape(-1, 2)
            stiff = (1.0 - size) * stiff
        return False

    def _gradient(self, moved: FloatArray) -> FloatArray:
        """(elements, points, 2, 2) deformation gradient."""
        return np.asarray(np.eye(2) + np.einsum("eai,qaj->eqij", moved[self._elements], self._slopes, optimize=True))

    def _forces(self, moved: FloatArray, ratio: float) -> tuple[FloatArray, csr_matrix]:
        """Forces (2 n,) of the nodes on the material for a modulus of 1 and a thickness of 1, and their slopes."""
        gradient = self._gradient(moved)
        turned = np.swapaxes(np.linalg.inv(gradient), 2, 3)
        lame, shear = ratio / ((1.0 + ratio) * (1.0 - 2.0 * ratio)), 0.5 / (1.0 + ratio)  # of a modulus of 1
        a, b = _law(np.linalg.det(gradient), lame, shear, self._plane)
        stress = shear * gradient - a[..., None, None] * turned
        force = np.zeros_like(self._rest)
        each = np.einsum("eqij,qaj,q->eai", stress, self._slopes, self._weights, optimize=True)
        np.add.at(force, self._elements, each)
        eye = np.eye(2)
        slope = shear * np.einsum("ik,jl->ijkl", eye, eye) + np.zeros((*a.shape, 2, 2, 2, 2))
        slope += a[..., None, None, None, None] * np.einsum("eqil,eqkj->eqijkl", turned, turned)
        slope += b[..., None, None, None, None] * np.einsum("eqij,eqkl->eqijkl", turned, turned)
        how = "eqijkl,qaj,qbl,q->eaibk"
        block = np.einsum(how, slope, self._slopes, self._slopes, self._weights, optimize=True).reshape(-1, 18, 18)
        dofs = (2 * self._elements[:, :, None] + np.arange(2)).reshape(-1, 18)
        rows, columns = np.repeat(dofs, 18, axis=1).ravel(), np.tile(dofs, (1, 18)).ravel()
        return force.ravel(), coo_matrix((block.ravel(), (rows, columns)), shape=(force.size, force.size)).tocsr()

    def reaction(self, moved: FloatArray, ratio: float) -> float:
        """Force of the contact along its push, for a modulus of 1 and a thickness of 1 [unit of lengths]."""
        force = self._forces(moved, ratio)[0].reshape(-1, 2)
        return float(force[self.fixed[self._touching]].sum(axis=0) @ self._toward)

    def reaction_noise(self, moved: FloatArray, ratio: float) -> float:
        """Standard deviation of `reaction` by the noise of the held positions, which neighbours share."""
        seen = self._seen
        if seen.noise is None:
            return 0.0
        _, tangent = self._forces(moved, ratio)
        pull = np.zeros_like(moved)
        pull[self.fixed[self._touching]] = self._toward
        by_all = tangent.T @ pull.ravel()
        free = self._free
        back = np.zeros(len(by_all))
        back[free] = splu(tangent[free][:, free].T.tocsc()).solve(by_all[free])
        by_fixed = (by_all - tangent.T @ back).reshape(-1, 2)[self.fixed]
        by_held = (self._of_held.T @ by_fixed)[self.measured] * seen.noise[self.measured, None]
        shared = np.exp(-cdist(seen.rest[self.measured], seen.rest[self.measured]) / FLOW_WINDOW_PX)
        return float(np.sqrt(max(np.einsum("ni,nm,mi->", by_held, shared, by_held), 0.0)))


def _contact_line(seen: Observation, rows: IntArray, columns: IntArray, toward: FloatArray) -> BoolArray:
    """(K,) the contact's particles, and those in line with its innermost ones: the whole force passes through them, of
    whatever width the tool is. rows, columns: (K,) of the lattice"""
    axis = int(np.abs(toward).argmax())
    across, along = (rows, columns) if axis else (columns, rows)
    touched = seen.touched
    deep = across[touched] * np.sign(toward[axis])
    innermost = touched[deep == deep.max()]
    first, last = along[innermost].min() - BESIDE, along[innermost].max() + BESIDE
    line = (across == across[innermost[0]]) & (along >= first) & (along <= last) & seen.free_observed
    line[touched] = True
    return np.asarray(line)


def _law(volume: FloatArray, lame: float, shear: float, plane: Plane) -> tuple[FloatArray, FloatArray]:
    """a, b of P = shear F - a F^-T and dP = shear dF + a F^-T dF^T F^-T + b (F^-T : dF) F^-T. volume: ratio of areas.
    In plane stress the stretch s along the view has no stress: shear (s^2 - 1) + lame ln(volume s) = 0"""
    volume = np.maximum(volume, 1e-6)
    if plane == "strain":
        return shear - lame * np.log(volume), np.full_like(volume, lame)
    s = np.ones_like(volume)
    for _ in range(30):
        slope = 2.0 * shear * s + lame / s
        s = np.maximum(s - (shear * (s**2 - 1.0) + lame * np.log(volume * s)) / slope, 0.2 * s)
    return shear * s**2, 2.0 * shear * s * lame / (2.0 * shear * s + lame / s)


def _nine_nodes(step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slopes (9, 9, 2) of the functions of nine nodes at nine points of integration, and their weights (9,). step:
    sides along x and y; nodes row by row, y down the rows"""
    at, weight = np.polynomial.legendre.leggauss(3)
    value = np.stack([at * (at - 1.0) / 2.0, 1.0 - at**2, at * (at + 1.0) / 2.0], axis=1)
    slope = np.stack([at - 0.5, -2.0 * at, at + 0.5], axis=1)
    along_x = np.einsum("pi,qj->pqij", value, slope).reshape(9, 9) * 2.0 / step[0]
    along_y = np.einsum("pi,qj->pqij", slope, value).reshape(9, 9) * 2.0 / step[1]
    return np.stack([along_x, along_y], axis=2), np.outer(weight, weight).ravel() * float(np.prod(step)) / 4.0
