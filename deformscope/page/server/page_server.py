"""The server of the page: on loopback, in a thread of its own, with a token in its address.

/TOKEN/               the page, its script and style, all of it known by name before the first request
/TOKEN/re_viewer...   rerun's web viewer out of the installed wheel
/TOKEN/recording.rrd  the recording that is played, where one is
/TOKEN/session           websocket: the state to the page, commands from it (`deformscope.page.server.messages`)
/TOKEN/data           websocket: pieces of the recording to the viewer in the page, `Drawn` from it

It accepts the requests of a page that it served, in a browser that reached it by a loopback name.

Other programs of this machine and other sites in its browsers lack the token of the address. A site whose own name
resolves to 127.0.0.1 (DNS rebinding) sends that name as Host; a page of another origin sends that as Origin."""

import asyncio
import atexit
import hmac
import itertools
import json
import logging
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketClose, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from deformscope.errors import InputError
from deformscope.page.server.messages import LONGEST_MESSAGE, VERSION, Beat, Drawn, Hello, PageCommand, PieceBatch
from deformscope.page.server.page_session import PageSession
from deformscope.page.server.pieces import PageReader, Pieces
from deformscope.page.server.viewer_files import LOOPBACK, NAMES, ViewerFiles

TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
RECORDING = "recording.rrd"
BACKLOG = 2048
"""Connections that wait in the kernel's queue."""
MOST_PAGES = 8
VIEWER_KEPT = "private, max-age=3600, immutable"
"""A reloaded page has the viewer, 43 MB, and its compiled form in the browser."""
STATE_EVERY_S = 0.1
"""Shortest period of the state's messages to a page."""
HELLO_S = 10.0
STOP_S = 5.0
BAD_MESSAGE, TOO_MANY, OTHER_VERSION = 1008, 1013, 4000
"""Codes with which a websocket is closed."""

MessageT = TypeVar("MessageT")
LOOPBACK_NAMES = ("127.0.0.1", "localhost", "[::1]")
"""Names of this machine, also through a forwarded port, whose number differs."""
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",  # the address holds the token
    "x-content-type-options": "nosniff",
    "cache-control": "no-store",
}
MOST_STRANGERS = 256
"""Connections without a valid request that are open at once; more of them wait in the kernel's queue."""
REQUEST_S = 1.0
"""Time limit for a connection's valid request."""
ACCEPT_AGAIN_S = 0.1


class Guard:
    """Passes on valid requests, with a path below the token; answers all others with 403, and a wrong method with 405.

    Connections without a valid request are strangers, closed after `REQUEST_S`. While there are `MOST_STRANGERS` no
    other connection is accepted: a browser on a busy machine, which connects long before it sends, has that time too.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._token = token.encode()
        self._strangers: dict[tuple[str, int] | None, asyncio.Transport] = {}
        self._places = asyncio.Semaphore(MOST_STRANGERS)

    async def accept(self, listening: socket.socket, protocol: Callable[[], asyncio.Protocol]) -> None:
        """Accept connections, each with a protocol of its own, in the order in which they came, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            await self._places.acquire()
            try:
                connection, client = await loop.sock_accept(listening)
                transport, _ = await loop.connect_accepted_socket(protocol, connection)
            except OSError:  # out of file descriptors, or it has gone
                self._places.release()
                await asyncio.sleep(ACCEPT_AGAIN_S)
                continue
            self._end(client, self._strangers.get(client))  # closed by its other end, whose port came back
            self._strangers[client] = transport
            loop.call_later(REQUEST_S, self._end, client, transport)

    def _end(self, client: tuple[str, int] | None, transport: asyncio.Transport | None) -> None:
        if transport is not None and self._strangers.get(client) is transport:
            self._passed(client)
            transport.abort()

    def _passed(self, client: tuple[str, int] | None) -> None:
        if self._strangers.pop(client, None) is not None:
            self._places.release()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            return
        status = 405 if scope.get("method", "GET") not in ("GET", "HEAD") else 200
        if not _from_the_page(Headers(scope=scope), websocket=scope["type"] == "websocket"):
            status = 403
        _, token, *rest = (*scope["path"].split("/", 2), "")[:3]
        if not hmac.compare_digest(token.encode(), self._token):
            status = 403

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        if status == 200:
            self._passed(scope["client"])
            path = "/" + rest[0]
            inner = {**scope, "path": path, "raw_path": path.encode(), "root_path": ""}
            await self._app(inner, receive, send_with_headers)
        elif scope["type"] == "websocket":
            await WebSocketClose(1008)(scope, receive, send)  # before it is accepted: HTTP 403
        else:
            await PlainTextResponse("refused\n", status, {"connection": "close"})(scope, receive, send_with_headers)


