"""Items in several processes: all results, whatever the order, and errors as they are."""

from __future__ import annotations

import os

import pytest

from deformscope.errors import InputError
from deformscope.processes import in_processes


def whose(number: int) -> tuple[int, int]:
    return number * number, os.getpid()


def refuses(number: int) -> int:
    raise InputError("a number that is liked", str(number))


def test_every_item_comes_back_with_its_index() -> None:
    pytest.importorskip("warp")
    found = dict(in_processes(whose, [3, 4, 5], workers=2))

    assert {index: square for index, (square, _) in found.items()} == {0: 9, 1: 16, 2: 25}
    assert all(process != os.getpid() for _, process in found.values())


def test_one_worker_is_this_process() -> None:
    assert list(in_processes(whose, [2, 6], workers=1)) == [(0, (4, os.getpid())), (1, (36, os.getpid()))]
    assert list(in_processes(whose, [], workers=4)) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_is_the_item_s_own(workers: int) -> None:
    pytest.importorskip("warp")
    with pytest.raises(InputError, match=r"liked; got \d"):
        list(in_processes(refuses, [1, 2], workers=workers))
