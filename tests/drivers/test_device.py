"""What all devices share, on a toy: the contract over every transport, commands, faults, and a simulated clock."""

import random
import socket
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import pytest

from deformscope_drivers.clock import Stamp
from deformscope_drivers.device import Device, EndOfReadings, Reconnect
from deformscope_drivers.errors import Busy, DeviceError, LinkLost, NoReply, NotConnected, Stale
from deformscope_drivers.health import Link
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.transport import CanTransport, SerialTransport, parse_bus, serial_or_can
from deformscope_drivers.wires import CanWire, PtyWire, TcpWire
from tests.drivers.buses import udp_bus
from tests.drivers.contract import Bench, DeviceContract, open_things, wait_until
from tests.drivers.faults import Faults, FaultyDouble
from tests.drivers.toy import PERIOD_NS, Toy, ToyDouble

QUICK = Reconnect(0.01, 0.1)


def silence(double: ToyDouble, silent: bool) -> None:
    double.silent = silent


def bench_on(wire, make) -> Bench:
    double = wire.double
    return Bench(make(), wire.unplug, wire.plug, lambda: silence(double, True), lambda: silence(double, False))


class TestOverAPty(DeviceContract):
    @pytest.fixture
    def bench(self) -> Iterator[Bench]:
        with PtyWire(ToyDouble()) as wire:
            made = bench_on(wire, lambda: Toy(SerialTransport(wire.port, 115200), reconnect=QUICK))
            yield Bench(
                made.device,
                made.unplug,
                made.plug,
                made.pause,
                made.resume,
                lambda: Toy(SerialTransport(wire.port, 9600)),
            )


class TestOverASocket(DeviceContract):
    @pytest.fixture
    def bench(self) -> Iterator[Bench]:
        with TcpWire(ToyDouble()) as wire:
            yield bench_on(wire, lambda: Toy(SerialTransport(wire.port, 115200), reconnect=QUICK))


@pytest.mark.parametrize("bus", ["virtual:toy", udp_bus()], ids=["virtual", "udp"])
class TestOverCan(DeviceContract):
    @pytest.fixture
    def bench(self, bus: str) -> Iterator[Bench]:
        with CanWire(ToyDouble(), bus, receive_id=0x100, send_id=0x101) as wire:
            made = bench_on(
                wire, lambda: Toy(CanTransport(bus, 0x100, 0x101, 1_000_000), silence_s=0.5, reconnect=QUICK)
            )
            # A bus goes on without the device: what is seen is silence, and an opened bus is a link.
            yield Bench(made.device, None, None, made.pause, made.resume)

    def test_silence_ends_the_link(self, bus: str) -> None:
        with CanWire(ToyDouble(), bus, receive_id=0x100, send_id=0x101) as wire:
            with Toy(CanTransport(bus, 0x100, 0x101, 1_000_000), silence_s=0.1, reconnect=QUICK) as device:
                device.next(5.0)
                events = device.events()
                wire.unplug()
                lost = events.get(5.0)
                wire.plug()
                device.next(5.0)
            assert lost.link is Link.LOST
            assert "none for 0.1 s" in lost.reason


@pytest.fixture
def wire() -> Iterator[PtyWire]:
    with PtyWire(ToyDouble()) as wire:
        yield wire


def toy(wire: PtyWire, **options) -> Toy:
    return Toy(SerialTransport(wire.port, 115200), **options)


def test_a_command_is_answered_while_readings_go_on(wire: PtyWire) -> None:
    with toy(wire) as device:
        readings = device.readings()
        device.next(5.0)
        assert device.set(7000) == 7000
        wait_until(lambda: device.next(5.0).count > 7000)
        assert any(reading.count < 7000 for reading in readings.take())


def test_no_reply_names_the_port_and_the_tries(wire: PtyWire) -> None:
    wire.double.deaf = True
    with toy(wire) as device, pytest.raises(NoReply, match=r"the new count within 2 x 0\.05 s") as caught:
        device.set(1, timeout_s=0.05)
    assert wire.port in str(caught.value)


