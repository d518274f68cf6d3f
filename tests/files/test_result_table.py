"""Tables of results: columns of any results, and conditions that can do nothing but compare."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from deformscope.errors import InputError
from deformscope.files.result_table import BATCH, make_table, read_table, select_rows, write_table
from deformscope.results.render import cells_of, reported, to_cells


@dataclass(frozen=True)
class Bulge:
    """height_m: as it was seen."""

    height_m: float = field(metadata=reported("height", unit="m"))
    height_m_interval: tuple[float, float] = field(metadata=reported())
    seen: str = field(metadata=reported(key="camera.seen"))


def test_what_a_result_declares_becomes_columns() -> None:
    assert cells_of(Bulge(0.5, (0.25, 0.75), "twice")) == {
        "height_m": 0.5,
        "height_m_low": 0.25,
        "height_m_high": 0.75,
        "camera.seen": "twice",
    }


def test_json_becomes_columns() -> None:
    found = {
        "parameter": "beta",
        "value": 0.5,
        "interval": [0.25, 0.75],
        "modulus_pa": 2.0,
        "modulus_interval_pa": [1.0, 3.0],
        "rate_n_per_s": 5.0,
        "rate_interval": None,
        "size_mm": 4.0,
        "size_interval": [3.0, 5.0],
        "noise": {"value": 1, "interval": [0, None]},
        "reasons": [{"code": "a"}, {"code": "b"}],
        "touches": [{"x": 1}, {"x": 2}, {"x": 3}],
        "curve": [1.0, 2.0, 3.0],
        "page": "x" * 1000,
        "converged": True,
    }
    assert to_cells(found, "fit.") == {
        "fit.parameter": "beta",
        "fit.beta": 0.5,
        "fit.beta_low": 0.25,
        "fit.beta_high": 0.75,
        "fit.modulus_pa": 2.0,
        "fit.modulus_pa_low": 1.0,
        "fit.modulus_pa_high": 3.0,
        "fit.rate_n_per_s": 5.0,
        "fit.rate_interval": None,
        "fit.size_mm": 4.0,
        "fit.size_mm_low": 3.0,
        "fit.size_mm_high": 5.0,
        "fit.noise": 1,
        "fit.noise_low": 0,
        "fit.noise_high": None,
        "fit.reasons": "a, b",
        "fit.touches": 3,
        "fit.converged": True,
    }


def test_rows_of_any_columns_and_kinds_make_a_table(tmp_path: Path) -> None:
    rows = [{"n": number, "mixed": number} for number in range(BATCH + 1)]
    rows += [{"mixed": "words", "late": 1.5}] * BATCH  # type: ignore[dict-item,list-item]
    write_table(make_table(rows, {"never": pa.string()}), tmp_path / "t.parquet")
    table = read_table(tmp_path / "t.parquet")
    assert table.num_rows == len(rows)
    assert table["n"].to_pylist()[: BATCH + 2] == [*range(BATCH + 1), None]
    assert table["mixed"].to_pylist() == [str(row["mixed"]) for row in rows]
    assert table["late"].null_count == BATCH + 1
    assert table["never"].null_count == len(rows)
    (tmp_path / "no.parquet").write_bytes(b"no table")
    with pytest.raises(InputError, match="a table"):
        read_table(tmp_path / "no.parquet")


@pytest.mark.parametrize(("first", "last"), [(True, 0.5), ([1, 2], "x"), (1, {"a": 2})])
def test_kinds_that_have_none_in_common_become_text_wherever_they_meet(first: Any, last: Any) -> None:
    for rows in ([{"a": first}] * BATCH + [{"a": last}], [{"a": first}, {"a": last}]):
        found = make_table(rows)["a"].to_pylist()
        assert [found[0], found[-1]] == [one if isinstance(one, str) else json.dumps(one) for one in (first, last)]


TABLE = make_table(
    [
        {"name": "a", "stiffness": 0.4, "verdict": "identified", "settings.fit.size": 3, "notes": "dropped it"},
        {"name": "b", "stiffness": 0.4, "verdict": "weak", "settings.fit.size": 4, "notes": None},
        {"name": "c", "stiffness": 0.9, "verdict": "identified", "settings.fit.size": 4, "notes": ""},
        {"name": "d", "stiffness": None, "verdict": None, "settings.fit.size": 5, "notes": "again"},
    ]
)


@pytest.mark.parametrize(
    ("where", "names"),
    [
        ('stiffness < 0.5 and verdict == "identified"', "a"),
        ("stiffness < 0.5 or size == 5", "abd"),
        ("not (stiffness < 0.5)", "c"),
        ("0.5 <= stiffness", "c"),
        ("3 < settings.fit.size < 5", "bc"),
        ("stiffness == None", "d"),
        ("None != stiffness", "abc"),
        ("stiffness != None and size != 4", "a"),
        ('verdict in ["weak", "none"]', "b"),
        ('"dropped" in notes', "a"),
        ("stiffness > -1", "abc"),
    ],
)
def test_conditions(where: str, names: str) -> None:
    assert "".join(select_rows(TABLE, where)["name"].to_pylist()) == names


def test_order() -> None:
    assert select_rows(TABLE, sort="-stiffness")["name"].to_pylist()[0] == "c"
    assert select_rows(TABLE, "stiffness > 0", "fit.size")["name"].to_pylist() == ["a", "b", "c"]


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("stiffnes < 1", "stiffness"),
        ("stiffness <", "a condition"),
        ("open('x').write('y')", "columns compared with values"),
        ("__import__('os').system('true') == 0", "columns compared with values"),
        ("(lambda: 1)() == stiffness", "columns compared with values"),
        ("1 < 2", "columns compared with values"),
        ("stiffness < [1, 2]", "a condition on these columns"),
        ('stiffness < "much"', "a condition on these columns"),
        ("name", "a condition on these columns"),
        ("stiffness < None", "== None or != None"),
        ('size in [1, "b"]', "a condition on these columns"),
        ("3 in [1, 2]", "columns compared with values"),
        ('"x" in ["x"]', "columns compared with values"),
        ("size < 1" + 40 * "0", "a condition on these columns"),
        ("not " * 3000 + "name", "a condition on these columns"),
        ("name" + ".a" * 3000, "a condition on these columns"),
    ],
)
def test_what_is_no_condition_is_refused_in_a_line(where: str, words: str) -> None:
    with pytest.raises(InputError) as refused:
        select_rows(TABLE, where)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
