"""The study of public measurements, on small files of known moduli in each source's layout; none is a copy."""

import json
import re
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from studies.__main__ import main
from studies.public import BOOK, CHIARO_PA, FUSED_GPA, NANITE_CONTACT_M, NANITE_PA, SOURCES, try_source
from tests.cases import Capture, slow
from tests.cli.test_indent_command import workbook

RANDOM = np.random.default_rng(5)
WAY = np.append(np.linspace(-1.0, 1.0, 400), np.linspace(1.0, -1.0, 400))


def sphere_n(young_pa: float, radius_m: float, dent_m: FloatArray, poisson: float = 0.5) -> FloatArray:
    clean = 4 / 3 * young_pa / (1 - poisson**2) * np.sqrt(radius_m) * np.maximum(dent_m, 0.0) ** 1.5
    return np.asarray(clean + 1e-3 * clean.max() * RANDOM.standard_normal(len(clean)))


def table(names: Sequence[str], units: Sequence[str], *columns: FloatArray) -> list[list[object]]:
    return [list(names), list(units), *np.column_stack(columns).tolist()]


def meat(folder: Path) -> None:
    dent = 1.2e-3 * WAY
    columns = 0.1 * np.arange(len(WAY)), sphere_n(8e3, 0.005, dent), 1e3 * dent, 15.0 - 1e3 * dent
    names = ["Temps d'essai", "Force standard", "Allongement", "Ecartement entre outils"]
    sheets: dict[str, list[list[object]]] = {"Résultats": [["", "Fmax"], ["", "N"], ["FF1 1A", 1.0]]}
    for sheet in ("FF1 1A", "FF1 1B", "FF2 1A", "RDG1 1A", "RDG2 1A"):
        sheets[sheet] = [[sheet] * 4, *table(names, ["s", "N", "mm", "mm"], *columns)]
    (folder / BOOK).parent.mkdir(parents=True)
    workbook(folder / BOOK, sheets)


def phantom(folder: Path) -> None:
    from scipy.io import savemat

    (folder / "data").mkdir(parents=True)
    for name in ("presence_exp", "properties_exp"):
        kinds = np.arange(16).reshape(4, 4) % 2
        content: dict[str, Any] = {"nodules": np.stack([kinds, kinds, kinds], axis=-1).astype(float)}
        for place, kind in np.ndenumerate(kinds):
            for turn in range(4):
                way = np.linspace(0, 1 + kind, 5)[:, None, None] + 0.1 * RANDOM.standard_normal((5, 2, 3))
                content[f"Rotate_{place[0] + 1}_{place[1] + 1}_d100_r{turn}"] = way
        savemat(folder / "data" / f"{name}.mat", content)


def recipes(folder: Path) -> None:
    rows = [f'{at},P{at},"Silicone (A + B + {at}% T)",{10 * at}.5,{at}.25' for at in range(1, 14)]
    path = folder / "data" / "processed" / "phantoms_table.csv"
    path.parent.mkdir(parents=True)
    path.write_text("\n".join(["no,label,composition,modulus_mean_kPa,modulus_std_kPa", *rows]) + "\n")


def tension(folder: Path) -> None:
    form = ["PARAMETER;INFO;URL;;", "Thickness (mm);3;;;", "Machine;of a kind;;;", ";;;;"]
    head = "Time (s);True Strain;True Stress (MPa);Engineering Strain;Engineering Stress (MPa)"
    rows = [f"{at / 10};{at / 100};{at / 500};{at / 90};{at / 700}" for at in range(40)]
    (folder / "Tensile-Tests-Data").mkdir(parents=True)
    (folder / "Tensile-Tests-Data" / "Ecoflex 00-30.csv").write_text("\n".join([*form, head, *rows]) + "\n")


def strip(folder: Path) -> None:
    path = folder / "single-step-relaxation" / "original_data"
    path.mkdir(parents=True)
    for name, most_mm in (("1d5", 40.0), ("6d0", 400.0)):
        way = np.minimum(np.arange(400) / 40.0, 1.0)
        rows = [f'"{at / 50:.4f}","{most_mm * one:.4f}","{one**0.5:.4f}"' for at, one in enumerate(way)]
        (path / f"{name}.csv").write_bytes("\n".join(["时间,位移,力", "(s),(mm),(N)", *rows, ""]).encode("gb18030"))


