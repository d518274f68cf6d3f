"""Space stops, plays or does nothing on a page, whatever has the focus; where text is typed, Ctrl+space does."""

from pathlib import Path
from typing import Any

from deformscope.page.server.messages import Playback, StopRun
from deformscope.page.server.page_server import PageServer
from tests.page.test_in_browser import DEVICES, Obeyed, browser, fake_viewer, shown, until

__all__ = ["browser", "shown"]

COMMANDS = (
    *("stop", "start-recording", "stop-recording", "keep-recent", "write-note", "begin-episode", "end-episode"),
    *("discard", "tare", "explore", "pause", "touch-at", "touch-next", "veto", "squeeze"),
)
PLACES = """() => {
  window.places = [...document.querySelectorAll("button, input, select, canvas")]
    .filter((one) => one.offsetParent && !one.disabled && !one.closest("dialog"));
  return window.places.map((one) => one.type === "text" && one.closest("#controls") !== null);
}"""
SET = "() => window.places.filter((one) => one.type !== 'text').map((one) => [one.checked, one.value])"


def focused(page: Any, index: int) -> None:
    page.evaluate("(index) => { document.activeElement.blur(); window.places[index].focus(); }", index)


def test_space_stops_whatever_has_the_focus_but_where_text_is_typed(shown: Any) -> None:
    fake_viewer(shown)
    with PageServer("bench") as page:
        page.session.enter("live", commands=COMMANDS, tares=("tip",), devices=DEVICES)
        run = Obeyed()
        page.session.bind(run)
        shown.goto(page.address)
        until(shown, lambda: shown.inner_text("#phase") == "live")
        until(shown, lambda: shown.is_visible("[data-kind=squeeze]"))
        texts, before = shown.evaluate(PLACES), shown.evaluate(SET)
        assert texts.count(True) == 3
        assert len(texts) > 20
        stops = 0
        for index, text in enumerate(texts):
            for key, stopping in ((" ", not text), ("Control+Space", True)):
                focused(shown, index)
                shown.keyboard.press(key)
                stops += stopping
                until(shown, lambda: len(run.commands) >= stops)  # noqa: B023
        assert [type(one) for one in run.commands] == [StopRun] * stops
        assert shown.evaluate(SET) == before
        assert shown.input_value("#note-text") == " "


def test_space_plays_a_recording_whatever_has_the_focus(shown: Any, tmp_path: Path) -> None:
    (tmp_path / "mine.rrd").write_bytes(b"RRF2")
    fake_viewer(shown)
    with PageServer("mine.rrd", tmp_path / "mine.rrd") as page:
        page.session.show(playback=Playback("session", 900 * 10**9, 10**8))
        shown.goto(page.address)
        until(shown, lambda: shown.inner_text("#moment").endswith("of 900.00 s"))
        texts, before = shown.evaluate(PLACES), shown.evaluate(SET)
        assert len(texts) > 5
        for index in range(len(texts)):
            focused(shown, index)
            shown.keyboard.press(" ")
            playing = index % 2 == 0
            until(shown, lambda: shown.inner_text("#play").startswith("Pause" if playing else "Play"))  # noqa: B023
        assert shown.evaluate(SET) == before
