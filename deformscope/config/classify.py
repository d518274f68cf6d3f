"""`deformscope classify`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from deformscope.config import flags
from deformscope.config.options import OutputOptions, RecordedOptions, Written, either
from deformscope.errors import InputError

NamesFlag = Annotated[
    tuple[str, ...] | None,
    flags.one_word("NAME,NAME...", lambda text: tuple(part for part in text.split(",") if part), flags.joined(",")),
    flags.unset,
]
PLACE = flags.Rule(
    lambda path: path.suffix in ("", ".html"),
    "a folder or a file that ends in .html after {flag}",
    show=lambda path: repr(str(path)),
)


@dataclass(frozen=True, slots=True)
class ClassifyConfig(RecordedOptions):
    """Find out how well the content of containers is known from what was measured when they were squeezed: from each
    modality, and from all of them fused. Everything is learned inside the training side of each split."""

    table: Annotated[Path, Positional, arg(metavar="DATASET|TABLE"), flags.Reads()]
    """A data set of `deformscope squeeze`, or a table (.npz, .csv or .parquet) with a label for each trial, and its
    features by modality."""
    modalities: NamesFlag = None
    """Take these alone, in that order; default: all."""
    merge: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="NAME=A,B...", help_behavior_hint="(repeatable)")
    ] = ()
    """Classes that become one, such as liquid=water,yogurt."""
    transfer: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="TRAINED:TESTED", help_behavior_hint="(repeatable)")
    ] = ()
    """Train on one kind of container and test on another (groups, where the table has no `kind`), * = any letters, as
    in 'box-*:cylinder-*'; default: from each kind to each other one."""
    splits: Annotated[int, flags.least(2)] = 200
    """Random, stratified and, where the table has `group`, group-wise splits, 70 % to train and 30 % to test."""
    costly_splits: Annotated[int, flags.least(0)] = 10
    """Splits of gradient boosting and the Gaussian process, which take long; 0 = without them."""
    curve_splits: Annotated[int, flags.least(0)] = 40
    """Splits of the learning curve, and of each step of a squeeze; 0 = without them."""
    quick: bool = False
    """At most 30 splits, and neither costly classifiers nor a learning curve."""
    plain_qda: bool = False
    """Try the thesis's quadratic discriminant analysis too, whose covariances are of one class alone, without shrinkage
    (`qda-plain`); a class needs more trials than components then."""
    duplicates: Literal["refuse", "drop"] = "refuse"
    """What happens to trials with the same features: they would be recognised across a split."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    model: Annotated[Path | None, flags.one_word("MODEL.npz", Path), flags.unset, flags.Reads()] = None
    """Train nothing: name these trials, which must be new, by a classifier that was saved, and find out whether it
    keeps its promise."""
    save: flags.ModelFlag = None
    """Write the classifier, trained on all trials (.npz, no pickle): late fusion of the modalities."""
    report: Annotated[Path | None, flags.one_word("FOLDER|FILE.html", Path), flags.unset, PLACE] = None
    """Write all that was found with pictures: one HTML page, or a folder that has the pictures as PNG beside it. What
    stands there is replaced."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        parse_merges(self.merge)
        parse_transfers(self.transfer)
        either("--model", "--save", self.model, self.save)
        either("--model", "--transfer", self.model, self.transfer)

    @property
    def page(self) -> Path | None:
        """The HTML page of the report."""
        if self.report is None or self.report.suffix == ".html":
            return self.report
        return self.report / "classification.html"

    def writes(self) -> tuple[Written, ...]:
        page = self.report is not None and self.report.suffix == ".html"
        return (*RecordedOptions.writes(self), *((Written("--report", self.report),) if page and self.report else ()))


def parse_merges(texts: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """New class -> classes that become it."""
    found: dict[str, tuple[str, ...]] = {}
    for text in texts:
        name, equals, members = text.partition("=")
        if not (name and equals and members) or name in found:
            raise InputError("--merge NAME=A,B, each NAME once", repr(text), "--merge liquid=water,yogurt")
        found[name] = tuple(part for part in members.split(",") if part)
    named = [one for members in found.values() for one in members]
    if len(set(named)) < len(named):
        raise InputError("each class in one --merge", "one in several")
    return found


def parse_transfers(texts: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Pairs of patterns."""
    found = []
    for text in texts:
        train, colon, test = text.partition(":")
        if not (train and colon and test):
            raise InputError("--transfer TRAINED:TESTED", repr(text), "--transfer 'box-*:cylinder-*'")
        found.append((train, test))
    return tuple(found)
