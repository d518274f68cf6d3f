"""Robotiq FT 300: bytes from the vendor's documents, losses, zero."""

import numpy as np
import pytest
from deformscope_ft300 import DRIVER, Ft300, Ft300Config
from deformscope_ft300.double import Ft300Double
from deformscope_ft300.protocol import START, STOP, Decoder, Packet, Reply, crc
from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope_drivers.contract import DeviceContract, ForceContract
from deformscope_drivers.errors import DeviceError, NoReply, SettingsRefused
from deformscope_drivers.framing import Skipped
from deformscope_drivers.interface import DeviceDriver
from deformscope_drivers.memory import MemoryTransport, SimulatedClock

# typed from Robotiq's manual: Fx = 1.00 N, Fy = -1.00 N, Fz = 25.60 N, Tx = 0.001 N m, Ty = -0.001 N m, Tz = 0
DATA = bytes.fromhex("20 4e 64 00 9c ff 00 0a 01 00 ff ff 00 00")
COUNTS = (100, -100, 2560, 1, -1, 0)


class TestContract(DeviceContract, ForceContract):
    scene = ForceContract.scene

    @pytest.fixture
    def driver(self) -> DeviceDriver:
        return DRIVER


def test_the_start_of_the_stream_is_that_of_the_manual() -> None:
    assert bytes.fromhex("09 10 01 9a 00 01 02 02 00 cd ca") == START
    assert STOP == b"\xff" * 50


def test_the_checksum_is_that_of_modbus() -> None:
    """Modbus over serial line, appendix B: 02 07 gives 41 12."""
    assert crc(bytes.fromhex("02 07")) == bytes.fromhex("41 12")


def good_in(data: bytes) -> list[object]:
    decoder = Decoder()
    return [one for one in [*decoder.feed(data), *decoder.finish()] if not isinstance(one, Skipped)]


def test_a_packet_is_read_as_documented_and_a_damaged_one_is_refused() -> None:
    frame = DATA + crc(DATA)
    assert list(Decoder().feed(frame)) == [Packet(COUNTS)]
    assert Packet(COUNTS).encode() == frame
    for bit in range(len(frame) * 8):
        flipped = bytearray(frame)
        flipped[bit // 8] ^= 1 << bit % 8
        assert not good_in(bytes(flipped))


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200), st.binary(max_size=200), st.integers(1, 40))
def test_packets_are_found_in_noise_however_it_is_divided(before: bytes, after: bytes, size: int) -> None:
    frame = DATA + crc(DATA)
    data = before + frame + after
    decoder = Decoder()
    events = [one for at in range(0, len(data), size) for one in decoder.feed(data[at : at + size])] + list(
        decoder.finish()
    )
    good = [one for one in events if not isinstance(one, Skipped)]
    assert Packet(COUNTS) in good
    length = sum(16 if isinstance(one, Packet) else 8 for one in good)
    assert length + sum(one.count for one in events if isinstance(one, Skipped)) == len(data)


def opened(scene=None) -> tuple[Ft300, Ft300Double, SimulatedClock]:
    clock, double = SimulatedClock(), Ft300Double(scene)
    sensor = Ft300(Ft300Config(), transport=MemoryTransport(double, clock), clock=clock)
    return sensor.open(own_thread=False), double, clock


def polled(sensor: Ft300, clock: SimulatedClock, seconds: float) -> list:
    readings, until_ns = [], clock() + round(seconds * 1e9)
    while clock() < until_ns:
        readings += sensor.poll(0.05)
    return readings


def test_it_streams_at_100_hz_and_its_answer_is_no_noise() -> None:
    sensor, double, clock = opened()
    assert double.streams
    assert len(polled(sensor, clock, 2.0)) == pytest.approx(200, abs=2)
    assert sensor.health().skipped_bytes == 0
    sensor.close()
    assert not double.streams


def test_silence_counts_as_loss() -> None:
    sensor, double, clock = opened()
    polled(sensor, clock, 3.0)
    double._next_ns += 800_000_000
    polled(sensor, clock, 3.0)
    assert sensor.health().lost == pytest.approx(80, abs=2)


def test_a_zero_is_taken_off_here_and_counts_stay() -> None:
    sensor, _, clock = opened(lambda time_s: (0.0, 0.0, 10.0, 0.0, 0.0, 0.0))
    before = polled(sensor, clock, 0.5)
    sensor.zero()
    after = polled(sensor, clock, 0.5)
    assert np.mean([one.force_n[0] for one in after], axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=0.05)
    assert np.mean([one.counts[0][2] for one in before]) == pytest.approx(400, abs=10)
    assert np.mean([one.counts[0][2] for one in after]) == pytest.approx(400, abs=10)


def test_a_load_that_varies_is_no_zero() -> None:
    sensor, _, _ = opened(lambda time_s: (0.0, 0.0, 20.0 * np.sin(30.0 * time_s), 0.0, 0.0, 0.0))
    with pytest.raises(SettingsRefused, match="at rest"):
        sensor.zero()


def test_a_sensor_without_power_says_what_to_check() -> None:
    class Dead(Ft300Double):
        def receive(self, data: bytes, now_ns: int) -> None:
            """It hears nothing."""

    clock = SimulatedClock()
    sensor = Ft300(Ft300Config(), transport=MemoryTransport(Dead(), clock), clock=clock)
    with pytest.raises(NoReply, match="24 V"):
        sensor.open(own_thread=False)


@pytest.mark.parametrize("wrong", [{"rate_hz": 200.0}, {"port": "spy://x"}])
def test_a_configuration_that_makes_no_sense_is_refused(wrong: dict) -> None:
    with pytest.raises((ValueError, DeviceError)):
        Ft300Config(**wrong)


def test_the_answer_is_known() -> None:
    reply = bytes.fromhex("09 10 01 9a 00 01")
    assert list(Decoder().feed(reply + crc(reply))) == [Reply.STARTED]
