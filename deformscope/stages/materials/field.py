"""A stiffness for each place from one deformation: smooth or of a few materials, whichever predicts left-out particles
better.

The ratio of stiffness between the places of a body determines a given motion; only a force determines the absolute
stiffness. The ratio is that of bilinear finite elements on the particles' lattice (`cell_model`), with Poisson's ratio
fitted too. beta's energy has none, so that its ratios of 1 - beta are too small on foams that have one. A beta for each
cell is fitted too, in the same places.

How far a smooth field hangs together is chosen by blocks of particles left out. Evidence decides whether a few
materials with borders describe it better: the density with which every number was predicted from those before it, less
the cost of a border of that length. It also decides whether places differ. The alternatives are one material, one that
is stiffer along a direction, and one that was observed with a smooth error. An interval includes every description that
the data do not rule out, so that a place without information retains its prior."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial import cKDTree
from scipy.special import expit, logsumexp, ndtri

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.doubts import little_explained, not_converged, ordered
from deformscope.stages.fit.estimate import Comparison, Doubt, limited
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.fit.search import Progress
from deformscope.stages.materials import field_estimate, field_fit, field_levels
from deformscope.stages.materials.cell_model import directional_modulus, elasticity

REACHES = (1.5, 3.0, 6.0, 12.0, 24.0)
"""How far the smooth field may hang together [spacings]: the strength of the prior."""

FIRST_REACH, FIRST_NOISE, SMOOTH_ROUNDS = 6.0, 0.05, 3
"""Where the search begins (noise as a share of the largest displacement), and its rounds."""

MATERIALS = (1, 2, 3, 4)
"""How many materials are tried."""

BORDER_ROUNDS = 6
"""Rounds of fitting levels and moving borders."""

WIDTHS = (1.0, 2.0)
"""How wide borders may be besides steps [spacings], as in `FieldFit.wide_levels`: 10 to 90 % of the change within 2.6
and 5.1 spacings."""

BORDER_COST, WIDE_COST = 0.4, 0.2
"""Cost of a border for each pair of cells that it separates, in natural logarithms of a probability; a wide border has
less detail."""

PLAUSIBLE = 0.05
"""Least probability of a description that intervals include."""

SHOWN, DIRECTIONS_SHOWN = 1e-4, 1e-3
"""Probability of one material below which places differ, and of a plain one among these below which directions do. With
noise smoother than the model's, one material had 6e-4, and a plain one 7e-3, where neither differs."""

CELLS_ERROR = 0.03
"""Standard deviation of the log ratio of two materials due to the cells, as they are as coarse as the particles: of
bodies without noise 0.96 to 1.02 of the true ratio was found."""

EXPLAINABLE = 1e-12
"""Share of the largest displacement, squared, that there is at least to be explained."""

SPLITS = (0.25, 0.5, 0.75)
"""Places at which a body that looks uniform is split, as shares of its extent along each axis."""

DRAWS = 40
"""Draws of the field, for the scale that a force gives."""

DETERMINED_LEAST = 0.5
"""Share of the places that must be determined for another verdict on the whole than unidentified."""

DIRECTIONS = 360
"""Directions of an anisotropic material that are tried."""

STRAIN_MOST = 0.15
"""Change of a cell's sides, as a share, beyond which small deformations are no description (95 % of all sides)."""


