"""Tables of results: made a row at a time, kept as Parquet, filtered by a condition that can do nothing else."""

from __future__ import annotations

import ast
import difflib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from deformscope.errors import InputError
from deformscope.file_io import replacing

BATCH = 2000
"""Rows that are held as Python's objects."""
_OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Lt: lambda a, b: a < b,
    ast.LtE: lambda a, b: a <= b,
    ast.Gt: lambda a, b: a > b,
    ast.GtE: lambda a, b: a >= b,
    ast.Eq: lambda a, b: a.is_null() if b is None else a == b,
    ast.NotEq: lambda a, b: a.is_valid() if b is None else a != b,
}


def make_table(rows: Iterable[Mapping[str, Any]], types: Mapping[str, pa.DataType] | None = None) -> pa.Table:
    """Rows with the columns of all of them; a column whose values are of several kinds becomes text.

    types: of columns that are there in any case
    """
    batches, held = [pa.table({name: pa.array([], kind) for name, kind in (types or {}).items()})], list[Any]()
    for row in rows:
        held.append(row)
        if len(held) == BATCH:
            batches.append(_batch(held))
            held = []
    batches.append(_batch(held))
    try:
        return pa.concat_tables(batches, promote_options="permissive")
    except (pa.ArrowTypeError, pa.ArrowInvalid):
        kinds: dict[str, set[pa.DataType]] = {}
        for batch in batches:
            for field in batch.schema:
                kinds.setdefault(field.name, set()).add(field.type)
        mixed = {name for name, some in kinds.items() if pa.string() in some and some - {pa.string(), pa.null()}}
        return pa.concat_tables([_as_text(batch, mixed) for batch in batches], promote_options="permissive")


def _batch(rows: list[Mapping[str, Any]]) -> pa.Table:
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: _array([row.get(name) for row in rows]) for name in names})


def _array(values: list[Any]) -> pa.Array:
    try:
        return pa.array(values)
    except (pa.ArrowTypeError, pa.ArrowInvalid, OverflowError):
        return pa.array([one if one is None or isinstance(one, str) else json.dumps(one) for one in values])


def _as_text(table: pa.Table, names: set[str]) -> pa.Table:
    for name in names & set(table.schema.names):
        table = table.set_column(table.schema.get_field_index(name), name, table[name].cast(pa.string()))
    return table


def write_table(table: pa.Table, path: Path) -> None:
    """As Parquet, in one go."""
    with replacing(path) as file:
        pq.write_table(table, file, compression="zstd")


def read_table(path: Path) -> pa.Table:
    """Raises InputError where it is no Parquet."""
    try:
        return pq.read_table(path, partitioning=None)
    except (OSError, pa.ArrowException) as error:
        raise InputError("a table (.parquet)", " ".join(str(error).split())[:200], where=path) from error


def select_rows(table: pa.Table, where: str = "", sort: str = "") -> pa.Table:
    """The rows for which a condition holds, in the order of a column. Raises InputError for what cannot be used.

    where: columns compared with values, with `and`, `or`, `not`, `in` and brackets, as Python has them; `"word" in
    column` looks within texts; a column may be named by the end of its name, where that is of one alone
    sort: a column, the largest first where a `-` stands before it
    """
    if where:
        try:
            tree = ast.parse(where.strip(), mode="eval").body
        except (SyntaxError, ValueError) as error:
            came = f"{where!r} ({error.args[0]})"
            raise InputError("a condition", came, 'stiffness < 0.5 and verdict == "identified"') from error
        condition = _condition(tree, table.schema.names, where)
        try:
            table = table.filter(condition)
        except (pa.ArrowException, TypeError) as error:
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


def _condition(node: ast.expr, names: list[str], whole: str) -> Any:
    match node:
        case ast.BoolOp(op, values):
            first, *rest = (_condition(one, names, whole) for one in values)
            for one in rest:
                first = first & one if isinstance(op, ast.And) else first | one
            return first
        case ast.UnaryOp(ast.Not(), operand):
            return ~_condition(operand, names, whole)
        case ast.Compare(left, operators, others):
            parts, found = [left, *others], None
            for number, operator in enumerate(operators):
                one = _comparison(parts[number], operator, parts[number + 1], names, whole)
                found = one if found is None else found & one
            return found
        case ast.Name() | ast.Attribute():
            return _operand(node, names, whole)
    raise _refused(node, whole)


def _comparison(left: ast.expr, operator: ast.cmpop, right: ast.expr, names: list[str], whole: str) -> Any:
    if isinstance(operator, ast.In | ast.NotIn):
        if isinstance(right, ast.List | ast.Tuple):
            values = [_operand(one, names, whole) for one in right.elts]
            found = _operand(left, names, whole).isin(values)
        elif isinstance(left, ast.Constant):
            found = pc.match_substring(_operand(right, names, whole), str(left.value))
        else:
            raise _refused(right, whole)
        return found if isinstance(operator, ast.In) else ~found
    if type(operator) not in _OPERATORS:
        raise _refused(left, whole)
    a, b = _operand(left, names, whole), _operand(right, names, whole)
    if isinstance(a, pc.Expression):
        return _OPERATORS[type(operator)](a, b)
    if not isinstance(b, pc.Expression):
        raise _refused(left, whole)
    return _OPERATORS[type(operator)](pc.scalar(a), b)


def _operand(node: ast.expr, names: list[str], whole: str) -> Any:
    match node:
        case ast.Constant(value) if value is None or isinstance(value, str | int | float):
            return value
        case ast.UnaryOp(ast.USub(), ast.Constant(value)) if isinstance(value, int | float):
            return -value
        case ast.Name() | ast.Attribute():
            return pc.field(find_column(_dotted(node, whole), names))
    raise _refused(node, whole)


def _dotted(node: ast.expr, whole: str) -> str:
    match node:
        case ast.Name(name):
            return name
        case ast.Attribute(value, attribute):
            return f"{_dotted(value, whole)}.{attribute}"
    raise _refused(node, whole)


def _refused(node: ast.expr, whole: str) -> InputError:
    return InputError("columns compared with values", repr(ast.get_source_segment(whole.strip(), node)), where=whole)
