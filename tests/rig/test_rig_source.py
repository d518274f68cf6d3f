"""A rig of doubles as a source: everything that came is taken once, in order, whatever happens to the cables."""

import contextlib
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.experiments.live.live_stages import live_stages
from deformscope.frames import Frame, HealthReport, Item, LinkChange, RawBytes, TactileFrame, WrenchFrame, host_ns
from deformscope.lab.double_device import double_device, wire_of
from deformscope.recording.losses import losses_of, named
from deformscope.rig.source import RigMember, RigSource
from deformscope.session import finish, run
from deformscope_drivers.dsa import Dsa, DsaConfig, DsaDouble
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.health import Link
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.optoforce import Optoforce, OptoforceConfig, OptoforceDouble
from deformscope_drivers.optoforce.protocol import Decoder, Reading
from tests.patience import PATIENCE_S


@contextlib.contextmanager
def doubled(driver: str, name: str, **settings: object) -> Iterator[RigMember]:
    config = DRIVERS[driver].config(**settings)
    with double_device(driver, config) as device:
        yield RigMember(name, DRIVERS[driver], device, simulated=True)


def gather(source: RigSource, until: Callable[[list[Item]], bool]) -> list[Item]:
    """Take until a condition on all that was taken; fails the test where it stays away."""
    items: list[Item] = []
    end = time.monotonic() + PATIENCE_S
    while not until(items):
        assert time.monotonic() < end, Counter(type(item).__name__ for item in items)
        items += source.take(0.02)
    return items


def frames_of(items: Sequence[Item], device: str) -> list[Frame]:
    return [item for item in items if isinstance(item, Frame) and item.device == device]


def test_frames_bytes_and_health_of_all_devices_in_order_of_time() -> None:
    with doubled("optoforce", "tip") as tip, doubled("dsa", "pads") as pads, RigSource([tip, pads]) as source:
        items = gather(source, lambda seen: len(frames_of(seen, "tip")) > 300 and len(frames_of(seen, "pads")) > 5)
        last = source.look()
        streams = {stream.device: stream for stream in source.streams}
    batches = frames_of(items, "tip")
    assert all(isinstance(frame, WrenchFrame) for frame in batches)
    assert [frame.index for frame in batches] == list(range(len(batches)))
    assert all(isinstance(frame, TactileFrame) for frame in frames_of(items, "pads"))
    assert dict(last.devices)["tip"].dropped == 0
    assert any(isinstance(item, HealthReport) for item in items)
    assert streams["pads"].kind == "tactile"
    assert [pad.rows * pad.columns for pad in streams["pads"].pads] == [84, 78] * 3
    assert streams["tip"].simulated


def test_on_a_simulated_clock_not_a_reading_is_lost() -> None:
    """What the host's threads may be late for, never happens here: every reading of every device is there."""
    clock = SimulatedClock(10**9)
    tip = Optoforce(OptoforceConfig(port="memory"), transport=MemoryTransport(OptoforceDouble(), clock), clock=clock)
    pads = Dsa(DsaConfig(port="memory"), transport=MemoryTransport(DsaDouble(), clock), clock=clock)

    def opener() -> None:
        pads.open(own_thread=False)
        tip.open(own_thread=False)

    members = [RigMember("tip", DRIVERS["optoforce"], tip), RigMember("pads", DRIVERS["dsa"], pads)]
    items: list[Item] = []
    with RigSource(members, clock=clock, opener=opener) as source:
        items += source.take(0.0)
        start_ns = clock()
        while clock() < start_ns + 3 * 10**9:
            tip.poll(0.01)
            pads.poll(0.0)
            items += source.take(0.0)
        health = dict(source.look().devices)
    readings = [frame for frame in frames_of(items, "tip") if host_ns(frame) > start_ns]
    assert len(readings) == 3000
    assert len(frames_of(items, "pads")) == health["pads"].received > 50
    assert len(frames_of(items, "tip")) == health["tip"].received
    assert all(one.lost == one.dropped == one.skipped_bytes == one.reconnects == 0 for one in health.values())
    assert [host_ns(item) for item in items] == sorted(host_ns(item) for item in items)
    assert sum(isinstance(item, HealthReport) for item in items) in (3, 4)


def test_the_raw_bytes_say_what_the_frames_say() -> None:
    with doubled("optoforce", "tip") as tip, RigSource([tip]) as source:
        items = gather(source, lambda seen: len(frames_of(seen, "tip")) > 200)
        source.close()
        items += source.rest()
    data = b"".join(item.data for item in items if isinstance(item, RawBytes) and not item.sent)
    counters = [event.counter for event in Decoder().feed(data) if isinstance(event, Reading)]
    frames = [frame.stamp.device_ticks for frame in frames_of(items, "tip")]
    assert len(counters) > 200
    assert [ticks % 65536 for ticks in frames] == counters


def test_a_device_that_cannot_be_opened_closes_the_others_and_is_named() -> None:
    config = DRIVERS["optoforce"].config(port="/dev/ttyNONE")
    missing = RigMember("wrist", DRIVERS["optoforce"], DRIVERS["optoforce"].make(config))
    before = threading.active_count()
    with doubled("optoforce", "tip") as tip:
        running = threading.active_count()
        with pytest.raises(InputError, match="device wrist"), RigSource([tip, missing]):
            pass
        assert not tip.device.is_open
        assert threading.active_count() == running
    assert threading.active_count() == before


