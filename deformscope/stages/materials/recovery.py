"""How a thing recovers once it is let go: what of its modulus relaxes, how fast, and what it keeps for good.

Where every modulus of a body relaxes alike and Poisson's ratio stays, one shape of its displacement grows and shrinks
with time (the correspondence principle: Lee 1955), and its share a(t) of the largest follows

    a(t) = f(t) + sum_i j_i E_i(t) + p max a,      dE_i/dt = (f - E_i) / l_i

with the force f as a share of what the same dent takes at once: each branch is a low-pass filter of the force, of
strength j_i and retardation time l_i (`stages.poke.creep`), and p the share that is kept. While a tool prescribes a(t)
nothing but a force shows f; once it is off f is 0, and what is left recovers by what the branches remember. So a motion
without force is asked by its recovery alone, and one with force by its relaxation too, which shows the stiffness.

None, one and two branches, with and without a set, are compared by their evidence and averaged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported as they are first used

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.relaxation import mean_relaxation_s
from deformscope.stages.fit.weighted_draws import draw_about, median_and_interval, pooled
from deformscope.stages.materials.recovery_estimate import Number, RecoveryBehaviour, RecoveryEstimate

STRENGTH_MEDIAN, STRENGTH_SPREAD = 0.2, 0.9
"""Log-normal prior of a branch's strength, as `stages.poke.creep` has it."""
SET_MEDIAN, SET_SPREAD = 0.06, 1.0
"""Log-normal prior of the share that is kept: 1 to 40 % [assumed]."""
SLOWEST = 5.0
"""Retardation times go from the time between frames to so many times what was recorded since the push."""
MOST_BRANCHES = 2
NOTICED = 0.03
"""Share that relaxes, or is kept, from which on a thing counts as viscous, or plastic."""
SURE = 0.95
LEAST_SD = 2e-3
"""Deviation of a frame's share at the least: one shape does not hold closer [chosen on tuning seeds]."""
OFFSET_SD = 4e-3
"""Deviation of an error that all frames after the release share, as flow has that has followed a push and its way back
[chosen on tuning seeds]."""
FORCE_SD = 0.01
"""Of a force as a share of the largest: what one shape, and its law, leave open."""
BETWEEN_SD = 0.5
"""Of where between its two frames the release lies, about the middle: anywhere."""
LEAST_AFTER = 4
"""Frames after the release that a recovery is fitted to."""
CANDIDATES = 12
"""Frames that are tried as the last one in contact, where no force shows it."""


def fit_recovery(
    time_s: FloatArray,
    amplitude: FloatArray,
    *,
    loaded: int,
    released: int | None = None,
    force_n: FloatArray | None = None,
    force_sd_n: float = 0.0,
    largest: float = 1.0,
    level: float = 0.9,
    seed: int = 0,
) -> RecoveryEstimate:
    """Fit the law to shares (T,) of the largest displacement.

    time_s: (T,) rising [s]; loaded: last frame at the deepest; released: first frame at which nothing touches it, None:
    found as the frame from which on the law holds without a force
    force_n: (T,) of the tool [N], and the deviation of one sample; largest: displacement of what was pressed then
    Raises InputError where too little was seen after the release, and no force before it.
    """
    if len(time_s) != len(amplitude) or not (np.diff(time_s) > 0.0).all():
        raise InputError("a rising time for each frame", f"{len(time_s)} for {len(amplitude)}")
    last = len(time_s) - 1
    if released is None:
        released = _released(time_s, amplitude, loaded)
    if last + 1 - released < LEAST_AFTER and force_n is None:
        came = f"{last + 1 - released} of {last + 1}"
        hint = "record on after the tool is off: some times as long as the recovery takes"
        raise InputError(f"{LEAST_AFTER} frames or more after the release", came, hint)
    law = _RecoveryLaw(time_s, amplitude, released, force_n, force_sd_n)
    models = [(branches, kept) for branches in range(MOST_BRANCHES + 1) for kept in (False, True)]
    law.widen(law.best(MOST_BRANCHES, kept=True), MOST_BRANCHES)
    draws = [
        law.posterior(branches, kept, np.random.default_rng([seed, at])) for at, (branches, kept) in enumerate(models)
    ]
    weight = pooled([one.log_evidence for one in draws], [one.weight for one in draws])
    strength, mean_s, kept, stiffness = (
        np.concatenate([getattr(one, name) for one in draws]) for name in ("strength", "mean_s", "kept", "stiffness")
    )
    share = strength / (1.0 + strength)
    creeps = strength > 0.0
    middle = int(np.argmax([one.log_evidence for one in draws]))
    simulated = np.full(len(time_s), np.nan)
    simulated[released:] = law.simulated(draws[middle].best[None], models[middle][0])[0][0]
    return RecoveryEstimate(
        share=Number(*median_and_interval(share, weight, level)),
        time_s=Number(*median_and_interval(mean_s[creeps], weight[creeps], level)),
        set=Number(*median_and_interval(kept, weight, level)),
        instant=_per_unit(stiffness, weight, largest, level) if force_n is not None else None,
        relaxed=_per_unit(stiffness * (1.0 - share), weight, largest, level) if force_n is not None else None,
        verdict=_verdict(share, kept, weight),
        level=level,
        reasons=(),
        explained=1.0,
        held_s=float(time_s[released - 1] - time_s[_begin(amplitude)]),
        watched_s=float(time_s[-1] - time_s[min(released, last)]),
        released=released,
        largest=largest,
        time=time_s - time_s[0],
        observed=amplitude,
        simulated=simulated,
        settings={"seed": seed, "frames": len(time_s), "with_force": force_n is not None, "noise": law.sd},
    )


