"""The SDH hand's bytes, against lines and messages typed from the protocol reference (its 1b), both ways."""

import itertools
import math
import random
from collections import Counter

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deformscope_drivers.framing import crc16
from deformscope_drivers.sdh.codes import CODES, ERRORS, error_name, release
from deformscope_drivers.sdh.protocol import (
    Command,
    CommandDecoder,
    DebugLine,
    Decoder,
    ErrorReply,
    Event,
    Reading,
    Received,
    Skipped,
    TextReply,
    ValueReply,
    encode,
    encode_reply,
)

POSE = (0.0, -10.0, 20.0, -10.0, 20.0, -10.0, 20.0)
POSE_F32 = "00000000 000020c1 0000a041 000020c1 0000a041 000020c1 0000a041"
POS_REPLY = "83 20 07 00 cdcccc3d 333323c1 6666a241 000020c1 0000a041 000020c1 0000a041 6d 34"
POS_REPLY_CAN = "83 1e 07 00 cdcccc3d 333323c1 6666a241 000020c1 0000a041 000020c1 0000a041"
POS_VALUES = (
    0.10000000149011612,
    -10.199999809265137,
    20.299999237060547,
    -10.0,
    20.0,
    -10.0,
    20.0,
)  # 0.1, -10.2, 20.3 as 32-bit floats

TEXT_COMMANDS: list[tuple[Command, bytes]] = [
    (Command("pos"), b"pos\r\n"),
    (Command("state", axis=3), b"state(3)\r\n"),
    (Command("p", POSE), b"p=0.000000,-10.000000,20.000000,-10.000000,20.000000,-10.000000,20.000000\r\n"),
    (Command("p", (1.5,), 3), b"p(3)=       1.500\r\n"),
    (Command("v", (-12.25,), 0), b"v(0)=     -12.250\r\n"),
    (Command("m"), b"m\r\n"),
    (Command("stop"), b"stop\r\n"),
    (Command("con", (2.0,)), b"con=2\r\n"),
    (Command("vp", (0.0,)), b"vp=0\r\n"),
    (Command("selgrip", (1.0,)), b"selgrip=1\r\n"),
    (Command("grip", (0.1, 40.0)), b"grip=0.100000,40.000000\r\n"),
    (Command("pid", (0.5, 0.25, 0.125), 2), b"pid(2)=0.500000,0.250000,0.125000\r\n"),
    (Command("get_duration"), b"get_duration\r\n"),
]

# event; the hand's line; whether it is also what our double would send (the traces are Schunk's own)
TEXT_REPLIES: list[tuple[Event, bytes, bool]] = [
    (ValueReply("m", (4.51,)), b"M=4.51\r\n", True),
    (ValueReply("get_duration", (4.51,)), b"GET_DURATION=4.51\r\n", True),
    (ValueReply("selgrip", (0.0, 1.0)), b"SELGRIP=0.0,1\r\n", True),
    (ValueReply("grip", (0.42, 0.1)), b"GRIP=0.42,0.1\r\n", True),
    (ValueReply("power", (0.0,) * 7), b"POWER=0,0,0,0,0,0,0\r\n", True),
    (ValueReply("m"), b"m\r\n", True),  # firmware before 0.0.3.1
    (ValueReply("m", (4.51,)), b"M=4.51s\n", False),
    (ValueReply("p", (1.5,), 3), b"P(3)=1.50\r\n", True),
    (ErrorReply(24), b"E24\r\n", True),
    (
        DebugLine("max distance=45.06, T=4.51s, num_points: 451"),
        b"@max distance=45.06, T=4.51s, num_points: 451\r\n",
        True,
    ),
    (TextReply("ver", "0.0.2.10"), b"VER=0.0.2.10\r\n", True),
    (Reading("pos", POSE), b"POS=0.00,-10.00,20.00,-10.00,20.00,-10.00,20.00\r\n", True),
    (Reading("pos", (-0.25,), 3), b"POS(3)=-0.25\n", False),
    (Reading("state", (0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 7.0)), b"STATE=0,1,2,4,5,6,7\r\n", True),
    (
        Reading("temp", (30.0, 31.0, 32.0, 33.0, 34.0, 35.0, 36.0, 45.5, 40.25)),
        b"TEMP=30.00,31.00,32.00,33.00,34.00,35.00,36.00,45.50,40.25\r\n",
        True,
    ),
]

