"""Recovery of a body after its release: relaxing share of its modulus, relaxation time, and permanent set.

If all moduli of a body relax by the same share and Poisson's ratio is constant, its displacement has one shape, which
grows and shrinks with time (the correspondence principle: Lee 1955). Its share a(t) of the largest follows

    a(t) = f(t) + sum_i j_i E_i(t) + p max a,      dE_i/dt = (f - E_i) / l_i

with the force f as a share of the immediate force of the same dent. Each branch is a low-pass filter of the force, of
strength j_i and retardation time l_i (`stages.poke.creep`), and p the permanent share. While a tool prescribes a(t)
only a force shows f; once it is off f is 0, and the rest recovers by the branches' memory. Therefore a motion without
force is fitted by its recovery only, and one with force by its relaxation too, which shows the stiffness.

Models with zero to three branches, and with a spectrum that reaches no plateau (`stages.fit.creep_spectra`), each with
and without a set, are averaged by their evidence, as a touch's are (`stages.fit.relaxation`). A process that outlasts
the record is a reason, and a bound; a smaller probability of it opens intervals. Without a force, such a process
resembles a set.
"""

import dataclasses
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.results.render import ReportedResult, derived, reported
from deformscope.stages.fit import relaxation
from deformscope.stages.fit.creep_spectra import FASTEST, Spectrum, spectra
from deformscope.stages.fit.estimate import Doubt, LengthUnit

SET_MEDIAN, SET_SPREAD = 0.06, 1.0
"""Log-normal prior of the share that is kept: 1 to 40 % [assumed]."""
MOST_BRANCHES = 3
OPEN_RECOVERY = 0.13
"""The same as `relaxation.OPEN` for recoveries: chosen on pushes of a Maxwell solid, seeds 3000 to 3099, before they
shared the posterior of touches."""
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

RecoveryBehaviour = Literal["elastic", "viscous", "plastic", "viscoplastic", "unidentified"]
MOTION_ALONE = "unidentified: motion alone does not determine it; record a force with the images"


