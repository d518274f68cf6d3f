"""Reasons to doubt a fit, found from its numbers: the same for beta, theta, axes and yielding.

Which of them lower a verdict, and why:

- `not-converged`, less than 30 % of the motion explained (`nothing-moved` where all of it is noise, or `rigid-motion`),
  rest and deformed of two sizes, columns swapped or mirrored, two materials: the value describes nothing in the data,
  so the parameter is unidentified.
- Less than 75 % explained (half of the motion, root mean square, is left) with more than noise left, a least AEE
  outside of a narrow interval, residuals ten times as large as the stated noise, theta with a misfit of half the noise.
  Such values depend on the error measure or on the body's load, so that the verdict is at most weak.
- The interval accounts for other contradictions of a stated noise, because it is computed from the residuals: they are
only named.
- A body of an unlikely size has the same beta and theta in any unit: it is named, and its stiffness is at most weak."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.fit.estimate import (
    EXPLAINED_LEAST,
    EXPLAINED_LOW,
    IDENTIFIED_WIDTH,
    Doubt,
    DoubtCode,
    Identifiability,
    NoiseSource,
    Verdict,
)
from deformscope.stages.fit.model import Model, Observation, rigid_positions
from deformscope.stages.fit.plausible import LARGE_M, size_of
from deformscope.stages.msm.solver import Msm

SMALL_M = 1e-3
"""Smallest plausible size of a body that a camera follows [m]."""

NOISE_NAMED, NOISE_LOWERS = 3.0, 10.0
"""Residuals larger or smaller than the stated noise by this factor contradict it, and lower a verdict: a factor of e is
one standard deviation of its prior (`noise.SCALE_SPREAD`)."""

LIKE_NOISE = 1.5
"""Ratio of residuals to the stated noise up to which they are noise, with errors of prescribed positions."""

STAYS, BACKGROUND = 3.0, 0.3
"""A particle that moved at most this many times its noise stayed. From this share on they may lie on a background."""

TREMBLES, MOST = 0.03, 0.95
"""Motion in images, as a share of the particles' spacing, that may be an error of the flow where the model explains
nothing of it; share of the free particles that stay where nothing moved."""

RIGID = 0.0025
"""Largest share of a motion (squares) that a shift and a turn of the whole body leave, if it is a rigid motion."""

RESCALED = 2.0
"""A deformed shape that is larger or smaller than the rest shape by this factor has another unit."""

MIRRORED = 0.25
"""Largest share of a motion beyond a rigid one (squares) that a mirrored rest shape leaves if the shape is mirrored."""

SWAPPED, SWAPPED_SHARE = 0.5, 0.75
"""With corrected columns, the squared residuals are at most this share of those without, and the remaining share of the
motion beyond a rigid one at most that share: data that fit neither way have another error. Chosen on tuning
seeds (`studies.seeds`): the squares of 750 bodies with right columns were no less than 0.6, of 150 with swapped columns
95 % were 0.45 at most."""

BULGES = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
"""Values of theta at which a body may bulge instead."""

SLIDES, SLIDES_SURE = 0.01, 4.0
"""Least sliding of held particles over what holds them, as a share of the push, and in deviations of its noise."""

NEGLIGIBLE, MISFIT_LEAST = 1e-3, 0.5
"""Share of a push below which a misfit does not change theta, and share of the noise from which it does."""

TAIL = 0.005
"""Mass of a posterior beyond a value, below which the value contradicts it."""


def found_in_numbers(
    name: str,
    ends: tuple[float, float],
    identifiability: Identifiability,
    *,
    converged: bool,
    noise: tuple[float | None, float | None, NoiseSource] = (None, None, "residuals"),
    least_aee: tuple[float, float] | None = None,
    seen: Sequence[Observation] = (),
) -> list[Doubt]:
    """The doubts that the numbers of a fit show.

    noise: residuals in units of the known noise, if any; their own noise [unit], if it is known apart from misfit;
    source of the known noise; least_aee: as in `aee_outside`; seen: as in `little_explained`"""
    ratio, shown, source = noise
    left_is_noise = shown is not None and identifiability.misfit < shown if ratio is None else ratio < LIKE_NOISE
    return [
        *not_converged(converged),
        *little_explained(identifiability.explained, left_is_noise=left_is_noise, seen=seen),
        *aee_outside(name, ends, least_aee),
        *noise_contradicted(ratio, source),
    ]


CAUSES: tuple[DoubtCode, ...] = ("nothing-moved", "rigid-motion", "axes-swapped", "units", "two-materials")
"""Causes, rather than consequences."""


def ordered(reasons: Iterable[Doubt]) -> tuple[Doubt, ...]:
    """Doubts in order: first those that lower a verdict the most, and causes before consequences."""
    rank: dict[Verdict | None, int] = {"unidentified": 0, "weak": 1, None: 2}
    return tuple(sorted(reasons, key=lambda one: (rank[one.allows], one.code not in CAUSES)))


OF_STIFFNESS: tuple[DoubtCode, ...] = (
    *("nothing-moved", "rigid-motion", "axes-swapped", "two-materials", "not-converged", "little-explained"),
)
"""Doubts that concern the stiffness too: the model computes it from the same positions."""


def of_stiffness(reasons: Iterable[Doubt]) -> list[Doubt]:
    """The reasons that concern the stiffness too, which is in N/m: doubts about units always lower its verdict."""
    some = [one for one in reasons if one.code in OF_STIFFNESS]
    return some + [Doubt(one.code, one.text, one.allows or "weak") for one in reasons if one.code == "units"]


def not_converged(converged: bool) -> Iterator[Doubt]:
    if not converged:
        yield Doubt("not-converged", "a simulation did not settle", "unidentified")


def little_explained(share: float, *, left_is_noise: bool = False, seen: Sequence[Observation] = ()) -> Iterator[Doubt]:
    """share: share of the motion beyond a rigid one that is explained (sums of squares); left_is_noise: the unexplained
    motion is no larger than noise, which the interval includes; seen: the fitted observations, to report whether a
    particle moved, or all moved as one rigid body"""
    words = f"the model explains {max(share, 0.0):.0%} of the motion"
    if share < EXPLAINED_LEAST and (rigid := _rigid(seen)):
        yield Doubt("rigid-motion", rigid, "unidentified")
    elif seen and (still := _still(seen, share)):
        yield Doubt("nothing-moved", still, "unidentified")
    elif share < EXPLAINED_LEAST:
        text = f"{words}; misfit or noise are as large as the motion itself{_background(seen)}"
        yield Doubt("little-explained", text, "unidentified")
    elif share < EXPLAINED_LOW and not left_is_noise:
        left = f"{np.sqrt(1.0 - share):.0%} of its root mean square is left"
        yield Doubt("little-explained", f"{words} only ({left}){_background(seen)}", "weak")


def _rigid(seen: Sequence[Observation]) -> str:
    """In words, that all motion is that of a rigid body; empty where it is not, or where there is none."""
    left = whole = 0.0
    for one in seen:
        known, moved = known_of(one), one.deformed - one.rest
        left += float(np.sum((rigid_positions(one.rest, one.deformed, known) - one.deformed)[known] ** 2))
        whole += float(np.sum(moved[known] ** 2)) if np.abs(moved[known]).max() > 1e-6 * size_of(one.rest) else 0.0
    if not seen or left > RIGID * whole or whole == 0.0:
        return ""
    return (
        f"a rigid motion: a shift and turn of the whole body are {1.0 - left / whole:.1%} of it, and nothing deformed"
    )


def _background(seen: Sequence[Observation]) -> str:
    """A hint where many particles of images stay where they are; empty = few do, or these are no images."""
    each = []
    for one in seen:
        if one.unit != "px" or one.noise is None:
            return ""
        moved = np.abs(one.deformed - one.rest).max(axis=1)
        each.append((moved <= STAYS * one.noise)[one.observed])
    share = float(np.mean(np.concatenate(each))) if each else 0.0
    found = f"; {share:.0%} of the particles do not move: --roi or --mask leaves out a background"
    return found if share >= BACKGROUND else ""


def _still(seen: Sequence[Observation], share: float) -> str:
    """In words, that all motion beyond a common one is noise; empty where it is more, or where the noise is not known
    and there is some. share: as in `little_explained`: motion that the model explains must be less to be noise"""
    held, every, noise = 0.0, list[FloatArray](), list[float]()
    for one in seen:
        known, size = known_of(one), size_of(one.rest)
        moved = one.deformed - one.rest
        away = np.linalg.norm(moved - np.median(moved[known], axis=0), axis=1)
        scatter = 0.0 if one.noise is None else one.noise
        limit = np.maximum(scatter if share >= EXPLAINED_LEAST else STAYS * scatter, 1e-6 * size)
        if one.unit == "px" and share < EXPLAINED_LEAST:  # errors of flow exceed its noise where little is seen
            limit = np.maximum(limit, TREMBLES * size / len(away) ** (1.0 / one.rest.shape[1]))
        stays = away <= limit
        if not stays[one.held].all() or np.mean(stays[one.free_observed]) < MOST:
            return ""
        held, every = max(held, float(away[one.held].max(initial=0.0))), [*every, away[known]]
        noise += [] if one.noise is None else [float(np.median(one.noise[known]))]
    unit = seen[0].unit
    noisy = f"; the noise of a position is {np.median(noise):.2g} {unit}" if noise else ""
    moved_most = f"{np.quantile(np.concatenate(every), MOST):.2g} {unit}"
    return f"nothing moved: the held particles by {held:.2g} {unit} at most, {MOST:.0%} of all by {moved_most}{noisy}"


def aee_outside(name: str, ends: tuple[float, float], least_aee: tuple[float, float] | None) -> Iterator[Doubt]:
    """least_aee: the value of least AEE, and the mass of the posterior below it. One in the tails contradicts the
    posterior; outside of a wide interval it is one of many that fit, and there is no verdict to lower."""
    if least_aee is None or TAIL < least_aee[1] < 1.0 - TAIL or ends[1] - ends[0] >= IDENTIFIED_WIDTH:
        return
    if not ends[0] <= least_aee[0] <= ends[1]:
        text = f"the {name} of least mean distance (AEE), {least_aee[0]:.3g}, is outside of its interval: the value "
        yield Doubt("aee-outside-interval", f"{text}depends on how errors are summed", "weak")


def residual_ratio(seen: Sequence[Observation], simulated: Sequence[FloatArray], floor: float) -> float | None:
    """Ratio of the residuals of simulations (K, d) to the stated noise, by the median, which outliers do not affect;
    None without a stated noise. floor: resolution of numbers [unit]"""
    each = []
    for one, position in zip(seen, simulated, strict=True):
        if one.noise is None:
            return None
        judged = one.free_observed
        each.append(np.abs((one.deformed - position)[judged] / np.maximum(one.noise[judged], floor)[:, None]).ravel())
    return float(np.median(np.concatenate(each)) / NORMAL_MEDIAN)


NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""

NOISE_WORDS: dict[NoiseSource, str] = {"given": "the given noise", "flow": "the noise estimated from the optical flow"}


def noise_source(seen: Sequence[Observation]) -> NoiseSource:
    """The source from which the noise of all observations is known."""
    return "residuals" if any(one.noise is None for one in seen) else seen[0].noise_source


def noise_contradicted(ratio: float | None, source: NoiseSource) -> Iterator[Doubt]:
    """ratio: size of the residuals over the noise from `source`; None if unknown"""
    if ratio is None or 1.0 / NOISE_NAMED < ratio < NOISE_NAMED:
        return
    if ratio > 1.0:
        text = f"the fit is off by {ratio:.0f} times {NOISE_WORDS[source]}: check held particles, region and noise"
        yield Doubt("noise-contradicted", text, "weak" if ratio > NOISE_LOWERS else None)
    elif ratio > 0.0:
        text = f"{NOISE_WORDS[source]} is {1.0 / ratio:.0f} times the residuals: give a smaller one, or unsmoothed data"
        yield Doubt("noise-contradicted", text)


# Units ---------------------------------------------------------------------------------------------------------------


def implausible_lengths(seen: Sequence[Observation]) -> Iterator[Doubt]:
    """Bodies of an unlikely size, if their positions are metres, and deformed shapes in another unit than rest."""
    sizes = [size_of(one.rest) * one.metres_per_unit for one in seen if one.metres_per_unit is not None]
    for size in [one for one in sizes if not SMALL_M <= one <= LARGE_M][:1]:
        yield Doubt("units", f"positions are taken as metres, so this body is {size:.3g} m large; are they?")
    for one in seen:
        known = known_of(one)
        before, after = (np.linalg.norm(x - x.mean(axis=0)) for x in (one.rest[known], one.deformed[known]))
        factor = float(after / before)
        if not 1.0 / RESCALED < factor < RESCALED:
            text = f"the deformed shape is {factor:.3g} times as large as the rest shape: two units?"
            yield Doubt("units", text, "unidentified")
            return


def known_of(seen: Observation) -> BoolArray:
    """(K,) particles whose deformed position is known: seen, or prescribed."""
    known = seen.observed.copy()
    known[seen.held] = True
    return known


# Axes ----------------------------------------------------------------------------------------------------------------


def mirrored(rest: FloatArray, deformed: FloatArray, known: BoolArray) -> Iterator[Doubt]:
    """A doubt if the deformed shape (K, d) is the rest shape (K, d) mirrored: two columns swapped, or one sign turned.
    known: (K,) particles that were observed"""

    def left(shape: FloatArray) -> float:
        """Sum of squared distances of the deformed particles from a shape (K, d) moved as a rigid body."""
        return float(np.sum((rigid_positions(shape, deformed, known) - deformed)[known] ** 2))

    mirror = np.ones(rest.shape[1])
    mirror[0] = -1.0
    as_is, turned = left(rest), left(rest * mirror)
    if as_is > (1e-6 * size_of(rest)) ** 2 and turned < MIRRORED * as_is:
        text = (
            f"the deformed shape is the rest shape mirrored ({np.sqrt(turned / as_is):.0%} of the motion is left): "
            "two columns swapped, or the sign of one turned"
        )
        yield Doubt("axes-swapped", text, "unidentified")


Simulate = Callable[[Sequence[FloatArray]], Sequence[FloatArray]]
"""States (B, K, d) of each observation at B values of the fitted parameter, the same ones for all, with the held
particles at their places in its deformed shape (K, d); NaN where there is none."""

Turn = tuple[str, FloatArray]
"""A possible mistake in the columns of displacements, in words, and the matrix (d, d) that corrects it."""


def turns(dim: int) -> list[Turn]:
    """Displacements with exchanged columns, with and without a changed sign, and with one changed sign. A change of all
    signs is left out, as small motions do not show it."""
    axes, eye = "xyz", np.eye(dim)
    found: list[Turn] = []
    for axis in range(dim):
        found.append((f"the sign of {axes[axis]} turned", np.diag(np.where(np.arange(dim) == axis, -1.0, 1.0))))
    for i, j in itertools.combinations(range(dim), 2):
        order = np.arange(dim)
        order[[i, j]] = order[[j, i]]
        found.append((f"{axes[i]} and {axes[j]} swapped", eye[order]))
        if dim == 2:
            found.append((f"{axes[i]} and {axes[j]} swapped and one sign turned", eye[order] * [1.0, -1.0]))
    if dim == 3:
        found += [("x, y and z in another order", eye[[1, 2, 0]]), ("x, y and z in another order", eye[[2, 0, 1]])]
    return found[1:] if dim == 2 else found  # in the plane one sign is the other one turned, and all


def bulging(seen: Sequence[Observation], bodies: Sequence[Msm], beta: FloatArray) -> Simulate:
    """States at betas (B,) of bodies whose clusters conserve an increasing share of their volume: they bulge."""
    betas, thetas = np.tile(beta, len(BULGES)), np.repeat(BULGES, len(beta))

    def simulate(shapes: Sequence[FloatArray]) -> list[FloatArray]:
        each = zip(seen, bodies, shapes, strict=True)
        return [body.relax(shape[one.held], betas, thetas, volume="project").settled for one, body, shape in each]

    return simulate


def swapped_axes(
    seen: Sequence[Observation],
    simulate: Simulate,
    bulge: Simulate | None,
    weight: FloatArray | None = None,
    rival: float = np.inf,
) -> Iterator[Doubt]:
    """Whether displacements fit far better with their columns in another order, or of another sign; also as a share of
    the motion beyond a rigid one, because the exchanged part may be less than before.

    bulge: the states of `bulging`. A bulge as that of rubber is no motion of another axis: exchanged columns have to
    fit better than it too. None = not tried; weight: (n,) weight of each observation, default 1
    rival: squared error [unit^2] of another explanation, which other axes have to undercut"""
    if all(one.unit == "px" for one in seen):
        return  # a picture's columns are in order: plates of low Poisson's ratio look exchanged
    each = np.ones(len(seen)) if weight is None else weight

    def left(matrix: FloatArray, states_of: Simulate) -> tuple[float, float]:
        """Least squared error of the model, and its share of a rigid body's, with rest shapes changed by (d, d)."""
        by_model: FloatArray = np.zeros(1)
        by_rigid = 0.0
        shapes = [one.rest + (one.deformed - one.rest) @ matrix.T for one in seen]
        for one, shape, states, counts in zip(seen, shapes, states_of(shapes), each, strict=True):
            judged = one.free_observed
            rigid = rigid_positions(one.rest, shape, known_of(one))
            by_model = by_model + counts * np.sum((states - shape)[:, judged] ** 2, axis=(1, 2))
            by_rigid += counts * float(np.sum((rigid - shape)[judged] ** 2))
        least = float(np.min(by_model, where=np.isfinite(by_model), initial=np.inf))
        return least, least / by_rigid if by_rigid > 0.0 else np.inf

    dim = seen[0].rest.shape[1]
    as_is, as_is_share = left(np.eye(dim), simulate)
    found = [(*left(matrix, simulate), words, matrix) for words, matrix in turns(dim)]
    least, share, words, matrix = min(found, key=lambda one: one[0])

    def better() -> bool:
        return (
            as_is > seen[0].rest.size * (1e-6 * size_of(seen[0].rest)) ** 2
            and least < min(SWAPPED * as_is, rival)
            and share < SWAPPED_SHARE * as_is_share
        )

    if bulge is not None and better():
        as_is, as_is_share = min((as_is, as_is_share), left(np.eye(dim), bulge))
        least, share = min((least, share), left(matrix, bulge))
    if better():
        now, then = max(1.0 - as_is_share, 0.0), max(1.0 - share, 0.0)
        text = f"with {words} in the displacements {then:.0%} of the motion is explained, as it is {now:.0%}"
        yield Doubt("axes-swapped", text, "unidentified")


