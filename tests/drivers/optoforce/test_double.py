"""The simulated DAQ: its bytes, its pace, its filter, and its zero point as drivers of the real one found it."""

import math

import numpy as np
import pytest

from deformscope_drivers.optoforce import OMD_20_SE_40N, Kind, OptoforceDouble, Sensitivity, Sensors, Status
from deformscope_drivers.optoforce.protocol import (
    ConfigReply,
    Configure,
    Decoder,
    Filter,
    Reading,
    SerialReply,
    Skipped,
    Speed,
    Zero,
    encode,
)

MS = 1_000_000
SECOND = 1000 * MS
QUIET = Sensors(noise_counts=0.0, offset_counts=0.0)


def load(force_n: float, kind: Kind = Kind.THREE_AXIS):
    return lambda time_s: np.full((kind.channels, kind.axes), force_n)


def heard(double: OptoforceDouble, until_ns: int) -> list:
    return list(Decoder().feed(double.due(until_ns)))


def configured(double: OptoforceDouble, now_ns: int, speed: int, filter_: int = 0, zero: int = 0) -> None:
    double.receive(encode(Configure(speed, filter_, zero)), now_ns)


def readings(events: list) -> list[Reading]:
    return [event for event in events if isinstance(event, Reading)]


def test_it_starts_at_its_defaults() -> None:
    double = OptoforceDouble()
    double.power_up(5 * SECOND)
    assert (double.settings.speed, double.settings.filter, double.zeroed) == (Speed.HZ_100, Filter.HZ_15, False)
    assert [reading.counter for reading in readings(heard(double, 6 * SECOND))] == list(range(100))


def test_its_noise_is_that_of_one_draw_for_each_sample() -> None:
    sent = np.array([one.counts[0] for one in readings(heard_at(OptoforceDouble(Sensors(seed=7)), speed=1))])
    noise = np.random.default_rng(7)
    drawn = [120.0 + 5.0 * noise.standard_normal(3) for _ in range(len(sent) + 10)]
    first = next(at for at in range(10) if np.array_equal(sent[0], np.rint(drawn[at])))
    np.testing.assert_array_equal(sent, np.rint(drawn[first : first + len(sent)]))


def heard_at(double: OptoforceDouble, speed: int) -> list:
    """A second of messages without a filter."""
    double.power_up(0)
    configured(double, 0, speed)
    return heard(double, SECOND)


@pytest.mark.parametrize(("speed", "rate"), [(1, 1000), (3, 333), (10, 100), (33, 30), (100, 10), (0, 0)])
def test_it_sends_at_its_speed(speed: int, rate: int) -> None:
    double = OptoforceDouble()
    configured(double, 0, speed)
    assert len(readings(heard(double, SECOND))) == rate
    assert (double.next_ns(SECOND) is None) == (speed == 0)


def test_bytes_of_a_known_load() -> None:
    sensors = Sensors(scene=lambda _: (401 / 16037 * 40, -401 / 16037 * 40, 20.0), noise_counts=0.0, offset_counts=0.0)
    double = OptoforceDouble(sensors)
    double.receive(bytes.fromhex("aa 00 32 03 01 00 00 00 e0"), 0)
    assert double.due(0) == bytes.fromhex("aa 00 50 01 00 00 fb")
    assert double.due(MS) == bytes.fromhex("aa 07 08 0a 00 00 00 00 01 91 fe 6f 1f 52 03 33")  # 8018.5 counts, to even
    double.receive(bytes.fromhex("ab 00 12 08 00 c5"), MS)
    assert double.due(MS) == bytes.fromhex("aa 00 12 08 49 53 45 30 41 31 32 39 02 b2")


def test_its_pace_has_no_drift_and_its_clock_has_what_it_is_given() -> None:
    for ppm, count in [(0, 3_600_000), (100, 3_600_360), (-100, 3_599_640)]:
        double = OptoforceDouble(Sensors(clock_ppm=ppm))
        configured(double, 0, 100)
        double.due(0)
        double._next_sent = 3_599_000  # an hour is passed over
        times = []
        while (next_ns := double.next_ns(0)) is not None and next_ns <= 3601 * SECOND:
            times.append(next_ns)
            double.due(next_ns)
        assert times[0] == round(3_599_000 * MS * 3_600_000 / count)
        assert np.diff(times) == pytest.approx(100 * MS * 3_600_000 / count, abs=1)


