"""The data set of squeezes: what is added comes back, and nothing twice."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from deformscope.errors import InputError
from deformscope.files.squeeze_dataset import FEATURES, INDEX, SqueezeDataset, TrialEntry, TrialRow

SETTINGS = {"tactile_end": "first"}


def trial(number: int, content: str = "rice", container: str = "box-01", **changes: object) -> TrialRow:
    random = np.random.default_rng(number)
    features = {"tactile": random.uniform(0, 4095, 72), "physical": np.array([1.0, np.nan, number])}
    if number % 2:
        features["vision"] = random.normal(size=3721)
    entry = TrialEntry(
        f"s-{container}-{number:05d}", content, container, seed=number, T_hand_container=tuple(np.eye(4).ravel())
    )
    series = {"tactile": random.normal(size=(3 + number, 72))}
    if number % 2:
        features["vision_small"] = random.normal(size=121)
        series["vision_small"] = random.normal(size=(2 + number, 121))
    return TrialRow(dataclasses.replace(entry, **changes), features, series)  # type: ignore[arg-type]


def dataset(folder: Path, *rows: TrialRow) -> SqueezeDataset:
    SqueezeDataset(folder, SETTINGS).add(rows)
    return SqueezeDataset(folder)


def test_what_is_added_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    given = [trial(1), trial(2, "empty"), TrialRow(dataclasses.replace(trial(3).entry, discarded="saturated"))]
    found = dataset(tmp_path / "d", *given).rows()
    for before, after in zip(given, found, strict=True):
        np.testing.assert_equal(dataclasses.asdict(after.entry), dataclasses.asdict(before.entry))
        assert after.features.keys() == before.features.keys()
        for name, values in before.features.items():
            np.testing.assert_array_equal(after.features[name], values)
        assert after.series.keys() == before.series.keys()
        for name, values in before.series.items():
            np.testing.assert_array_equal(after.series[name], values)
    assert found[2].features == {}


def test_a_table_leaves_discarded_trials_out_and_marks_a_missing_modality(tmp_path: Path) -> None:
    table = dataset(tmp_path, trial(1), trial(2, "empty", "box-02"), trial(3, discarded="over-squeezed")).table()
    assert list(table.label) == ["rice", "empty"]
    assert list(table.group) == ["box-01", "box-02"]  # type: ignore[arg-type]
    assert np.isnan(table.modalities["vision"]).all(axis=1).tolist() == [False, True]
    assert table.series["tactile"].shape == (2, 5, 72)
    assert np.isnan(table.series["tactile"][0, 4:]).all()
    assert table.series["vision_small"].shape == (2, 3, 121)
    assert np.isnan(table.series["vision_small"][1]).all()


def test_nothing_is_in_it_twice(tmp_path: Path) -> None:
    made = dataset(tmp_path, trial(1))
    with pytest.raises(InputError, match="s-box-01-00001, which is there"):
        made.add([trial(1)])
    again = trial(1)
    renamed = dataclasses.replace(again, entry=dataclasses.replace(again.entry, trial="other"))
    with pytest.raises(InputError, match="other, whose features are those of s-box-01-00001"):
        made.add([renamed])
    assert len(made.rows()) == 1


def test_labels_are_corrected_and_trials_discarded_and_taken_back(tmp_path: Path) -> None:
    made = dataset(tmp_path, trial(1), trial(2))
    name = made.entries()[0].trial
    made.change([name], content="flour")
    made.change([name], discarded="it leaked")
    assert (made.entries()[0].content, made.entries()[0].discarded) == ("flour", "it leaked")
    made.change([name], discarded=None)
    assert made.entries()[0].discarded is None
    np.testing.assert_array_equal(made.rows()[0].features["tactile"], trial(1).features["tactile"])
    with pytest.raises(InputError, match=r"a trial of .*; got 'nobody'"):
        made.change(["nobody"], content="rice")


def test_two_sets_become_one_with_their_recordings(tmp_path: Path) -> None:
    one = dataset(tmp_path / "a", trial(1))
    other = dataset(tmp_path / "b", trial(1), trial(2, recording="trials/s-box-01-00002.rrd"))
    (tmp_path / "b" / "trials").mkdir()
    (tmp_path / "b" / "trials" / "s-box-01-00002.rrd").write_bytes(b"bytes")
    assert one.merge(other) == 1
    assert [entry.seed for entry in one.entries()] == [1, 2]
    assert one.recording_path("s-box-01-00002").read_bytes() == b"bytes"
    differs = dataset(tmp_path / "c", dataclasses.replace(trial(2), features={"tactile": np.zeros(72)}))
    with pytest.raises(InputError, match="another trial s-box-01-00002"):
        one.merge(differs)


def test_other_settings_are_refused(tmp_path: Path) -> None:
    dataset(tmp_path, trial(1))
    with pytest.raises(InputError, match="settings of the data set; got others"):
        SqueezeDataset(tmp_path, {"tactile_end": "last"}).add([trial(2)])


def test_a_missing_trial_and_what_is_no_data_set_are_refused_in_one_line(tmp_path: Path) -> None:
    made = dataset(tmp_path / "d", trial(1), trial(2))
    path = tmp_path / "d" / FEATURES
    pq.write_table(pq.read_table(path).slice(0, 1), path)
    with pytest.raises(InputError, match="features of s-box-01-00002; got none"):
        made.table()
    with pytest.raises(InputError, match=r"with its index\.parquet; got a folder without it"):
        SqueezeDataset(tmp_path).entries()
    with pytest.raises(InputError, match=r"with its index\.parquet; got no such folder"):
        SqueezeDataset(tmp_path / "none").change(["s-box-01-00001"], content="rice")
    (tmp_path / "d" / INDEX).write_bytes(b"PAR1 damaged")
    with pytest.raises(InputError, match=r"a damaged index\.parquet"):
        made.entries()


@pytest.mark.parametrize(
    ("name", "column"), [(INDEX, "T_hand_container"), (FEATURES, "trial"), (FEATURES, "tactile.0")]
)
def test_a_table_that_lost_a_column_is_refused_in_one_line(tmp_path: Path, name: str, column: str) -> None:
    made = dataset(tmp_path, trial(1), trial(2))
    pq.write_table(pq.read_table(tmp_path / name).drop_columns([column]), tmp_path / name)
    with pytest.raises(InputError, match=f"got a {re.escape(name)} without "):
        made.rows()
