"""`deformscope classify`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from deformscope.config import flags
from deformscope.config.options import OutputOptions, RecordedOptions, Written
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
    """Evaluate how well the content of containers is classified from measurements of squeezes: by each modality, and by
    all modalities fused. Every split fits all its parameters on its training side alone."""

    table: Annotated[Path, Positional, arg(metavar="DATASET|TABLE"), flags.Reads()]
    """A data set of `deformscope squeeze`, or a table (.npz, .csv or .parquet) with a label and features by modality
    for each trial."""
    modalities: NamesFlag = None
    """Use these modalities alone, in this order; default: all."""
    merge: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="NAME=A,B...", help_behavior_hint="(repeatable)")
    ] = ()
    """Classes to merge, such as liquid=water,yogurt."""
    transfer: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="TRAINED:TESTED", help_behavior_hint="(repeatable)")
    ] = ()
    """Train on one kind of container and test on another (groups, where the table has no `kind`), with * for any
    letters, as in 'box-*:cylinder-*'; default: from each kind to every other one."""
    splits: Annotated[int, flags.least(2)] = 200
    """Number of random, stratified splits, 70 % to train and 30 % to test; group-wise if the table has `group`."""
    curve_splits: Annotated[int, flags.least(0)] = 40
    """Splits of the learning curve, and of each step of a squeeze; 0 = without them."""
    quick: bool = False
    """At most 30 splits, without learning curve."""
    duplicates: Literal["refuse", "drop"] = "refuse"
    """How to treat trials with the same features: a classifier would recognise them across a split."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    save: flags.ModelFlag = None
    """Write the classifier, trained on all trials (.npz, no pickle): late fusion of the modalities."""
    report: Annotated[Path | None, flags.one_word("FOLDER|FILE.html", Path), flags.unset, PLACE] = None
    """Write the whole result with pictures: one HTML page, or a folder with the page and PNG files. An existing page is
    replaced."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        parse_merges(self.merge)
        parse_transfers(self.transfer)

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
    """Maps each new class to the classes that are merged into it."""
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
    """Pairs of patterns: kinds that train, and kinds that are tested."""
    found = []
    for text in texts:
        train, colon, test = text.partition(":")
        if not (train and colon and test):
            raise InputError("--transfer TRAINED:TESTED", repr(text), "--transfer 'box-*:cylinder-*'")
        found.append((train, test))
    return tuple(found)
