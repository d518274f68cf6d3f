"""The binary protocol of firmware 0.0.2.15 and later: one request, one reply, always for all seven axes.

    request  code u8, length u8, count u8 (0 or 7),            count x f32, [crc u16]
    reply    code u8, length u8, count u8,         status u8,      7 x f32, [crc u16]

Little-endian. `length` counts all following bytes, including the checksum, so that it shows whether there is one.
Messages on RS-232 have a checksum over all bytes before it, those on CAN and TCP have none. Source:
ipab-slmc/SDHLibrary-CPP, sdh/sdhserial.cpp."""

import math
import struct

from deformscope_drivers.framing import GoodFrame, Refused, crc16
from deformscope_drivers.sdh import codes

FIRST_CODE, LAST_CODE = min(codes.NAMES), max(codes.NAMES)
CHECKSUM_SIZE = 2
_VALUES = struct.Struct(f"<{codes.AXIS_COUNT}f")
_REPLY_LENGTH = 2 + _VALUES.size
_REQUEST_LENGTHS = {1: 0, 1 + _VALUES.size: codes.AXIS_COUNT}


def encode_request(command: codes.Command, *, checksummed: bool) -> bytes:
    """Raises ValueError for a request outside the protocol; limits are not checked."""
    values = command.values
    if command.name not in codes.CODES:
        raise ValueError(f"the hand has no command {command.name!r}")
    if command.axis is not None or len(values) not in (0, codes.AXIS_COUNT):
        raise ValueError(f"a binary request is for all {codes.AXIS_COUNT} axes: {command}")
    if not all(math.isfinite(value) for value in values):
        raise ValueError(f"values must be finite: {values}")
    payload = _VALUES.pack(*values) if values else b""
    length = 1 + len(payload) + CHECKSUM_SIZE * checksummed
    return _sealed(bytes([codes.CODES[command.name], length, len(values)]) + payload, checksummed)


def encode_reply(event: codes.Reading | codes.ValueReply | codes.ErrorReply, *, checksummed: bool) -> bytes:
    """The hand's reply. A refused command is answered with zeros; that its count is 7 too is an assumption."""
    values: tuple[float, ...]
    if isinstance(event, codes.ErrorReply):
        name, status, values = event.name or "", event.code, (0.0,) * codes.AXIS_COUNT
    else:
        name = event.quantity if isinstance(event, codes.Reading) else event.name
        status, values = 0, event.values
    length = _REPLY_LENGTH + CHECKSUM_SIZE * checksummed
    head = bytes([codes.CODES[name], length, codes.AXIS_COUNT, status])
    return _sealed(head + _VALUES.pack(*values), checksummed)


def parse_reply(buffer: bytes, start: int, checksummed: bool | None) -> GoodFrame[codes.Event] | Refused | None:
    """The reply whose code is at `start`; checksummed: None = decided by its length."""
    body = _body(buffer, start, {_REPLY_LENGTH: codes.AXIS_COUNT}, checksummed)
    if not isinstance(body, bytes):
        return body
    code, length, count, status = body[:4]
    if count not in (0, codes.AXIS_COUNT):
        return Refused("count")
    if status >= len(codes.ERRORS):
        return Refused("status")
    values = _VALUES.unpack_from(body, 4)
    if not all(math.isfinite(value) for value in values):
        return Refused("value")
    name = codes.NAMES[code]
    event: codes.Event
    if status:
        event = codes.ErrorReply(status, name)
    elif name in codes.MEASURED_COUNT:
        if count != codes.MEASURED_COUNT[name]:
            return Refused("count")
        event = codes.Reading(name, values)
    else:
        event = codes.ValueReply(name, values[:count])
    return GoodFrame(event, 2 + length)


def parse_request(buffer: bytes, start: int, checksummed: bool | None) -> GoodFrame[codes.Command] | Refused | None:
    """The request whose code is at `start`, as the hand decodes it."""
    body = _body(buffer, start, _REQUEST_LENGTHS, checksummed)
    if not isinstance(body, bytes):
        return body
    code, length, count = body[:3]
    values = body[3 : 3 + _VALUES.size]
    if count != (codes.AXIS_COUNT if length > 1 + CHECKSUM_SIZE else 0):
        return Refused("count")
    return GoodFrame(codes.Command(codes.NAMES[code], _VALUES.unpack(values) if count else ()), 2 + length)


def _sealed(message: bytes, checksummed: bool) -> bytes:
    return message + crc16(message).to_bytes(CHECKSUM_SIZE, "little") if checksummed else message


def _body(buffer: bytes, start: int, lengths: dict[int, int], checksummed: bool | None) -> bytes | Refused | None:
    """The message that starts there, once it is whole and its length and checksum are right."""
    if len(buffer) < start + 2:
        return None
    length = buffer[start + 1]
    has_checksum = length not in lengths
    if has_checksum and length - CHECKSUM_SIZE not in lengths:
        return Refused("length")
    if checksummed is not None and has_checksum != checksummed:
        return Refused("length")
    if len(buffer) < start + 2 + length:
        return None
    message = buffer[start : start + 2 + length]
    if has_checksum and crc16(message[:-CHECKSUM_SIZE]) != int.from_bytes(message[-CHECKSUM_SIZE:], "little"):
        return Refused("checksum")
    return message
