"""A page's server and what asks it: plain HTTP and websockets, with any header."""

import http.client
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from websockets.sync.client import ClientConnection, connect

from deformscope.page.server.page_server import PageServer
from tests.patience import PATIENCE_S


def get(page: PageServer, path: str, headers: dict[str, str] | None = None, method: str = "GET") -> tuple[int, bytes]:
    """Status and content. path: below the server, with the token where it is wanted; as it is, nothing is escaped"""
    connection = http.client.HTTPConnection(netloc(page), timeout=PATIENCE_S)
    try:
        connection.putrequest(method, path, skip_host="Host" in (headers or {}))
        for name, value in (headers or {}).items():
            connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def netloc(page: PageServer) -> str:
    return urlsplit(page.address).netloc


def token(page: PageServer) -> str:
    return urlsplit(page.address).path.strip("/")


def root(page: PageServer) -> str:
    return f"/{token(page)}/"


@contextmanager
def socket_to(page: PageServer, what: str, **options: Any) -> Iterator[ClientConnection]:
    """A websocket as a browser opens it from the page; options: of `connect`, which replace its own"""
    given: dict[str, Any] = {"origin": f"http://{netloc(page)}", "max_size": None, "proxy": None}
    with connect(f"ws://{netloc(page)}{root(page)}{what}", **(given | options)) as websocket:
        yield websocket


class PageScript:
    """A page's script, as far as state and commands go."""

    def __init__(self, websocket: ClientConnection, name: str) -> None:
        self._websocket, self._id = websocket, 0
        self.state: dict[str, Any] = {}
        self._send(kind="hello", version=1, page=name)
        self.until(lambda state: bool(state))

    def command(self, kind: str, **fields: Any) -> tuple[str, str]:
        """Outcome and words."""
        number = self._send(kind=kind, **fields)
        while True:
            message = self._next()
            if message["kind"] == "reply":
                assert message["id"] == number
                return message["outcome"], message["words"]

    def beat(self, *, visible: bool = True) -> None:
        """The heartbeat of its script, once. From any thread"""
        self._websocket.send(json.dumps({"id": 0, "kind": "beat", "visible": visible}))

    @contextmanager
    def beating(self) -> Iterator[None]:
        """Ten times a second until the end of the context."""
        over = threading.Event()

        def work() -> None:
            while not over.wait(0.1):
                self.beat()

        self.beat()
        thread = threading.Thread(target=work)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def until(self, wanted: Any) -> dict[str, Any]:
        """The first state that is wanted."""
        while not wanted(self.state):
            self._next()
        return self.state

    def _send(self, **message: Any) -> int:
        self._id += 1
        self._websocket.send(json.dumps({"id": self._id} | message))
        return self._id

    def _next(self) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(self._websocket.recv(PATIENCE_S))
        if message["kind"] == "state":
            self.state = message
        return message


@contextmanager
def page_script(page: PageServer, name: str) -> Iterator[PageScript]:
    with socket_to(page, "session") as websocket:
        yield PageScript(websocket, name)
