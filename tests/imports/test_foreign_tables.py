"""Tables as other programs write them: read right, or refused by what is wrong with them; never other numbers."""

import io
import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from deformscope.cli import main
from deformscope.files import table_file
from deformscope.files.table_file import form_of, moment_ns, read_table
from deformscope.frames import WrenchFrame
from deformscope.imports.readers import open_reader
from tests.cases import Capture, each_once, slow
from tests.imports.test_files_and_folders import imported, refused
from tests.imports.test_import_mistakes import AXES, map_of
from tests.imports.test_importing import frames_of, inspected

TRUTH = np.array([[1.5, -20.25, 300.125 + at] for at in range(40)])
NAMES = ("t", "Fx", "Fy", "Fz")


def written(
    separator: str = ",", point: str = ".", *, names: tuple[str, ...] = NAMES, end: str = "\n", quote: str = ""
) -> str:
    """Forces (TRUTH) at 100 Hz."""
    rows = [[f"{value:.3f}".replace(".", point) for value in (at / 100, *row)] for at, row in enumerate(TRUTH)]
    return "".join(separator.join(f"{quote}{one}{quote}" for one in row) + end for row in (list(names), *rows))


def forces(path: Path, text: str | bytes, asked: str = "", *, status: int = 0, name: str = "t.csv") -> Any:
    """Forces (n, 3) and stamps [s] of a table that was imported."""
    source = path / name
    source.write_bytes(text if isinstance(text, bytes) else text.encode())
    asked = asked or map_of(AXES, topics=f'["{name}"]')
    frames: list[Any] = frames_of(imported(source, asked, path / "r.rrd", status))["tip"]
    assert all(isinstance(one, WrenchFrame) for one in frames)
    return np.array([one.force_n[0] for one in frames]), np.array([one.stamp.host_ns / 1e9 for one in frames])


