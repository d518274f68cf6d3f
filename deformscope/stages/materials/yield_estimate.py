"""What a motion shows of yielding: the yield strain, what was found with it, and the evidence they rest on."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope.arrays import FloatArray
from deformscope.stages.fit.estimate import Doubt, LengthUnit, Verdict, lengths


@dataclass(frozen=True, slots=True)
class Parameter:
    """A fitted number with its interval; None: an end that the data leave open. given: it was not fitted."""

    value: float
    interval: tuple[float, float | None]
    given: bool = False


@dataclass(frozen=True, slots=True)
class YieldEstimate:
    """What a motion shows of yielding.

    yield_strain: |S - I|_2 above which it flows; where the verdict is `unidentified` its interval has no upper end:
    no yield strain above the lower one contradicts the motion
    verdict: by the interval's width over the value (`identified` below 0.2, `weak` below 0.7); reasons: to doubt it,
    which may lower its verdict
    explained: share of the motion beyond a rigid one that the model explains (sums of squares; free particles)
    largest_strain: that any cluster would have seen had nothing yielded
    set: root mean square distance between the last frame simulated with and without yielding, at its free particles
    deviation, elastic_deviation: root mean square of a coordinate's residual, at the best and without yielding
    aee, elastic_aee: average Euclidean error over all observed particles and frames
    curve: (n,) yield strains and (n,) root mean squares of a coordinate's residual there, the others at their best
    simulated, elastic: (T, K, d) the motion at the best, and without yielding
    unit, metres_per_unit: of all lengths; None: not known
    """

    yield_strain: Parameter
    verdict: Verdict
    reasons: tuple[Doubt, ...]
    explained: float
    beta: Parameter
    creep: Parameter | None
    level: float
    largest_strain: float
    set: float
    deviation: float
    elastic_deviation: float
    aee: float
    elastic_aee: float
    curve: tuple[FloatArray, ...]
    simulated: FloatArray
    elastic: FloatArray
    converged: bool
    settings: dict[str, object]
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0

    def as_json(self) -> dict[str, object]:
        """The public form; an interval's end that is null is open."""

        def public(parameter: Parameter | None) -> dict[str, object] | None:
            if parameter is None:
                return None
            low, high = parameter.interval
            return {"value": parameter.value, "interval": [low, high], "given": parameter.given}

        return {
            "parameter": "yield_strain",
            **(public(self.yield_strain) or {}),
            "level": self.level,
            "verdict": self.verdict,
            "reasons": [one.as_json() for one in self.reasons],
            "explained": self.explained,
            "beta": public(self.beta),
            "creep_per_s": public(self.creep),
            "largest_strain": self.largest_strain,
            **lengths("permanent_set", self.set, self.unit, self.metres_per_unit),
            **lengths("rms", self.deviation, self.unit, self.metres_per_unit),
            **lengths("rms_elastic", self.elastic_deviation, self.unit, self.metres_per_unit),
            **lengths("aee", self.aee, self.unit, self.metres_per_unit),
            **lengths("aee_elastic", self.elastic_aee, self.unit, self.metres_per_unit),
            "curve": {
                "yield_strain": self.curve[0].tolist(),
                **lengths("rms", self.curve[1], self.unit, self.metres_per_unit),
            },
            "converged": self.converged,
            "settings": self.settings,
        }
