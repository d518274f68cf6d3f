"""A recording on a page that plays it: chapters are its touches, its episodes, or its phases."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import msgspec

from deformscope.frames import HealthReport, SessionNote
from deformscope.page.server.messages import Chapter, Playback
from deformscope.page.server.page_server import PageServer
from deformscope.recording.item_rows import Row, read_rows
from deformscope.recording.items import read_streams
from deformscope.recording.reader import Replay
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
    from deformscope.log.exploration.compare import comparison_rrd

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
    for row, following in pairwise([*begun, None]):
        assert row is not None
        end_ns = until_ns if following is None else following.session_ns
        found.append(Chapter(_format_touch(row), row.session_ns, end_ns))
    squeezed = [row for row in rows if isinstance(row.item, SqueezePhase)]
    for row, following in pairwise([*squeezed, None]):
        assert row is not None
        end_ns = until_ns if following is None else following.session_ns
        found.append(Chapter(row.item.name, row.session_ns, end_ns))
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


def _format_touch(row: Row) -> str:
    name = str(row.item.name)
    return f"touch {row.touch}" if name == "travel" else name
