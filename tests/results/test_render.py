"""A quantity is declared once; JSON, units, rows and lines have it from there, in the order of the declarations."""

import json
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.results.render import (
    ReportedResult,
    derived,
    format_value,
    quantities,
    reported,
    to_columns,
    to_json,
    to_line,
    to_rows,
    units_of,
)


@dataclass(frozen=True, slots=True)
class Ends:
    value: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Inner:
    radius_m: float = field(metadata=reported(unit="m"))
    hidden: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown(ReportedResult):
    parameter: ClassVar[str] = "depth"
    depth_m: float = field(
        metadata=reported(
            "depth", unit="m", digits=".1f", scale=1e3, shown_unit="mm", interval="ends_m", line="dent {}"
        )
    )
    ends_m: tuple[float, float] = field(metadata=reported(key="depth.interval"))

    @property
    @derived("verdict", key=None, line="{}", caption="it is {}")
    def verdict_text(self) -> str:
        return "sure" if self.depth_m > 0.0 else ""

    speed_m_s: float | None = field(default=None, metadata=reported("speed", key="speed_mm_s", json_scale=1e3))
    inner: tuple[Inner, ...] = field(default=(), metadata=reported())
    force: Ends | None = field(default=None, metadata=reported("force", per_length=True, missing="no force"))
    error: float = field(default=2.0, metadata=reported("error", length=True))
    more: FloatArray | None = field(default=None, metadata=reported(optional=True))
    unit: str = "px"
    metres_per_unit: float | None = None


ONE = Shown(depth_m=0.0034, ends_m=(0.003, 0.004), inner=(Inner(0.02, "not told"),), more=np.array([1.0, np.nan]))


def test_json_is_in_the_order_of_the_declarations_and_made_of_what_json_has() -> None:
    expected = {
        "parameter": "depth",
        "depth_m": 0.0034,
        "depth": {"interval": [0.003, 0.004]},
        "speed_mm_s": None,
        "inner": [{"radius_m": 0.02}],
        "force": None,
        "error_m": None,
        "error_px": 2.0,
        "more": [1.0, None],
    }
    assert json.dumps(ONE.as_json()) == json.dumps(expected)
    assert "more" not in Shown(depth_m=0.1, ends_m=(0.0, 1.0)).as_json()
    assert units_of((Shown, Inner)) == {"depth_m": "m", "radius_m": "m"}


def test_words_have_number_unit_and_interval() -> None:
    assert format_value(ONE, "depth_m") == "3.4 mm (3.0 to 4.0)"
    assert to_rows(ONE, "verdict_text", "speed_m_s", "force", "error") == [
        ("verdict", "sure"),
        ("force", "no force"),
        ("error", "2 px"),
    ]
    assert (to_line(ONE), to_line(ONE, "caption")) == ("dent 3.4 mm (3.0 to 4.0), sure", "it is sure")


def test_a_force_per_length_follows_the_scale() -> None:
    scaled = Shown(depth_m=0.1, ends_m=(0.0, 1.0), force=Ends(2.0, (1.0, 3.0)), metres_per_unit=0.5)
    assert scaled.as_json()["force"] == {"value": 4.0, "interval": [2.0, 6.0]}
    assert format_value(scaled, "force") == "0.004 N/mm (0.002 to 0.006)"
    assert scaled.as_json()["error_m"] == 1.0


def test_what_is_not_declared_is_not_reported() -> None:
    assert [one.name for one in quantities(Inner)] == ["radius_m"]


def test_what_inherits_reports_what_its_base_does() -> None:
    @dataclass(frozen=True, slots=True, kw_only=True)
    class More(Shown):
        rate: float = field(default=1.0, metadata=reported())

    names = [one.name for one in quantities(Shown)]
    assert [one.name for one in quantities(More)] == [*names, "rate"]


@dataclass(frozen=True, slots=True)
class Scored:
    right: Ends | None = field(metadata=reported("right", "accuracy", interval_key="accuracy_interval", digits=".0%"))
    found: int = field(default=1, metadata=reported())


def test_a_number_and_its_interval_have_keys_and_columns_of_their_own() -> None:
    scores = [Scored(Ends(0.8, (0.7, 0.9))), Scored(Ends(0.5, (0.25, 0.75)), found=2)]
    assert to_columns(scores) == (("right", "interval"), [("80%", "70% to 90%"), ("50%", "25% to 75%")])
    assert to_json(scores[1]) == {"accuracy": 0.5, "accuracy_interval": [0.25, 0.75], "found": 2}
    assert to_json(Scored(None)) == {"accuracy": None, "accuracy_interval": None, "found": 1}
