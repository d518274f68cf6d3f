"""The OptoForce driver on its double: the contract over pty and CAN, and what is OptoForce's own."""

import random
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from deformscope_drivers.device import Reconnect
from deformscope_drivers.errors import CommandRefused, DeviceError, NoReply, SettingsRefused
from deformscope_drivers.health import Identity, Link
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.optoforce import (
    OMD_20_SE_40N,
    CounterStep,
    Kind,
    Optoforce,
    OptoforceConfig,
    OptoforceDouble,
    Sensitivity,
    Sensors,
)
from deformscope_drivers.optoforce.protocol import Configure, Filter, Reading, Speed, Status, encode
from deformscope_drivers.wires import CanWire, PtyWire, Wire
from tests.cases import slow_but
from tests.drivers.buses import udp_bus
from tests.drivers.contract import Bench, DeviceContract, nothing_left_since, open_things, wait_until
from tests.drivers.faults import Faults, FaultyDouble
from tests.patience import PATIENCE_S

QUICK = Reconnect(0.01, 0.1)
MS = 1_000_000
UDP = udp_bus()


def silence(wire: Wire, silent: bool) -> None:
    wire.double.silent = silent


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine may keep a double from sending for longer than a DAQ would be silent."""
    monkeypatch.setattr("deformscope_drivers.optoforce.device.SILENCE_S", PATIENCE_S)


@pytest.mark.usefixtures("patient")
class TestOverAPty(DeviceContract):
    @pytest.fixture
    def bench(self) -> Iterator[Bench]:
        with PtyWire(OptoforceDouble()) as wire:
            config = OptoforceConfig(port=wire.port, reconnect=QUICK)
            yield Bench(
                Optoforce(config),
                wire.unplug,
                wire.plug,
                lambda: silence(wire, True),
                lambda: silence(wire, False),
                lambda: Optoforce(config),
            )


@pytest.mark.parametrize("bus", ["virtual:optoforce", UDP], ids=["virtual", "udp"])
@pytest.mark.parametrize("padded", [False, True], ids=["", "padded"])
@pytest.mark.usefixtures("patient")
class TestOverCan(DeviceContract):
    @pytest.fixture
    def bench(self, bus: str, padded: bool) -> Iterator[Bench]:
        with can_wire(OptoforceDouble(), bus, padded) as wire:
            config = OptoforceConfig(bus=bus, reconnect=QUICK, rate_hz=333)
            yield Bench(Optoforce(config), None, None, lambda: silence(wire, True), lambda: silence(wire, False), None)


def can_wire(double: OptoforceDouble, bus: str, padded: bool = False) -> CanWire:
    return CanWire(double, bus, receive_id=0x100, send_id=0x101, padded=padded)


class Simulation:
    """The driver and its double in one thread, on a clock of their own."""

    def __init__(self, sensors: Sensors | None = None, faults: Faults | None = None, seed: int = 0, **config) -> None:
        self.clock = SimulatedClock()
        self.double = OptoforceDouble(sensors)
        wire = self.double if faults is None else FaultyDouble(self.double, faults, seed)
        self.transport = MemoryTransport(wire, self.clock)
        config = OptoforceConfig(port="memory", **{"sensitivity": OMD_20_SE_40N, **config})
        self.device = Optoforce(config, transport=self.transport, clock=self.clock)

    def __enter__(self) -> Optoforce:
        return self.device.open(own_thread=False)

    def __exit__(self, *_) -> None:
        self.device.close()

    def run(self, seconds: float) -> list:
        """What is measured in that time."""
        until_ns = self.clock() + round(seconds * 1e9)
        found = []
        while self.clock() < until_ns:
            found += self.device.poll((until_ns - self.clock()) / 1e9)
        return found


def forces(measured: list) -> np.ndarray:
    return np.array([one.force_n for one in measured])


def test_opening_brings_the_daq_into_the_configured_state() -> None:
    simulation = Simulation(rate_hz=333, filter_hz=5)
    with simulation as device:
        assert (simulation.double.settings.speed, simulation.double.settings.filter) == (Speed.HZ_333, Filter.HZ_5)
        assert device.settings.speed is Speed.HZ_333
        assert device.acknowledges is True
        assert device.kind is Kind.THREE_AXIS
        assert len(simulation.run(1.0)) == 333


def test_a_daq_may_be_opened_stopped() -> None:
    simulation = Simulation(rate_hz=0)
    with simulation as device:
        assert device.kind is None
        assert simulation.run(30.0) == []
        assert device.link is Link.CONNECTED
        with pytest.raises(SettingsRefused, match="one that is stopped"):
            device.zero()


@pytest.mark.parametrize("acknowledges", [True, False])
@pytest.mark.parametrize("rate_hz", slow_but([10], [1000, 10]))
def test_zeroing_takes_the_load_away(rate_hz: float, acknowledges: bool) -> None:
    sensors = Sensors(scene=lambda _: (0.5, -1.0, 3.0), acknowledges=acknowledges)
    simulation = Simulation(sensors, rate_hz=rate_hz, filter_hz=15)
    with simulation as device:
        simulation.run(2.0)
        taken = device.zero()
        assert simulation.double.zeroed
        assert device.settings.zeroed
        assert taken == pytest.approx(np.array([[0.5, -1.0, 3.0]]) * 16037 / 40 + 120, abs=4)
        assert np.abs(forces(simulation.run(1.0)).mean(axis=0)).max() < 0.01
        assert device.health().extra["unacknowledged"] == (0 if acknowledges else 3)


def test_zeroing_again_takes_the_new_load() -> None:
    force = [1.0]
    simulation = Simulation(Sensors(scene=lambda _: [force[0]] * 3))
    with simulation as device:
        device.zero()
        force[0] = 5.0
        simulation.run(0.5)
        assert forces(simulation.run(0.5)).mean() == pytest.approx(4.0, abs=0.02)
        device.zero()
        assert forces(simulation.run(0.5)).mean() == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize(
    "motion", [lambda t: (0, 0, t), lambda t: (0, 0.2 * np.sin(60 * t), 0)], ids=["drift", "shake"]
)
def test_zeroing_is_refused_while_the_load_moves_and_changes_nothing(motion) -> None:
    simulation = Simulation(Sensors(scene=motion))
    with simulation as device:
        with pytest.raises(SettingsRefused, match=r"vary by less than 30 counts.*the zero point is unchanged"):
            device.zero()
        assert not device.settings.zeroed
        assert not simulation.double.zeroed
        device.zero(still_counts=1000)
        assert simulation.double.zeroed


def test_zeroing_is_refused_under_overload_and_without_a_sensor() -> None:
    simulation = Simulation(Sensors(scene=lambda _: (0, 0, 60.0)))
    with simulation as device:
        with pytest.raises(SettingsRefused, match="overload fz"):
            device.zero()
        simulation.double.unplugged = {0}
        with pytest.raises(SettingsRefused, match="sensor not detected"):
            device.zero()


def test_a_zero_point_that_does_not_take_is_noticed() -> None:
    simulation = Simulation()
    with simulation as device:
        simulation.double._set_zero = lambda zero, now_ns: None
        with pytest.raises(SettingsRefused, match="within 30 counts of zero"):
            device.zero()
        assert not device.settings.zeroed


def test_zero_at_start() -> None:
    simulation = Simulation(Sensors(scene=lambda _: (1.0, 1.0, 1.0)), zero_at_start=True)
    with simulation:
        assert np.abs(forces(simulation.run(0.5)).mean(axis=0)).max() < 0.02


def test_after_a_lost_link_settings_and_zero_point_are_there_again() -> None:
    force = [2.0]
    sensors = Sensors(scene=lambda _: [force[0]] * 3, offset_counts=200.0)
    with PtyWire(OptoforceDouble(sensors)) as wire:
        config = OptoforceConfig(port=wire.port, sensitivity=OMD_20_SE_40N, filter_hz=50, reconnect=QUICK)
        with Optoforce(config) as device:
            device.zero()
            wire.unplug()
            wait_until(lambda: device.link is Link.LOST)
            force[0] = 6.0
            wire.plug()
            wait_until(lambda: device.link is Link.CONNECTED)
            time.sleep(0.2)
            measured = device.next(5.0)
            assert (wire.double.settings.speed, wire.double.settings.filter) == (Speed.HZ_1000, Filter.HZ_50)
            assert measured.force_n.mean() == pytest.approx(4.0, abs=0.1)
            assert measured.offset_counts is not None


def test_a_daq_that_restarts_behind_a_live_link_is_set_up_again() -> None:
    simulation = Simulation(Sensors(scene=lambda _: (1.0, 2.0, 3.0)), filter_hz=50)
    with simulation as device:
        device.zero()
        simulation.run(5.0)
        events = device.events()
        simulation.double.power_up(simulation.clock() + 200 * MS)
        measured = [one for one in simulation.run(1.0) if one.usable]
        assert np.abs(forces(measured)).max() < 0.1  # not even right after the restart is there an untared force
        assert (simulation.double.settings.speed, simulation.double.settings.filter) == (Speed.HZ_1000, Filter.HZ_50)
        assert device.health().extra["restarts"] == 1
        assert "restarted" in events.get(1.0).reason
        assert device.health().lost == 0
        assert np.abs(forces(simulation.run(1.0)).mean(axis=0)).max() < 0.02


@pytest.mark.parametrize("acknowledges", [True, False])
def test_a_restart_that_looks_like_a_loss_gives_no_untared_force(acknowledges: bool) -> None:
    simulation = Simulation(Sensors(scene=lambda _: (1.0, 2.0, 3.0), acknowledges=acknowledges))
    simulation.double._sent = 63_500
    with simulation as device:
        device.zero()
        while simulation.double._sent < 65_500:
            simulation.run(0.01)
        simulation.double.power_up(simulation.clock() + 300 * MS)  # its counter goes on from 0 as after 36 lost ones
        measured = simulation.run(3.0)
        assert device.health().extra["restarts"] == 0
        assert device.settings.zeroed is False
        assert np.abs(forces([one for one in measured if one.usable])).max() < 0.1
        assert 0 < sum("zero" in one.doubts for one in measured) < 40
        assert len(measured) > 2000


@pytest.mark.parametrize("acknowledges", [True, False])
def test_while_the_zero_point_changes_readings_are_marked(acknowledges: bool) -> None:
    simulation = Simulation(Sensors(scene=lambda _: (1.0, 2.0, 3.0), acknowledges=acknowledges), filter_hz=0)
    with simulation as device:
        device.zero()
        readings = device.readings()
        device._send_settings(replace(device.settings, zeroed=False))  # as after a restart
        simulation.run(0.5)
        measured = readings.take()
        assert np.abs(forces([one for one in measured if one.usable])).max() < 0.1
        assert sum("zero" in one.doubts for one in measured) == (0 if acknowledges else 300)


def test_lost_readings_are_counted_where_they_are_missing() -> None:
    simulation = Simulation()
    with simulation as device:
        simulation.run(0.1)
        simulation.double._line.clear()
        simulation.clock.advance_to(simulation.clock() + 7 * MS)
        simulation.double.due(simulation.clock())  # nobody hears these
        measured = simulation.run(0.1)
        assert (measured[0].lost_before, measured[0].follows) == (7, CounterStep.LOST)
        assert sum(one.lost_before for one in measured) == device.health().lost == 7


@pytest.mark.parametrize("seed", slow_but([0], range(3)))
def test_on_a_bad_wire_every_whole_reading_comes_and_the_rest_is_counted(seed: int) -> None:
    simulation = Simulation(faults=Faults(noise=0.05, flip=0.05, cut=0.05, twice=0.02, split=0.1), seed=seed)
    with simulation as device:
        before = device.health()
        measured = simulation.run(10.0)
        health = device.health()
    assert health.refused["checksum"] > 100
    assert health.skipped_bytes > before.skipped_bytes
    counters = [one.stamp.device_ticks for one in measured if not one.doubts]
    missing = 10_000 - len(set(counters))
    assert health.lost == pytest.approx(missing, abs=3)
    assert missing > 700
    assert all(abs(one.counts[0][0]) < 200 for one in measured if not one.doubts)


def test_overload_and_a_missing_sensor_are_reported() -> None:
    force = [0.0]
    simulation = Simulation(Sensors(scene=lambda _: (0, 0, force[0])))
    with simulation as device:
        simulation.run(0.1)
        force[0] = 60.0
        measured = simulation.run(0.1)
        assert measured[-1].overload == ("fz",)
        assert measured[-1].usable
        assert device.health().extra["overloaded"] > 50
        simulation.double.unplugged = {0}
        measured = simulation.run(0.1)
        assert not measured[-1].usable
        assert str(measured[-1].status) == "sensor not detected"
        assert device.health().extra["unusable"] == 100


def test_a_reading_that_cannot_be_is_marked() -> None:
    simulation = Simulation(sensitivity=Sensitivity((1000.0,) * 3, (10.0,) * 3))
    with simulation as device:
        packet = encode(Reading(Kind.THREE_AXIS, 20, Status(0), ((0, 0, 2001),)))
        other = encode(Reading(Kind.SIX_AXIS, 21, Status(0), ((0,) * 6,)))
        before = device.health().extra["doubted"]
        marked = [one for event in device._decoder.feed(packet + other) for one in device._measure(event, 0)]
        assert marked[0].doubts == ("load",)
        assert not marked[0].usable
        assert marked[1].doubts == ("kind",)
        assert marked[1].per_count is None
        assert device.health().extra["doubted"] == before + 2


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("counts_samples", [False, True])
def test_every_kind_and_either_counter(kind: Kind, counts_samples: bool) -> None:
    report = Sensitivity((8000.0,) * kind.axes, (20.0,) * kind.axes)
    load = np.arange(1.0, 1 + kind.channels * kind.axes).reshape(kind.channels, kind.axes)
    sensors = Sensors(kind, lambda _: load, report, counts_samples=counts_samples, offset_counts=0.0)
    simulation = Simulation(sensors, sensitivity=(report,) * kind.channels, rate_hz=100)
    with simulation as device:
        measured = simulation.run(3.0)
        assert len(measured) == 300
        assert measured[0].force_n.shape == (kind.channels, 3)
        assert np.mean([one.load for one in measured], axis=0) == pytest.approx(load, abs=0.01)
        assert (measured[0].torque_nm is not None) == (kind is Kind.SIX_AXIS)
        assert device.health().lost == 0
        assert device.health().clock.tick_ns == pytest.approx(1e6 if counts_samples else 1e7, rel=1e-6)


def test_a_report_for_another_kind_of_sensor_is_refused() -> None:
    simulation = Simulation(Sensors(Kind.FOUR_CHANNEL), sensitivity=OMD_20_SE_40N)
    with pytest.raises(SettingsRefused, match=r"a 4-channel DAQ: 4 of 3.*one sensitivity report for each"), simulation:
        pass
    assert not simulation.device.is_open


@pytest.mark.slow
def test_the_daqs_clock_is_fitted() -> None:
    simulation = Simulation(Sensors(clock_ppm=80.0), rate_hz=100)
    with simulation as device:
        simulation.run(60.0)
        assert device.health().clock.drift_ppm == pytest.approx(-80.0, abs=1.0)
        assert device.health().lost == 0


def test_serial_numbers() -> None:
    simulation = Simulation(Sensors(serial="ISE0B001"), serial="ISE0B001")
    with simulation as device:
        assert device.identity() == Identity("OptoForce 3-axis", "ISE0B001")
        assert device.serial_number() == "ISE0B001"
    simulation = Simulation(Sensors(serial="ISE0B001"), serial="ISE0A129")
    with pytest.raises(SettingsRefused, match="expected serial number ISE0A129; got ISE0B001"), simulation:
        pass


def test_a_daq_that_refuses_or_says_nothing() -> None:
    simulation = Simulation()
    simulation.double._configure = lambda asked, now_ns: simulation.double._acknowledge(1, now_ns)
    with pytest.raises(CommandRefused, match="error 1"), simulation:
        pass
    simulation = Simulation()
    simulation.double.silent = True
    with pytest.raises(NoReply, match=r"1 readings within 1 s.*power, cable and port"), simulation:
        pass


def test_what_the_host_sends_and_hears_is_there_to_be_recorded() -> None:
    simulation = Simulation(rate_hz=100)
    chunks = simulation.device.raw()
    with simulation:
        simulation.run(0.1)
        taken = chunks.take()
        assert [chunk.data for chunk in taken if chunk.sent] == [encode(Configure(10, 2, 0))]
        heard = b"".join(chunk.data for chunk in taken if not chunk.sent)
        assert bytes.fromhex("aa 00 50 01 00 00 fb") in heard


@pytest.mark.slow
def test_a_simulated_session_repeats_bit_for_bit() -> None:
    def session() -> list:
        simulation = Simulation(Sensors(seed=3), Faults(flip=0.1, noise=0.1))
        with simulation:
            return [(one.stamp, one.counts, one.doubts) for one in simulation.run(3.0)]

    assert session() == session()


@pytest.mark.parametrize("bus", ["virtual:zeroing", UDP], ids=["virtual", "udp"])
def test_it_is_zeroed_over_can(bus: str) -> None:
    with can_wire(OptoforceDouble(), bus) as wire:
        config = OptoforceConfig(bus=bus, sensitivity=OMD_20_SE_40N, rate_hz=333)
        with Optoforce(config) as device:
            device.zero()
            assert np.abs(device.next(5.0).force_n).max() < 0.2
            assert device.serial_number() == "ISE0A129"
        assert wire.double.zeroed


def test_a_daq_that_falls_silent_is_lost_and_found() -> None:
    simulation = Simulation()
    with simulation as device:
        simulation.double.silent = True
        with pytest.raises(DeviceError, match=r"none for 1 s"):
            simulation.run(3.0)
        assert device.link is Link.LOST


class TornDouble(OptoforceDouble):
    """Its first reading after being set up comes without its beginning, as where a stream is entered anywhere."""

    def power_up(self, now_ns: int) -> None:
        super().power_up(now_ns)
        self._spoken = 0
        self._luck = random.Random(now_ns)

    def receive(self, data: bytes, now_ns: int) -> None:
        super().receive(data, now_ns)
        self._spoken = 0

    def due(self, now_ns: int) -> bytes:
        data = super().due(now_ns)
        self._spoken += bool(data)
        return data[self._luck.randint(1, 15) :] if data and self._spoken == 2 else data


@pytest.mark.parametrize("cycles", [20, pytest.param(1000, marks=pytest.mark.slow)])
def test_the_cable_is_pulled_out_and_put_back_again_and_again(cycles: int) -> None:
    skipped_readings = []
    with PtyWire(TornDouble()) as wire, Optoforce(OptoforceConfig(port=wire.port, reconnect=QUICK)) as device:
        device.next(5.0)
        before = open_things()
        for cycle in range(cycles):
            time.sleep(0.0003 * (cycle % 10))  # in the middle of whatever comes
            wire.unplug()
            wait_until(lambda: device.link is not Link.CONNECTED)
            before_plug = device.health()
            wire.plug()
            wait_until(lambda: device.link is Link.CONNECTED)
            readings = device.readings()
            for _ in range(5):
                readings.get(5.0)
            readings.close()
            skipped_readings.append((device.health().skipped_bytes - before_plug.skipped_bytes) / 16)
            assert device.health().reconnects == cycle + 1
        wait_until(lambda: nothing_left_since(before))
    assert 0 < max(skipped_readings) <= 2


class NotedDouble(OptoforceDouble):
    """Notes when each reading left it, by its counter."""

    def power_up(self, now_ns: int) -> None:
        super().power_up(now_ns)
        self.left_ns: list[int] = []

    def due(self, now_ns: int) -> bytes:
        data = super().due(now_ns)
        self.left_ns += [time.monotonic_ns()] * (self._sent - len(self.left_ns))
        return data


@pytest.mark.realtime
@pytest.mark.parametrize("seconds", [3, 60])
def test_a_kilohertz_over_a_pty_loses_nothing(seconds: int, capsys) -> None:
    double = NotedDouble()
    with (
        PtyWire(double) as wire,
        Optoforce(OptoforceConfig(port=wire.port, sensitivity=OMD_20_SE_40N, filter_hz=150)) as device,
    ):
        readings = device.readings()
        wait_until(lambda: device.health().received > 20)
        readings.take()
        start_ns, cpu_s, taken = time.monotonic_ns(), time.process_time(), []
        while time.monotonic_ns() - start_ns < seconds * 1e9:
            taken += [reading.stamp for reading in readings.take()]
            time.sleep(0.01)
        cpu = (time.process_time() - cpu_s) / seconds
        health = device.health()
    late_us = [(stamp.host_ns - double.left_ns[stamp.device_ticks]) / 1e3 for stamp in taken]
    with capsys.disabled():
        reported = ", ".join(f"{share:g} % {np.percentile(late_us, share):.0f} us" for share in (50, 90, 99, 99.9, 100))
        print(f"\n{seconds} s at 1 kHz: {len(taken)} readings, lost {health.lost}; latency {reported}; CPU {cpu:.1%}")
    assert (health.lost, health.dropped, health.skipped_bytes) == (0, 0, 0)
    assert len(taken) == pytest.approx(1000 * seconds, rel=0.1)  # a double that is kept from running sends later


def test_a_config_is_a_copy_away_from_another() -> None:
    config = OptoforceConfig(port="/dev/ttyACM0")
    assert replace(config, rate_hz=100).rate_hz == 100
    assert Optoforce(config).name == "/dev/ttyACM0"
    with pytest.raises(DeviceError, match="neither"):
        Optoforce(OptoforceConfig())
