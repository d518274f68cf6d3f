"""Damage that the byte sum lets pass is counted exactly, and the checks behind it catch what they are said to."""

import functools
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from deformscope_drivers.optoforce.measurement import doubts
from deformscope_drivers.optoforce.protocol import Decoder, Kind, Reading, Skipped, Status, encode
from tests.drivers.optoforce import flips
from tests.drivers.optoforce.flips import DamageCount, table
from tests.drivers.optoforce.packets import FROM_DAQ

EXAMPLES = [bytes.fromhex(text) for text, _ in FROM_DAQ[1:4]]
BEHIND = EXAMPLES[0] * 3
count = functools.cache(flips.count)


@pytest.mark.parametrize("text", [text for text, _ in FROM_DAQ])
def test_every_flip_of_one_bit_is_refused(text: str) -> None:
    packet = bytes.fromhex(text)
    for place in range(8 * len(packet)):
        damaged = bytearray(packet)
        damaged[place // 8] ^= 1 << place % 8
        events = list(Decoder().feed(bytes(damaged) + BEHIND))
        assert isinstance(events[0], Skipped)
        assert [event for event in events if not isinstance(event, Skipped)] == [FROM_DAQ[1][1]] * 3


@pytest.mark.slow
def test_flips_of_two_bits_are_counted_as_brute_force_counts_them() -> None:
    packet = EXAMPLES[0]
    decoder, passed = Decoder(), 0
    for places in combinations(range(128), 2):
        damaged = bytearray(packet)
        for place in places:
            damaged[place // 8] ^= 1 << place % 8
        passed += isinstance(next(decoder.feed(bytes(damaged) + BEHIND)), Reading)
        list(decoder.finish())
    assert count(packet, None)["2 bits flipped"].passed == passed


@pytest.mark.slow
@pytest.mark.parametrize("packet", EXAMPLES)
def test_flips_of_two_bits_by_hand(packet: bytes) -> None:
    """They pass at the same place in two bytes of the body, one set and one cleared, or in one of them and the low
    byte of the sum, both alike."""
    body, low = packet[4:14], packet[15]
    expected = 0
    for bit in range(8):
        ones = sum(value >> bit & 1 for value in body)
        expected += ones * (len(body) - ones)
        expected += ones if low >> bit & 1 else len(body) - ones
    assert count(packet, None)["2 bits flipped"].passed == expected


def behind(packet: bytes) -> bytes:
    """The next readings of the same stream."""
    (reading,) = Decoder().feed(packet)
    return b"".join(encode(replace(reading, counter=reading.counter + at, status=Status(0))) for at in (1, 2, 3))


def test_changes_of_two_bytes_are_counted_as_brute_force_counts_them() -> None:
    packet = EXAMPLES[0]
    values, stream = np.arange(256), behind(packet)
    passed = 0
    for first, second in combinations(range(4, 16), 2):
        weight = np.ones(16)
        weight[14:] = -256, -1
        moved = weight[first] * (values - packet[first])[:, None] + weight[second] * (values - packet[second])[None, :]
        passed += int((moved == 0).sum()) - 1
    decoder = Decoder()
    for header_byte in (0x10, 0x1C):  # another kind's packet, that goes on in the packets behind
        for at in {*range(16)} - {3}:
            for value in {*range(256)} - {packet[at]}:
                damaged = bytearray(packet)
                damaged[3], damaged[at] = header_byte, value
                passed += isinstance(next(decoder.feed(bytes(damaged) + stream)), Reading)
                list(decoder.finish())
    assert count(packet, None)["2 bytes changed"].passed == passed


@pytest.mark.slow
def test_the_published_counts_of_a_sensor_at_rest() -> None:
    found = count(bytes.fromhex(FROM_DAQ[3][0]), 16037)
    assert found == {
        "1 bit flipped": DamageCount(128),
        "2 bits flipped": DamageCount(8128, 234, by_status=49, by_counter=67, by_load=9, unseen=109),
        "3 bits flipped": DamageCount(341376, 1023, by_status=317, by_counter=382, by_load=19, unseen=305),
        "2 bytes changed": DamageCount(7803000, 7800, by_status=2539, by_counter=2400, by_load=41, unseen=2820),
        "2 bytes swapped": DamageCount(115, 41, by_status=14, by_counter=13, by_load=0, unseen=14),
    }


@pytest.mark.slow
def test_the_checks_catch_what_touches_status_counter_and_size_and_nothing_else() -> None:
    without, within = count(EXAMPLES[0], None), count(EXAMPLES[0], 16037)
    for damage, tally in within.items():
        assert tally.passed == without[damage].passed
        assert tally.by_load == without[damage].unseen - tally.unseen
        assert (tally.by_status, tally.by_counter) == (without[damage].by_status, without[damage].by_counter)
    assert within["2 bits flipped"].by_load > 0


def test_the_command_prints_a_table(monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.setattr(flips, "count", count)
    monkeypatch.setattr("sys.argv", ["flips"])
    flips.main()
    assert "| 2 bits flipped | 8128 | 234 (2.879%) | 49 | 67 | 9 | 109 |" in capsys.readouterr().out
    path = tmp_path / "some.bin"
    path.write_bytes(b"".join(EXAMPLES))
    monkeypatch.setattr("sys.argv", ["flips", "--file", str(path), "--readings", "2"])
    flips.main()
    assert capsys.readouterr().out == table([EXAMPLES[0], EXAMPLES[2]], 16037) + "\n"
    path.write_bytes(b"nothing")
    with pytest.raises(SystemExit, match="there are none"):
        flips.main()


def reading(*counts: int, status: int = 0, kind: Kind = Kind.THREE_AXIS) -> Reading:
    return Reading(kind, 0, Status(status), (counts,))


LIMITS = [(16037.0, 16037.0, 16037.0)]


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        (reading(401, -401, 8019), ()),
        (reading(0, 0, 32074), ()),
        (reading(0, 0, 32075), ("load",)),
        (reading(-32768, 0, 0), ("load",)),
        (reading(0, 0, 0, status=0x0080), ()),
        (reading(0, 0, 0, status=0x0400), ()),
        (reading(0, 0, 0, status=0x0C00), ("status",)),
        (reading(0, 0, 0, status=0x6000), ("status",)),
        (reading(0, 0, 0, status=0x0005), ("status",)),
        (reading(0, 0, 0, status=0x0010), ("status",)),
        (reading(0, 0, 32075, status=0xFFFF), ("status", "load")),
    ],
)
def test_what_is_plausible(seen: Reading, expected: tuple[str, ...]) -> None:
    assert doubts(seen, LIMITS) == expected
    assert doubts(seen, None) == tuple(doubt for doubt in expected if doubt != "load")


def test_torque_overloads_are_plausible_where_torques_are_measured() -> None:
    assert doubts(reading(*[0] * 6, status=0x0070, kind=Kind.SIX_AXIS), None) == ()