BINARY_REQUESTS: list[tuple[Command, str, str]] = [
    (Command("pos"), "83 03 00 dc 1e", "83 01 00"),
    (Command("state"), "84 03 00 a3 28", "84 01 00"),
    (Command("vel"), "81 03 00 98 cb", "81 01 00"),
    (Command("p", POSE), f"85 1f 07 {POSE_F32} f0 62", f"85 1d 07 {POSE_F32}"),
]

STREAM: list[tuple[Event, bytes]] = [
    *((event, line) for event, line, _ in TEXT_REPLIES),
    (Reading("pos", POS_VALUES), bytes.fromhex(POS_REPLY)),
    (Reading("pos", POS_VALUES), bytes.fromhex(POS_REPLY_CAN)),
]

JUNK = [b"\x00\xff\xfe", b"zzz", b"\x83", b"\x83\x20\x07", b"POS=", b"\r\n", b"E", b"TEXT", b"\x85\x1f", b"x" * 400]


def good(events: list[Event | Skipped]) -> list[Event]:
    return [event for event in events if not isinstance(event, Skipped)]


def skipped_bytes(events: list[Event | Skipped]) -> int:
    return sum(event.count for event in events if isinstance(event, Skipped))


def decode(stream: bytes, sizes: list[int] | None = None) -> list[Event | Skipped]:
    decoder, events, at = Decoder(), [], 0
    for size in itertools.cycle(sizes or [max(len(stream), 1)]):
        if at >= len(stream):
            break
        events += decoder.feed(stream[at : at + size])
        assert decoder.pending <= 264
        at += size
    return [*events, *decoder.finish()]


@pytest.mark.parametrize(("command", "line"), TEXT_COMMANDS)
def test_text_commands(command: Command, line: bytes) -> None:
    assert encode(command) == line
    assert list(CommandDecoder().feed(line)) == [Received(command)]


@pytest.mark.parametrize(("event", "line", "ours"), TEXT_REPLIES)
def test_text_replies(event: Event, line: bytes, ours: bool) -> None:
    assert list(Decoder().feed(line)) == [event]
    if ours:
        assert encode_reply(event) == line


@pytest.mark.parametrize(("command", "serial", "can"), BINARY_REQUESTS)
def test_binary_requests(command: Command, serial: str, can: str) -> None:
    assert encode(command, binary_checksum=True) == bytes.fromhex(serial)
    assert encode(command, binary_checksum=False) == bytes.fromhex(can)
    for message, checksummed in ((serial, True), (can, False)):
        data = bytes.fromhex(message)
        assert list(CommandDecoder(checksummed=checksummed).feed(data)) == [Received(command, binary=True)]
        assert not [e for e in CommandDecoder(checksummed=not checksummed).feed(data) if isinstance(e, Received)]


def test_binary_replies() -> None:
    reading = Reading("pos", POS_VALUES)
    for message, checksummed in ((POS_REPLY, True), (POS_REPLY_CAN, False)):
        data = bytes.fromhex(message)
        assert encode_reply(Reading("pos", (0.1, -10.2, 20.3, *POSE[3:])), binary_checksum=checksummed) == data
        assert list(Decoder(checksummed=checksummed).feed(data)) == [reading]
        assert list(Decoder().feed(data)) == [reading]
        assert good(list(Decoder(checksummed=not checksummed).feed(data))) == []


def test_a_binary_refusal_names_its_command() -> None:
    # P refused with 24: status in the fourth byte; the values mean nothing then.
    message = bytes.fromhex(f"85 1e 07 18 {'00' * 28}")
    assert list(Decoder().feed(message)) == [ErrorReply(24, "p")]


def test_command_codes_and_errors_of_the_reference() -> None:
    assert (CODES["v"], CODES["pos"], CODES["numaxis"], CODES["grip"]) == (128, 131, 152, 160)
    assert (CODES["power"], CODES["change_channel"], len(CODES)) == (164, 171, 44)
    assert sorted(CODES.values()) == list(range(128, 172))
    assert [error_name(code) for code in (10, 13, 24, 28, 33, 36)] == [
        "CHECKSUM_ERROR",
        "CMD_UNKNOWN",
        "RANGE_ERROR",
        "AXIS_DISABLED",
        "CRC_ERROR",
        "UNKNOWN_ERROR",
    ]
    assert len(ERRORS) == 37
    assert len({name for name, _ in ERRORS}) == 37


