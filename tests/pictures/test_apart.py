"""Pictures drawn in a process of their own: the same bytes, whatever becomes of the process."""

from __future__ import annotations

import os
import signal

import pytest

from deformscope.pictures.apart import drawing_apart, drawn
from deformscope.pictures.exploration import words_png


def own_process() -> bytes:
    return str(os.getpid()).encode()


def without_width() -> bytes:
    raise ZeroDivisionError("no width")


def test_a_picture_is_the_same_drawn_apart_and_here() -> None:
    here = drawn(words_png, "no touch yet")
    assert drawn(own_process) == own_process()
    with drawing_apart():
        there = drawn(own_process)
        assert there != own_process()
        assert drawn(words_png, "no touch yet") == here
        with pytest.raises(ZeroDivisionError, match="no width"):  # as if drawn here
            drawn(without_width)
        os.kill(int(there), signal.SIGKILL)
        assert drawn(words_png, "no touch yet") == here
    assert drawn(own_process) == own_process()
