"""A recording that a page plays: its chapters, and that it is served whole to the page alone."""

from pathlib import Path
from typing import Any

from deformscope.frames import SessionNote
from deformscope.page.playback import chapters_of
from deformscope.page.server.messages import Chapter, Playback
from deformscope.page.server.page_server import PageServer
from deformscope.recording.reader import Row
from deformscope.stages.map.exploration import PhaseStart
from deformscope.stages.squeeze.trial import SqueezePhase
from tests.page.pages import get, page_script, root
from tests.page.test_in_browser import FAKE_VIEWER, browser, shown, until

__all__ = ["browser", "shown"]

S = 1_000_000_000


def rows(*given: tuple[float, object, int]) -> list[Row]:
    return [Row(round(at_s * S), touch, item) for at_s, item, touch in given]


def test_touches_are_chapters() -> None:
    found = chapters_of(
        rows(
            (0.0, PhaseStart("look", 0), 0),
            (1.0, PhaseStart("plan", 0), 0),
            (2.0, PhaseStart("travel", 0), 1),
            (3.0, PhaseStart("approach", 0), 1),
            (6.0, PhaseStart("travel", 1), 2),
            (8.0, PhaseStart("stopped: a person asked", 2), 2),
        ),
        9 * S,
    )
    assert [(one.name, one.from_ns // S, one.until_ns // S) for one in found] == [
        ("look", 0, 2),
        ("touch 1", 2, 6),
        ("touch 2", 6, 8),
        ("stopped: a person asked", 8, 9),
    ]


def test_episodes_notes_and_phases_are_chapters() -> None:
    found = chapters_of(
        rows(
            (1.0, SessionNote(0, "episode-begin", "soft"), 0),
            (2.0, SessionNote(0, "note", "it gives"), 0),
            (3.0, SessionNote(0, "episode-end", "soft"), 0),
            (4.0, SessionNote(0, "episode-begin", "hard"), 0),
            (5.0, SqueezePhase("close"), 0),
        ),
        7 * S,
    )
    assert [(one.name, one.from_ns // S, one.until_ns // S) for one in found] == [
        ("soft", 1, 3),
        ("note: it gives", 2, 7),
        ("hard", 4, 7),
        ("close", 5, 7),
    ]
    assert chapters_of([], 0) == []


def test_a_recording_is_served_to_the_page_alone(tmp_path: Path) -> None:
    file = tmp_path / "mine.rrd"
    file.write_bytes(b"RRF2" + bytes(100_000))
    with PageServer("mine.rrd", file) as page:
        page.session.show(playback=Playback("session", S, S // 10))
        assert get(page, root(page) + "recording.rrd") == (200, file.read_bytes())
        assert b'<body data-recording="recording.rrd">' in get(page, root(page))[1]
        for path in ("/recording.rrd", root(page) + "mine.rrd", root(page) + "../recording.rrd"):
            assert get(page, path)[0] in (403, 404)
        assert get(page, root(page) + "recording.rrd", {"Origin": "http://evil.example"})[0] == 403
        with page_script(page, "a") as one:
            assert one.state["playback"]["until_ns"] == S
            assert one.command("stop")[0] == "refused"  # nothing goes on
    with PageServer("bench") as page:
        assert get(page, root(page) + "recording.rrd")[0] == 404
        assert b"data-recording" not in get(page, root(page))[1].split(b"<body")[1].split(b">")[0]


PLAYS = """
window.asked = [];
window.wasm_bindgen.WebHandle.prototype.add_receiver = function (url) {
  [window.received, window.handle] = [url, this];
};
window.wasm_bindgen.WebHandle.prototype.viewer_control = async (bytes) => window.asked.push([...bytes]);
"""


def test_chapters_steps_and_playing_move_the_viewers_time(shown: Any, tmp_path: Path) -> None:
    file = tmp_path / "mine.rrd"
    file.write_bytes(b"RRF2")
    chapters = (Chapter("touch 1", 2 * S, 4 * S),)
    shown.route(
        "**/re_viewer.js", lambda route: route.fulfill(body=FAKE_VIEWER + PLAYS, content_type="text/javascript")
    )
    shown.route("**/re_viewer_bg.wasm", lambda route: route.fulfill(body=""))

    def moment() -> list[int]:
        found: list[int] = shown.evaluate("window.asked.at(-1) ?? []")
        return found

    with PageServer("mine.rrd", file) as page:
        page.session.show(playback=Playback("session", 9 * S, S // 10, chapters))
        shown.goto(page.address)
        until(shown, lambda: shown.evaluate("window.received") == page.address + "recording.rrd")
        until(shown, lambda: shown.inner_text("#moment") == "9.00 of 9.00 s")
        shown.evaluate("window.asked = []")
        shown.evaluate("window.handle.tell({ type: 'timeline_change', timeline: 'log_time' })")  # rerun's own views
        assert shown.inner_text("#viewer-words") != ""  # they are covered
        shown.evaluate("window.handle.tell({ type: 'timeline_change' })")  # of the recording's views, which follow
        until(shown, lambda: shown.inner_text("#viewer-words") == "")
        until(shown, lambda: moment() == list(cursor(9 * S)))
        shown.evaluate("window.handle.tell({ type: 'time_update', time: 3e9 })")  # somebody has moved it in the viewer
        until(shown, lambda: shown.inner_text("#moment") == "3.00 of 9.00 s")
        shown.click("text=touch 1")
        until(shown, lambda: moment() == list(cursor(2 * S)))
        shown.keyboard.press(".")
        until(shown, lambda: moment() == list(cursor(2 * S + S // 10)))
        shown.keyboard.press(",")
        until(shown, lambda: moment() == list(cursor(2 * S)))
        shown.select_option("#speed", "10")
        shown.keyboard.press(" ")
        until(shown, lambda: moment() == list(cursor(4 * S)))  # the chapter's end
        until(shown, lambda: shown.inner_text("#play").startswith("Play"))
        assert shown.inner_text("#moment") == "4.00 of 9.00 s"
        assert shown.is_hidden("#stop")  # nothing goes on
        assert shown.is_hidden("#remarks")
        page.session.remark("map, with threshold = 0.1: 2 regions; recorded: 1 region")
        until(shown, lambda: "recorded: 1 region" in shown.inner_text("#remarks"))


def cursor(ns: int) -> bytes:
    """rerun's request by hand: fields of `ViewerControlRequest`, `SetTimeCursorRequest`, `Timeline`."""
    time = bytes([1 << 3]) + varint(ns)
    timeline = bytes([1 << 3 | 2, 7]) + b"session"
    inner = bytes([2 << 3 | 2, len(timeline)]) + timeline + bytes([3 << 3 | 2, len(time)]) + time + bytes([5 << 3, 1])
    return bytes([6 << 3 | 2, len(inner)]) + inner


def varint(value: int) -> bytes:
    found = bytearray()
    while value > 127:
        found.append(value & 127 | 128)
        value >>= 7
    return bytes([*found, value])
