"""The study of probabilities while the hand closes: whose squeezes it trains on and names, and what it says of them."""

import numpy as np
import pytest

from deformscope.files.squeeze_dataset import TrialEntry, TrialRow
from deformscope.stages.squeeze import model_check
from studies import contents
from studies.reproduce.container_trials import SqueezeJob

WIDTH = {"tactile": 4, "vision": 9, "vision_small": 4, "physical": 2}


def drawn(job: SqueezeJob) -> TrialRow:
    """Features that tell contents apart."""
    random = np.random.default_rng([job.seed, 7])
    place = contents.CONTENTS.index(job.content)
    features = {name: place + random.normal(0.0, 0.3, width) for name, width in WIDTH.items()}
    series = {name: np.repeat(features[name][None], 12, axis=0) for name in ("tactile", "vision_small")}
    return TrialRow(TrialEntry(str(job.seed), job.content, job.container, session=job.session), features, series)


@pytest.mark.slow
def test_new_cartons_are_named_at_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contents, "run_squeeze", drawn)
    monkeypatch.setattr(model_check, "DRAWS", 200)
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
