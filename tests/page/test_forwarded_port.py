"""The page through a forwarded port, as `ssh -L 8080:127.0.0.1:PORT robot` makes one: another port, the same token."""

import http.client
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from deformscope.page.server.messages import StopRun
from deformscope.page.server.page_server import PageServer
from tests.page.pages import PageScript, netloc, root
from tests.page.test_in_browser import Obeyed, browser, fake_viewer, shown, until
from tests.patience import PATIENCE_S

__all__ = ["browser", "shown"]

DOCUMENTED = ("ssh -L 8080:127.0.0.1:PORT robot", "http://127.0.0.1:8080/TOKEN/")


@contextmanager
def forwarded(port: int) -> Iterator[int]:
    """A port of this machine whose connections go to the other one, byte for byte, as ssh's client and server do."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        opened: list[socket.socket] = []

        def accept() -> None:
            with suppress(OSError):
                while True:
                    near = listening.accept()[0]
                    far = socket.create_connection(("127.0.0.1", port))
                    opened.extend((near, far))
                    for one, other in ((near, far), (far, near)):
                        threading.Thread(target=pump, args=(one, other), daemon=True).start()

        def pump(one: socket.socket, other: socket.socket) -> None:
            with suppress(OSError):
                while data := one.recv(65536):
                    other.sendall(data)
                other.shutdown(socket.SHUT_WR)

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        yield int(listening.getsockname()[1])
        listening.shutdown(socket.SHUT_RDWR)
        thread.join(PATIENCE_S)
        for one in opened:
            one.close()


@pytest.fixture
def page() -> Iterator[PageServer]:
    with PageServer("bench") as server:
        server.session.enter("live", commands=("stop",))
        yield server


def status(port: int, path: str, **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    try:
        connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
        return connection.getresponse().status
    finally:
        connection.close()


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_a_forwarded_port_is_the_page(page: PageServer, name: str) -> None:
    run = Obeyed()
    page.session.bind(run)
    with forwarded(int(netloc(page).split(":")[1])) as port:
        here = f"{name}:{port}"
        assert status(port, root(page), Host=here) == 200
        assert status(port, root(page) + "page.js", Host=here, Origin=f"http://{here}") == 200
        with connect(f"ws://{here}{root(page)}session", origin=Origin(f"http://{here}"), proxy=None) as websocket:
            assert PageScript(websocket, "remote").command("stop") == ("done", "")
    assert isinstance(run.commands[0], StopRun)


def test_who_is_refused_at_the_server_is_refused_through_the_port(page: PageServer) -> None:
    own = netloc(page)
    with forwarded(int(own.split(":")[1])) as port:
        here = f"127.0.0.1:{port}"
        assert status(port, "/" + "x" * 32 + "/") == 403
        for host, origin in (
            ("evil.example", None),  # a name that was rebound
            (f"evil.example:{port}", f"http://evil.example:{port}"),
            (here, f"http://{own}"),  # a page at another port, be it the server's own
            (here, "http://evil.example"),
            (here, "null"),
        ):
            headers = {"Host": host} | ({} if origin is None else {"Origin": origin})
            assert status(port, root(page), **headers) == 403
        for origin in (f"http://{own}", "http://evil.example", None):
            with (
                pytest.raises(InvalidStatus) as refused,
                connect(
                    f"ws://{here}{root(page)}session", origin=None if origin is None else Origin(origin), proxy=None
                ),
            ):
                pytest.fail("opened")
            assert refused.value.response.status_code == 403


def test_a_browser_gives_commands_through_the_port(page: PageServer, shown: Any) -> None:
    run = Obeyed()
    page.session.bind(run)
    fake_viewer(shown)
    page.pieces.add(b"views", lasting=True)
    with forwarded(int(netloc(page).split(":")[1])) as port:
        shown.goto(DOCUMENTED[1].replace("8080", str(port)).replace("TOKEN", root(page).strip("/")))
        until(shown, lambda: shown.inner_text("#phase") == "live")
        until(shown, lambda: shown.evaluate("window.pieces.length") == 1)  # the viewer's data, too
        shown.keyboard.press(" ")
        until(shown, lambda: run.commands)
        shown.goto("about:blank")
    assert isinstance(run.commands[0], StopRun)


def test_the_docs_name_this_way() -> None:
    docs = (Path(__file__).parents[2] / "docs" / "howto" / "watch-a-rig.md").read_text(encoding="utf-8")
    for line in DOCUMENTED:
        assert line in docs