def grips(folder: Path) -> None:
    (folder / "iCubGraspDataset").mkdir(parents=True)
    for at, name in enumerate(f"{full}_{what}" for full in ("empty", "full") for what in ("coke", "vitamin_water")):
        for trial in range(12):
            lines = ["-10000"]
            for step in range(3):
                lines += [" ".join(f"{20 + at + one + RANDOM.normal():.3f}" for one in range(9)), "1.0 2.0 3.0 4.0 5.0"]
                pressed = 10 * step * (1 + at)
                lines += [" ".join(f"{244 - pressed + RANDOM.normal():.1f}" for _ in range(12)) for _ in range(5)]
            (folder / "iCubGraspDataset" / f"{name}_{trial + 1}.txt").write_text("\n".join(lines) + "\n")


def wrenches(folder: Path) -> None:
    log = [[1.7e9 + at / 30, 1065.0, [0.1] * 6, [at / 10, 0.0, -1.0, 0.0, 0.1, 0.0]] for at in range(40)]
    (folder / "demo" / "0").mkdir(parents=True)
    (folder / "demo" / "0" / "data.json").write_text(json.dumps(log))


def jpk(folder: Path) -> None:
    """Heights of 10 pm and deflections of 100 nV as whole numbers; 0.04349 N/m, 70 nm/V."""
    dent = 2e-6 * WAY
    force = sphere_n(NANITE_PA, 1e-5, dent)
    height = NANITE_CONTACT_M - dent - force / 0.04349
    scaling = "lcd-info.{}.{}.scaling.multiplier={}\nlcd-info.{}.{}.scaling.offset={}\n"
    conversion = "lcd-info.{0}.conversion-set.conversion.{1}.defined=true\n"
    conversion += "lcd-info.{0}.conversion-set.conversion.{1}.base-calibration-slot={2}\n"
    shared = scaling.format(0, "encoder", 1e-11, 0, "encoder", 0.0) + scaling.format(
        1, "encoder", 1e-7, 1, "encoder", 0.0
    )
    chain = [(0, "nominal", "volts", 1.0), (1, "distance", "volts", 7e-8), (1, "force", "distance", 0.04349)]
    for number, slot, base, factor in chain:
        path = f"conversion-set.conversion.{slot}"
        shared += conversion.format(number, slot, base) + scaling.format(number, path, factor, number, path, 0.0)
    (folder / "tests" / "data").mkdir(parents=True)
    with zipfile.ZipFile(folder / "tests" / "data" / "fmt-jpk-fd_spot3-0192.jpk-force", "w") as packed:
        packed.writestr("shared-data/header.properties", shared)
        for segment, part in enumerate((slice(400), slice(400, None))):
            lines = (
                "channel.height.lcd-info.*=0\nchannel.vDeflection.lcd-info.*=1\nforce-segment-header.num-points=400\n"
            )
            packed.writestr(f"segments/{segment}/segment-header.properties", lines)
            for name, values in (("height", height / 1e-11), ("vDeflection", force / 0.04349 / 7e-8 / 1e-7)):
                whole = np.round(values[part]).astype(">i4").tobytes()
                packed.writestr(f"segments/{segment}/channels/{name}.dat", whole)


def bead(folder: Path) -> None:
    dent = 5e-6 * WAY
    force = sphere_n(CHIARO_PA, 27.5e-6, dent)
    piezo = 2e-5 + dent + force / 0.019
    head = "Date\t12/05/2025\nTip radius (um)\t27.500\nk (N/m)\t0.019\n\nModel: Hertz\nE[v=0.500] (Pa)\t117.007\n\n"
    head += "Time (s)\tLoad (uN)\tIndentation (nm)\tCantilever (nm)\tPiezo (nm)\tAuxiliary\n"
    columns = np.arange(len(WAY)) / 100, 1e6 * force, 0 * force, 1e9 * force / 0.019, 1e9 * piezo, 0 * force
    rows = ["\t".join(f"{one:.6f}" for one in row) for row in np.column_stack(columns)]
    name = "fmt-chiaro-txt_AEBP1_Indentation_002"
    (folder / "tests" / "data").mkdir(parents=True)
    with zipfile.ZipFile(folder / "tests" / "data" / f"{name}.zip", "w") as packed:
        packed.writestr(f"{name}.txt", head + "\n".join(rows) + "\n")


