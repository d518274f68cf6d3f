"""The evaluation is honest: nothing leaks from the tested side, chance is chance, and copies are refused."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
import pytest
from sklearn.datasets import load_digits, load_wine
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.squeeze.classifiers import NAMES
from deformscope.stages.squeeze.evaluation import EvaluationOptions, evaluate
from deformscope.stages.squeeze.scores import difference, reliability_of, score_of, split_ratio
from deformscope.stages.squeeze.table import LabelledTable, Split, draw
from deformscope.stages.squeeze.trial_run import Answers, run_split
from tests.cases import slow
from tests.stages.squeeze.trials import blobs, noise, two_modalities

FAST = EvaluationOptions(splits=6, curve_splits=0, protocols=("stratified",))
ALL = (*NAMES, "pooled", "late-fusion")


def missing(table: LabelledTable) -> dict[str, np.ndarray]:
    return {name: table.missing(name) for name in table.modalities}


@pytest.mark.parametrize(("classes", "columns"), [(2, 5), slow(4, 80)])
def test_random_labels_give_every_classifier_the_no_information_rate(classes: int, columns: int) -> None:
    options = dataclasses.replace(FAST, splits=8, level=0.99, protocols=("random", "stratified"))
    found = evaluate(noise(classes, 24, columns, seed=classes), options)
    assert {one.method for one in found.scores} == {*ALL} - {"late-fusion"}
    for score in found.scores:
        low, high = score.accuracy.interval
        assert score.chance == pytest.approx(1 / classes)
        assert low <= score.chance <= high, (score.method, score.protocol)


def test_what_is_learned_does_not_depend_on_the_tested_side() -> None:
    """Every answer to a tested trial is the same, to the bit, whatever the other tested trials are."""
    table = two_modalities()
    split = draw("stratified", table, 1, 0)[0]
    before = run_split(table.modalities, missing(table), table.target, 4, split, methods=ALL)
    changed = {name: values.copy() for name, values in table.modalities.items()}
    for values in changed.values():
        values[split.test[1:]] = 1e3 * np.random.default_rng(0).normal(size=(len(split.test) - 1, values.shape[1]))
    after = run_split(changed, missing(table), table.target, 4, split, methods=ALL)
    assert set(before) == set(after)
    for key, one in before.items():
        assert after[key].answer[0] == one.answer[0], key
        assert after[key].sure[0] == pytest.approx(one.sure[0], rel=1e-9), key


def test_a_column_that_a_scaler_fitted_on_all_would_take_gains_nothing() -> None:
    """It says the class, but is constant on the training side: a scaler or components of all trials would use it."""
    table = noise(3, 20, 6, seed=1)
    split = draw("stratified", table, 1, 0)[0]
    leak = np.zeros((60, 1))
    leak[split.test, 0] = 50.0 * table.target[split.test]
    with_leak = {"touch": np.concatenate([table.modalities["touch"], leak], axis=1)}
    without = run_split(table.modalities, missing(table), table.target, 3, split, methods=ALL)
    for key, one in run_split(with_leak, missing(table), table.target, 3, split, methods=ALL).items():
        np.testing.assert_array_equal(one.answer, without[key].answer)
    # The check can fail: where the column varies on the training side, it is used.
    leak[:, 0] = 50.0 * table.target
    assert run_split(with_leak | {"touch": leak}, missing(table), table.target, 3, split)[
        "touch", "knn"
    ].answer.tolist() == (table.target[split.test].tolist())


def test_copies_across_a_split_are_refused_by_name() -> None:
    table = blobs()
    table.modalities["touch"][30] = table.modalities["touch"][3]
    with pytest.raises(InputError, match="row 4 = row 31"):
        evaluate(table, FAST)


def one_nearest(table: LabelledTable, splits: Sequence[Split]) -> FloatArray:
    """(J,) accuracy of scikit-learn's 1-nearest-neighbour on standardised features."""
    features = np.concatenate(list(table.modalities.values()), axis=1)
    nearest = make_pipeline(StandardScaler(), KNeighborsClassifier(1))
    return np.array(
        [
            nearest.fit(features[one.train], table.target[one.train]).score(features[one.test], table.target[one.test])
            for one in splits
        ]
    )