def test_releases_compare_by_number() -> None:
    assert release("0.0.2.10") > release("0.0.2.9")
    assert release(" 0.0.3.2-b ") == (0, 0, 3, 2)
    assert release("hello") == ()


def test_whole_one_byte_at_a_time_and_merged() -> None:
    stream = b"".join(data for _, data in STREAM)
    expected = [event for event, _ in STREAM]
    decoder = Decoder()
    assert list(decoder.feed(stream)) == expected
    assert [event for byte in stream for event in decoder.feed(bytes([byte]))] == expected
    assert decoder.pending == 0


@pytest.mark.parametrize("junk", JUNK)
@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_junk_before_between_and_after(junk: bytes, size: int) -> None:
    stream = junk + b"".join(data + junk for _, data in STREAM)
    decoded = decode(stream, [size])
    assert good(decoded) == [event for event, _ in STREAM]
    assert skipped_bytes(decoded) > 0


def test_a_stray_debug_mark_costs_the_line_behind_it() -> None:
    assert decode(b"@M=4.51\r\nM=4.51\r\n") == [DebugLine("M=4.51"), ValueReply("m", (4.51,))]


def test_a_damaged_line_is_not_a_shorter_one() -> None:
    for line in (b"TEMP=1,2,3,4,5,6,7\r\n", b"xEMP=1,2,3\r\n", b"TVAV=1,2\r\n", b"SELGRI\xd0=0.0,1\r\n"):
        for size in (1, 3, 100):
            assert good(decode(line, [size])) == [], line


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"POS=1,2,3\r\n", "count"),
        (b"TEMP=1,2,3,4,5,6,7\r\n", "count"),
        (b"POS=0,0,0,0,0,0,x\r\n", "number"),
        (b"POS=0,0,0,0,0,0,1e999\r\n", "number"),
        (b"POS(7)=1\r\n", "axis"),
        (b"VER(1)=0.0.2.9\r\n", "axis"),
        (b"E37\r\n", "status"),
        (b"POS=\r\n", "number"),
        (b"POS=1,\xb2\r\n", "line"),
        (b"VER=" + b"0" * 300 + b"\r\n", "length"),
        (bytes.fromhex(POS_REPLY[:-1] + "5"), "checksum"),
        (bytes.fromhex("83 1e 07 30" + "00" * 28), "status"),
        (bytes.fromhex("83 1e 03 00" + "00" * 28), "count"),
        (bytes.fromhex("83 1e 07 00 0000c07f" + "00" * 24), "value"),
        (bytes.fromhex("83 1b 07 00" + "00" * 28), "length"),
    ],
)
def test_what_is_refused_and_why(line: bytes, reason: str) -> None:
    decoded = decode(line)
    assert reason in [event.reason for event in decoded if isinstance(event, Skipped)]
    assert good(decoded) == []
    assert skipped_bytes(decoded) == len(line)


@pytest.mark.parametrize(
    "command",
    [
        Command("jump"),
        Command("p", (math.nan,) * 7),
        Command("p", (math.inf,), 2),
        Command("p", (1.0,), 7),
        Command("vp", (0.5,)),
    ],
)
def test_commands_without_words(command: Command) -> None:
    with pytest.raises(ValueError):
        encode(command)


@pytest.mark.parametrize("command", [Command("p", (1.0,), 2), Command("p", (1.0, 2.0)), Command("v", (math.nan,) * 7)])
def test_commands_without_binary_bytes(command: Command) -> None:
    with pytest.raises(ValueError):
        encode(command, binary_checksum=True)


PIECES = st.lists(
    st.one_of(st.binary(max_size=12), st.sampled_from([data for _, data in STREAM]), st.sampled_from(JUNK)), max_size=10
)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(PIECES, st.lists(st.integers(1, 40), min_size=1, max_size=5))
@example([b"", bytes.fromhex(POS_REPLY)[:20], bytes.fromhex(POS_REPLY)], [3])
def test_events_do_not_depend_on_how_the_stream_is_cut(pieces: list[bytes], sizes: list[int]) -> None:
    stream = b"".join(pieces)
    whole, cut = decode(stream), decode(stream, sizes)
    assert good(cut) == good(whole)
    assert skipped_bytes(cut) == skipped_bytes(whole) <= len(stream)
    reasons = [[e.reason for e in events if isinstance(e, Skipped) and e.reason != "noise"] for events in (whole, cut)]
    assert reasons[0] == reasons[1]


