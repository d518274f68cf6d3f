"""The data stream of a Robotiq FT 300: 16 bytes, 20 4E, six int16 (low byte first), a Modbus CRC of what is before it.

Source: Robotiq's FT 300 instruction manual, section 4 (Modbus RTU, slave 9; the value 0x0200 in register 410 starts the
stream, 50 bytes of FF end it), and its published Python example (19 200 baud, hundredths of N, thousandths of N m)."""

import struct
from dataclasses import dataclass
from enum import Enum

import numpy as np

from deformscope_drivers.framing import FrameDecoder, GoodFrame, Refused, find_start

BAUDRATE = 19_200
RATE_HZ = 100.0
HEADER = b"\x20\x4e"
PACKET_BYTES, REPLY_BYTES = 16, 8
COUNTS_PER_N, COUNTS_PER_NM = 100.0, 1000.0
PER_COUNT = 1.0 / np.array([COUNTS_PER_N] * 3 + [COUNTS_PER_NM] * 3)


def crc(data: bytes) -> bytes:
    """The CRC of Modbus RTU (0xA001, begins with 0xFFFF), low byte first."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")


def _with_crc(data: bytes) -> bytes:
    return data + crc(data)


START = _with_crc(bytes.fromhex("09 10 01 9a 00 01 02 02 00"))
"""Write 0x0200 into register 410 of slave 9."""
STARTED = _with_crc(bytes.fromhex("09 10 01 9a 00 01"))
STOP = b"\xff" * 50


class Reply(Enum):
    """An answer of the sensor."""

    STARTED = "started"


@dataclass(frozen=True, slots=True)
class Packet:
    """counts: Fx Fy Fz Tx Ty Tz"""

    counts: tuple[int, ...]

    def encode(self) -> bytes:
        """Its 16 bytes."""
        return _with_crc(HEADER + struct.pack("<6h", *self.counts))


class Decoder(FrameDecoder[Packet | Reply]):
    """Packets of the stream, and the answer to its start."""

    def _find(self, buffer: bytes, start: int) -> int:
        return min(find_start(buffer, start, HEADER), find_start(buffer, start, STARTED[:2]))

    def _parse(self, buffer: bytes, start: int) -> GoodFrame[Packet | Reply] | Refused | None:
        is_reply = buffer[start : start + 1] == STARTED[:1]
        length = REPLY_BYTES if is_reply else PACKET_BYTES
        frame = buffer[start : start + length]
        if len(frame) < length:
            return None
        if crc(frame[:-2]) != frame[-2:]:
            return Refused("checksum")
        if is_reply:
            return GoodFrame(Reply.STARTED, length) if frame == STARTED else Refused("reply")
        return GoodFrame(Packet(struct.unpack_from("<6h", frame, 2)), length)
