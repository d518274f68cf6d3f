"""Tables of results: made row by row, stored as Parquet, and filtered by a condition that can have no other effect."""

import ast
import difflib
import json
import operator
from collections.abc import Callable, Iterable, Mapping
from functools import reduce
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from deformscope.errors import InputError
from deformscope.file_io import replacing

BATCH = 2000
"""Number of rows that are held as Python objects."""
_OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: lambda a, b: a.is_null() if b is None else a == b,
    ast.NotEq: lambda a, b: a.is_valid() if b is None else a != b,
}


def make_table(rows: Iterable[Mapping[str, Any]], types: Mapping[str, pa.DataType] | None = None) -> pa.Table:
    """A table with the columns of all rows; a column whose values have several types becomes text. types: types of
    columns that always exist"""
    batches, held = [pa.table({name: pa.array([], kind) for name, kind in (types or {}).items()})], list[Any]()
    for row in rows:
        held.append(row)
        if len(held) == BATCH:
            batches.append(_batch(held))
            held = []
    batches.append(_batch(held))
    names = dict.fromkeys(name for batch in batches for name in batch.schema.names)
    return pa.table({name: _column([_part(batch, name) for batch in batches]) for name in names})


def _batch(rows: list[Mapping[str, Any]]) -> pa.Table:
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: _array([row.get(name) for row in rows]) for name in names})


def _array(values: list[Any]) -> pa.Array:
    try:
        return pa.array(values)
    except UnicodeEncodeError:  # of a name that is not UTF-8
        return pa.array([to_utf8(one) if isinstance(one, str) else one for one in values])
    except (pa.ArrowTypeError, pa.ArrowInvalid, OverflowError):
        return _text(values)


def _text(values: list[Any]) -> pa.Array:
    texts = [to_utf8(one) if isinstance(one, str) else None if one is None else json.dumps(one) for one in values]
    return pa.array(texts, pa.string())


def to_utf8(text: str) -> str:
    """A text of a table: bytes that are not UTF-8, as in names of files, are escapes."""
    return text.encode(errors="backslashreplace").decode()


def _part(batch: pa.Table, name: str) -> pa.ChunkedArray:
    return batch[name] if name in batch.schema.names else pa.chunked_array([pa.nulls(batch.num_rows)])


def _column(parts: list[pa.ChunkedArray]) -> pa.ChunkedArray:
    try:
        return pa.concat_tables([pa.table({"": one}) for one in parts], promote_options="permissive").column(0)
    except (pa.ArrowTypeError, pa.ArrowInvalid):
        return pa.chunked_array([_text(one.to_pylist()) for one in parts])


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table as Parquet."""
    with replacing(path) as file:
        pq.write_table(table, file, compression="zstd")


def read_table(path: Path) -> pa.Table:
    """Raises InputError if it is no Parquet."""
    try:
        return pq.read_table(path, partitioning=None)
    except (OSError, pa.ArrowException) as error:
        raise InputError("a table (.parquet)", " ".join(str(error).split())[:200], where=path) from error


def select_rows(table: pa.Table, where: str = "", sort: str = "") -> pa.Table:
    """The rows for which a condition holds, in the order of a column. Raises InputError for an unusable condition.

    where: columns compared with values, with `and`, `or`, `not`, `in` and brackets, as in Python. `"word" in column`
    looks within texts; a column may be named by the end of its name, if that is unique
    sort: a column, the largest first with a `-` before it"""
    if where:
        try:
            table = table.filter(_condition(ast.parse(where.strip(), mode="eval").body, table.schema.names))
        except SyntaxError as error:
            hint = 'stiffness < 0.5 and verdict == "identified"'
            raise InputError("a condition", f"{where!r} ({error.msg})", hint) from error
        except (pa.ArrowException, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
            raise InputError("a condition on these columns", " ".join(str(error).split())[:200], where=where) from error
    if sort:
        order = "descending" if sort.startswith("-") else "ascending"
        column = find_column(sort.removeprefix("-"), table.schema.names)
        table = table.take(pc.sort_indices(table[column], sort_keys=[("", order)]))
    return table


def find_column(name: str, names: list[str]) -> str:
    """The column of this name, or the only one that ends so. Raises InputError."""
    ends = [one for one in names if one.endswith(f".{name}")]
    if name in names or len(ends) == 1:
        return name if name in names else ends[0]
    near = difflib.get_close_matches(name, [*names, *(one.rpartition(".")[2] for one in names)], n=3)
    hint = ", ".join(ends or near or names[:8])
    raise InputError("a column of the table", f"{name!r}" + (", of which there are several" if ends else ""), hint)


def _condition(node: ast.expr, names: list[str]) -> Any:
    """Columns and conditions as Arrow's expressions, values unchanged."""
    match node:
        case ast.Constant(value) if value is None or isinstance(value, str | int | float):
            return value
        case ast.UnaryOp(ast.USub(), ast.Constant(value)) if isinstance(value, int | float):
            return -value
        case ast.Name() | ast.Attribute():
            return pc.field(find_column(ast.unparse(node), names))
        case ast.List(values) | ast.Tuple(values):
            return [_condition(one, names) for one in values]
        case ast.UnaryOp(ast.Not(), operand):
            return ~_condition(operand, names)
        case ast.BoolOp(op, values):
            join = operator.and_ if isinstance(op, ast.And) else operator.or_
            return reduce(join, (_condition(one, names) for one in values))
        case ast.Compare(left, operators, others):
            parts = [_condition(one, names) for one in (left, *others)]
            return reduce(operator.and_, map(_comparison, parts, operators, parts[1:]))
    raise InputError("columns compared with values", repr(ast.unparse(node)))


def _comparison(left: Any, by: ast.cmpop, right: Any) -> Any:
    if isinstance(by, ast.In | ast.NotIn) and isinstance(left, str) and isinstance(right, pc.Expression):
        found = pc.match_substring(right, left)
    elif isinstance(by, ast.In | ast.NotIn) and isinstance(right, list) and isinstance(left, pc.Expression):
        found = left.isin(right)
    elif type(by) in _OPERATORS and any(isinstance(one, pc.Expression) for one in (left, right)):
        if left is None:  # equality is the same either way
            left, right = right, left
        if right is None and not isinstance(by, ast.Eq | ast.NotEq):
            raise InputError("== None or != None", "an order with None")
        return _OPERATORS[type(by)](left if isinstance(left, pc.Expression) else pc.scalar(left), right)
    else:
        raise InputError("columns compared with values", "something else")
    return ~found if isinstance(by, ast.NotIn) else found
