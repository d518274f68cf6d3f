"""Many small portions become few, and no row changes."""

from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa
import rerun as rr
from rerun.chunk import Chunk

from deformscope.log import merged
from deformscope.log.merged import Merged

SECOND = 1_000_000_000


def portion(path: str, first_ns: int, count: int = 10, names: Sequence[str] = ("a",)) -> Chunk:
    times_ns = first_ns + np.arange(count) * (SECOND // 10)
    columns = rr.DynamicArchetype.columns(archetype="Test", components=dict.fromkeys(names, times_ns))
    return Chunk.from_columns(path, [rr.TimeColumn("session", duration=times_ns.astype("timedelta64[ns]"))], columns)


def put_together(chunks: Sequence[Chunk]) -> Iterator[Chunk]:
    putting = Merged()
    for chunk in chunks:
        yield from putting.add(chunk)
    yield from putting.rest()


def rows(chunks: Sequence[Chunk], path: str) -> list[dict[str, object]]:
    return [row for chunk in chunks if chunk.entity_path == path for row in chunk.to_record_batch().to_pylist()]


def test_every_row_is_there_once_with_its_id_in_fewer_portions() -> None:
    given = [portion(path, at * SECOND) for at in range(90) for path in ("/w/0", "/w/1")]
    found = list(put_together(given))
    for path in ("/w/0", "/w/1"):
        assert rows(found, path) == rows(given, path)
        assert sum(chunk.entity_path == path for chunk in found) == 5
    assert len({str(chunk.id) for chunk in found}) == len(found)


def test_large_ones_go_on_at_once() -> None:
    large = portion("/w/0", 0, merged.MOST_BYTES // 8)
    assert [chunk.num_rows for chunk in Merged().add(large)] == [merged.MOST_BYTES // 8]


def test_results_of_an_exploration_are_few_portions() -> None:
    """One a touch would cost memory for all that it lasts."""
    paths = ("/exploration/touch", "/display/maps/beta", "/arm/arm")
    given = [portion(path, at * 13 * SECOND, 1) for at in range(277) for path in paths]
    found = list(put_together(given))
    for path in paths:
        assert rows(found, path) == rows(given, path)
    counts = [sum(chunk.entity_path == path for chunk in found) for path in paths]
    assert counts == [12, 12, 93]


def test_many_small_parts_are_a_portion() -> None:
    given = [portion("/display/peak", at * SECOND // 100, 1) for at in range(2 * merged.MOST_PARTS + 1)]
    assert [chunk.num_rows for chunk in put_together(given)] == [merged.MOST_PARTS, merged.MOST_PARTS, 1]


def test_other_columns_are_another_portion() -> None:
    given = [portion("/w/0", at * SECOND, names=("a",) if at % 2 else ("a", "b")) for at in range(6)]
    found = list(put_together(given))
    assert sorted(chunk.num_columns - min(c.num_columns for c in found) for chunk in found) == [0, 1]
    by_id = {row["rerun.controls.RowId"]: row for row in rows(found, "/w/0")}
    assert by_id == {row["rerun.controls.RowId"]: row for row in rows(given, "/w/0")}


def test_what_comes_late_is_not_called_sorted() -> None:
    """A viewer would search it wrongly."""
    (found,) = put_together([portion("/w/0", 5 * SECOND), portion("/w/0", 0)])
    field: pa.Field = found.to_record_batch().schema.field("session")
    assert b"rerun:is_sorted" not in field.metadata
    (found,) = put_together([portion("/w/0", 0), portion("/w/0", 5 * SECOND)])
    field = found.to_record_batch().schema.field("session")
    assert field.metadata[b"rerun:is_sorted"] == b"true"