def test_a_cable_pulled_out_is_an_item_and_the_others_go_on() -> None:
    config = DRIVERS["optoforce"].config()
    with wire_of("optoforce", config, "") as wire, doubled("dsa", "pads") as pads:
        device = DRIVERS["optoforce"].make(DRIVERS["optoforce"].config(port=wire.port))
        with RigSource([RigMember("tip", DRIVERS["optoforce"], device), pads]) as source:
            gather(source, lambda seen: len(frames_of(seen, "tip")) > 10)
            wire.unplug()
            lost = gather(source, lambda seen: bool(changes(seen)) and len(frames_of(seen, "pads")) > 3)
            wire.plug()
            found = gather(source, lambda seen: len(frames_of(seen, "tip")) > 10)
    assert changes(lost)[0] is Link.LOST
    assert changes(found)[-1] is Link.CONNECTED


def changes(items: Sequence[Item]) -> list[Link]:
    return [item.event.link for item in items if isinstance(item, LinkChange) and item.device == "tip"]


class Keeper:
    """A recorder that keeps all."""

    def __init__(self) -> None:
        self.items: list[Item] = []

    def write(self, items: Any) -> None:
        self.items += items if isinstance(items, Sequence) else ()


def test_watching_leaves_nothing_behind() -> None:
    keeper = Keeper()
    with doubled("optoforce", "tip") as tip, RigSource([tip]) as source:
        run(source, live_stages((), {}, lambda items: len(frames_of(keeper.items, "tip")) > 200), keeper)
        finish(source, keeper)
        health = tip.device.health()
    frames = frames_of(keeper.items, "tip")
    assert [frame.index for frame in frames] == list(range(len(frames)))
    assert health.received == len(frames)
    assert health.dropped == 0
    assert not source.failures
    assert [host_ns(item) for item in frames] == sorted(host_ns(item) for item in frames)
    assert changes(keeper.items)[-1] is Link.CLOSED


def test_ctrl_c_while_devices_open_closes_them(monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupted(ThreadPoolExecutor):
        def map(self, *arguments: Any, **options: Any) -> Any:
            list(super().map(*arguments, **options))
            raise KeyboardInterrupt

    monkeypatch.setattr("deformscope.rig.source.ThreadPoolExecutor", Interrupted)
    with doubled("optoforce", "tip") as tip:
        with pytest.raises(KeyboardInterrupt), RigSource([tip]):
            pass
        assert not tip.device.is_open


def test_a_device_that_does_not_close_well_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with doubled("optoforce", "tip") as tip:
        source = RigSource([tip])
        with source:
            close = tip.device.close

            def fail() -> None:
                close()
                raise DeviceError("an arm that stopped", "one that did not")

            monkeypatch.setattr(tip.device, "close", fail)
        assert "one that did not" in source.failures["tip"]
        monkeypatch.undo()


def test_a_recording_of_files_ends_with_them(tmp_path: Path) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((8, 8, 3), number, np.uint8))
    driver = DRIVERS["image_folder"]
    device = driver.make(driver.config(path=str(tmp_path), fps=50.0))
    keeper = Keeper()
    with RigSource([RigMember("camera", driver, device)]) as source:
        run(source, live_stages((), {}, lambda items: source.ended), keeper)
        finish(source, keeper)
    assert len(frames_of(keeper.items, "camera")) == 3
    assert not source.failures


def test_a_device_that_is_gone_for_good_is_a_loss_by_time() -> None:
    """Its counter cannot know."""
    config = DRIVERS["optoforce"].config()
    with wire_of("optoforce", config, "") as wire:
        device = DRIVERS["optoforce"].make(DRIVERS["optoforce"].config(port=wire.port))
        with RigSource([RigMember("tip", DRIVERS["optoforce"], device)]) as source:
            gather(source, lambda seen: len(frames_of(seen, "tip")) > 200)
            wire.unplug()
            gather(source, lambda seen: Link.LOST in changes(seen))
            gather(source, lambda seen: device.health().silent_s > 0.5)
            source.close()
            last = source.look()
            health = dict(last.devices)["tip"]
    lost = losses_of(last)["tip"]
    assert lost["silent_s"] >= 0.5
    assert lost["readings"] == lost["readings_by_time"] == pytest.approx(1000 * lost["silent_s"], rel=0.2)
    assert "a port that is there; got none" in health.reason
    assert "without any" in named({"tip": lost})
    assert source.look().devices[0][1].silent_s == health.silent_s, "closed: nothing is lost any more"


def test_a_device_that_fails_is_a_loss_until_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    with doubled("optoforce", "tip") as tip, RigSource([tip]) as source:
        gather(source, lambda seen: len(frames_of(seen, "tip")) > 200)

        def fail(timeout_s: float) -> list[Any]:
            raise ValueError("an index out of range")

        monkeypatch.setattr(tip.device, "_receive", fail)
        gather(source, lambda seen: tip.device.health().silent_s > 0.3)
        source.close()
        assert "an index out of range" in source.failures["tip"]
        assert losses_of(source.look())["tip"]["silent_s"] > 0.3
