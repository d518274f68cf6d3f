"""Recordings of before: both formats are read, whole, and decoded again as they were.

`old/format-1.rrd` was recorded at f97f1ab, the last commit of format 1, and `old/format-2.rrd` at de43922: 0.4 s of an
OptoForce sensor and of DSA pads each, with the bytes of their wires.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from deformscope.cli import main

OLD = Path(__file__).parent / "old"


@pytest.mark.parametrize(("number", "pads", "tip"), [(1, 14, 575), (2, 13, 499)])
def test_they_are_whole_and_decoded_again_identically(
    number: int, pads: int, tip: int, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = str(OLD / f"format-{number}.rrd")

    assert main(["verify", recording]) == 0
    assert "every byte is as it was recorded" in capsys.readouterr().out
    assert main(["replay", recording]) == 0
    printed = capsys.readouterr().out
    assert f"{pads} of {pads} frames decoded again, identical" in printed
    assert f"{tip} of {tip} frames decoded again, identical" in printed