# What a value holds for ----------------------------------------------------------------------------------------------


def setting(seen: Sequence[Observation], model: Model, misfit: float, noise: float) -> Iterator[Doubt]:
    """The setting for which theta is valid; with misfit of half the noise [unit] another depth gives another theta."""
    share = max(push_share(one) for one in seen)
    least = NEGLIGIBLE * share * max(size_of(one.rest) for one in seen)
    many = ", ".join(dict.fromkeys(str(len(one.rest)) for one in seen))
    one_cluster = model.cluster_size is None
    group = f"one {model.basis} cluster" if one_cluster else f"{model.basis} clusters of {model.cluster_size} a side"
    fixed = f", beta {model.beta:g}" if model.parameter == "theta" else ""
    slid, unit = max((_slid(one, noise) for one in seen), default=0.0), "px" if seen[0].unit == "px" else "m"
    held = f"held particles that slide by up to {slid:.2g} {unit}" if slid else "held particles that do not slide"
    if slid:
        how = f"{held} over what holds them: theta goes with friction; compare it with values of the same surfaces only"
        yield Doubt("held-slides", how, "weak")
    text = (
        f"theta holds for this setting: a push of {share:.0%} of the body's size, {many} particles in {group}{fixed}, "
        f"{held}; another depth, resolution or friction gives another value"
    )
    yield Doubt("setting", text, "weak" if misfit > max(MISFIT_LEAST * noise, least) else None)


