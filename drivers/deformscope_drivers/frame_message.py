"""A picture of a depth camera, as the process that reads the camera sends it. Nothing here imports numpy."""

from dataclasses import dataclass

NO_TIME_US = 2**64 - 1
"""Value of a frame's timestamp if the camera's clock did not stamp it."""
INDEX_MASK = 0xFFFFFFFF
"""A camera's count of frames is taken as one of 32 bits."""


@dataclass(frozen=True, slots=True)
class FrameMessage:
    """host_ns: arrival on the host's monotonic clock, which all processes share [ns]; timestamp_us: time on the
    camera's clock [us]; index: the camera's count of frames, 32 bits; sizes [px], 0 = no colour
    depth: little endian, 2 bytes a pixel; color: RGB, 3 bytes a pixel; both row by row without padding"""

    host_ns: int
    timestamp_us: int
    index: int
    width: int
    height: int
    color_width: int
    color_height: int
    depth: bytes
    color: bytes