def _per_unit(stiffness: FloatArray, weight: FloatArray, largest: float, level: float) -> Number:
    return Number(*median_and_interval(stiffness / largest, weight, level))


def _verdict(share: FloatArray, kept: FloatArray, weight: FloatArray) -> RecoveryBehaviour:
    """The verdict of draws. share, kept: (n,) lost by flow, kept for good; weight: (n,)"""
    viscous, plastic = (float(weight[one > NOTICED].sum()) for one in (share, kept))
    if viscous >= SURE:
        return "viscoplastic" if plastic >= SURE else "viscous"
    if plastic >= SURE:
        return "plastic"
    return "elastic" if max(viscous, plastic) <= 1.0 - SURE else "unidentified"


def _begin(amplitude: FloatArray) -> int:
    """Index of the frame before it moves, of an amplitude (T,)."""
    return max(0, int(np.flatnonzero(amplitude > 0.02 * amplitude.max())[0]) - 1)


def _released(time_s: FloatArray, amplitude: FloatArray, loaded: int) -> int:
    """The first frame after which the law holds without a force: what is in contact may be anywhere between rest and
    the deepest, what is free is where the law has it."""
    last = len(time_s) - 1
    latest = last + 1 - LEAST_AFTER
    if latest <= loaded:
        return loaded + 1
    tried = np.unique(np.linspace(loaded + 1, latest, min(CANDIDATES, latest - loaded)).astype(int))
    # it comes back fast while a tool lifts: the frames right after the fastest are the likeliest
    fastest = loaded + 1 + int(np.argmin(np.diff(amplitude[loaded:])))
    near = np.arange(fastest - 1, fastest + 4)
    tried = np.unique(np.concatenate([tried, near[(near > loaded) & (near <= latest)]]))
    likely: list[float] = []
    best = None
    for released in tried[::-1]:
        law = _RecoveryLaw(time_s, amplitude, int(released))
        best = law.best(1, kept=True, start=best)
        off = law.residuals(best[None], 1)[0][: last + 1 - released]
        free = last + 1 - released
        likely.append(-0.5 * float(off @ off) - free * float(np.log(law.sd * np.sqrt(2.0 * np.pi))))
    return int(tried[::-1][int(np.argmax(likely))])


@dataclass(frozen=True, slots=True)
class _RecoveryDraws:
    """Of one model: log evidence, its best parameters; weight (d,); sum of j_i, mean relaxation time [s], share kept,
    and force for the largest displacement at once [N], all (d,)."""

    log_evidence: float
    best: FloatArray
    weight: FloatArray
    strength: FloatArray
    mean_s: FloatArray
    kept: FloatArray
    stiffness: FloatArray


