"""What a person who places the arm may say."""

import pytest

from deformscope.robot.by_hand import height_m_of


@pytest.mark.parametrize(
    ("answer", "height_m"),
    [("", 0.05), ("51.5", 0.0515), ("51,5", 0.0515), ("nan", None), ("inf", None), ("5.1", None), ("yes", None)],
)
def test_a_height_is_taken_where_it_is_one(answer: str, height_m: float | None) -> None:
    assert height_m_of(answer, 0.05) == (None if height_m is None else pytest.approx(height_m))
