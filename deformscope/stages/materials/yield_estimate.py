"""Results of yielding from a motion: the yield strain, parameters fitted with it, and their evidence."""

from dataclasses import dataclass, field
from typing import ClassVar

from deformscope.arrays import FloatArray
from deformscope.results.render import ReportedResult, derived, lengths, reported
from deformscope.stages.fit.estimate import Doubt, LengthUnit, Verdict, converged_text, explained_text


@dataclass(frozen=True, slots=True)
class Parameter:
    """A fitted number with its interval; None: an end that the data do not determine. given: it was not fitted."""

    value: float
    interval: tuple[float, float | None]
    given: bool = False

    @property
    def text(self) -> str:
        """The number with its interval."""
        low, high = self.interval
        return f"{self.value:.4g} (given)" if self.given else f"{self.value:.4g} ({low:.4g} to {high:.4g})"


@dataclass(frozen=True, slots=True, kw_only=True)
class YieldEstimate(ReportedResult):
    """Results of yielding from a motion.

    yield_strain: |S - I|_2 above which it flows. If the verdict is `unidentified`, its interval has no upper end: no
    yield strain above the lower end contradicts the motion; verdict: verdict by the interval's width over the value
    (`identified` below 0.2, `weak` below 0.7); reasons: reasons to doubt it, which may lower its verdict
    explained: share of the motion beyond a rigid one that the model explains (sums of squares; free particles)
    largest_strain: largest strain of any cluster if nothing had yielded
    set: root mean square distance between the last frame simulated with and without yielding, at its free particles
    deviation, elastic_deviation: root mean square of a coordinate's residual, at the best and without yielding
    aee, elastic_aee: average Euclidean error over all observed particles and frames
    curve: (n,) yield strains and (n,) root mean squares of a coordinate's residual there, the others at their best
    simulated, elastic: (T, K, d) the motion at the best, and without yielding
    unit, metres_per_unit: unit and scale of all lengths; None: not known"""

    parameter: ClassVar[str] = "yield_strain"

    yield_strain: Parameter = field(metadata=reported(flat=True))
    level: float = field(metadata=reported())
    verdict: Verdict = field(metadata=reported())
    reasons: tuple[Doubt, ...] = field(metadata=reported())
    explained: float = field(
        metadata=reported("explained", words=lambda found: explained_text(found.explained, found.reasons))
    )
    beta: Parameter = field(metadata=reported("beta", words=lambda found: found.beta.text))
    creep: Parameter | None = field(
        metadata=reported(
            "creep [1/s]", key="creep_per_s", words=lambda found: "" if found.creep is None else found.creep.text
        )
    )
    largest_strain: float = field(metadata=reported("largest strain, unyielded", digits=".4g"))
    set: float = field(metadata=reported("permanent set (rms)", key="permanent_set", length=True))
    deviation: float = field(metadata=reported(key="rms", length=True))
    elastic_deviation: float = field(metadata=reported(key="rms_elastic", length=True))
    aee: float = field(metadata=reported(length=True))
    elastic_aee: float = field(metadata=reported(key="aee_elastic", length=True))
    curve: tuple[FloatArray, ...]

    @property
    @derived(key="curve")
    def curve_json(self) -> dict[str, object]:
        """The error over the yield strain."""
        strain, rms = self.curve
        return {"yield_strain": strain} | lengths("rms", rms, self.unit, self.metres_per_unit)

    simulated: FloatArray
    elastic: FloatArray
    converged: bool = field(metadata=reported("converged", words=converged_text))
    settings: dict[str, object] = field(metadata=reported())
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0
