"""The thesis's statements beside ours: the words follow the numbers."""

from functools import cache

import numpy as np
import pytest

from deformscope.stages.squeeze.evaluation import Evaluation, EvaluationOptions, evaluate
from deformscope.stages.squeeze.table import LabelledTable
from studies.reproduce.container_findings import HARDNESS, compare_findings

FEW = EvaluationOptions(splits=16, curve_splits=0, protocols=("stratified",))


@cache
def evaluated(*, blind: bool = False) -> tuple[Evaluation, Evaluation]:
    """Touch orders contents by hardness, neighbours close together; vision knows water alone, or nothing."""
    random = np.random.default_rng(3)
    label = np.repeat(HARDNESS, 30)
    place = np.repeat(np.arange(5.0), 30)
    touch = np.column_stack([3.0 * place, *random.normal(size=(3, 150))]) + random.normal(size=(150, 4))
    vision = random.normal(size=(150, 40))
    vision[label == "water"] += 0.0 if blind else 4.0
    table = LabelledTable(label, None, {"tactile": touch, "vision": vision, "vision_small": vision[:, :2]})
    three = table.merged({"liquid": ("water", "yogurt"), "granular": ("flour", "rice")})
    return evaluate(table, FEW), evaluate(three, FEW)


@pytest.mark.slow
@pytest.mark.parametrize("blind", [False, True])
def test_vision_is_best_for_water_where_it_is(blind: bool) -> None:
    ours = {one.thesis: one.ours for one in compare_findings(*evaluated(blind=blind))}
    water = ours["Vision is most informative for water."]
    assert ("Water: vision is better" in water) is not blind
    assert blind or water.endswith("Vision is best for water.")
    touch = ours["Of three classes, touch is better for empty and granular contents."]
    assert "Empty: touch is better" in touch
    assert "Granular: touch is better" in touch or not blind


def test_neighbours_in_hardness_are_confused_by_touch() -> None:
    ours = [one.ours for one in compare_findings(*evaluated(blind=True))]
    neighbours = next(words for words in ours if "name a neighbour" in words)
    assert float(neighbours.split("%")[0].removeprefix("By touch ")) > 70.0
    assert any(words.startswith("tactile+vision, knn over tactile, knn: loses") for words in ours)
