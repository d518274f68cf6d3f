"""All pages see one state; one of them steers; every command is answered at once, whatever it does."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest
from websockets.sync.client import connect

from deformscope.page.server import messages
from deformscope.page.server.page_server import PageServer
from deformscope.page.server.page_session import BEAT_S, CONFIRM_S, NEXT, PageSession
from tests.page.pages import PageScript, netloc, page_script, root
from tests.patience import PATIENCE_S


class Notebook:
    """What goes on: notes and tares."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def handle(self, command: messages.PageCommand) -> tuple[messages.Outcome, str]:
        match command:
            case messages.WriteNote():
                self.notes.append(command.text)
                return "done", "noted"
            case messages.TareDevice():
                raise RuntimeError("the sensor\nmoves")
            case _:
                return "done", "stopped"


@pytest.fixture
def page() -> Iterator[PageServer]:
    with PageServer("bench") as server:
        server.session.enter("live", commands=("write-note", "tare", "stop"))
        yield server


def test_two_pages_see_the_same_and_one_steers(page: PageServer) -> None:
    notebook = Notebook()
    page.session.bind(notebook)
    with page_script(page, "a") as first, page_script(page, "b") as second:
        for one in (first, second):
            state = one.until(lambda state: state["pages"] == 2)
            assert (state["title"], state["phase"], state["controls"]) == ("bench", "live", "a")
        assert first.command("write-note", text="touched") == ("done", "noted")
        assert second.command("write-note", text="no") == (
            "refused",
            "another page has the controls: take them over first",
        )
        assert second.command("take-controls")[0] == "done"
        assert first.until(lambda state: state["controls"] == "b")
        assert first.command("write-note", text="no")[0] == "refused"
        assert second.command("write-note", text="again") == ("done", "noted")
        assert first.command("stop") == ("done", "stopped")  # from any page
        assert notebook.notes == ["touched", "again"]
    with page_script(page, "c") as third:  # both are gone: whoever comes steers
        assert third.until(lambda state: state["controls"] == "c")["pages"] == 1


def test_through_a_forwarded_port(page: PageServer) -> None:
    """As by ssh -L: the browser's Host and Origin have another port than the server."""
    page.session.bind(Notebook())
    with socket.create_server(("127.0.0.1", 0)) as near:
        threading.Thread(target=forward, args=(near, int(netloc(page).split(":")[1])), daemon=True).start()
        other = f"127.0.0.1:{near.getsockname()[1]}"
        address = f"ws://{other}{root(page)}session"
        with connect(address, origin=f"http://{other}", proxy=None) as websocket:  # type: ignore[arg-type]
            assert PageScript(websocket, "far").command("write-note", text="from afar") == ("done", "noted")


