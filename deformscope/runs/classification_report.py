"""A classification as one HTML page, with the figures of Thesis chapter 2.

Accuracy of the classification of a container's content, for own tables and data sets of squeezes."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from deformscope.config import ClassifyConfig
from deformscope.executor.local import core_count
from deformscope.file_io import resolve
from deformscope.files.classifier_file import save_classifier
from deformscope.files.squeeze_dataset import SqueezeDataset
from deformscope.files.table_file import read_table, table_of_arrays
from deformscope.pictures import classification as pictures
from deformscope.pictures.palette import GOOD, IDLE, WARN, hexadecimal
from deformscope.pictures.report import Figure, Part, ReportVerdict, Section, Table, html_report
from deformscope.plain import Json
from deformscope.results.render import to_columns, to_json
from deformscope.runs.calibration_report import provenance_sections
from deformscope.runs.result import LibraryResult
from deformscope.stages.squeeze.evaluation import Evaluation, EvaluationOptions, ModalityComparison, Progress, evaluate
from deformscope.stages.squeeze.groupings import ALPHA
from deformscope.stages.squeeze.model import ContentModel, fit_model
from deformscope.stages.squeeze.scores import ClassificationScore
from deformscope.stages.squeeze.table import LabelledTable, refuse_duplicates, without_duplicates
from deformscope.stages.squeeze.trial_run import Method, joined_name
from deformscope.version import __version__

QUICK_SPLITS = 30
"""With --quick."""

TableSource: TypeAlias = str | Path | LabelledTable | Mapping[str, object]
"""A table's file, a table, or arrays by name: `label (N,)`, optional `group (N,)`, and (N, ...) of each modality."""


@dataclass(frozen=True, slots=True)
class ClassificationResult(LibraryResult):
    """Accuracy of contents. name: name of the table; evaluation: every number"""

    evaluation: Evaluation
    name: str = ""

    @property
    def accuracy(self) -> float:
        """Accuracy of the model of `model()`: late fusion of the modalities, in the strictest splits."""
        return self.evaluation.best.accuracy.value

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of that accuracy, in the containers that were squeezed."""
        return self.evaluation.best.accuracy.interval

    def __repr__(self) -> str:
        return f"<{format_told(self.evaluation, self.evaluation.trusted)}>"

    def model(self, progress: Progress | None = None) -> ContentModel:
        """A classifier trained on all trials; `predict_proba` names contents from new features."""
        found, best = self.evaluation, self.evaluation.trusted
        promised = {
            "accuracy": best.accuracy.value,
            "interval": found.elsewhere(best),
            "balanced_accuracy": best.balanced.value,
            "level": best.level,
            "protocol": found.protocol,
            "trials": len(found.table),
        }
        return fit_model(
            found.table,
            by_group=found.protocol == "group",
            seed=found.options.seed,
            promised=promised,
            provenance={"deformscope": __version__, "source": self.name},
            progress=progress,
        )

    def save(self, path: Path | str) -> None:
        """Write `model()` as a file (.npz, no pickle)."""
        save_classifier(self.model(), Path(path))

    def entries(self) -> list[Json]:
        """The command's JSON: one entry per modality, method and kind of split."""
        return [self._entry(one) for one in self.evaluation.scores]

    def as_json(self) -> Json:
        return {"classification": self.entries()}

    def _entry(self, score: ClassificationScore) -> dict[str, Any]:
        found = self.evaluation
        labels = found.table.classes
        entry = to_json(score) | {
            "labels": labels,
            "recall": [
                {"label": label, "value": score.shares[index, index], "interval": score.share_interval(index, index)}
                for index, label in enumerate(labels)
            ],
            "tested_trials": score.trials,
            "components": score.components,
            "split_accuracy": score.split_accuracy,
            "recommended": score is found.best,
        }
        if score is found.best:
            entry |= {"interval_elsewhere": found.elsewhere(found.trusted), "near_copies": found.copies}
            entry["without_near_copies"] = None if found.without_copies is None else to_json(found.without_copies)
        if score.pair is not None:
            return entry | {"trained_on": score.pair[0], "tested_on": score.pair[1]}
        if score.protocol == found.protocol:
            key = score.modality, score.method
            entry["comparisons"] = [_compared(one, labels) for one in found.comparisons if one.first == key]
            entry["learning_curve"] = [to_json(one) for one in found.curve if (one.modality, one.method) == key]
            if score.method in ("pooled", "late-fusion"):
                steps = score.modality if score.method == "pooled" else joined_name(tuple(found.table.series))
                entry["steps"] = [to_json(one) | {"modality": steps} for one in found.steps.get(steps, ())]
            if score.method == "knn" and score.modality in found.clusters:
                rand = found.clusters[score.modality].rand
                entry["k_means"] = {"clusters": len(labels), "adjusted_rand": rand.mean(), "deviation": rand.std()}
            if score.method == "qda" and score.modality in found.normality:
                normal = found.normality[score.modality]
                entry["lilliefors"] = {"pooled_p": normal.pooled, "within_p": normal.within}
        return entry

    def tables(self) -> tuple[Table, ...]:
        found = self.evaluation
        table = found.table
        sizes = [int((table.label == one).sum()) for one in table.classes]
        rows: list[tuple[str, str]] = [
            *([("without near copies", format_told(found, found.without_copies))] if found.without_copies else []),
            ("result" if not found.copies else "with near copies", format_told(found, found.best)),
            ("trials", f"{len(table)} of {len(table.classes)} classes, {min(sizes)} to {max(sizes)} each"),
        ]
        if table.group is not None:
            rows.append(("groups", str(len(np.unique(table.group)))))
        rows += [(name, f"{values.shape[1]} features") for name, values in table.modalities.items()]
        if len(table.fused[0]) > 1:
            rows.append(("fusion", format_fusion(found)))
        rows += [("note", one) for one in found.notes]
        return (
            Table(rows, caption=f"Contents of {self.name}" if self.name else "Contents"),
            *score_tables(found, every=False),
        )

    def figures(self) -> tuple[Figure, ...]:
        found = self.evaluation
        strict = [one for one in found.scores if one.protocol == found.protocol]
        return (
            Figure(pictures.accuracies_png(strict), "Accuracy of every method, with its interval"),
            Figure(pictures.confusion_png([found.best], found.table.classes), "Confusion: rows are the true contents"),
            Figure(pictures.reliability_png([found.best]), "Share of right answers over their probability"),
        )


