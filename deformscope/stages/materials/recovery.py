"""Recovery of a body after its release: relaxing share of its modulus, relaxation time, and permanent set.

If all moduli of a body relax by the same share and Poisson's ratio is constant, its displacement has one shape, which
grows and shrinks with time (the correspondence principle: Lee 1955). Its share a(t) of the largest follows

    a(t) = f(t) + sum_i j_i E_i(t) + p max a,      dE_i/dt = (f - E_i) / l_i

with the force f as a share of the immediate force of the same dent. Each branch is a low-pass filter of the force, of
strength j_i and retardation time l_i (`stages.poke.creep`), and p the permanent share. While a tool prescribes a(t)
only a force shows f; once it is off f is 0, and the rest recovers by the branches' memory. Therefore a motion without
force is fitted by its recovery only, and one with force by its relaxation too, which shows the stiffness.

Models with zero to three branches, and with a spectrum that reaches no plateau (`stages.fit.creep_spectra`), each with
and without a set, are averaged by their evidence. A process that outlasts the record is a reason, and a bound; a
smaller probability of it opens intervals. Without a force, such a process resembles a set. One branch that outlasts the
record is therefore a model of its own: draws about a faster one do not reach it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported as they are first used

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.creep_spectra import (
    ENDLESS_HOLDS,
    STRENGTH_MEDIAN,
    STRENGTH_SPREAD,
    Branches,
    Endless,
    Spectrum,
)
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.fit.relaxation import (
    kept_of,
    mean_relaxation_s,
    relaxation_modes,
    seen_of,
)
from deformscope.stages.fit.weighted_draws import draw_about, median_and_interval, pooled
from deformscope.stages.materials.recovery_estimate import Number, RecoveryBehaviour, RecoveryEstimate

SET_MEDIAN, SET_SPREAD = 0.06, 1.0
"""Log-normal prior of the share that is kept: 1 to 40 % [assumed]."""
SLOWEST = 10.0
"""Retardation times range from the time between frames to this multiple of the record since the push."""
MOST_BRANCHES, MOST_WITH_SLOW = 3, 2
OUTLASTS = 0.3
"""Prior probability that one of the branches outlasts the record: the share of the log times that does [assumed]."""
OPEN_RECOVERY = 0.13
"""The same as `relaxation.OPEN` for recoveries. At .15 intervals of the share hold .82 of slow branches; at .1 the
median width of the time of two branches is 1.8 times as large (pushes of a Maxwell solid, seeds 3000 to 3099)."""
PRESSED = 0.95
"""Share of the largest displacement at which the push has come to its end."""
FORCE_DRAWS = 400
"""Number of draws from which the remaining force is computed."""
NOTICED = 0.03
"""Relaxing, or permanent, share from which a body counts as viscous, or plastic."""
SURE = 0.95
LEAST_SD = 2e-3
"""Least deviation of a frame's share, as the displacement has one shape only approximately [chosen on tuning seeds]."""
OFFSET_SD = 4e-3
"""Standard deviation of an error that all frames after the release share, as in flow that has followed a push and its
end [chosen on tuning seeds]."""
FORCE_SD = 0.01
"""Error of a force as a share of the largest, due to the one shape and its law."""
BETWEEN_SD = 0.5
"""Deviation of the time of release between its two frames, about their middle: it may be anywhere between them."""
LEAST_AFTER = 4
"""Least number of frames after the release for fitting a recovery."""
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

    time_s: (T,) rising [s]; loaded: last frame at the deepest; released: first frame without a contact, None: found as
    the frame from which the law holds without a force; force_n: (T,) force of the tool [N], and the deviation of one
    sample; largest: largest displacement of the pressed particles.

    Raises InputError if too little was recorded after the release, and no force before it.
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
    models = [(spectrum, kept) for spectrum in law.spectra for kept in (False, True)]
    law.widen(law.best(law.spectra[2], kept=True), law.spectra[2])
    draws = [
        law.posterior(spectrum, kept, np.random.default_rng([seed, at])) for at, (spectrum, kept) in enumerate(models)
    ]
    weight = pooled([one.log_evidence for one in draws], [one.weight for one in draws])
    every, retarded_s, mean_s, kept, stiffness, endless = (
        np.concatenate([getattr(one, name) for one in draws])
        for name in ("strength", "retarded_s", "mean_s", "kept", "stiffness", "endless")
    )
    watched_s, record_s = law.watched_s, law.record_s
    seen = seen_of(every, retarded_s, endless, weight, record_s, OPEN_RECOVERY)
    share, creeps = seen.share, every.any(axis=1)
    judged = weight * (seen.within if not seen.reasons else 1.0)
    # a closed interval is of what relaxes within the record
    shared = judged if not seen.open else weight
    verdict = _verdict(share, kept, weight)
    mean_time = median_and_interval(mean_s[creeps], judged[creeps], level)
    if not seen.reasons and verdict not in ("elastic", "plastic") and mean_time[1][1] > record_s:
        seen = dataclasses.replace(seen, reasons=(_alike(mean_time, watched_s),))
    some = np.random.default_rng(seed).choice(len(weight), FORCE_DRAWS, p=weight / weight.sum())
    ramp_s = float(time_s[law.pressed] - time_s[_begin(amplitude)])
    relaxed = _per_unit(stiffness * (1.0 - share), weight, largest, level)
    if seen.reasons or seen.open:
        relaxed = Number(relaxed.interval[1] if seen.reasons else relaxed.value, (0.0, relaxed.interval[1]))
    stays, (least, most) = median_and_interval(kept, weight, level)
    unseen = weight * ~seen.within
    if (seen.reasons or seen.open) and unseen.any():  # a part of the set may be a slow recovery
        least = min(least, median_and_interval(kept, unseen, level)[1][0])
    middle = int(np.argmax([one.log_evidence for one in draws]))
    simulated = np.full(len(time_s), np.nan)
    simulated[released:] = law.simulated(draws[middle].best[None], models[middle][0])[0][0]
    return RecoveryEstimate(
        share=Number(*seen.bounded(*median_and_interval(share, shared, level), 1.0)),
        time_s=Number(*seen.bounded(*mean_time, np.inf)),
        set=Number(stays, (least, most)),
        instant=_per_unit(stiffness, weight, largest, level) if force_n is not None else None,
        relaxed=relaxed if force_n is not None else None,
        verdict=verdict,
        level=level,
        reasons=seen.reasons,
        force_kept=kept_of(every[some], retarded_s[some], np.ones(FORCE_DRAWS), ramp_s, record_s),
        explained=1.0,
        held_s=float(time_s[released - 1] - time_s[_begin(amplitude)]),
        watched_s=watched_s,
        released=released,
        largest=largest,
        time=time_s - time_s[0],
        observed=amplitude,
        simulated=simulated,
        settings={"seed": seed, "frames": len(time_s), "with_force": force_n is not None, "noise": law.sd},
    )


