"""Pictures drawn in a process of their own: the same bytes, whatever becomes of the process."""

import os
import signal

import pytest

from deformscope.pictures.exploration import text_png
from deformscope.pictures.render_process import render, render_process


def own_process() -> bytes:
    return str(os.getpid()).encode()


def without_width() -> bytes:
    raise ZeroDivisionError("no width")


def test_a_picture_is_the_same_drawn_apart_and_here() -> None:
    here = render(text_png, "no touch yet")
    assert render(own_process) == own_process()
    with render_process():
        there = render(own_process)
        assert there != own_process()
        assert render(text_png, "no touch yet") == here
        with pytest.raises(ZeroDivisionError, match="no width"):  # as if drawn here
            render(without_width)
        os.kill(int(there), signal.SIGKILL)
        assert render(text_png, "no touch yet") == here
    assert render(own_process) == own_process()