def _from_the_page(headers: Headers, *, websocket: bool) -> bool:
    """Whether Host and Origin are those of a page that this server served. A browser sends an Origin with every
    websocket."""
    hosts, origins = headers.getlist("host"), headers.getlist("origin")
    if len(hosts) != 1 or len(origins) > 1:
        return False
    host = hosts[0].lower()
    try:
        parts = urlsplit(f"http://{host}")
        name = parts.netloc if parts.port is None else parts.netloc.removesuffix(f":{parts.port}")
    except ValueError:
        return False
    if name not in LOOPBACK_NAMES or parts.netloc != host:
        return False
    if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
        return False
    return origins[0].lower() == f"http://{host}" if origins else not websocket


class GuardedServer(uvicorn.Server):
    """A server whose connections its guard accepts."""

    def __init__(self, config: uvicorn.Config, guard: Guard) -> None:
        super().__init__(config)
        self._guard = guard

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets=[])
        protocol = partial(
            H11Protocol, config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )
        self._accepting = [asyncio.create_task(self._guard.accept(one, protocol)) for one in sockets or []]

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        for task in self._accepting:
            task.cancel()
        await asyncio.gather(*self._accepting, return_exceptions=True)
        await super().shutdown(sockets)


class PageServer:
    """`with PageServer("lab:bench") as page: print(page.address)`.

    session: the state that pages show, and the commands they give; pieces: data for the viewer in the pages
    recording: a file that the pages play instead"""

    def __init__(self, title: str = "", recording: Path | None = None) -> None:
        self.session = PageSession(title)
        self.pieces = Pieces()
        self.address = ""
        self._token = secrets.token_urlsafe(24)
        self._viewer_files = ViewerFiles()
        self._static = {
            file.name: (file.read_bytes(), TYPES["." + file.name.rsplit(".", 1)[1]])
            for file in (resources.files("deformscope.page.server") / "static").iterdir()
        }
        self._offered: dict[str, tuple[bytes, str]] = {}
        self._recording = recording
        if recording is not None:
            page, media_type = self._static["index.html"]
            marked = page.replace(b"<body>", f'<body data-recording="{RECORDING}">'.encode())
            self._static["index.html"] = marked, media_type
        self._server: uvicorn.Server | None = None
        self._thread: threading.Thread | None = None
        self._sessions: set[WebSocket] = set()
        self._viewers: set[WebSocket] = set()

    @property
    def where(self) -> str:
        """The page's address in one line for people."""
        return f"viewer: {self.address} (open it in a browser on this machine)"

    def __enter__(self) -> "PageServer":
        self.open()
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def open(self) -> None:
        """Listen, and return once the page answers. Serve the page until `close`, or the end of the process."""
        listening = socket.create_server((LOOPBACK, 0), backlog=BACKLOG)
        listening.setblocking(False)
        self.address = f"http://{LOOPBACK}:{listening.getsockname()[1]}/{self._token}/"
        guard = Guard(self.routes(), self._token)
        config = uvicorn.Config(
            guard,
            loop="asyncio",  # another might read a connection before its guard has noted it
            ws="websockets-sansio",
            ws_max_size=LONGEST_MESSAGE,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            timeout_graceful_shutdown=1,
        )
        logging.getLogger("uvicorn").setLevel(logging.CRITICAL)  # an attacker is not to fill the terminal
        self._server = GuardedServer(config, guard)
        # A daemon: nothing waits for a page.
        self._thread = threading.Thread(
            target=self._server.run, args=([listening],), name="deformscope-page", daemon=True
        )
        self._thread.start()
        _pages.append(self)

    def close(self) -> None:
        """Stop serving."""
        if self._server is not None and self._thread is not None:
            if self._sessions:
                time.sleep(2 * STATE_EVERY_S)  # they get the last state: why it stopped
            self._server.should_exit = True
            self._thread.join(STOP_S)
            self._server = None
            self._viewer_files.close()
        if self in _pages:
            _pages.remove(self)

    def routes(self) -> ASGIApp:
        """Paths below the token."""
        routes = [
            Route("/session", _only_websocket),
            Route("/data", _only_websocket),
            Route("/{name}", self._file),
            Route("/", self._file),
            WebSocketRoute("/session", self._serve_session),
            WebSocketRoute("/data", self._serve_data),
        ]
        app = Starlette(routes=routes)
        app.router.redirect_slashes = False  # no answer repeats a path
        return app

    # Files -----------------------------------------------------------------------------------------------------------

    def offer(self, name: str, content: bytes, media_type: str) -> None:
        """Offer a file that the page may request from now on, in place of one that was offered under this name."""
        self._offered[name] = content, media_type

    async def _file(self, request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name in self._static or name in self._offered:
            content, media_type = self._static.get(name) or self._offered[name]
            return Response(content, media_type=media_type)
        if name == RECORDING and self._recording is not None:
            return FileResponse(self._recording, media_type="application/octet-stream")
        if name not in NAMES:
            return PlainTextResponse("no such file\n", 404)
        try:
            size = await asyncio.to_thread(self._viewer_files.size, name)
        except (OSError, InputError) as error:
            self.session.remark(f"no viewer: {error}", bad=True)
            return PlainTextResponse("no viewer\n", 503)
        headers = {"content-length": str(size), "cache-control": VIEWER_KEPT}
        return StreamingResponse(self._viewer_files.parts(name), media_type=NAMES[name], headers=headers)

    # State and commands ----------------------------------------------------------------------------------------------

    async def _serve_session(self, websocket: WebSocket) -> None:
        if len(self._sessions) >= MOST_PAGES:
            await websocket.close(TOO_MANY)
            return
        async with _served(websocket, self._sessions):
            async with asyncio.timeout(HELLO_S):
                hello = await _received(websocket, _HELLO)
            if hello.version != VERSION:
                await websocket.close(OTHER_VERSION, "load the page again")
                return
            self.session.come(hello.page)
            try:
                await _first_of(self._send_states(websocket), self._dispatch(websocket, hello.page))
            finally:
                self.session.leave(hello.page)

    async def _send_states(self, websocket: WebSocket) -> None:
        with _news(self.session.watch) as changed:
            while True:
                changed.clear()
                await websocket.send_text(_encoded(self.session.state))
                await asyncio.sleep(STATE_EVERY_S)
                await changed.wait()

    async def _dispatch(self, websocket: WebSocket, page: str) -> None:
        while True:
            command = await _received(websocket, _COMMAND)
            if isinstance(command, Beat):
                self.session.beat(page, visible=command.visible)
                continue
            reply = self.session.command(page, command)
            await websocket.send_text(_encoded(reply))

    # Data ------------------------------------------------------------------------------------------------------------

    async def _serve_data(self, websocket: WebSocket) -> None:
        after = websocket.query_params.get("after", "0")
        if len(self._viewers) >= MOST_PAGES or not (after.isascii() and after.isdigit() and len(after) < 16):
            await websocket.close(TOO_MANY)
            return
        reader = self.pieces.join(int(after))
        try:
            async with _served(websocket, self._viewers):
                drawn: asyncio.Queue[int] = asyncio.Queue(1)
                await _first_of(self._send_pieces(websocket, reader, drawn), _take_drawn(websocket, drawn))
        finally:
            self.pieces.part(reader)

    async def _send_pieces(self, websocket: WebSocket, reader: PageReader, drawn: asyncio.Queue[int]) -> None:
        """One batch after the other, each once the page has drawn the one before."""
        with _news(self.pieces.watch) as changed:
            for count in itertools.count(1):
                while not (batch := self.pieces.take(reader)):
                    await changed.wait()
                    changed.clear()
                for piece in batch:
                    await websocket.send_bytes(piece.data)
                mark = PieceBatch(count, reader.last, batch[-1].until_ns, reader.behind_s, reader.skipped)
                await websocket.send_text(_encoded(mark))
                while await drawn.get() != count:
                    pass
                changed.clear()
                with suppress(TimeoutError):
                    async with asyncio.timeout(self.pieces.drawn(reader)):  # what was made while it drew is old by now
                        await changed.wait()


_HELLO: msgspec.json.Decoder[Hello] = msgspec.json.Decoder(Hello)
_COMMAND: msgspec.json.Decoder[PageCommand | Beat] = msgspec.json.Decoder(PageCommand | Beat)
_DRAWN: msgspec.json.Decoder[Drawn] = msgspec.json.Decoder(Drawn)

_pages: list[PageServer] = []
"""Pages that this process serves."""


def running_pages() -> list[PageServer]:
    """The pages that this process serves."""
    return list(_pages)


@atexit.register
def end_pages() -> None:
    """Stop serving all pages."""
    for page in running_pages():
        page.close()


def _encoded(message: msgspec.Struct) -> str:
    try:
        return msgspec.json.encode(message).decode()
    except UnicodeEncodeError:  # a path that is not UTF-8: what is not becomes an escape
        return json.dumps(msgspec.to_builtins(message))


async def _only_websocket(request: Request) -> Response:
    return PlainTextResponse("a websocket alone\n", 426)


async def _received(websocket: WebSocket, decoder: msgspec.json.Decoder[MessageT]) -> MessageT:
    """The next message. Raises DecodeError for any other, WebSocketDisconnect at the end."""
    message = await websocket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1005))
    if message.get("text") is None:
        raise msgspec.DecodeError("a text message is expected")
    return decoder.decode(message["text"])


