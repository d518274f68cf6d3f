"""The thesis's results of squeezed containers (5.3 and 5.4), compared with those of the laboratory's squeezes.

The laboratory was not tuned for these findings: a different result is reported as such."""

from dataclasses import dataclass

import numpy as np

from deformscope.stages.squeeze.evaluation import Evaluation
from deformscope.stages.squeeze.scores import ClassificationScore, difference
from deformscope.stages.squeeze.trial_run import Method

HARDNESS = ("empty", "water", "yogurt", "rice", "flour")
"""The thesis's order of growing resistance."""
TOUCH, VISION, SMALL = "tactile", "vision", "vision_small"
BOTH, RAW = f"{TOUCH}+{VISION}", f"{TOUCH}+{SMALL}"
TEST_OVER_TRAIN = 0.3 / 0.7


@dataclass(frozen=True, slots=True)
class FindingComparison:
    """thesis: its reported result; ours: the laboratory's result, with intervals"""

    thesis: str
    ours: str


def compare_findings(five: Evaluation, three: Evaluation) -> list[FindingComparison]:
    """The thesis's statements, each with the result of this reproduction. five: accuracy for all contents; three: for
    empty, liquid, granular"""
    touch, vision, both = (five.score(name, "knn") for name in (TOUCH, VISION, BOTH))
    return [
        FindingComparison("Vision is most informative for water.", _better(five, touch, vision, ("water",))),
        FindingComparison(
            "Of three classes, touch is better for empty and granular contents.",
            _better(three, three.score(TOUCH, "knn"), three.score(VISION, "knn"), ("empty", "granular")),
        ),
        FindingComparison("Touch confuses yogurt with flour or water.", _named(five, touch, "yogurt")),
        FindingComparison(
            "Vision confuses rice and flour with yogurt.",
            f"{_named(five, vision, 'rice')} {_named(five, vision, 'flour')}",
        ),
        FindingComparison(
            f"Contents next to one another ({', '.join(HARDNESS)}) are confused with one another.",
            f"By touch {_neighbours(five, touch)}, by vision {_neighbours(five, vision)}; 40 % is chance.",
        ),
        FindingComparison(
            "Nearest neighbours do better than QDA.",
            "; ".join(_versus(five, (name, "knn"), (name, "qda")) for name in (TOUCH, VISION)) + ".",
        ),
        FindingComparison(
            "Early fusion does not always help: it gains for water, and loses 4 points of touch for yogurt and empty.",
            f"{_versus(five, (BOTH, 'knn'), (TOUCH, 'knn'))}; of touch, "
            + ", ".join(
                f"{one} {_recall(five, touch, one)} becomes {_recall(five, both, one)}"
                for one in ("water", "yogurt", "empty")
            )
            + ".",
        ),
        FindingComparison(
            "Raw touch with the small image gains 4.6 points over both on components.",
            f"{_versus(five, (RAW, 'linear'), (BOTH, 'knn'))}.",
        ),
    ]


def _recall(found: Evaluation, score: ClassificationScore, label: str) -> str:
    at = found.table.classes.index(label)
    low, high = score.share_interval(at, at)
    return f"{score.shares[at, at]:.0%} ({low:.0%} to {high:.0%})"


def _better(found: Evaluation, touch: ClassificationScore, vision: ClassificationScore, labels: tuple[str, ...]) -> str:
    """Which modality classifies more of some contents correctly."""
    words = []
    for label in labels:
        at = found.table.classes.index(label)
        felt, seen = touch.share_interval(at, at), vision.share_interval(at, at)
        verdict = (
            "touch is better"
            if felt[0] > seen[1]
            else "vision is better"
            if seen[0] > felt[1]
            else "no clear difference"
        )
        words.append(
            f"{label}: {verdict}, touch {_recall(found, touch, label)}, vision {_recall(found, vision, label)}."
        )
    seen_best = found.table.classes[int(np.nanargmax(np.diagonal(vision.shares)))]
    return " ".join(f"{one[0].upper()}{one[1:]}" for one in words) + f" Vision is best for {seen_best}."


def _named(found: Evaluation, score: ClassificationScore, label: str) -> str:
    """The classification of a content."""
    at = found.table.classes.index(label)
    named = [(float(score.shares[at, one]), answer) for one, answer in enumerate(found.table.classes) if one != at]
    wrong = ", ".join(f"{answer} {share:.0%}" for share, answer in sorted(named, reverse=True) if share >= 0.005)
    rightly = f"{label[0].upper()}{label[1:]} is classified rightly in {_recall(found, score, label)}"
    return f"{rightly}, else as {wrong or 'nothing'}."


def _neighbours(found: Evaluation, score: ClassificationScore) -> str:
    """Share of the wrong answers that name a neighbour in hardness."""
    place = [HARDNESS.index(label) for label in found.table.classes]
    apart = np.abs(np.subtract.outer(place, place))
    wrong = float(score.confusion[apart > 0].sum())
    return (
        f"{score.confusion[apart == 1].sum() / wrong:.0%} of the errors name a neighbour"
        if wrong
        else "nothing is confused"
    )


def _versus(found: Evaluation, one: tuple[str, Method], other: tuple[str, Method]) -> str:
    """The difference of two accuracies on the same splits."""
    first, second = found.score(*one), found.score(*other)
    gain, _ = difference(first.split_accuracy, second.split_accuracy, TEST_OVER_TRAIN, first.level)
    low, high = gain.interval
    verdict = "gains" if low > 0.0 else "loses" if high < 0.0 else "no clear difference"
    ends = (
        f"{first.accuracy.value:.1%} against {second.accuracy.value:.1%} ({100 * low:+.1f} to {100 * high:+.1f} points)"
    )
    return f"{one[0]}, {one[1]} over {other[0]}, {other[1]}: {verdict}, {ends}"
