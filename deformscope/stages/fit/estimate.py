"""Result of a calibration: the parameter, its interval, the verdicts, and their evidence."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.results.render import WORDING, ReportedResult, derived, lengths, reported, to_json

Parameter = Literal["beta", "theta"]
Verdict = Literal["identified", "weak", "at-bound", "unidentified"]
LengthUnit = Literal["m", "px"]
Plane = Literal["stress", "strain"]
"""What happens along a camera's view: no stress, so that the body bulges freely, or no strain."""
WithInterval = tuple[float, tuple[float, float]]
"""A value and its interval."""
NoiseSource = Literal["given", "flow", "residuals"]
"""Source of the noise of positions: a person or a file, the optical flow, or only a fit's residuals."""

IDENTIFIED_WIDTH, WEAK_WIDTH = 0.2, 0.7
"""An interval narrower than the first is identified, narrower than the second weak."""

RATIO_KNOWN = 0.25
"""Widest interval of Poisson's ratio that counts as determined."""

RISE_LEAST = 2.0
"""Standard deviations by which the data must separate the likeliest value from the least likely."""

EXPLAINED_LEAST, EXPLAINED_LOW = 0.3, 0.75
"""Share of the non-rigid motion (sums of squares) that a model must explain before its parameter is meaningful. Below
the second, half of the motion (root mean square) is left, so that the parameter is a compromise and not identified."""

SHOWN = 121
"""Number of values of a posterior in the JSON."""

DoubtCode = Literal[
    "not-converged",
    "nothing-moved",
    "rigid-motion",
    "little-explained",
    "aee-outside-interval",
    "noise-contradicted",
    "units",
    "axes-swapped",
    "two-materials",
    "held-off",
    "held-slides",
    "setting",
    "short-record",
    "no-plateau",
    "large-strain",
    "smooth-error",
    "body-unsure",
    "unfit-images",
    "force-drift",
    "adhesion",
]


@dataclass(frozen=True, slots=True)
class Doubt:
    """A reason to doubt a parameter, or its range of validity.

    code: stable name for programs; text: one sentence for people, with its numbers; allows: the best verdict that is
    possible with this doubt; None: the reason states the range of validity, or the interval accounts for it"""

    code: DoubtCode
    text: str = field(metadata=WORDING)
    allows: Verdict | None = None


def limited(found: Verdict, reasons: Sequence[Doubt]) -> Verdict:
    """A verdict, lowered by the reasons to doubt it; `at-bound` counts as `weak`."""
    allowed = {one.allows for one in reasons}
    if "unidentified" in allowed:
        return "unidentified"
    return "weak" if found == "identified" and "weak" in allowed else found


@dataclass(frozen=True, slots=True)
class Curve:
    """The error over the parameter.

    parameter: (n,) values tried, rising; aee: (n,) average Euclidean error [the estimate's unit], NaN if diverged"""

    parameter: FloatArray
    aee: FloatArray


@dataclass(frozen=True, slots=True)
class PushCurve:
    """Force over the depth of a push, at the frames of its loading. depth_m, force_n: (n,) [m], [N]"""

    depth_m: FloatArray
    force_n: FloatArray


