"""ATI Net F/T and OnRobot HEX: bytes from the vendors' documents, losses, the sensor's page, a foreign client."""

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from deformscope_netft import HEX, NETFT, HexConfig, NetftConfig, NetftSensor, RdtAgain
from deformscope_netft.double import NetftDouble, NetftPage
from deformscope_netft.protocol import RECORD, Calibration, Command, Decoder, Record, read_page, request
from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope_drivers.contract import DeviceContract, ForceContract
from deformscope_drivers.contract.devices import wait_until
from deformscope_drivers.errors import DeviceError, NoReply, NotConnected, SettingsRefused
from deformscope_drivers.framing import Skipped
from deformscope_drivers.interface import DeviceDriver
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.wires import DatagramWire
from tests.patience import PATIENCE_S

# typed from ATI's table of an RDT record: high byte first
BYTES = bytes.fromhex(
    "00 00 00 07"  # RDT sequence 7
    "00 01 86 a0"  # FT sequence 100 000
    "00 00 00 00"  # status
    "00 0f 42 40"  # Fx 1 000 000
    "ff f0 bd c0"  # Fy -1 000 000
    "00 1e 84 80"  # Fz 2 000 000
    "00 00 00 01 ff ff ff ff 00 00 00 00"  # Tx Ty Tz
)
KNOWN = {"counts_per_n": 1e6, "counts_per_nm": 1e6}


@pytest.fixture(params=[NETFT, HEX], ids=["netft", "onrobot_hex"])
def any_driver(request: pytest.FixtureRequest) -> DeviceDriver:
    return request.param


class TestContract(DeviceContract, ForceContract):
    scene = ForceContract.scene

    @pytest.fixture
    def driver(self, any_driver: DeviceDriver) -> DeviceDriver:
        return any_driver


def test_requests_are_those_of_the_documents() -> None:
    assert request(Command.STREAM) == bytes.fromhex("12 34 00 02 00 00 00 00")
    assert request(Command.STOP) == bytes.fromhex("12 34 00 00 00 00 00 00")
    assert request(Command.BIAS) == bytes.fromhex("12 34 00 42 00 00 00 00")
    assert request(Command.BIAS, 255) == bytes.fromhex("12 34 00 42 00 00 00 ff")
    assert request(Command.SPEED, 2) == bytes.fromhex("12 34 00 82 00 00 00 02")
    assert request(Command.FILTER, 4) == bytes.fromhex("12 34 00 81 00 00 00 04")


def test_a_record_is_read_as_documented() -> None:
    record = Record(7, 100_000, 0, (1_000_000, -1_000_000, 2_000_000, 1, -1, 0))
    assert list(Decoder().feed(BYTES)) == [record]
    assert record.encode() == BYTES


@pytest.mark.parametrize("data", [BYTES[:-1], BYTES + b"\0", b"\0", b"<html>", b"<netft><cfgcpf>nan</cfgcpf></netft>"])
def test_a_datagram_of_another_length_has_no_record_and_harms_no_other(data: bytes) -> None:
    decoder = Decoder()
    (skipped,) = decoder.feed(data)
    assert isinstance(skipped, Skipped)
    assert skipped.count == len(data)
    assert len(list(decoder.feed(BYTES))) == 1


@settings(max_examples=200, deadline=None)
@given(st.lists(st.binary(max_size=120), max_size=6))
def test_any_datagrams_are_taken(pieces: list[bytes]) -> None:
    decoder = Decoder()
    for piece in filter(None, pieces):
        events = list(decoder.feed(piece))
        skipped = sum(one.count for one in events if isinstance(one, Skipped))
        records = sum(isinstance(one, Record) for one in events)
        assert skipped + records * RECORD.size == len(piece) or piece.startswith(b"<")


class Unkind(MemoryTransport):
    """The network: `change` gets each record with its number, and gives what arrives in its place."""

    def __init__(self, double: NetftDouble, clock: SimulatedClock, change: Callable[[int, bytes], list[bytes]]) -> None:
        super().__init__(double, clock)
        self.change, self.number, self.held = change, 0, b""

    def read(self, timeout_s: float) -> bytes:
        data = super().read(timeout_s)
        out = []
        for at in range(0, len(data), RECORD.size):
            self.number += 1
            out += self.change(self.number, data[at : at + RECORD.size])
        return b"".join(out)


def run(change: Callable[[int, bytes], list[bytes]], seconds: float = 1.0) -> tuple[NetftSensor, list]:
    config, clock = NetftConfig(**KNOWN), SimulatedClock()
    double = NetftDouble(config)
    sensor = NetftSensor(config, transport=Unkind(double, clock, change), clock=clock).open(own_thread=False)
    return sensor, polled(sensor, clock, seconds)


def polled(sensor: NetftSensor, clock: SimulatedClock, seconds: float) -> list:
    readings, until_ns = [], clock() + round(seconds * 1e9)
    while clock() < until_ns:
        readings += sensor.poll(0.05)
    return readings


