"""Young's modulus from force over depth of a rigid tip: approach, loading, hold and unloading, with its interval.

The contact stage (`contact.fit_approach`) fits contact point and dent, by the law of the tip on the sample
(`tip_law`). What the curve alone does not show enters the interval: each cause with its share."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.results.render import ReportedResult, derived, reported
from deformscope.stages.fit.estimate import Doubt, Verdict, relative_verdict
from deformscope.stages.poke import contact
from deformscope.stages.poke.creep import CreepFit, cycle_loss, drift_rate, fit_creep
from deformscope.stages.poke.tip_law import Ground, Indenter, TipLaw
from deformscope.stages.regions.touches import LAW_SD

FEWEST, AIR = 20, 5
"""Fewest samples of a curve, and of free air."""
LENGTH, FORCE = 0.005, 3.0
"""A curve's dent and peak as the contact stage sees them [m, N]: its scales are a robot's, a curve may be of
nanonewtons."""
OWN_EXPONENT_SD = 0.02
"""Deviation of the exponent's prior, where the curve follows the law."""
LAW_OFF, CUTS = 0.04, (1.0, 0.75, 0.55, 0.4, 0.3)
"""It does as long as its exponent is within this share, and two deviations, of the law's; it is tried up to these
shares of the peak."""
MOST_OF_RADIUS, MOST_OF_LAYER, MOST_DEPTH_M = 0.3, 0.2, 0.1
"""Deepest dents that the law of small strain is fitted to, over the tip's radius and over a layer's thickness: Hertz's
law holds within some 3 % up to 0.3 radii (Lin et al. 2009, Biomech. Model. Mechanobiol. 8, 345). Deeper ones than the
last [m] are taken to be of another unit."""
FAR = 2.0
"""Way in free air, over that from contact on, beyond which a curve is not used."""
BENDS = 0.25
"""Log of the force over the law's at twice the fitted dent, from which the sample bends; elastic ones under a sphere
stay below."""
TRIMS = 6
"""How often, at most, what is deeper is cut off and contact found again."""
PLATEAU = 1.15
"""Depth over that at which the law has the largest force, from which a curve has a plateau."""
POISSONS, DRAWS = 5, 4000
"""Values of Poisson's ratio, where it is a range; draws of an interval."""
HELD, LONG, BEGUN, POKED, CREEPS = 0.01, 0.1, 0.02, 0.3, 0.3
"""Share of depth or force within which a tip holds; least duration of a hold over that of the loading; shares of the
peak below which the tip is taken to be free, and beyond which it pokes; largest speed of a tip that holds over that of
the loading."""
RISES = 0.2
"""Rate of the first samples over the loading's mean rate, from which they are in contact."""
NAMED, DRIFT_SD = 0.02, 0.01
"""Share of the peak from which adhesion and drift are named; five times as much leaves `weak`. Deviation of a drift
that no free air shows [assumed]."""
BACK, BACK_EXPONENT_SD = 0.4, 0.3
"""Share of the force down to which an unloading is fitted, and the deviation of its exponent, which is 1.2 to 1.6 for
many tips (Oliver and Pharr 1992, Journal of Materials Research 7, 1564)."""
CREEPS_N, CREEPS_M = (0.1, 100.0), (2e-4, 0.05)
"""Forces and dents of the foams that the relaxation's priors are of."""
FREE_SIDES = 0.1
"""Largest share of the force that a sample may lack for its free sides."""
OWN = ("contact and noise", "drift", "adhesion")
"""Causes of an interval that are of one curve alone."""

_DOWN = np.array([0.0, 0.0, 1.0])
_kpa = partial(reported, scale=1e-3, shown_unit="kPa", digits=".4g")
_mm = partial(reported, scale=1e3, shown_unit="mm", digits=".4g")


@dataclass(frozen=True, slots=True)
class IndentCurve:
    """One poke. depth_m, force_n: (n,) way into the sample, from any zero [m], and force on the tip [N], above 0 where
    it presses, in the order measured; time_s: (n,) rising, None = not known; name: its source"""

    depth_m: FloatArray
    force_n: FloatArray
    time_s: FloatArray | None = None
    name: str = ""