GERMAN = written(";", ",", end="\r\n")
PREFACE = "".join(f"Line {at}: a, b; c\r\n" for at in range(10))
TABLES: dict[str, str | bytes] = {
    "commas": written(),
    "tabs": written("\t"),
    "tabs and decimal commas": written("\t", ","),
    "semicolons": written(";"),
    "semicolons and decimal commas": GERMAN,
    "bars": written("|", ","),
    "blanks": written(" "),
    "runs of blanks": written("    "),
    "blanks, decimal commas": written("  ", ",", end="\r\n"),
    "blanks before and after": "".join(f"   {line} \n" for line in written("\t ").splitlines()),
    "blanks after commas": written(", "),
    "quoted decimal commas": written(",", ",", quote='"'),
    "a byte order mark": "\ufeff" + written(),
    "UTF-16 of a spreadsheet": written("\t", ",", end="\r\n").encode("utf-16"),
    "Latin-1": f"Meßgerät\n{written(';', ',')}".encode("latin-1"),
    "lines before": PREFACE + GERMAN,
    "a comment as header": written(" ", names=("# t", *NAMES[1:])),
    "rows of units": written(";", ",").replace("\n", "\ns;N;N;N\n", 1),
    "rows of units in brackets": written("\t").replace("\n", "\n[s]\t[N]\t[N]\t[N]\n", 1),
    "three header rows": "clock,plate,plate,plate\n" + written().replace("\n", "\ns,N,N,N\n", 1),
    "a form of as many fields above": "PARAMETER;INFO;URL;\nThickness (mm);3;;\nStandard;D412;;\n;;;\n"
    + written(";", ","),
    "a separator after the last": written(";", ",", end=";\n"),
    "empty lines": "\n\n" + written().replace("\n", "\n\n") + "\n",
    "rows without values at the end": written(";", ",") + ";;;\n\n;;;\n",
    "no last line end": written().rstrip("\n"),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_is_read_whatever_its_separator(name: str, tmp_path: Path) -> None:
    found, times_s = forces(tmp_path, TABLES[name])
    np.testing.assert_array_equal(found, TRUTH)
    np.testing.assert_allclose(times_s, np.arange(len(TRUTH)) / 100, atol=1e-9)


@pytest.mark.parametrize("suffix", [".txt", ".tsv", ".dat", ".CSV"])
def test_a_table_is_one_whatever_its_ending(suffix: str, tmp_path: Path) -> None:
    found, _ = forces(tmp_path, written("\t", ","), name=f"t{suffix}")
    np.testing.assert_array_equal(found, TRUTH)


@pytest.mark.parametrize(
    ("separator", "last"),
    each_once([",", ";", "\t", " "], ["0.400;1.5", "0.400;1.5\n", "0.400;1.500;", "0.400;1.500;2.000;3.0", "0.4"]),
)
def test_a_last_line_that_was_cut_is_left_out_and_named(
    separator: str, last: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    cut = last.replace(";", separator)
    found, _ = forces(tmp_path, written(separator) + cut, status=3)
    np.testing.assert_array_equal(found, TRUTH)
    said = "".join(capfd.readouterr())
    assert f"its last line is cut and left out: {cut.strip()!r}" in said
    assert "tip: 1 readings lost" in said
    assert "its last line is cut" in inspected(tmp_path / "t.csv")


def test_a_table_with_errors_within_is_refused_by_its_row(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "t.csv"
    source.write_text(written().replace("0.200,1.500,", "0.200,") + written())
    error = refused(source, map_of(AXES), tmp_path / "r.rrd", capfd)
    assert "Expected 4 columns, got 3: 0.200,-20.250,320.125" in error
    assert "skip_rows" not in error


def test_skip_rows_is_advised_where_it_helps(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source, given = tmp_path / "t.csv", tmp_path / "given.toml"
    source.write_text(PREFACE + GERMAN)
    error = refused(source, "skip_rows = 3\n" + map_of(AXES), tmp_path / "r.rrd", capfd)
    assert "a header of 4 columns after skip_rows = 3 lines" in error
    assert "try: skip_rows = 10, or the map without it" in error
    found, _ = forces(tmp_path, PREFACE + GERMAN, "skip_rows = 10\n" + map_of(AXES))
    np.testing.assert_array_equal(found, TRUTH)
    given.write_text("skip_rows = 10\n")
    capfd.readouterr()
    assert main(["import", "--inspect", str(source), "--map", str(given)]) == 0
    said = capfd.readouterr().out
    assert "`;` between columns, decimal commas, 10 lines before its header, columns t, Fx, Fy, Fz" in said
    assert "skip_rows = 10" in said


def plates(first: str = "") -> str:
    rows = "".join(f"{at},0,1,2,3,10,20,30\n" for at in range(1, 30))
    return f"{first}Frame,Sub Frame,Fx,Fy,Fz,Fx,Fy,Fz\n,,N,N,N,N,N,N\n{rows}"


@pytest.mark.parametrize("to", ["csv", "parquet"])
def test_columns_of_one_name_have_their_place(to: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / f"t.{to}"
    if to == "csv":
        source.write_text(plates("Devices\n100\n,,Left,,,Right,,\n"))
    else:
        columns = [pa.array([float(one)] * 29) for one in (0, 0, 1, 2, 3, 10, 20, 30)]
        pq.write_table(pa.Table.from_arrays(columns, ["Frame", "Sub", *("Fx", "Fy", "Fz") * 2]), source)

    def asked(columns: dict[str, str]) -> str:
        text = map_of(columns, topics=f'["{source.name}"]').replace('time = "t"\ntime_unit = "s"', "rate_hz = 100")
        return text

    assert "Fx#3" in inspected(source)
    assert "Fx#6" in inspected(source)
    error = refused(source, asked(AXES), tmp_path / "r.rrd", capfd)
    assert "one of Fz#5, Fz#8: 2 columns are named Fz; got 'Fz'" in error
    for places, values in (("345", (1, 2, 3)), ("678", (10, 20, 30))):
        text = asked({f"force_{axis}_n": f"F{axis}#{at}" for axis, at in zip("xyz", places, strict=True)})
        frames: list[Any] = frames_of(imported(source, text, tmp_path / f"{places}.rrd"))["tip"]
        np.testing.assert_array_equal([one.force_n[0] for one in frames], [values] * 29)


@pytest.mark.parametrize("count", [2, 3, 4, 6, 7])
@pytest.mark.parametrize("form", ["fixed", "free", "text"])
def test_parts_of_a_list_are_named(count: int, form: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    values = [[at + part / 8 for part in range(count)] for at in range(5)]
    times = [at / 10 for at in range(5)]
    source = tmp_path / ("t.csv" if form == "text" else "t.parquet")
    if form == "text":
        source.write_text("t,wrench\n" + "".join(f'{at},"{row}"\n' for at, row in zip(times, values, strict=True)))
    else:
        kind = pa.list_(pa.float64(), *([count] if form == "fixed" else []))
        pq.write_table(pa.table({"t": times, "wrench": pa.array(values, kind)}), source)

    def asked(columns: dict[str, str]) -> str:
        units = {name: "N m" if "torque" in name else "N" for name in columns}
        text = map_of(columns, topics=f'["{source.name}"]')
        said = ", ".join(f'"{field}" = "{units[name]}"' for name, field in columns.items())
        return text.replace(text[text.index("units") : text.index("time =")], f"units = {{{said}}}\n")

    whole = asked({"force_n": "wrench"})
    if count == 3:
        found = frames_of(imported(source, whole, tmp_path / "r.rrd"))["tip"]
        np.testing.assert_array_equal([one.force_n[0] for one in found], values)  # type: ignore[union-attr]
    else:
        error = refused(source, whole, tmp_path / "r.rrd", capfd)
        assert f"parts of a list are named: force_x_n = \"NAME[0]\"; got '{count} numbers'" in error
    columns = {f"force_{axis}_n": f"wrench[{at}]" for at, axis in enumerate("xyz")}
    if count == 2:
        assert "wrench[2]: wrench has 2 parts" in refused(source, asked(columns), tmp_path / "s.rrd", capfd)
        return
    if count >= 6:
        columns |= {f"torque_{axis}_nm": f"wrench[{at}]" for at, axis in enumerate("xyz", 3)}
    frames: list[Any] = frames_of(imported(source, asked(columns), tmp_path / "s.rrd"))["tip"]
    np.testing.assert_array_equal([one.force_n[0] for one in frames], np.array(values)[:, :3])
    if count >= 6:
        np.testing.assert_array_equal([one.torque_nm[0] for one in frames], np.array(values)[:, 3:6])


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_load_cell_is_a_force_along_its_axis(axis: str, tmp_path: Path) -> None:
    text = "t;load\n" + "".join(f"{at},5;{at},25\n" for at in range(9))
    asked = map_of({f"force_{axis}_n": "load"}, unit="kgf")
    found, _ = forces(tmp_path, text, asked)
    expected = np.zeros((9, 3))
    expected[:, "xyz".index(axis)] = (np.arange(9) + 0.25) * 9.80665
    np.testing.assert_allclose(found, expected, rtol=1e-15)
    (tmp_path / "map.toml").write_text(asked)
    assert main(["import", "--inspect", str(tmp_path / "t.csv"), "--map", str(tmp_path / "map.toml")]) == 0


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("12:34:56.789", 45_296_789_000_000),
        ("12:34:56,789", 45_296_789_000_000),
        ("2026-11-29 12:34:56.789012345", 1_795_955_696_789_012_345),
        ("2026-11-29T12:34:56Z", 1_795_955_696_000_000_000),
        ("2026-11-29T13:34:56+01:00", 1_795_955_696_000_000_000),
        ("29.11.2026 12:34:56,5", 1_795_955_696_500_000_000),
    ],
)
@pytest.mark.parametrize("separator", [";", "\t"])
def test_times_of_day_and_dates_are_times(text: str, ns: int, separator: str, tmp_path: Path) -> None:
    assert moment_ns(text) == ns
    rows = "".join(separator.join((text, "1,5", "2,5", "3,5")) + "\n" for _ in range(4))
    source = tmp_path / "t.csv"
    source.write_text(separator.join(("Uhrzeit", "Fx", "Fy", "Fz")) + f"\n{rows}")
    assert 'time = "Uhrzeit"\ntime_unit = "ns"' in inspected(source)
    asked = map_of(AXES).replace('time = "t"\ntime_unit = "s"', 'time = "Uhrzeit"\ntime_unit = "ns"')
    frames: list[Any] = frames_of(imported(source, asked, tmp_path / "r.rrd"))["tip"]
    assert [one.stamp.host_ns for one in frames] == [ns] * 4


@pytest.mark.parametrize("kind", [pa.time64("ns"), pa.time32("ms"), pa.string(), pa.timestamp("us", "UTC")])
def test_times_of_a_parquet_are_times(kind: pa.DataType, tmp_path: Path) -> None:
    ns = [45_296_789_000_000 + at * 10**7 for at in range(3)]
    times = pa.array(ns).cast(pa.int64())
    made = [f"12:34:56.{789 + 10 * at}" for at in range(3)] if kind == pa.string() else None
    cast = (
        times.cast(pa.timestamp("ns", "UTC") if pa.types.is_timestamp(kind) else pa.time64("ns")).cast(kind)
        if made is None
        else pa.array(made)
    )
    pq.write_table(pa.table({"t": cast, **{f"F{axis}": [1.0, 2.0, 3.0] for axis in "xyz"}}), tmp_path / "t.parquet")
    asked = map_of(AXES, topics='["t.parquet"]')
    frames: list[Any] = frames_of(imported(tmp_path / "t.parquet", asked, tmp_path / "r.rrd"))["tip"]
    assert [one.stamp.host_ns for one in frames] == ns


@pytest.mark.parametrize("text", ["25:00:00", "12:60:00", "11/29/2026 12:34:56", "12:34:56 PM", "noon"])
def test_what_is_no_time_is_named(text: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "t.csv"
    source.write_text("t,Fx,Fy,Fz\n" + f"{text},1.5,2.5,3.5\n" * 3)
    assert text in refused(source, map_of(AXES), tmp_path / "r.rrd", capfd)


def test_numbers_that_are_text_are_shown_and_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "t.parquet"
    columns = {"t": [0.0, 0.1], "Fx": ["1,5", "1,6"], "Fy": ["2.5", "2.5"], "Fz": [3.0, 3.0]}
    pq.write_table(pa.table(columns), source)
    assert "columns t, Fx (text '1,5'), Fy (text '2.5'), Fz" in inspected(source)
    asked = map_of(AXES, topics='["t.parquet"]')
    error = refused(source, asked, tmp_path / "r.rrd", capfd)
    assert "text in Fx, where numbers were expected: '1,5'" in error
    grouped = tmp_path / "g.csv"
    grouped.write_text("t,Fx,Fy,Fz\n" + '0.1,"1,500",2.5,3.5\n' * 3)
    error = refused(grouped, map_of(AXES, topics='["g.csv"]'), tmp_path / "g.rrd", capfd)
    assert "text in Fx, where numbers were expected: '1,500'" in error
    mixed = tmp_path / "t.csv"
    mixed.write_text("t;Fx;Fy;Fz\n" + "0,1;1.234,5;2,5;3,5\n" * 3)
    assert "Fx (text '1.234,5')" in inspected(mixed)
    assert "text in Fx" in refused(mixed, map_of(AXES), tmp_path / "s.rrd", capfd)


@pytest.mark.parametrize("unit", ["mN", "V", "Nm"])
def test_units_of_the_header_hold(unit: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "t.csv"
    source.write_text(written("\t", names=("Time (ms)", *(f"F{axis} [{unit}]" for axis in "xyz"))))
    text = inspected(source)
    assert 'time = "Time (ms)"\ntime_unit = "ms"' in text
    named = {f"force_{axis}_n": f"F{axis} [{unit}]" for axis in "xyz"}
    asked = map_of(named, unit="N").replace('time = "t"', 'time = "Time (ms)"')
    error = refused(source, asked, tmp_path / "r.rrd", capfd)
    assert f'[{unit}]" of tip in the map: {"N m" if unit == "Nm" else unit}, as the source says' in error
    silent = asked.replace(asked[asked.index("units") : asked.index("time =")], "").replace('time_unit = "s"\n', "")
    if unit == "mN":
        found, times_s = forces(tmp_path, source.read_bytes(), silent)
        np.testing.assert_allclose(found, TRUTH / 1000, rtol=1e-15)
        np.testing.assert_allclose(times_s, np.arange(len(TRUTH)) / 1e5, atol=1e-9)
    else:
        assert "one of N, mN, kN, gf, kgf, lbf" in refused(source, silent, tmp_path / "s.rrd", capfd)


def test_a_map_is_judged_by_five_numbers_and_a_picture(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source, asked, png = tmp_path / "t.csv", tmp_path / "map.toml", tmp_path / "seen.png"
    source.write_text(written(";", ",").replace("0,000;1,500", "0,000;"))
    asked.write_text(map_of(AXES, 'nan = "keep"\n', unit="mN"))
    command = ["import", "--inspect", str(source), "--map", str(asked), "--picture", str(png)]
    assert main([*command, "--json", "-"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert found["map"].endswith(asked.read_text())
    (stream,) = found["streams"]
    assert stream["rate_hz"] == pytest.approx(100)
    assert stream["valid"] == pytest.approx(119 / 120)
    fz = stream["quantities"]["force_z"]
    assert fz["unit"] == "N"
    assert [fz[name] for name in ("smallest", "median", "largest")] == pytest.approx([0.300125, 0.319625, 0.339125])
    assert png.read_bytes()[:4] == b"\x89PNG"
    text = "# stream tip (wrench): 100/s, 99.17 % valid; smallest, median, largest: force_x 0.0015, 0.0015, 0.0015 N"
    assert text in found["map"]
    assert main(["import", str(source), "--picture", str(png), "--record", str(tmp_path / "r.rrd")]) == 2
    assert "expected --picture with --inspect" in capfd.readouterr().err


@pytest.mark.parametrize("separator", [",", ";", "\t", "  "])
@pytest.mark.parametrize("suffix", [".csv", ".txt"])
def test_trials_are_read_by_the_same_reader(separator: str, suffix: str, tmp_path: Path) -> None:
    point = "." if separator == "," else ","
    rows = [["label", "group", "tactile.0", "tactile.1"]]
    rows += [["foam" if at % 2 else "wood", f"box{at % 3}", f"{at}{point}25", f"-{at}{point}5"] for at in range(12)]
    path = tmp_path / f"trials{suffix}"
    path.write_text("".join(separator.join(row) + "\r\n" for row in rows))
    found = read_table(path)
    np.testing.assert_array_equal(found.modalities["tactile"], [[at + 0.25, -at - 0.5] for at in range(12)])
    assert found.classes == ("foam", "wood")


def test_a_header_in_chinese_is_read_as_it_is_written(tmp_path: Path) -> None:
    text = written(names=("时间(s)", "力x(N)", "力y(N)", "位移z(N)"))
    for encoding in ("gb18030", "utf-8"):
        form = form_of(io.BytesIO(text.encode(encoding)))
        assert form.names == ("时间(s)", "力x(N)", "力y(N)", "位移z(N)")
        assert set(form.units.values()) == {"s", "N"}
    (tmp_path / "t.csv").write_bytes(text.encode("gb18030"))
    with open_reader(tmp_path / "t.csv") as reader:
        assert next(reader.messages(["t.csv"])).value["力y(N)"] == -20.25
    for names in (
        ("Größe", "Kraft µ°", "Weg", "t"),
        ("déjà", "Temps d'essai °C", "été", "à"),
    ):  # high bytes, in pairs too
        assert form_of(io.BytesIO(written(names=names).encode("latin-1"))).names == names


@pytest.mark.parametrize("blocks", [(1, 3, 5), (3, 3, 5, 5, 3)])
def test_rows_of_other_widths_are_no_table(blocks: tuple[int, ...], tmp_path: Path, capfd: Capture) -> None:
    """A log that writes a line for each sensor: the last block alone would be a table of a few rows."""
    lines = [" ".join(f"{one}.{at}" for one in range(width)) for at in range(20) for width in blocks]
    (tmp_path / "grasp.txt").write_text("\n".join([*lines, "1 2 3 4 5", "1 2 3 4 5"]) + "\n")
    assert main(["import", str(tmp_path / "grasp.txt"), "--inspect"]) == 2
    said = capfd.readouterr().err
    assert f"rows of {', '.join(map(str, sorted({*blocks})))} numbers" in said
    assert said.count("\n") <= 5


def test_a_form_is_the_same_whatever_the_first_lines_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows after many lines of text, and tables longer than what is looked at; columns are judged once, not at each
    row."""
    judged: list[object] = []
    whole = table_file._of_numbers
    monkeypatch.setattr(table_file, "_of_numbers", lambda block: judged.append(block) or whole(block))
    for before in (0, 1, 30, 300):
        preface = "".join(f"line {at}; text, {at}\n" for at in range(before))
        text = (preface + written(";", ",") + "0,5;1,0;2,0;3,0\n" * 20_000).encode()
        found = form_of(io.BytesIO(text))
        assert (found.separator, found.point, found.names, found.before) == (";", ",", NAMES, before)
        assert found.end == len(text)
    assert len(judged) <= 4 * 2 * len(table_file.SEPARATORS)


UNITS_TO_N = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216152605}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@pytest.mark.parametrize("seed", [*range(12), *(slow(seed) for seed in range(12, 200))])
def test_no_change_of_a_map_gives_other_numbers_in_silence(
    seed: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Kind, unit, axis and order: the numbers are those that the map names, or the map is refused. What the source says
    of its units, no map overrules."""
    draw = random.Random(seed)
    separator, point = draw.choice([(",", "."), (";", ","), ("\t", ","), ("  ", "."), (";", ".")])
    says, is_said = draw.choice(sorted(UNITS_TO_N)), draw.random() < 0.5
    fields = [f"F{axis} ({says})" if is_said else f"F{axis}" for axis in "xyz"]
    source = tmp_path / "t.txt"
    source.write_text(written(separator, point, names=("t", *(one.replace(" ", "") for one in fields))))
    fields = [one.replace(" ", "") for one in fields]
    columns = dict(zip([f"force_{axis}_n" for axis in "xyz"], fields, strict=True))
    unit, kind, time_unit = says, "wrench", "s"
    match draw.choice(["kind", "unit", "axis", "order", "drop", "time"]):
        case "kind":
            kind = draw.choice(["arm", "hand", "tactile", "color", "depth"])
        case "unit":
            unit = draw.choice([*UNITS_TO_N, "N m", "kPa", "m", "n", "?"])
        case "axis":
            names = [*columns]
            draw.shuffle(names)
            columns = dict(zip(names, fields, strict=True))
        case "order":
            items = [*columns.items()]
            draw.shuffle(items)
            columns = dict(items)
        case "drop":
            for name in draw.sample(sorted(columns), draw.choice([1, 2])):
                del columns[name]
        case "time":
            time_unit = draw.choice([*SECONDS, "min", "?", ""])
    asked = map_of(columns, unit=unit, topics='["t.txt"]').replace('"wrench"', f'"{kind}"')
    (tmp_path / "map.toml").write_text(asked.replace('time_unit = "s"', f'time_unit = "{time_unit}"'))
    flags = [str(source), "--map", str(tmp_path / "map.toml")]
    status = main(["import", *flags, "--record", str(tmp_path / "r.rrd")])
    said = "".join(capfd.readouterr())
    if status:
        assert (status, "Traceback" in said, (tmp_path / "r.rrd").exists()) == (2, False, False)
        return
    assert kind == "wrench"
    if is_said:
        assert unit == says
    place = {field: at for at, field in enumerate(fields)}
    factor = UNITS_TO_N[unit]
    expected = np.zeros((len(TRUTH), 3))
    for at, axis in enumerate("xyz"):
        if f"force_{axis}_n" in columns:
            expected[:, at] = TRUTH[:, place[columns[f"force_{axis}_n"]]] * factor
    frames: list[Any] = frames_of(tmp_path / "r.rrd")["tip"]
    np.testing.assert_allclose([one.force_n[0] for one in frames], expected, rtol=1e-14)
    times_s = [(one.stamp.host_ns - frames[0].stamp.host_ns) / 1e9 for one in frames]
    np.testing.assert_allclose(times_s, np.arange(len(TRUTH)) / 100 * SECONDS[time_unit], atol=2e-9)
    if len(columns) == 1:
        assert main(["import", "--inspect", *flags]) == 0
        assert "alone, 0 along the others" in capfd.readouterr().out