def test_lost_datagrams_are_counted() -> None:
    lost = {50, 51, 52, 300, 700}
    sensor, readings = run(lambda number, data: [] if number in lost else [data])
    assert sensor.health().lost == len(lost)
    assert sensor.health().lost_by_time == 0
    assert len(readings) == pytest.approx(1000 - len(lost), abs=60)


def test_repeated_and_late_datagrams_are_no_readings() -> None:
    held: list[bytes] = []

    def change(number: int, data: bytes) -> list[bytes]:
        if number == 100:
            return [data, data]
        if number == 200:
            held.append(data)
            return []
        return [data, *held] if number == 203 else [data]

    sensor, readings = run(change)
    health = sensor.health()
    assert health.refused == {"repeated": 1, "late": 1}
    assert health.lost == 0, "the late one came"
    ticks = [one.stamp.device_ticks for one in readings]
    assert ticks == sorted(ticks)


@pytest.mark.parametrize("before_s", [0.06, 3.0])
def test_a_stream_that_begins_again_goes_on(before_s: float) -> None:
    clock, config = SimulatedClock(), NetftConfig(**KNOWN)
    double = NetftDouble(config)
    sensor = NetftSensor(config, transport=MemoryTransport(double, clock), clock=clock).open(own_thread=False)
    polled(sensor, clock, before_s)
    double.receive(request(Command.STREAM), clock())  # of another program
    assert len(polled(sensor, clock, 0.5)) == pytest.approx(500, abs=5)
    assert sensor.health().lost == 0


@pytest.mark.parametrize(
    ("status", "usable", "overload"),
    [(0, True, False), (1 << 16, True, False), (1 << 31 | 1 << 17, False, True), (1 << 31 | 1 << 20, False, False)],
)
def test_the_status_is_that_of_the_reading(status: int, usable: bool, overload: bool) -> None:
    data = BYTES[:8] + status.to_bytes(4, "big") + BYTES[12:]
    _, readings = run(lambda number, _: [int.to_bytes(number, 4, "big") + data[4:]], 0.1)
    assert {one.usable for one in readings} == {usable}
    assert {bool(one.overload) for one in readings} == {overload}
    np.testing.assert_allclose(readings[0].force_n, [[1.0, -1.0, 2.0]])
    np.testing.assert_allclose(readings[0].torque_nm, [[1e-6, -1e-6, 0.0]])


def test_a_load_that_varies_is_no_zero() -> None:
    clock, config = SimulatedClock(), NetftConfig(**KNOWN)
    double = NetftDouble(config, lambda time_s: (0.0, 0.0, 20.0 * np.sin(30.0 * time_s), 0.0, 0.0, 0.0))
    sensor = NetftSensor(config, transport=MemoryTransport(double, clock), clock=clock)
    with sensor.open(own_thread=False), pytest.raises(SettingsRefused, match="a load at rest"):
        sensor.zero()


def test_the_hex_gets_its_rate_and_filter() -> None:
    clock, config = SimulatedClock(), HexConfig(rate_hz=100, filter_hz=1.5)
    double = NetftDouble(config)
    with NetftSensor(config, transport=MemoryTransport(double, clock), clock=clock).open(own_thread=False) as sensor:
        readings = polled(sensor, clock, 1.0)
    assert double.filter == 6
    assert len(readings) == pytest.approx(100, abs=2)


# The sensor's page ----------------------------------------------------------------------------------------------------


@pytest.fixture
def wire() -> Iterator[DatagramWire]:
    with DatagramWire(NetftDouble(NetftConfig(), lambda time_s: (0.0, 0.0, 10.0, 0.0, 0.0, 0.0))) as wire:
        yield wire


def test_a_page_in_pounds_is_converted() -> None:
    with NetftPage(cfgcpf=4448.2216152605, scfgfu="lbf", cfgcpt=1000, scfgtu="N-mm") as page:
        found = read_page(page.content())
    assert found is not None
    assert found.counts_per_n == pytest.approx(1000.0)
    assert found.counts_per_nm == pytest.approx(1e6)
    assert (found.serial, found.rate_hz) == ("FT00001", 1000.0)


@pytest.mark.parametrize(
    "values", [{"scfgfu": "stone"}, {"cfgcpf": "0"}, {"cfgcpt": "-5"}, {"cfgcpf": "inf"}, {"cfgcpf": ""}]
)
def test_a_page_without_a_calibration_has_none(values: dict[str, str]) -> None:
    with NetftPage(**values) as page:
        assert read_page(page.content()) is None