@dataclass(frozen=True, slots=True)
class Posterior:
    """Probability of a quantity, given the data.

    parameter: (g,) rising; density: (g,) density, whose integral by trapezoids is 1"""

    parameter: FloatArray
    density: FloatArray

    def cumulative(self) -> FloatArray:
        """(g,) from 0 to 1."""
        steps = 0.5 * (self.density[1:] + self.density[:-1]) * np.diff(self.parameter)
        mass = np.concatenate([[0.0], np.cumsum(steps)])
        return np.asarray(mass / mass[-1])

    def thinned(self, count: int) -> "Posterior":
        """The posterior at this number of its values at most, evenly chosen."""
        rows = np.unique(np.linspace(0, len(self.parameter) - 1, count).round().astype(int))
        return Posterior(self.parameter[rows], self.density[rows])

    def rank(self, value: float) -> float:
        """Share of the mass below a value: for true values it is uniform from 0 to 1 if the posterior is right."""
        return float(np.interp(value, self.parameter, self.cumulative()))

    def quantile(self, share: FloatArray | float) -> FloatArray:
        """Values of the parameter below which these shares (n,) of the posterior's mass lie."""
        mass = self.cumulative()
        rising = np.concatenate([[True], np.diff(mass) > 0.0])
        return np.asarray(np.interp(share, mass[rising], self.parameter[rising]))

    def mode(self) -> float:
        """Value of the highest density, between the values by a parabola through its logarithm."""
        top = int(np.argmax(self.density))
        near = self.density[top - 1 : top + 2]
        if not 0 < top < len(self.density) - 1 or near.min() <= 0.0:
            return float(self.parameter[top])
        step = self.parameter[top - 1 : top + 2] - self.parameter[top]
        bend, slope, _ = np.polyfit(step, np.log(near), 2)
        away = -0.5 * slope / bend if bend < 0.0 else 0.0
        return float(self.parameter[top] + np.clip(away, step[0], step[2]))

    def deviation(self) -> float:
        """Standard deviation."""
        mean = np.trapezoid(self.density * self.parameter, self.parameter)
        return float(np.sqrt(max(np.trapezoid(self.density * (self.parameter - mean) ** 2, self.parameter), 0.0)))

    def shortest(self, level: float, holding: float) -> tuple[float, float]:
        """The shortest interval of the mass `level` that holds a value, the estimate.

        It is the set of highest density if that contains the estimate, and one-sided if the density is highest at a
        bound: equal tails cannot include it."""
        start = np.linspace(0.0, 1.0 - level, 401)
        at = self.rank(holding)
        # one of the starts makes the interval end exactly at the value, another begin there
        start = np.unique(np.clip(np.concatenate([start, [at, at - level]]), 0.0, 1.0 - level))
        low, high = self.quantile(start), self.quantile(start + level)
        low[start == 0.0], high[start == 1.0 - level] = self.parameter[0], self.parameter[-1]
        slack = 1e-9 * (self.parameter[-1] - self.parameter[0])
        holds = (low <= holding + slack) & (holding - slack <= high)
        if not holds.any():
            return min(float(low[0]), holding), max(float(high[-1]), holding)
        best = int(np.argmin(np.where(holds, high - low, np.inf)))
        return min(float(low[best]), holding), max(float(high[best]), holding)


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Whether the data identify the parameter.

    rise: standard deviations by which the data separate the likeliest value of the range from the least likely
    explained: share of the motion, less the best rigid one, that the model explains (sums of squares; free particles).
    The share is that at the least AEE, 0 or less if misfit or noise are as large as the motion
    deviation: deviation of the posterior; misfit: root mean square of the model's error, per coordinate [unit]"""

    rise: float = field(metadata=reported(key="rise_sd"))
    explained: float = field(metadata=reported())
    deviation: float = field(metadata=reported())
    misfit: float


@dataclass(frozen=True, slots=True)
class Choice:
    """A choice of model that was tested on particles that were left out of its fit.

    held: the parts whose motion is prescribed; alpha, dt [s]: of time stepping, None for static states, which neither
    alters; held_out, fit: mean error on particles left out, and of the same ones when fitted [the estimate's unit];
    scatter: standard error of held_out relative to the best choice's; value: the parameter with it; chosen: in use"""

    cluster_size: int | None = field(metadata=reported())
    held: tuple[str, ...] = field(metadata=reported())
    alpha: float | None = field(metadata=reported())
    dt: float | None = field(metadata=reported())
    held_out: float
    scatter: float
    fit: float
    value: float
    chosen: bool = field(default=False, metadata=reported())

    def as_json(self, parameter: Parameter, scale: float) -> dict[str, object]:
        """scale: scale of the lengths."""
        errors = {"held_out_aee": scale * self.held_out, "scatter": scale * self.scatter, "fit_aee": scale * self.fit}
        return to_json(self) | errors | {parameter: self.value}


