"""Counts the damage that OptoForce's byte sum lets pass, exactly, and what the checks behind it catch.

    python -m tests.drivers.optoforce.flips                       # one reading, as sent by a sensor at rest
    python -m tests.drivers.optoforce.flips --file capture.bin    # the mean over readings of a raw stream
    python -m tests.drivers.optoforce.flips --file capture.bin --readings 20 --nominal-counts 16037

Every damage of a kind is done to a 16-byte packet within a stream, and the damaged stream is decoded.
"""

import argparse
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import numpy.typing as npt

from deformscope_drivers.optoforce import protocol
from deformscope_drivers.optoforce.measurement import doubts

KNOWN_HEADERS = {*protocol.HEADERS.values(), protocol.CONFIG_REPLY, protocol.SERIAL_REPLY}
SIZE = 16
SUM_AT = 14
IntArray = npt.NDArray[np.int64]
Patch = dict[int, int]
"""Where a byte is replaced, and by what."""


@dataclass(frozen=True, slots=True)
class DamageCount:
    """How often one kind of damage passes the byte sum, and which check finds it first.

    possible: how many there are; passed: how many of them the decoder takes for a reading
    by_status: of these, how many show another kind of sensor, or a status that is undefined or not usable
    by_counter: a counter that does not follow the one before; by_load: more than twice the nominal load
    unseen: none of these"""

    possible: int
    passed: int = 0
    by_status: int = 0
    by_counter: int = 0
    by_load: int = 0
    unseen: int = 0


def count(packet: bytes, nominal_counts: float | None) -> dict[str, DamageCount]:
    """What each kind of damage to this packet comes to; with the nominal counts, its load is checked as well."""
    swaps = [{a: packet[b], b: packet[a]} for a, b in combinations(range(SIZE), 2) if packet[a] != packet[b]]
    return {
        "1 bit flipped": _tally(packet, _flips(packet, 1), 8 * SIZE, nominal_counts),
        "2 bits flipped": _tally(packet, _flips(packet, 2), math.comb(8 * SIZE, 2), nominal_counts),
        "3 bits flipped": _tally(packet, _flips(packet, 3), math.comb(8 * SIZE, 3), nominal_counts),
        "2 bytes changed": _tally(packet, _changes(packet), math.comb(SIZE, 2) * 255**2, nominal_counts),
        "2 bytes swapped": _tally(packet, swaps, len(swaps), nominal_counts),
    }


def _tally(packet: bytes, patches: Iterable[Patch], possible: int, nominal_counts: float | None) -> DamageCount:
    (reading,) = protocol.Decoder().feed(packet)
    assert isinstance(reading, protocol.Reading)
    behind = b"".join(
        protocol.encode(
            protocol.Reading(reading.kind, (reading.counter + later) % 0x10000, protocol.Status(0), reading.counts)
        )
        for later in (1, 2, 3)
    )
    limits = None if nominal_counts is None else [[nominal_counts] * 3]
    passed = by_status = by_counter = by_load = 0
    decoder = protocol.Decoder()
    for patch in patches:
        damaged = bytearray(packet)
        for at, value in patch.items():
            damaged[at] = value
        event = next(decoder.feed(bytes(damaged) + behind))
        decoder.finish()
        if not isinstance(event, protocol.Reading):
            continue
        passed += 1
        found = doubts(event, limits) if event.kind is reading.kind else ("kind",)
        if "kind" in found or "status" in found or not event.status.usable:
            by_status += 1
        elif event.counter != reading.counter:
            by_counter += 1
        elif "load" in found:
            by_load += 1
    return DamageCount(possible, passed, by_status, by_counter, by_load, passed - by_status - by_counter - by_load)


def _flips(packet: bytes, bits: int) -> Iterator[Patch]:
    """Every flip of that many bits that leaves the sum right, or makes a header of another; no other can pass."""
    change = _change_of_sum(packet)
    places = np.array(list(combinations(range(8 * SIZE), bits)), np.int64).reshape(-1, bits)
    in_header = (places < 8 * protocol.HEADER_SIZE).any(axis=1)
    for flip in places[in_header | (change[places].sum(axis=1) == 0)].tolist():
        patch: Patch = {}
        for place in flip:
            at, bit = divmod(place, 8)
            patch[at] = patch.get(at, packet[at]) ^ 1 << bit
        if bytes(patch.get(at, packet[at]) for at in range(protocol.HEADER_SIZE)) in KNOWN_HEADERS:
            yield patch


