"""Reading files of arrays (`.npz`): what pair, motion and model files have in common.

Nothing in them is executed (no pickle).
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.stages.msm.clusters import find_lattice

Arrays = Mapping[str, npt.NDArray[Any]]
"""What a file holds, by name."""


@contextmanager
def open_arrays(
    raw: bytes, expected: str, where: object = "", *, came: str = "a file that is none, or damaged"
) -> Iterator[Arrays]:
    """The arrays in a file's bytes, each read where it is asked for.

    expected, came: what InputError tells of bytes that are no such file, of a missing name, and of a value that is
    refused while the file is open; where: the file's name
    """
    try:
        with np.load(io.BytesIO(raw), allow_pickle=False) as file:
            yield file
    except (ValueError, OSError, zipfile.BadZipFile, EOFError, KeyError) as error:
        raise InputError(expected, came, where=where) from error


def read_arrays(raw: bytes, expected: str, where: object = "") -> dict[str, npt.NDArray[Any]]:
    """All arrays in a file's bytes. Raises InputError for bytes that are no such file."""
    with open_arrays(raw, expected, where) as file:
        return {name: np.asarray(file[name]) for name in file}


# Single arrays; each raises InputError for what it cannot be ---------------------------------------------------------


def numbers(found: Arrays, name: str) -> npt.NDArray[np.float64]:
    """Numbers of any shape."""
    if found[name].dtype.kind not in "fiu":
        raise InputError(f"numbers in {name}", str(found[name].dtype))
    return found[name].astype(np.float64)


def sized(found: Arrays, name: str, count: int) -> npt.NDArray[Any]:
    """(count,) of any kind."""
    if found[name].shape != (count,):
        raise InputError(f"{name} of shape ({count},)", str(found[name].shape))
    return found[name]


def indices(found: Arrays, name: str, count: int) -> npt.NDArray[np.int64]:
    """Distinct indices below `count`; a boolean array of that length will do as well."""
    value = found[name]
    if value.dtype == np.bool_ and value.shape == (count,):
        return np.flatnonzero(value)
    if value.ndim != 1 or value.dtype.kind not in "iu":
        raise InputError(f"whole-number indices in {name}", f"{value.dtype} of shape {value.shape}")
    if value.size and (value.min() < 0 or value.max() >= count):
        raise InputError(f"indices 0 to {count - 1} in {name}", f"{value.min()} to {value.max()}")
    if np.unique(value).size != value.size:
        raise InputError(f"each index once in {name}", "repeated ones")
    return value.astype(np.int64)


def lattice(found: Arrays, rest: npt.NDArray[Any]) -> tuple[tuple[int, ...] | None, npt.NDArray[Any] | None]:
    """`shape` and `cell` (K,) of rest positions (K, d); without `shape` those of a regular rest shape, else None."""
    if "shape" not in found:
        return find_lattice(rest) or (None, None)
    shape = tuple(int(n) for n in np.atleast_1d(found["shape"]))
    size = int(np.prod(shape))
    if min(shape) < 1 or (size != len(rest) and "cell" not in found) or size < len(rest):
        raise InputError(
            f"a lattice shape for {len(rest)} particles", "x".join(map(str, shape)), "give `cell` where it has holes"
        )
    cell = indices(found, "cell", size) if "cell" in found else np.arange(len(rest))
    if len(cell) != len(rest):
        raise InputError(f"cell of shape ({len(rest)},)", str(cell.shape))
    return shape, cell
