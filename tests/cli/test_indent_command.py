"""`deformscope indent` as a user runs it: tables of several programs, recordings, maps, and what it refuses."""

import json
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import deformscope as ds
from deformscope.arrays import FloatArray
from deformscope.cli import main
from tests.cases import Capture

ROOT = Path(__file__).parents[2]
YOUNG = 20e3
SPHERE = ["--tip", "sphere:0.02", "--poisson", "0.3"]


def curve(seed: int = 0, young: float = YOUNG) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, depth and force: a ball of 2 cm on a half-space, down and up."""
    way = np.linspace(-0.001, 0.002, 400)
    z = np.append(way, way[::-1])
    force = 4 / 3 * young / 0.91 * 0.1 * np.maximum(z, 0.0) ** 1.5
    force += 0.0005 * np.random.default_rng(seed).standard_normal(len(z))
    return 0.01 * np.arange(len(z)), z + 0.003, force


def write(path: Path, header: str, *columns: FloatArray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


def found(args: list[str], capsys: Capture) -> dict:  # type: ignore[type-arg]
    assert main(["indent", *args, "--viewer", "none", "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


def test_a_test_machines_text_is_read_as_it_is(tmp_path: Path, capsys: Capture) -> None:
    time, z, force = curve()
    rows = [f"{a:.2f};{1e3 * b:.5f};{c:.5f}".replace(".", ",") for a, b, c in zip(time, z, force, strict=True)]
    head = "Prüfprotokoll;\nProbe 1;\n\nPrüfzeit;Standardweg;Standardkraft\ns;mm;N\n"
    path = tmp_path / "test.txt"
    path.write_text(head + "\n".join(rows) + "\n", encoding="latin-1")
    outputs = {one: tmp_path / f"out.{one}" for one in ("png", "html", "rrd")}
    flags = ["--picture", str(outputs["png"]), "--report", str(outputs["html"]), "--record", str(outputs["rrd"])]
    result = found([str(path), *SPHERE, *flags], capsys)["curves"][0]
    assert result["modulus_pa"] == pytest.approx(YOUNG, rel=0.02)
    assert result["modulus_interval_pa"][0] < YOUNG < result["modulus_interval_pa"][1]
    assert result["contact_m"] == pytest.approx(0.003, abs=2e-5)
    assert result["rate_n_per_s"] > 0.0
    assert all(one.stat().st_size > 1000 for one in outputs.values())
    assert "Young&#x27;s modulus" in outputs["html"].read_text(encoding="utf-8")
    assert main(["verify", str(outputs["rrd"])]) == 0


@pytest.mark.parametrize(
    ("header", "factors", "flags"),
    [
        ("Time (s),Extension (mm),Load (N)", (1.0, 1e3, 1.0), []),
        ("t [ms],piezo height [nm],force [nN]", (1e3, 1e9, 1e9), []),
        ("time_s,depth_m,force_n", (1.0, 1.0, 1.0), []),
        ("time_ms,depth_mm,load_g", (1e3, 1e3, 1 / 9.80665e-3), []),
        ("t,depth,force", (1.0, 1e3, 1.0), ["--force-column", "force=N", "--depth-column", "depth=mm"]),
        ("z [mm],Fz [N],Fx [N]", (1.0, 1e3, -1.0), ["--force-column=-Fz [N]"]),
    ],
)
def test_columns_are_found_by_units_and_names_or_said(
    header: str, factors: tuple[float, ...], flags: list[str], tmp_path: Path, capsys: Capture
) -> None:
    time, z, force = curve()
    columns = [factors[0] * time, factors[1] * z, factors[2] * force]
    if header.startswith("z"):
        columns = [columns[1], columns[2], time]
    path = write(tmp_path / "curve.csv", header, *columns)
    assert found([str(path), *SPHERE, *flags], capsys)["curves"][0]["modulus_pa"] == pytest.approx(YOUNG, rel=0.02)


def jpk(path: Path, *, tip: bool = False) -> None:
    """A force curve as JPK's software exports it as text: a bead of 5 um on a gel of 1 kPa, with a cantilever of
    0.02 N/m."""
    way = np.linspace(-2e-6, 1.5e-6, 500)
    force = 4 / 3 * 1e3 / 0.75 * np.sqrt(2.5e-6) * np.maximum(way, 0.0) ** 1.5
    force += 2e-12 * np.random.default_rng(3).standard_normal(len(way))
    height = 60e-6 - way - (0 if tip else 1) * force / 0.02
    parts = ["# xPosition: 0.001", "#", "# approachID: 1", ""]
    for segment, order in (("extend", slice(None)), ("retract", slice(None, None, -1))):
        parts += [f"# segment: {segment}", f"# columns: vDeflection {'verticalTipPosition' if tip else 'height'} time"]
        parts += ['# fancyNames: "Vertical deflection" "Height (measured)" "Segment Time"', "# sensitivity: 7.4E-8"]
        parts += ["# springConstant: 0.02", "# units: N m s", "#"]
        parts += [
            f"{a:.7E} {b:.9E} {c:.4f}"
            for a, b, c in zip(force[order], height[order], 0.001 * np.arange(500), strict=True)
        ]
        parts.append("")
    path.write_text("\n".join(parts))


@pytest.mark.parametrize("tip", [True, False])
def test_the_segments_of_a_force_curve_are_one_curve(tip: bool, tmp_path: Path, capsys: Capture) -> None:
    jpk(tmp_path / "force.txt", tip=tip)
    asked = [str(tmp_path / "force.txt"), "--tip", "sphere:5e-6", "--poisson", "0.5"]
    asked += [f"--depth-column=-{'verticalTipPosition' if tip else 'height'}"]
    if not tip:  # without the cantilever's give the gel would be too soft
        assert main(["indent", *asked]) == 2
        assert "try: --machine-n-per-mm 2e-05, as the file states" in capsys.readouterr().err
        asked += ["--machine-n-per-mm", "2e-5"]
    result = found(asked, capsys)["curves"][0]
    assert result["modulus_pa"] == pytest.approx(1e3, rel=0.04)
    assert result["unloading_pa"] == pytest.approx(1e3, rel=0.15)
    assert result["loss"] == pytest.approx(0.0, abs=0.02)


def test_segments_of_other_columns_are_refused(tmp_path: Path, capsys: Capture) -> None:
    jpk(tmp_path / "force.txt")
    text = (tmp_path / "force.txt").read_text().rpartition("# columns: vDeflection height")
    (tmp_path / "force.txt").write_text(f"{text[0]}# columns: height vDeflection{text[2]}")
    assert main(["indent", str(tmp_path / "force.txt"), "--tip", "sphere:5e-6"]) == 2
    assert "segments of the same columns; got vDeflection height time, or height vDefl" in capsys.readouterr().err


def workbook(path: Path, sheets: dict[str, list[list[object]]]) -> Path:
    """An .xlsx of sheets."""
    head = "<?xml version='1.0'?>"
    main_ns = "xmlns='http://schemas.openxmlformats.org/spreadsheetml/2006/main'"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    relations = "xmlns='http://schemas.openxmlformats.org/package/2006/relationships'"
    listed = "".join(f"<sheet name='{one}' sheetId='{at}' r:id='r{at}'/>" for at, one in enumerate(sheets, 1))
    linked = "".join(
        f"<Relationship Id='r{at}' Type='{office}/worksheet' Target='worksheets/sheet{at}.xml'/>"
        for at in range(1, len(sheets) + 1)
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as book:
        root = f"<Relationship Id='b' Type='{office}/officeDocument' Target='xl/workbook.xml'/>"
        book.writestr("_rels/.rels", f"{head}<Relationships {relations}>{root}</Relationships>")
        book.writestr(
            "xl/workbook.xml", f"{head}<workbook {main_ns} xmlns:r='{office}'><sheets>{listed}</sheets></workbook>"
        )
        book.writestr("xl/_rels/workbook.xml.rels", f"{head}<Relationships {relations}>{linked}</Relationships>")
        for at, rows in enumerate(sheets.values(), 1):
            cells = (
                "".join(
                    f"<c t='inlineStr'><is><t>{one}</t></is></c>" if isinstance(one, str) else f"<c><v>{one}</v></c>"
                    for one in row
                )
                for row in rows
            )
            data = "".join(f"<row>{one}</row>" for one in cells)
            book.writestr(
                f"xl/worksheets/sheet{at}.xml", f"{head}<worksheet {main_ns}><sheetData>{data}</sheetData></worksheet>"
            )
    return path


def test_sheets_of_a_workbook_are_places(tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("python_calamine")
    sheets: dict[str, list[list[object]]] = {"Résultats": [["Fmax", "dL"], ["N", "mm"], [1.5, 2.0], [1.25, 2.5]]}
    for number in range(3):
        rows = np.column_stack(curve(number)) * [1.0, 1e3, 1.0]
        sheets[f"FF{number}"] = [[f"FF{number}"] * 3, ["Temps d'essai", "Allongement", "Force standard"]]
        sheets[f"FF{number}"] += [["s", "mm", "N"], *rows[:700].tolist(), [" ", " ", " "], *rows[700:].tolist()]
    path = workbook(tmp_path / "zwick.xlsx", sheets)
    result = found([f"{path}#FF[01]", *SPHERE], capsys)
    assert [one["name"] for one in result["curves"]] == ["zwick.xlsx/FF0", "zwick.xlsx/FF1"]
    assert result["curves"][0]["rate_n_per_s"] > 0.0
    assert result["together"]["modulus_pa"] == pytest.approx(YOUNG, rel=0.02)
    assert main(["indent", f"{path}#RDG", *SPHERE]) == 2
    assert "expected a sheet out of Résultats, FF0, FF1, FF2; got RDG" in capsys.readouterr().err
    (tmp_path / "bad.xlsx").write_bytes(path.read_bytes()[:500])
    assert main(["indent", str(tmp_path / "bad.xlsx"), *SPHERE]) == 2
    assert "expected a workbook" in capsys.readouterr().err


def test_a_workbook_without_its_package_names_it(tmp_path: Path, capsys: Capture, monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    assert main(["indent", str(workbook(tmp_path / "a.xlsx", {"A": [["t"]]})), *SPHERE]) == 2
    assert "try: pip install 'deformscope[excel]'" in capsys.readouterr().err


def test_several_sources_are_places_of_one_sample(tmp_path: Path, capsys: Capture) -> None:
    paths = []
    for number, factor in enumerate((1.0, 1.1, 0.9)):
        columns = curve(number, factor * YOUNG)
        paths.append(str(write(tmp_path / f"place-{number}.csv", "time [s],depth [m],force [N]", *columns)))
    result = found([*paths, *SPHERE], capsys)
    assert [one["name"] for one in result["curves"]] == ["place-0.csv", "place-1.csv", "place-2.csv"]
    together = result["together"]
    assert together["modulus_pa"] == pytest.approx(YOUNG, rel=0.04)
    assert together["scatter"] == pytest.approx(0.1, abs=0.03)
    assert together["own_sd"] < 0.02


def test_touches_of_an_exploration_have_moduli(capsys: Capture) -> None:
    recording = str(ROOT / "recordings" / "explore.rrd")
    result = found([recording, "--tip", "sphere:0.02", "--thickness-m", "0.05", "--bonded", "--poisson", "0.3"], capsys)
    touches = [one for one in ds.open_recording(recording).results() if type(one).__name__ == "TouchEstimate"]
    assert len(result["curves"]) == len(touches) > 1
    for one, touch in zip(result["curves"], touches, strict=True):
        assert touch.modulus_pa is not None  # type: ignore[attr-defined]
        assert one["modulus_pa"] == pytest.approx(touch.modulus_pa, rel=0.35)  # type: ignore[attr-defined]


def test_a_map_gives_the_force_and_the_pose_of_others(tmp_path: Path, capsys: Capture) -> None:
    time, z, force = curve()
    twice = [np.append(time, time + 9.0), np.append(z, z), np.append(force, force)]
    way = np.column_stack([0.4 + 0.6 * twice[1], 0.1 + 0 * twice[1], 0.3 - 0.8 * twice[1]])
    columns = twice[0], -0.6 * twice[2], 0 * twice[2], 0.8 * twice[2]
    write(tmp_path / "log.csv", "t,Fx,Fy,Fz,x,y,z,rx,ry,rz", *columns, *way.T, *np.zeros_like(way).T)
    streams = (
        '[[streams]]\ndevice = "tip"\nkind = "wrench"\ntopics = ["log.csv"]\ntime = "t"\ntime_unit = "s"\n'
        'columns = {"force_x_n" = "Fx", "force_y_n" = "Fy", "force_z_n" = "Fz"}\n'
        'units = {"Fx" = "N", "Fy" = "N", "Fz" = "N"}\n'
        '[[streams]]\ndevice = "arm"\nkind = "arm"\ntopics = ["log.csv"]\ntime = "t"\ntime_unit = "s"\n'
        'columns = {"position_x_m" = "x", "position_y_m" = "y", "position_z_m" = "z",'
        ' "rotation_x_rad" = "rx", "rotation_y_rad" = "ry", "rotation_z_rad" = "rz"}\nrotation = "vector"\n'
        'units = {"x" = "m", "y" = "m", "z" = "m", "rx" = "rad", "ry" = "rad", "rz" = "rad"}\n'
    )
    (tmp_path / "map.toml").write_text(streams)
    result = found([str(tmp_path / "log.csv"), *SPHERE, "--map", str(tmp_path / "map.toml")], capsys)
    assert [one["name"] for one in result["curves"]] == ["log.csv, touch 1", "log.csv, touch 2"]
    for one in result["curves"]:
        assert one["modulus_pa"] == pytest.approx(YOUNG, rel=0.03)


def test_a_recording_is_replayed_drawn_and_listed(tmp_path: Path, capsys: Capture, monkeypatch: Any) -> None:
    """The source may be gone: its curves are in the recording."""
    header = "time [s],depth [m],force [N]"
    paths = [write(tmp_path / f"{one}.csv", header, *curve(one)) for one in range(2)]
    record, page, again = tmp_path / "r.rrd", tmp_path / "r.html", tmp_path / "again.rrd"
    first = found([*map(str, paths), *SPHERE, "--record", str(record)], capsys)
    for one in paths:
        one.unlink()
    flags = ["--viewer", "none", "--json", "-", "--record", str(again)]
    assert main(["replay", str(record), *flags]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == first
    assert "replay: identical to the recorded numbers" in err
    assert main(["replay", str(again), "--viewer", "none"]) == 0  # what a replay records is as good
    capsys.readouterr()
    assert main(["report", str(record), "--out", str(page), "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["figures"] == ["Force over depth since contact, with the fitted law"]
    assert "All curves together" in page.read_text()
    assert "data:image/png" in page.read_text()
    assert main(["catalog", "compare", str(record), str(again), "--json", "-"]) == 0
    results = {one["name"]: one for one in json.loads(capsys.readouterr().out)["results"]}
    assert results["modulus_pa"]["first"]["value"] == first["together"]["modulus_pa"]
    monkeypatch.setattr("deformscope.stages.poke.indentation.LAW_SD", 0.5)
    assert main(["replay", str(record), "--viewer", "none"]) == 2
    assert "numbers that differ by" in capsys.readouterr().err


def test_a_script_has_the_same_from_arrays() -> None:
    time, z, force = curve()
    result = ds.indent({"depth_m": z, "force_n": force, "time_s": time}, tip="sphere:0.02", poisson="0.3")
    assert result.modulus_pa == pytest.approx(YOUNG, rel=0.02)
    assert result.interval_pa == result.curves[0].modulus_interval_pa
    assert "Young's modulus" in str(result)
    assert result._repr_html_().count("<img") == 1
    pair = [{"depth_m": z, "force_n": force}] * 2
    assert ds.indent(pair, tip="sphere:0.02").together is not None
    with pytest.raises(ds.InputError, match="expected depth_m, force_n"):
        ds.indent({"depth_m": z}, tip="sphere:0.02")


@pytest.mark.parametrize(
    ("header", "flags", "words"),
    [
        ("t,depth,force", [], "expected the unit of column force: N, mN"),
        ("time [s],depth [m],force [N]", ["--depth-column", "depth [m]=s"], "expected the unit of column depth [m]: m"),
        ("time [s],depth [m],force [N]", ["--force-column", "load"], "expected --force-column out of time [s]"),
        ("Fx [N],depth [m],Fz [N]", [], "expected one column of force; got Fx [N], Fz [N]"),
        ("time [s],depth [m],force [N]", ["--thickness-m", "0.01"], "--thickness-m with --bonded or --sliding"),
        ("time [s],depth [m],force [N]", ["--width-m", "0.012"], "expected sides far from the contact"),
    ],
)
def test_what_is_missing_is_asked_for_in_one_line(
    header: str, flags: list[str], words: str, tmp_path: Path, capsys: Capture
) -> None:
    path = write(tmp_path / "curve.csv", header, *curve())
    assert main(["indent", str(path), *SPHERE, *flags]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert len(said.splitlines()) <= 5


def test_what_is_no_poke_of_this_tip_is_refused_in_one_line(tmp_path: Path, capsys: Capture) -> None:
    time, z, force = curve()
    twice = np.append(time, time + 9.0), np.append(z, z), np.append(force, 3.0 * force)
    cases: list[tuple[tuple[FloatArray, ...], list[str], str]] = [
        (twice, [], "expected one poke in a curve; got 2 | try: a file of each, with its tip"),
        ((time, z, 0.0 * force), [], "a depth and a force that change"),
        ((time, 0.0 * z, force), [], "a depth and a force that change"),
        ((time[:400], z[400:], force[400:]), [], "try: the way in too, with air before it"),
        ((time, z, -force), [], "try: a minus before the column (--force-column=-NAME)"),
        ((time, z, force), ["--machine-n-per-mm", "0.01"], "a machine stiffer than the curve; got 0.01 N/mm"),
        ((time, z, force), ["--thickness-m", "10", "--bonded"], "expected a --thickness-m below 1 m; got 10"),
    ]
    for columns, flags, words in cases:
        path = write(tmp_path / "curve.csv", "time [s],depth [m],force [N]", *columns)
        assert main(["indent", str(path), *SPHERE, *flags]) == 2
        said = capsys.readouterr().err
        assert words in said
        assert len(said.splitlines()) == 1


def test_columns_of_a_parquet_table_have_their_units_in_their_names(tmp_path: Path, capsys: Capture) -> None:
    time, z, force = curve()
    named = {"time [s]": time, "depth (mm)": 1e3 * z, "force [N]": force}
    pq.write_table(pa.table(named), tmp_path / "curve.parquet")
    result = found([str(tmp_path / "curve.parquet"), *SPHERE], capsys)["curves"][0]
    assert result["modulus_pa"] == pytest.approx(YOUNG, rel=0.02)


@pytest.mark.parametrize("tip", ["sphere", "sphere:20", "flat:0.01", "cone:95", "wedge:0.1", "sphere:-1"])
def test_a_tip_that_is_none_is_refused(tip: str, tmp_path: Path, capsys: Capture) -> None:
    path = write(tmp_path / "curve.csv", "time [s],depth [m],force [N]", *curve())
    assert main(["indent", str(path), "--tip", tip]) == 2
    assert "sphere:0.02, disc:0.01, flat:0.02x0.01 or cone:70" in capsys.readouterr().err