def format_accuracy(score: ClassificationScore) -> str:
    """Accuracy with its interval, and that of always naming the most frequent class."""
    method = f"{score.modality}, {score.method}, {score.splits} {format_split(score)}"
    return f"{format_right(score)}, chance {score.chance:.1%}: {method}"


def format_told(found: Evaluation, score: ClassificationScore) -> str:
    """See `format_accuracy`; without groups the interval for another container comes first."""
    if found.protocol == "group":
        return format_accuracy(score)
    low, high = found.elsewhere(score)
    (near_low, near_high), method = score.accuracy.interval, f"{score.modality}, {score.method}"
    return (
        f"{score.accuracy.value:.1%} right; in another container or session {low:.1%} to {high:.1%}, in new "
        f"trials of the same containers {near_low:.1%} to {near_high:.1%} ({score.level:.0%} intervals), "
        f"chance {score.chance:.1%}: {method}, {score.splits} {format_split(score)}"
    )


def format_right(score: ClassificationScore) -> str:
    """Accuracy with its interval."""
    low, high = score.accuracy.interval
    return f"{score.accuracy.value:.1%} right ({score.level:.0%} interval {low:.1%} to {high:.1%})"


def format_split(score: ClassificationScore) -> str:
    """What the splits keep separate, as text."""
    if score.pair is not None:
        return f"transfer from {score.pair[0]} to {score.pair[1]}"
    return {"random": "random splits", "stratified": "stratified splits", "group": "splits by group"}[score.protocol]