def forward(near: socket.socket, port: int) -> None:
    """One connection to a port, on to another."""

    def pump(source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(1 << 16):
                sink.sendall(data)
        with suppress(OSError):
            sink.shutdown(socket.SHUT_WR)

    with near.accept()[0] as came, socket.create_connection(("127.0.0.1", port)) as far:
        back = threading.Thread(target=pump, args=(far, came), daemon=True)
        back.start()
        pump(came, far)
        back.join()


def test_what_a_command_cannot_do_is_said(page: PageServer) -> None:
    with page_script(page, "a") as one:
        assert one.command("write-note", text="x")[0] == "refused"  # nothing attends yet
        page.session.bind(Notebook())
        assert one.command("tare", device="tip") == ("refused", "the sensor moves")
        assert one.command("start-recording") == (
            "refused",
            "no start-recording while it is live; possible: write-note, tare, stop",
        )
        page.session.enter("stopped", "by Ctrl-C")
        assert one.until(lambda state: state["phase"] == "stopped")["commands"] == []
        assert one.command("write-note", text="x") == ("refused", "it has stopped: by Ctrl-C")


@pytest.mark.realtime
def test_answers_come_at_once(page: PageServer) -> None:
    """Also while the state changes all the time; the median of many, as others have the machine too."""
    page.session.bind(Notebook())
    with page_script(page, "a") as one:
        took = []
        for number in range(50):
            page.session.remark(f"number {number}")
            began = time.monotonic()
            one.command("write-note", text="x")
            took.append(time.monotonic() - began)
    assert sorted(took)[len(took) // 2] < 0.1


def test_no_phase_follows_that_may_not() -> None:
    for phase, following in NEXT.items():
        for other in NEXT:
            session = PageSession()
            way = {"idle": [], "paused": ["exploring", "paused"]}.get(phase, [phase])
            for step in way:
                session.enter(step)  # type: ignore[arg-type]
            if other in following or other == phase:
                session.enter(other)
                assert session.state.phase == other
            else:
                with pytest.raises(ValueError, match="does not follow"):
                    session.enter(other)


def test_remarks_are_the_newest() -> None:
    session = PageSession()
    for number in range(1000):
        session.remark(f"number {number}", bad=number == 999)
    remarks = session.state.remarks
    assert len(remarks) == 50
    assert (remarks[-1].number, remarks[-1].words, remarks[-1].bad) == (1000, "number 999", True)


class Moves:
    """What waits for a confirm at a session whose time is set by hand, with two pages at it; `a` has the controls."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.happened: list[str] = []
        self.session = PageSession(clock=lambda: self.now_s)
        self.session.come("a")
        self.session.come("b")
        self.session.enter("paused")
        self.ask()
        for page in ("a", "b"):
            self.session.beat(page, visible=True)

    def ask(self) -> int:
        """The number of a move that waits from now on."""
        self.session.ask("the arm", lambda: self.happened.append("moved"), self.happened.append)
        return self.session.state.pending.number

    def say(
        self,
        page: str,
        number: int,
        kind: type[messages.ConfirmMove | messages.CancelMove | messages.SeeMove] = messages.ConfirmMove,
    ) -> tuple[str, str]:
        reply = self.session.command(page, kind(1, number))
        return reply.outcome, reply.words


def test_a_move_waits_for_its_confirm() -> None:
    moves = Moves()
    assert moves.happened == []
    assert moves.say("b", 1)[0] == "refused"  # another page has the controls
    assert moves.say("a", 2)[0] == "refused"  # there is no such move
    assert moves.say("a", 1) == ("done", "the arm")
    assert moves.say("a", 1)[0] == "refused"  # once, and no more
    assert moves.happened == ["moved"]
    assert moves.session.state.pending is None


def test_a_confirm_expires() -> None:
    moves = Moves()
    moves.now_s += CONFIRM_S
    moves.session.beat("a", visible=True)
    assert moves.say("a", 1) == ("refused", "not confirmed within 10 s: nothing moves")
    assert moves.happened == ["not confirmed within 10 s: nothing moved"]


def test_the_time_of_a_question_counts_from_when_it_was_drawn_once() -> None:
    """A page that is busy draws it late; whoever then has 10 s to read it has no more."""
    moves = Moves()
    moves.now_s += CONFIRM_S + 5.0
    moves.session.beat("a", visible=True)
    assert moves.say("b", 1, messages.SeeMove)[0] == "refused"  # it does not steer
    assert moves.say("a", 1, messages.SeeMove)[0] == "done"
    moves.now_s += CONFIRM_S - 0.1
    assert moves.say("a", 1, messages.SeeMove)[0] == "refused"  # seen before
    moves.session.beat("a", visible=True)
    assert moves.say("a", 1) == ("done", "the arm")
    moves.ask()
    assert moves.say("a", 2, messages.SeeMove)[0] == "done"
    moves.now_s += CONFIRM_S
    moves.session.beat("a", visible=True)
    assert moves.say("a", 2)[0] == "refused"
    assert moves.happened == ["moved", "not confirmed within 10 s: nothing moved"]


def test_what_nobody_answers_is_let_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seen or not, by itself; the one who waits next is not."""
    monkeypatch.setattr("deformscope.page.server.page_session.UNSEEN_S", 0.05)
    monkeypatch.setattr("deformscope.page.server.page_session.CONFIRM_S", 0.2)
    let_be = [threading.Event() for _ in range(2)]
    session = PageSession()
    session.come("a")
    session.enter("paused")
    for number, waits in enumerate(let_be, 1):
        session.ask("the arm", lambda: None, lambda reason, waits=waits: waits.set())  # type: ignore[misc]
        if number == 2:
            assert session.command("a", messages.SeeMove(1, number)).outcome == "done"
            assert not waits.wait(0.06)  # as long as what nobody has seen
        assert waits.wait(PATIENCE_S)
        assert session.state.pending is None


def test_nothing_else_moves_by_a_confirm() -> None:
    """What waited is let be where another move is asked for, where it is cancelled, and where another page steers."""
    moves = Moves()
    assert moves.ask() == 2
    assert moves.say("a", 1)[0] == "refused"
    assert moves.say("a", 2, messages.CancelMove) == ("done", "nothing moves")
    assert moves.ask() == 3
    moves.session.command("b", messages.TakeControls(1))
    assert moves.say("b", 3)[0] == "refused"
    assert moves.happened == [
        "another move was requested",
        "cancelled: nothing moved",
        "another page took the controls over",
    ]


def test_a_page_that_is_not_there_confirms_nothing() -> None:
    moves = Moves()
    moves.now_s += BEAT_S + 0.01
    assert moves.say("a", 1)[0] == "refused"
    moves.session.beat("a", visible=False)
    assert moves.say("a", 1) == ("refused", "the page that has the controls is hidden")
    moves.session.beat("a", visible=True)
    assert moves.say("a", 1)[0] == "done"


def test_whether_the_page_that_steers_is_there() -> None:
    moves = Moves()
    session = moves.session
    assert session.absent() == ""
    moves.now_s += BEAT_S - 0.01
    assert session.absent() == ""
    moves.now_s += 0.02
    assert session.absent() == "no heartbeat of the page for 310 ms"
    session.beat("b", visible=True)
    assert session.absent() != ""  # it does not steer
    session.command("b", messages.TakeControls(1))
    assert session.absent() == ""
    session.leave("b")
    assert session.absent() == "no page has the controls"


def test_heartbeats_get_no_answer(page: PageServer) -> None:
    page.session.bind(Notebook())
    with page_script(page, "a") as one:
        one.beat()
        assert one.command("write-note", text="x") == ("done", "noted")
        assert page.session.absent() == ""
        one.beat(visible=False)
        one.command("write-note", text="x")
        assert page.session.absent() == "the page that has the controls is hidden"