def _alike(mean_time: tuple[float, tuple[float, float]], watched_s: float) -> Doubt:
    """That a recovery may be slower than was watched. mean_time: median and interval [s]"""
    middle, (_, slowest) = mean_time
    text = (
        f"the recovery takes {middle:.2g} s (up to {slowest:.2g} s), and {watched_s:.2g} s were recorded "
        "after the release: a slow recovery and a permanent set look alike; record longer"
    )
    return Doubt("short-record", text)


def _per_unit(stiffness: FloatArray, weight: FloatArray, largest: float, level: float) -> Number:
    return Number(*median_and_interval(stiffness / largest, weight, level))


def _verdict(share: FloatArray, kept: FloatArray, weight: FloatArray) -> RecoveryBehaviour:
    """The verdict of draws. share, kept: (n,) relaxing and permanent shares; weight: (n,)"""
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
    """The first frame after which the law holds without a force: particles in contact may be anywhere between rest and
    the deepest, free ones follow the law."""
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
        best = law.best(law.spectra[1], kept=True, start=best)
        off = law.residuals(best[None], law.spectra[1])[0][: last + 1 - released]
        free = last + 1 - released
        likely.append(-0.5 * float(off @ off) - free * float(np.log(law.sd * np.sqrt(2.0 * np.pi))))
    return int(tried[::-1][int(np.argmax(likely))])


@dataclass(frozen=True, slots=True)
class _RecoveryDraws:
    """Draws of one model: log evidence, its best parameters; weight (d,); j_i and l_i [s] (d, b), with strength 0 for
    absent branches; mean relaxation time [s], permanent share, immediate force of the largest displacement [N], and
    whether the spectrum has no end, all (d,)."""

    log_evidence: float
    best: FloatArray
    weight: FloatArray
    strength: FloatArray
    retarded_s: FloatArray
    mean_s: FloatArray
    kept: FloatArray
    stiffness: FloatArray
    endless: BoolArray


class _RangedBranches(Branches):
    """Branches with one choice of log times: nodes are the (b, 2) range of each, of four deviations."""

    def priors(self) -> tuple[FloatArray, FloatArray]:
        log_j = np.full(self.count, np.log(STRENGTH_MEDIAN))
        first, last = self.nodes.T
        mean = np.append(log_j, 0.5 * (first + last))
        return mean[None], np.append(np.full(self.count, STRENGTH_SPREAD), 0.25 * (last - first))


