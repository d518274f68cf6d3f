"""What a rig adds to the modulus that it reads, by cause: from touches of a sample of known modulus.

Along the normal the tip is where the arm says, z = z0 + exp(s) (d + c F) + tau v, with the dent d of the tip's law
(`tip_law`) at the true force F = exp(-g) times the sensor's; z0 is of each touch. Each cause is within its tolerance
or off, with a wide prior. The posterior is that over all sets of up to two causes that are off (each as a Gaussian,
Laplace). It includes what is not known of the sample: modulus, thickness, Poisson's ratio, places, loss, exponent."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.results.render import ReportedResult, reported
from deformscope.stages.poke import indentation
from deformscope.stages.poke.contact import Z_90
from deformscope.stages.regions.touches import LAW_SD

CAUSES = ("force gain", "depth scale", "tip radius", "compliance", "clock")
"""Logs of what a sensor says over the true force, of the arm's travel over the true one, and of the true tip over the
stated one; compliance beyond the stated one [m/N]; delay of forces relative to poses [s]."""
TOLERANCE, OFF = (0.03, 0.003, 0.005, 1e-5, 0.002), (0.15, 0.06, 0.2, 3e-4, 0.03)
"""Deviations of causes that are not off, and of those that are [assumed]."""
OFF_SHARE, MOST_OFF, SURE = 0.1, 2, 0.8
"""Prior probability that a cause is off; most that are off together; probability from which causes are named."""
LOSS_SD, PLACES_SD, REPEATS_M = 0.05, 0.003, 2e-5
"""Deviations of the log dent on the way back over that on the way in, and of log modulus from place to place, of
silicones; least scatter of an arm along its way [m] [assumed]."""
UNEVEN, MOST_TIMES = 0.1, 3.0
"""Scatter between touches from which a sample is not of one modulus; ratio of a reading from which it is another."""
LEAST, CHUNKS, AROUND, ROUNDS, DRAWS, POINTS, TIP_STEP = 0.05, 16, 10, 6, 4000, 300, 0.4
"""Share of the peak from which samples are used; means of each way; samples around one that its speed is taken from."""


@dataclass(frozen=True, slots=True)
class KnownSample:
    """modulus_pa, modulus_sd: Young's modulus [Pa], deviation of its log; lies: how it lies, and the tip on it"""

    name: str
    modulus_pa: float
    modulus_sd: float
    lies: indentation.IndentSample


@dataclass(frozen=True, slots=True, kw_only=True)
class RigBias(ReportedResult):
    """bias: what a rig adds to a modulus, as a share of it, with its 90 % interval; read_pa: modulus that it read;
    scatter: deviation of log E from touch to touch beyond their own errors; known_to: deviation of the log of the known
    modulus, below which gain, depth and tip are not seen; off: the fewest causes of which one is off, empty = none
    causes: by name, value and deviation as in `CAUSES`, probability that it is off, its part of the log of the bias"""

    bias: float = field(metadata=reported("bias", interval="bias_interval", digits="+.1%"))
    bias_interval: tuple[float, float] = field(metadata=reported())
    read_pa: float = field(metadata=reported("modulus read", scale=1e-3, shown_unit="kPa", digits=".4g"))
    scatter: float = field(metadata=reported("scatter between touches", digits=".1%"))
    known_to: float = field(metadata=reported("sample known to", digits=".1%"))
    off: tuple[str, ...] = field(metadata=reported("off", words=lambda found: found.off_text))
    causes: dict[str, tuple[float, float, float, float]] = field(
        metadata=reported("causes", words=lambda found: found.causes_text)
    )
    curves: tuple[indentation.IndentEstimate, ...]

    @property
    def off_text(self) -> str:
        """Which causes are off."""
        apart = ", which this sample does not distinguish" if len(self.off) > 1 else ""
        return " or ".join(self.off) + apart if self.off else "no cause is beyond its tolerance"

    @property
    def causes_text(self) -> str:
        """Each cause with its 90 % interval."""
        units = ((100.0, "%"),) * 3 + ((1e3, "mm/N"), (1e3, "ms"))
        each = [(*one, *unit) for one, unit in zip(self.causes.items(), units, strict=True)]
        text = "{} {:+.2g} +- {:.2g} {} (off {:.2f})".format
        return ", ".join(text(name, by * one[0], by * Z_90 * one[1], unit, one[2]) for name, one, by, unit in each)