def glass(folder: Path) -> None:
    dent = 8e-7 * WAY
    clean = 2 / np.pi * 1e9 * FUSED_GPA / (1 - 0.18**2) * np.tan(np.radians(70.3)) * np.maximum(dent, 0.0) ** 2
    force = clean + 1e-3 * clean.max() * RANDOM.standard_normal(len(clean))
    rows = table(
        ["Markers", "Time", "Load", "Depth"][1:], ["s", "mN", "nm"], np.arange(800) / 10, 1e3 * force, 1e9 * dent
    )
    path = folder / "micromechanics_indentationGUI" / "Examples" / "Example1"
    path.mkdir(parents=True)
    workbook(path / "FusedSilica.xlsx", {"Results": [["Pmax"], ["mN"], [48.0]], "Test 1": rows})


def counts(folder: Path) -> None:
    (folder / "src").mkdir(parents=True)
    rows = [f"{at},{14 * at},{at % 7},{-at}.5,0.{at % 10}" for at in range(60)]
    text = "index,time(ms),command_slave,position_slave,force_slave\n" + "\n".join(rows) + "\n"
    (folder / "src" / "2020-05-10_16-50__Data_From_Arduino.txt").write_text(text)


MADE = {
    "perineal_indentation": (meat, ["", "", "", ""]),
    "palpation_analysis": (phantom, ["", ""]),
    "phantom-material-database": (recipes, ["yes"]),
    "Soft-Robotics-Materials-Database": (tension, ["", "yes"]),
    "VHB4910_data": (strip, ["", ""]),
    "icub_grasp_dataset": (grips, ["", "", "", ""]),
    "punyo_force_estimation": (wrenches, ["yes"]),
    "nanite": (jpk, ["", "yes", "yes", "", ""]),
    "afmformats": (bead, ["yes", "yes"]),
    "indentationGUI": (glass, ["yes", ""]),
    "didactic_palpation_device": (counts, [""]),
}


@pytest.mark.parametrize("name", [slow(name) if name == "perineal_indentation" else name for name in MADE])
def test_a_source_of_known_moduli_is_held(name: str, tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    make, held = MADE[name]
    make(tmp_path / name)
    rows = try_source((name, str(tmp_path / name))).rows
    missing = name == "perineal_indentation"  # the other book, of which nothing here can write the format
    assert ["" if one.holds is None else "yes" if one.holds else "no" for one in rows[: len(held)]] == held
    assert len(rows) == len(held) + missing
    said = " | ".join(one.came for one in rows)
    if missing:
        assert "left out: no 230515_C_Indentation_relaxation_500N_force.xls" in said
        assert "2 places" in rows[0].came
    if name in ("VHB4910_data", "didactic_palpation_device", "Soft-Robotics-Materials-Database", "icub_grasp_dataset"):
        assert "refused: expected" in said
        assert "identified;" not in said.replace("unidentified;", "")
    if name == "nanite":
        moduli = [float(text) for text in re.findall(r"([\d.]+) kPa(?: \(|, contact)", said)]
        assert moduli == pytest.approx([14.7] * 3, rel=0.01)
    if name in ("palpation_analysis", "icub_grasp_dataset"):
        assert "accuracy 1.000" in said


def test_what_is_missing_is_left_out_by_name(tmp_path: Path, capsys: Capture) -> None:
    counts(tmp_path / "didactic_palpation_device")
    found = tmp_path / "public.json"
    assert main(["public", str(tmp_path), "--jobs", "1", "--json", str(found)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    sources = {one["source"]: one for one in json.loads(found.read_text())}
    assert set(sources) == set(SOURCES) == set(MADE)
    assert [len(one["rows"]) for name, one in sources.items() if name != "didactic_palpation_device"] == [0] * 10
    assert sources["didactic_palpation_device"]["rows"][0]["came"].startswith("refused: expected the unit of column")
    assert "skipped: no folder nanite" in said
    assert sources["nanite"]["address"] == "github.com/AFM-analysis/nanite"
    assert main(["public", str(tmp_path / "none")]) == 2
    assert "expected a folder of checkouts" in capsys.readouterr().err