@dataclass(frozen=True, slots=True)
class IndentSample:
    """A sample, and what pokes it.

    thickness_m, ground: thickness of a layer and what is under it, None = a half-space; poisson: range of Poisson's
    ratio; width_m: smallest width, None = wide; machine_n_per_mm: stiffness of machine, arm or cantilever, None = rigid
    tip_sd, thickness_sd, gain_sd, machine_sd: deviations of the tip's size, thickness, force's gain and machine's
    stiffness, as shares"""

    tip: Indenter
    thickness_m: float | None = None
    ground: Ground = "half-space"
    poisson: tuple[float, float] = (0.0, 0.5)
    width_m: float | None = None
    machine_n_per_mm: float | None = None
    tip_sd: float = 0.005
    thickness_sd: float = 0.02
    gain_sd: float = 0.01
    machine_sd: float = 0.05

    def law(self, deepest_m: float, poisson: float, *, tip: float = 1.0, thickness: float = 1.0) -> TipLaw:
        """Force over depth for a Poisson's ratio; tip, thickness: factors of their sizes."""
        thickness_m = None if self.thickness_m is None else thickness * self.thickness_m
        return TipLaw(self.tip.scaled(tip), deepest_m, thickness_m, self.ground, poisson)

    @property
    def limit_m(self) -> float:
        """Deepest dent of small strain [m]."""
        layer_m = np.inf if self.thickness_m is None else MOST_OF_LAYER * self.thickness_m
        return float(min(layer_m, MOST_OF_RADIUS * self.tip.radius_m))

    def free_sides(self, radius_m: float) -> float:
        """Share of the force that it lacks for its free sides, at most, for a radius of the contact [m]: a bound on
        finite elements of cylinders under a disc, 1 to 10 radii thick, Poisson's ratio 0 to 0.49, on either ground."""
        if self.width_m is None:
            return 0.0
        thickness = (self.thickness_m or self.width_m) / radius_m
        return (0.45 + 0.3 * thickness) / (0.5 * self.width_m / radius_m) ** 2


@dataclass(frozen=True, slots=True)
class ModulusShare:
    """A cause of the interval. sd: deviation of the log of the modulus"""

    cause: str = field(metadata=reported())
    sd: float = field(metadata=reported())


@dataclass(frozen=True, slots=True, kw_only=True)
class IndentEstimate(ReportedResult):
    """A sample's modulus from one poke; every interval holds 90 %.

    modulus_pa: Young's modulus E; plane_pa: E / (1 - nu^2), which a curve on a half-space determines without nu;
    half_space_pa: E by the law of a half-space; unloading_pa: E by the slope at which the unloading begins (Oliver and
    Pharr 1992), None without one; contact_m: depth at which contact began; depth_m: dent up to which the law was
    fitted, stiffness_n_per_mm: slope of the law there; deepest_m, peak_force_n: deepest dent, largest force
    loss: energy that the cycle lost over that of the way in; held_s, force_kept: duration of a hold, and the force at
    its end over that at its begin; creep: relaxation under a sphere that held; rate_n_per_s: fastest rise of the force
    pull_off_n: largest pull on the tip, None if there is none; adhesion_j_per_m2: work of adhesion of a sphere by that
    pull (Johnson, Kendall and Roberts 1971: W = 2 F / (3 pi R)); drift_n_per_s: drift of the force in free air
    shares: causes of the interval; log_sd: deviation of log E due to this curve alone
    along_m, force_n, law_n: (n,) depth since contact, force, and force by the law"""

    name: str = field(metadata=reported("curve"))
    modulus_pa: float = field(metadata=_kpa("Young's modulus", interval="modulus_interval_pa"))
    modulus_interval_pa: tuple[float, float] = field(metadata=reported())
    verdict: Verdict = field(metadata=reported("verdict"))
    reasons: tuple[Doubt, ...] = field(
        metadata=reported("reasons", words=lambda found: "; ".join(f"{one.code}: {one.text}" for one in found.reasons))
    )
    plane_pa: float = field(metadata=_kpa("E / (1 - nu^2)", interval="plane_interval_pa"))
    plane_interval_pa: tuple[float, float] = field(metadata=reported())
    half_space_pa: float = field(metadata=_kpa("E by a half-space's law"))
    unloading_pa: float | None = field(metadata=_kpa("E by the unloading's slope"))
    contact_m: float = field(metadata=_mm("contact at", interval="contact_interval_m"))
    contact_interval_m: tuple[float, float] = field(metadata=reported())
    depth_m: float = field(metadata=_mm("law fitted up to"))
    deepest_m: float = field(metadata=_mm("deepest"))
    peak_force_n: float = field(metadata=reported("peak force", shown_unit="N"))
    stiffness_n_per_mm: float = field(metadata=reported("slope of the law there", shown_unit="N/mm"))
    loss: float | None = field(metadata=reported("energy lost", digits=".0%"))
    held_s: float = field(metadata=reported())
    force_kept: float | None = field(metadata=reported("force left after the hold", digits=".1%"))
    pull_off_n: float | None = field(metadata=reported("pull-off", shown_unit="N"))
    adhesion_j_per_m2: float | None = field(metadata=reported("work of adhesion", shown_unit="J/m^2"))
    drift_n_per_s: float | None = field(metadata=reported("drift of the force", digits=".2g", shown_unit="N/s"))
    rate_n_per_s: float | None = field(metadata=reported("fastest rise", shown_unit="N/s"))
    shares: tuple[ModulusShare, ...] = field(
        metadata=reported("interval, by cause", words=lambda found: shares_text(found.shares))
    )
    log_sd: float = field(metadata=reported(key="own_log_sd"))
    along_m: FloatArray = field(metadata=reported(key="curve.depth_m"))
    force_n: FloatArray = field(metadata=reported(key="curve.force_n"))
    law_n: FloatArray = field(metadata=reported(key="curve.law_n"))
    creep: CreepFit | None = None

    @property
    @derived("relaxation")
    def creep_text(self) -> str | None:
        """The sample's creep in the hold, as text."""
        return None if self.creep is None else self.creep.text


