"""The wire format of the Weiss DSACON32m, the tactile controller of Schunk's SDH: bytes <-> messages.

This module uses no port, clock or thread. A packet is, in both directions,

    AA AA AA | id | payload length, 2 bytes | payload | CRC, 2 bytes

without CRC where the payload is empty. The CRC covers all from id to payload (`deformscope_drivers.framing`); it
misses some pairs of flipped bits (counted in `tests/drivers/dsa/flips.py`). Therefore a packet must also have a known
id, the length of that id, and texels of 12 bits, one for each cell of the sensor.
Source: SDHLibrary-CPP, sdh/dsa.h and dsa.cpp (protocols.md 1a)."""

import struct
from abc import abstractmethod
from dataclasses import dataclass

from deformscope_drivers.dsa import messages
from deformscope_drivers.dsa.messages import decode_raw, decode_rle, encode_raw, encode_rle
from deformscope_drivers.framing import EventT, FrameDecoder, GoodFrame, Refused, crc16, find_start
from deformscope_drivers.framing import Skipped as Skipped

PREAMBLE = b"\xaa\xaa\xaa"
SDH_CELLS = 3 * (6 * 14 + 6 * 13)
"""Texels of the SDH's six matrices."""

_HEAD = struct.Struct("<3sBH")
_FRAME_HEAD = struct.Struct("<IB")
_CRC_BYTES = 2
_COMMAND_PAYLOAD_MAX = 64  # well above the longest that is public, 6; a length beyond it is noise, not a command


def stream(*, rle: bool = True, frame_rate_hz: int = 30) -> messages.ConfigureAcquisition:
    """Send frames until they are stopped, as many as the line carries; the requested rate is not guaranteed."""
    return messages.ConfigureAcquisition(
        messages.Acquisition.ON | (messages.Acquisition.RLE if rle else 0), frame_rate_hz
    )


def stop() -> messages.ConfigureAcquisition:
    """Stop sending frames; the RLE flag is set, as in Schunk's software."""
    return messages.ConfigureAcquisition(messages.Acquisition.RLE)


def encode(message: messages.Command | messages.Reply | messages.Reading) -> bytes:
    """The packet that holds a message. A `Reading` is run-length encoded if its flags say so."""
    if isinstance(message, messages.Reading):
        coded = encode_rle(message.texels) if message.flags & messages.FRAME_RLE else encode_raw(message.texels)
        return packet(messages.Id.FRAME, _FRAME_HEAD.pack(message.timestamp_ms, message.flags) + coded)
    if isinstance(message, messages.Ack):
        return packet(message.command, struct.pack("<H", message.error))
    layout = messages.LAYOUT_OF[type(message)]
    return packet(layout.id, layout.pack(message))


def packet(id: int, payload: bytes) -> bytes:
    """A packet of any id."""
    whole = _HEAD.pack(PREAMBLE, id, len(payload)) + payload
    return whole + struct.pack("<H", crc16(whole[len(PREAMBLE) :])) if payload else whole


class _DsaDecoder(FrameDecoder[EventT]):
    """Finds whole packets in a stream by preamble, length and checksum; a subclass decodes their payload."""

    def _find(self, buffer: bytes, start: int) -> int:
        return find_start(buffer, start, PREAMBLE)

    def _parse(self, buffer: bytes, start: int) -> GoodFrame[EventT] | Refused | None:
        if len(buffer) < start + _HEAD.size:
            id_came = len(buffer) > start + len(PREAMBLE)
            return Refused("id") if id_came and not self._knows(buffer[start + len(PREAMBLE)]) else None
        _, id, length = _HEAD.unpack_from(buffer, start)
        if not self._knows(id):
            return Refused("id")
        if not self._fits(id, length):
            return Refused("length")
        payload_at = start + _HEAD.size
        end = payload_at + length + (_CRC_BYTES if length else 0)
        if len(buffer) < end:
            return None
        intact = not length or crc16(buffer[start + len(PREAMBLE) : end - _CRC_BYTES]) == int.from_bytes(
            buffer[end - _CRC_BYTES : end], "little"
        )
        event = self._event(id, buffer[payload_at : payload_at + length], intact)
        return event if isinstance(event, Refused) else GoodFrame(event, end - start)

    @abstractmethod
    def _knows(self, id: int) -> bool:
        """Whether packets of that id come from the other end."""

    @abstractmethod
    def _fits(self, id: int, length: int) -> bool:
        """Whether a payload of that id may have that length."""

    @abstractmethod
    def _event(self, id: int, payload: bytes, intact: bool) -> EventT | Refused:
        """Content of a whole packet; `intact`: its checksum is right."""


