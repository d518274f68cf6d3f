"""Readings missing by time: what a link, a buffer and a rate can do, on times made up here."""

import random

import pytest

from deformscope_drivers.health import Continuity, Missing

S = 1_000_000_000


class Sent:
    """Readings that arrive at a rate. clock_s: as far as it went"""

    def __init__(self, rate_hz: float | None = 0.0) -> None:
        self.at = Continuity()
        self.clock_s = 100.0
        self.at.expect(self.now_ns, rate_hz)
        self.at.begin(self.now_ns)

    @property
    def now_ns(self) -> int:
        return round(self.clock_s * S)

    def come(self, rate_hz: float, seconds: float, jitter_s: float = 0.0, seed: int = 0) -> None:
        rng = random.Random(seed)
        began_s = self.clock_s
        for index in range(1, round(rate_hz * seconds) + 1):
            arrival_s = began_s + index / rate_hz + rng.random() * jitter_s
            self.clock_s = max(self.clock_s, arrival_s)
            self.at.add(self.now_ns)
        self.clock_s = max(self.clock_s, began_s + seconds)

    def burst(self, count: int) -> None:
        for _ in range(count):
            self.at.add(self.now_ns)

    def wait(self, seconds: float) -> None:
        self.clock_s += seconds

    def missing(self) -> Missing:
        return self.at.at(self.now_ns)


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 30.0, 1000.0])
@pytest.mark.parametrize("set_to", [0.0, 0.5, 1.0, 2.0])
def test_a_device_that_sends_misses_nothing_even_where_it_is_slower_or_faster_than_set(
    rate_hz: float, set_to: float
) -> None:
    sent = Sent(set_to * rate_hz)
    sent.come(rate_hz, max(20.0, 20.0 / rate_hz), jitter_s=min(0.3, 0.5 / rate_hz))
    assert sent.missing() == Missing()


def test_a_link_lost_for_good_costs_the_time_until_the_end() -> None:
    sent = Sent(1000.0)
    sent.come(1000.0, 3.0)
    sent.at.lose_link(sent.now_ns)
    sent.wait(7.0)
    sent.at.end(sent.now_ns)
    sent.wait(60.0)  # a look long after the end
    missing = sent.missing()
    assert missing.silent_s == pytest.approx(7.0, abs=0.01)
    assert missing.count == pytest.approx(7000, abs=10)


def test_a_link_lost_for_a_moment_costs_that_moment() -> None:
    sent = Sent()
    sent.come(1000.0, 3.0)
    for _ in range(3):
        sent.wait(0.05)
        sent.at.lose_link(sent.now_ns)
        sent.wait(0.15)
        sent.at.begin(sent.now_ns)
        sent.come(1000.0, 2.0)
    assert sent.missing().count == pytest.approx(600, abs=10)
    assert sent.missing().silent_s == pytest.approx(0.6, abs=0.01)


def test_silence_on_a_link_that_holds_is_counted_while_it_lasts_and_after() -> None:
    sent = Sent()
    sent.come(30.0, 5.0)
    sent.wait(4.0)
    during = sent.missing()
    sent.come(30.0, 5.0)
    assert during.count == pytest.approx(120, abs=2)
    assert sent.missing().count == pytest.approx(120, abs=2)
    assert sent.missing().silent_s == pytest.approx(4.0, abs=0.1)


def test_what_waited_in_a_buffer_while_this_program_stood_still_is_not_missing() -> None:
    sent = Sent(1000.0)
    sent.come(1000.0, 3.0)
    sent.wait(2.0)
    sent.burst(2000)
    sent.come(1000.0, 3.0)
    assert sent.missing() == Missing()


def test_a_buffer_that_ran_over_costs_the_rest_also_where_the_counter_wrapped() -> None:
    sent = Sent(1000.0)
    sent.come(1000.0, 3.0)
    sent.wait(70.0)
    sent.burst(256)  # as much as the buffer holds
    sent.at.count_lost(3155)  # what a counter of 16 bits says
    sent.come(1000.0, 3.0)
    assert sent.missing().count == pytest.approx(70_000 - 256 - 3155, abs=70)


def test_what_the_counter_counted_is_not_counted_again() -> None:
    sent = Sent()
    sent.come(100.0, 5.0)
    sent.wait(3.0)
    sent.at.count_lost(300)
    sent.come(100.0, 5.0)
    assert sent.missing() == Missing()


def test_a_device_that_never_sends_is_silent_from_the_start() -> None:
    sent = Sent(30.0)
    sent.wait(10.0)
    assert sent.missing() == Missing(10.0, 300)
    unknown = Sent()
    unknown.wait(10.0)
    assert unknown.missing() == Missing(10.0, 0)


def test_a_device_may_take_a_moment_to_start() -> None:
    sent = Sent(30.0)
    sent.wait(2.0)
    sent.come(30.0, 5.0)
    assert sent.missing() == Missing()


def test_a_device_that_gives_when_asked_misses_nothing() -> None:
    sent = Sent(None)
    for _ in range(5):
        sent.wait(10.0)
        sent.burst(1)
    assert sent.missing() == Missing()


def test_a_device_that_was_stopped_on_purpose_misses_nothing() -> None:
    sent = Sent(1000.0)
    sent.come(1000.0, 2.0)
    sent.at.expect(sent.now_ns, None)
    sent.wait(20.0)
    assert sent.missing() == Missing()
    sent.at.expect(sent.now_ns, 100.0)
    sent.come(100.0, 5.0)
    assert sent.missing() == Missing()


def test_a_camera_that_exposes_longer_in_the_dark_misses_nothing() -> None:
    sent = Sent(30.0)
    for rate_hz in (30.0, 15.0, 7.5, 30.0, 15.0):
        sent.come(rate_hz, 4.0)
    assert sent.missing() == Missing()
