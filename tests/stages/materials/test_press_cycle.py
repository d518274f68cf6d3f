"""When a push is at its deepest, and when nothing presses any more: from displacement, from force, or as named."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.materials.press_cycle import PressForce, course_of, find_cycle, frames_to_fit, share_of_push

HELD = np.array([0.0, 2.0, 5.0, 8.0, 10.0, 10.0, 10.0, 6.0, 3.0, 2.05, 2.0, 2.02, 2.0])


def test_what_rests_again_is_unloaded() -> None:
    found = find_cycle(HELD, 0.02)
    assert (found.loaded, found.unloaded, found.source) == (6, 9, "displacement")
    assert found.kept == pytest.approx(0.205)
    assert find_cycle(np.array([0.0, 5.0, 10.0, 0.1]), 0.02).unloaded == 3


def test_a_force_shows_it_where_what_was_pressed_still_recovers() -> None:
    course = np.append(np.array([0.0, 5.0, 10.0, 10.0]), 4.0 * 0.8 ** np.arange(8))
    time_s = 0.1 * np.arange(len(course))
    fine = np.linspace(-0.5, 1.5, 500)
    force = PressForce(fine, np.where((fine > 0.02) & (fine < 0.34), 3.0, 0.0), 0.01)
    found = find_cycle(course, 0.02, time_s=time_s, force=force)
    assert (found.loaded, found.unloaded, found.source) == (3, 4, "force")
    still = PressForce(fine, np.where(fine > 0.02, 3.0, 0.0), 0.01)
    with pytest.raises(InputError, match=r"3 N at the last frame.*--at LOADED,UNLOADED"):
        find_cycle(course, 0.02, time_s=time_s, force=still)


@pytest.mark.parametrize(
    ("course", "says"),
    [
        (np.linspace(0.0, 10.0, 6), "as deep at its last frame as ever"),
        (np.array([0.0, 5.0, 10.0, 8.0, 6.0, 4.0]), "still on its way back at the last frame, 40% deep"),
        (np.array([0.0, 0.01, 0.02, 0.0]), "a motion that is pressed"),
    ],
)
def test_a_motion_that_cannot_tell_is_refused_with_what_to_record(course: np.ndarray, says: str) -> None:
    with pytest.raises(InputError, match=says):
        find_cycle(course, 0.02)


def test_named_frames_are_taken_as_they_are() -> None:
    found = find_cycle(HELD, 0.02, given=(5, 8))
    assert (found.loaded, found.unloaded, found.source) == (5, 8, "given")
    with pytest.raises(InputError, match="0 < LOADED < UNLOADED <= 12"):
        find_cycle(HELD, 0.02, given=(8, 8))


def test_tracks_that_went_wrong_hardly_move_the_share() -> None:
    random = np.random.default_rng(0)
    shape = random.normal(size=(40, 2))
    share = np.array([0.0, 0.5, 1.0, 0.3])
    moved = share[:, None, None] * shape + random.normal(0.0, 1e-3, (4, 40, 2))
    moved[3, :8] += 2.0  # as beside a tool that lifts
    moved[:, 39] = np.nan
    found, loaded, known = share_of_push(moved)
    assert loaded == 2
    assert known.sum() == 39
    assert found == pytest.approx(share, abs=4e-3)
    assert course_of(moved, np.array([0, 39]))[2] == pytest.approx(np.linalg.norm(moved[2, 0]), rel=1e-2)
    with pytest.raises(InputError, match="6 particles"):
        share_of_push(np.where(np.arange(40)[None, :, None] < 4, moved, np.nan))


def test_few_frames_go_even_along_the_way() -> None:
    course = np.concatenate(
        [np.linspace(0.0, 10.0, 51), np.full(50, 10.0), np.linspace(10.0, 2.0, 9)[1:], np.full(40, 2.0)]
    )
    cycle = find_cycle(course, 0.02)
    rows = frames_to_fit(cycle, 8, between=False)
    assert len(rows) <= 8
    assert {cycle.loaded, cycle.unloaded, len(course) - 1} <= set(rows.tolist())
    assert not ((rows > cycle.loaded) & (rows < cycle.unloaded)).any()
    assert np.diff(course[rows[rows <= 50]]).max() < 3.0
    both = frames_to_fit(cycle, 8, between=True)
    assert ((both > cycle.loaded) & (both < cycle.unloaded)).any()
