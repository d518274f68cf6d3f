"""Streams as CSV, Parquet and NumPy files, one for each stream; rows are written when they come, so that memory stays
bounded."""

import json
import zipfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

IMAGES = ("image", "depth", "color")
"""Columns that hold an image in each row; CSV leaves them out."""


class TableFile(Protocol):
    """One stream's file, which takes batches until it is closed."""

    def write(self, batch: pa.RecordBatch) -> None: ...

    def close(self) -> None: ...


class ParquetFile:
    """Columns unchanged, with their units in the fields' metadata."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        from pyarrow.parquet import ParquetWriter

        self._writer = ParquetWriter(path, schema, compression="zstd")

    def write(self, batch: pa.RecordBatch) -> None:
        self._writer.write_batch(batch)

    def close(self) -> None:
        self._writer.close()


class CsvFile:
    """Lists are JSON, bytes are hexadecimal; images are left out."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        from pyarrow.csv import CSVWriter

        self._names = [name for name in schema.names if name not in IMAGES]
        kinds = {name: schema.field(name).type for name in self._names}
        self._schema = pa.schema([(name, pa.string() if _is_flat(kind) else kind) for name, kind in kinds.items()])
        self._writer = CSVWriter(str(path), self._schema)

    def write(self, batch: pa.RecordBatch) -> None:
        columns = [_as_text(batch.column(name)) for name in self._names]
        self._writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=self._schema))

    def close(self) -> None:
        self._writer.close()


class NpzFile:
    """An array for each column. For lists, text and bytes: all values, and `NAME_offsets` (rows + 1,) where each row
    begins in them; for numbers that some rows lack: `NAME_valid` (rows,)."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self._path, self._draft = path, path.with_name(f"{path.name}.arrow")  # how long it is shows at its end
        self._writer = pa.ipc.new_file(str(self._draft), schema)

    def write(self, batch: pa.RecordBatch) -> None:
        self._writer.write_batch(batch)

    def close(self) -> None:
        self._writer.close()
        with zipfile.ZipFile(self._path, "w", zipfile.ZIP_DEFLATED) as made, pa.memory_map(str(self._draft)) as source:
            table = pa.ipc.open_file(source).read_all()
            for name, column in zip(table.column_names, table.columns, strict=True):
                for key, kind, count, parts in _arrays(name, column):
                    about = {"descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": (count,)}
                    with made.open(f"{key}.npy", "w", force_zip64=True) as file:
                        np.lib.format.write_array_header_1_0(file, about)
                        for part in parts:
                            file.write(np.ascontiguousarray(part, kind).data)
        self._draft.unlink()


Parts = Iterable[npt.NDArray[Any]]


def _arrays(name: str, column: pa.ChunkedArray) -> Iterator[tuple[str, np.dtype[Any], int, Parts]]:
    """Name, type, length and parts of each array of a column."""
    if _is_flat(column.type):
        kind = np.dtype(column.type.value_type.to_pandas_dtype() if _is_numbers(column.type) else np.uint8)
        ends = np.cumsum(np.concatenate([[0], *(_flat(one)[1] for one in column.chunks)]).astype(np.int64))
        yield f"{name}_offsets", ends.dtype, len(ends), [ends]
        yield name, kind, int(ends[-1]), (_flat(one)[0] for one in column.chunks)
        return
    kind = np.dtype(column.type.to_pandas_dtype())
    fill: Any = np.nan if kind.kind == "f" else False if kind.kind == "b" else 0
    filled = (pc.fill_null(one, fill).to_numpy(zero_copy_only=False) for one in column.chunks)
    yield name, kind, len(column), filled
    if kind.kind != "f" and column.null_count:
        there = (one.is_valid().to_numpy(zero_copy_only=False) for one in column.chunks)
        yield f"{name}_valid", np.dtype(bool), len(column), there


TABLE_FILES: dict[str, Callable[[Path, pa.Schema], TableFile]] = {
    "csv": CsvFile,
    "parquet": ParquetFile,
    "npz": NpzFile,
}


def _is_flat(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_string(kind) or pa.types.is_large_binary(kind))


def _is_numbers(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) and not pa.types.is_string(kind.value_type))


def _flat(column: pa.Array) -> tuple[npt.NDArray[Any], npt.NDArray[np.int64]]:
    """All values of all rows, and how many each row has; text as UTF-8, lists of text as JSON."""
    if _is_numbers(column.type):
        lengths = pc.fill_null(pc.list_value_length(column), 0).to_numpy(zero_copy_only=False)
        return column.flatten().to_numpy(zero_copy_only=False), lengths.astype(np.int64)
    if pa.types.is_list(column.type):
        column = _as_text(column)
    rows = column.to_pylist()
    encoded = [(row.encode() if isinstance(row, str) else row) or b"" for row in rows]
    return np.frombuffer(b"".join(encoded), np.uint8), np.array([len(row) for row in encoded], np.int64)


def _as_text(column: pa.Array) -> pa.Array:
    if pa.types.is_list(column.type):
        return pa.array([None if row is None else json.dumps(row) for row in column.to_pylist()], pa.string())
    if pa.types.is_large_binary(column.type):
        return pa.array([None if row is None else row.hex() for row in column.to_pylist()], pa.string())
    return column
