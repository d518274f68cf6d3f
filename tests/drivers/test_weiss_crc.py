"""The checksum that the SDH's tactile controller and its hand share: check value and worked packets."""

import pytest

from deformscope_drivers.framing import crc16

# Checksummed bytes and the two bytes that follow them on the wire, from the protocol reference's worked packets.
WORKED = [
    ("83 03 00", "dc 1e"),  # hand: POS request
    ("84 03 00", "a3 28"),  # hand: STATE request
    ("81 03 00", "98 cb"),  # hand: VEL request
    ("03 03 00 01 00 00", "2f 6a"),  # tactile controller: stop
    ("03 03 00 80 1e 00", "8e 1c"),  # tactile controller: stream, raw
    ("0f 06 00 02 00 00 00 00 3f", "d6 e1"),  # tactile controller: sensitivity
]


def test_check_value() -> None:
    assert crc16(b"123456789") == 0x6EB4


@pytest.mark.parametrize(("covered", "on_the_wire"), WORKED)
def test_worked_packets(covered: str, on_the_wire: str) -> None:
    assert crc16(bytes.fromhex(covered)) == int.from_bytes(bytes.fromhex(on_the_wire), "little")


def test_goes_on_from_what_came_before() -> None:
    assert crc16(b"6789", crc16(b"12345")) == crc16(b"123456789")


def test_leading_zeros_matter() -> None:
    assert len({crc16(bytes(count)) for count in range(4)}) == 4