@dataclass(frozen=True, slots=True)
class Number:
    """A number and its interval."""

    value: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryEstimate(ReportedResult):
    """Results of a push and its recovery.

    share: share of the modulus that relaxes; time_s: mean relaxation time [s], each branch weighted by its share share
    and time_s are lower bounds, relaxed an upper bound, if a reason reports that the end was not recorded; their
    intervals are open in that direction from a smaller probability of it on (`OPEN_RECOVERY`)
    force_kept: remaining share of the force at the end of the push, held there, for times within the record
    set: permanent share of the largest displacement; instant, relaxed: force over displacement of the pressed
    particles, immediate and relaxed [N per unit]; None without a force
    verdict: "viscous" if more than 3 % relaxes, "plastic" if more is permanent, both, neither (elastic), or unknown
    reasons: reasons to doubt it; explained: share of the motion after the release (squares) that one shape explains
    held_s: time from the push to the release; watched_s: time after the release; released: first frame after the
    release; time: (T,) [s]; observed, simulated: (T,) share of the largest displacement, simulated from the release on
    unit, metres_per_unit: unit and scale of the displacements"""

    parameter: ClassVar[str] = "relaxing_share"

    share: Number = field(metadata=reported("share of the modulus that relaxes", flat=True, digits=".1%"))
    level: float = field(metadata=reported())
    verdict: RecoveryBehaviour = field(metadata=reported())
    reasons: tuple[Doubt, ...] = field(metadata=reported())
    explained: float = field(
        metadata=reported(
            "explained",
            words=lambda found: f"{max(found.explained, 0.0):.1%} of the motion by one shape that grows and shrinks",
        )
    )
    time_s: Number = field(metadata=reported("mean relaxation time", key="relaxation_time_s", shown_unit="s"))
    force_kept: tuple[relaxation.ForceKept, ...] = field(
        metadata=reported(
            "force, held in place", words=lambda found: "; ".join(map(str, (found.force_kept[0], found.force_kept[-1])))
        )
    )
    set: Number = field(metadata=reported("permanent set", key="permanent_set_share", digits=".1%"))

    @property
    @derived()
    def permanent_set_m(self) -> Number | None:
        """Permanent set of the push [m]."""
        metres = 1.0 if self.unit == "m" else self.metres_per_unit
        if metres is None:
            return None
        low, high = (metres * self.largest * end for end in self.set.interval)
        return Number(metres * self.largest * self.set.value, (low, high))

    instant: Number | None = field(
        metadata=reported("stiffness at once", key="instant_n_per_m", per_length=True, missing=MOTION_ALONE)
    )
    relaxed: Number | None = field(
        metadata=reported("stiffness, relaxed", key="relaxed_n_per_m", per_length=True, missing=MOTION_ALONE)
    )
    held_s: float = field(metadata=reported())
    watched_s: float = field(metadata=reported())
    released: int = field(metadata=reported(key="released_frame"))
    largest: float = field(metadata=reported("pressed", key=None, length=True))
    time: FloatArray = field(metadata=reported(key="recovery.time_s"))
    observed: FloatArray = field(metadata=reported(key="recovery.observed"))
    simulated: FloatArray = field(metadata=reported(key="recovery.simulated"))
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0
    settings: dict[str, object] = field(default_factory=dict, metadata=reported())


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

    Raises InputError if too little was recorded after the release, and no force before it."""
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
    law.widen()
    models = [(spectrum, kept) for spectrum in law.spectra for kept in (False, True)]
    fitted = [law.fitted(*one) for one in models]
    random = np.random.default_rng(seed)
    drawn, draws = relaxation.relaxation_posterior(
        [(one, fit) for (one, _), fit in zip(models, fitted, strict=True)], random
    )
    kept = np.concatenate([law.kept(one, with_set) for one, (_, with_set) in zip(drawn, models, strict=True)])
    stiffness = np.concatenate([law.stiffness(one) for one in drawn])
    watched_s, record_s, weight = law.watched_s, law.record_s, draws.weight
    seen = draws.seen(record_s, OPEN_RECOVERY)
    share, judged = seen.share, weight * (seen.within if not seen.reasons else 1.0)
    # a closed interval is of what relaxes within the record
    shared = judged if not seen.open else weight
    verdict = _verdict(share, kept, weight)
    mean_time = draws.time(judged, level)
    if not seen.reasons and verdict not in ("elastic", "plastic") and mean_time[1][1] > record_s:
        text = (
            f"the recovery takes {mean_time[0]:.2g} s (up to {mean_time[1][1]:.2g} s), and {watched_s:.2g} s were "
            "recorded after the release: a slow recovery and a permanent set look alike; record longer"
        )
        seen = dataclasses.replace(seen, reasons=(Doubt("short-record", text),))
    some = draws.some(random, FORCE_DRAWS)
    relaxed = _per_unit(stiffness * (1.0 - share), weight, largest, level)
    if seen.reasons or seen.open:
        relaxed = Number(relaxed.interval[1] if seen.reasons else relaxed.value, (0.0, relaxed.interval[1]))
    stays, (least, most) = relaxation.median_and_interval(kept, weight, level)
    unseen = weight * ~seen.within
    if (seen.reasons or seen.open) and unseen.any():  # a part of the set may be a slow recovery
        least = min(least, relaxation.median_and_interval(kept, unseen, level)[1][0])
    parts = np.split(weight, np.cumsum([len(one) for one in drawn])[:-1])
    middle = int(np.argmax([part.sum() for part in parts]))
    simulated = np.full(len(time_s), np.nan)
    simulated[released:] = law.simulated(fitted[middle].likeliest(), *models[middle])[0][0]
    return RecoveryEstimate(
        share=Number(*seen.bounded(*relaxation.median_and_interval(share, shared, level), 1.0)),
        time_s=Number(*seen.bounded(*mean_time, np.inf)),
        set=Number(stays, (least, most)),
        instant=_per_unit(stiffness, weight, largest, level) if force_n is not None else None,
        relaxed=relaxed if force_n is not None else None,
        verdict=verdict,
        level=level,
        reasons=seen.reasons,
        force_kept=relaxation.kept_of(some.strength, some.retarded_s, np.ones(FORCE_DRAWS), law.ramp_s, record_s),
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


def _per_unit(stiffness: FloatArray, weight: FloatArray, largest: float, level: float) -> Number:
    return Number(*relaxation.median_and_interval(stiffness / largest, weight, level))


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
    for released in tried:
        law = _RecoveryLaw(time_s, amplitude, int(released))
        off, free = law.off(law.spectra[1]), last + 1 - released
        likely.append(-0.5 * float(off @ off) - free * float(np.log(law.sd * np.sqrt(2.0 * np.pi))))
    return int(tried[int(np.argmax(likely))])


class _RecoveryLaw:
    """The law over one motion; parameters (k,): the error that all frames after the release share, the release's
    position between its two frames, log of the stiffness if a force was recorded, log of the permanent share if there
    is one, then those of a spectrum."""

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
        pressed = int(np.argmax(amplitude >= PRESSED * amplitude.max()))
        self.ramp_s = float(time_s[pressed] - time_s[_begin(amplitude)])
        self.watched_s = float(time_s[-1] - time_s[min(released, len(time_s) - 1)])
        held_s = float(time_s[released - 1] - time_s[pressed])
        self.record_s = max(self.watched_s, held_s if force_n is not None else 0.0)
        frame_s = float(np.median(np.diff(time_s)))
        self.spectra = spectra(max(self.ramp_s, frame_s / FASTEST), max(self.record_s, frame_s), MOST_BRANCHES)
        # neighbouring frames share no motion beyond a straight one
        bend = np.diff(amplitude[released:], 2)
        scatter = 1.4826 * float(np.median(np.abs(bend))) / np.sqrt(6.0) if len(bend) else 0.0
        self.sd = max(LEAST_SD, scatter)
        self._force = None
        if force_n is not None:
            most = float(np.max(force_n))
            self._force, self._force_scale = force_n[1:released] / most, most
            self._force_sd = np.hypot(FORCE_SD, force_sd_n / most)

    def off(self, spectrum: Spectrum) -> FloatArray:
        """(T - released,) residuals after the release at the likeliest parameters of a spectrum with a set."""
        (off,) = self._residuals(self.fitted(spectrum, True).likeliest(), spectrum, True)
        return np.asarray(off[: len(self._amplitude) - self._released])

    def widen(self) -> None:
        """Use the residual of the best fit of two branches as noise, shared by neighbours."""
        off = self.off(self.spectra[2])
        if len(off) <= self.spectra[2].size + self._own(True):
            return
        size = max(1.0, float(np.sqrt(np.mean(off**2))))
        alike = float(off[1:] @ off[:-1]) / max(float(off @ off), 1e-12)
        shared = np.sqrt((1.0 + np.clip(alike, 0.0, 0.9)) / (1.0 - np.clip(alike, 0.0, 0.9)))
        self.sd *= size * float(shared)

    def fitted(self, spectrum: Spectrum, kept: bool) -> relaxation.DrawnModel:
        """One spectrum with all choices of its nodes, with or without a set, as it is fitted."""
        mean, spread = spectrum.priors()
        force = self._force is not None
        own = [0.0, 0.5, *[0.0] * force, *[float(np.log(SET_MEDIAN))] * kept]
        own_spread = [OFFSET_SD, BETWEEN_SD, *[np.inf] * force, *[SET_SPREAD] * kept]
        return relaxation.DrawnModel(
            np.hstack([np.broadcast_to(own, (len(mean), len(own))), mean]),
            np.append(own_spread, spread),
            spectrum.prior,
            lambda some: self._residuals(some, spectrum, kept),
            lambda some: self._linear(some, spectrum, kept),
        )

    def kept(self, at: FloatArray, kept: bool) -> FloatArray:
        """(d,) permanent shares of parameters (d, k)."""
        return np.exp(at[:, self._own(kept) - 1]) if kept else np.zeros(len(at))

    def stiffness(self, at: FloatArray) -> FloatArray:
        """(d,) immediate forces of the largest displacement [N]."""
        return self._force_scale * np.exp(at[:, 2]) if self._force is not None else np.zeros(len(at))

    def _own(self, kept: bool) -> int:
        """Number of parameters before those of the spectrum."""
        return 2 + (self._force is not None) + kept

    def _linear(self, at: FloatArray, spectrum: Spectrum, kept: bool) -> tuple[FloatArray, FloatArray]:
        """(d, m) residuals of parameters (d, k), and their derivatives (d, k, m): central differences in one pass."""
        step = 1e-4 * np.eye(at.shape[1])
        near = (at[:, None, None] + np.stack([step, -step])).reshape(-1, at.shape[1])
        more, less = self._residuals(near, spectrum, kept).reshape(len(at), 2, at.shape[1], -1).swapaxes(0, 1)
        return self._residuals(at, spectrum, kept), (more - less) / 2e-4

    def _residuals(self, at: FloatArray, spectrum: Spectrum, kept: bool) -> FloatArray:
        """(d, m) of parameters (d, k): shares after the release, then forces before it, in their deviations."""
        share, force = self.simulated(at, spectrum, kept)
        parts = [(self._amplitude[self._released :] - share) / self.sd]
        if self._force is not None:
            parts.append((self._force - force) / self._force_sd)
        return np.concatenate(parts, axis=1)

    def simulated(self, at: FloatArray, spectrum: Spectrum, kept: bool) -> tuple[FloatArray, FloatArray]:
        """Shares (d, T - released) after the release, and forces (d, released - 1) before it, of parameters (d, k)."""
        released, count = self._released, len(self._time)
        strength, retarded = spectrum.filters(at[:, self._own(kept) :])
        offset, between, stays = at[:, :1], np.clip(at[:, 1], 0.0, 1.0), self.kept(at, kept)
        most = self._most[released - 1]
        driven = self._amplitude - stays[:, None] * self._most  # (d, T) what is elastic or creeps
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
        scale = np.exp(at[:, 2:3]) if self._force is not None else 1.0
        return after + stays[:, None] * most + offset, scale * np.maximum(force[:, 1:], 0.0)


def _driven(
    strength: FloatArray, retarded: FloatArray, gap_s: FloatArray, amplitude: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(d, T) reduction of the force by branches (d, b) under a displacement (d, T) that is linear from frame to frame,
    `gap_s` (T - 1,) apart, each step exact; and (d, b) the branches at its end."""
    rate, mode, push = relaxation.relaxation_modes(strength, retarded)
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