def _slid(seen: Observation, noise: float) -> float:
    """How far held particles of a flat side slide apart [unit]: the largest motion by an even strain of the side that a
    tool moves, or that stays. 0 where noise [unit] may look the same, or the particles are on no flat side."""
    moved, touched = seen.deformed - seen.rest, np.isin(seen.held, seen.touched)
    sd = 0.0 if seen.held_measured is False else noise if seen.noise is None else float(seen.noise[seen.held].max())
    farthest, push = 0.0, push_share(seen) * size_of(seen.rest)
    for side in (one for one in (seen.held[touched], seen.held[~touched]) if len(one)):
        at = seen.rest[side] - seen.rest[side].mean(axis=0)
        size, along = np.linalg.svd(at, full_matrices=False)[1:]
        flat = size > 1e-6 * size_of(seen.rest)
        if len(side) <= flat.sum() or not 0 < flat.sum() < at.shape[1]:
            continue
        place = at @ along[flat].T
        strain = np.linalg.lstsq(place, (moved[side] - moved[side].mean(axis=0)) @ along[flat].T, rcond=None)[0]
        far = np.linalg.norm(place @ (0.5 * (strain + strain.T)), axis=1)
        unsure = SLIDES_SURE * sd * float(np.linalg.norm(place, axis=1).max() / size[flat].min())
        if far.max() > max(SLIDES * push, unsure):
            farthest = max(farthest, float(far.max()))
    return farthest


def push_share(seen: Observation) -> float:
    """The largest motion of a held particle, beyond the least one, as a share of the body's size."""
    moved = (seen.deformed - seen.rest)[seen.held]
    still = moved[np.linalg.norm(moved, axis=1).argmin()]
    return float(np.linalg.norm(moved - still, axis=1).max()) / size_of(seen.rest)
