"""OptoForce's codec: known packets both ways, however they arrive, and real recordings, whole and damaged."""

import random
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope_drivers.framing import FrameDecoder
from deformscope_drivers.optoforce.protocol import (
    CommandDecoder,
    ConfigReply,
    Configure,
    DaqState,
    Decoder,
    Filter,
    Kind,
    Reading,
    SensorState,
    SerialReply,
    Skipped,
    Speed,
    Status,
    encode,
)
from tests.drivers.optoforce.packets import FROM_DAQ, TO_DAQ

CAPTURE_1000 = Path(__file__).with_name("capture_1000.bin")
PACKETS = [(bytes.fromhex(text), event) for text, event in [*FROM_DAQ, *TO_DAQ]]
BOTH_WAYS = pytest.mark.parametrize(
    ("decoder", "packets"), [(Decoder, FROM_DAQ), (CommandDecoder, TO_DAQ)], ids=["from the DAQ", "to the DAQ"]
)


def events_of(decoder: FrameDecoder, data: bytes, piece: int | None = None) -> list:
    """What comes out, fed whole or in pieces, up to the end of the stream."""
    size = piece or max(len(data), 1)
    events = [event for at in range(0, len(data), size) for event in decoder.feed(data[at : at + size])]
    return [*events, *decoder.finish()]


@pytest.mark.parametrize(("packet", "message"), PACKETS, ids=[text for text, _ in [*FROM_DAQ, *TO_DAQ]])
def test_a_message_is_this_packet(packet: bytes, message) -> None:
    assert encode(message) == packet


@BOTH_WAYS
def test_packets_whole_in_pieces_and_merged(decoder, packets) -> None:
    stream = b"".join(bytes.fromhex(text) for text, _ in packets)
    expected = [message for _, message in packets]
    for text, message in packets:
        assert events_of(decoder(), bytes.fromhex(text)) == [message]
        assert events_of(decoder(), bytes.fromhex(text), piece=1) == [message]
    for piece in (None, 1, 2, 3, 5, 7, 16, 64):
        assert events_of(decoder(), stream, piece) == expected


@BOTH_WAYS
def test_junk_before_between_and_after(decoder, packets) -> None:
    junk = bytes.fromhex("00 ff aa aa 07 ab 00 aa 00 32 aa 07 08")  # beginnings of headers among it
    stream = junk + junk.join(bytes.fromhex(text) for text, _ in packets) + junk
    for piece in (None, 1, 3):
        events = events_of(decoder(), stream, piece)
        assert [event for event in events if not isinstance(event, Skipped)] == [message for _, message in packets]
        assert sum(event.count for event in events if isinstance(event, Skipped)) == len(junk) * (len(packets) + 1)


@BOTH_WAYS
def test_a_packet_with_any_byte_changed_is_refused_and_the_next_comes_out(decoder, packets) -> None:
    for text, message in packets:
        packet = bytes.fromhex(text)
        for at in range(len(packet)):
            for change in (0x01, 0x80, 0xFF):
                damaged = packet[:at] + bytes([packet[at] ^ change]) + packet[at + 1 :]
                events = events_of(decoder(), damaged + packet)
                assert [event for event in events if not isinstance(event, Skipped)] == [message]
                assert sum(event.count for event in events if isinstance(event, Skipped)) == len(packet)


def test_a_header_within_a_bad_packet_starts_the_search_anew() -> None:
    inner = bytes.fromhex("aa 07 08 0a 04 d2 00 00 01 91 fe 6f 1f 53 04 0a")
    cut = bytes.fromhex("aa 07 08 0a 12 34")
    events = events_of(Decoder(), cut + inner + inner)
    assert [event.counter for event in events if isinstance(event, Reading)] == [1234, 1234]
    assert [event for event in events if isinstance(event, Skipped)] == [Skipped(6, "checksum")]


