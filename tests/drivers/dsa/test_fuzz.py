"""Whatever comes: no exception, bounded memory, every intact frame found again.

    PYTHONPATH=.:drivers python tests/drivers/dsa/test_fuzz.py 100000000

feeds that many bytes, half of them random, half a valid stream with faults, and prints what came of it."""

import random
import sys
import time
import tracemalloc
from dataclasses import dataclass, field

import numpy as np
import pytest

from deformscope_drivers.dsa.messages import FRAME_RLE, Reading
from deformscope_drivers.dsa.protocol import SDH_CELLS, Decoder, encode
from deformscope_drivers.framing import Skipped

LONGEST = 6 + 5 + 2 * SDH_CELLS + 2


@dataclass
class Outcome:
    """What came of a stream. intact, found: frames sent undamaged, and those of them that came out

    damaged, believed: frames sent with damage, and events that nobody sent"""

    bytes: int = 0
    intact: int = 0
    found: int = 0
    damaged: int = 0
    believed: int = 0
    skipped_bytes: int = 0
    longest_pending: int = 0
    reasons: dict[str, int] = field(default_factory=dict)


def feed(decoder: Decoder, data: bytes, outcome: Outcome) -> list:
    outcome.bytes += len(data)
    good = []
    for event in decoder.feed(data):
        if isinstance(event, Skipped):
            outcome.skipped_bytes += event.count
            outcome.reasons[event.reason] = outcome.reasons.get(event.reason, 0) + 1
        else:
            good.append(event)
    outcome.longest_pending = max(outcome.longest_pending, decoder.pending)
    return good


def noise(byte_count: int, seed: int) -> Outcome:
    """Random bytes, every eighth stretch full of preambles and packet heads."""
    source, outcome, decoder = random.Random(seed), Outcome(), Decoder()
    while outcome.bytes < byte_count:
        data = source.randbytes(4096)
        if source.random() < 1 / 8:
            data = b"".join(head(source) + source.randbytes(source.randrange(60)) for _ in range(100))
        outcome.believed += len(feed(decoder, data, outcome))
    return outcome


def head(source: random.Random) -> bytes:
    return b"\xaa\xaa\xaa" + bytes([source.randrange(24), source.randrange(256), source.randrange(4)])


def faulty_stream(byte_count: int, seed: int) -> Outcome:
    """Frames, half of them damaged, in pieces of any size. Each intact one has its own time and must come out."""
    source, outcome, decoder = random.Random(seed), Outcome(), Decoder()
    awaited: dict[int, Reading] = {}
    number = 0
    while outcome.bytes < byte_count:
        batch = b""
        for _ in range(100):
            number += 1
            reading = frame(source, number)
            if source.random() < 0.5:
                batch += damaged(encode(reading), source)
                outcome.damaged += 1
            else:
                batch += encode(reading)
                awaited[number] = reading
                outcome.intact += 1
        while batch:
            size = source.randrange(1, 3000)
            count(feed(decoder, batch[:size], outcome), awaited, outcome)
            batch = batch[size:]
        # enough of nothing for anything that a damaged length promised
        count(feed(decoder, bytes(LONGEST), outcome), awaited, outcome)
        awaited.clear()
    return outcome


def frame(source: random.Random, number: int) -> Reading:
    texels = np.zeros(SDH_CELLS, np.uint16)
    for _ in range(source.randrange(6)):
        at = source.randrange(SDH_CELLS)
        texels[at : at + source.randrange(1, 30)] = source.randrange(4096)
    return Reading(number, source.choice([0, FRAME_RLE, FRAME_RLE]), texels)


def damaged(packet: bytes, source: random.Random) -> bytes:
    """One fault: a flipped bit, other bytes, the end missing, bytes missing, or bytes too many."""
    at, some = source.randrange(1, len(packet)), source.randrange(1, 5)
    match source.randrange(5):
        case 0:
            spoiled = packet[:at] + bytes([packet[at] ^ 1 << source.randrange(8)]) + packet[at + 1 :]
        case 1:
            spoiled = packet[:at] + source.randbytes(some) + packet[at + some :]
        case 2:
            spoiled = packet[:at]
        case 3:
            spoiled = packet[:at] + packet[at + some :]
        case _:
            spoiled = packet[:at] + source.randbytes(some) + packet[at:]
    return spoiled if packet not in spoiled else damaged(packet, source)


def count(good: list, awaited: dict[int, Reading], outcome: Outcome) -> None:
    for event in good:
        if isinstance(event, Reading) and awaited.get(event.timestamp_ms) == event:
            del awaited[event.timestamp_ms]
            outcome.found += 1
        else:
            outcome.believed += 1


def assert_sound(outcome: Outcome) -> None:
    """Nothing beyond what a checksum of 16 bits lets pass, and every intact frame."""
    chance = outcome.damaged / 65_536
    assert outcome.believed <= chance + 3 * chance**0.5 + 1
    # a damaged frame that is believed may have the next one in it
    assert outcome.intact - outcome.found <= outcome.believed
    assert outcome.longest_pending < LONGEST


@pytest.mark.parametrize("seed", [1, 2])
def test_noise(seed: int) -> None:
    outcome = noise(1_000_000, seed)
    assert outcome.believed == 0
    assert outcome.longest_pending < LONGEST
    assert 0 <= outcome.bytes - outcome.skipped_bytes < LONGEST


@pytest.mark.parametrize("seed", [1, 2])
def test_a_stream_with_faults(seed: int) -> None:
    outcome = faulty_stream(1_000_000, seed)
    assert outcome.intact > 1000
    assert outcome.damaged > 1000
    assert_sound(outcome)


@pytest.mark.slow
def test_a_hundred_million_bytes() -> None:
    quiet, faulty = noise(50_000_000, 3), faulty_stream(50_000_000, 3)
    assert quiet.believed <= 1
    assert quiet.longest_pending < LONGEST
    assert_sound(faulty)


def main() -> None:
    half = int(sys.argv[1]) // 2
    for kind in (noise, faulty_stream):
        before = time.perf_counter()
        outcome = kind(half, 0)
        took_s = time.perf_counter() - before
        tracemalloc.start()
        kind(half // 100, 0)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        print(f"{kind.__name__}: {took_s:.0f} s, at most {peak / 1e3:.0f} kB in a hundredth of it")
        print(f"  {outcome}", flush=True)


if __name__ == "__main__":
    main()
