"""A squeeze from a page: the hand moves once that was confirmed, and no longer than somebody is there."""

from pathlib import Path
from typing import Any

import pytest

from deformscope.page.devices import ShownDevices
from deformscope.page.robot_page import PageSqueezing
from deformscope.page.server.messages import ConfirmMove, StartSqueezing, StopRun
from deformscope.page.server.page_session import PageSession
from deformscope.recording.items import read_results
from deformscope.runs.skeleton import Watch
from deformscope.stages.squeeze.trial import SqueezePhase, SqueezeStop
from deformscope.terminal import Interruption
from tests.page.pages import page_script
from tests.page.test_pieces import FakeClock
from tests.page.test_rig_on_page import started

WHAT = "the hand closes"


class Hand:
    """As a watch sees it. stops: why it was asked to"""

    doing = ""

    def __init__(self) -> None:
        self.stops: list[str] = []

    def ask_to_stop(self, reason: str) -> None:
        self.stops.append(reason)

    def halt(self, reason: str) -> bool:
        return True


class Bench:
    """A session, a squeeze and a hand, no devices; the clock stands unless it is set."""

    def __init__(self) -> None:
        self.clock, self.asked, self.hand = FakeClock(), Interruption(), Hand()
        self.session = PageSession(clock=self.clock)
        self.squeezing = PageSqueezing(self.session, self.asked, ShownDevices(self.session, ()))
        self.watch = Watch(self.asked, lambda words: None)
        self.watch.robot = self.hand
        self.session.come("one")

    def confirm(self) -> str:
        """Ask and confirm; the outcome."""
        assert self.session.command("one", StartSqueezing(1)).outcome == "begun"
        pending = self.session.state.pending
        assert pending.what == WHAT
        return self.session.command("one", ConfirmMove(2, pending.number)).outcome

    def stopped(self) -> list[str]:
        """Why the hand was asked to stop, after one control period more."""
        if why := self.squeezing.reason_to_stand():
            self.hand.ask_to_stop(why)
        return self.hand.stops


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_nothing_moves_before_a_page_that_is_there_confirms(bench: Bench) -> None:
    assert bench.session.command("one", StartSqueezing(1)).outcome == "refused"  # nothing waits
    bench.squeezing.wait_for(WHAT)
    assert bench.confirm() == "refused"  # no heartbeat
    assert not bench.squeezing.is_agreed()
    bench.session.beat("one", visible=False)
    assert bench.confirm() == "refused"
    assert not bench.squeezing.is_agreed()
    bench.session.beat("one", visible=True)
    assert bench.confirm() == "done"
    assert bench.squeezing.is_agreed()
    bench.squeezing.go_on()
    assert bench.session.state.phase == "squeezing"
    assert bench.session.command("one", StartSqueezing(1)).outcome == "refused"
    bench.squeezing.wait_for(WHAT)  # the next motion is a question of its own
    assert not bench.squeezing.is_agreed()
    assert bench.session.state.phase == "paused"


@pytest.mark.parametrize("loss", ["silent", "hidden", "gone"])
def test_the_hand_stops_where_nobody_watches_what_they_confirmed(bench: Bench, loss: str) -> None:
    bench.squeezing.wait_for(WHAT)
    bench.session.beat("one", visible=True)
    bench.confirm()
    bench.squeezing.go_on()
    bench.clock.now_s += 0.29
    assert bench.stopped() == []
    match loss:
        case "silent":
            bench.clock.now_s += 0.02
        case "hidden":
            bench.session.beat("one", visible=False)
        case _:
            bench.session.leave("one")
    assert len(bench.stopped()) == 1


def test_a_squeeze_agreed_to_at_the_terminal_needs_no_page(bench: Bench) -> None:
    bench.squeezing.wait_for(WHAT)
    bench.squeezing.go_on()
    bench.clock.now_s += 60.0
    assert bench.stopped() == []


def test_stop(bench: Bench) -> None:
    bench.squeezing.go_on()
    assert bench.session.command("other", StopRun(1)).outcome == "done"  # from any page
    bench.watch()
    assert bench.hand.stops == ["from the page"]


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [False, True])
def test_a_squeeze_from_the_page(tmp_path: Path, hidden: bool) -> None:
    file = tmp_path / "squeezed.rrd"
    words = ("squeeze", "lab:containers", "--content", "rice", "--container", "box-07", "--paused")
    with (
        started(*words, "--page-timeout", "60", "--record", str(file), folder=tmp_path) as command,
        page_script(command.page, "one") as one,
    ):
        with one.beating():
            one.until(lambda state: "squeeze" in state["commands"])
            one.command("squeeze")
            state = one.until(lambda state: state["pending"])
            assert one.command("confirm", number=state["pending"]["number"])[0] == "done"
            one.until(lambda state: state["reason"] == "squeeze" if hidden else state["phase"] == "stopped")
        if hidden:
            one.beat(visible=False)
            one.until(lambda state: state["phase"] == "stopped")
        found = command.ended()
    stops = [row.item for row in read_results(file, (SqueezeStop,), trust=True)]
    phases: list[Any] = [row.item.name for row in read_results(file, (SqueezePhase,), trust=True)]
    if hidden:
        assert "hidden" in stops[0].reason
        assert "hold" not in phases
    else:
        assert stops == []
        assert "hold" in phases
    assert found["hand_stands"]
