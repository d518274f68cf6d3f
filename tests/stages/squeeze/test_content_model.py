"""A trained classifier names contents of new trials, with what is there of them."""

import dataclasses

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.squeeze.model import ContentModel, fit_model
from tests.stages.squeeze.trials import stepped, two_modalities


@pytest.fixture(scope="module")
def model() -> ContentModel:
    table = two_modalities(each=30)
    series = np.stack([0.1 * table.modalities["touch"], table.modalities["touch"]], axis=1)
    return fit_model(dataclasses.replace(table, series={"touch": series}), by_group=True)


def test_new_trials_are_named_with_probabilities(model: ContentModel) -> None:
    new = two_modalities(each=50, seed=9)
    posterior = model.predict_proba(new.modalities)
    truth = np.array([model.labels.index(one) for one in new.label])
    np.testing.assert_allclose(posterior.sum(axis=1), 1.0)
    assert (posterior.argmax(axis=1) == truth).mean() > 0.72
    assert abs(posterior.max(axis=1).mean() - (posterior.argmax(axis=1) == truth).mean()) < 0.08


def test_one_modality_will_do_and_a_row_without_one_falls_back_to_the_other(model: ContentModel) -> None:
    new = two_modalities(seed=9)
    touch = model.predict_proba({"touch": new.modalities["touch"]})
    both = {name: values.copy() for name, values in new.modalities.items()}
    both["vision"][:5] = np.nan
    mixed = model.predict_proba(both)
    np.testing.assert_allclose(mixed[:5], touch[:5], rtol=1e-12)
    assert not np.allclose(mixed[5:], touch[5:])


def test_a_posterior_for_every_step_of_a_squeeze(model: ContentModel) -> None:
    new = two_modalities(seed=9).modalities["touch"]
    np.testing.assert_allclose(
        model.predict_step("touch", 0, 0.1 * new), model.predict_step("touch", 1, new), atol=1e-6
    )
    np.testing.assert_array_equal(model.predict_step("touch", 7, new), model.predict_step("touch", 1, new))


@pytest.fixture(scope="module")
def live() -> ContentModel:
    return fit_model(stepped(), by_group=True)


def test_touch_and_vision_are_fused_at_each_step_and_it_says_which_of_them(live: ContentModel) -> None:
    new = stepped(50, seed=9)
    truth = np.array([live.labels.index(one) for one in new.label])

    def right(time_s: float, *names: str) -> float:
        step = round(10 * time_s)
        known, posterior = live.predict_at(time_s, {name: new.series[name][:, step] for name in names})
        assert known == names
        np.testing.assert_allclose(posterior.sum(axis=1), 1.0)
        return float((posterior.argmax(axis=1) == truth).mean())

    assert right(0.6, "tactile", "vision_small") > right(0.6, "tactile") + 0.15
    assert right(0.6, "tactile", "vision_small") > right(0.1, "tactile", "vision_small") + 0.2


def test_where_there_is_no_vision_at_a_step_touch_alone_answers(live: ContentModel) -> None:
    new = {name: values[:, 6] for name, values in stepped(10, seed=9).series.items()}
    both, touch = live.predict_at(0.6, new)[1], live.predict_step("tactile", 6, new["tactile"])
    missing = np.isnan(new["vision_small"]).all(axis=1)
    np.testing.assert_allclose(both[missing], touch[missing], rtol=1e-12)
    assert not np.allclose(both[~missing], touch[~missing])


def test_a_model_whose_vision_has_no_steps_answers_by_touch_and_says_so(live: ContentModel) -> None:
    before = dataclasses.replace(live, steps={"tactile": live.steps["tactile"]}, step_fusion=())
    new = {name: values[:, 6] for name, values in stepped(10, seed=9).series.items()}
    known, posterior = before.predict_at(0.6, new)
    assert known == ("tactile",)
    np.testing.assert_array_equal(posterior, before.predict_step("tactile", 6, new["tactile"]))


def test_features_that_do_not_fit_are_refused(model: ContentModel) -> None:
    row = np.zeros((1, 3))
    for features, said in (
        ({"smell": row}, "got smell"),
        ({}, "features of touch or vision"),
        ({"touch": np.zeros((1, 5))}, r"\(n, 3\) features in touch"),
        ({"touch": row, "vision": np.zeros((2, 4))}, "as many rows"),
        ({"touch": np.full((1, 3), np.nan)}, "none at all in row 1"),
        ({"touch": np.full((1, 3), np.inf)}, "infinity"),
    ):
        with pytest.raises(InputError, match=said):
            model.predict_proba(features)
    with pytest.raises(InputError, match="a modality with steps: touch"):
        model.predict_step("vision", 0, np.zeros((1, 4)))