def test_the_counter_wraps_and_may_count_samples() -> None:
    double = OptoforceDouble()
    configured(double, 0, 1)
    double._sent = 65534
    assert [reading.counter for reading in readings(heard(double, 4 * MS))] == [65534, 65535, 0, 1]
    double = OptoforceDouble(Sensors(counts_samples=True))
    configured(double, 0, 33)
    assert [reading.counter for reading in readings(heard(double, 100 * MS))] == [33, 66, 99]


@pytest.mark.parametrize("cutoff", [Filter.HZ_150, Filter.HZ_15, Filter.HZ_1_5])
def test_its_filter_answers_a_step_as_a_first_order_one(cutoff: Filter) -> None:
    sensors = Sensors(scene=lambda time_s: (0, 0, 40.0 if time_s > 0.9995 else 0.0), noise_counts=0, offset_counts=0)
    double = OptoforceDouble(sensors)
    configured(double, 0, 1, cutoff)
    fz = np.array([reading.counts[0][2] for reading in readings(heard(double, 2 * SECOND))])
    time_constant_s = 1 / (2 * math.pi * cutoff.cutoff_hz)
    assert np.all(fz[:999] == 0)
    expected = 16037 * (1 - np.exp(-np.arange(1, 1001) * 1e-3 / time_constant_s))
    assert fz[999:1999] == pytest.approx(expected[: len(fz[999:1999])], abs=1)


def test_its_filter_quietens_noise_and_no_filter_does_not() -> None:
    spread = []
    for filter_ in (Filter.NONE, Filter.HZ_15):
        double = OptoforceDouble(Sensors(noise_counts=20.0))
        configured(double, 0, 1, filter_)
        spread.append(np.std([reading.counts[0] for reading in readings(heard(double, 5 * SECOND))[100:]]))
    assert spread[0] == pytest.approx(20.0, rel=0.05)
    weight = 1 - math.exp(-2 * math.pi * 0.015)
    assert spread[1] == pytest.approx(20.0 * math.sqrt(weight / (2 - weight)), rel=0.2)


def test_it_is_zeroed_only_some_time_after_it_was_cleared() -> None:
    double = OptoforceDouble(Sensors(scene=load(10.0), noise_counts=0.0))
    configured(double, 0, 1)
    assert readings(heard(double, 5 * MS))[-1].counts == ((4129, 4129, 4129),)
    configured(double, 5 * MS, 1, zero=Zero.SET)
    assert readings(heard(double, 6 * MS))[-1].counts == ((0, 0, 0),)
    configured(double, 10 * MS, 1, zero=Zero.CLEAR)
    assert not double.zeroed
    configured(double, 11 * MS, 1, zero=Zero.SET)  # too early
    assert not double.zeroed
    assert readings(heard(double, 12 * MS))[-1].counts == ((4129, 4129, 4129),)
    configured(double, 12 * MS, 1, zero=Zero.SET)
    assert double.zeroed


def test_zeroing_twice_in_a_row_does_not_work() -> None:
    force = [10.0]
    double = OptoforceDouble(Sensors(scene=lambda _: [force[0]] * 3, noise_counts=0.0))
    configured(double, 0, 1)
    configured(double, 5 * MS, 1, zero=Zero.SET)
    force[0] = 20.0
    configured(double, 1000 * MS, 1, zero=Zero.SET)
    assert readings(heard(double, 1005 * MS))[-1].counts == ((4010, 4010, 4010),)  # 8018.5 + 120 - 4129, to even


def test_it_acknowledges_or_not_and_refuses_settings_that_it_does_not_have() -> None:
    double = OptoforceDouble(QUIET)
    configured(double, 0, 7)
    configured(double, 0, 0, 9)
    configured(double, 0, 0, 4, 1)
    configured(double, 0, 0)
    assert heard(double, 0) == [ConfigReply(1)] * 3 + [ConfigReply(0)]
    double = OptoforceDouble(Sensors(acknowledges=False))
    configured(double, 0, 0)
    assert heard(double, 0) == []
    assert double.settings.speed is Speed.STOP


