"""What `python -m studies videos` counts."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from studies.__main__ import main
from studies.rendered_video import case, render
from studies.videos import FilmOutcome, VideosConfig, accuracy, compared, flags_of, trials

SMALL = {"width_px": 320, "height_px": 240, "frames": 2, "rest": 1, "ramp": 1}
ONE = FilmOutcome(
    2000, "tool", 1 / 30, 0.0, (2.0, 1e4, 0.2, 1.5), (2.04, 1.2e4, 0.25, 1.52), (1.9, 1e4, 0.1, 1.4), (2.1,) * 4
)


@pytest.mark.parametrize("seed", [2000, 2001, 2002])
def test_the_flags_of_the_truth_are_right(seed: int) -> None:
    video = render(case(seed, **SMALL))
    overlap, held, contact = compared(video, {"particles": flags_of(video)})
    assert overlap > 0.93
    assert held
    assert contact


def test_a_wrong_region_and_wrong_parts_are_seen() -> None:
    video = render(case(2002, **SMALL))
    x, y, width, height = video.contact
    used = {"roi": None, "held": ("left", "contact"), "contact": (x + width, y, width, height)}
    overlap, held, contact = compared(video, {"particles": used})
    assert overlap < 0.5
    assert not held
    assert not contact
    outline = (video.outline + 0.1 * video.roi[2]).ravel().tolist()
    assert compared(video, {"particles": used, "outline": outline})[0] < 0.85


def test_errors_and_intervals_are_counted() -> None:
    far = dataclasses.replace(ONE, value=(2.4, np.nan, np.nan, 2.0), reasons=("slips",))
    rows = {row["quantity"]: row for row in accuracy("all", [ONE, far])}
    stiffness, modulus, clock = (rows[name] for name in ("stiffness at the contact", "modulus", "time of the log"))
    assert stiffness["median"] == pytest.approx(0.11)
    assert (stiffness["near"].hits, stiffness["near"].cases, stiffness["doubted"].rate) == (1, 2, 1.0)
    assert (modulus["near"].cases, modulus["near"].hits, modulus["doubted"].hits) == (1, 0, 0)
    assert (clock["near"].hits, clock["held"].hits) == (1, 2)
    slow = dataclasses.replace(ONE, lag_s=0.3)
    assert accuracy("all", [ONE, slow])[-1]["near"].cases == 1


def test_seeds_that_an_earlier_count_looked_at_are_not_counted_again() -> None:
    counted = [one.seed for some in trials(VideosConfig()) for one in some.cases]
    assert min(counted) == 2140
    assert max(one.seed for some in trials(VideosConfig(tuning=True)) for one in some.cases) < 2000


@pytest.mark.slow
def test_a_small_study_counts_its_videos(tmp_path: Path) -> None:
    target = tmp_path / "found.json"
    counts = ["--videos", "1", "--unaided", "1", "--softening", "0", "--small", "--tuning", "--jobs", "1"]
    assert main(["videos", *counts, "--json", str(target), "--resume", str(tmp_path / "kept.jsonl")]) == 0
    found = json.loads(target.read_text())
    assert found["with flags"]["errors"] == found["without flags"]["errors"] == {}
    stiffness = found["with flags"]["rows"][0]
    assert stiffness["quantity"] == "stiffness at the contact"
    assert stiffness["median"] < 0.2