def _change_of_sum(packet: bytes) -> IntArray:
    """(128,) by how much each bit's flip moves the sum of the bytes from the sum that is sent."""
    change = np.zeros(8 * SIZE, np.int64)
    for at, value in enumerate(packet):
        weight = {SUM_AT: -256, SUM_AT + 1: -1}.get(at, 1)
        for bit in range(8):
            change[8 * at + bit] = weight * (1 << bit) * (-1 if value >> bit & 1 else 1)
    return change


def _changes(packet: bytes) -> Iterator[Patch]:
    """Every change of two bytes that leaves the sum right, or makes a header of another; no other can pass."""
    total = int.from_bytes(packet[SUM_AT:], "big")
    for first, second in combinations(range(protocol.HEADER_SIZE, SUM_AT), 2):
        both = packet[first] + packet[second]
        for value in range(max(0, both - 255), min(255, both) + 1):
            if value != packet[first]:
                yield {first: value, second: both - value}
    for at in range(protocol.HEADER_SIZE, SUM_AT):
        for value in set(range(256)) - {packet[at]}:
            sent = (total + value - packet[at]).to_bytes(2, "big")
            changed = {SUM_AT + i: byte for i, byte in enumerate(sent) if byte != packet[SUM_AT + i]}
            if len(changed) == 1:
                yield {at: value, **changed}
    for header in KNOWN_HEADERS:
        patch = {at: value for at, value in enumerate(header) if value != packet[at]}
        if len(patch) == 2:
            yield patch
        if len(patch) == 1:
            for at in set(range(SIZE)) - set(patch):
                yield from ({**patch, at: value} for value in range(256) if value != packet[at])


def table(packets: list[bytes], nominal_counts: float | None) -> str:
    """The counts as Markdown, the mean over several packets."""
    tallies = [count(packet, nominal_counts) for packet in packets]
    lines = [
        "| damage to a packet | cases | pass the sum | by status or kind | by counter | by load | unseen |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for damage in tallies[0]:
        of = [tally[damage] for tally in tallies]
        columns = [
            np.mean([getattr(tally, name) for tally in of])
            for name in ("possible", "passed", "by_status", "by_counter", "by_load", "unseen")
        ]
        cases, passed, *rest = columns
        shown = f"{passed:.10g} ({passed / cases:.3%})" if cases else "0"
        lines.append(f"| {damage} | {cases:.10g} | {shown} | " + " | ".join(f"{value:.10g}" for value in rest) + " |")
    return "\n".join(lines)


def readings_of(path: Path, many: int) -> list[bytes]:
    """The packets of that many 3-axis readings, spread over a raw stream."""
    found = [event for event in protocol.Decoder().feed(path.read_bytes()) if isinstance(event, protocol.Reading)]
    found = [reading for reading in found if reading.kind is protocol.Kind.THREE_AXIS]
    if not found:
        raise SystemExit(f"expected a raw stream with 3-axis readings; there are none in it | {path}")
    picked = np.linspace(0, len(found) - 1, min(many, len(found))).astype(int)
    return [protocol.encode(found[index]) for index in picked]


AT_REST = protocol.Reading(protocol.Kind.THREE_AXIS, 0x2D6A, protocol.Status(0), ((-9, -5, 7),))
"""The first reading of alknemeyer/optoforce's recording."""


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.drivers.optoforce.flips", description="damage that the byte sum lets pass"
    )
    parser.add_argument("--file", type=Path, help="a raw stream of a 3-axis sensor (default: one reading at rest)")
    parser.add_argument("--readings", type=int, default=20, help="of how many of its readings to take the mean")
    parser.add_argument("--nominal-counts", type=float, default=16037, help="what the sensor reads at nominal load")
    options = parser.parse_args()
    packets = readings_of(options.file, options.readings) if options.file else [protocol.encode(AT_REST)]
    print(table(packets, options.nominal_counts))


if __name__ == "__main__":
    main()
