"""A trained classifier on new trials: its promise, its posteriors, and what it does with a modality less."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.runs.classifier_check import ClassifierCheckResult
from deformscope.stages.squeeze import model_check
from deformscope.stages.squeeze.model import ContentModel, fit_model
from deformscope.stages.squeeze.model_check import check_model
from tests.cases import Patch, slow
from tests.stages.squeeze.trials import stepped, two_modalities

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


def test_what_a_model_says_while_the_squeeze_goes_on_is_checked_at_each_time() -> None:
    found = check_model(fit_model(stepped(40, seed=1), by_group=False), stepped(75, seed=2)).times
    assert [one.time_s for one in found[:3]] == [0.2, 0.5, 1.0]
    assert np.isnan(found[3].time_s)
    assert [one.score.modality for one in found] == ["tactile+vision_small"] * 3 + ["tactile+vision"]
    accuracy = [one.score.accuracy.value for one in found]
    assert accuracy[0] < accuracy[1] - 0.1
    for one in found:
        low, high = one.error_interval
        assert 0.0 < low < high < 0.15  # 300 answers of a classifier that means what it says
        assert low - 0.05 < one.by_chance < high
        assert one.debiased.interval[0] == 0.0 <= one.debiased.value < one.debiased.interval[1]  # nothing beyond chance


@pytest.mark.slow
def test_answers_that_are_too_sure_have_a_calibration_error_that_shows() -> None:
    table = stepped(75, seed=2)
    random = np.random.default_rng(0)
    noisy = {name: values + 1.5 * random.normal(size=values.shape) for name, values in table.series.items()}
    model = fit_model(stepped(40, seed=1), by_group=False)
    before, after = (check_model(model, one).times[1] for one in (table, dataclasses.replace(table, series=noisy)))
    assert after.score.calibration_error > before.error_interval[1]
    assert after.error_interval[0] <= after.score.calibration_error <= after.error_interval[1]
    assert after.debiased.interval[0] > after.by_chance
    assert before.debiased.interval[0] == 0.0


@pytest.mark.parametrize("off", [slow(0.0), slow(0.05), 0.15])
def test_the_debiased_error_is_what_was_put_in_and_its_interval_holds_it(off: float, monkeypatch: Patch) -> None:
    """Answers whose probabilities are above the share that is right by as much, 300 at a time."""
    monkeypatch.setattr(model_check, "DRAWS", 200)
    held, values, chance = [], [], []
    for seed in range(60):
        random = np.random.default_rng(seed)
        sure = random.uniform(0.6, 1.0, 300)
        right = random.random(300) < sure - off
        score: Any = SimpleNamespace(level=0.9)
        posterior = np.stack([1.0 - sure, sure], axis=1)
        found = model_check._time_check(0.2, score, posterior, right.astype(np.int64), seed)
        held.append(found.debiased.interval[0] <= off <= found.debiased.interval[1])
        values.append(found.debiased.value)
        chance.append(found.by_chance)
    assert np.mean(held) > 0.83
    assert np.mean(values) == pytest.approx(off, abs=0.025)
    assert 0.02 < np.mean(chance) < 0.06


def test_a_table_without_steps_has_no_times() -> None:
    assert check_model(fit_model(stepped(20), by_group=False), dataclasses.replace(stepped(20), series={})).times == ()
