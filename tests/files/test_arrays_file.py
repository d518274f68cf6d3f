"""Files of arrays that are damaged, or say what cannot be: refused in one line, with bounded memory."""

import contextlib
import io
import resource
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.files.model_file import load_model
from deformscope.files.motions import parse_motion
from deformscope.files.pairs import parse_pair

REST = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij"), -1).reshape(-1, 2) * 0.01


def npz(compressed: bool = True, **arrays: Any) -> bytes:
    file = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, **arrays)
    return file.getvalue()


def pair(compressed: bool = True, **more: Any) -> bytes:
    return npz(compressed, rest=REST, deformed=REST + 0.001, held=np.array([0, 1]), **more)


def refusal(raw: bytes) -> str:
    with pytest.raises(InputError) as told:
        parse_pair(raw, "pair.npz")
    assert len(str(told.value).splitlines()) == 1
    assert str(told.value).endswith("| pair.npz")
    return str(told.value)


def test_a_renamed_single_array_is_named() -> None:
    file = io.BytesIO()
    np.save(file, REST)
    assert "a single array (.npy)" in refusal(file.getvalue())


def test_a_damaged_byte_in_the_compressed_arrays_is_refused() -> None:
    raw = pair()
    entry = zipfile.ZipFile(io.BytesIO(raw)).getinfo("deformed.npy")
    start = entry.header_offset + 30 + len("deformed.npy") + 20
    for place in range(start, start + entry.compress_size - 1):
        damaged = bytearray(raw)
        damaged[place] ^= 0x40
        assert "damaged" in refusal(bytes(damaged))


@pytest.mark.parametrize("cell", [False, True])
@pytest.mark.parametrize(
    "shape",
    [
        *([np.nan, 3.0], [np.inf, 1.0], [2**31, 2**31], [2**40, 1], [10**9, 10**9], [1e300, 1.0], [4000, 3000]),
        *([-1, -12], [0, 12], [], ["a", "b"], [4.5, 3.0], [1, 1, 1, 12], [True, False]),
    ],
)
def test_a_shape_that_is_no_lattice_is_refused(shape: list[Any], cell: bool) -> None:
    assert "lattice" in refusal(pair(shape=np.array(shape), **({"cell": np.arange(12)} if cell else {})))


def claiming(shape: str) -> bytes:
    """A pair file whose `rest` says that it has this shape."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"
    header += " " * (63 - (10 + len(header)) % 64) + "\n"
    raw = io.BytesIO(pair())
    with zipfile.ZipFile(raw) as old, zipfile.ZipFile(new := io.BytesIO(), "w") as made:
        for name in ("deformed.npy", "held.npy"):
            made.writestr(name, old.read(name))
        made.writestr("rest.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + bytes(64))
    return new.getvalue()


@pytest.mark.parametrize("shape", ["(100000000, 2)", "(9223372036854775807, 9)", "(4, -2)", "(99999999999999999999,)"])
def test_a_huge_claimed_array_is_refused_without_memory_for_it(shape: str) -> None:
    tracemalloc.start()
    refusal(claiming(shape))
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


def test_a_file_that_says_it_unpacks_to_more_than_its_bytes_can_is_refused() -> None:
    raw = bytearray(pair())
    directory = raw.rindex(b"PK\x01\x02")
    raw[directory + 24 : directory + 28] = struct.pack("<I", 0xFFFFFFF0)
    refusal(bytes(raw))


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    changes=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), max_size=6),
    cut=st.one_of(st.none(), st.floats(0, 1)),
    compressed=st.booleans(),
    reader=st.sampled_from([parse_pair, parse_motion]),
)
def test_mutated_files_are_read_or_refused(
    changes: list[tuple[float, int]], cut: float | None, compressed: bool, reader: Any
) -> None:
    base = bytearray(pair(compressed, shape=np.array([4, 3]), cell=np.arange(12), motion=np.stack([REST, REST])))
    for place, value in changes:
        base[int(place * len(base))] = value
    raw = bytes(base if cut is None else base[: int(cut * len(base))])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with contextlib.suppress(InputError):  # and nothing else
        reader(raw, "f.npz")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000, "kilobytes"


@settings(max_examples=100, deadline=None)
@given(raw=st.binary(max_size=400))
def test_any_bytes_are_refused(raw: bytes) -> None:
    with pytest.raises(InputError):
        parse_pair(raw, "f.npz")


@pytest.mark.parametrize("told", ["{", "[]", "3", "{}", "[" * 5000, '{"tip": 3, "rivals": [], "law": {}}'])
def test_a_model_whose_text_is_nonsense_is_refused(told: str, tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    arrays = dict.fromkeys(("rest", "toward", "fixed", "places", "stiffness", "left_out", "rival_stiffness"), REST)
    path.write_bytes(npz(format=np.array("deformscope model 1"), told=np.array(told), **arrays))
    with pytest.raises(InputError, match="a complete model file"):
        load_model(path)


def test_the_command_says_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "renamed.npz"
    np.save(tmp_path / "a.npy", REST)
    (tmp_path / "a.npy").rename(path)
    assert main(["calibrate", "beta", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "unexpected" not in line
