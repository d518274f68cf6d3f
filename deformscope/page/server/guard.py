"""Which requests this server accepts: those of a page that it served, in a browser that reached it by a loopback name.

Other programs of this machine and other sites in its browsers lack the token of the address. A site whose own name
resolves to 127.0.0.1 (DNS rebinding) sends that name as Host; a page of another origin sends that as Origin.
"""

from __future__ import annotations

import asyncio
import hmac
from typing import Any
from urllib.parse import urlsplit

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
MOST_STRANGERS = 64
REQUEST_S = 1.0
"""Time limit for a connection's valid request."""
READ_ROUNDS = 4
"""Rounds of the event loop after which a new connection has been read, and may be closed in favour of later ones."""


class Guard:
    """Passes on valid requests, with a path below the token; answers all others with 403, and a wrong method with 405.

    Connections without a valid request are strangers: closed after `REQUEST_S`, and the oldest earlier if there are
    more than `MOST_STRANGERS`. Therefore strangers cannot use up the connections for pages.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._token = token.encode()
        self._strangers: dict[tuple[str, int] | None, asyncio.Transport] = {}

    def add_stranger(self, client: tuple[str, int] | None, transport: asyncio.Transport) -> None:
        """Note a new connection. client: its other end"""
        self._strangers[client] = transport
        asyncio.get_running_loop().call_later(REQUEST_S, self._end, client, transport)
        self._end_oldest(READ_ROUNDS)

    def _end_oldest(self, rounds: int) -> None:
        if rounds > 0:
            asyncio.get_running_loop().call_soon(self._end_oldest, rounds - 1)
        elif len(self._strangers) > MOST_STRANGERS:
            self._end(*next(iter(self._strangers.items())))

    def _end(self, client: tuple[str, int] | None, transport: asyncio.Transport) -> None:
        if self._strangers.get(client) is transport:
            del self._strangers[client]
            transport.abort()

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
            self._strangers.pop(scope["client"], None)
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


class GuardedProtocol(H11Protocol):
    """HTTP connections that a guard tracks from their beginning."""

    def __init__(self, guard: Guard, **options: Any) -> None:
        super().__init__(**options)
        self._guard = guard

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._guard.add_stranger(self.client, transport)
