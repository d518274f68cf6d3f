"""A page of recordings that plays one when it is clicked, at the same address."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path

from starlette.responses import HTMLResponse, PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from deformscope.errors import InputError
from deformscope.page.playback import playback_of
from deformscope.page.server.page_server import PageServer

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"
"""Policy of the page, which contains its pictures and has no script."""
MOST_OPEN = 8
"""Largest number of recordings that are open for playback; a further one replaces the oldest."""


class CatalogServer(PageServer):
    """Serves one page of HTML; below it, at NUMBER/, the page that plays the recording at that place of a list."""

    def __init__(self, title: str, html: str, recordings: Sequence[Path]) -> None:
        super().__init__(title)
        self._html, self._recordings = html, {str(number): path for number, path in enumerate(recordings)}
        self._played: dict[str, ASGIApp] = {}

    def routes(self) -> ASGIApp:
        return self._route

    async def _route(self, scope: Scope, receive: Receive, send: Send) -> None:
        number, slash, rest = scope["path"].removeprefix("/").partition("/")
        if slash and number in self._recordings:
            app = await self._play(number)
            await app({**scope, "path": f"/{rest}", "raw_path": f"/{rest}".encode()}, receive, send)
        elif scope["type"] == "http" and scope["path"] == "/":
            await HTMLResponse(self._html, headers={"content-security-policy": POLICY})(scope, receive, send)
        elif scope["type"] == "http":
            await PlainTextResponse("no such page\n", 404)(scope, receive, send)

    async def _play(self, number: str) -> ASGIApp:
        if number not in self._played:
            path = self._recordings[number]
            page = PageServer(path.name, path)
            try:
                page.session.show(playback=await asyncio.to_thread(playback_of, path))
            except InputError as error:
                return PlainTextResponse(f"{error}\n", 422)
            while len(self._played) >= MOST_OPEN:
                del self._played[next(iter(self._played))]
            self._played[number] = page.routes()
        return self._played[number]


def serve_catalog(title: str, html: str, recordings: Sequence[Path]) -> CatalogServer:
    """Serve the catalog and print its address, until `close`, or the end of the process."""
    page = CatalogServer(title, html, recordings)
    page.open()
    print(page.where, file=sys.stderr, flush=True)
    return page