def sets() -> dict[str, LabelledTable]:
    digits, wine = load_digits(), load_wine()
    return {
        "digits": LabelledTable(digits.target[:300].astype(str), None, {"pixels": digits.data[:300]}),
        "wine": LabelledTable(wine.target.astype(str), None, {"chemistry": wine.data}),
        "40 classes": blobs(classes=40, each=8, columns=30, apart=6.0),
    }


@pytest.mark.parametrize("name", [slow("digits"), "wine", slow("40 classes")])
def test_at_least_as_good_as_the_nearest_neighbour(name: str) -> None:
    table = dataclasses.replace(sets()[name], group=None)
    options = dataclasses.replace(FAST, splits=8)
    splits = draw("stratified", table, 8, 0)
    best = evaluate(table, options).best
    found, _ = difference(best.split_accuracy, one_nearest(table, splits), split_ratio(splits), 0.9)
    assert found.value >= -0.002
    assert best.accuracy.interval[0] < best.accuracy.value < best.accuracy.interval[1] or best.accuracy.value == 1.0


def test_late_fusion_knows_what_neither_modality_knows() -> None:
    found = evaluate(two_modalities(each=24), dataclasses.replace(FAST, splits=8))
    touch, vision = (found.score(name, "pooled") for name in ("touch", "vision"))
    assert max(touch.accuracy.interval[1], vision.accuracy.interval[1]) < 0.72  # two classes of four each
    assert found.best.method == "late-fusion"
    assert found.best.accuracy.interval[0] > 0.72
    by_name = {(one.first, one.second): one for one in found.comparisons}
    gain = by_name[("touch+vision", "late-fusion"), ("touch", "pooled")]
    assert gain.difference.interval[0] > 0.0
    assert gain.p_value < 0.05
    assert all(one.interval[1] >= 0.0 for one in gain.by_class)


def test_a_coarser_copy_of_a_modality_takes_its_place_and_is_not_fused_with_it() -> None:
    table = two_modalities()
    coarse = table.modalities["vision"][:, :2]
    found = evaluate(
        dataclasses.replace(table, modalities={**table.modalities, "vision_small": coarse}),
        dataclasses.replace(FAST, splits=4),
    )
    assert found.best.modality == "touch+vision"
    assert {one.modality for one in found.scores} == {
        *("touch", "vision", "vision_small", "touch+vision", "touch+vision_small")
    }
    assert {one.modality for one in found.scores if one.method == "late-fusion"} == {"touch+vision"}
    assert (
        found.score("vision", "knn").accuracy.value
        == evaluate(table, dataclasses.replace(FAST, splits=4)).score("vision", "knn").accuracy.value
    )


def test_where_a_modality_says_nothing_late_fusion_is_the_other_one() -> None:
    table = two_modalities()
    rng = np.random.default_rng(3)
    blind = dataclasses.replace(
        table,
        modalities={
            "touch": 2.5 * table.target[:, None] + rng.normal(size=(64, 3)),
            "vision": rng.normal(size=(64, 40)),
        },
    )
    found = evaluate(blind, dataclasses.replace(FAST, splits=8))
    touch = found.score("touch", "pooled")
    assert found.best.accuracy.value > touch.accuracy.value - 0.03
    assert found.score("touch+vision", "knn").accuracy.value < touch.accuracy.value - 0.1  # early fusion drags it down


def test_with_a_modality_switched_off_the_other_answers() -> None:
    table = two_modalities()
    split = draw("stratified", table, 1, 0)[0]
    off = {name: values.copy() for name, values in table.modalities.items()}
    off["vision"][split.test] = np.nan
    absent = {name: np.isnan(values).all(axis=1) for name, values in off.items()}
    found = run_split(off, absent, table.target, 4, split, methods=("pooled", "late-fusion"))
    touch, late = found["touch", "pooled"], found["touch+vision", "late-fusion"]
    np.testing.assert_array_equal(late.answer, touch.answer)
    np.testing.assert_allclose(late.sure, touch.sure, rtol=1e-12)