class _RecoveryLaw:
    """The law over one motion; parameters: those of a spectrum, the error that all frames after the release share, and
    the release's position between its two frames. Then log of the permanent share, and log of the stiffness, if these
    exist."""

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
        self._limits = fast - 2.0, slow + 2.0
        self.pressed = int(np.argmax(amplitude >= PRESSED * amplitude.max()))
        self.watched_s = float(time_s[-1] - time_s[min(released, len(time_s) - 1)])
        held_s = float(time_s[released - 1] - time_s[self.pressed])
        self.record_s = max(self.watched_s, held_s if force_n is not None else 0.0)
        outlasts = OUTLASTS if self.record_s > 0.0 else 0.0
        every = np.array([[fast, slow]] * MOST_BRANCHES)
        self.spectra: list[Spectrum] = [
            _RangedBranches(count, every[:count], 0.5**count * (1.0 - (outlasts if count else 0.0)))
            for count in range(MOST_BRANCHES + 1)
        ]
        self.spectra.append(Endless.over(np.exp(fast), SLOWEST * span / ENDLESS_HOLDS, 1.0, 0.25))
        if outlasts:
            late = np.array([[np.log(self.record_s), slow]])
            self.spectra += [
                _RangedBranches(count, np.vstack([every[1:count], late]), 0.5**count * outlasts)
                for count in range(1, MOST_WITH_SLOW + 1)
            ]
        # neighbouring frames share no motion beyond a straight one
        bend = np.diff(amplitude[released:], 2)
        scatter = 1.4826 * float(np.median(np.abs(bend))) / np.sqrt(6.0) if len(bend) else 0.0
        self.sd = max(LEAST_SD, scatter)
        self._force = None
        if force_n is not None:
            most = float(np.max(force_n))
            self._force, self._force_scale = force_n[1:released] / most, most
            self._force_sd = np.hypot(FORCE_SD, force_sd_n / most)

    def widen(self, best: FloatArray, spectrum: Spectrum) -> None:
        """Use the residual of the best fit (p,) as noise, shared by neighbours."""
        off = self.residuals(best[None], spectrum)[0][: len(self._amplitude) - self._released]
        if len(off) <= len(best):
            return
        size = max(1.0, float(np.sqrt(np.mean(off**2))))
        alike = float(off[1:] @ off[:-1] / max(off @ off, 1e-12))
        shared = np.sqrt((1.0 + np.clip(alike, 0.0, 0.9)) / (1.0 - np.clip(alike, 0.0, 0.9)))
        self.sd *= size * float(shared)

    def best(self, spectrum: Spectrum, *, kept: bool, start: FloatArray | None = None) -> FloatArray:
        """The likeliest parameters (p,) of a spectrum. start: (p,), from which they are sought"""
        if start is None:
            middle, spread = self._priors(spectrum)
            if not spectrum.endless and spectrum.most > 1:
                middle = middle + spread * np.append(np.zeros(spectrum.most), np.linspace(-0.7, 0.7, spectrum.most))
            more = [0.0, 0.5, *[np.log(SET_MEDIAN)] * kept, *[0.0] * (self._force is not None)]
            start = np.append(middle, more)
        found = scipy.optimize.least_squares(
            lambda one: self.residuals(one[None], spectrum)[0],
            start,
            jac=lambda one: self.jacobian(one, spectrum),
            x_scale="jac",
            ftol=1e-7,
            xtol=1e-6,
            max_nfev=60,
        )
        return np.asarray(found.x)

    def posterior(self, spectrum: Spectrum, kept: bool, random: np.random.Generator) -> _RecoveryDraws:
        """Weighted draws of the parameters of one model."""
        best = self.best(spectrum, kept=kept)
        spread = np.append(self._priors(spectrum)[1], [SET_SPREAD] * kept)
        size = float(np.log(np.sqrt(2.0 * np.pi) * spread).sum() - np.log(spectrum.prior))
        drawn, weight, log_evidence = draw_about(
            best, self.jacobian(best, spectrum), lambda some: self.residuals(some, spectrum), size, random
        )
        strength, retarded_s = self._filters(drawn, spectrum)
        at = self._size(spectrum) + 2
        none = ((0, 0), (0, max(one.most for one in self.spectra) - spectrum.most))
        return _RecoveryDraws(
            log_evidence=log_evidence,
            best=best,
            weight=weight,
            strength=np.pad(strength, none),
            retarded_s=np.pad(retarded_s, none, constant_values=1.0),
            mean_s=mean_relaxation_s(strength, retarded_s),
            kept=np.exp(drawn[:, at]) if kept else np.zeros(len(drawn)),
            stiffness=self._force_scale * np.exp(drawn[:, -1]) if self._force is not None else np.zeros(len(drawn)),
            endless=np.full(len(drawn), spectrum.endless),
        )

    def jacobian(self, at: FloatArray, spectrum: Spectrum) -> FloatArray:
        """(m, k) of the residuals, by central differences, all in one pass."""
        step = 1e-4 * np.eye(len(at))
        both = self.residuals(np.concatenate([at + step, at - step]), spectrum)
        return np.asarray((both[: len(at)] - both[len(at) :]).T / 2e-4)

    def residuals(self, at: FloatArray, spectrum: Spectrum) -> FloatArray:
        """(d, m) of parameters (d, k): shares after the release, forces before it, then the priors' penalties."""
        share, force = self.simulated(at, spectrum)
        parts = [(self._amplitude[self._released :] - share) / self.sd]
        if self._force is not None:
            parts.append((self._force - force) / self._force_sd)
        size, (middle, spread) = self._size(spectrum), self._priors(spectrum)
        offset, between = at[:, size : size + 1], at[:, size + 1 : size + 2]
        parts += [(at[:, :size] - middle) / spread, offset / OFFSET_SD, (between - 0.5) / BETWEEN_SD]
        if self._has_set(at, spectrum):
            parts.append((at[:, size + 2 : size + 3] - np.log(SET_MEDIAN)) / SET_SPREAD)
        return np.concatenate(parts, axis=1)

    def simulated(self, at: FloatArray, spectrum: Spectrum) -> tuple[FloatArray, FloatArray]:
        """Shares (d, T - released) after the release, and forces (d, released - 1) before it, of parameters (d, k)."""
        released, count = self._released, len(self._time)
        strength, retarded = self._filters(at, spectrum)
        size = self._size(spectrum)
        offset, between = at[:, size, None], np.clip(at[:, size + 1], 0.0, 1.0)
        kept = np.exp(at[:, size + 2]) if self._has_set(at, spectrum) else np.zeros(len(at))
        most = self._most[released - 1]
        driven = self._amplitude - kept[:, None] * self._most  # (d, T) what is elastic or creeps
        force = driven[:, :released].copy()
        branch: FloatArray = np.zeros((len(at), spectrum.most))
        if spectrum.most:
            carried, branch = _driven(strength, retarded, np.diff(self._time[:released]), driven[:, :released])
            force -= carried
        after: FloatArray = np.empty((len(at), count - released))
        if count > released:
            gap = self._time[released] - self._time[released - 1]
            branch = _lifted(branch, force[:, -1], retarded, between * gap, gap)
            since = self._time[released:] - self._time[released]
            left = np.exp(-since[None, None, :] / retarded[:, :, None])
            after = np.einsum("db,dbt->dt", strength * branch, left)
        scale = np.exp(at[:, -1])[:, None] if self._force is not None else 1.0
        return after + kept[:, None] * most + offset, scale * np.maximum(force[:, 1:], 0.0)

    def _filters(self, at: FloatArray, spectrum: Spectrum) -> tuple[FloatArray, FloatArray]:
        """Strengths and retardation times (n, b) [s], these within their limits, of parameters (n, p)."""
        strength, retarded_s = spectrum.filters(at[:, : self._size(spectrum)])
        return strength, np.clip(retarded_s, *np.exp(self._limits))

    def _priors(self, spectrum: Spectrum) -> tuple[FloatArray, FloatArray]:
        """(k,) means and deviations of a spectrum's parameters: one Gaussian in place of a sum."""
        means, spread = spectrum.priors()
        return means.mean(axis=0), np.hypot(spread, means.std(axis=0))

    def _size(self, spectrum: Spectrum) -> int:
        return len(self._priors(spectrum)[0])

    def _has_set(self, at: FloatArray, spectrum: Spectrum) -> bool:
        return bool(at.shape[1] > self._size(spectrum) + 2 + (self._force is not None))


def _driven(
    strength: FloatArray, retarded: FloatArray, gap_s: FloatArray, amplitude: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(d, T) reduction of the force by branches (d, b) under a displacement (d, T) that is linear from frame to frame,
    `gap_s` (T - 1,) apart, each step exact; and (d, b) the branches at its end."""
    rate, mode, push = relaxation_modes(strength, retarded)
    turn = -rate * gap_s[:, None, None]
    first = np.expm1(turn) / turn
    before, rise = amplitude.T[:-1, :, None], np.diff(amplitude.T, axis=0)[..., None]
    more = gap_s[:, None, None] * push * (first * before + (first - 1.0) / turn * rise)
    left, state = np.exp(turn), np.zeros((len(gap_s) + 1, *strength.shape))
    for at in range(len(gap_s)):
        state[at + 1] = left[at] * state[at] + more[at]
    ended = np.einsum("dbm,dm->db", mode, state[-1]) / np.sqrt(strength * retarded)
    return np.einsum("tdm,dm->dt", state, push), ended


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
