"""What every device owes its users, as tests."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError, LinkLost, NotConnected, Stale
from deformscope_drivers.health import Link
from deformscope_drivers.interface import DeviceDriver, Scene
from deformscope_drivers.wires import of_any_serial, reaching, wire_for

PATIENCE_S = 60.0
TOLD_WITHIN_S = 1.0


@dataclass(frozen=True, slots=True)
class Bench:
    """A device on the bench. device: closed; unplug, plug: pull its cable out and put it back, None = cannot be
    done from here; pause, resume: the device falls silent and speaks again, on a link that stays; another: opens the
    same port a second time, which must be refused"""

    device: Device[Any]
    unplug: Callable[[], None] | None = None
    plug: Callable[[], None] | None = None
    pause: Callable[[], None] | None = None
    resume: Callable[[], None] | None = None
    another: Callable[[], Device[Any]] | None = None
    told_within_s: float = TOLD_WITHIN_S  # generous: a busy machine is no fault of the device's


@contextlib.contextmanager
def bench_of(driver: DeviceDriver, scene: Scene) -> Iterator[Bench]:
    """A device of a driver with its double, by its default configuration."""
    config = driver.doubled_config
    if driver.double is None:
        assert driver.simulated is not None, "a driver with a double"
        with driver.simulated(of_any_serial(config), scene) as device:
            yield Bench(device)
        return
    with wire_for(driver.double(config, scene), config, "virtual:contract") as wire:
        device = driver.make(reaching(config, wire.port, is_bus=wire.is_bus))
        yield Bench(device, wire.unplug, wire.plug)


def wait_until(condition: Callable[[], bool], timeout_s: float = PATIENCE_S) -> float:
    """Wait for a condition; the time it took [s]. Fails the test when it stays away."""
    start = time.monotonic()
    while not condition():
        if time.monotonic() - start > timeout_s:
            pytest.fail(f"nothing happened within {timeout_s:g} s")
        time.sleep(0.002)
    return time.monotonic() - start


def open_things() -> tuple[int, set[str]]:
    """Open file descriptors of this process, and the names of its threads."""
    folder = Path("/proc/self/fd")
    return len(list(folder.iterdir())) if folder.is_dir() else 0, {thread.name for thread in threading.enumerate()}


def nothing_left_since(before: tuple[int, set[str]]) -> bool:
    """Whether no descriptor and no thread is open that was not `before`; other processes may take their time to end."""
    descriptors, threads = open_things()
    return descriptors <= before[0] and threads <= before[1]


class Contract:
    """The subclass gives the fixture `driver`, or its own `bench`, on other doubles or real hardware."""

    @pytest.fixture
    def driver(self) -> DeviceDriver:
        raise NotImplementedError("a contract test gives the fixture `driver` or `bench`")

    def scene(self, time_s: float) -> Any:
        """What the double measures, by kind: see `deformscope_drivers.interface.Scene`."""
        return None

    @pytest.fixture
    def bench(self, driver: DeviceDriver) -> Iterator[Bench]:
        with bench_of(driver, self.scene) as bench:
            yield bench

    @pytest.fixture
    def device(self, bench: Bench) -> Iterator[Device[Any]]:
        with bench.device.open() as device:
            yield device


class DeviceContract(Contract):
    """Every device passes this."""

    def test_a_constructor_touches_nothing(self, bench: Bench) -> None:
        assert not bench.device.is_open
        assert bench.device.link is Link.CLOSED
        assert f"device {bench.device.name}" not in open_things()[1]

    def test_nothing_is_read_from_a_closed_device(self, bench: Bench) -> None:
        with pytest.raises(NotConnected):
            bench.device.next(0.1)
        with pytest.raises(NotConnected):
            bench.device.latest(1.0)
        with pytest.raises(NotConnected):
            next(iter(bench.device))

    def test_it_is_opened_once_and_closed_as_often_as_one_likes(self, bench: Bench) -> None:
        with bench.device as device:
            assert device.link is Link.CONNECTED
            with pytest.raises(DeviceError, match="closed"):
                device.open()
        assert not device.is_open
        device.close()

    def test_it_opens_again_and_leaves_nothing_behind(self, bench: Bench) -> None:
        with bench.device as device:
            device.next(PATIENCE_S)
        before = open_things()
        for _ in range(3):
            with bench.device as device:
                device.next(PATIENCE_S)
                assert device.health().received >= 1
        wait_until(lambda: nothing_left_since(before))

    def test_a_second_owner_is_refused(self, bench: Bench, device: Device[Any]) -> None:
        if bench.another is None:
            pytest.skip("this link may be shared")
        with pytest.raises(NotConnected):
            bench.another().open()
        device.next(PATIENCE_S)

    def test_iteration_gives_every_reading_in_order(self, device: Device[Any]) -> None:
        before = device.health().received
        readings = device.readings()
        taken = [readings.get(PATIENCE_S) for _ in range(20)]
        stamps = [reading.stamp.host_ns for reading in taken]
        assert stamps == sorted(stamps)
        assert readings.dropped == 0
        assert device.health().received >= before + 20

    def test_next_waits_for_a_new_reading(self, device: Device[Any]) -> None:
        asked_ns = time.monotonic_ns()
        assert device.next(PATIENCE_S).stamp.host_ns >= asked_ns

    def test_latest_is_at_hand_while_it_is_fresh(self, device: Device[Any]) -> None:
        newest = device.next(PATIENCE_S)
        assert device.latest(PATIENCE_S).stamp.host_ns >= newest.stamp.host_ns
        with pytest.raises(Stale, match="reading"):
            device.latest(-1.0)

    def test_silence_is_stale(self, bench: Bench, device: Device[Any]) -> None:
        if bench.pause is None or bench.resume is None:
            pytest.skip("this device cannot be made to fall silent")
        device.next(PATIENCE_S)
        bench.pause()
        wait_until(lambda: (device.health().age_s or 0.0) > 0.05)
        with pytest.raises(Stale):
            device.latest(0.05)
        with pytest.raises(Stale):
            device.next(0.05)
        bench.resume()
        device.next(PATIENCE_S)

    def test_a_slow_reader_loses_the_oldest_and_sees_how_many(self, device: Device[Any]) -> None:
        readings = device.readings(capacity=4)
        quick = device.readings()
        wait_until(lambda: readings.dropped >= 3)
        device.close()
        newest = list(quick)[-4:]
        assert readings.received == readings.dropped + len(readings)
        assert list(readings) == newest
        assert device.health().dropped >= readings.dropped

    def test_all_readers_come_to_an_end_when_it_is_closed(self, device: Device[Any]) -> None:
        ended = threading.Event()
        readings = device.readings()

        def read() -> None:
            for _ in readings:
                pass
            ended.set()

        reader = threading.Thread(target=read)
        reader.start()
        device.next(PATIENCE_S)
        device.close()
        assert ended.wait(PATIENCE_S)
        reader.join()

    def test_health_counts_what_came_and_was_lost(self, device: Device[Any]) -> None:
        device.next(PATIENCE_S)
        readings = [device.next(PATIENCE_S) for _ in range(5)]
        health = device.health()
        assert health.link is Link.CONNECTED
        assert health.received >= len(readings)
        assert health.rate_hz > 0
        assert health.age_s is not None
        assert 0 <= health.age_s < PATIENCE_S
        assert health.reconnects == 0

    def test_a_cable_pulled_out_is_reported_and_put_back_is_found(self, bench: Bench, device: Device[Any]) -> None:
        if bench.unplug is None or bench.plug is None:
            pytest.skip("this cable cannot be pulled from here")
        events = device.events()
        readings = device.readings()
        device.next(PATIENCE_S)
        bench.unplug()
        assert events.get(PATIENCE_S).link is Link.LOST
        assert device.health().reason
        bench.plug()
        wait_until(lambda: device.link is Link.CONNECTED)
        after_ns = time.monotonic_ns()
        device.next(PATIENCE_S)
        assert device.health().reconnects == 1
        assert events.get(PATIENCE_S).link is Link.CONNECTED
        assert not readings.ended
        assert any(reading.stamp.host_ns >= after_ns for reading in readings.take())

    def test_it_closes_while_its_link_is_lost(self, bench: Bench, device: Device[Any]) -> None:
        if bench.unplug is None:
            pytest.skip("this cable cannot be pulled from here")
        readings = device.readings()
        bench.unplug()
        wait_until(lambda: device.link is Link.LOST)
        device.close()
        assert list(readings) is not None
        assert readings.ended
        with pytest.raises(NotConnected):
            device.latest(1.0)

    def test_it_does_not_open_without_a_cable(self, bench: Bench) -> None:
        if bench.unplug is None:
            pytest.skip("this cable cannot be pulled from here")
        bench.unplug()
        with pytest.raises((NotConnected, LinkLost, DeviceError)) as caught:
            bench.device.open()
        assert bench.device.name in str(caught.value)
        assert not bench.device.is_open
