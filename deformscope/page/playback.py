"""Pages that play recordings: one, whose chapters are its touches, its episodes, or its phases; or any of a catalog."""

import asyncio
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import msgspec
from starlette.responses import HTMLResponse, PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from deformscope.errors import InputError
from deformscope.frames import HealthReport, SessionNote
from deformscope.page.server.messages import Chapter, Playback
from deformscope.page.server.page_server import PageServer
from deformscope.recording.items import read_streams
from deformscope.recording.reader import Replay, Row, read_rows
from deformscope.stages.map.exploration import PhaseStart
from deformscope.stages.squeeze.trial import SqueezePhase

LAYER = "layer.rrd"
STEP_NS = 100_000_000
"""Step: about a picture of a camera at 10 Hz."""


def play_on_page(path: Path) -> PageServer:
    """Serve a recording on a page that plays it; its address is printed. Play a recording on a page until `close`, or
    the end of the process."""
    page = PageServer(path.name, path)
    page.session.show(playback=playback_of(path))
    page.open()
    print(page.where, file=sys.stderr, flush=True)
    return page


def show_comparison(
    page: PageServer,
    recording: Replay,
    recorded: Sequence[Row],
    again: Sequence[object],
    size_m: tuple[float, float],
    name: str,
) -> None:
    """Show other settings' results for a recorded exploration as a layer over it. recorded: its results; again: results
    with other settings; size_m: size of the surface; name: name of the settings"""
    from deformscope.log.exploration.results import comparison_rrd

    streams = read_streams(recording.path, trust=True)
    results = [(row.session_ns, row.item) for row in recorded]
    layer = comparison_rrd(recording.identity, streams, size_m, results, again, name)
    page.offer(LAYER, layer, "application/octet-stream")
    playback = page.session.state.playback
    assert playback is not None
    page.session.show(playback=msgspec.structs.replace(playback, layer=LAYER))


def playback_of(path: Path) -> Playback:
    """Duration of a recording of devices, and its chapters."""
    rows = list(read_rows(Replay(path, trust=True), (HealthReport, SessionNote, PhaseStart, SqueezePhase)))
    until_ns = max((row.session_ns for row in rows), default=0)
    return Playback("session", until_ns, STEP_NS, tuple(chapters_of(rows, until_ns)))


def chapters_of(rows: list[Row], until_ns: int) -> list[Chapter]:
    """Chapters of the recording, in order of time. rows: notes and phases"""
    found = []
    touches = [row for row in rows if isinstance(row.item, PhaseStart)]
    begun = [row for row in touches if row.item.name in ("look", "travel") or row.item.name.startswith("stopped")]
    for phases in (begun, [row for row in rows if isinstance(row.item, SqueezePhase)]):
        for row, following in pairwise([*phases, None]):
            assert row is not None
            name = f"touch {row.touch}" if row.item.name == "travel" and phases is begun else str(row.item.name)
            end_ns = until_ns if following is None else following.session_ns
            found.append(Chapter(name, row.session_ns, end_ns))
    notes = [row for row in rows if isinstance(row.item, SessionNote)]
    for place, row in enumerate(notes):
        if row.item.about == "episode-begin":
            ends = (one.session_ns for one in notes[place:] if one.item.about == "episode-end")
            later = [one.item.about for one in notes[place + 1 :]]
            mine = later[: later.index("episode-begin")] if "episode-begin" in later else later
            name = f"{row.item.text} (discarded)" if "discard-episode" in mine else row.item.text
            found.append(Chapter(name, row.session_ns, next(ends, until_ns)))
        elif row.item.about == "note":
            found.append(Chapter(f"note: {row.item.text}", row.session_ns, until_ns))
    return sorted(found, key=lambda chapter: chapter.from_ns)


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
