"""Flipped bits: no single one passes; the pairs that do are counted exactly, and so are those that are left."""

import itertools

import numpy as np
import pytest

from deformscope_drivers.dsa.messages import Reading
from deformscope_drivers.dsa.protocol import Decoder, encode
from deformscope_drivers.framing import Skipped, crc16
from tests.cases import slow_but
from tests.drivers.dsa.flips import LEFT, Subject, count_pairs, flipped, passing_pairs, syndromes, typical
from tests.drivers.dsa.packets import ACK, ANSWERS, FRAME, STOP

SUBJECTS = {subject.name: subject for subject in typical()}
ANSWER_PACKETS = [data for _, data in ANSWERS]
FRAMES = [subject.packet for name, subject in SUBJECTS.items() if name not in ("stop", "ack")]


def test_the_subjects_are_the_worked_packets() -> None:
    assert SUBJECTS["stop"].packet == STOP
    assert SUBJECTS["ack"].packet == ACK
    assert SUBJECTS["frame of 23 texels, RLE"].packet == FRAME
    assert len(SUBJECTS["idle frame, RLE"].packet) == 79
    assert len(SUBJECTS["grasp, raw"].packet) == 985


@pytest.mark.parametrize(
    "data",
    slow_but([one for one in (*ANSWER_PACKETS, *FRAMES) if len(one) < 900], [*ANSWER_PACKETS, *FRAMES]),
    ids=lambda data: f"{data[3]:02x}, {len(data)} bytes",
)
def test_every_single_flip_is_refused(data: bytes) -> None:
    """By a decoder that knows nothing of the sensor, and finds the intact packet behind the damaged one."""
    (intact,) = Decoder().feed(data)
    for bit in range(8 * len(data)):
        decoder = Decoder()
        events = [*decoder.feed(flipped(data, (bit,)) + data), *decoder.finish()]
        assert [event for event in events if not isinstance(event, Skipped)] == [intact], f"bit {bit}"
        assert sum(event.count for event in events if isinstance(event, Skipped)) == len(data)


@pytest.mark.parametrize(
    ("name", "passing"), [("stop", 9), ("ack", 6), ("frame of 23 texels, RLE", 92), ("grasp, raw", 513_906)]
)
def test_pairs_that_the_checksum_lets_pass(name: str, passing: int) -> None:
    """The first three as the reference has them; it has about 500 000 for the last."""
    assert sum(1 for _ in passing_pairs(SUBJECTS[name].packet)) == passing


@pytest.mark.parametrize("data", [STOP, ACK, FRAME])
def test_syndromes_foretell_every_pair(data: bytes) -> None:
    """All pairs tried, against the checksum itself."""
    bits = range(24, 8 * len(data))
    passing = {
        pair
        for pair in itertools.combinations(bits, 2)
        if crc16((changed := flipped(data, pair))[3:-2]) == int.from_bytes(changed[-2:], "little")
    }
    assert passing == set(passing_pairs(data))
    assert len(syndromes(data)) == len(bits)
    assert (syndromes(data) != 0).all()


@pytest.mark.parametrize(
    ("name", "refused", "left"),
    [("stop", 7, 2), ("ack", 5, 1), ("frame of 23 texels, RLE", 73, 19), ("idle frame, RLE", 1408, 1303)],
)
def test_pairs_that_are_left(name: str, refused: int, left: int) -> None:
    count = count_pairs(SUBJECTS[name])
    assert (count.refused.total(), count.left) == (refused, left)
    assert count.refused.total() + count.left == count.pass_checksum


@pytest.mark.parametrize("name", ["stop", "ack", "frame of 23 texels, RLE"])
def test_the_count_is_that_of_all_pairs_tried(name: str) -> None:
    """Also with a flip in the preamble, and without syndromes."""
    subject = SUBJECTS[name]
    pairs = itertools.combinations(range(8 * len(subject.packet)), 2)
    assert sum(subject.verdict(pair) == LEFT for pair in pairs) == count_pairs(subject).left


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "passing", "left"), [("grasp, RLE", 98_142, 55_594), ("grasp, raw", 513_906, 289_963)]
)
def test_pairs_that_are_left_of_frames_in_a_grasp(name: str, passing: int, left: int) -> None:
    count = count_pairs(SUBJECTS[name])
    assert (count.pass_checksum, count.left) == (passing, left)


def test_what_is_left_of_an_empty_raw_frame_is_in_the_low_bits() -> None:
    """No pair with a flip in the four bits that no texel has is left, nor one that moves the clock far."""
    packet = encode(Reading(60_000, 0, np.zeros(12, np.uint16)))
    subject = Subject("twelve", packet, 12)
    left = [pair for pair in passing_pairs(packet) if subject.verdict(pair) == LEFT]
    high = {8 * at + bit for at in range(12, 11 + 24, 2) for bit in range(4, 8)}
    weeks = set(range(8 * 6 + 10, 8 * 10))
    assert left
    assert not [pair for pair in left if {*pair} & (high | weeks)]
