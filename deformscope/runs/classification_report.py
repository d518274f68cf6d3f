"""A classification as one HTML page, with the figures of Thesis chapter 2."""

from collections.abc import Iterator, Mapping

import numpy as np

from deformscope.pictures import classification as pictures
from deformscope.pictures.palette import GOOD, IDLE, WARN, hexadecimal
from deformscope.pictures.report import Figure, Part, ReportVerdict, Section, Table, html_report
from deformscope.results.render import to_columns
from deformscope.runs.calibration_report import provenance_sections
from deformscope.runs.classification import ClassificationResult, format_fusion, format_told, score_tables
from deformscope.stages.squeeze.evaluation import Evaluation
from deformscope.stages.squeeze.groupings import ALPHA
from deformscope.stages.squeeze.model import ContentModel
from deformscope.stages.squeeze.trial_run import Method, joined_name

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
            Figure(png, f"{FIGURES[name.split('-')[0]].capitalize()}{_which(name)}.")
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


def _which(name: str) -> str:
    rest = name.split("-", 1)[1] if "-" in name else ""
    return f": {rest}" if rest else ""


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