def test_commands_from_many_threads_do_not_mix(wire: PtyWire) -> None:
    wrong = []

    def work(number: int) -> None:
        for step in range(20):
            count = number * 1000 + step
            if device.set(count) != count:
                wrong.append(count)

    with toy(wire) as device:
        threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert wrong == []


def test_a_command_on_a_lost_link_fails_at_once(wire: PtyWire) -> None:
    with toy(wire) as device:
        wire.unplug()
        wait_until(lambda: device.link is Link.LOST)
        with pytest.raises(LinkLost):
            device.set(1)


def test_without_reconnection_readers_get_the_error(wire: PtyWire) -> None:
    with toy(wire, reconnect=None) as device:
        readings = device.readings()
        device.next(5.0)
        wire.unplug()
        with pytest.raises(LinkLost):
            for _ in readings:
                pass
        with pytest.raises(LinkLost):
            device.latest(100.0)
        assert device.link is Link.FAILED


def test_an_error_in_the_device_thread_reaches_every_reader(wire: PtyWire, monkeypatch: pytest.MonkeyPatch) -> None:
    with toy(wire) as device:
        readings = device.readings()
        monkeypatch.setattr(device, "_measure", lambda event, host_ns: 1 // 0)
        with pytest.raises(ZeroDivisionError):
            for _ in readings:
                pass
        with pytest.raises(ZeroDivisionError):
            device.next(1.0)


def test_raw_bytes_are_what_went_over_the_wire(wire: PtyWire) -> None:
    with toy(wire) as device:
        raw = device.raw()
        readings = device.readings()
        device.set(0x1234)
        device.next(5.0)
        device.close()
        chunks = list(raw)
        sent = b"".join(chunk.data for chunk in chunks if chunk.sent)
        received = b"".join(chunk.data for chunk in chunks if not chunk.sent)
        counts = [int.from_bytes(received[at + 1 : at + 3], "big") for at in range(0, len(received), 4)]
    assert sent == b"=\x12\x34"
    assert received.count(b"!\x12\x34\x46") == 1
    assert [reading.count for reading in readings] == [
        count for at, count in enumerate(counts) if received[4 * at : 4 * at + 1] == b"#"
    ]


def test_a_queue_from_before_the_opening_misses_nothing(wire: PtyWire) -> None:
    device = toy(wire)
    readings, raw, events = device.readings(), device.raw(), device.events()
    with device:
        device.next(5.0)
    taken = list(readings)
    assert len(taken) == device.health().received
    assert b"".join(chunk.data for chunk in raw)[1:3] == taken[0].count.to_bytes(2, "big")
    assert [event.link for event in events] == [Link.CONNECTED, Link.CLOSED]


def test_raw_bytes_that_nobody_takes_are_counted_as_dropped(wire: PtyWire) -> None:
    with toy(wire) as device:
        raw = device.raw(capacity=2)
        wait_until(lambda: raw.dropped > 3)
        assert device.health().extra["raw_dropped"] >= 3


def test_a_queue_of_a_device_that_does_not_open_ends_with_the_reason() -> None:
    device = Toy(SerialTransport("/dev/ttyNONE", 115200))
    readings = device.readings()
    with pytest.raises(NotConnected):
        device.open()
    with pytest.raises(NotConnected):
        next(iter(readings))


def test_the_same_reading_again_and_again_is_a_stuck_sensor(wire: PtyWire) -> None:
    with toy(wire, stuck_after_s=0.05) as device:
        device.next(5.0)
        assert not device.health().stuck
        wire.double.stuck = True
        wait_until(lambda: device.health().stuck)
        with pytest.raises(Stale, match="the same reading"):
            device.latest(1.0)
        wire.double.stuck = False
        wait_until(lambda: not device.health().stuck)
        device.latest(1.0)


def test_a_bad_wire_is_counted_and_survived() -> None:
    faulty = FaultyDouble(ToyDouble(), Faults(noise=0.1, flip=0.1, cut=0.1, split=0.1), seed=3)
    with PtyWire(faulty) as wire, toy(wire) as device:
        wait_until(lambda: device.health().received > 300)
        health = device.health()
    assert health.skipped_bytes > 100
    assert health.refused["checksum"] > 3
    assert health.resyncs > 10
    assert health.lost > 3


def test_cables_pulled_and_put_back_leave_nothing_behind(wire: PtyWire) -> None:
    with toy(wire, reconnect=QUICK) as device:
        device.next(5.0)
        before = open_things()
        for cycle in range(20):
            wire.unplug()
            wait_until(lambda: device.link is Link.LOST)
            wire.plug()
            wait_until(lambda cycle=cycle: device.health().reconnects == cycle + 1)
            device.next(5.0)
        after = open_things()
    # The double's own thread is new after every plug; its name is the same.
    assert after == before


def test_a_port_that_is_not_there_is_reported() -> None:
    with pytest.raises(NotConnected, match=r"expected a port that is there; got none .* /dev/ttyNONE"):
        Toy(SerialTransport("/dev/ttyNONE", 115200)).open()


def test_a_refused_connection_is_no_matter_of_the_usb_cable() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(NotConnected, match=r"got .*refused.* try: .*power.*address"):
        Toy(SerialTransport(f"socket://127.0.0.1:{port}", 115200)).open()


def test_a_port_in_use_is_reported(wire: PtyWire) -> None:
    with toy(wire), pytest.raises(Busy, match="another program"):
        toy(wire).open()


def test_a_configuration_names_one_way_to_the_device() -> None:
    with pytest.raises(DeviceError, match="neither"):
        serial_or_can("", "", baudrate=1)
    with pytest.raises(DeviceError, match="both"):
        serial_or_can("/dev/x", "virtual:y", baudrate=1)
    assert parse_bus("udp_multicast:239.1.1.1?port=5&hop_limit=0") == (
        "udp_multicast",
        "239.1.1.1",
        {"port": 5, "hop_limit": 0},
    )
    with pytest.raises(NotConnected, match="interface:channel"):
        parse_bus("can0")


def simulated(double: ToyDouble) -> tuple[Toy, SimulatedClock, MemoryTransport]:
    clock = SimulatedClock(10**9)
    double.power_up(clock())
    transport = MemoryTransport(double, clock)
    return Toy(transport, clock=clock), clock, transport


def test_on_a_simulated_clock_a_run_is_the_same_every_time() -> None:
    def run() -> list[tuple[int, int]]:
        device, clock, _ = simulated(ToyDouble())
        with device.open(own_thread=False):
            readings = device.readings()
            while clock() < 3 * 10**9:
                device.poll(0.01)
            assert device.set(500) == 500
            assert device.next(0.1).count == 500
            return [(reading.stamp.host_ns, reading.count) for reading in readings.take()]

    first = run()
    assert first == run()
    assert len(first) == 1001
    assert first[0] == (10**9 + PERIOD_NS, 0)


def test_silence_on_a_simulated_clock_is_stale_in_simulated_time() -> None:
    double = ToyDouble()
    device, clock, _ = simulated(double)
    with device.open(own_thread=False):
        device.next(1.0)
        double.silent = True
        before_ns = clock()
        with pytest.raises(Stale, match=r"none for 0\.5"):
            device.next(0.5)
        assert clock() - before_ns == pytest.approx(5e8, abs=2 * PERIOD_NS)


def test_the_clock_of_the_device_is_fitted_through_random_delays() -> None:
    from deformscope_drivers.clock import ClockFit, Unwrap

    rng = random.Random(0)
    skew, fit, unwrap = 80e-6, ClockFit(1e6), Unwrap(1 << 16, 1e6)
    for tick in range(100_000):
        delay_ns = 50_000 + rng.expovariate(1 / 400_000)
        host_ns = round(7e9 + tick * 1e6 * (1 + skew) + delay_ns)
        fit.add(unwrap(tick % 65536, host_ns), host_ns)
    relation = fit.relation()
    assert relation.drift_ppm == pytest.approx(80, abs=1)
    assert relation.residual_ns < 20_000
    assert relation.offset_ns + 50_000 * relation.tick_ns == pytest.approx(
        7e9 + 50_000 * 1e6 * (1 + skew) + 50_000, abs=20_000
    )


def test_a_wrapping_counter_is_followed_over_a_long_pause() -> None:
    from deformscope_drivers.clock import Unwrap

    unwrap = Unwrap(65536, 1e6)
    assert unwrap(65530, 0) == 65530
    assert unwrap(4, 10_000_000) == 65540
    assert unwrap(2, 8_000_000) == 65538  # one that came late
    assert unwrap(10, 200_000_000_000) == 4 * 65536 + 10  # 200 s later, at 1 kHz


@dataclass(frozen=True, slots=True)
class Page:
    stamp: Stamp
    number: int


class Book(Device[Page]):
    """A device that can wait for its readers, and comes to an end."""

    queue_readings = 3

    def __init__(self, pages: int) -> None:
        super().__init__("book")
        self.pages = pages

    def _connect(self) -> None:
        self._turned = 0

    def _receive(self, timeout_s: float) -> Iterable[Page]:
        if not self._wanted():
            time.sleep(0.001)
            return []
        if self._turned == self.pages:
            raise EndOfReadings("the last page")
        self._turned += 1
        return [Page(Stamp(time.monotonic_ns()), self._turned)]

    def _disconnect(self) -> None:
        pass


def test_readers_end_with_what_there_is_to_read_and_lose_nothing() -> None:
    with Book(50) as book:
        read = []
        for page in book:
            time.sleep(0.0005)
            read.append(page.number)
        wait_until(lambda: book.link is Link.CLOSED)
        assert read == list(range(1, 51))
        assert book.health().dropped == 0
        assert book.health().reason == "the last page"
        with pytest.raises(NotConnected, match="the last page"):
            book.next(0.1)
        with pytest.raises(NotConnected, match="the last page"):
            book.latest(10.0)
    assert not book.is_open
    with book:
        assert book.next(5.0).number == 1  # opened again, it begins again


def test_next_turns_one_page_at_a_time() -> None:
    with Book(3) as book:
        numbers = []
        for _ in range(3):
            numbers.append(book.next(5.0).number)
            time.sleep(0.01)
        assert numbers == [1, 2, 3]
        with pytest.raises(NotConnected, match="the last page"):
            book.next(5.0)


def test_a_poll_at_the_end_closes_it() -> None:
    book = Book(2).open(own_thread=False)
    queue = book.readings()
    assert [page.number for _ in range(3) for page in book.poll()] == [1, 2]
    assert [page.number for page in queue] == [1, 2]
    with pytest.raises(NotConnected, match="the last page"):
        book.poll()
    book.close()
    assert not book.is_open


def test_a_port_that_goes_while_it_is_opened_is_not_connected(wire: PtyWire, monkeypatch: pytest.MonkeyPatch) -> None:
    import termios

    def gone(*arguments: object) -> None:
        raise termios.error(5, "Input/output error")  # which is no OSError

    transport = SerialTransport(wire.port, 115200)
    monkeypatch.setattr(termios, "tcflush", gone)
    monkeypatch.setattr(termios, "tcsetattr", gone)
    with pytest.raises(NotConnected):
        transport.open()
    transport.close()


def test_a_host_that_never_reads_does_not_hold_a_double_up() -> None:
    class Flood(ToyDouble):
        def next_ns(self, now_ns: int) -> int | None:
            return now_ns

        def due(self, now_ns: int) -> bytes:
            return bytes(1 << 20)

    wire = TcpWire(Flood())
    wire.plug()
    with socket.create_connection(("127.0.0.1", int(wire.port.rsplit(":", 1)[1]))):
        wait_until(lambda: wire.lost_bytes > 64 << 20)
        ended = threading.Thread(target=wire.unplug, daemon=True)
        ended.start()
        ended.join(5.0)
        assert not ended.is_alive()


def test_readers_end_whatever_closing_raises(wire: PtyWire, monkeypatch: pytest.MonkeyPatch) -> None:
    device = toy(wire).open()
    readings = device.readings()
    close = device._disconnect

    def fail() -> None:
        close()
        raise ValueError("unforeseen")

    monkeypatch.setattr(device, "_disconnect", fail)
    device.close()
    assert readings.ended
    assert device.link is Link.FAILED