def test_too_few_samples_are_words_not_crashes() -> None:
    table = blobs(classes=24, each=3, columns=10, apart=8.0, groups=2)
    keep = np.r_[0, 3:72]  # one trial alone of the first class
    found = evaluate(table.rows(keep), dataclasses.replace(FAST, splits=4, curve_splits=2, protocols=None))
    assert found.protocol == "group"
    assert any("one trial alone of c00" in note for note in found.notes)
    assert any("fewer than 5 trials of c01, c02, c03, c04 and 19 more" in note for note in found.notes)
    assert found.best.confusion.shape == (24, 24)
    assert found.best.confusion[0].sum() == 0


def test_one_trial_of_each_label_is_refused() -> None:
    with pytest.raises(InputError, match="two trials of a label at least"):
        evaluate(blobs(classes=3, each=1, columns=4, apart=8.0, groups=1), FAST)


def test_a_modality_that_never_varies_is_refused() -> None:
    table = two_modalities()
    flat = dataclasses.replace(table, modalities={**table.modalities, "flat": np.ones((64, 3))})
    with pytest.raises(InputError, match="none that differ in it"):
        evaluate(flat, FAST)


def test_transfer_trains_on_one_kind_and_tests_on_the_other() -> None:
    """The kinds are mirror images: what was learned of one is wrong of the other, and within both it is right."""
    table = blobs(classes=2, each=40, columns=2)
    kind = np.array(["carton", "bottle"])[np.arange(80) % 2]
    side = np.where(kind == "carton", 1.0, -1.0) * np.where(table.target == 0, 1.0, -1.0)
    touch = np.random.default_rng(0).normal(size=(80, 2)) + 3.0 * np.stack([side, kind == "carton"], axis=1)
    table = dataclasses.replace(table, kind=kind, group=None, modalities={"touch": touch})
    found = evaluate(table, dataclasses.replace(FAST, splits=12))
    transfers = {one.pair: one for one in found.scores if one.method == "knn" and one.protocol == "transfer"}
    assert set(transfers) == {("bottle", "carton"), ("carton", "bottle")}
    for one in transfers.values():
        assert one.accuracy.interval[1] < 0.3
        assert one.confusion.sum() == 40
    assert found.score("touch", "knn").accuracy.value > 0.9
    patterns = evaluate(table, dataclasses.replace(FAST, transfer=(("c*", "bottle"),)))
    assert {one.pair for one in patterns.scores if one.pair} == {("c*", "bottle")}
    with pytest.raises(InputError, match="share some"):
        evaluate(table, dataclasses.replace(FAST, transfer=(("*", "bottle"),)))


def test_the_learning_curve_rises_and_a_squeeze_is_known_better_with_time() -> None:
    table = blobs(classes=4, each=30, columns=10, apart=2.2)
    touch = table.modalities["touch"]
    rng = np.random.default_rng(1)
    series = np.stack([share * touch + (1 - share) * rng.normal(size=touch.shape) for share in (0.0, 0.5, 1.0)], axis=1)
    series[::7, 2] = np.nan  # trials that ended early keep what they had
    found = evaluate(
        dataclasses.replace(table, series={"touch": series}), dataclasses.replace(FAST, splits=4, curve_splits=4)
    )
    curve = [one.accuracy.value for one in found.curve if one.method == "linear"]
    times = found.steps["touch"]
    assert [round(one.share, 1) for one in found.curve if one.method == "linear"] == [0.2, 0.4, 0.6, 0.8, 1.0]
    assert curve[-1] > curve[0] + 0.03
    assert [one.time_s for one in times] == pytest.approx([0.0, 0.1, 0.2])
    assert times[0].accuracy.interval[0] < 0.25 < times[-1].accuracy.interval[0]
    assert times[0].stopped <= times[1].stopped <= times[2].stopped
    assert times[2].right > 0.8


