"""Which requests this server accepts: those of a page that it served, in a browser that reached it by a loopback name.

Other programs of this machine and other sites in its browsers lack the token of the address. A site whose own name
resolves to 127.0.0.1 (DNS rebinding) sends that name as Host; a page of another origin sends that as Origin."""

import asyncio
import hmac
import socket
from collections.abc import Callable
from functools import partial
from urllib.parse import urlsplit

import uvicorn
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose
from uvicorn.protocols.http.h11_impl import H11Protocol

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