async def _take_drawn(websocket: WebSocket, drawn: asyncio.Queue[int]) -> None:
    while True:
        await drawn.put((await _received(websocket, _DRAWN)).batch)


@asynccontextmanager
async def _served(websocket: WebSocket, among: set[WebSocket]) -> AsyncIterator[None]:
    """Accepted until it is gone, sends an invalid message, or the server ends."""
    among.add(websocket)
    try:
        await websocket.accept()
        yield
    except (WebSocketDisconnect, TimeoutError):
        pass
    except (msgspec.DecodeError, UnicodeDecodeError):
        with suppress(RuntimeError, WebSocketDisconnect):
            await websocket.close(BAD_MESSAGE)
    finally:
        among.remove(websocket)


@contextmanager
def _news(watch: Callable[[Callable[[], None]], Callable[[], None]]) -> Iterator[asyncio.Event]:
    """An event of this loop that is set by every change, in any thread."""
    loop, changed = asyncio.get_running_loop(), asyncio.Event()

    def call() -> None:
        with suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(changed.set)

    end = watch(call)
    try:
        yield changed
    finally:
        end()


async def _first_of(*works: Coroutine[Any, Any, None]) -> None:
    """Run them side by side until one ends, and raise its error; the others are cancelled."""
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        task.result()
