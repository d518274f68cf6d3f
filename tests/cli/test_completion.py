"""What a shell completes, and what is suggested for names with a mistake."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("tyro")

from deformscope.cli import main
from deformscope.cli.completion import next_words


@pytest.mark.parametrize(
    ("line", "some", "not_these"),
    [
        ("deformscope ex", ["explore", "export"], ["record"]),
        ("deformscope calibrate ", ["beta", "viscous"], ["verify"]),
        ("deformscope catalog com", ["compare"], []),
        ("deformscope calibrate beta sample:t", ["sample:table", "sample:tension"], ["sample:pair"]),
        ("deformscope calibrate beta sample:pair --pic", ["--picture"], []),
        ("deformscope calibrate beta sample:pair --method ", ["gradient", "sweep"], ["sample:pair"]),
        ("deformscope explore lab:two-60", ["lab:two-60-150"], []),
        ("deformscope record lab:b", ["lab:bench"], []),
        ("deformscope completion ", ["bash", "fish", "zsh"], []),
        ("deformscope calibrate beta 'a ", [], ["beta"]),
    ],
)
def test_words_that_may_follow(line: str, some: list[str], not_these: list[str]) -> None:
    found = next_words(line)
    assert set(some) <= set(found)
    assert not set(not_these) & set(found)


def test_bash_completes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    line = "deformscope explore lab:two-60"
    script = f"""deformscope() {{ {sys.executable} -m deformscope "$@"; }}
{capsys.readouterr().out}
COMP_LINE='{line}'; COMP_POINT={len(line)}; _deformscope; printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["two-60-150"]  # what bash has as the last word


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["explore", "two-60-150"], "try: lab:two-60-150"),
        (["explore", "two-60-l50"], "try: lab:two-60-150"),
        (["explore", "lab:two-6o-150"], "try: two-60-150"),
        (["calibrate", "beta", "tension"], "try: sample:tension"),
        (["calibrate", "beta", "sample:tensio"], "try: sample:tension"),
        (["calibrate", "both", "pairs"], "try: sample:pair"),
        (["record", "bensh"], "try: lab:bench"),
        (["explor"], "try: deformscope explore"),
    ],
)
def test_near_misses_are_suggested(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert says in capsys.readouterr().err
