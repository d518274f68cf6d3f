"""Health of a rig's devices, on its page and at the terminal: rates, losses, drift, alarms."""

from collections.abc import Callable, Sequence

from deformscope.frames import HealthReport, LinkChange, SessionNote, Stream, WrenchFrame
from deformscope.page.server.messages import DeviceState, DriftState
from deformscope.page.server.page_session import PageSession
from deformscope.rig.alarms import TareDrift
from deformscope.session import SessionRecorder, Step
from deformscope.stages.map.exploration import PhaseStart
from deformscope.terminal import say
from deformscope_drivers.health import Health

SHOW_EVERY_S = 0.3
"""Shortest time between one state text of a robot and the next."""
UNTOUCHED = ("look", "plan", "travel", "tare", "done")
"""Phases of an exploration in which nothing touches the force sensor: its force is then drift, no load."""


class ShownDevices:
    """Shows on a page the health of devices, computed from all their items, and the robot's use of them.

    touching: whether something may touch a force sensor, whose drift is then unknown"""

    def __init__(self, session: PageSession, streams: Sequence[Stream]) -> None:
        self.touching = False
        self._session = session
        self._streams = {stream.device: stream for stream in streams}
        self._drifts: dict[str, TareDrift] = {}
        self._shown_s = -1e9

    def __call__(self, doing: str) -> None:
        """doing: the robot's state, as text; shown seldom enough for a control period"""
        now_s = self._session.state.now_s
        if now_s - self._shown_s >= SHOW_EVERY_S:
            self._shown_s = now_s
            self._session.show(reason=doing)

    def on_items(self, items: Sequence[object]) -> None:
        """Receives all items, in order."""
        for item in items:
            if isinstance(item, HealthReport):
                self._session.show(devices=tuple(self._state(name, health) for name, health in item.devices))
            elif isinstance(item, WrenchFrame) and not self.touching:
                self._drifts.setdefault(item.device, TareDrift()).add((item,))
            elif (remark := remark_of(item)) is not None:
                words, bad = remark
                self._session.remark(words, bad=bad)

    def tared(self, device: str) -> None:
        """Restart the drift of a tared device."""
        self._drifts.pop(device, None)

    def _state(self, name: str, health: Health) -> DeviceState:
        from deformscope.log.rig.health import word  # it brings rerun

        stream, drift, drifted = self._streams.get(name), self._drifts.get(name), None
        if drift is not None and drift.line:
            drifted = DriftState(drift.lasted_s, drift.unit, tuple(map(float, drift.now)), drift.line, drift.loaded)
        elif stream is not None and stream.kind == "wrench":
            drifted = DriftState(0.0, "", (), ())  # its place is there from the beginning
        return DeviceState(
            name=name,
            state=word(health, stream),
            simulated=stream is not None and stream.simulated,
            rate_hz=health.rate_hz,
            age_s=health.age_s,
            jitter_s=health.jitter_s,
            received=health.received,
            lost=health.lost,
            dropped=health.dropped,
            refused=sum(health.refused.values()),
            bad_bytes=health.skipped_bytes,
            reconnects=health.reconnects,
            reason="; ".join(part for part in (health.reason, *health.alarms) if part),
            drift=drifted,
        )


class WatchedDevices:
    """A recorder, while a robot acts, that also reports at the terminal when an alarm of a sensor begins and ends, and
    shows new data on a page, if there is one. line: shows the robot's state, and nothing for an empty text"""

    def __init__(self, recorder: SessionRecorder, shown: ShownDevices | None, line: Callable[[str], None]) -> None:
        self._recorder, self._shown, self._line = recorder, shown, line
        self._phase = ""

    def write(self, items: object) -> None:
        """See `Recorder.write`."""
        self._recorder.write(items)
        if isinstance(items, Step):
            for result in items.results:
                if isinstance(result, PhaseStart):
                    self._phase = result.name
                    if self._shown is not None:  # what comes next may have come before the phase began
                        self._shown.touching |= self._phase not in UNTOUCHED
        elif isinstance(items, Sequence):
            for item in items:
                if isinstance(item, SessionNote) and (remark := remark_of(item)) is not None:
                    self._line("")
                    say(remark[0])
            if self._shown is not None:
                self._shown.on_items(items)
                self._shown.touching = self._phase not in ("", *UNTOUCHED)


def remark_of(item: object) -> tuple[str, bool] | None:
    """The immediate remark for people, and whether it is bad: links that change, alarms of sensors, stages without
    results."""
    if isinstance(item, LinkChange):
        reason = f": {item.event.reason}" if item.event.reason else ""
        return f"{item.device}: {item.event.link}{reason}", item.event.link in ("lost", "failed")
    if isinstance(item, SessionNote) and item.about in ("stage", "stage-over"):
        return f"stage {item.text}", item.about == "stage"
    if isinstance(item, SessionNote) and item.about in ("alarm", "alarm-over"):
        began = item.about == "alarm"
        return item.text if began else f"over: {item.text}", began
    return None
