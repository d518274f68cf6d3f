"""Evaluation of a saved classifier on new trials: `deformscope classify TABLE --model MODEL`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from deformscope.pictures import classification as pictures
from deformscope.pictures.palette import GOOD, WARN, hexadecimal
from deformscope.pictures.report import Figure, ReportVerdict, Section, Table, html_report
from deformscope.results.render import to_json
from deformscope.runs.calibration_report import provenance_sections
from deformscope.runs.classification import format_right
from deformscope.runs.result import LibraryResult
from deformscope.stages.squeeze.model_check import ModelCheck
from deformscope.stages.squeeze.scores import ClassificationScore


@dataclass(frozen=True, slots=True)
class ClassifierCheckResult(LibraryResult):
    """Evaluation of a trained classifier on new trials. trials: their number; name: name of table and model"""

    check: ModelCheck
    trials: int
    name: str = ""

    def tables(self) -> tuple[Table, ...]:
        check, score = self.check, self.check.score
        rows = [
            (
                "accuracy",
                f"{format_right(score)}, chance {score.chance:.1%}, {score.trials.sum()} of {self.trials} trials",
            ),
            ("promised", format_promise(check)),
            *([("drifted", format_drifted(check))] if check.drifted and not check.kept else []),
            ("calibration", format_calibration(check)),
            *((f"{name} alone", format_right(one)) for name, one in check.alone.items()),
        ]
        return (
            Table(rows, caption=self.name),
            Table(
                [
                    (label, f"{score.shares[at, at]:.1%}", "{:.1%} to {:.1%}".format(*score.share_interval(at, at)))
                    for at, label in enumerate(check.labels)
                    if score.trials[at]
                ],
                ("content", "named rightly", "interval"),
                "Content by content",
            ),
        )

    def pictures(self) -> dict[str, bytes]:
        """Pictures as PNG, by names that are valid for files."""
        scores = [self.check.score, *self.check.alone.values()]
        return {
            "reliability": pictures.reliability_png(scores),
            "confusion": pictures.confusion_png(scores, self.check.labels),
        }

    def figures(self) -> tuple[Figure, ...]:
        captions = {
            "reliability": "Share of right answers over their probability; shaded, a perfectly calibrated classifier",
            "confusion": "Confusion: rows are the true contents",
        }
        return tuple(Figure(png, captions[name]) for name, png in self.pictures().items())

    def entries(self) -> list[dict[str, Any]]:
        """The entries of an evaluation: one for all modalities together, one for each alone."""
        return [self._entry(one) for one in (self.check.score, *self.check.alone.values())]

    def as_json(self) -> dict[str, Any]:
        return {"classification": self.entries()}

    def _entry(self, score: ClassificationScore) -> dict[str, Any]:
        entry = to_json(score) | {"labels": self.check.labels, "recommended": score is self.check.score}
        if score is not self.check.score:
            return entry
        return entry | to_json(self.check) | {"bins_inside": self.check.inside[0], "bins": self.check.inside[1]}


def format_promise(check: ModelCheck) -> str:
    """Whether the accuracy equals the promise of the model's file."""
    if check.trained:
        count = int(check.score.trials.sum())
        return f"not judged: {check.trained} of {count} trials trained this model, so they do not test it"
    if check.promised is None or check.expected is None:
        return "nothing: the file holds no accuracy"
    better = check.score.accuracy.value > check.expected[1]
    verdict = "kept" if check.kept else "NOT kept: the accuracy is higher than promised" if better else "NOT kept"
    promised = "{:.1%} ({:.1%} to {:.1%})".format(check.promised.value, *check.promised.interval)
    return f"{verdict}: {promised}; {{:.1%}} to {{:.1%}} expected of this number of trials".format(*check.expected)


def format_drifted(check: ModelCheck) -> str:
    """The features that are farthest from those of the training trials."""
    named = ", ".join(f"{name} by {by:+.1f}" for name, by in list(check.drifted.items())[:3])
    more = f" and {len(check.drifted) - 3} more" if len(check.drifted) > 3 else ""
    return (
        f"{named}{more} deviations of the training trials, on average: check the sensor's zero and gain, or train again"
    )


def format_calibration(check: ModelCheck) -> str:
    """Whether the posteriors are calibrated."""
    verdict = "inside" if check.calibration_kept else "NOT inside"
    return (
        f"{verdict} the {check.score.level:.0%} band of a perfectly calibrated classifier: "
        f"{check.calibrated:.0%} of perfectly calibrated ones deviate more; {check.inside[0]} of "
        f"{check.inside[1]} bins lie in their bands, error {check.score.calibration_error:.1%}"
    )


def check_page(result: ClassifierCheckResult, seed: int, settings: Mapping[str, object]) -> str:
    """The check as one HTML page."""
    check = result.check
    well = check.calibration_kept and check.kept is not False and not check.trained
    words = (f"Promised: {format_promise(check)}.", f"Calibration: {format_calibration(check)}.")
    verdict = ReportVerdict(format_right(check.score), words, hexadecimal(GOOD if well else WARN))
    sections = [Section("", [verdict, *result.tables()]), Section("Answers", list(result.figures()))]
    return html_report(
        f"A classifier on new trials: {result.name}", [*sections, *provenance_sections(seed=seed, settings=settings)]
    )