def format_fusion(found: Evaluation) -> str:
    """Text on the gain of late fusion, for each class, as far as the intervals show it."""
    names = found.table.fused[0]
    singles = {name: found.score(name, "pooled") for name in names}
    better = max(singles, key=lambda name: singles[name].accuracy.value)
    late = joined_name(names), "late-fusion"
    labels = found.table.classes
    worse, gained = [], []
    whole = ""
    for one in found.comparisons:
        if one.first == late and one.second == (better, "pooled"):
            low, high = one.difference.interval
            sure = "better than" if low > 0 else "worse than" if high < 0 else "not distinguishable from"
            whole = f"late fusion is {sure} {better} alone ({one.difference.value:+.1%}, {low:+.1%} to {high:+.1%})"
        if one.first == late and one.second[1] == "pooled":
            worse += [f"{labels[c]} (than {one.second[0]})" for c, by in enumerate(one.by_class) if by.interval[1] < 0]
            gained += [labels[c] for c, by in enumerate(one.by_class) if one.second[0] == better and by.interval[0] > 0]
    words = [whole or "late fusion was not compared"]
    if gained:
        words.append(f"better in {', '.join(gained)}")
    words.append(f"WORSE in {', '.join(worse)}" if worse else "in no class worse than the better modality")
    return "; ".join(words)


def _compared(one: ModalityComparison, labels: Sequence[str]) -> dict[str, Any]:
    by_class = [
        {"label": label, "difference": by.value, "interval": by.interval}
        for label, by in zip(labels, one.by_class, strict=True)
    ]
    return to_json(one) | {"with_modality": one.second[0], "with_method": one.second[1], "by_class": by_class}


def score_tables(found: Evaluation, *, every: bool = True) -> tuple[Table, ...]:
    """Every method in every kind of split, and transfers; every: score all kinds of splits; otherwise only the
    strictest, and the recommended methods."""
    names: tuple[str, ...] = ()
    made, others = [], []
    for what in dict.fromkeys((one.protocol, one.pair) for one in found.scores):
        mine = [one for one in found.scores if (one.protocol, one.pair) == what]
        words, (names, rows) = format_split(mine[0]), to_columns(mine)
        if every or what[0] == found.protocol:
            caption = f"{words[0].upper()}{words[1:]}, chance {mine[0].chance:.1%}"
            made.append(Table(rows, names, caption))
        else:
            best = found.best
            others += [
                (words, *row)
                for one, row in zip(mine, rows, strict=True)
                if one.method == best.method and (one.modality == best.modality or one.pair is not None)
            ]
    if others:
        made.append(Table(others, ("splits", *names), "Other splits"))
    return tuple(made)


def classify_table(
    table: LabelledTable,
    name: str,
    options: EvaluationOptions,
    progress: Progress | None = None,
    beyond: LabelledTable | None = None,
) -> ClassificationResult:
    """Evaluate a table as `classify` does; linear algebra uses one thread, because splits run in parallel. beyond: as
    in `evaluate`"""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        found = evaluate(table, dataclasses.replace(options, workers=core_count()), progress, beyond)
    return ClassificationResult(found, name)


def table_from(
    source: TableSource,
    *,
    modalities: Sequence[str] | None = None,
    merge: Mapping[str, Sequence[str]] | None = None,
    duplicates: Literal["refuse", "drop"] = "refuse",
) -> LabelledTable:
    """A table from any supported source, in the form that is evaluated."""
    if isinstance(source, LabelledTable):
        table = source
    elif isinstance(source, str | Path):
        path = resolve(source)
        table = SqueezeDataset(path).table() if path.is_dir() else read_table(path)
    else:
        table = table_of_arrays({name: np.asarray(values) for name, values in source.items()})
    table = table if modalities is None else table.of(modalities)
    table = table.merged(merge or {})
    if duplicates == "drop":
        return without_duplicates(table)
    refuse_duplicates(table)
    return table


def options_of(config: ClassifyConfig, transfer: tuple[tuple[str, str], ...]) -> EvaluationOptions:
    """The flags as options of an evaluation."""
    splits = (min(config.splits, QUICK_SPLITS), 0) if config.quick else (config.splits, config.curve_splits)
    return EvaluationOptions(*splits, level=config.level, seed=config.output.seed, transfer=transfer)


