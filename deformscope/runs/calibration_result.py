"""Result of a calibration of beta or theta."""

from dataclasses import dataclass
from pathlib import Path

from deformscope.errors import InputError
from deformscope.files.model_file import save_model
from deformscope.files.pairs import save_pair
from deformscope.pictures.evidence import Result, results_png
from deformscope.pictures.messages import estimate_tables
from deformscope.pictures.report import Figure, Table
from deformscope.plain import Json
from deformscope.runs.calibration_report import poke_tables
from deformscope.runs.result import SourceResult
from deformscope.stages.fit.calibrate import Model, Observation
from deformscope.stages.fit.estimate import Doubt, Estimate, Verdict
from deformscope.stages.msm.poke import Law
from deformscope.stages.poke.fitted import FittedModel, from_pair
from deformscope.stages.poke.poke_estimate import PokesResult
from deformscope.version import __version__


@dataclass(frozen=True, slots=True)
class CalibrationResult(SourceResult):
    """Result of `calibrate_beta` or `calibrate_theta`.

    estimate: value, interval, verdicts, error curve; shown: observed and simulated particles
    pokes: pokes of a surface, where layers below it were fitted
    pair: the observation and the model's settings, from which `model` is made, if there was one pair"""

    estimate: Estimate
    shown: Result
    pokes: PokesResult | None = None
    pair: tuple[Observation, Model] | None = None

    @property
    def value(self) -> float:
        """The most likely parameter."""
        return self.estimate.value

    @property
    def interval(self) -> tuple[float, float]:
        """The parameter's interval, at the estimate's level."""
        return self.estimate.interval

    @property
    def verdict(self) -> Verdict:
        """The verdict on the parameter."""
        return self.estimate.verdict

    @property
    def reasons(self) -> tuple[Doubt, ...]:
        """Why the parameter is doubtful, and its range of validity; reasons that lower the verdict first."""
        return self.estimate.reasons

    def __repr__(self) -> str:
        low, high = self.interval
        return f"<{self.estimate.parameter} {self.value:.4g}, {low:.4g} to {high:.4g}: {self.verdict}>"

    def model(self) -> FittedModel:
        """A model that `deformscope.predict` can poke. Raises InputError if the source has no scale in metres."""
        if self.pokes is not None:
            return self.pokes.model
        if self.pair is None:
            raise InputError("a result of one pair, of images, or of pokes of a surface", "several pairs")
        (seen, model), found = self.pair, self.estimate
        beta, theta = (found.value, model.theta) if model.parameter == "beta" else (model.beta, found.value)
        law = Law(beta, theta, model.cluster_size, model.basis, model.volume)
        stiffness = None if found.stiffness is None else found.stiffness[0]
        error_m = found.aee_free * (found.metres_per_unit or 1.0)
        return from_pair(seen, law, stiffness, error_m, {"deformscope": __version__, "sources": [self.name]})

    def save(self, path: Path | str) -> None:
        """Write `model()` as a file (.npz) for `deformscope predict`."""
        save_model(self.model(), Path(path))

    def save_pair(self, path: Path | str) -> None:
        """Write the fitted particles as a pair file (.npz), which `calibrate_beta` and the other fits read."""
        if self.pair is None:
            raise InputError("a result of one pair, or of images", "several pairs, or pokes of a surface")
        save_pair(self.pair[0], Path(path))

    def picture(self) -> bytes:
        """Particles, the model's error over the body, error curve and posterior, as PNG."""
        return results_png([self.shown])

    def as_json(self) -> Json:
        found = self.estimate.as_json()
        if self.pokes is not None:
            found |= {"pokes": self.pokes.rows(), "tried": self.pokes.tried_json()}
            found |= {"field": self.pokes.model.field_kind, "model": None}
        return self.with_problems(found)

    def tables(self) -> tuple[Table, ...]:
        parameter, rows = self.estimate.parameter, self.source_rows()
        title = f"{parameter} of {self.name}" if self.name else f"Estimate of {parameter}"
        first, *others = estimate_tables(self.estimate, title)
        tables = [Table([*first.rows, *rows], caption=first.caption), *others]
        if self.pokes is not None:
            tables += poke_tables(self.pokes)
        return tuple(tables)

    def figures(self) -> tuple[Figure, ...]:
        return (Figure(self.picture(), self.estimate.verdict_text()),)
