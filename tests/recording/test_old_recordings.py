"""Recordings of before: both formats are read, whole, and decoded again as they were.

`old/format-1.rrd` was recorded at f97f1ab, the last commit of format 1, and `old/format-2.rrd` at de43922: 0.4 s of an
OptoForce sensor and of DSA pads each, with the bytes of their wires. `old/squeeze.rrd` is a squeeze of 18479e7, whose
container was tracked once the hand had opened, in some of the images.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from deformscope.cli import main
from deformscope.recording.items import read_results
from deformscope.runs import replay_result
from deformscope.stages.squeeze.trial import ContainerChange, TrackedContainer
from tests.rounding import differing_by_more
from tests.verified import verify_here

OLD = Path(__file__).parent / "old"


@pytest.mark.parametrize(("number", "pads", "tip"), [(1, 14, 575), (2, 13, 499)])
def test_they_are_whole_and_decoded_again_identically(
    number: int, pads: int, tip: int, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = OLD / f"format-{number}.rrd"

    assert verify_here(recording) == 0
    assert "all bytes are as recorded" in capsys.readouterr().out
    assert main(["replay", str(recording)]) == 0
    printed = capsys.readouterr().out
    assert f"{pads} of {pads} frames decoded again, identical" in printed
    assert f"{tip} of {tip} frames decoded again, identical" in printed


def test_a_squeeze_of_before_opens_and_is_computed_again(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for 0.02 %: it was recorded when depths of the model had 32 bits."""
    monkeypatch.setattr(replay_result, "differing", partial(differing_by_more, share=2e-4))
    recording = OLD / "squeeze.rrd"
    tracked = [row.item for row in read_results(recording, (TrackedContainer,), trust=True)]

    assert len(tracked) == 3
    assert all(one.good and one.lag_s is None and one.directions is None for one in tracked)
    assert {one.degrees for one in tracked} == {"3 of 6 observed"}
    assert list(read_results(recording, (ContainerChange,), trust=True)) == []
    assert main(["replay", str(recording)]) == 0
    assert "identical to the recorded numbers" in " ".join(capsys.readouterr().err.split())
