"""A trained classifier on new trials: its promise, its posteriors, and what it does with a modality less."""

import dataclasses

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.runs.classifier_check import ClassifierCheckResult
from deformscope.stages.squeeze.model import ContentModel, fit_model
from deformscope.stages.squeeze.model_check import check_model
from tests.stages.squeeze.trials import two_modalities

PROMISED = {"accuracy": 0.97, "interval": (0.95, 0.99)}


@pytest.fixture(scope="module")
def model() -> ContentModel:
    return fit_model(two_modalities(40, seed=1), by_group=False, promised=PROMISED)


def test_new_trials_of_the_same_kind_keep_the_promise_and_are_calibrated(model: ContentModel) -> None:
    found = check_model(model, two_modalities(75, seed=2))
    assert found.kept
    assert found.calibration_kept
    assert found.score.confusion.sum() == 300
    assert found.score.accuracy.value == pytest.approx(np.trace(found.score.confusion) / 300)
    assert found.inside[0] >= found.inside[1] - 2


def test_a_classifier_that_is_too_sure_or_misses_its_promise_is_found_out(model: ContentModel) -> None:
    table = two_modalities(75, seed=2)
    random = np.random.default_rng(0)
    noisy = {name: values + 1.5 * random.normal(size=values.shape) for name, values in table.modalities.items()}
    found = check_model(model, dataclasses.replace(table, modalities=noisy))
    assert not found.kept
    assert not found.calibration_kept
    assert found.score.overconfidence.interval[0] > 0.0


def test_features_that_drifted_are_named_where_a_classifier_fails(model: ContentModel) -> None:
    table = two_modalities(75, seed=2)
    assert check_model(model, table).drifted == {}
    name = next(iter(table.modalities))
    drifting = table.modalities[name].copy()
    drifting[:, 1] += 9.0 * drifting[:, 1].std()
    drifting[:, 0] -= 4.0 * drifting[:, 0].std()
    drifting[::7] = np.nan
    found = check_model(model, dataclasses.replace(table, modalities={**table.modalities, name: drifting}))
    assert not found.kept
    assert list(found.drifted) == [f"{name}[1]", f"{name}[0]"]
    assert list(found.drifted.values()) == pytest.approx([9.0, -4.0], rel=0.3)
    (row,) = (row for row in ClassifierCheckResult(found, len(table)).tables()[0].rows if row[0] == "drifted")
    assert row[1].startswith(f"{name}[1] by +")


def test_with_one_modality_less_the_other_answers_as_it_does_alone(model: ContentModel) -> None:
    table = two_modalities(20, seed=3)
    whole, left = check_model(model, table), check_model(model, table.of(("touch",)))
    assert set(whole.alone) == {"touch", "vision"}
    np.testing.assert_array_equal(left.score.confusion, whole.alone["touch"].confusion)
    assert whole.score.accuracy.value > left.score.accuracy.value + 0.1


def test_half_of_the_contents_suffice_and_unknown_ones_are_refused(model: ContentModel) -> None:
    table = two_modalities(20, seed=3)
    found = check_model(model, table.rows(np.isin(table.label, ["water", "rice"])))
    assert dict(zip(found.labels, found.score.trials.tolist(), strict=True)) == {
        "empty": 0,
        "flour": 0,
        "rice": 20,
        "water": 20,
    }
    with pytest.raises(InputError, match="labels out of empty, flour, rice, water; got 'oil'"):
        check_model(model, table.merged({"oil": ["water"]}))
