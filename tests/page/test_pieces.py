"""A page that is slow, hidden or gone holds nothing back, and what it was not sent is counted."""

import json
from collections.abc import Iterator

import pytest

from deformscope.page.server.page_server import PageServer
from deformscope.page.server.pieces import (
    FASTEST_S,
    FIRST_BYTES,
    LASTING_BYTES,
    MOST_REST_S,
    RECENT_BYTES,
    RECENT_S,
    REST,
    SLOWEST_S,
    Pieces,
    ViewerPiece,
)
from tests.page.pages import socket_to
from tests.patience import PATIENCE_S


class FakeClock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def pieces(clock: FakeClock) -> Pieces:
    return Pieces(clock)


def numbers(taken: list[ViewerPiece]) -> list[int]:
    return [piece.number for piece in taken]


def test_a_page_that_follows_gets_all_in_order(pieces: Pieces, clock: FakeClock) -> None:
    reader = pieces.join(0)
    assert pieces.take(reader) == []
    for step in range(50):
        pieces.add(b"x", lasting=step % 7 == 0)
        clock.now_s += 0.2
        assert numbers(pieces.take(reader)) == [step + 1]
        pieces.drawn(reader)
    assert reader.skipped == 0
    assert reader.behind_s == pytest.approx(0.4)  # it showed the piece before until now


def test_a_frozen_page_gets_what_lasts_and_the_newest(pieces: Pieces, clock: FakeClock) -> None:
    reader = pieces.join(0)
    pieces.add(b"views", lasting=True)
    pieces.take(reader)
    for step in range(2, 302):  # five minutes
        clock.now_s += 1.0
        pieces.add(b"x" * 1000, lasting=step == 100)
    assert numbers(pieces.take(reader)) == [100, 300, 301]
    assert reader.skipped == 300 - 3
    assert pieces.held_bytes < (RECENT_S + 3) * 1000  # and nothing was kept for it


def test_a_page_that_comes_gets_what_lasts_and_the_recent_stretch(pieces: Pieces, clock: FakeClock) -> None:
    pieces.add(b"views", lasting=True)
    for _ in range(100):
        clock.now_s += 1.0
        pieces.add(b"x", lasting=False)
    reader = pieces.join(0)
    assert numbers(pieces.take(reader)) == [1, *range(101 - int(RECENT_S), 102)]
    assert reader.skipped == 0
    again = pieces.join(90)  # it had all of these when its connection was lost
    assert numbers(pieces.take(again)) == list(range(91, 102))
    assert numbers(pieces.take(pieces.join(10**9))) == []


def test_memory_is_bounded_and_the_beginning_stays(pieces: Pieces) -> None:
    big = b"x" * (1 << 20)
    for _ in range(200):
        pieces.add(big, lasting=True)
        pieces.add(big, lasting=False)
    assert pieces.held_bytes <= FIRST_BYTES + LASTING_BYTES + RECENT_BYTES
    kept = [piece for piece in pieces.take(pieces.join(0)) if piece.lasting]
    assert numbers(kept)[: FIRST_BYTES >> 20] == [1, 3, 5, 7]
    assert numbers(kept)[-1] == 399


def test_a_piece_is_made_when_a_page_is_ready_for_it(pieces: Pieces, clock: FakeClock) -> None:
    assert pieces.period_s == SLOWEST_S  # nobody looks
    fast, slow = pieces.join(0), pieces.join(0)
    assert pieces.period_s == FASTEST_S  # they have nothing yet
    pieces.add(b"x", lasting=False)
    for reader in (fast, slow):
        pieces.take(reader)
    assert pieces.period_s == SLOWEST_S
    clock.now_s += 0.4
    pieces.drawn(fast)
    assert pieces.period_s == SLOWEST_S
    clock.now_s += REST * 0.4 + 1e-6  # it has other things to do
    assert pieces.period_s == FASTEST_S
    pieces.add(b"x", lasting=False)
    pieces.take(fast)
    clock.now_s += 60.0  # and is hidden, and the other never draws: nothing needs to be made for them
    assert pieces.period_s == SLOWEST_S
    pieces.drawn(slow)
    clock.now_s += MOST_REST_S + 1e-6  # however long it took
    assert pieces.period_s == FASTEST_S
    pieces.part(slow)
    assert pieces.period_s == SLOWEST_S


@pytest.fixture
def page() -> Iterator[PageServer]:
    with PageServer() as server:
        yield server


def test_a_batch_comes_once_the_one_before_was_drawn(page: PageServer) -> None:
    page.pieces.add(b"first", lasting=True, until_ns=5)
    with socket_to(page, "data") as websocket:
        assert websocket.recv(PATIENCE_S) == b"first"
        assert json.loads(websocket.recv(PATIENCE_S)) == {
            "batch": 1,
            "last": 1,
            "until_ns": 5,
            "behind_s": None,
            "skipped": 0,
        }
        page.pieces.add(b"second", lasting=False)
        page.pieces.add(b"third", lasting=False)
        with pytest.raises(TimeoutError):
            websocket.recv(0.2)  # as while the page is hidden
        websocket.send('{"batch":1}')
        assert [websocket.recv(PATIENCE_S) for _ in range(2)] == [b"second", b"third"]
        assert json.loads(websocket.recv(PATIENCE_S))["last"] == 3
        websocket.send('{"batch":2}')
    with socket_to(page, "data?after=2") as websocket:
        assert websocket.recv(PATIENCE_S) == b"third"