class Decoder(_DsaDecoder[messages.Reading | messages.Reply]):
    """The host's end. Yields `Reading`, replies (`Ack`, `ControllerInfo`...) and `Skipped`.

    cells: texels of all matrices together, as the controller reports them (it may be set later). Frames must then have
    exactly this number. While it is None, any number up to 486 passes: the SDH's, the largest sensor with a public
    size. A bound is needed, because a damaged length must not delay the frames behind it."""

    def __init__(self, cells: int | None = None) -> None:
        super().__init__()
        self.cells = cells

    def _knows(self, id: int) -> bool:
        ids = messages.Id
        return id in messages.REPLY_TO or id in (ids.FRAME, ids.ACQUISITION, ids.SET_SENSITIVITY, ids.SET_THRESHOLD)

    def _fits(self, id: int, length: int) -> bool:
        if id == messages.Id.FRAME:
            coded = length - _FRAME_HEAD.size
            return 0 < coded <= 2 * (self.cells or SDH_CELLS) and coded % 2 == 0
        return length == 2 or (id in messages.REPLY_TO and length == messages.REPLY_TO[id].fields.size)

    def _event(self, id: int, payload: bytes, intact: bool) -> messages.Reading | messages.Reply | Refused:
        if not intact:
            return Refused("checksum")
        if id == messages.Id.FRAME:
            timestamp_ms, flags = _FRAME_HEAD.unpack_from(payload)
            coded = payload[_FRAME_HEAD.size :]
            texels = decode_rle(coded, self.cells or SDH_CELLS) if flags & messages.FRAME_RLE else decode_raw(coded)
            if texels is None:
                return Refused("texel count" if flags & messages.FRAME_RLE else "texel range")
            right_count = texels.size and self.cells in (None, texels.size)
            return messages.Reading(timestamp_ms, flags, texels) if right_count else Refused("texel count")
        if len(payload) > 2:
            reply: messages.Reply = messages.REPLY_TO[id].unpack(payload)
            return reply
        error = int.from_bytes(payload, "little")
        # a query that succeeded is answered in full
        return Refused("length") if id in messages.REPLY_TO and error == messages.SUCCESS else messages.Ack(id, error)


@dataclass(frozen=True, slots=True)
class Faulty:
    """A command that cannot be carried out. id: id as sent; error: the code that answers it"""

    id: int
    error: int


class CommandDecoder(_DsaDecoder[messages.Command | Faulty]):
    """The controller's end, for doubles. Yields commands, `Faulty` for damaged packets, and `Skipped`.

    A controller trusts the length and answers unusable packets, where the host searches on. Error codes were assigned
    to errors by their names; only the list of codes is public."""

    def _knows(self, id: int) -> bool:
        return True

    def _fits(self, id: int, length: int) -> bool:
        return length <= _COMMAND_PAYLOAD_MAX

    def _event(self, id: int, payload: bytes, intact: bool) -> messages.Command | Faulty:
        if not intact:
            return Faulty(id, messages.CHECKSUM)
        layout = messages.COMMAND_WITH.get(id)
        if layout is None:
            return Faulty(id, messages.UNKNOWN_COMMAND)
        if len(payload) != layout.fields.size:
            return Faulty(
                id, messages.NOT_ENOUGH_PARAMETERS if len(payload) < layout.fields.size else messages.COMMAND_FORMAT
            )
        command: messages.Command = layout.unpack(payload)
        return command
