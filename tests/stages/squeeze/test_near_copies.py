"""Copies that are told from trials that are alike, and intervals that do not rest on what copies or containers say."""

import itertools

import numpy as np
import pytest

from deformscope.runs.classification_report import ClassificationResult, format_told
from deformscope.stages.squeeze.evaluation import Evaluation, EvaluationOptions, evaluate
from deformscope.stages.squeeze.groupings import near_copies
from deformscope.stages.squeeze.scores import difference, over_splits
from deformscope.stages.squeeze.table import LabelledTable
from studies.independent.labelled_rows import rows_of
from tests.stages.squeeze.trials import blobs, noise, two_modalities

FEW = EvaluationOptions(8, 0)


def copied(table: LabelledTable, rows: list[int], by: float, *, elsewhere: bool = True) -> LabelledTable:
    """With copies of some rows that differ by so many deviations of a column, in another group of the same label."""
    rng = np.random.default_rng(5)
    more = table.rows(np.array(rows))
    assert more.group is not None
    group = np.array([f"{one}-copy" for one in more.group]) if elsewhere else more.group
    features = {
        name: np.concatenate([values, values[rows] + by * values.std(axis=0) * rng.normal(size=values[rows].shape)])
        for name, values in table.modalities.items()
    }
    assert table.group is not None
    label, groups = np.concatenate([table.label, more.label]), np.concatenate([table.group, group])
    return LabelledTable(label, groups, features)


@pytest.mark.parametrize("by", [1e-9, 1e-6, 1e-4])
def test_copies_in_other_groups_are_found_and_nothing_else(by: float) -> None:
    table, rows = two_modalities(40), [3, 17, 88, 120]
    assert near_copies(copied(table, rows, by)) == [(row, len(table) + at) for at, row in enumerate(rows)]
    assert near_copies(copied(table, rows, by, elsewhere=False)) == []


@pytest.mark.parametrize("columns", [1, 2, 6, 40])
def test_trials_that_are_alike_by_chance_are_no_copies(columns: int) -> None:
    found = 0
    for seed in range(40):
        found += len(near_copies(noise(3, 30, columns, seed=seed)))
        found += len(near_copies(blobs(each=30, columns=columns, apart=30.0, seed=seed)))
    assert found <= 4  # 0.8 are expected


def test_a_table_copied_whole_is_found() -> None:
    table = blobs(each=30)
    assert len(near_copies(copied(table, list(range(len(table))), 1e-6))) == len(table)


def test_accuracy_without_copies_is_told_and_promised() -> None:
    rows = rows_of("copies", 2003)
    table = LabelledTable(rows.label.astype(np.str_), rows.container.astype(np.str_), {"touch": rows.features})
    result = ClassificationResult(found := evaluate(table, FEW))
    label, features = rows.new()
    model = result.model()
    truth = (model.predict_proba({"touch": features}).argmax(axis=1) == label).mean()
    low, high = found.without_copies.accuracy.interval
    assert low <= truth <= high < found.best.accuracy.value
    assert model.promised["interval"] == (low, high)
    assert list(dict(row[:2] for row in result.tables()[0].rows))[:2] == ["without near copies", "with near copies"]
    assert any("row 1 ~ row 121" in note for note in found.notes)
    entry = next(one for one in result.entries() if one["recommended"])
    assert len(entry["near_copies"]) == 120
    assert entry["without_near_copies"]["accuracy"] == found.without_copies.accuracy.value


def without_groups(seed: int) -> tuple[Evaluation, float]:
    """Labels that features have nothing to do with, containers that nobody told, and the truth in new containers."""
    rows = rows_of("untold-random", seed)
    found = evaluate(LabelledTable(rows.label.astype(np.str_), None, {"touch": rows.features}), FEW)
    label, features = rows.new()
    posterior = ClassificationResult(found).model().predict_proba({"touch": features})
    return found, float((posterior.argmax(axis=1) == label).mean())


@pytest.mark.slow
def test_without_groups_the_interval_for_another_container_comes_first_and_holds() -> None:
    found, truth = without_groups(2000)
    low, high = found.best.accuracy.interval
    assert truth < low  # what the splits say is wrong there
    assert found.elsewhere(found.best)[0] <= truth <= found.elsewhere(found.best)[1]
    words = format_told(found, found.best)
    assert words.index("in another container or session") < words.index(f"{low:.1%} to {high:.1%}")
    assert ClassificationResult(found).model().promised["interval"] == found.elsewhere(found.best)
    told = evaluate(blobs(), FEW)
    assert told.elsewhere(told.best) == told.best.accuracy.interval


def test_no_error_is_not_surer_by_a_jump_than_hardly_any() -> None:
    same, nearly = np.full(50, 0.0), np.full(50, 0.0)
    nearly[0] = -0.01
    for one, other in itertools.pairwise([nearly, same]):
        first, second = over_splits(one, 0.4, 0.9, 40.0), over_splits(other, 0.4, 0.9, 40.0)
        width = [found.interval[1] - found.interval[0] for found in (first, second)]
        assert 0.9 < width[1] / width[0] < 1.1
    p_values = [difference(one, np.full(50, 0.001), 0.4, 0.9, 40.0)[1] for one in (same, nearly)]
    assert p_values[0] == pytest.approx(p_values[1], abs=0.05)