class _RecoveryLaw:
    """The law over one motion; parameters: log j and log l of each branch, the error that all frames after the release
    share, how far between its two frames the release lies, then log of the share kept, and log of the stiffness, where
    these are there."""

    def __init__(
        self,
        time_s: FloatArray,
        amplitude: FloatArray,
        released: int,
        force_n: FloatArray | None = None,
        force_sd_n: float = 0.0,
    ) -> None:
        self._time, self._amplitude, self._released = time_s, amplitude, released
        self._most = np.maximum.accumulate(np.maximum(amplitude, 0.0))
        span = time_s[-1] - time_s[_begin(amplitude)]
        fast, slow = np.log(float(np.median(np.diff(time_s)))), np.log(SLOWEST * span)
        self._log_time, self._time_spread = 0.5 * (fast + slow), 0.25 * (slow - fast)
        self._limits = fast - 2.0, slow + 2.0
        # neighbouring frames share no motion beyond a straight one
        bend = np.diff(amplitude[released:], 2)
        scatter = 1.4826 * float(np.median(np.abs(bend))) / np.sqrt(6.0) if len(bend) else 0.0
        self.sd = max(LEAST_SD, scatter)
        self._force = None
        if force_n is not None:
            most = float(np.max(force_n))
            self._force, self._force_scale = force_n[1:released] / most, most
            self._force_sd = np.hypot(FORCE_SD, force_sd_n / most)

    def widen(self, best: FloatArray, branches: int) -> None:
        """Take what the best fit (p,) leaves as noise, and that neighbours share it."""
        off = self.residuals(best[None], branches)[0][: len(self._amplitude) - self._released]
        if len(off) <= len(best):
            return
        size = max(1.0, float(np.sqrt(np.mean(off**2))))
        alike = float(off[1:] @ off[:-1] / max(off @ off, 1e-12))
        shared = np.sqrt((1.0 + np.clip(alike, 0.0, 0.9)) / (1.0 - np.clip(alike, 0.0, 0.9)))
        self.sd *= size * float(shared)

    def best(self, branches: int, *, kept: bool, start: FloatArray | None = None) -> FloatArray:
        """The likeliest parameters (p,) of so many branches. start: (p,), from which they are sought"""
        if start is None:
            apart = np.linspace(-0.7, 0.7, branches) if branches > 1 else np.zeros(branches)
            parts = [np.full(branches, np.log(STRENGTH_MEDIAN)), self._log_time + self._time_spread * apart, [0.0, 0.5]]
            parts += [[np.log(SET_MEDIAN)]] * kept + [[0.0]] * (self._force is not None)
            start = np.concatenate(parts)
        found = scipy.optimize.least_squares(
            lambda one: self.residuals(one[None], branches)[0],
            start,
            jac=lambda one: self.jacobian(one, branches),
            x_scale="jac",
            ftol=1e-7,
            xtol=1e-6,
            max_nfev=60,
        )
        return np.asarray(found.x)

    def posterior(self, branches: int, kept: bool, random: np.random.Generator) -> _RecoveryDraws:
        """Weighted draws of the parameters of one model."""
        best = self.best(branches, kept=kept)
        size = branches * np.log(2.0 * np.pi * STRENGTH_SPREAD * self._time_spread)
        size += kept * np.log(np.sqrt(2.0 * np.pi) * SET_SPREAD)
        drawn, weight, log_evidence = draw_about(
            best, self.jacobian(best, branches), lambda some: self.residuals(some, branches), float(size), random
        )
        strength, retarded_s = np.exp(drawn[:, :branches]), np.exp(self._log_times(drawn, branches))
        at = 2 * branches + 2
        share = np.exp(drawn[:, at]) if kept else np.zeros(len(drawn))
        stiffness = self._force_scale * np.exp(drawn[:, -1]) if self._force is not None else np.zeros(len(drawn))
        mean_s = mean_relaxation_s(strength, retarded_s)
        return _RecoveryDraws(
            log_evidence=log_evidence,
            best=best,
            weight=weight,
            strength=strength.sum(axis=1),
            mean_s=mean_s,
            kept=share,
            stiffness=stiffness,
        )

    def jacobian(self, at: FloatArray, branches: int) -> FloatArray:
        """(m, k) of the residuals, by central differences, all in one pass."""
        step = 1e-4 * np.eye(len(at))
        both = self.residuals(np.concatenate([at + step, at - step]), branches)
        return np.asarray((both[: len(at)] - both[len(at) :]).T / 2e-4)

    def residuals(self, at: FloatArray, branches: int) -> FloatArray:
        """(d, m) of parameters (d, k): shares after the release, forces before it, then what priors hold against."""
        share, force = self.simulated(at, branches)
        parts = [(self._amplitude[self._released :] - share) / self.sd]
        if self._force is not None:
            parts.append((self._force - force) / self._force_sd)
        offset, between = at[:, 2 * branches : 2 * branches + 1], at[:, 2 * branches + 1 : 2 * branches + 2]
        parts += [
            (at[:, :branches] - np.log(STRENGTH_MEDIAN)) / STRENGTH_SPREAD,
            (at[:, branches : 2 * branches] - self._log_time) / self._time_spread,
            offset / OFFSET_SD,
            (between - 0.5) / BETWEEN_SD,
        ]
        if self._has_set(at, branches):
            parts.append((at[:, 2 * branches + 2 : 2 * branches + 3] - np.log(SET_MEDIAN)) / SET_SPREAD)
        return np.concatenate(parts, axis=1)

    def simulated(self, at: FloatArray, branches: int) -> tuple[FloatArray, FloatArray]:
        """Shares (d, T - released) after the release, and forces (d, released - 1) before it, of parameters (d, k)."""
        released, count = self._released, len(self._time)
        strength, retarded = np.exp(at[:, :branches]), np.exp(self._log_times(at, branches))
        offset, between = at[:, 2 * branches, None], np.clip(at[:, 2 * branches + 1], 0.0, 1.0)
        kept = np.exp(at[:, 2 * branches + 2]) if self._has_set(at, branches) else np.zeros(len(at))
        most = self._most[released - 1]
        driven = self._amplitude - kept[:, None] * self._most  # (d, T) what is elastic or creeps
        branch: FloatArray = np.zeros((len(at), branches))
        force = np.empty((len(at), released))
        if branches:
            steps = _BranchSteps.of(strength, retarded, np.diff(self._time[:released]))
            for frame in range(released):
                if frame:
                    branch = steps.step(branch, driven[:, frame - 1], driven[:, frame], frame - 1)
                force[:, frame] = driven[:, frame] - np.sum(strength * branch, axis=1)
        else:
            force[:] = driven[:, :released]
        after: FloatArray = np.empty((len(at), count - released))
        if count > released:
            gap = self._time[released] - self._time[released - 1]
            branch = _lifted(branch, force[:, -1], retarded, between * gap, gap)
            since = self._time[released:] - self._time[released]
            left = np.exp(-since[None, None, :] / retarded[:, :, None])
            after = np.einsum("db,dbt->dt", strength * branch, left)
        scale = np.exp(at[:, -1])[:, None] if self._force is not None else 1.0
        return after + kept[:, None] * most + offset, scale * np.maximum(force[:, 1:], 0.0)

    def _log_times(self, at: FloatArray, branches: int) -> FloatArray:
        """(n, branches) log times of the branches, within their limits, of parameters (n, p)."""
        return np.asarray(np.clip(at[:, branches : 2 * branches], *self._limits))

    def _has_set(self, at: FloatArray, branches: int) -> bool:
        return bool(at.shape[1] > 2 * branches + 2 + (self._force is not None))


