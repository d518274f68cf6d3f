"""Losses of devices in a recording, by device: as numbers for files, and as text for people."""

import dataclasses
from collections.abc import Mapping, Sequence

from deformscope.frames import HealthReport
from deformscope_drivers.device import JOINING_BYTES, RAW_DROPPED
from deformscope_drivers.health import Health

WORDS = {
    "readings": "readings lost",
    "dropped": "readings dropped here",
    "raw_dropped": "pieces of bytes dropped here",
    "refused": "frames refused",
    "skipped_bytes": "bytes skipped",
    "reconnects": "reconnects",
    "unseen": "frames, none of which has a valid value",
}
"""Each count that is a loss, and its name in messages, the most important first."""

COUNTS = ("received", "lost", "dropped", "skipped_bytes", "resyncs", "reconnects", "lost_by_time", "silent_s")
"""Counts of `Health` from a device's opening on."""


def lost_by(health: Health) -> dict[str, float]:
    """A device's losses above 0; empty = none.

    readings: readings that should have come; readings_by_time: those of them that only the time shows; silent_s: the
    time without readings [s]; dropped, raw_dropped: readings and pieces of bytes that arrived and were not read in time
    """
    found: dict[str, float] = {
        "readings": health.lost,
        "readings_by_time": health.lost_by_time,
        "silent_s": round(health.silent_s, 3),
        "dropped": health.dropped,
        "raw_dropped": int(health.extra.get(RAW_DROPPED, 0)),
        "refused": sum(health.refused.values()),
        "skipped_bytes": health.skipped_bytes - int(health.extra.get(JOINING_BYTES, 0)),
        "reconnects": health.reconnects,
    }
    return {name: value for name, value in found.items() if value}


def since(report: HealthReport, before: HealthReport) -> HealthReport:
    """Health of the devices with counts relative to an earlier health: losses of a recording that began then."""
    earlier = dict(before.devices)
    return HealthReport(report.host_ns, tuple((name, _since(now, earlier[name])) for name, now in report.devices))


def _since(now: Health, before: Health) -> Health:
    refused = {reason: count - before.refused.get(reason, 0) for reason, count in now.refused.items()}
    extra = {
        name: now.extra[name] - before.extra.get(name, 0) for name in (RAW_DROPPED, JOINING_BYTES) if name in now.extra
    }
    return dataclasses.replace(
        now,
        **{name: getattr(now, name) - getattr(before, name) for name in COUNTS},
        refused={reason: count for reason, count in refused.items() if count},
        extra={**now.extra, **extra},
    )


def losses_of(report: HealthReport) -> dict[str, dict[str, float]]:
    """Losses of the devices with any, by name. report: their last health"""
    found = {name: lost_by(health) for name, health in report.devices}
    return {name: lost for name, lost in found.items() if lost}


def to_text(lost: Mapping[str, float]) -> str:
    """One device's losses in a line; empty where there are none."""
    parts = []
    silent_s, by_time = lost.get("silent_s", 0.0), int(lost.get("readings_by_time", 0))
    for name, words in WORDS.items():
        count = int(lost.get(name, 0))
        if name == "readings" and (count or silent_s):
            silence = f"{silent_s:.3g} s without any" if silent_s else ""
            share = "" if not by_time else f"about {by_time} of them by time" if by_time != count else "by time"
            more = ", ".join(part for part in (share, silence) if part)
            parts.append(f"{count or 'an unknown number of'} {words}" + (f" ({more})" if more else ""))
        elif count:
            parts.append(f"{count} {words}")
    return ", ".join(parts)


def named(losses: Mapping[str, Mapping[str, float]]) -> str:
    """All devices' losses in one line."""
    return "; ".join(f"{device}: {to_text(lost)}" for device, lost in losses.items())


def without_frames(devices: Sequence[str]) -> dict[str, str]:
    """The loss of each device that a recording names and of which no frame was read."""
    return dict.fromkeys(devices, "all frames: the recording names it, and holds none")
