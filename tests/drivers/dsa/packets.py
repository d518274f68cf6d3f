"""Packets of the DSACON32m and what they say, typed from the protocol reference."""

import struct

import numpy as np

from deformscope_drivers.dsa import messages


def hexed(text: str) -> bytes:
    return bytes.fromhex(text)


def checked(text: str) -> bytes:
    """A packet for which the reference gives only the layout, with the checksum as the reference describes it."""
    body = hexed(text)
    return b"\xaa\xaa\xaa" + body + struct.pack("<H", checksum(body))


def checksum(data: bytes) -> int:
    """Bit by bit, apart from the drivers' own: the entry of the byte that leaves, by polynomial 0x1021, shifted in."""
    crc = 0xFFFF
    for byte in data:
        entry = ((crc ^ byte) & 0xFF) << 8
        for _ in range(8):
            entry = entry << 1 ^ (0x1021 if entry & 0x8000 else 0)
        crc = crc >> 8 ^ entry & 0xFFFF
    return crc


def reading(timestamp_ms: int, flags: int, *texels: int) -> messages.Reading:
    return messages.Reading(timestamp_ms, flags, np.array(texels, np.uint16))


# The reference's worked packets, host to controller.
COMMANDS = [
    (messages.ConfigureAcquisition(0x01), hexed("aa aa aa 03 03 00 01 00 00 2f 6a")),  # stop
    (messages.ConfigureAcquisition(0x81), hexed("aa aa aa 03 03 00 81 00 00 2f 68")),  # one frame
    (messages.ConfigureAcquisition(0x81, 30), hexed("aa aa aa 03 03 00 81 1e 00 2c 76")),  # stream
    (messages.ConfigureAcquisition(0x80, 30), hexed("aa aa aa 03 03 00 80 1e 00 8e 1c")),  # stream, raw
    (messages.QueryController(), hexed("aa aa aa 01 00 00")),
    (messages.QuerySensor(), hexed("aa aa aa 02 00 00")),
    (messages.QueryMatrix(0), hexed("aa aa aa 0b 01 00 00 cb fb")),
    (messages.QueryMatrix(1), hexed("aa aa aa 0b 01 00 01 ea eb")),
    (messages.QueryMatrix(5), hexed("aa aa aa 0b 01 00 05 6e ab")),
    (messages.SetSensitivity(0, 0, 0.75), hexed("aa aa aa 0f 06 00 00 00 00 00 40 3f 30 2a")),
    (messages.SetSensitivity(2, 0, 0.5), hexed("aa aa aa 0f 06 00 02 00 00 00 00 3f d6 e1")),
    (messages.SetThreshold(0, 0, 150), hexed("aa aa aa 13 04 00 00 00 96 00 90 cf")),
    (messages.QueryThreshold(0), hexed("aa aa aa 14 01 00 00 03 c1")),
    (messages.QuerySensitivity(3), checked("12 01 00 03")),
]

FRAME = hexed("aa aa aa 00 0d 00 e8 03 00 00 01 00 f0 00 50 05 20 ff 1f 82 e7")
ACK = hexed("aa aa aa 03 02 00 00 00 4b b9")
STOP = hexed("aa aa aa 03 03 00 01 00 00 2f 6a")

# Controller to host: the reference's worked packets, then its layouts filled in by hand.
ANSWERS = [
    (messages.Ack(0x03), ACK),
    (messages.Ack(0x03, 11), hexed("aa aa aa 03 02 00 0b 00 37 64")),
    (messages.SensorInfo(0, 6, 0, 1, 4321, 0), hexed("aa aa aa 02 0c 00 00 00 06 00 00 00 01 e1 10 00 00 00 b2 cb")),
    (reading(1000, 1, *[0] * 20, 5, 5, 4095), FRAME),
    (reading(0x01020304, 0, 1, 0, 4095), checked("00 0b 00 04 03 02 01 00 01 00 00 00 ff 0f")),
    (
        messages.ControllerInfo(0, 0x12345678, 0x10, 268, 0xC0, 0x70, 2, 3, 1_000_000, 0x2A),
        checked("01 12 00 00 00 78 56 34 12 10 0c 01 c0 70 02 03 40 42 0f 00 2a"),
    ),
    (
        messages.MatrixInfo(0, 3.5, 3.25, 6, 14, b"abcdef", b"\0\1", 7, (1.0, 2.0, 0.5), (0.0, -1.0, 0.25), 4095.0, 1),
        checked(
            "0b 34 00 00 00 00 00 60 40 00 00 50 40 06 00 0e 00 61 62 63 64 65 66 00 01 07"
            "00 00 80 3f 00 00 00 40 00 00 00 3f 00 00 00 00 00 00 80 bf 00 00 80 3e 00 f0 7f 45 01"
        ),
    ),
    (messages.SensitivityInfo(0, 2, 0.75, 0.5), checked("12 0b 00 00 00 02 00 00 40 3f 00 00 00 3f")),
    (messages.ThresholdInfo(0, 150), checked("14 04 00 00 00 96 00")),
    (messages.Ack(0x0B, 24), checked("0b 02 00 18 00")),  # a query that failed, answered with the error code alone
    (messages.Ack(0x0F), checked("0f 02 00 00 00")),
    (messages.Ack(0x13, 27), checked("13 02 00 1b 00")),
]