def shares_text(shares: Sequence[ModulusShare]) -> str:
    """Causes of an interval, the largest first."""
    ordered = sorted((one for one in shares if one.sd >= 5e-4), key=lambda one: -one.sd)
    return ", ".join(f"{one.cause} {one.sd:.1%}" for one in ordered)


class SplitCurve:
    """A curve with its parts: air and loading up to sample `loaded`, a hold up to `held`, the unloading up to
    `released`, then air. force_n: (n,) zero and drift taken off; depth_m: (n,) the machine's give taken off"""

    def __init__(self, curve: IndentCurve, sample: IndentSample) -> None:
        self.sample = sample
        self.given_m, self.force_n, self.time_s = _checked(curve)
        self.softness = 0.0 if sample.machine_n_per_mm is None else 1e-3 / sample.machine_n_per_mm
        smooth = smoothed(self.force_n)
        self.peak_n, top = float(smooth.max()), int(np.argmax(smooth))
        below = np.flatnonzero(smooth[:top] < max(BEGUN * self.peak_n, 3.0 * _scatter(self.force_n)))
        self.began = int(below[-1]) + 1 if len(below) else 0
        self.noise_n = max(_scatter(self.force_n), 1e-4 * self.peak_n)
        if not self.peak_n > 10.0 * self.noise_n:
            expected, came = f"a force well above its noise of {self.noise_n:.2g} N", f"{self.peak_n:.2g} N at most"
            raise InputError(expected, came, "a curve that touches the sample", curve.name)
        self._split(smooth)
        pressed = smooth > max(POKED * self.peak_n, 4.0 * self.noise_n)
        known = pressed | (smooth < max(BEGUN * self.peak_n, 3.0 * self.noise_n))
        if (pokes := int((np.diff(pressed[known].astype(np.int64), prepend=0) > 0).sum())) > 1:
            raise InputError("one poke in a curve", f"{pokes}", "a file of each, with its tip", curve.name)
        self.rate_n_per_s: float | None = None
        self.drift_n, self.drift_sd_n = self._drift()
        self.depth_m = self.given_m - self.softness * self.force_n
        if sample.machine_n_per_mm is not None and self.depth_m[self.loaded - 1] <= self.depth_m[self.began]:
            expected, came = "a machine stiffer than the curve", f"{sample.machine_n_per_mm:.3g} N/mm"
            raise InputError(expected, came, "--machine-n-per-mm of the machine alone", curve.name)
        self.travel_m = float(np.ptp(self.depth_m[self.began : self.held]))
        # a curve that begins in contact is low there without a pull
        pull = -float(min(smooth[min(AIR, self.began) : self.loaded].min(), smooth[self.held - 1 :].min()))
        self.pull_n = pull if pull > max(4.0 * self.noise_n, NAMED * self.peak_n) else 0.0
        scatter = max(_scatter(self.given_m[self.began : self.loaded]), 2e-4 * self.travel_m)
        self.machine = contact.ArmCompliance(0.0, sample.machine_sd * self.softness, scatter)

    def _split(self, smooth: FloatArray) -> None:
        top_m = float(self.given_m.max())
        deep = self.given_m >= top_m - HELD * (top_m - self.given_m[self.began])
        took = 0
        for near in (deep | (smooth >= (1.0 - HELD) * self.peak_n), deep):
            at = np.flatnonzero(near & (smooth > 0.2 * self.peak_n))
            self.loaded, self.held = int(at[0]) + 1, int(at[-1]) + 1
            way, took = float(np.ptp(self.given_m[self.loaded - 1 : self.held])), self.held - self.loaded
            # on a plateau the force stays while the tip goes on as fast as before
            if way * (self.loaded - self.began) <= CREEPS * (top_m - self.given_m[self.began]) * took:
                break
        if took < max(LONG * (self.loaded - self.began), 2 * AIR):
            self.loaded = self.held = int(np.argmax(smooth if near is not deep else self.given_m)) + 1
        free = smooth[self.held :] < max(BEGUN * self.peak_n, 3.0 * self.noise_n)
        free |= self.given_m[self.held :] < self.given_m[self.began]
        self.released = self.held + int(np.argmax(free)) if free.any() else len(smooth)

    def _drift(self) -> tuple[float, float]:
        """Drift of the force from first contact to peak, which is taken off, and its deviation [N]: by the free air on
        both sides, else by that before contact."""
        at = np.arange(len(self.force_n), dtype=np.float64) if self.time_s is None else self.time_s
        # where the force of a cone is seen, it has touched for a while
        hidden = max(float(smoothed(self.force_n)[self.began]) / self.peak_n, 0.0) ** (
            1.0 / contact.EXPONENT[self.sample.tip.kind]
        )
        top_m, began_m = float(self.given_m[self.loaded - 1]), float(self.given_m[self.began])
        free = self.given_m < began_m - 1.3 * (top_m - began_m) * hidden / (1.0 - min(hidden, 0.9))
        before, after = np.flatnonzero(free[: self.began]), self.released + np.flatnonzero(free[self.released :])
        took = float(at[self.loaded - 1] - at[self.began])
        usual_n = DRIFT_SD * self.peak_n
        rate = rate_sd = np.nan
        if len(before) >= 4 * AIR:
            away = at[before] - at[before].mean()
            rate = float(away @ self.force_n[before] / (away @ away))
            rate_sd = self.noise_n / float(np.sqrt(away @ away))
        if len(before) >= AIR <= len(after):
            _, both, both_sd = drift_rate(at, self.force_n, before, after, self.noise_n)
            if not abs(both - rate) > 4.0 * np.hypot(both_sd, rate_sd):  # else the tip drags, or keeps something
                rate, rate_sd = both, both_sd
        if np.isnan(rate):
            return 0.0, usual_n
        self.rate_n_per_s = None if self.time_s is None else rate
        if abs(rate) < 4.0 * rate_sd:
            return 0.0, min(rate_sd * took, usual_n)
        self.force_n = self.force_n - rate * (at - at[before].mean())
        return rate * took, max(rate_sd, 0.2 * abs(rate)) * took

    def far(self) -> int:
        """Samples at the begin that are far from the sample, where zero and drift are others than near it."""
        return int(np.argmax(self.given_m > self.given_m[self.began] - FAR * self.travel_m))

    def law(self, poisson: float) -> TipLaw:
        """The tip's law, up to the deepest dent that it is fitted to."""
        return self.sample.law(min(1.2 * self.travel_m, 2.0 * self.sample.limit_m), poisson)

    def fit(self, upto: int, exponent_sd: float, law: TipLaw) -> contact.ContactFit:
        """The contact stage on the loading up to a sample."""
        return self._fit(self.depth_m[:upto], self.force_n[:upto], exponent_sd, contact.LOADED, law)

    def _fit(
        self, depth_m: FloatArray, force_n: FloatArray, exponent_sd: float, least: float, law: TipLaw | None
    ) -> contact.ContactFit:
        """The contact stage, in scales of the curve; without a law, a power law."""
        scale_m, scale_n = self.scale
        soft_sd = self.machine.compliance_sd * scale_n / scale_m
        return contact.fit_approach(
            np.arange(len(depth_m), dtype=np.float64),
            -depth_m[:, None] / scale_m * _DOWN,
            force_n[:, None] / scale_n * _DOWN,
            _DOWN,
            tip=self.sample.tip.kind,
            set_force_n=float(force_n.max()) / scale_n,
            arm=contact.ArmCompliance(0.0, soft_sd, self.machine.position_sd_m / scale_m),
            force_sd_n=self.noise_n / scale_n,
            exponent_sd=exponent_sd,
            least_share=least,
            dents=contact.power_law if law is None else partial(law.dents, scale_m=scale_m),
        )

    @property
    def scale(self) -> tuple[float, float]:
        """A metre and a newton of the contact stage [m, N]."""
        return self.travel_m / LENGTH, self.peak_n / FORCE

    def dent_m(self, fit: contact.ContactFit) -> float:
        """Dent of a fit [m]."""
        return fit.depth_m * self.scale[0]

    def plane_pa(self, fit: contact.ContactFit, law: TipLaw) -> float:
        """E* of a fit [Pa]."""
        return fit.at_force_n * self.scale[1] / float(law.response(self.dent_m(fit)))

    def within_law(self) -> tuple[int, float, list[Doubt]]:
        """Sample up to which the loading follows the law of small strain, the deviation of the exponent there, and what
        was left out."""
        law, whole, reasons = self.law(0.5 * sum(self.sample.poisson)), self.loaded, list[Doubt]()
        limit_m, found = self.sample.limit_m, self.fit(whole, contact.EXPONENT_SD, law)
        for _ in range(TRIMS):  # contact is found too deep with what does not follow the law
            deep = self.depth_m[:whole] > found.contact_m * self.scale[0] + limit_m
            at = max(int(np.argmax(deep)), self.began + FEWEST)
            if not deep.any() or self.dent_m(found) <= limit_m or at >= whole:
                break
            whole, found = at, self.fit(at, contact.EXPONENT_SD, law)
        if whole != self.loaded:
            text = f"dents beyond {1e3 * limit_m:.3g} mm are left out: the law is of small strain"
            reasons.append(Doubt("large-strain", text))
        upto, follows, loading = whole, False, self.force_n[:whole]
        for cut in CUTS:
            at = whole if cut == 1.0 else int(np.argmax(loading >= cut * loading.max())) + 1
            if cut < 1.0 and at - self.began < FEWEST:
                break
            upto, found = at, self.fit(at, contact.EXPONENT_SD, law)
            follows = abs(found.exponent - law.exponent) < LAW_OFF * law.exponent + 2.0 * found.exponent_sd
            if follows:
                break
        dent_m = self.dent_m(found)
        if (
            upto == whole == self.loaded
            and self.depth_m[:whole].max() > found.contact_m * self.scale[0] + PLATEAU * dent_m
        ):
            text = f"a plateau: the force hardly rises beyond a depth of {1e3 * dent_m:.3g} mm, where it leaves the law"
            reasons.append(Doubt("large-strain", text))
        if upto != whole or not follows:
            text = f"the curve leaves the law of a {self.sample.tip} at a depth of {1e3 * dent_m:.3g} mm"
            reasons.append(Doubt("large-strain", text, None if follows else "weak"))
        return upto, OWN_EXPONENT_SD if follows else contact.EXPONENT_SD, reasons

    def bend(self, fit: contact.ContactFit, law: TipLaw) -> float:
        """Log of the force over the law's at twice the fitted dent, 0 where it is small or not known: a sample that
        stiffens looks like a stiff one that is touched later, all the more as noise hides how it begins."""
        contact_m, dent_m = fit.contact_m * self.scale[0], self.dent_m(fit)
        deeper = np.flatnonzero(self.depth_m[: self.loaded] > contact_m + 2.0 * dent_m)
        if not len(deeper):
            return 0.0
        over_pa = smoothed(self.force_n)[deeper[0]] / self.plane_pa(fit, law)
        off = float(np.log(max(over_pa / law.response(2.0 * dent_m), 0.1)))
        return off if off > BENDS else 0.0

    def reasons(self) -> list[Doubt]:
        """What the curve shows besides the law."""
        pull, drift = self.pull_n / self.peak_n, abs(self.drift_n) / self.peak_n
        text = f"the tip is pulled with {pull:.0%} of the largest force: surfaces that stick make small dents deeper"
        found = [Doubt("adhesion", text, "weak" if pull > 5.0 * NAMED else None)] if pull else []
        if drift > NAMED:
            text = f"the force drifted by {drift:.0%} of its peak during the loading, which is taken off"
            found.append(Doubt("force-drift", text, "weak" if drift > 5.0 * NAMED else None))
        rise = float(np.median(self.force_n[AIR : 2 * AIR]) - np.median(self.force_n[:AIR]))
        touched = rise > max(4.0 * self.noise_n, RISES * AIR * self.peak_n / self.loaded)
        if self.began < AIR or touched:
            few = "begins in contact" if touched or not self.began else f"has {self.began} samples before contact"
            text = f"the curve {few}: neither where that is nor the force's zero is seen"
            found.append(Doubt("short-record", text, "unidentified" if "begins" in few else "weak"))
        return found

    def shares(self, fit: contact.ContactFit, law: TipLaw, bend: float) -> tuple[ModulusShare, ...]:
        """Deviations of log E*, by their causes. bend: see `bend`"""
        sample, dent_m, steep = self.sample, self.dent_m(fit), law.steepness(self.dent_m(fit))
        bent_m = self.machine.compliance_sd * fit.at_force_n * self.scale[1]
        own_m = float(np.sqrt(max((fit.depth_sd_m * self.scale[0]) ** 2 - bent_m**2, 0.0)))

        strained = dent_m / sample.limit_m
        if sample.tip.kind == "cone":  # its strain is that of a sphere with the same slope at the contact's edge
            strained = 1.0 / np.tan(np.radians(sample.tip.size[0])) / MOST_OF_RADIUS**0.5

        def follows(**factor: float) -> float:
            other = sample.law(law.deepest_m, law.poisson, **factor)
            return abs(float(np.log(other.response(dent_m) / law.response(dent_m))))

        every = {
            "contact and noise": steep * own_m / dent_m,
            "machine": steep * bent_m / dent_m,
            "tip": follows(tip=1.0 + sample.tip_sd),
            "thickness": follows(thickness=1.0 + sample.thickness_sd) if sample.thickness_m else 0.0,
            "force gain": sample.gain_sd,
            "drift": self.drift_sd_n / self.peak_n,
            "adhesion": 0.5 * self.pull_n / self.peak_n,
            "law": float(np.linalg.norm([LAW_SD * min(strained, 1.0), fit.exponent / law.exponent - 1.0, bend])),
        }
        return tuple(ModulusShare(cause, sd) for cause, sd in every.items())

    def unloading_pa(self, contact_m: float, law: TipLaw) -> float | None:
        """E* by the slope with which the unloading begins, over that of the law at the same depth, which is 2 a E* for
        any round tip on a half-space."""
        deep_m = float(self.depth_m[self.held - 1]) - contact_m
        if self.released - self.held < 2 * AIR or deep_m <= 0.0:
            return None
        depth_m, force_n = (one[self.held - 1 : self.released][::-1] for one in (self.depth_m, self.force_n))
        air = np.zeros(2 * AIR)
        try:
            depth_m, force_n = np.append(air + depth_m[0], depth_m), np.append(air, force_n)
            back = self._fit(depth_m, force_n, BACK_EXPONENT_SD, BACK, None)
        except InputError:
            return None
        slope = back.exponent * back.at_force_n * self.scale[1] / self.dent_m(back)
        return slope * deep_m / (float(law.response(deep_m)) * law.steepness(deep_m))

    def creep(self) -> CreepFit | None:
        """Relaxation under a sphere that held, of foams."""
        is_foam = CREEPS_N[0] < self.peak_n < CREEPS_N[1] and CREEPS_M[0] < self.travel_m < CREEPS_M[1]
        if self.time_s is None or self.held == self.loaded or self.sample.tip.kind != "sphere" or not is_foam:
            return None
        try:
            return fit_creep(
                self.time_s,
                -self.depth_m[:, None] * _DOWN,
                self.force_n[:, None] * _DOWN,
                _DOWN,
                loading=self.loaded,
                held=self.held,
                set_force_n=float(self.force_n[: self.loaded].max()),
                arm=self.machine,
                radius_m=self.sample.tip.radius_m,
            )
        except InputError:
            return None