def _with_interval(one: WithInterval) -> dict[str, object]:
    return {"value": one[0], "interval": one[1]}


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate(ReportedResult):
    """One calibrated parameter with everything needed to judge it (Thesis eq. 3.18, 3.19, Algorithms 2 and 3).

    value: the most likely parameter, the mode of its posterior (with white noise that of least squares); interval:
    interval at `level` of that posterior, which always contains `value`; one-sided at a bound; bounds: searched range
    least_aee: the thesis's value, that of the least AEE (Algorithm 3), and this AEE [unit]; None where not searched
    verdict: verdict on the parameter; stiffness_verdict: verdict on stiffness, which positions alone do not identify
    stiffness: the energy's stiffness k and its interval over `interval` [N/m], if a force was given
    contact_stiffness: force over the displacement of the contact, and its interval [N/mm], if both are known
    metres_per_unit: the scale of the lengths; None for pixels of unknown size
    force: force on the contact of images [N]; modulus: Young's modulus by it [Pa]; poisson: Poisson's ratio, each with
    its interval; plane: what the modulus assumes; modulus_verdict: verdict on it; force_curve: force over depth, and
    force_offset: time of the log at the first frame [s], where a log of the force was given
    posterior, identifiability: evidence of the interval and the verdict
    reasons: reasons to doubt the parameter, first those that lower its verdict
    selection: choices of model that were tried, if a selection was requested; selection_text: remarks on the selection
    aee: mean error over all observed particles, held ones included (eq. 3.18); aee_free: error over the free particles
    only; nearest: one-sided nearest-neighbour error (eq. 4.6); unit: unit of every length here
    converged: every simulation that the value and the interval rest on reached its static state"""

    parameter: Parameter = field(metadata=reported())
    value: float = field(metadata=reported())
    interval: tuple[float, float] = field(metadata=reported())
    level: float = field(metadata=reported())
    bounds: tuple[float, float] = field(metadata=reported())
    verdict: Verdict = field(metadata=reported())

    @derived()
    def verdict_text(self) -> str:
        """The verdict in plain words, with the first reason that lowers it."""
        low, high = self.interval
        name = self.parameter
        because = {one.allows: one.text for one in reversed(self.reasons)}
        why = because.get("weak", "")
        if self.verdict == "identified":
            return f"identified: {name} is {low:.3g} to {high:.3g}"
        if self.verdict == "unidentified":
            wide = f"any {name} from {low:.2g} to {high:.2g} fits; the data do not identify it"
            return f"unidentified: {because.get('unidentified', wide)}"
        but = f", but {why}" if why else ""
        if self.verdict == "weak":
            if high - low < IDENTIFIED_WIDTH:
                return f"weak: {name} is {low:.3g} to {high:.3g} by this model{but}"
            return f"weak: any {name} from {low:.2g} to {high:.2g} fits{but}"
        bound = "the lower" if low <= self.bounds[0] else "the upper"
        side = f"below {high:.3g}" if low <= self.bounds[0] else f"above {low:.3g}"
        weak = "" if high - low < IDENTIFIED_WIDTH else "weak, "
        return f"{weak}at {bound} bound: any {name} {side} fits{but}"

    reasons: tuple[Doubt, ...] = field(default=(), metadata=reported())
    stiffness_verdict: Verdict = field(metadata=reported())

    @derived()
    def stiffness_text(self) -> str:
        """Remarks on stiffness, as text."""
        if self.force is not None:
            return "; ".join(f"{name} {words}" for name, words in self.stiffness_rows())
        texts = []
        if self.contact_stiffness is not None:
            texts.append("{:.3g} N/mm at the contact ({:.3g} to {:.3g})".format(*_flat(self.contact_stiffness)))
        if self.stiffness is not None:
            found = "{:.4g} N/m ({:.4g} to {:.4g})".format(*_flat(self.stiffness))
            texts.append(f"the model's constant k is {self.stiffness_verdict}: {found}")
        return "; ".join(texts) or "position alone does not identify stiffness here: give a force"

    def stiffness_rows(self) -> list[tuple[str, str]]:
        """Stiffness as names and values; of images with a force each quantity, or what it lacks."""
        if self.force is None:
            return [("stiffness", self.stiffness_text())]
        rows = [("force", "{:.3g} N ({:.3g} to {:.3g})".format(*_flat(self.force)))]
        if self.force_offset is not None:
            found = "{:.3g} s at the first frame ({:.3g} to {:.3g})".format(*_flat(self.force_offset))
            rows.append(("time of the log", found))
        if self.metres_per_unit is None:
            return [*rows, ("stiffness", "no scale: give --px-per-cm or --scale-from")]
        if self.contact_stiffness is not None:
            found = "{:.3g} N/mm ({:.3g} to {:.3g})".format(*_flat(self.contact_stiffness))
            rows.append(("stiffness at the contact", f"{self.stiffness_verdict}: {found}"))
        if self.modulus is None or self.poisson is None:
            return [*rows, ("modulus", self.modulus_verdict or "give --thickness-m")]
        found = "{:.3g} kPa ({:.3g} to {:.3g})".format(*(1e-3 * one for one in _flat(self.modulus)))
        ratio = "{:.2f} ({:.2f} to {:.2f})".format(*_flat(self.poisson))
        known = "" if self.poisson[1][1] - self.poisson[1][0] <= RATIO_KNOWN else "not determined: "
        rows.append(("modulus", f"{self.modulus_verdict}: {found} in plane {self.plane}"))
        return [*rows, ("Poisson's ratio", known + ratio)]

    aee: float
    aee_free: float
    nearest: float
    least_aee: tuple[float, float] | None = None
    unit: LengthUnit
    metres_per_unit: float | None = 1.0

    @property
    @derived(flat=True)
    def errors_json(self) -> dict[str, float | None]:
        """The errors, in metres if the scale is known, and in pixels if they were measured in pixels."""
        known = {name: getattr(self, name) for name in ("aee", "aee_free", "nearest")}
        each = [lengths(name, value, self.unit, self.metres_per_unit) for name, value in known.items()]
        return {key: one[key] for place in (0, 1) for one in each for key in [[*one][place]]}

    @property
    @derived(key="least_aee", optional=True)
    def least_aee_json(self) -> dict[str, float | None] | None:
        """The thesis's value with its AEE, in the units of the errors."""
        if self.least_aee is None:
            return None
        value, aee = self.least_aee
        return {self.parameter: value} | lengths("aee", aee, self.unit, self.metres_per_unit)

    curve: Curve

    @property
    @derived(key="curve")
    def curve_json(self) -> dict[str, object]:
        """The curve, in metres where the scale is known."""
        unit = "px" if self.metres_per_unit is None else "m"
        return {"parameter": self.curve.parameter, "aee": self.curve.aee * self._scale, "unit": unit}

    @property
    @derived()
    def explained(self) -> float | None:
        """Share of the motion beyond a rigid one that the model explains; None if not computed."""
        return None if self.identifiability is None else self.identifiability.explained

    converged: bool = field(metadata=reported())
    settings: dict[str, object] = field(metadata=reported())
    posterior: Posterior | None = field(
        default=None, metadata=reported(optional=True, json=lambda posterior: posterior.thinned(SHOWN))
    )
    identifiability: Identifiability | None = None

    @property
    @derived(key="identifiability", optional=True)
    def identifiability_json(self) -> dict[str, float | None] | None:
        """JSON of the identifiability, with lengths as those of the errors."""
        if (known := self.identifiability) is None:
            return None
        return to_json(known) | lengths("misfit", known.misfit, self.unit, self.metres_per_unit)

    selection: tuple[Choice, ...] = ()
    selection_text: str = ""

    @property
    @derived(flat=True)
    def selection_json(self) -> dict[str, object]:
        """JSON of the choices that were tried."""
        if not self.selection:
            return {}
        return {
            "selection": [one.as_json(self.parameter, self._scale) for one in self.selection],
            "selection_unit": "px" if self.metres_per_unit is None else "m",
            "selection_text": self.selection_text,
        }

    stiffness: tuple[float, tuple[float, float]] | None = field(
        default=None, metadata=reported(key="stiffness_n_per_m", optional=True, json=_with_interval)
    )
    contact_stiffness: tuple[float, tuple[float, float]] | None = field(
        default=None, metadata=reported(key="contact_stiffness_n_per_mm", optional=True, json=_with_interval)
    )

    force: WithInterval | None = field(
        default=None, metadata=reported(key="force_n", optional=True, json=_with_interval)
    )
    modulus: WithInterval | None = field(
        default=None, metadata=reported(key="modulus_pa", optional=True, json=_with_interval)
    )
    poisson: WithInterval | None = field(default=None, metadata=reported(optional=True, json=_with_interval))
    plane: Plane | None = field(default=None, metadata=reported(optional=True))
    modulus_verdict: Verdict | None = field(default=None, metadata=reported(optional=True))
    force_curve: PushCurve | None = field(default=None, metadata=reported(optional=True))
    force_offset: WithInterval | None = field(
        default=None, metadata=reported(key="force_offset_s", optional=True, json=_with_interval)
    )

    @property
    def _scale(self) -> float:
        """Factor of lengths in JSON: to metres where the scale is known."""
        return 1.0 if self.metres_per_unit is None else self.metres_per_unit


