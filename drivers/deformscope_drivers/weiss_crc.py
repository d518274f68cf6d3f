"""The checksum of the SDH's tactile controller (Weiss DSACON32m) and of the hand's binary protocol on RS-232.

The checksum is no named standard: the table is that of CRC-16/CCITT (polynomial 0x1021, most significant bit first),
and the update shifts the other way, as in reflected CRCs. For the ASCII digits "123456789" it is 0x6EB4, while
CRC-16/CCITT-FALSE is 0x29B1 and CRC-16/MCRF4XX 0x6F91; CRC libraries do not have it. The code is not truly cyclic:
every flipped bit changes it, but some pairs of flipped bits do not. Source: ipab-slmc/SDHLibrary-CPP, sdh/crc.h (facts,
not code)."""

from __future__ import annotations

import struct

START = 0xFFFF

_POLYNOMIAL = 0x1021


def _table_entry(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = (value << 1) ^ (_POLYNOMIAL if value & 0x8000 else 0)
    return value & 0xFFFF


_TABLE = tuple(_table_entry(byte) for byte in range(256))

# Two bytes at a time, which halves the time for a tactile frame: by the state with the next two bytes, low one first,
# put on it. The table is linear (its entry for a ^ b is the one for a, ^ the one for b), so the state after both is
# (T[x & 255] >> 8) ^ T[(x >> 8) ^ (T[x & 255] & 255)].
_PAIR_TABLE = tuple((low >> 8) ^ _TABLE[high ^ (low & 0xFF)] for high in range(256) for low in _TABLE)


def crc16(data: bytes, crc: int = START) -> int:
    """The checksum of `data`; `crc` is that of the bytes before it, to continue from. Sent low byte first."""
    for pair in struct.unpack_from(f"<{len(data) // 2}H", data):
        crc = _PAIR_TABLE[crc ^ pair]
    if len(data) % 2:
        crc = (crc >> 8) ^ _TABLE[(crc ^ data[-1]) & 0xFF]
    return crc