THESIS_METHODS: tuple[Method, ...] = ("knn", "qda")
RAW_METHODS: tuple[Method, ...] = ("linear",)
MOST_CONFUSED = 10
"""Pairs of contents in a table."""
FIGURES = {
    "mean": "mean features of each class, on one scale (as Thesis figures 2.6 and 2.7)",
    "clusters": "trials on the two largest components: contents, and clusters with centroids (as figures 2.9, 2.10)",
    "curve": "accuracy over the share of the training trials (as figure 2.11)",
    "confusion": "confusion matrices of single modalities (as figures 2.12 and 2.13)",
    "raw": "confusion matrices without principal components (as figure 2.14)",
    "fusion": "share of right answers in each class, by each modality and by late fusion",
    "fused": "confusion matrices of early and late fusion",
    "transfer": "trained on one kind of container and tested on another",
    "reliability": "share of right answers over their probability, with a perfectly calibrated classifier",
    "steps": "posterior during the squeeze",
    "accuracies": "accuracy of every method with its interval",
}
"""Caption of each picture, by the start of its name."""


def classification_pictures(result: ClassificationResult) -> dict[str, bytes]:
    """The pictures as PNG, by a name that is valid for a file; a picture without data is left out."""
    return dict(_pictures(result.evaluation))


def _pictures(found: Evaluation) -> Iterator[tuple[str, bytes]]:
    table = found.table
    labels, names = table.classes, table.fused[0]
    single = list(table.modalities)
    shown = [*single, *map(joined_name, table.fused)]
    strict = [one for one in found.scores if one.protocol == found.protocol]
    yield "accuracies", pictures.accuracies_png(strict)
    for name in single:
        yield f"mean-{name}", pictures.mean_images_png(table, name)
    for name, clusters in found.clusters.items():
        yield f"clusters-{name}", pictures.clusters_png(table, clusters, name)
    if found.curve:
        yield "curve", pictures.curve_png(found)
    for start, methods in (("confusion", THESIS_METHODS), ("raw", RAW_METHODS)):
        for method in methods:
            of_method = [one for one in strict if one.method == method and one.modality in shown]
            yield f"{start}-{method}", pictures.confusion_png(of_method, labels)
    if len(names) > 1:
        yield "fusion", pictures.fusion_png(found)
        fused = [*(found.score(name, "pooled") for name in names), found.best]
        yield "fused", pictures.confusion_png(fused, labels)
    if any(one.pair is not None for one in found.scores):
        yield "transfer", pictures.transfer_png(found)
    calibrated = [found.score(name, "pooled") for name in names]
    yield "reliability", pictures.reliability_png([*calibrated, found.best] if len(names) > 1 else calibrated)
    if found.steps:
        yield "steps", pictures.steps_png(found)


def classification_page(
    result: ClassificationResult,
    model: ContentModel,
    drawn: Mapping[str, bytes],
    settings: Mapping[str, object],
    *besides: Section,
) -> str:
    """All results as one HTML page. model: model trained on all trials; drawn: result of `classification_pictures`;
    settings: the command's settings; besides: sections that come after the first"""
    title = f"Contents of containers: {result.name}" if result.name else "Contents of containers"
    first, *others = _sections(result, model, drawn, settings)
    return html_report(title, [first, *besides, *others])


def _sections(
    result: ClassificationResult, model: ContentModel, drawn: Mapping[str, bytes], settings: Mapping[str, object]
) -> list[Section]:
    found = result.evaluation

    def of(*starts: str) -> list[Part]:
        return [
            Figure(png, ": ".join((FIGURES[name.split("-")[0]].capitalize(), *name.split("-", 1)[1:])) + ".")
            for name, png in drawn.items()
            if name.split("-")[0] in starts
        ]

    summary = result.tables()[0]
    sections = [
        Section("", [_verdict(found), summary]),
        Section("Accuracy", [*of("accuracies"), PROTOCOL_WORDS, *score_tables(found, every=False)]),
        Section("What was measured", of("mean")),
        Section("Natural groupings", [*of("clusters"), *_groupings(found)]),
        Section("Confusions", [_confused(found), CONFUSION_WORDS, *of("confusion", "raw")]),
    ]
    if len(found.table.fused[0]) > 1:
        sections.append(
            Section("Fusion", [f"{_sentence(format_fusion(found))}.", *of("fusion", "fused"), _weights(model)])
        )
    if found.comparisons:
        names, rows = to_columns(found.comparisons)
        sections.append(
            Section("Comparisons", [Table(rows, names, "The same splits, by the corrected resampled t-test")])
        )
    if found.curve:
        sections.append(Section("Accuracy over the number of trials", of("curve")))
    if steps := of("steps"):
        sections.append(Section("During the squeeze", steps))
    if transfer := of("transfer"):
        sections.append(Section("Transfer", [TRANSFER_WORDS, *transfer]))
    sections.append(Section("Calibration", [CALIBRATION_WORDS, *of("reliability")]))
    sections.append(Section("Every method in all splits", score_tables(found)))
    return [*sections, *provenance_sections(seed=found.options.seed, settings=settings)]