def test_modalities_are_fused_in_each_step_and_one_that_is_missing_there_leaves_the_other() -> None:
    table = two_modalities()
    over = {name: np.stack([0.3 * values, values], axis=1) for name, values in table.modalities.items()}
    over["vision"][:, 0] = np.nan
    found = evaluate(dataclasses.replace(table, series=over), dataclasses.replace(FAST, splits=4, curve_splits=4))
    assert [one.time_s for one in found.steps["vision"]] == pytest.approx([0.1])
    fused = found.steps["touch+vision"]
    assert [one.time_s for one in fused] == pytest.approx([0.1])
    assert fused[0].accuracy.value >= max(found.steps[one][-1].accuracy.value for one in ("touch", "vision")) - 0.02


def test_the_same_table_and_seed_give_the_same_numbers_in_threads() -> None:
    few = dataclasses.replace(FAST, splits=5)
    one = evaluate(two_modalities(), few)
    other = evaluate(two_modalities(), dataclasses.replace(few, workers=3))
    for mine, theirs in zip(one.scores, other.scores, strict=True):
        np.testing.assert_array_equal(mine.split_accuracy, theirs.split_accuracy)
        assert mine.calibration_error == theirs.calibration_error


def test_clusters_of_clear_clouds_are_the_classes_and_their_components_normal() -> None:
    found = evaluate(blobs(classes=3, each=40, columns=4, apart=14.0), FAST)
    assert found.clusters["touch"].rand.max() == pytest.approx(1.0)
    passed, tested = found.normality["touch"].normal_within
    assert passed >= 0.7 * tested
    assert found.normality["touch"].normal_pooled[0] < found.normality["touch"].normal_pooled[1]


@pytest.mark.parametrize("protocol", ["random", "stratified", "group", "transfer"])
@pytest.mark.parametrize("together", [False, True])
def test_one_error_more_never_raises_an_end_of_an_interval(
    protocol: Literal["random", "stratified", "group", "transfer"], together: bool
) -> None:
    """From all right to all wrong, trial by trial or group by group: accuracy, balanced accuracy, each class."""
    table = blobs(classes=2, each=24, groups=3)
    splits = [Split(np.arange(24), np.arange(24, 48))] if protocol == "transfer" else draw(protocol, table, 20, 0)
    tested = np.unique(np.concatenate([one.test for one in splits]))
    order = tested if together else np.random.default_rng(3).permutation(tested)
    if together:
        order = tested[np.argsort(table.group[tested], kind="stable")]  # type: ignore[index]
    ends = []
    for wrong in range(len(order) + 1):
        answer = np.where(np.isin(np.arange(48), order[:wrong]), 1 - table.target, table.target)
        answers = [
            Answers(one.test, answer[one.test], np.full(len(one.test), 0.9), np.zeros(len(one.test)), 1.0)
            for one in splits
        ]
        score = score_of(table, ("touch", "knn"), protocol, splits, answers, 0.9)
        seen = np.flatnonzero(score.trials)
        ends.append(
            [*score.accuracy.interval, *score.balanced.interval, *(score.share_interval(at, at) for at in seen)]
        )
    found = np.array([np.hstack(one) for one in ends])
    assert (np.diff(found, axis=0) < 1e-12).all()
    assert found[1, 0] > found[0, 0] - 0.1  # one error less says little else
    assert found[0, 1] == 1.0


def test_a_calibrated_classifier_is_inside_its_band_and_an_overconfident_one_is_not() -> None:
    rng = np.random.default_rng(0)
    sure = rng.uniform(0.3, 1.0, size=20000)
    right = rng.random(20000) < sure
    honest, boastful = reliability_of(sure, right, 10.0, 0.9), reliability_of(np.sqrt(sure), right, 10.0, 0.9)
    inside = [
        ((one.band[:, 0] <= one.right) & (one.right <= one.band[:, 1]))[one.count > 0].mean()
        for one in (honest, boastful)
    ]
    assert inside[0] == 1.0
    assert inside[1] < 0.5
