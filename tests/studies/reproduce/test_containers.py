"""The plan of the thesis's experiment: its proportions, and boxes and days that have every content."""

from collections import Counter, defaultdict
from pathlib import Path

from studies.reproduce.container_trials import BOXES, THESIS_COUNTS, squeeze_jobs


def test_the_thesis_s_proportions() -> None:
    jobs = squeeze_jobs(Path("d"), sum(THESIS_COUNTS.values()), 0, 20, 0)
    assert sum(THESIS_COUNTS.values()) == len(jobs) == 731
    assert Counter(job.content for job in jobs) == THESIS_COUNTS
    assert len({job.trial for job in jobs}) == len({job.seed for job in jobs}) == 731
    assert sum(job.whole for job in jobs) == 20


def test_no_box_and_no_day_gives_a_content_away() -> None:
    jobs = squeeze_jobs(Path("d"), sum(THESIS_COUNTS.values()), 0, 0, 0)
    boxes, sessions = defaultdict(set), defaultdict(set)
    for job in jobs:
        boxes[job.container].add(job.content)
        sessions[job.session].add(job.content)
    assert len(boxes) == BOXES
    assert all(len(contents) == 5 for contents in (*boxes.values(), *sessions.values()))


def test_fewer_trials_keep_all_contents_and_cylinders_come_besides() -> None:
    jobs = squeeze_jobs(Path("d"), 40, 20, 2, 7)
    assert len(jobs) == 60
    assert len({job.content for job in jobs[:40]}) == 5
    assert {job.container.split("-")[0] for job in jobs[40:]} == {"cylinder"}
    assert len({job.seed for job in jobs}) == 60
