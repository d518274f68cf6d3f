"""Texels as the DSACON32m sends them: raw, or run-length encoded in words of 4 bits of run and 12 of value."""

from __future__ import annotations

import numpy as np

from deformscope_drivers.dsa.messages import TexelArray

TEXEL_MAX = 4095
"""Texels have 12 bits."""

LONGEST_RUN = 15

_WORD = np.dtype("<u2")


def decode_raw(coded: bytes) -> TexelArray | None:
    """(n,) texels of n little-endian words; None where one has more than 12 bits."""
    texels = np.frombuffer(coded, _WORD)
    return None if (texels > TEXEL_MAX).any() else _own(texels)


def decode_rle(coded: bytes, cells_max: int) -> TexelArray | None:
    """(n,) texels of run-length encoded words (a run of 0 gives none); None where there are more than `cells_max`."""
    words = np.frombuffer(coded, _WORD)
    runs = words >> 12
    return None if int(runs.sum(dtype=np.int64)) > cells_max else _own(np.repeat(words & TEXEL_MAX, runs))


def encode_raw(texels: TexelArray) -> bytes:
    """(n,) texels as n little-endian words."""
    return texels.astype(_WORD).tobytes()


def encode_rle(texels: TexelArray) -> bytes:
    """(n,) texels as words of run and value, with runs as long as can be; never longer than raw."""
    if not texels.size:
        return b""
    starts = np.flatnonzero(np.diff(texels, prepend=texels[0] ^ 1))
    lengths = np.diff(starts, append=texels.size)
    words = []
    for value, length in zip(texels[starts].tolist(), lengths.tolist(), strict=True):
        words += [LONGEST_RUN << 12 | value] * (length // LONGEST_RUN)
        if rest := length % LONGEST_RUN:
            words.append(rest << 12 | value)
    return np.array(words, _WORD).tobytes()


def _own(texels: TexelArray) -> TexelArray:
    """The same counts (n,) as uint16 in the machine's byte order, read-only."""
    texels = texels.astype(np.uint16)
    texels.flags.writeable = False
    return texels