def _means(curves: Sequence[indentation.IndentCurve], sample: indentation.IndentSample) -> FloatArray:
    """(n, 6) means over parts of both ways: z [m], force [N], speed [m/s], deviation of z [m], number of the touch, and
    1 on the way back."""
    rows = []
    for number, curve in enumerate(curves):
        poke = indentation.SplitCurve(curve, sample)
        if poke.time_s is None:
            raise InputError("touches with times", "none", where=curve.name)
        upto = poke.within_law()[0]
        most = float(poke.force_n[max(upto - 5, 0) : upto].mean())
        for back, (begin, end) in enumerate(((poke.began, upto), (poke.held, poke.released))):
            force = poke.force_n[begin:end]
            # by time, between the first and the last: a choice by each force would favour its noise
            edge = begin + np.flatnonzero((force > max(LEAST * most, 3.0 * poke.noise_n)) & (force < 1.02 * most))
            way = np.arange(edge[0], edge[-1] + 1) if len(edge) else edge
            for part in np.array_split(way, min(CHUNKS, len(way) // 3)) if len(way) > 2 else ():
                z, force = poke.given_m[part], poke.force_n[part]
                about = slice(max(part[0] - AROUND, way[0]), min(part[-1] + AROUND, way[-1]) + 1)
                time = poke.time_s[about] - poke.time_s[part[0]]
                slope = min(float(np.ptp(z)) / max(float(np.ptp(force)), 1e-12), 1.0)
                sd = np.hypot(REPEATS_M, slope * poke.noise_n / np.sqrt(len(part)))
                speed = np.polyfit(time, poke.given_m[about], 1)[0]
                rows.append((z.mean(), force.mean(), speed, sd, number, back))
    return np.array(rows, np.float64)


class _Rig:
    """z by the parameters: the causes; log modulus, thickness, Poisson's ratio, exponent, loss; place and z0 of each
    touch."""

    def __init__(self, means: FloatArray, known: KnownSample, tolerance: Sequence[float], scatter: float) -> None:
        sample = known.lies
        self.at_m, self.force_n, self.speed_m_s, self.sd_m, touch, self.back = means.T
        self.touch = touch.astype(np.int64)
        self.count = count = int(self.touch[-1]) + 1
        self.give = 0.0 if sample.machine_n_per_mm is None else 1e-3 / sample.machine_n_per_mm
        each = [self.touch == one for one in range(count)]
        self.peak_n = np.array([self.force_n[one].max() for one in each])
        (low, high), nu, deep = sample.poisson, 0.5 * sum(sample.poisson), 2.0 * sample.limit_m
        self.law, self.plane_pa = sample.law(deep, nu), known.modulus_pa / (1.0 - nu**2)
        ends = np.log(self.law.response(np.array([1e-4, 1.0]) * 2.0 * deep))
        self.logs = np.linspace(float(ends[0]), float(ends[1]), POINTS)
        others = [sample.law(deep, nu, tip=float(np.exp(one))) for one in (-TIP_STEP, TIP_STEP)]
        others += [sample.law(deep, nu, thickness=1.02), sample.law(deep, nu - 0.02)]
        self.dents = np.log(self.law.depth(np.exp(self.logs)))
        small, large, thick, other = (np.log(one.depth(np.exp(self.logs))) - self.dents for one in others)
        self.tip, self.bent_tip = 0.5 * (large - small) / TIP_STEP, 0.5 * (large + small) / TIP_STEP**2
        self.thick, self.nu = thick / np.log(1.02), -other / 0.02
        self.plane_slope = 2.0 * nu / (1.0 - nu**2)  # of log E*, over Poisson's ratio
        own = [np.hypot(known.modulus_sd, LAW_SD), sample.thickness_sd, max((high - low) / 12.0**0.5, 1e-6)]
        own += [indentation.OWN_EXPONENT_SD, LOSS_SD, *[max(PLACES_SD, scatter)] * count, *[1.0] * count]
        self.prior, self.start = np.array([*tolerance, *own]), np.zeros(10 + 2 * count)
        self.start[-count:] = [self.at_m[one].min() for one in each]

    def z_m(self, at: FloatArray) -> FloatArray:
        """(n,) by the parameters."""
        (gain, scale, tip, give, clock, young, thick, nu, bend, loss), count = at[:10], self.count
        force = self.force_n * np.exp(-gain)
        response = np.log(force / self.plane_pa) - young - at[10 : 10 + count][self.touch] - self.plane_slope * nu
        table = self.dents + tip * self.tip + tip**2 * self.bent_tip + thick * self.thick + nu * self.nu
        dent = np.interp(response, self.logs, table) + loss * self.back
        dent -= bend / self.law.exponent**2 * np.log(self.force_n / self.peak_n[self.touch])
        way = np.exp(scale) * (np.exp(dent) + (self.give + give) * force) + clock * self.speed_m_s
        return np.asarray(at[10 + count :][self.touch] + way)

    def fitted(self, prior: FloatArray, at: FloatArray, inflate: float) -> tuple[FloatArray, FloatArray, float]:
        """Best parameters, from `at`, their covariance, and the log of the evidence."""
        sd, cost, whole = inflate * self.sd_m, 0.0, np.eye(len(prior))
        steps = np.diag(np.minimum(1e-3 * prior, 1e-4))
        for _ in range(ROUNDS):
            off = (self.at_m - self.z_m(at)) / sd
            columns = [(self.z_m(at + one) - self.z_m(at - one)) / (2.0 * one.sum()) / sd for one in steps]
            jacobian, away = np.stack(columns, axis=1), np.append(at[: -self.count], np.zeros(self.count))
            whole = jacobian.T @ jacobian + np.diag(prior**-2)
            cost = float(off @ off + ((away / prior) ** 2).sum())
            at = at + np.linalg.solve(whole, jacobian.T @ off - away / prior**2)
        evidence = -0.5 * cost - float(np.log(prior).sum()) - 0.5 * float(np.linalg.slogdet(whole)[1])
        return at, np.linalg.inv(whole), evidence

    def shares(self) -> FloatArray:
        """(8,) change of the log modulus that is read, under the largest force, for one unit of each of the causes, and
        of the sample's log modulus, thickness and Poisson's ratio."""
        force = float(np.median(self.peak_n))
        at = np.log(force / self.plane_pa)
        depth = float(np.exp(np.interp(at, self.logs, self.dents)))
        steep = -self.law.steepness(depth)
        tip, thick, nu = (steep * float(np.interp(at, self.logs, one)) for one in (self.tip, self.thick, self.nu))
        return np.array([1.0, steep, tip, steep * force / depth, 0.0, 1.0, thick, nu + self.plane_slope])


def certify_rig(
    curves: Sequence[indentation.IndentCurve], known: KnownSample, tolerance: Sequence[float] = TOLERANCE
) -> RigBias:
    """The bias of a rig and its causes by touches of a sample of known modulus. tolerance: deviations (5,) of causes
    that are not off. Raises the errors of `fit_indentation`, and InputError for touches that disagree."""
    estimates = [indentation.fit_indentation(one, known.lies, creep=False) for one in curves]
    read = indentation.combine(estimates)
    if abs(np.log(read.modulus_pa / known.modulus_pa)) > np.log(MOST_TIMES) + 2.0 * known.modulus_sd:
        expected = f"a reading within {MOST_TIMES:g} times of the sample's {known.modulus_pa / 1e3:.3g} kPa"
        raise InputError(expected, f"{read.modulus_pa / 1e3:.3g} kPa", "the sample's name, the tip's radius")
    if read.scatter > UNEVEN:
        came, hint = f"touches that differ by {read.scatter:.0%}", "a sample of one material, away from its sides"
        raise InputError(f"a sample whose touches agree within {UNEVEN:.0%}", came, hint)
    rig = _Rig(_means(curves, known.lies), known, tolerance, read.scatter)
    every = np.append(np.maximum(OFF, tolerance), rig.prior[5:])
    first = rig.fitted(every, rig.start, 1.0)[0]
    inflate = max(1.0, float(np.median(np.abs(rig.at_m - rig.z_m(first)) / rig.sd_m)) / 0.6745)
    sets = [one for size in range(MOST_OFF + 1) for one in itertools.combinations(range(5), size)]
    found, weight = [], np.zeros(len(sets))
    for number, off in enumerate(sets):
        prior = np.where(np.isin(np.arange(len(every)), off), every, rig.prior)
        found.append(rig.fitted(prior, np.append(np.zeros(10 + rig.count), first[-rig.count :]), inflate))
        weight[number] = found[-1][2] + len(off) * np.log(OFF_SHARE / (1.0 - OFF_SHARE))
    weight = np.exp(weight - weight.max()) / np.exp(weight - weight.max()).sum()
    random = np.random.default_rng(0)
    several = zip(found, random.multinomial(DRAWS, weight), strict=True)
    drawn = np.concatenate([random.multivariate_normal(at, cov, n, method="eigh") for (at, cov, _), n in several])
    shares = rig.shares()
    sample = drawn[:, 5:8] @ shares[5:] + drawn[:, 10 : 10 + rig.count].mean(axis=1)
    low, middle, high = np.quantile(np.expm1(np.log(read.modulus_pa / known.modulus_pa) - sample), (0.05, 0.5, 0.95))
    chance = np.array([weight[[cause in one for one in sets]].sum() for cause in range(5)])
    mean, sd = drawn[:, :5].mean(axis=0), drawn[:, :5].std(axis=0)
    order, named = np.argsort(-chance), tuple[str, ...]()
    for count in (3, 2, 1):  # the fewest likely ones
        if weight[[bool({*order[:count].tolist()} & {*one}) for one in sets]].sum() >= SURE:
            named = tuple(CAUSES[one] for one in order[:count])
    parts = np.stack([mean, sd, chance, mean * shares[:5]]).tolist()
    return RigBias(
        bias=float(middle),
        bias_interval=(float(low), float(high)),
        read_pa=read.modulus_pa,
        scatter=read.scatter,
        known_to=known.modulus_sd,
        off=named,
        causes=dict(zip(CAUSES, zip(*parts, strict=True), strict=True)),
        curves=tuple(estimates),
    )
