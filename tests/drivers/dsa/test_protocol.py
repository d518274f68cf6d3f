"""The tactile controller's wire format: known bytes both ways, however they come, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope_drivers.dsa.messages import Ack
from deformscope_drivers.dsa.protocol import SDH_CELLS, CommandDecoder, Decoder, Faulty, encode, stop, stream
from deformscope_drivers.framing import Skipped, crc16
from tests.drivers.dsa.packets import ACK, ANSWERS, COMMANDS, FRAME, STOP, checked, checksum, hexed, reading

BOTH_WAYS = [(CommandDecoder, COMMANDS), (Decoder, ANSWERS)]
CASES = [(kind, message, data) for kind, table in BOTH_WAYS for message, data in table]
JUNK = b"\x1b[5n\xaa\xaa\x00\xff"


def fed(decoder, data: bytes, *, size: int | None = None) -> list:
    size = size or len(data) or 1
    events = [event for at in range(0, len(data), size) for event in decoder.feed(data[at : at + size])]
    return [*events, *decoder.finish()]


def good(events: list) -> list:
    return [event for event in events if not isinstance(event, Skipped)]


def skipped(events: list) -> int:
    return sum(event.count for event in events if isinstance(event, Skipped))


@pytest.mark.parametrize(("kind", "message", "data"), CASES)
def test_each_known_packet_both_ways(kind, message, data) -> None:
    assert encode(message) == data
    assert fed(kind(), data) == [message]
    assert fed(kind(), data, size=1) == [message]


@pytest.mark.parametrize(("kind", "table"), BOTH_WAYS)
@pytest.mark.parametrize("size", [1, 2, 7, 64, None])
def test_packets_that_come_as_one(kind, table, size) -> None:
    messages = [message for message, _ in table]
    assert fed(kind(), b"".join(data for _, data in table), size=size) == messages


@pytest.mark.parametrize(("kind", "table"), BOTH_WAYS)
@pytest.mark.parametrize("size", [1, 5, None])
def test_junk_before_between_and_after(kind, table, size) -> None:
    stream = JUNK + b"".join(data + JUNK for _, data in table)
    events = fed(kind(), stream, size=size)
    assert good(events) == [message for message, _ in table]
    assert skipped(events) == len(JUNK) * (len(table) + 1)


def test_the_preamble_may_follow_more_of_the_same_byte() -> None:
    assert good(fed(Decoder(), b"\xaa" * 5 + ACK)) == [Ack(3)]


def test_a_packet_in_the_ruins_of_another() -> None:
    cut = FRAME[:12]
    events = fed(Decoder(), cut + FRAME + ACK)
    assert good(events) == [reading(1000, 1, *[0] * 20, 5, 5, 4095), Ack(3)]
    assert events[0] == Skipped(12, "checksum")


def test_commands_by_name() -> None:
    assert encode(stop()) == STOP
    assert encode(stream()) == hexed("aa aa aa 03 03 00 81 1e 00 2c 76")
    assert encode(stream(rle=False)) == hexed("aa aa aa 03 03 00 80 1e 00 8e 1c")


def raw_frame(*words: int, flags: int = 0) -> bytes:
    body = (1000).to_bytes(4, "little") + bytes([flags]) + b"".join(word.to_bytes(2, "little") for word in words)
    return checked((b"\x00" + len(body).to_bytes(2, "little") + body).hex())


@pytest.mark.parametrize(
    ("data", "cells", "reason"),
    [
        (FRAME[:-1] + b"\xe6", None, "checksum"),
        (checked("03 03 00 00 00 00"), None, "length"),  # a host's command, come back
        (checked("04 02 00 00 00"), None, "id"),
        (hexed("aa aa aa 02 00 00"), None, "length"),
        (checked("02 02 00 00 00"), None, "length"),  # success, without what was asked for
        (checked("00 05 00 e8 03 00 00 00"), None, "length"),  # no texels
        (checked("00 08 00 e8 03 00 00 00 01 00 02"), None, "length"),  # half a texel
        (raw_frame(*[0] * (SDH_CELLS + 1)), None, "length"),
        (raw_frame(1, 2, 0x1003), None, "texel range"),
        (raw_frame(1, 2), 3, "texel count"),
        (raw_frame(1, 2, 3, 4), 3, "length"),
        (raw_frame(0x2001, flags=1), 3, "texel count"),
        (raw_frame(0x4001, flags=1), 3, "texel count"),
        (raw_frame(*[0xF000] * 40, flags=1), None, "texel count"),
        (raw_frame(0x0005, flags=1), None, "texel count"),  # a run of none
    ],
)
def test_refused(data: bytes, cells: int | None, reason: str) -> None:
    events = fed(Decoder(cells), data + ACK)
    assert good(events) == [Ack(3)]
    assert events[0].reason == reason
    assert skipped(events) == len(data)


def test_frames_as_long_as_they_can_be() -> None:
    words = [4095, 0] * (SDH_CELLS // 2)
    for cells in (None, SDH_CELLS):
        assert fed(Decoder(cells), raw_frame(*words)) == [reading(1000, 0, *words)]
        assert len(raw_frame(*words)) == 985


def test_a_run_of_none_gives_none() -> None:
    assert fed(Decoder(3), raw_frame(0x0005, 0x2001, 0x1007, flags=1)) == [reading(1000, 1, 1, 1, 7)]


def test_flags_that_are_not_public_are_handed_on() -> None:
    assert fed(Decoder(), raw_frame(9, flags=0x80)) == [reading(1000, 0x80, 9)]


def test_more_cells_than_the_sdh_has_can_be_reported() -> None:
    words = list(range(1000))
    assert fed(Decoder(1000), raw_frame(*words)) == [reading(1000, 0, *words)]


def test_texels_are_nobodys_to_change() -> None:
    (found,) = fed(Decoder(), FRAME)
    assert found.texels.dtype == np.uint16
    with pytest.raises(ValueError, match="read-only"):
        found.texels[0] = 1


def test_what_waits_is_bounded() -> None:
    decoder = Decoder()
    longest = raw_frame(*[1] * SDH_CELLS)
    for _ in range(50):
        list(decoder.feed(longest[:-1]))
        assert decoder.pending < 985


def test_a_controller_answers_what_it_cannot_use() -> None:
    damaged = STOP[:-1] + b"\x6b"
    unknown, short, long = (checked("ab 01 00 00"), checked("03 01 00 01"), checked("0b 02 00 00 00"))
    assert fed(CommandDecoder(), damaged + unknown + short + long + STOP) == [
        Faulty(3, 11),
        Faulty(0xAB, 13),
        Faulty(3, 12),
        Faulty(0x0B, 14),
        stop(),
    ]


TEXELS = st.lists(st.integers(0, 4095) | st.just(0), min_size=1, max_size=120) | st.lists(
    st.sampled_from([0, 0, 0, 7]), min_size=1, max_size=120
)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(TEXELS, st.integers(0, 2**32 - 1))
def test_any_texels_both_codings(texels: list[int], timestamp_ms: int) -> None:
    raw, rle = (reading(timestamp_ms, flags, *texels) for flags in (0, 1))
    assert fed(Decoder(len(texels)), encode(raw) + encode(rle)) == [raw, rle]
    assert len(encode(rle)) <= len(encode(raw))


PIECES = st.lists(
    st.sampled_from([data for _, data in ANSWERS])
    | st.binary(max_size=12)
    | st.just(b"\xaa\xaa\xaa")
    | st.integers(1, len(FRAME)).map(lambda length: FRAME[:length]),
    max_size=10,
)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(PIECES, st.lists(st.integers(1, 9), min_size=1, max_size=5))
def test_events_do_not_depend_on_how_the_stream_is_cut(pieces: list[bytes], cuts: list[int]) -> None:
    data = b"".join(pieces)
    whole = fed(Decoder(), data)
    decoder, events, at, turn = Decoder(), [], 0, 0
    while at < len(data):
        events += decoder.feed(data[at : at + cuts[turn % len(cuts)]])
        at, turn = at + cuts[turn % len(cuts)], turn + 1
    events += decoder.finish()
    assert good(events) == good(whole)
    assert skipped(events) == skipped(whole)
    assert skipped(whole) + sum(len(encode(event)) for event in good(whole)) == len(data)


@pytest.mark.parametrize("text", [b"", b"1", b"123456789", bytes(5)])
def test_the_tests_own_checksum_is_the_drivers(text: bytes) -> None:
    assert checksum(text) == crc16(text)
    assert checksum(b"123456789") == 0x6EB4
