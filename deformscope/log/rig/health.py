"""Health of the devices: a table as text, coloured lanes over time, and every counter as a number; the bytes on the
wire, the times of the connection, and remarks of people."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from deformscope.frames import HealthReport, LinkChange, SessionNote, Stream
from deformscope.log.rig.columns import Batch, Shown, moments, recorded, root, scalars
from deformscope.log.rig.numbers import plotted
from deformscope.pictures.palette import BAD, GOOD, IDLE, WARN
from deformscope_drivers.health import Health, Link

STALE_S = 1.0
"""A reading older than this, or than STALE_READINGS at the stream's own rate, whichever is longer, is stale."""
STALE_READINGS = 5.0

COLORS = {
    "ok": GOOD,
    "waiting": IDLE,
    "closed": IDLE,
    "stale": WARN,
    "stuck": WARN,
    "saturated": WARN,
    "LOST": BAD,
    "FAILED": BAD,
}
HEAD = ("device", "state", "Hz", "jitter ms", "received", "lost", "dropped", "refused", "bad bytes", "relinked", "why")


def word(health: Health, stream: Stream | None) -> str:
    """The state of a device in one word."""
    if health.link != Link.CONNECTED:
        return {Link.LOST: "LOST", Link.FAILED: "FAILED", Link.CLOSED: "closed"}[health.link]
    if health.age_s is None:
        return "waiting"
    fastest_hz = stream.fastest_hz if stream is not None else 0.0
    if health.age_s > max(STALE_S, STALE_READINGS / fastest_hz if fastest_hz > 0 else 0.0):
        return "stale"
    alarms = ["stuck"] * health.stuck + [alarm.replace(":", " ").split()[0] for alarm in health.alarms]
    return "stuck" if "stuck" in alarms else alarms[0] if alarms else "ok"


def log_health(
    batch: Batch, reports: Sequence[HealthReport], start_ns: int, streams: Sequence[Stream], shown: Shown | None = None
) -> None:
    """shown: the states that a viewer has already: a device's counters are sent only when its state changes"""
    known = {stream.device: stream for stream in streams}
    looks: dict[str, list[tuple[int, Health]]] = {}
    for report in reports:
        for device, health in report.devices:
            state = word(health, known.get(device))
            if shown is None or shown.get(f"health of {device}", ("", 0))[0] != state:
                looks.setdefault(device, []).append((report.host_ns, health))
            if shown is not None:
                shown[f"health of {device}"] = state, report.host_ns
    for device, seen in looks.items():
        _log_device(batch, device, seen, start_ns, known.get(device))
    when = [report.host_ns for report in reports]
    columns = [
        *rr.TextDocument.columns(
            text=[table(report, known) for report in reports], media_type=["text/markdown"] * len(reports)
        ),
        *recorded(reports),
    ]
    batch.send_columns("health", moments(when, start_ns), columns)


def table(report: HealthReport, streams: dict[str, Stream]) -> str:
    """The devices as a Markdown table, trouble in bold."""
    lines = [f"| {' | '.join(HEAD)} |", f"|{' --- |' * len(HEAD)}"]
    for device, health in report.devices:
        stream = streams.get(device)
        state = word(health, stream)
        name = f"{device} (SIMULATED)" if stream is not None and stream.simulated else device
        refused = sum(health.refused.values())
        reasons = ", ".join(f"{reason} {count}" for reason, count in health.refused.items())
        numbers = (health.received, health.lost, health.dropped)
        cells = [
            *(name, state if state in ("ok", "waiting", "closed") else f"**{state}**", f"{health.rate_hz:.4g}"),
            f"{1e3 * health.jitter_s:.2g}",
            *(f"{number:,}".replace(",", " ") for number in numbers),
            f"{refused} ({reasons})" if refused else "0",
            *(
                str(health.skipped_bytes),
                str(health.reconnects),
                "; ".join(filter(None, (health.reason, *health.alarms))),
            ),
        ]
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return "\n".join(lines)


def _log_device(
    batch: Batch, device: str, looks: Sequence[tuple[int, Health]], start_ns: int, stream: Stream | None
) -> None:
    health = [one for _, one in looks]
    columns = [*rr.StateChange.columns(state=[word(one, stream) for one in health]), *recorded(health)]
    batch.send_columns(root("health", device), moments([at for at, _ in looks], start_ns), columns)


LINK_COLORS = {Link.CONNECTED: GOOD, Link.LOST: WARN, Link.FAILED: BAD, Link.CLOSED: IDLE}
LEVELS = {Link.CONNECTED: "INFO", Link.LOST: "WARN", Link.FAILED: "ERROR", Link.CLOSED: "INFO"}


def log_link(
    batch: Batch, device: str, changes: Sequence[LinkChange], start_ns: int, streams: Sequence[Stream]
) -> None:
    events = [change.event for change in changes]
    words = [f"{event.link}: {event.reason}" if event.reason else str(event.link) for event in events]
    columns = [
        *rr.TextLog.columns(text=words, level=[LEVELS[event.link] for event in events]),
        *rr.StateChange.columns(state=[str(event.link) for event in events]),
        *recorded(changes),
    ]
    batch.send_columns(root("link", device), moments([event.host_ns for event in events], start_ns), columns)
    ends = [event.host_ns for event in events if event.link != Link.CONNECTED]
    for path, _ in [plot for stream in streams if stream.device == device for plot in plotted(stream)]:
        if ends:  # a line goes no further: nobody knows what was between
            batch.send_columns(path, moments(ends, start_ns), scalars([np.zeros(0)] * len(ends)))


def log_notes(batch: Batch, notes: Sequence[SessionNote], start_ns: int) -> None:
    words = [note.text if note.about == "note" else f"{note.about}: {note.text}" for note in notes]
    columns = [
        *rr.TextLog.columns(
            text=words, level=["WARN" if note.about in ("alarm", "stage") else "INFO" for note in notes]
        ),
        *recorded(notes),
    ]
    batch.send_columns("note", moments([note.host_ns for note in notes], start_ns), columns)
