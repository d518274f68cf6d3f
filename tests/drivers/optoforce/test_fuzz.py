"""Anything may come off a wire: nothing escapes the decoder, it keeps little, and it always finds back."""

import random
import resource
import time
from collections import Counter
from pathlib import Path

import pytest

from deformscope_drivers.optoforce.protocol import Decoder, Reading, Skipped, encode
from tests.drivers.optoforce.packets import FROM_DAQ

LONGEST = 34
STREAM = Path(__file__).with_name("capture_1000.bin").read_bytes()[7:]
GOOD = [STREAM[at : at + 16] for at in range(0, len(STREAM), 16)]
OTHERS = [packet for packet in (bytes.fromhex(text) for text, _ in FROM_DAQ) if packet not in GOOD]


def piece(luck: random.Random) -> tuple[bytes, int]:
    """Something that may come off a wire, and how many good readings of the recording it holds."""
    fate = luck.random()
    if fate < 0.4:
        many = luck.randint(1, 4)
        first = luck.randrange(len(GOOD) - many)
        return STREAM[16 * first : 16 * (first + many)], many
    if fate < 0.6:
        return luck.randbytes(luck.randint(1, 64)), 0
    packet = luck.choice(OTHERS)
    if fate < 0.7:
        return packet[: luck.randint(1, len(packet))], 0
    if fate < 0.8:
        return packet[:4] + luck.randbytes(luck.randint(0, 40)), 0
    if fate < 0.9:
        at = luck.randrange(len(packet))
        return packet[:at] + bytes([packet[at] ^ luck.randint(1, 255)]) + packet[at + 1 :], 0
    return bytes([luck.choice((0x00, 0x07, 0x08, 0xAA, 0xFF))]) * luck.randint(1, 40), 0


@pytest.mark.parametrize("total_bytes", [10**6, pytest.param(10**8, marks=pytest.mark.slow)])
def test_nothing_escapes_and_the_way_is_always_found_back(total_bytes: int, capsys) -> None:
    luck = random.Random(total_bytes)
    decoder, seen, started = Decoder(), Counter[str](), time.process_time()
    decoding_s, fed, counted, good, heard = 0.0, 0, 0, 0, 0
    recorded = set(Decoder().feed(STREAM))
    memory_kib = 0
    while fed < total_bytes:
        pieces = [piece(luck) for _ in range(200)]
        block = b"".join(data for data, _ in pieces) + GOOD[0] * 3 + GOOD[1]
        before = time.process_time()
        at, events = 0, []
        while at < len(block):
            size = luck.randint(1, 4000)
            events += decoder.feed(block[at : at + size])
            assert decoder.pending < LONGEST
            at += size
        decoding_s += time.process_time() - before
        fed += len(block)
        good += sum(many for _, many in pieces) + 4
        assert next(event for event in reversed(events) if isinstance(event, Reading)) in recorded
        for event in events:
            seen[event.reason if isinstance(event, Skipped) else type(event).__name__] += 1
            counted += event.count if isinstance(event, Skipped) else len(encode(event))
            heard += isinstance(event, Reading) and event in recorded
        memory_kib = memory_kib or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    grown_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory_kib
    swallowed = good - heard

    with capsys.disabled():
        print(
            f"\n{fed} bytes in {time.process_time() - started:.0f} s of CPU, {decoding_s:.0f} s of them decoding; "
            f"{dict(seen)}; good readings {good}, of which {swallowed} were taken for the rest of a torn packet "
            f"whose sum was right by chance; memory grew by {grown_kib} KiB"
        )
    assert counted + decoder.pending == fed
    assert 0 <= swallowed < 2e-3 * good  # the sum of a torn packet is right once in about a thousand
    assert grown_kib < 8192