def test_commands_in_pieces_padded_and_among_junk() -> None:
    double = OptoforceDouble(QUIET)
    stream = b"\xaa\x00\x32" + encode(Configure(0, 0, 0)).ljust(16, b"\0") + encode(Configure(1, 2, 255))
    for at in range(len(stream)):
        double.receive(stream[at : at + 1], 0)
    assert heard(double, 0) == [ConfigReply(0)] * 2
    assert (double.settings.speed, double.settings.filter) == (Speed.HZ_1000, Filter.HZ_150)


def test_overload_is_reported_and_the_signal_ends() -> None:
    force = [0.0]
    double = OptoforceDouble(Sensors(scene=lambda _: (0.0, 0.0, force[0]), noise_counts=0, offset_counts=0))
    configured(double, 0, 1)
    expected = [(39.0, 15636, 0), (49.0, 19645, 0x0080), (-49.0, -19645, 0x0080), (400.0, 28867, 0x0080)]
    for at, (newtons, counts, status) in enumerate(expected, start=1):
        force[0] = newtons
        (reading,) = readings(heard(double, at * MS))[-1:]
        assert reading.counts == ((0, 0, counts),)
        assert reading.status == status


@pytest.mark.parametrize("kind", list(Kind))
def test_every_kind_has_its_packet_and_its_scale(kind: Kind) -> None:
    report = Sensitivity((1000.0, 2000.0, 4000.0, 100.0, 200.0, 400.0)[: kind.axes], (10.0,) * kind.axes)
    double = OptoforceDouble(Sensors(kind, load(2.0, kind), report, noise_counts=0, offset_counts=0))
    configured(double, 0, 1)
    (reading,) = readings(heard(double, MS))
    assert reading.kind is kind
    assert reading.counts == ((200, 400, 800, 20, 40, 80)[: kind.axes],) * kind.channels


def test_a_sensor_that_is_pulled_off_reads_nothing_and_says_so() -> None:
    double = OptoforceDouble(Sensors(Kind.FOUR_CHANNEL, load(2.0, Kind.FOUR_CHANNEL), noise_counts=0, offset_counts=0))
    configured(double, 0, 1)
    double.unplugged = {2}
    (reading,) = readings(heard(double, MS))
    assert [sum(channel) > 0 for channel in reading.counts] == [True, True, False, True]
    assert reading.status == Status(0x0403)
    double.unplugged = {0, 2}
    assert readings(heard(double, 2 * MS))[0].status == Status(0x0409)
    double.unplugged = set()
    assert readings(heard(double, 3 * MS))[0].status == Status(0)


def test_what_is_not_kept_is_gone_after_switching_off() -> None:
    double = OptoforceDouble(Sensors(scene=load(3.0), noise_counts=0.0))
    configured(double, 0, 1, zero=Zero.SET)
    double.due(500 * MS)
    double.power_up(SECOND)
    assert (double.settings.speed, double.settings.filter, double.zeroed) == (Speed.HZ_100, Filter.HZ_15, False)
    events = heard(double, 2 * SECOND)
    assert events[0].counter == 0
    assert not any(isinstance(event, Skipped) for event in events)


def test_a_slow_line_delays_and_loses_nothing() -> None:
    double = OptoforceDouble(Sensors(bytes_per_s=11520.0))
    configured(double, 0, 10)
    events = heard(double, SECOND)
    assert isinstance(events[0], ConfigReply)
    assert len(readings(events)) == 99  # the last one is still on the line
    assert len(double.due(SECOND + 2 * MS)) == 16


def test_a_serial_number_comes_among_readings() -> None:
    double = OptoforceDouble(Sensors(serial="ABC"))
    configured(double, 0, 1)
    double.receive(bytes.fromhex("ab 00 12 08 00 c5"), 3 * MS)
    assert SerialReply("ABC") in heard(double, 5 * MS)


def test_sensitivities_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="expected 4 sensitivities of 3 axes"):
        OptoforceDouble(Sensors(Kind.FOUR_CHANNEL, sensitivity=(OMD_20_SE_40N,) * 3))
    with pytest.raises(ValueError, match="expected 1 sensitivities of 6 axes"):
        OptoforceDouble(Sensors(Kind.SIX_AXIS, sensitivity=OMD_20_SE_40N))
