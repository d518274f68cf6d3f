"""While a robot acts, its page shows of devices what `live` shows: links, alarms, jitter, and drift while untouched."""

import numpy as np
import pytest

from deformscope.frames import HealthReport, LinkChange, SessionNote, Stream, WrenchFrame
from deformscope.page.devices import ShownDevices, WatchedDevices
from deformscope.page.server.messages import DriftState
from deformscope.page.server.page_session import PageSession
from deformscope.session import Moment, Step
from deformscope.stages.map.exploration import PhaseStart
from deformscope_drivers.clock import Stamp
from deformscope_drivers.health import Health, Link, LinkEvent

ALARM = "tip: saturated: fz at the end of its range"


class Kept:
    """A recorder that keeps what it is given."""

    def __init__(self) -> None:
        self.written: list[object] = []

    def write(self, items: object) -> None:
        self.written.append(items)


class Watched:
    """A force sensor that gives 10 readings a second, between a robot's phases."""

    def __init__(self) -> None:
        self.session, self.kept = PageSession(), Kept()
        shown = ShownDevices(self.session, [Stream("tip", "wrench", "optoforce")])
        self.recorder = WatchedDevices(self.kept, shown, print)
        self.index = 0

    def begin(self, phase: str) -> None:
        self.recorder.write(Step((PhaseStart(phase, 0),), moment=Moment(0)))

    def feel(self, force_n: float, seconds: int) -> None:
        """In batches of a second."""
        for _ in range(seconds):
            at_ns = [100_000_000 * (self.index + step) for step in range(10)]
            force = np.array([[0.0, 0.0, force_n]])
            counts = np.zeros(3, np.int64)
            self.recorder.write([WrenchFrame(Stamp(ns), ns, counts, force, device="tip") for ns in at_ns])
            self.index += 10

    def drift(self) -> DriftState | None:
        self.recorder.write([HealthReport(0, (("tip", Health(Link.CONNECTED, age_s=0.01, jitter_s=0.002)),))])
        (shown,) = self.session.state.devices
        assert shown.jitter_s == 0.002
        return shown.drift


def test_drift_is_what_the_sensor_feels_while_nothing_touches_it() -> None:
    watched = Watched()
    watched.begin("look")
    watched.feel(0.0, 3)
    watched.begin("press")
    watched.feel(3.0, 5)
    watched.begin("retreat")
    watched.feel(1.0, 2)
    watched.begin("travel")
    watched.feel(1.0, 1)  # may have been felt before the way began
    watched.feel(0.02, 4)
    drift = watched.drift()
    assert drift.now == pytest.approx((0.0, 0.0, 0.02))
    assert max(drift.line) == pytest.approx(0.02)


def test_alarms_and_links_are_said_on_the_page_and_alarms_at_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    watched = Watched()
    items = [
        SessionNote(1, "alarm", ALARM),
        LinkChange(LinkEvent(2, Link.LOST, "unplugged"), "tip"),
        SessionNote(3, "alarm-over", ALARM),
        SessionNote(4, "note", "of a person"),
    ]
    watched.recorder.write(items)
    said = [(remark.words, remark.bad) for remark in watched.session.state.remarks]
    assert said == [(ALARM, True), ("tip: lost: unplugged", True), (f"over: {ALARM}", False)]
    assert capsys.readouterr().err.splitlines() == [ALARM, f"over: {ALARM}"]
    assert watched.kept.written == [items]
    alone = WatchedDevices(Kept(), None, print)  # without a page
    alone.write(items)
    assert capsys.readouterr().err.splitlines() == [ALARM, f"over: {ALARM}"]


def test_a_stage_that_gives_nothing_is_remarked_and_that_it_goes_on() -> None:
    watched = Watched()
    watched.recorder.write([SessionNote(1, "stage", "beta gives nothing: too dark")])
    watched.recorder.write([SessionNote(2, "stage-over", "beta gives results")])
    said = [(remark.words, remark.bad) for remark in watched.session.state.remarks]
    assert said == [("stage beta gives nothing: too dark", True), ("stage beta gives results", False)]