@dataclass(frozen=True, slots=True)
class _BranchSteps:
    """Branches driven by a displacement that goes straight from frame to frame, each step exact.

    rate: (d, b) eigenvalues of how branches relax under a displacement; into, out: (d, b, b) to their eigenvectors and
    back; push: (d, b) what drives each; gap_s: (n,) between frames
    """

    rate: FloatArray
    into: FloatArray
    out: FloatArray
    push: FloatArray
    gap_s: FloatArray

    @classmethod
    def of(cls, strength: FloatArray, retarded: FloatArray, gap_s: FloatArray) -> _BranchSteps:
        matrix = -(np.eye(strength.shape[1]) + strength[:, None, :]) / retarded[:, :, None]
        # alike to a symmetric matrix, whose eigenvectors are orthogonal: scaled by the root of j_i l_i
        root = np.sqrt(strength * retarded)
        even = matrix * root[:, :, None] / root[:, None, :]
        rate, vectors = np.linalg.eigh(0.5 * (even + even.transpose(0, 2, 1)))
        into, out = vectors.transpose(0, 2, 1) * root[:, None, :], vectors / root[:, :, None]
        return cls(rate=rate, into=into, out=out, push=np.einsum("dij,dj->di", into, 1.0 / retarded), gap_s=gap_s)

    def step(self, branch: FloatArray, before: FloatArray, now: FloatArray, at: int) -> FloatArray:
        """(d, b) from one frame to the next, the displacement (d,) going from `before` to `now`."""
        gap = self.gap_s[at]
        turn = self.rate * gap
        first = np.expm1(turn) / turn
        second = (first - 1.0) / turn
        moved = np.exp(turn) * np.einsum("dij,dj->di", self.into, branch)
        moved += gap * self.push * (first * before[:, None] + second * (now - before)[:, None])
        return np.asarray(np.einsum("dij,dj->di", self.out, moved))


def _lifted(
    branch: FloatArray, force: FloatArray, retarded: FloatArray, lift_s: FloatArray, gap_s: float
) -> FloatArray:
    """(d, b) branches a time `gap_s` after the last frame in contact; the force (d,) goes straight to 0 within
    `lift_s` (d,)."""
    lift = np.maximum(lift_s, 1e-9)[:, None]
    left = np.exp(-lift / retarded)
    # a filter behind a force that falls straight to 0: exact
    slope = force[:, None] / lift
    risen = left * branch + force[:, None] * (1.0 - left) - slope * (lift - retarded * (1.0 - left))
    return np.asarray(risen * np.exp(-(gap_s - lift) / retarded))