def flips(data: bytes, *bits: int) -> bytes:
    spoiled = bytearray(data)
    for bit in bits:
        spoiled[bit // 8] ^= 1 << bit % 8
    return bytes(spoiled)


def test_every_single_flip_of_a_checksummed_reply_is_refused() -> None:
    reply = bytes.fromhex(POS_REPLY)
    for bit in range(8 * len(reply)):
        for decoder in (Decoder(checksummed=True), Decoder()):
            events = [*decoder.feed(flips(reply, bit)), *decoder.finish()]
            assert not [event for event in good(events) if isinstance(event, Reading)], bit


def test_double_flips_of_a_checksummed_reply_are_counted() -> None:
    """What the checksum lets pass by its construction, and what is left once the reply must be to what was asked,
    with an angle that an axis can have."""
    reply = bytes.fromhex(POS_REPLY)
    passed: Counter[str] = Counter()
    # The checksum is linear: of two flips, the one's effect on it must be the other's.
    effects: dict[int, list[int]] = {}
    right = crc16(reply[:-2]) ^ int.from_bytes(reply[-2:], "little")
    assert right == 0
    for bit in range(8 * len(reply)):
        spoiled = flips(reply, bit)
        effects.setdefault(crc16(spoiled[:-2]) ^ int.from_bytes(spoiled[-2:], "little"), []).append(bit)
    assert 0 not in effects
    for bits in effects.values():
        for first, second in itertools.combinations(bits, 2):
            passed["checksum"] += 1
            events = good(list(Decoder(checksummed=True).feed(flips(reply, first, second))))
            if not events:
                continue
            passed["decoder"] += 1
            if isinstance(events[0], Reading) and events[0].quantity == "pos":
                passed["asked"] += 1
                if all(-90.5 <= value <= 90.5 for value in events[0].values):
                    passed["plausible"] += 1
                    worst = max(abs(a - b) for a, b in zip(events[0].values, POS_VALUES, strict=True))
                    passed["plausible and wrong by more than 0.5 deg"] += worst > 0.5
    assert math.comb(8 * len(reply), 2) == 36856
    assert passed == DOUBLE_FLIPS


DOUBLE_FLIPS = {
    "checksum": 455,
    "decoder": 376,
    "asked": 334,
    "plausible": 244,
    "plausible and wrong by more than 0.5 deg": 103,
}


def test_what_flips_do_to_a_reply_without_checksum() -> None:
    """On CAN the bus has its own checksum; the message has none. So what is counted is what its form gives away."""
    reply = bytes.fromhex(POS_REPLY_CAN)
    assert sum(not good(decode(flips(reply, bit))) for bit in range(8 * len(reply))) == SINGLE_FLIPS_REFUSED_ON_CAN


SINGLE_FLIPS_REFUSED_ON_CAN = 20


def fuzz(size: int, seed: int) -> tuple[int, int]:
    """Noise with good messages and pieces of them in it; bytes skipped, messages put in that came out."""
    source = random.Random(seed)
    decoder = Decoder(checksummed=True)
    fed = skipped = found = put = longest = 0
    marker = Reading("temp", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0))
    line = b"\r\n" + encode_reply(marker)
    while fed < size:
        data = source.randbytes(source.randint(0, 2000))
        for _ in range(source.randint(0, 3)):
            _, message = source.choice(STREAM)
            data += message[source.randint(0, 5) : source.randint(1, len(message))]
        data += line
        put += 1
        fed += len(data)
        for event in decoder.feed(data):
            if isinstance(event, Skipped):
                skipped += event.count
            else:
                found += event == marker
        longest = max(longest, decoder.pending)
    assert found == put
    assert longest <= 264
    return skipped, found


def test_fuzz_a_little() -> None:
    skipped, found = fuzz(1_000_000, seed=5)
    assert skipped > 100_000
    assert found > 500


@pytest.mark.slow
def test_fuzz_a_hundred_million_bytes() -> None:
    skipped, found = fuzz(100_000_000, seed=6)
    assert skipped > 10_000_000
    assert found > 50_000


@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.binary(max_size=400))
def test_a_hand_survives_what_a_host_sends(data: bytes) -> None:
    decoder = CommandDecoder()
    events = [*decoder.feed(data), *decoder.finish()]
    assert sum(event.count for event in events if isinstance(event, Skipped)) <= len(data)