def test_a_stream_entered_anywhere_gives_a_reading_within_two_packets() -> None:
    stream = CAPTURE_1000.read_bytes()[7:]
    for start in range(9000):
        reading = next(event for event in Decoder().feed(stream[start : start + 32]) if isinstance(event, Reading))
        assert reading.counter == 11626 + -(-start // 16)


def test_a_header_within_a_good_packet_starts_nothing() -> None:
    (text, reading) = FROM_DAQ[4]
    assert bytes.fromhex(text).count(bytes.fromhex("aa07080a")) == 2
    assert events_of(Decoder(), bytes.fromhex(text) * 3) == [reading] * 3


def test_a_torn_packet_waits_for_no_more_than_its_length() -> None:
    decoder = Decoder()
    four = bytes.fromhex(FROM_DAQ[5][0])
    one, reading = bytes.fromhex(FROM_DAQ[1][0]), FROM_DAQ[1][1]
    events = [event for _ in range(3) for event in decoder.feed(one if _ else four[:20])]
    assert [event for event in events if isinstance(event, Reading)] == [reading, reading]


def test_zeros_that_fill_a_can_frame_belong_to_the_packet_before() -> None:
    stream = b"".join(bytes.fromhex(text).ljust(-(-len(bytes.fromhex(text)) // 8) * 8, b"\0") for text, _ in FROM_DAQ)
    assert events_of(Decoder(fill_to=8), stream) == [message for _, message in FROM_DAQ]
    assert sum(event.count for event in events_of(Decoder(), stream) if isinstance(event, Skipped)) == 1 + 6 + 2 + 2


def test_zeros_that_fill_a_command_are_skipped() -> None:
    events = events_of(CommandDecoder(), bytes.fromhex(TO_DAQ[1][0]).ljust(16, b"\0") + bytes.fromhex(TO_DAQ[0][0]))
    assert events == [TO_DAQ[1][1], Skipped(7, "noise"), TO_DAQ[0][1]]


@pytest.mark.parametrize(
    ("text", "serial"),
    [
        ("aa 00 12 08 41 42 43 00 00 00 00 00 01 8a", "ABC"),
        ("aa 00 12 08 41 42 43 20 20 20 20 20 02 2a", "ABC"),
        ("aa 00 12 08 41 42 ff 43 44 45 46 47 03 9f", None),
        ("aa 00 12 08 00 00 00 00 00 00 00 00 00 c4", None),
    ],
)
def test_serial_numbers_shorter_than_their_room_and_none(text: str, serial: str | None) -> None:
    packet = bytes.fromhex(text)
    assert sum(packet[:-2]) == int.from_bytes(packet[-2:], "big")
    assert events_of(Decoder(), packet)[0] == (Skipped(14, "content") if serial is None else SerialReply(serial))


def test_every_bit_of_the_status_word() -> None:
    assert Status(0).usable
    assert str(Status(0)) == "ok"
    assert Status(0x2000).daq is DaqState.ERROR
    assert Status(0x4000).daq is DaqState.COMMUNICATION_ERROR
    assert Status(0x0400).sensor is SensorState.NOT_DETECTED
    assert Status(0x0800).sensor is SensorState.FAILURE
    assert Status(0x1000).sensor is SensorState.TEMPERATURE
    assert Status(0xE000).daq == 7
    assert [Status(1 << bit).overload for bit in range(9, 3, -1)] == [
        ("fx",),
        ("fy",),
        ("fz",),
        ("tx",),
        ("ty",),
        ("tz",),
    ]
    assert Status(0x0008).several_sensors
    assert [Status(number).sensor_number for number in range(5)] == [0, 1, 2, 3, 4]
    assert [bit for bit in range(16) if not Status(1 << bit).usable] == [10, 11, 12, 13, 14, 15]
    assert str(Status(0x4482)) == "DAQ communication error, sensor not detected, overload fz"
    assert Status.of(DaqState.ERROR, SensorState.FAILURE, ("fz", "tz"), True, 4) == 0x289C
    for word in range(0, 0x10000, 7):
        status = Status(word)
        reported = (status.daq, status.sensor, status.overload, status.several_sensors, status.sensor_number)
        assert Status.of(*reported) == word


def test_settings_by_their_numbers() -> None:
    assert {speed: speed.rate_hz for speed in Speed} == pytest.approx(
        {0: 0, 1: 1000, 3: 333.33, 10: 100, 33: 30.3, 100: 10}, rel=1e-3
    )
    assert {filter_.value: filter_.cutoff_hz for filter_ in Filter} == {
        0: None, 1: 500, 2: 150, 3: 50, 4: 15, 5: 5, 6: 1.5,
    }  # fmt: skip


@pytest.mark.parametrize(
    "message",
    [
        Reading(Kind.THREE_AXIS, 70000, Status(0), ((0, 0, 0),)),
        Reading(Kind.THREE_AXIS, 0, Status(0), ((0, 0, 40000),)),
        Reading(Kind.FOUR_CHANNEL, 0, Status(0), ((0, 0, 0),)),
        Reading(Kind.SIX_AXIS, 0, Status(0), ((0, 0, 0), (0, 0, 0))),
        Configure(256, 0, 0),
        ConfigReply(-1),
        SerialReply("too long for it"),
        SerialReply("ünicode"),
    ],
)
def test_what_fits_no_packet_is_refused(message) -> None:
    with pytest.raises(ValueError, match="expected"):
        encode(message)


def test_a_recording_of_a_sensor_at_rest() -> None:
    events = events_of(Decoder(), CAPTURE_1000.read_bytes())
    assert events[0] == ConfigReply(0)
    readings = events[1:]
    assert all(isinstance(reading, Reading) for reading in readings)
    assert [reading.counter for reading in readings] == list(range(11626, 12626))
    assert readings[0].counts == ((-9, -5, 7),)


def test_a_long_recording_is_whole(shared_data: Path) -> None:
    stream = (shared_data / "optoforce" / "capture_10000.bin").read_bytes()
    for piece in (None, 1000, 17):
        events = events_of(Decoder(), stream, piece)
        readings = [event for event in events if isinstance(event, Reading)]
        assert len(readings) == 10_000
        assert [reading.counter for reading in readings] == list(range(11626, 21626))
        assert {reading.status for reading in readings} == {0}
        assert Counter(type(event) for event in events) == {Reading: 10_000, ConfigReply: 1}
        assert b"".join(encode(event) for event in events) == stream


@pytest.mark.parametrize("seed", range(5))
def test_a_damaged_recording_loses_the_damaged_packets_alone(seed: int) -> None:
    luck = random.Random(seed)
    stream = CAPTURE_1000.read_bytes()[7:]
    packets = [stream[at : at + 16] for at in range(0, len(stream), 16)]
    pieces, good, changed, bad_bytes = [], [], 0, 0
    for packet in packets:
        fate = luck.choice(["good", "good", "good", "junk", "changed", "dropped"])
        if fate in ("good", "junk"):
            junk = luck.choice([luck.randbytes(luck.randint(1, 40)), packet[:4], b"\xaa\x07\x08\x1c", packet[:15]])
            junk = junk if fate == "junk" else b""
            pieces += [junk, packet]
            good.append(packet)
            bad_bytes += len(junk)
        elif fate == "changed":
            at = luck.randrange(4, 16)
            pieces.append(packet[:at] + bytes([packet[at] ^ luck.randint(1, 255)]) + packet[at + 1 :])
            changed += 1
            bad_bytes += 16
        else:
            first = luck.randrange(16)
            rest = packet[:first] + packet[first + luck.randint(1, 16 - first) :]
            pieces.append(rest)
            bad_bytes += len(rest)

    for piece in (None, 1, 50):
        events = events_of(Decoder(), b"".join(pieces), piece)
        skipped = [event for event in events if isinstance(event, Skipped)]
        assert [encode(event) for event in events if isinstance(event, Reading)] == good
        assert sum(event.count for event in skipped) == bad_bytes
        assert sum(event.reason == "checksum" for event in skipped) >= changed
        assert len(events) == len(good) + len(skipped)


JUNK = st.one_of(
    st.binary(max_size=40),
    st.sampled_from([packet for packet, _ in PACKETS]),
    st.sampled_from([packet[:length] for packet, _ in PACKETS for length in (1, 2, 3, 4, 5, 9)]),
)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.lists(JUNK, max_size=12), st.integers(1, 40))
def test_anything_may_be_fed_and_what_is_behind_comes_out(pieces: list[bytes], piece: int) -> None:
    longest, tail = 34, [bytes.fromhex(FROM_DAQ[1][0])] * 4
    stream = b"".join(pieces)
    decoder, events = Decoder(), []
    for at in range(0, len(stream), piece):
        events += decoder.feed(stream[at : at + piece])
        assert decoder.pending < longest
    before = len(events)
    events += decoder.feed(b"".join(tail))
    assert [event for event in events[before:] if event == FROM_DAQ[1][1]][-2:] == [FROM_DAQ[1][1]] * 2
    counted = sum(event.count if isinstance(event, Skipped) else len(encode(event)) for event in events)
    assert counted + decoder.pending == len(stream) + 16 * len(tail)


COUNTS = st.integers(-32768, 32767)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.sampled_from(list(Kind)), st.integers(0, 65535), st.integers(0, 65535), st.data())
def test_every_reading_survives_the_wire(kind: Kind, counter: int, status: int, data: st.DataObject) -> None:
    row = st.tuples(*[COUNTS] * kind.axes)
    reading = Reading(kind, counter, Status(status), data.draw(st.tuples(*[row] * kind.channels)))
    assert events_of(Decoder(), encode(reading)) == [reading]
