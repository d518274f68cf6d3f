"""Reading files of arrays (`.npz`): common parts of pair, motion, model and classifier files.

Nothing in them is executed (no pickle)."""

import io
import json
import math
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.file_io import read_file
from deformscope.stages.msm.clusters import find_lattice

T = TypeVar("T")
Arrays = Mapping[str, npt.NDArray[Any]]
"""Arrays of a file, by name."""


DEFLATED_AT_MOST = 1100
"""Most bytes to which one compressed byte can expand."""
SAMPLES = {"pair": "sample:pair", "motion": "sample:press"}
"""An example of each kind of file."""
LATTICE_CELLS = 10_000_000
"""Largest number of cells of a lattice with holes, as arrays have that size."""


def read_arrays(raw: bytes, expected: str, where: object = "") -> dict[str, npt.NDArray[Any]]:
    """All arrays in a file's bytes, by name, of any shape.

    expected, where: the expected kind of file, and its name, for messages. Raises InputError for bytes that are no such
    file or damaged. No more memory is allocated than the bytes can fill."""
    came = "a damaged file, or one of another kind"
    if raw.startswith(np.lib.format.MAGIC_PREFIX):
        raise InputError(expected, "a single array (.npy)", "numpy.savez(FILE.npz, rest=..., ...)", where)
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            entries = [entry for entry in archive.infolist() if entry.filename.endswith(".npy")]
            return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}
    except (MemoryError, InputError):
        raise
    except Exception as error:  # damaged bytes make zipfile, zlib and NumPy raise what they like
        raise InputError(expected, came, where=where) from error


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> npt.NDArray[Any]:
    """One array; refused before it is allocated where the file cannot hold as much as it says."""
    if entry.file_size > DEFLATED_AT_MOST * (entry.compress_size + 1):
        raise ValueError("more data than its bytes can hold")
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(file)
    if dtype.hasobject:
        name = entry.filename.removesuffix(".npy")
        raise InputError(f"numbers or texts in {name}", "Python objects (pickle)", f"numpy.asarray({name}, dtype=str)")
    if math.prod(shape) * dtype.itemsize > entry.file_size:
        raise ValueError("an array larger than its file")
    content = archive.read(entry)  # to its end, where its checksum is compared
    return np.asarray(np.lib.format.read_array(io.BytesIO(content), allow_pickle=False))


# Single arrays; each raises InputError for what it cannot be ---------------------------------------------------------


def numbers(found: Arrays, name: str) -> npt.NDArray[np.float64]:
    """The array of this name as float64, of any shape."""
    if found[name].dtype.kind not in "fiu":
        raise InputError(f"numbers in {name}", str(found[name].dtype))
    return found[name].astype(np.float64)


def sized(found: Arrays, name: str, count: int) -> npt.NDArray[Any]:
    """An array (count,) of any type."""
    if found[name].shape != (count,):
        raise InputError(f"{name} of shape ({count},)", str(found[name].shape))
    return found[name]


def indices(found: Arrays, name: str, count: int) -> npt.NDArray[np.int64]:
    """(n,) distinct indices below `count`, from an array of indices or a mask (count,)."""
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


def number(found: Arrays, name: str, hint: str = "") -> float | None:
    """One finite number of 0 or more; None without an array of this name."""
    if name not in found:
        return None
    value = numbers(found, name).reshape(-1)
    if value.size != 1 or not (np.isfinite(value[0]) and value[0] >= 0.0):
        raise InputError(f"one {name} of 0 or more", "something else", hint)
    return float(value[0])


def rest_of(found: Arrays, needed: tuple[str, ...], kind: str) -> npt.NDArray[np.float64]:
    """`rest` (K, d), d = 2 or 3, from a file that must have all arrays of its kind."""
    if missing := [name for name in needed if name not in found]:
        keys = ", ".join(sorted(found)) or "nothing"
        hint = f"{', '.join(needed)}, as {SAMPLES[kind]} has them"
        raise InputError(f"{' and '.join(missing)} in the {kind} file", keys, hint)
    rest = numbers(found, "rest")
    if rest.ndim != 2 or rest.shape[1] not in (2, 3):
        raise InputError("rest of shape (K, 2) or (K, 3)", str(rest.shape))
    if not np.isfinite(rest).all():
        raise InputError("finite positions", "NaN or infinity in rest", "drop those particles")
    return rest


def parsed(raw: bytes, kind: str, where: object, parse: Callable[[Arrays], T]) -> T:
    """The result of `parse` on a file's arrays; a refusal names the file."""
    found = read_arrays(raw, f"a {kind} file (.npz of arrays)", where)
    try:
        return parse(found)
    except InputError as error:
        raise type(error).about(error, where) from error


def described(path: Path, kind: str, version: int, how: str, make: Callable[[Any, Arrays], T]) -> T:
    """The result of `make` on the description and the arrays of a file with `format` "deformscope KIND VERSION" and
    `told`, a JSON text. how: how to make such a file. Raises InputError for another kind of file, a damaged one, or
    another format."""
    what, wanted = f"a {kind} file", f"deformscope {kind} {version}"
    found = read_arrays(read_file(path, what, how), f"{what} (.npz)", path)
    shown = str(found["format"]) if "format" in found and found["format"].dtype.kind == "U" else ""
    if "told" not in found or not shown.startswith(f"deformscope {kind} "):
        names = ", ".join(sorted(found)[:4]) or "nothing"
        holds = "a pair file" if {"rest", "deformed"} <= found.keys() else f"an .npz of {names}"
        raise InputError(what, repr(shown) if shown else holds, how, path)
    if shown != wanted:
        hint = "a newer deformscope" if shown.rpartition(" ")[2].isdecimal() else how
        raise InputError(f"{what} of format {wanted!r}", repr(shown), hint, path)
    try:
        return make(json.loads(str(found["told"])), found)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, RecursionError) as error:
        came = f"one without or with a wrong {' '.join(str(error).split())[:120]}"
        raise InputError(f"a complete {kind} file", came, how, path) from error
    except InputError as error:
        raise type(error).about(error, path) from error


NOT_KNOWN = "leave it out if it is unknown"


def lattice(found: Arrays, rest: npt.NDArray[Any]) -> tuple[tuple[int, ...] | None, npt.NDArray[Any] | None]:
    """`shape` and `cell` (K,) of rest positions (K, d). If the file has no `shape`, those of a regular rest shape, else
    None."""
    if "shape" not in found:
        return find_lattice(rest) or (None, None)
    given = found["shape"].reshape(-1)
    sides = [float(side) for side in given] if given.dtype.kind in "fiu" and 0 < given.size <= 3 else []
    if not sides or not all(side.is_integer() and side >= 1.0 for side in sides):
        raise InputError("a lattice shape of whole numbers", f"{given.dtype} {given[:4].tolist()}", "shape=(4, 3, 2)")
    shape = tuple(int(side) for side in sides)
    size = math.prod(shape)
    if (size != len(rest) and "cell" not in found) or size < len(rest):
        raise InputError(
            f"a lattice shape for {len(rest)} particles", "x".join(map(str, shape)), "give `cell` where it has holes"
        )
    if size > max(LATTICE_CELLS, len(rest)):
        came = " x ".join(f"{side:g}" for side in sides)
        raise InputError(f"a lattice of at most {LATTICE_CELLS} cells", came, "leave out the cells that are empty")
    cell = indices(found, "cell", size) if "cell" in found else np.arange(len(rest))
    if len(cell) != len(rest):
        raise InputError(f"cell of shape ({len(rest)},)", str(cell.shape))
    return shape, cell
