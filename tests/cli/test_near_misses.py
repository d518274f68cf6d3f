"""What is suggested for names with a mistake."""

import pytest

from deformscope.cli import main


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["explore", "two-60-150"], "try: lab:two-60-150"),
        (["explore", "two-60-l50"], "try: lab:two-60-150"),
        (["explore", "lab:two-6o-150"], "try: two-60-150"),
        (["calibrate", "beta", "tension"], "try: sample:tension"),
        (["calibrate", "beta", "sample:tensio"], "try: sample:tension"),
        (["calibrate", "theta", "pairs"], "try: sample:pair"),
        (["record", "bensh"], "try: lab:bench"),
        (["explor"], "try: deformscope explore"),
    ],
)
def test_near_misses_are_suggested(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert says in capsys.readouterr().err
