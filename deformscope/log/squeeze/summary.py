"""What is known of a squeeze, in words and numbers."""

from __future__ import annotations

import rerun as rr

from deformscope.log.exploration.moment import ResultBatch
from deformscope.stages.squeeze.events import SqueezeEvents

SQUEEZE_SUMMARY = "display/squeeze/summary"
EVENTS = "display/squeeze/events"


def log_no_squeeze(now: ResultBatch) -> None:
    text = "# Not squeezed yet"
    now.show(SQUEEZE_SUMMARY, rr.TextDocument(text, media_type="text/markdown"))


def log_events_summary(now: ResultBatch, events: SqueezeEvents) -> None:
    """The events with their intervals."""
    took_s = (events.steady_ns - events.first_ns) / 1e9
    wide = [(high - low) / 1e6 for low, high in (events.first_interval_ns, events.steady_interval_ns)]
    text = f"steady {took_s:.2f} s after first contact (known to {wide[0]:.0f} ms and {wide[1]:.0f} ms)"
    now.show(EVENTS, rr.TextLog(text, level="INFO"))