@dataclass(frozen=True, slots=True)
class Description:
    """One way to describe the field. fit: the fit that `point` belongs to; label: (C,) materials, -1 where it is
    smooth; root: root of the covariance after the data (p, q); weight: logarithm of its probability, without the common
    part; misfit: chi2 for each number; width: width of borders, as in `WIDTHS`, 0 = steps"""

    name: str
    fit: field_fit.FieldFit
    label: IntArray
    prior: field_fit.StiffnessPrior
    point: field_fit.FieldPoint
    root: FloatArray
    noise: field_fit.NoiseModel
    weight: float
    judged: field_fit.LeftOutError
    misfit: float
    width: float = 0.0

    def relative(self, edges: IntArray, sds: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(C,) log stiffness over its mean, and the ends of its interval; a cell at a border may be of either side."""
        at, root = self._cells
        mean = at.mean()
        root = root - root.mean(axis=0)
        variance = (root**2).sum(axis=1) * max(1.0, self.misfit)
        if self.label[0] < 0 or self.width:
            p, reach = at - mean, sds * np.sqrt(variance)
            return p, p - reach, p + reach
        p = (self._pure(edges) @ at)[self.label] - mean
        # each cell at a border may be of either side, which moves the mean of all
        variance = variance + len(field_levels.border_cells(self.label, edges)) * (0.5 * np.ptp(p) / len(p)) ** 2
        low, high = p - sds * np.sqrt(variance), p + sds * np.sqrt(variance)
        one, other = np.concatenate([edges, edges[:, ::-1]]).T
        ends = low.copy(), high.copy()
        np.minimum.at(low, one, ends[0][other])
        np.maximum.at(high, one, ends[1][other])
        return p, low, high

    def contrast(self, edges: IntArray, sds: float) -> tuple[float, tuple[float, float]]:
        """Stiffest over softest, and its interval of `sds` standard deviations. edges: (n, 2) neighbouring clusters"""
        p, root = self._cells
        if self.label[0] >= 0:
            pure = self._pure(edges)
            p, root = pure @ p, pure @ root
            low, high = int(p.argmin()), len(p) - 1 - int(p[::-1].argmax())  # where all are alike: two of them
        else:
            low, high = (int(np.abs(p - end).argmin()) for end in np.quantile(p, [0.02, 0.98]))
        apart = float(p[high] - p[low])
        sd = float(np.hypot(np.linalg.norm(root[high] - root[low]) * max(1.0, self.misfit) ** 0.5, CELLS_ERROR))
        low_end, high_end = (float(np.exp(apart + sign * sds * sd)) for sign in (-1.0, 1.0))
        return float(np.exp(apart)), (max(low_end, 1.0), high_end)

    @property
    def _cells(self) -> tuple[FloatArray, FloatArray]:
        """Log stiffness (C,) and the root of its covariance (C, q)."""
        count = len(self.label)
        return self.point.at[:count], self.root[:count]

    def _pure(self, edges: IntArray) -> FloatArray:
        """(k, C) means over each material's cells that no border passes through, or over all where there are none; of
        wide borders, its cell that they reach least."""
        if self.width:
            deepest = self.prior.root[: len(self.label), : self.label.max() + 1].argmax(axis=0)
            return np.asarray(np.eye(len(self.label))[deepest])
        member = (self.label == np.arange(self.label.max() + 1)[:, None]).astype(np.float64)
        inner = member.copy()
        inner[:, field_levels.border_cells(self.label, edges)] = 0.0
        chosen = np.where(inner.any(axis=1, keepdims=True), inner, member)
        return np.asarray(chosen / chosen.sum(axis=1, keepdims=True))


def fit_field(
    seen: Observation, *, level: float = 0.9, seed: int = 0, device: str = "cpu", progress: Progress | None = None
) -> tuple[field_estimate.FieldEstimate, Comparison]:
    """A stiffness for each place of the observation, and the betas of the engine."""
    seen = field_fit.in_whole_cells(seen)
    fit = field_fit.FieldFit(seen, "elastic")
    sds = float(ndtri(0.5 + 0.5 * level))
    steps = len(MATERIALS) + 3

    def done(number: int) -> None:
        if progress is not None:
            progress("descriptions of the field", number, steps)

    edges = field_levels.neighbours(fit.place, fit.spacing)
    reach, found, others = _descriptions(fit, edges, done)
    weight = np.array([one.weight for one in found])
    probability = np.exp(weight - logsumexp(weight))
    plausible = probability >= PLAUSIBLE
    chosen, one_material = _chosen(found, probability)
    value, _, _ = chosen.relative(edges, sds)
    included = [one for one, likely in zip(found, plausible, strict=True) if likely or one is chosen]
    included += [one for one in others if one.weight > logsumexp(weight) + np.log(PLAUSIBLE)]
    differ = any(one.label.max() != 0 for one in included)
    if chosen.label.max() == 0:
        included += _hidden(chosen)
    ends = [one.relative(edges, sds)[1:] for one in included]
    interval = np.stack([np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)], axis=1)
    done(steps - 1)
    beta, beta_ends, beta_state, beta_aee = _betas(seen, chosen, reach, sds, device)
    motion = float(np.sum(fit.target**2))
    left = float(np.sum((fit.target - chosen.point.state.moved.ravel()[fit.rows]) ** 2))
    explained = 1.0 - left / motion if motion > fit.size**2 * EXPLAINABLE else 0.0
    reasons = [*not_converged(chosen.point.converged), *_doubts(fit, chosen, differ)]
    reasons += little_explained(explained, left_is_noise=chosen.misfit < 2.0, seen=[seen])
    verdicts = tuple(limited(one, reasons) for one in field_estimate.place_verdicts(np.exp(interval)))
    kind: field_estimate.FieldKind = (
        "gradual" if chosen.label[0] < 0 else "materials" if chosen.label.max() > 0 else "uniform"
    )
    directions = None
    if chosen.fit.rival == "anisotropic":
        kind, directions = "anisotropic", _directions(chosen)
    determined = np.mean([one != "unidentified" for one in verdicts]) >= DETERMINED_LEAST
    contrasts = [one.contrast(edges, sds)[1] for one in included]
    if kind in ("uniform", "anisotropic") and max(high for _, high in contrasts) > field_estimate.WEAK_FACTOR:
        determined = np.False_
    doubted = one_material < PLAUSIBLE and differ and kind in ("uniform", "anisotropic")
    if not determined or doubted or any(one.allows == "unidentified" for one in reasons):
        kind = "unidentified"
    absolute, absolute_ends = _absolute(chosen, value, interval, np.random.default_rng(seed), sds)
    likeliest = max(included, key=lambda one: one.weight)  # its borders may be wide
    ratio, _ = (likeliest if chosen.label.max() else chosen).contrast(edges, sds)
    ratio_ends = min(low for low, _ in contrasts), max(high for _, high in contrasts)
    d = seen.rest.shape[1]
    off = np.linalg.norm((chosen.point.state.moved - fit.displacement)[seen.observed], axis=1)
    stiffest = 1.0 - beta
    estimate = field_estimate.FieldEstimate(
        place=fit.place,
        spacing=fit.spacing,
        stiffness=np.exp(value),
        interval=np.exp(interval),
        level=level,
        verdicts=verdicts,
        material=chosen.label,
        ratio=ratio,
        ratio_interval=ratio_ends,
        beta=beta,
        beta_interval=beta_ends,
        beta_ratio=float(stiffest.max() / stiffest.min()),
        absolute=absolute,
        absolute_interval=absolute_ends,
        verdict=kind,
        reasons=ordered(reasons),
        directions=directions,
        poisson=fit.nu(chosen.point.at),
        poisson_sd=fit.nu_sd(chosen.point.at, float(np.linalg.norm(chosen.root[len(fit.cells)]))),
        reach=reach,
        tried=tuple(one.name for one in found),
        held_out=np.array([one.judged.total for one in found]) / len(fit.target),
        probability=probability,
        plausible=tuple(plausible.tolist()),
        noise=chosen.noise.size * fit.spacing,
        noise_reach=chosen.noise.reach,
        aee=float(off.mean()) * fit.spacing,
        beta_aee=beta_aee,
        explained=explained,
        converged=chosen.point.converged,
        unit=seen.unit,
        metres_per_unit=seen.metres_per_unit,
        settings={"particles": len(seen.rest), "cells": len(fit.cells), "dimensions": d, "device": device},
    )
    done(steps)
    return estimate, Comparison(seen.rest, seen.deformed, beta_state, seen.observed, seen.held, unit=seen.unit)


def _descriptions(
    fit: field_fit.FieldFit, edges: IntArray, done: Callable[[int], None]
) -> tuple[float, list[Description], list[Description]]:
    """Correlation length of a smooth field [spacings]; all descriptions: smooth, one material, more, and last an
    anisotropic one and one with a smooth error; and others of as many materials, with other borders or wide ones."""
    reach, noise, point = _smooth(fit)
    done(1)
    found = [_described(fit, "smooth", fit.prior(reach), noise, point)]
    others: list[Description] = []
    for count in MATERIALS:
        some = _materials(fit, found, edges, count)
        found += some[:1]
        others += some[1:]
        done(1 + count)
        if not some or (count > 2 and some[0].weight < found[-2].weight):
            break
    if max(one.weight for one in found[1:]) > found[1].weight:
        others += [wide for one in found[2:4] for wide in _wide(fit, one, edges)]
    return reach, [*found, _rival(found[1], "anisotropic"), _rival(found[1], "smooth error")], others


def _chosen(found: list[Description], probability: FloatArray) -> tuple[Description, float]:
    """The reported description, and the probability of one material, plain, anisotropic or with a smooth error. That
    places differ has to be shown, and so has that directions do: evidence is as good as the model of the noise."""
    plain, bent, error = probability[[1, -2, -1]].tolist()
    same = plain + bent + error
    if same < SHOWN:
        return found[int(probability.argmax())], same
    return found[1 if plain >= DIRECTIONS_SHOWN * same else -1 if error >= PLAUSIBLE * same else -2], same


def _smooth(fit: field_fit.FieldFit) -> tuple[float, field_fit.NoiseModel, field_fit.FieldPoint]:
    """How far the field hangs together, by blocks left out; the noise, and the likeliest field."""
    best, found = -np.inf, None
    reach, noise, point = FIRST_REACH, field_fit.NoiseModel(1.0, FIRST_NOISE * fit.size), None
    for _ in range(SMOOTH_ROUNDS):
        prior = fit.prior(reach)
        point = fit.fit(prior, noise, None if point is None else point.at)
        noise, evidence = field_fit.likeliest_noise(fit, prior, point)
        if evidence > best:
            best, found = evidence, (reach, noise, point)
        folds = field_fit.Folds(fit, noise, point.state.response)
        left_out = [
            folds.judge(point, fit.target, partial(field_fit.smooth_mean, fit.prior(one))).total for one in REACHES
        ]
        reach = REACHES[int(np.argmin(left_out))]
    assert found is not None
    return found


def _described(
    fit: field_fit.FieldFit,
    name: str,
    prior: field_fit.StiffnessPrior,
    noise: field_fit.NoiseModel,
    point: field_fit.FieldPoint,
    label: IntArray | None = None,
    cost: float = 0.0,
    width: float = 0.0,
) -> Description:
    """With the noise that is likeliest under it. label: (C,) materials; cost, width: of their borders"""
    noise, _ = field_fit.likeliest_noise(fit, prior, point, near=noise)
    point = fit.fit(prior, noise, point.at)
    _, evidence = field_fit.likeliest_noise(fit, prior, point, near=noise)
    judged = field_fit.Folds(fit, noise, point.state.response).judge(
        point, fit.target, partial(field_fit.smooth_mean, prior)
    )
    root = fit.noise_root(noise, point.state.response)
    left = solve_triangular(root, fit.target - point.moved, lower=True)
    label = np.full(len(fit.cells), -1) if label is None else label
    after, misfit = field_fit.posterior(fit, prior, noise, point), float(left @ left) / len(left)
    return Description(name, fit, label, prior, point, after, noise, evidence - cost, judged, misfit, width)


def _materials(fit: field_fit.FieldFit, found: list[Description], edges: IntArray, count: int) -> list[Description]:
    """Descriptions by this number of materials, with borders that were found from several starts, the most probable
    first; none if there are fewer. found: the smooth field, and fewer materials; edges: (n, 2) neighbouring cells"""
    smooth, noise = found[0], max(found, key=lambda one: one.weight).noise
    p, weight = smooth.point.at[:-1], 1.0 / np.maximum((smooth.root[:-1] ** 2).sum(axis=1), 1e-12)
    begun = [field_levels.levels_of(p, weight, count)]
    if count > 1:
        # the best straight cut through one of the materials across each axis
        root = fit.noise_root(noise, found[-1].point.state.response)
        both = found[-1].point.linear(fit.target), found[-1].point.slope
        y, w = (solve_triangular(root, rows, lower=True) for rows in both)
        gain = partial(field_levels.gain, gram=w.T @ w, wanted=w.T @ y)
        cuts = field_levels.cuts(found[-1].label, fit.place, fit.spacing)
        begun += field_levels.split(found[-1].label, p, weight)
        begun += [max(some, key=lambda label: gain(fit.levels(label))) for some in cuts if some]
    described: list[Description] = []
    for one in begun:
        described += _found_from(fit, noise, one, edges, count, described)
    if described and count > 1:  # borders that the noise's first guess has misplaced
        best = max(described, key=lambda one: one.weight)
        described += _found_from(fit, best.noise, best.label, edges, count, described)
    return sorted(described, key=lambda one: -one.weight)


def _wide(fit: field_fit.FieldFit, one: Description, edges: IntArray) -> list[Description]:
    """The same materials with wide borders: a step leaves open how far they reach."""
    level, found = one._pure(edges) @ one.point.at[: len(one.label)], []
    cost = WIDE_COST * field_levels.border_length(one.label, edges)
    for width in WIDTHS:
        prior = fit.wide_levels(one.label, level, width)
        point = fit.fit(prior, one.noise, one.point.at)
        found.append(_described(fit, one.name, prior, one.noise, point, one.label, cost, width))
    return found


def _found_from(
    fit: field_fit.FieldFit,
    noise: field_fit.NoiseModel,
    label: IntArray,
    edges: IntArray,
    count: int,
    before: list[Description],
) -> list[Description]:
    """Result of moving borders (C,), if it has this number of materials and was not found before."""
    least = fit.cells.shape[1]  # what is smaller is no more than a border that passes through cells
    moved, point = _bordered(fit, noise, label, edges)
    if moved.max() + 1 != count or np.bincount(moved).min() < least:
        return []
    level = np.array([point.at[:-1][moved == k].mean() for k in range(count)])
    label = np.asarray(level.argsort().argsort()[moved])  # numbered from the softest
    if any(np.array_equal(label, one.label) for one in before):
        return []
    prior = fit.levels(label, field_levels.border_cells(label, edges))
    name = "one material" if count == 1 else f"{count} materials"
    cost = BORDER_COST * field_levels.border_length(label, edges)
    return [_described(fit, name, prior, noise, fit.fit(prior, noise, point.at), label, cost)]


def _bordered(
    fit: field_fit.FieldFit, noise: field_fit.NoiseModel, label: IntArray, edges: IntArray
) -> tuple[IntArray, field_fit.FieldPoint]:
    """Labels (C,) and the fit, of the borders of least chi2 and length found while moving them."""
    tried: list[tuple[float, IntArray, field_fit.FieldPoint]] = []
    point = None
    for _ in range(BORDER_ROUNDS):
        point = fit.fit(fit.levels(label), noise, None if point is None else point.at)
        root = fit.noise_root(noise, point.state.response)
        left = solve_triangular(root, fit.target - point.moved, lower=True)
        cost = field_levels.BORDER * field_levels.border_length(label, edges)
        tried.append((float(left @ left) + cost, label, point))
        y, w = (solve_triangular(root, rows, lower=True) for rows in (point.linear(fit.target), point.slope))
        moved = field_levels.sharpened(label, fit.levels, edges, y, w)
        if any(np.array_equal(moved, before) for _, before, _ in tried):
            break
        label = moved
    return min(tried, key=lambda one: one[0])[1:]


def _rival(uniform: Description, rival: field_fit.Rival) -> Description:
    """One material in all places that a rival distinguishes from the plain one."""
    fit = field_fit.FieldFit(uniform.fit.seen, "elastic", rival)
    prior = fit.levels(uniform.label)
    point = fit.fit(prior, uniform.noise)
    noise, _ = field_fit.likeliest_noise(fit, prior, point)
    return _described(fit, f"one material, {rival}", prior, noise, fit.fit(prior, noise, point.at), uniform.label)


def _directions(one: Description) -> field_estimate.DirectionalStiffness:
    """Along which direction an anisotropic material is stiffest, and over the softest how much. Directions are spread
    evenly over a half circle, or a half sphere (golden spiral)."""
    fit, d, at, turn = one.fit, one.fit.place.shape[1], one.point.at, np.arange(DIRECTIONS)
    if d == 2:
        angle = np.pi * turn / DIRECTIONS
        along = np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        up, angle = (turn + 0.5) / DIRECTIONS, np.pi * (3.0 - np.sqrt(5.0)) * turn
        flat = np.sqrt(1.0 - up**2)
        along = np.column_stack([flat * np.cos(angle), flat * np.sin(angle), up])
    found = directional_modulus(elasticity(d, fit.nu(at), fit.bent(at)), along)
    low, high = int(found.argmin()), int(found.argmax())
    return field_estimate.DirectionalStiffness(along[high], along[low], ratio=float(found[high] / found[low]))


def _hidden(one: Description) -> list[Description]:
    """A body that looks uniform, as two materials whose border is across an axis: the contrast that the data cannot
    exclude. Layers that strain alike show none."""
    fit, noise, found = one.fit, one.noise, []
    for number, along in enumerate(fit.place.T):
        for share in SPLITS:
            label = (along > np.quantile(along, share)).astype(np.int64)
            if label.any():
                prior = fit.levels(label)
                root = field_fit.posterior(fit, prior, noise, one.point)
                found.append(replace(one, name=f"split {number} {share}", label=label, prior=prior, root=root))
    return found


def _betas(
    seen: Observation, chosen: Description, reach: float, sds: float, device: str
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """(C,) beta of each cell in the found places, (C, 2) its interval, and the engine's positions with them: (K, d) and
    their mean distance from the observation [unit]."""
    fit = field_fit.FieldFit(seen, "beta")
    prior = fit.prior(reach) if chosen.label[0] < 0 else fit.levels(chosen.label)
    noise = field_fit.NoiseModel(1.0, FIRST_NOISE * fit.size)
    point = fit.fit(prior, noise)
    for _ in range(2):
        noise, _ = field_fit.likeliest_noise(fit, prior, point)
        point = fit.fit(prior, noise, point.at)
    sd = np.sqrt((field_fit.posterior(fit, prior, noise, point)[:-1] ** 2).sum(axis=1))
    odds = point.at[:-1]
    beta, ends = expit(-odds), np.stack([expit(-odds - sds * sd), expit(-odds + sds * sd)], axis=1)
    model = Model(cluster_size=2, device=device)
    middle = np.array([seen.rest[row].mean(axis=0) for row in model.grouping(seen)])
    of_cluster = beta[cKDTree(fit.place).query(middle)[1]]
    state = model.body(seen).relax(seen.deformed[seen.held], of_cluster[None]).position[0]
    left = np.linalg.norm((state - seen.deformed)[seen.observed], axis=1)
    return beta, ends, state, float(left.mean())


def _absolute(
    chosen: Description, value: FloatArray, interval: FloatArray, rng: np.random.Generator, sds: float
) -> tuple[FloatArray | None, FloatArray | None]:
    """(C,) stiffness of each cell [N per unit], modulus times spacing (in the plane, times thickness), and its
    interval, by the net force on the touched particles."""
    fit, seen, count = chosen.fit, chosen.fit.seen, len(value)
    if seen.force_n is None or not len(seen.touched) or fit.size <= field_fit.LEAST_MOTION:
        return None, None
    q = chosen.root.shape[1]
    every = []
    for draw in np.concatenate([np.zeros((1, q)), rng.standard_normal((DRAWS, q))]):
        at = chosen.point.at + chosen.root @ draw
        p = at[:count] - at[:count].mean()
        force = fit.model.state(p, fit.displacement, fit.nu(at), fit.bent(at), slopes=False).force
        every.append(float(np.log(np.linalg.norm(force[fit.whole_touched].sum(axis=0)))))
    scale = float(np.log(seen.force_n / fit.spacing) - every[0])
    doubt = np.hypot(np.std(every[1:]), 0.0 if seen.force_noise_n is None else seen.force_noise_n / seen.force_n)
    reach = np.hypot(interval - value[:, None], sds * doubt) * np.array([-1.0, 1.0])
    return np.exp(value + scale), np.exp(value[:, None] + reach + scale)


def _doubts(fit: field_fit.FieldFit, chosen: Description, differ: bool) -> Iterator[Doubt]:
    """Large strain, a setting that hides places, and an error that resembles them. differ: places that differ explain
    the observation, too"""
    sides = [fit.cells[:, [one, other]] for one, other in pairwise(range(fit.cells.shape[1]))]
    seen: BoolArray = fit.seen.observed
    changes = [np.diff(fit.displacement[some], axis=1)[:, 0] for some in sides if seen[some].any()]
    large = float(np.quantile(np.linalg.norm(np.concatenate(changes), axis=1), 0.95))
    if large > STRAIN_MOST:
        text = f"sides of cells change by {large:.0%}: the field is that of small deformations; deform it less"
        yield Doubt("large-strain", text, "weak")
    if len(fit.held) != len(fit.seen.held):
        text = (
            "a tool presses a part of a face: cells blur the strain around it, and neighbours below it strain "
            "alike; hold and move whole faces (stretch or shear it)"
        )
        yield Doubt("setting", text, "unidentified")
    if chosen.fit.rival == "smooth error":
        text = (
            "one material explains it if the observation has a smooth error (a scale or a drift that differs "
            "between the two states, a lens); make sure that camera and body are at rest, or measure it with "
            "nothing moved"
        )
        yield Doubt("smooth-error", text, "unidentified" if differ else "weak")
