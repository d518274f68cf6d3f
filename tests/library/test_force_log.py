"""Logs of a force: tables as scales and loggers write them, recordings and their exports; what is no log is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deformscope as ds
from deformscope.config.calibrate import PushFlags
from deformscope.runs.force_log import read_force
from deformscope.stages.materials.press_cycle import PressForce
from tests.library.test_materials import recorded

TIMES = np.arange(100) / 10.0
PRESS = np.clip(TIMES - 4.0, 0.0, 2.0)
"""Newtons, from 4 s on."""


def read(path: Path, **more: Any) -> PressForce:
    return read_force(PushFlags.of(force=str(path), **more))


def written(
    path: Path, header: str, factor: float = 1.0, time_factor: float = 1.0, form: str = "{:.6f},{:.6f}"
) -> Path:
    rows = [form.format(time_factor * t, factor * n + 0.7) for t, n in zip(TIMES, PRESS, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("header", "factor", "time_factor"),
    [
        ("time [s],force [N]", 1.0, 1.0),
        ("time_s,force_n", 1.0, 1.0),
        ("t_ms,force_N", 1.0, 1e3),
        ("time_s,weight_g", 1.0 / 9.80665e-3, 1.0),
        ("time [s],load [kg]", 1.0 / 9.80665, 1.0),
        ("time_s,Fz_n", -1.0, 1.0),
    ],
)
def test_columns_and_units_are_those_of_the_header(
    tmp_path: Path, header: str, factor: float, time_factor: float
) -> None:
    found = read(written(tmp_path / "log.csv", header, factor, time_factor))
    np.testing.assert_allclose(found.time_s, TIMES, atol=1e-9)
    np.testing.assert_allclose(found.force_n, PRESS, atol=1e-4)


def test_a_column_and_its_unit_are_chosen(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", "time_s,scale,other_n", 1.0 / 9.80665e-3, form="{0:.3f},{1:.3f},{1:.3f}")
    found = read(path, force_column="scale", force_unit="g")
    np.testing.assert_allclose(found.force_n, PRESS, atol=1e-4)


def test_a_spreadsheets_table(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{t:.1f};{n:.4f}".replace(".", ",") for t, n in zip(TIMES, PRESS, strict=True)]
    path.write_text("\n".join(["Kitchen scale", "Zeit [s];Kraft [N]", *rows]) + "\n", encoding="utf-8")
    np.testing.assert_allclose(read(path).force_n, PRESS, atol=1e-4)


@pytest.mark.parametrize(
    ("header", "more", "said"),
    [
        ("time_s,weight", {}, "one column with the force"),
        ("time_s,weight", {"force_column": "weight"}, "the unit of the force"),
        ("time,force_n", {}, "a column with the time"),
        ("when,force_n", {}, "a column with the time"),
        ("time_s,force_n", {"force_column": "load"}, "one column with the force"),
    ],
)
def test_what_a_table_does_not_say_is_asked_for(tmp_path: Path, header: str, more: dict[str, Any], said: str) -> None:
    with pytest.raises(ds.InputError, match=said):
        read(written(tmp_path / "log.csv", header), **more)


def test_a_table_of_few_readings_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time_s,force_n\n0.0,0.0\n1.0,2.0\n", encoding="utf-8")
    with pytest.raises(ds.InputError, match="5 readings"):
        read(tmp_path / "log.csv")


@pytest.mark.parametrize("kind", ["recording", "export"])
def test_a_recording_and_its_export_have_the_same_force(tmp_path: Path, kind: str) -> None:
    path = recorded(tmp_path / "rig.rrd", "tip")
    if kind == "export":
        ds.export(path, to="csv", out=tmp_path / "tables")
        path = tmp_path / "tables"
    found = read(path)
    at = found.time_s[0] + np.array([0.1, 0.55, 0.9])
    np.testing.assert_allclose(found.at(at), [0.0, 2.0, 0.0], atol=1e-6)


def test_one_of_several_sensors_is_named(tmp_path: Path) -> None:
    path = recorded(tmp_path / "rig.rrd", "palm", "tip")
    with pytest.raises(ds.InputError, match="--force-sensor palm"):
        read(path)
    assert read(path, force_sensor="tip").force_n.max() == pytest.approx(2.0)
