"""The study of probabilities while the hand closes: whose squeezes it trains on and names, and what it says of them."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deformscope.files.squeeze_dataset import TrialEntry, TrialRow
from deformscope.stages.squeeze.model import ContentModel, fit_model
from deformscope.stages.squeeze.table import LabelledTable
from studies import contents
from studies.reproduce.container_trials import SqueezeJob
from tests.cases import Patch, slow
from tests.stages.squeeze.trials import stepped

WIDTH = {"tactile": 4, "vision": 9, "vision_small": 4, "physical": 2}


def drawn(job: SqueezeJob) -> TrialRow:
    """Features that tell contents apart."""
    random = np.random.default_rng([job.seed, 7])
    place = contents.CONTENTS.index(job.content)
    features = {name: place + random.normal(0.0, 0.3, width) for name, width in WIDTH.items()}
    series = {name: np.repeat(features[name][None], 12, axis=0) for name in ("tactile", "vision_small")}
    return TrialRow(TrialEntry(str(job.seed), job.content, job.container, session=job.session), features, series)


@pytest.mark.slow
def test_new_cartons_are_named_at_each_time(monkeypatch: Patch) -> None:
    monkeypatch.setattr(contents, "run_squeeze", drawn)
    monkeypatch.setattr(contents, "DRAWS", 200)
    options = contents.ContentsConfig(train=75, trials=50)
    (trials,) = contents.trials(options)
    rows = [trials.try_one(seed) for seed in trials.cases]
    trained, new = rows[: options.train], rows[options.train :]
    for of in (lambda row: row.entry.container, lambda row: row.entry.session):
        assert not {of(row) for row in trained} & {of(row) for row in new}
    for carton in {row.entry.container for row in rows}:
        assert {row.entry.content for row in rows if row.entry.container == carton} == set(contents.CONTENTS)
    said = contents.report(options, 0.0, rows)
    found = said.json
    assert isinstance(found, dict)
    assert list(found["trained_on"]) == ["0 to 24", "25 to 49", "50 to 74", "0 to 74"]
    for times in found["trained_on"].values():
        assert [one["time_s"] for one in times] == [0.2, 0.5, 1.0, None]
        assert all(one["accuracy"] > 0.8 for one in times)
        assert all(one["calibration_by_chance"] < 0.1 for one in times)
    assert len(said.tables[0].rows) == 16


def during(model: ContentModel, table: LabelledTable) -> list[contents.TimeCheck]:
    return list(contents._during(model, table, 0.9, 0))


def test_what_a_model_says_while_the_squeeze_goes_on_is_checked_at_each_time() -> None:
    found = during(fit_model(stepped(40, seed=1), by_group=False), stepped(75, seed=2))
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
    before, after = (during(model, one)[1] for one in (table, dataclasses.replace(table, series=noisy)))
    assert after.score.calibration_error > before.error_interval[1]
    assert after.error_interval[0] <= after.score.calibration_error <= after.error_interval[1]
    assert after.debiased.interval[0] > after.by_chance
    assert before.debiased.interval[0] == 0.0


@pytest.mark.parametrize("off", [slow(0.0), slow(0.05), 0.15])
def test_the_debiased_error_is_what_was_put_in_and_its_interval_holds_it(off: float, monkeypatch: Patch) -> None:
    """Answers whose probabilities are above the share that is right by as much, 300 at a time."""
    monkeypatch.setattr(contents, "DRAWS", 200)
    held, values, chance = [], [], []
    for seed in range(60):
        random = np.random.default_rng(seed)
        sure = random.uniform(0.6, 1.0, 300)
        right = random.random(300) < sure - off
        score: Any = SimpleNamespace(level=0.9)
        posterior = np.stack([1.0 - sure, sure], axis=1)
        found = contents._time_check(0.2, score, posterior, right.astype(np.int64), seed)
        held.append(found.debiased.interval[0] <= off <= found.debiased.interval[1])
        values.append(found.debiased.value)
        chance.append(found.by_chance)
    assert np.mean(held) > 0.83
    assert np.mean(values) == pytest.approx(off, abs=0.025)
    assert 0.02 < np.mean(chance) < 0.06
