"""The page's side of steering: what waits for a confirm, where somebody points, and its heartbeat."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from deformscope.page.server import messages
from deformscope.page.server.page_server import PageServer
from tests.page.test_in_browser import Obeyed, browser, fake_viewer, shown, until

__all__ = ["browser", "shown"]

COMMANDS = ("stop", "explore", "touch-at", "touch-picked")
EXPECTED = (0.0, 1.0, 2.0)


class Seen:
    """Calls this with each command."""

    def __init__(self, call: Callable[[], None]) -> None:
        self._call = call

    def handle(self, command: messages.PageCommand) -> tuple[messages.Outcome, str]:
        self._call()
        return "done", ""


@contextmanager
def no_heartbeat(page: PageServer) -> Iterator[None]:
    """For the session nobody is there meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page.session, "absent", lambda: "nobody is there")
        yield


def test_confirms_and_places(shown: Any) -> None:
    run, happened = Obeyed(), list[str]()
    with PageServer("bench") as page:
        page.session.bind(run)
        page.session.enter("paused", commands=COMMANDS)
        fake_viewer(shown)
        shown.goto(page.address)
        until(shown, lambda: shown.inner_text("#phase") == "paused" and not page.session.absent())

        # the dialog names what moves; space stops while it is open; Enter confirms, Escape cancels
        for key, came in (("Enter", "moved"), ("Escape", "cancelled: nothing moved")):
            page.session.ask("the arm <b>moves</b>", lambda: happened.append("moved"), happened.append)
            until(shown, lambda: shown.is_visible("#confirm"))
            assert shown.inner_text("#confirm-what") == "the arm <b>moves</b>"
            shown.keyboard.press(" ")
            shown.keyboard.press(key)
            until(shown, lambda came=came: happened[-1:] == [came] and shown.is_hidden("#confirm"))
        assert len(happened) == 2
        assert [type(one) for one in run.commands] == [messages.StopRun, messages.StopRun]

        # one that is refused for now still waits; its time counts from when it was drawn; that it was let be is said
        happened.clear()
        page.session.ask("the arm", lambda: happened.append("moved"), page.session.remark)
        until(shown, lambda: page.session.state.pending is not None and page.session.state.pending.seen)
        with no_heartbeat(page):
            shown.keyboard.press("Enter")
            until(shown, lambda: "confirm: refused, nobody is there" in shown.inner_text("#remarks"))
        until(shown, lambda: shown.is_visible("#confirm"))
        shown.keyboard.press("Enter")
        until(shown, lambda: happened == ["moved"] and shown.is_hidden("#confirm"))
        page.session.ask("the arm", lambda: None, page.session.remark)
        until(shown, lambda: shown.is_visible("#confirm"))
        page.session._drop("not in time")
        until(shown, lambda: shown.inner_text("#place-words") == "not in time" and shown.is_hidden("#confirm"))

        # a place that is typed, one that is picked, and one that is picked beside everything
        shown.fill("#place-x", "31.5")
        shown.fill("#place-y", "20")
        shown.keyboard.press("Enter")
        until(shown, lambda: len(run.commands) == 3)
        pick = "document.dispatchEvent(new CustomEvent('viewer', {detail: {type: 'selection_change', items: [%s]}}))"
        shown.evaluate(pick % "")
        shown.evaluate(pick % "{type: 'entity', entity_path: '/display/scene/surface'}")  # out of a list, not a place
        shown.evaluate(pick % "{type: 'entity', entity_path: '/display/scene/surface', position: [0.25, 0.125, 0.5]}")
        shown.evaluate("document.activeElement.blur()")
        shown.keyboard.press("x")
        until(shown, lambda: len(run.commands) == 5)
        match run.commands[2:]:
            case [
                messages.TouchAt(x_m=0.315, y_m=0.2),
                messages.TouchPicked(position_m=(0.25, 0.125, 0.5)),
                messages.StartExploring(),
            ]:
                pass
            case other:
                raise AssertionError(other)
        page.session.remark("no touch there: the arm cannot reach it from above", bad=True)
        until(shown, lambda: "cannot reach" in shown.inner_text("#place-words"))

        # what is expected, and what was felt
        curve = messages.ForceCurve(0.3, 0.2, "2 touches", EXPECTED, EXPECTED, (0.0, 0.5, 1.0), (0.0, 2.0, 4.0))
        page.session.show(curve=curve)
        until(shown, lambda: "expected" in shown.inner_text("#curve figcaption"))
        drawn = shown.get_attribute("#curve .expected", "d")
        assert drawn.count("L") == 2
        assert "NaN" not in drawn + shown.get_attribute("#curve .band", "d")


def test_the_heartbeat_says_whether_somebody_is_there(shown: Any) -> None:
    with PageServer("bench") as page:
        page.session.enter("live")
        fake_viewer(shown)
        shown.goto(page.address)
        until(shown, lambda: not page.session.absent())
        for seen, absent in (("hidden", "the page that has the controls is hidden"), ("visible", "")):
            shown.evaluate(
                f"Object.defineProperty(document, 'visibilityState', {{ value: '{seen}', configurable: true }});"
                "document.dispatchEvent(new Event('visibilitychange'))"
            )
            until(shown, lambda absent=absent: page.session.absent() == absent)

        # who presses a button is there, however long the page was busy before
        page.session.enter("live", commands=("stop",))
        until(shown, lambda: shown.is_enabled("#stop"))
        there = list[str]()
        page.session.bind(Seen(lambda: there.append(page.session.absent())))
        shown.evaluate(
            "for (const end = performance.now() + 2500; performance.now() < end; );"
            "document.getElementById('stop').click()"
        )
        until(shown, lambda: there == [""])

        # a script that hangs has no heartbeat
        reasons, over = set[str](), threading.Event()

        def look() -> None:
            while not over.wait(0.02):
                reasons.add(page.session.absent()[:20])

        looking = threading.Thread(target=look)
        looking.start()
        shown.evaluate("for (const end = performance.now() + 2500; performance.now() < end; );")
        over.set()
        looking.join()
        assert "no heartbeat of the " in reasons
        until(shown, lambda: not page.session.absent())
        shown.goto("about:blank")
        until(shown, lambda: page.session.absent() == "no page has the controls")