def fit_indentation(curve: IndentCurve, sample: IndentSample, *, creep: bool = True) -> IndentEstimate:
    """The modulus of a sample by one poke. Raises InputError for a curve that does not touch, of a wrong sign or unit,
    and for a tip that the sample has no room for. creep: fit the relaxation of a hold too"""
    poke = SplitCurve(curve, sample)
    if far := poke.far():
        time_s = None if poke.time_s is None else poke.time_s[far:]
        poke = SplitCurve(IndentCurve(poke.given_m[far:], poke.force_n[far:], time_s, curve.name), sample)
    if poke.travel_m > (most_m := min(MOST_DEPTH_M, sample.thickness_m or np.inf)):
        expected, hint = f"dents of less than {1e3 * most_m:.4g} mm", "the unit of depth (--depth-column NAME=mm)"
        raise InputError(expected, f"{1e3 * poke.travel_m:.4g} mm", hint, curve.name)
    upto, exponent_sd, reasons = poke.within_law()
    reasons += poke.reasons()
    low, high = sample.poisson
    ratios = np.linspace(low, high, POISSONS if high > low and sample.ground == "bonded" else 1)
    laws = [poke.law(float(nu)) for nu in ratios]  # E* depends on nu where the ground holds the layer
    fits = [poke.fit(upto, exponent_sd, law) for law in laws]
    plane = np.array([poke.plane_pa(one, law) for one, law in zip(fits, laws, strict=True)])
    fit, law, middle = fits[len(fits) // 2], laws[len(fits) // 2], 1.0 - (0.5 * (low + high)) ** 2
    dent_m, contact_m = poke.dent_m(fit), fit.contact_m * poke.scale[0]
    radius_m = sample.tip.contact_radius_m(dent_m)
    if sample.width_m is not None and (lacks := sample.free_sides(radius_m)) > FREE_SIDES:
        expected = f"sides far from the contact, which is {2e3 * radius_m:.3g} mm wide"
        came = f"a sample {1e3 * sample.width_m:.4g} mm wide, which lacks up to {min(lacks, 1.0):.0%} of the force"
        raise InputError(expected, came, "a smaller tip, or a shallower dent", curve.name)
    if bend := poke.bend(fit, law):
        text = f"at twice {1e3 * dent_m:.3g} mm the force is {np.exp(bend):.2g} times the law's: the sample stiffens"
        reasons.append(Doubt("large-strain", text, "weak"))
    shares = poke.shares(fit, law, bend)
    nu = np.linspace(low, high, POISSONS)  # a range: the interval holds whichever it is
    plane_log = np.interp(nu, ratios, np.log(plane))
    young_log = plane_log + np.log1p(-(nu**2))
    random = np.random.default_rng(0)
    error = float(np.linalg.norm([one.sd for one in shares])) * random.standard_normal(DRAWS)
    ratio = np.log(friction_ratio(nu, radius_m / (sample.thickness_m or np.inf)))
    stuck, sides = random.uniform(size=DRAWS) * ratio.mean(), -float(np.log1p(-sample.free_sides(radius_m)))
    ends = float(np.quantile(error - stuck, 0.05)), float(np.quantile(error, 0.95)) + sides
    (value, interval), (plane_pa, plane_interval) = (
        (float(np.exp(one[POISSONS // 2])), (float(np.exp(one.min() + ends[0])), float(np.exp(one.max() + ends[1]))))
        for one in (young_log, plane_log)
    )
    half_space = TipLaw(sample.tip, law.deepest_m)
    unloading = poke.unloading_pa(contact_m, law)
    dents = np.maximum(poke.depth_m - contact_m, 0.0)
    times, loading, smooth = poke.time_s, slice(poke.began, poke.loaded), smoothed(poke.force_n)
    sphere_m = sample.tip.radius_m if sample.tip.kind == "sphere" else None
    around_m = contact.Z_90 * fit.contact_sd_m * poke.scale[0]
    return IndentEstimate(
        name=curve.name,
        modulus_pa=value,
        modulus_interval_pa=interval,
        verdict=relative_verdict(value, interval, reasons),
        reasons=tuple(reasons),
        plane_pa=plane_pa,
        plane_interval_pa=plane_interval,
        half_space_pa=poke.plane_pa(poke.fit(upto, exponent_sd, half_space), half_space) * middle,
        unloading_pa=None if unloading is None else unloading * middle,
        contact_m=contact_m,
        contact_interval_m=(contact_m - around_m, contact_m + around_m),
        depth_m=dent_m,
        deepest_m=float(dents.max()),
        peak_force_n=poke.peak_n,
        stiffness_n_per_mm=1e-3 * fit.at_force_n * poke.scale[1] / dent_m * law.steepness(dent_m),
        loss=cycle_loss(poke.depth_m, poke.force_n, poke.held, poke.machine, poke.noise_n)[0],
        held_s=0.0 if times is None else float(times[poke.held - 1] - times[poke.loaded - 1]),
        force_kept=float(smooth[poke.held - 1] / smooth[poke.loaded - 1]) if poke.held > poke.loaded else None,
        pull_off_n=poke.pull_n or None,
        adhesion_j_per_m2=2.0 * poke.pull_n / (3.0 * np.pi * sphere_m) if sphere_m and poke.pull_n else None,
        drift_n_per_s=poke.rate_n_per_s,
        rate_n_per_s=None
        if times is None
        else contact.peak_rate(times[loading], poke.force_n[loading], poke.noise_n)[0],
        shares=(
            *shares,
            ModulusShare("Poisson's ratio", 0.5 * float(np.ptp(young_log))),
            ModulusShare("friction", float(stuck.std())),
            ModulusShare("free sides (upper end alone)", sides),
        ),
        log_sd=float(np.linalg.norm([one.sd for one in shares if one.cause in OWN])),
        along_m=poke.depth_m - contact_m,
        force_n=poke.force_n,
        law_n=law.response(dents) * plane[len(fits) // 2] * (dents > 0.0),
        creep=poke.creep() if creep else None,
    )


def friction_ratio(poisson: FloatArray, over_thickness: float = 0.0) -> FloatArray:
    """Force on a tip to which the surface sticks, over that without friction, for Poisson's ratios (n,): of a flat disc
    on a half-space (Spence 1968, Proc. R. Soc. A 305, 55). On a layer 1 / over_thickness contact radii thick, nearly
    incompressible material adds to it (a bound on finite elements, 0.5 to 3 radii)."""
    left = np.maximum(1.0 - 2.0 * poisson, 1e-9)
    thin = 0.075 * over_thickness**2 * np.maximum(poisson - 0.4, 0.0) / 0.09
    return np.asarray((1.0 - poisson) * np.log1p(2.0 * left) / left + thin)


def smoothed(values: FloatArray) -> FloatArray:
    """(n,) mean of five samples."""
    return np.convolve(np.pad(values, 2, mode="edge"), np.full(5, 0.2), mode="valid")


def _scatter(values: FloatArray) -> float:
    """Deviation of one sample of a smooth curve (n,)."""
    return float(np.median(np.abs(np.diff(values, 2)))) / (0.6745 * np.sqrt(6.0)) if len(values) > 2 else 0.0


def _checked(curve: IndentCurve) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Depth, force without its zero, and time of a curve (n,); samples that are no numbers are left out."""
    depth_m, force_n, time_s = curve.depth_m, curve.force_n, curve.time_s
    if depth_m.shape != force_n.shape or depth_m.ndim != 1 or (time_s is not None and time_s.shape != depth_m.shape):
        raise InputError("as many forces as depths (n,)", f"{force_n.shape} and {depth_m.shape}", where=curve.name)
    good: BoolArray = np.isfinite(depth_m) & np.isfinite(force_n)
    if time_s is not None:
        good &= np.isfinite(time_s)
        good[good] = np.diff(np.maximum.accumulate(time_s[good]), prepend=-np.inf) > 0.0
    if good.sum() < FEWEST:
        raise InputError(f"{FEWEST} samples or more", f"{good.sum()}", where=curve.name)
    depth_m, force_n = depth_m[good], force_n[good]
    if not (np.ptp(depth_m) > 0.0 and np.ptp(force_n) > 0.0):
        raise InputError("a depth and a force that change", "a constant one", where=curve.name)
    few = max(AIR, len(force_n) // 20)
    first, last = np.array_split(force_n[:few], 3), float(np.median(force_n[-few:]))
    zero, began, ended = (float(np.median(part)) for part in (force_n[:few], first[0], first[-1]))
    if ended - began > 4.0 * _scatter(force_n) and last < began:  # begun in contact, and let go
        zero = last
    force_n = force_n - zero
    smooth = smoothed(force_n)
    if -smooth.min() > 2.0 * smooth.max():
        came, hint = f"{smooth.min():.3g} N", "a minus before the column (--force-column=-NAME)"
        if depth_m[int(np.argmin(smooth))] < depth_m[0]:
            hint = "the way in too, with air before it"
        raise InputError("a force above 0 where the tip presses", came, hint, curve.name)
    if depth_m[int(np.argmax(smooth))] <= depth_m[0]:
        came, hint = "one that falls as the force rises", "a minus before the column (--depth-column=-NAME)"
        raise InputError("a depth that grows into the sample", came, hint, curve.name)
    return depth_m, force_n, None if time_s is None else time_s[good]


@dataclass(frozen=True, slots=True, kw_only=True)
class IndentSummary(ReportedResult):
    """Several pokes of one sample together; the interval holds 90 %, of the mean over the sample.

    curves: number of pokes; scatter: deviation of log E from poke to poke beyond what their own errors explain;
    own_sd: median of these errors"""

    curves: int = field(metadata=reported("curves", digits=".0f"))
    modulus_pa: float = field(metadata=_kpa("Young's modulus", interval="modulus_interval_pa"))
    modulus_interval_pa: tuple[float, float] = field(metadata=reported())
    verdict: Verdict = field(metadata=reported("verdict"))
    scatter: float = field(metadata=reported("scatter between places", digits=".1%"))
    own_sd: float = field(metadata=reported("error of one curve alone", digits=".1%"))


def combine(estimates: Sequence[IndentEstimate]) -> IndentSummary:
    """One sample by several pokes: random effects (DerSimonian and Laird 1986) on log E; errors that all pokes share
    are not averaged."""
    log, own = np.log([one.modulus_pa for one in estimates]), np.maximum([one.log_sd for one in estimates], 1e-4)
    weight = own**-2
    off2 = float(weight @ (log - weight @ log / weight.sum()) ** 2) - (len(log) - 1)
    scatter2 = max(off2 / max(weight.sum() - (weight**2).sum() / weight.sum(), 1e-12), 0.0) if len(log) > 1 else 0.0
    weight = 1.0 / (own**2 + scatter2)
    mean, sd2 = float(weight @ log / weight.sum()), float(1.0 / weight.sum())
    best = estimates[int(np.argmin(own))]
    common = np.abs(np.log(np.array(best.modulus_interval_pa) / best.modulus_pa)) / contact.Z_90
    low, high = contact.Z_90 * np.sqrt(np.maximum(common**2 - own.min() ** 2, 0.0) + sd2)
    value, interval = float(np.exp(mean)), (float(np.exp(mean - low)), float(np.exp(mean + high)))
    return IndentSummary(
        curves=len(log),
        modulus_pa=value,
        modulus_interval_pa=interval,
        verdict=relative_verdict(value, interval, [doubt for one in estimates for doubt in one.reasons]),
        scatter=float(np.sqrt(scatter2)),
        own_sd=float(np.median(own)),
    )