PROTOCOL_WORDS = (
    "Scaling, principal components, classifiers, calibration and fusion are learned inside the training side "
    "of each split (70 %). Random splits are the thesis's; splits by group leave whole containers or "
    "sessions out, as for a new container. Intervals are Wilson's for the effective number of independent "
    "trials. Splits share trials (Nadeau and Bengio 2003) and trials of a group may err together, which "
    "reduces it. knn and qda use the components that hold 80 % of the variance; qda-raw and linear "
    "all of them. pooled combines all of these, with weights calibrated on training trials left out."
)
CONFUSION_WORDS = (
    "Each row adds up to 100 % and gives the classifications of the trials of one content, with Wilson's "
    "interval below where classes are few."
)
TRANSFER_WORDS = (
    "All trials of one kind train, all trials of the other test; trials of a group count as fewer in the intervals."
)
CALIBRATION_WORDS = (
    "Of the answers with probability 80 %, 80 % should be right. The band contains a perfectly calibrated "
    "classifier, for this number of trials; the dots' areas are the numbers of answers."
)


def _verdict(found: Evaluation) -> ReportVerdict:
    best = found.trusted
    low, _ = best.accuracy.interval
    color = GOOD if low > best.chance else WARN if best.accuracy.value > best.chance else IDLE
    known = "better than chance" if low > best.chance else "NOT distinguishable from chance"
    words = (f"Contents are known {known}.", *(f"Note: {one}." for one in found.notes))
    return ReportVerdict(_sentence(format_told(found, best)), words, hexadecimal(color))


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}"


def _groupings(found: Evaluation) -> list[Part]:
    rows = []
    for name, clusters in found.clusters.items():
        rand = f"{clusters.rand.mean():.2f} ± {clusters.rand.std():.2f}"
        normal = found.normality.get(name)
        within = "–" if normal is None else "{} of {}".format(*normal.normal_within)
        pooled = "–" if normal is None else "{} of {}".format(*normal.normal_pooled)
        rows.append((name, str(len(clusters.centroid)), rand, within, pooled))
    names = ("modality", "clusters", "adjusted Rand index", "normal within class", "normal over all")
    words = (
        "The adjusted Rand index is 1 if the clusters equal the contents and 0 if they are independent of "
        "them; mean and standard deviation of 10 runs. Normal: components whose Lilliefors p-value is above "
        f"{ALPHA:g}. QDA assumes normal classes; 95 % of truly normal ones pass."
    )
    return [Table(rows, names), words]


def _weights(model: ContentModel) -> Table:
    """Reliability of each modality for each class."""
    rows = [
        (label, *(f"{weight:.2f}" for weight in weights))
        for label, weights in zip(model.labels, model.fusion.weight.T, strict=True)
    ]
    caption = (
        "Weight of each modality's log posterior in late fusion, fitted on all trials: 1 = Bayes' rule, 0 = ignored"
    )
    return Table(rows, ("content", *model.modalities), caption)


def _confused(found: Evaluation) -> Table:
    """The pairs of contents that are confused most often."""
    best, labels = found.best, found.table.classes
    shares = np.nan_to_num(best.shares - np.diag(np.diagonal(best.shares)))
    order = np.argsort(-shares, axis=None)[:MOST_CONFUSED]
    pairs = [(int(one) // len(labels), int(one) % len(labels)) for one in order if shares.flat[one] > 0.0]
    rows = [
        (
            labels[truth],
            labels[answer],
            f"{shares[truth, answer]:.1%}",
            "{:.1%} to {:.1%}".format(*best.share_interval(truth, answer)),
        )
        for truth, answer in pairs
    ]
    return Table(rows, ("true", "named", "share", "interval"), f"Most often confused by {best.modality}, {best.method}")
