"""Tables of labelled trials: what does not fit together, and trials that stand there twice."""

import dataclasses

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.squeeze.table import LabelledTable, duplicates, refuse_duplicates, without_duplicates
from tests.stages.squeeze.trials import blobs, two_modalities

LABEL = np.array(["a", "b", "a"])


def test_what_does_not_fit_together_is_refused() -> None:
    features = {"touch": np.eye(3)}
    for table, said in (
        (lambda: LabelledTable(LABEL, None, {}), "got none"),
        (lambda: LabelledTable(LABEL, np.array(["g"]), features), "a group for each of 3 labels"),
        (lambda: LabelledTable(LABEL, None, {"touch": np.eye(2)}), "3 rows of features in touch"),
        (lambda: LabelledTable(LABEL, None, {"touch": np.array([[0.0], [np.inf], [1.0]])}), "infinity in row 2"),
        (lambda: LabelledTable(LABEL, None, {"touch": np.full((3, 2), np.nan)}), "none at all"),
        (lambda: LabelledTable(np.array(["a", "a", "a"]), None, features), "two different labels; got 'a'"),
    ):
        with pytest.raises(InputError) as refusal:
            table()
        assert said in str(refusal.value)


def test_equal_trials_are_found_in_all_modalities_together_and_named() -> None:
    table = two_modalities()
    for values in table.modalities.values():
        values[7] = values[2]
        values[30] = values[2]
    table.modalities["touch"][11] = table.modalities["touch"][12]
    assert duplicates(table) == [(2, 7, 30)]
    with pytest.raises(InputError, match="row 3 = row 8 = row 31 with the same features"):
        refuse_duplicates(table)
    named = dataclasses.replace(table, trial=np.array([f"t{row}" for row in range(len(table))]))
    with pytest.raises(InputError, match="trial t2 = trial t7"):
        refuse_duplicates(named)


def test_copies_are_dropped_unless_their_labels_differ() -> None:
    table = blobs()
    table.modalities["touch"][4] = table.modalities["touch"][1]
    kept = without_duplicates(table)
    assert len(kept) == len(table) - 1
    np.testing.assert_array_equal(kept.modalities["touch"][4], table.modalities["touch"][5])
    table.modalities["touch"][20] = table.modalities["touch"][1]
    with pytest.raises(InputError, match="one label"):
        without_duplicates(table)


def test_classes_can_be_merged() -> None:
    merged = two_modalities().merged({"granular": ("flour", "rice")})
    assert merged.classes == ("empty", "granular", "water")
    assert (merged.label == "granular").sum() == 32
    with pytest.raises(InputError, match="'sand'"):
        merged.merged({"hard": ("sand",)})