def test_the_calibration_comes_from_the_page_and_a_replay_has_it(wire: DatagramWire) -> None:
    with NetftPage(cfgcpf=500_000) as page:  # each count is worth twice as much
        sensor = NetftSensor(NetftConfig(port=wire.port, http_port=page.port))
        raw, readings = sensor.raw(), sensor.readings()
        with sensor.open():
            sensor.next(PATIENCE_S)
            assert sensor.identity().serial == "FT00001"
        published = readings.take()
    assert published[0].force_n[0, 2] == pytest.approx(2 * 22.0, abs=0.3)
    again = RdtAgain(sensor.config, sensor.describe(), "tip")
    decoder = again.begin()
    found = [
        again.measure(one, chunk.host_ns) for chunk in raw.take() if not chunk.sent for one in decoder.feed(chunk.data)
    ]
    found = [one for one in found if one is not None]
    assert len(found) == len(published)
    np.testing.assert_array_equal([one.force_n for one in found], [one.force_n for one in published])


@pytest.mark.parametrize(
    ("settings", "values", "error", "words"),
    [
        ({}, {"comrdtrate": 7000}, SettingsRefused, "rate_hz = 7000, as on its page"),
        ({"serial": "FT9"}, {}, SettingsRefused, "serial number FT9; got FT00001"),
        ({}, {"scfgfu": "stone"}, SettingsRefused, "known units"),
    ],
)
def test_a_page_that_does_not_fit_is_refused_with_what_to_do(
    settings: dict, values: dict, error: type[DeviceError], words: str, wire: DatagramWire
) -> None:
    with NetftPage(**values) as page, pytest.raises(error, match=words):
        NetftSensor(NetftConfig(port=wire.port, http_port=page.port, **settings)).open()


def test_a_page_of_anything_else_is_refused_or_not_needed(wire: DatagramWire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(NetftPage, "content", lambda page: b"<html><body>a printer</body></html>")
    with NetftPage() as page:
        config = NetftConfig(port=wire.port, http_port=page.port)
        with pytest.raises(SettingsRefused, match="a page with counts"):
            NetftSensor(config).open()
        with NetftSensor(dataclasses.replace(config, **KNOWN)).open() as sensor:
            assert sensor.next(PATIENCE_S).usable


def test_without_a_page_it_asks_for_the_counts(wire: DatagramWire) -> None:
    with NetftPage() as page:
        gone = page.port
    with pytest.raises(NotConnected, match="counts_per_n and counts_per_nm"):
        NetftSensor(NetftConfig(port=wire.port, http_port=gone)).open()


def test_a_wrong_address_is_reported_with_what_to_check() -> None:
    with DatagramWire(NetftDouble(NetftConfig())) as wire:
        gone = wire.port
    with pytest.raises((NoReply, DeviceError), match="check"):
        NetftSensor(NetftConfig(port=gone, **KNOWN)).open()


@pytest.mark.parametrize(
    "wrong",
    [
        {"port": "/dev/ttyACM0"},
        {"rate_hz": 0.0},
        {"rate_hz": 8000.0},
        {"counts_per_n": 5.0},
        {"counts_per_n": -1.0, "counts_per_nm": 1.0},
    ],
)
def test_a_configuration_that_makes_no_sense_is_refused(wrong: dict) -> None:
    with pytest.raises(ValueError, match="expected"):
        NetftConfig(**wrong)


@pytest.mark.parametrize("wrong", [{"rate_hz": 300.0}, {"filter_hz": 20.0}, {"rate_hz": 1000.0}])
def test_a_hex_has_its_own_rates_and_filters(wrong: dict) -> None:
    with pytest.raises(ValueError, match="expected"):
        HexConfig(**wrong)


def test_a_foreign_client_reads_the_double(wire: DatagramWire) -> None:
    """pynetft: its own socket, its own reading of the page and of the records."""
    pynetft = pytest.importorskip("pynetft", reason="pip install pynetft")
    host, port = wire.port.removeprefix("udp://").split(":")
    with NetftPage() as page:
        config = pynetft.Config(sensor_host=host, rdt_port=int(port), http_port=page.port)
        with pynetft.Client(config) as client:
            assert client.wait_for_first_sample(PATIENCE_S)
            first = client.latest_sample()
            client.bias()
            wait_until(lambda: abs(client.latest_sample().force[2]) < 0.2)
            health = client.health()
    np.testing.assert_allclose(first.force, [4.0, -3.0, 22.0], atol=0.2)
    np.testing.assert_allclose(first.torque, [0.05, -0.1, 0.02], atol=5e-3)
    assert (first.force_unit.value, first.torque_unit.value) == ("N", "N-m")
    assert (health.malformed_count, health.duplicate_count, health.device_error_count) == (0, 0, 0)


def test_a_calibration_that_is_given_is_kept() -> None:
    config = dataclasses.replace(NetftConfig(), **KNOWN)
    again = RdtAgain(config, None, "tip")
    decoder = again.begin()
    assert again.measure(Calibration(1.0, 1.0), 0) is None
    (record,) = decoder.feed(BYTES)
    np.testing.assert_allclose(again.measure(record, 0).force_n, [[1.0, -1.0, 2.0]])