def _flat(one: WithInterval) -> tuple[float, float, float]:
    return one[0], *one[1]


def converged_text(found: Any) -> str:
    """Whether an estimate's simulations reached their static states."""
    return "yes" if found.converged else "NO: do not rely on the values"


def explained_text(share: float, reasons: Sequence[Doubt] = ()) -> str:
    """Explained share of a motion beyond a rigid one, as text, with a warning if it is small and no reason says why."""
    described = f"{max(share, 0.0):.0%} of the motion beyond a rigid one"
    if share >= EXPLAINED_LOW or any(one.code in ("nothing-moved", "rigid-motion") for one in reasons):
        return described
    return f"only {described}: check units, order and held particles; if they are right, try another model"


def verdict(
    ends: tuple[float, float],
    bounds: tuple[float, float],
    identifiability: Identifiability | None = None,
    reasons: Sequence[Doubt] = (),
) -> Verdict:
    """The verdict from an interval within its bounds, its data, and the reasons to doubt it."""
    width = ends[1] - ends[0]
    found = identifiability
    if width >= WEAK_WIDTH or (found is not None and (found.rise < RISE_LEAST or found.explained < EXPLAINED_LEAST)):
        return "unidentified"
    if ends[0] <= bounds[0] or ends[1] >= bounds[1]:
        return limited("at-bound", reasons)
    return limited("identified" if width < IDENTIFIED_WIDTH else "weak", reasons)


def relative_verdict(value: float, ends: tuple[float, float], reasons: Sequence[Doubt] = ()) -> Verdict:
    """The verdict on a positive quantity without bounds, by its interval's width over its value."""
    width = (ends[1] - ends[0]) / value
    found: Verdict = "identified" if width < IDENTIFIED_WIDTH else "weak" if width < WEAK_WIDTH else "unidentified"
    return limited(found, reasons)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Observed and simulated particles of one moment, at the best parameter.

    rest, observed, simulated: (K, d) positions [unit]; seen: (K,) whether `observed` was measured;
    held: (n,) indices of the particles whose position was prescribed"""

    rest: FloatArray
    observed: FloatArray
    simulated: FloatArray
    seen: BoolArray
    held: IntArray
    unit: LengthUnit
