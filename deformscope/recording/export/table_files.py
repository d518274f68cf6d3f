"""Streams as CSV, Parquet and NumPy files, one a stream; written as they come, so that memory stays bounded."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Protocol

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
    """Columns as they are, with their units in the fields' metadata."""

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
        fields = [pa.field(name, _text_type(schema.field(name).type)) for name in self._names]
        self._schema = pa.schema(fields)
        self._writer = CSVWriter(str(path), self._schema)

    def write(self, batch: pa.RecordBatch) -> None:
        columns = [_as_text(batch.column(name)) for name in self._names]
        self._writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=self._schema))

    def close(self) -> None:
        self._writer.close()


class NpzFile:
    """An array for each column. Of lists, text and bytes: all values, and `NAME_offsets` (rows + 1,) where each row
    begins in them; of numbers that some rows lack: `NAME_valid` (rows,)."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self._path, self._rows = path, 0
        self._arrays: dict[str, _GrowingArray] = {}
        for name in schema.names:
            if _is_flat(schema.field(name).type):
                self._array(f"{name}_offsets", np.dtype(np.int64)).add(np.zeros(1, np.int64))
                self._array(name, np.dtype(_item_type(schema.field(name).type)))

    def write(self, batch: pa.RecordBatch) -> None:
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if _is_flat(column.type):
                values, lengths = _flat(column)
                ends = self._arrays[f"{name}_offsets"]
                ends.add(ends.last + np.cumsum(lengths))
                self._arrays[name].add(values)
                continue
            kind = np.dtype(column.type.to_pandas_dtype())
            there = column.is_valid().to_numpy(zero_copy_only=False)
            fill: Any = np.nan if kind.kind == "f" else False if kind.kind == "b" else 0
            self._array(name, kind).add(pc.fill_null(column, fill).to_numpy(zero_copy_only=False))
            if kind.kind != "f" and (f"{name}_valid" in self._arrays or not there.all()):
                known = self._array(f"{name}_valid", np.dtype(bool))
                known.add(np.concatenate([np.ones(self._rows - known.count, bool), there]))
        self._rows += batch.num_rows

    def close(self) -> None:
        with zipfile.ZipFile(self._path, "w", zipfile.ZIP_DEFLATED) as made:
            for name, array in self._arrays.items():
                made.write(array.close(), f"{name}.npy")
                array.path.unlink()

    def _array(self, name: str, kind: np.dtype[Any]) -> _GrowingArray:
        if name not in self._arrays:
            self._arrays[name] = _GrowingArray(self._path.with_name(f"{self._path.name}.{name}.npy"), kind)
        return self._arrays[name]


class _GrowingArray:
    """A .npy file whose length is known at its end. count: of its values; last: the last one"""

    def __init__(self, path: Path, kind: np.dtype[Any]) -> None:
        self.path, self.count, self.last = path, 0, 0
        self._kind = kind
        path.touch()
        with path.open("r+b") as file:
            self._write_header(file)

    def add(self, values: npt.NDArray[Any]) -> None:
        with self.path.open("ab") as file:  # opened each time: there are more columns than open files
            file.write(np.ascontiguousarray(values, self._kind).data)
        self.count += len(values)
        self.last = int(values[-1]) if len(values) and self._kind.kind == "i" else self.last

    def close(self) -> Path:
        with self.path.open("r+b") as file:
            self._write_header(file)
        return self.path

    def _write_header(self, file: BinaryIO) -> None:
        # NumPy pads the header so that it is as long whatever the length of the array.
        about = {"descr": np.lib.format.dtype_to_descr(self._kind), "fortran_order": False, "shape": (self.count,)}
        np.lib.format.write_array_header_1_0(file, about)


TABLE_FILES: dict[str, Callable[[Path, pa.Schema], TableFile]] = {
    "csv": CsvFile,
    "parquet": ParquetFile,
    "npz": NpzFile,
}


def _is_flat(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_string(kind) or pa.types.is_large_binary(kind))


def _item_type(kind: pa.DataType) -> Any:
    return kind.value_type.to_pandas_dtype() if _is_numbers(kind) else np.uint8


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


def _text_type(kind: pa.DataType) -> pa.DataType:
    return pa.string() if _is_flat(kind) else kind


def _as_text(column: pa.Array) -> pa.Array:
    if pa.types.is_list(column.type):
        return pa.array([None if row is None else json.dumps(row) for row in column.to_pylist()], pa.string())
    if pa.types.is_large_binary(column.type):
        return pa.array([None if row is None else row.hex() for row in column.to_pylist()], pa.string())
    return column
