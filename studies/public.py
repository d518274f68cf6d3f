"""`python -m studies public FOLDER`: public measurements of others, read and fitted by the commands that a user types.

python -m studies public checkouts --json public.json

FOLDER holds checkouts by the repositories' names (`checkouts/nanite`); one that is missing is left out by name, with
its address and the commit that was tried. Nothing of them is copied: what a command needs in another form, as a table
for `classify`, is written to a folder of its own for as long as the command runs.
"""

import json
import re
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional

import deformscope as ds
from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.frames import WrenchFrame
from deformscope.imports.readers import open_reader
from deformscope.pictures.report import Table
from deformscope.recording.items import read_items
from studies.runner import Study, StudyOptions, StudyReport, Trials

ZWICK = "indentation/experiments/zwick/raw_data"
BOOK = f"{ZWICK}/230331/230331_C_Indentation_relaxation_500N_force.xlsx"
SILICONE = f"{ZWICK}/230515/230515_C_Indentation_relaxation_500N_force.xls"
FRUITS = ("vitamin_water", "coke")
FINGERS, TAXELS, BLOCK = 5, 12, 7
"""Fingers of the iCub, taxels of each, and lines of its log for each time: encoders, positions, fingers."""
FUSED_GPA, WORKBOOK_GPA = 72.0, 49.54
"""Young's modulus of fused silica (Oliver and Pharr 1992), and that of the last cycle in the workbook."""
CHIARO_PLANE_PA, CHIARO_PA = 156.009, 117.007
"""E / (1 - nu^2) and E in the header of the Chiaro's file."""
NANITE_PA, NANITE_CONTACT_M = 14741.96, 1.80293e-5
"""E and contact point of nanite's fit in its own tests, for a paraboloid of 10 um and Poisson's ratio 0.5."""


@dataclass(frozen=True, slots=True)
class PublicRow:
    """One use of a source. typed: the command; came: its result; authors: that of the authors; holds: whether our
    interval holds that, None where there is nothing to hold; why: why not, or under which assumption"""

    typed: str
    came: str
    authors: str = "nothing"
    holds: bool | None = None
    why: str = ""


@dataclass(frozen=True, slots=True)
class PublicOutcome:
    """rows: uses of a source, none where it is missing"""

    source: str
    rows: tuple[PublicRow, ...]


@dataclass(frozen=True, slots=True)
class Source:
    """A repository. owner: who publishes it; commit: the version that was tried; licence: its licence, or `none`; rows:
    the uses of a checkout"""

    owner: str
    commit: str
    licence: str
    rows: Callable[[Path], Iterator[PublicRow]]


@dataclass(frozen=True, slots=True)
class PublicOptions(StudyOptions):
    """Public measurements of others, by the commands that a user types."""

    folder: Annotated[Path, Positional] = Path()
    """Checkouts, by the repositories' names."""


# What a command says -------------------------------------------------------------------------------------------------


def typed_of(source: str, options: dict[str, Any]) -> str:
    """The command line of a call."""
    flags = [f"--{name.replace('_', '-')}" + ("" if value is True else f"={value}") for name, value in options.items()]
    return " ".join(["deformscope indent", f"'{source}'", *flags])


def indented(folder: Path, source: str, **options: Any) -> tuple[str, "ds.IndentResult | None", str]:
    """The command, its result, and that in words: modulus with interval and verdict, or the one line that it refuses
    with."""
    typed = typed_of(source, options)
    try:
        found = ds.indent(str(folder / source), **options)
    except InputError as error:
        return typed, None, f"refused: {str(error).partition(' | ')[0]}"
    low, high = found.interval_pa
    one = found.curves[0]
    said = f"{pressure(found.modulus_pa)} ({pressure(low)} to {pressure(high)}), {(found.together or one).verdict}"
    reasons = sorted({reason.code for curve in found.curves for reason in curve.reasons})
    if found.together is not None:
        said += f"; {len(found.curves)} places, scatter {found.together.scatter:.0%}"
    return typed, found, "; ".join([said, *([", ".join(reasons)] if reasons else [])])


def pressure(value_pa: float) -> str:
    """A modulus in a fitting unit."""
    unit, scale = next(
        one for one in (("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3), ("Pa", 1.0)) if abs(value_pa) >= one[1]
    )
    return f"{value_pa / scale:.3g} {unit}"


def inside(value: float, interval: Sequence[float]) -> bool:
    return interval[0] <= value <= interval[1]


def classified(table: dict[str, Any], typed: str, authors: str, **options: Any) -> PublicRow:
    """Accuracy on a table of trials."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trials.npz"
        np.savez(path, **table)
        found = ds.classify(path, splits=options.pop("splits", 30), curve_splits=0, **options)
    low, high = found.interval
    classes, of = len(set(table["label"])), len(table["label"])
    said = f"accuracy {found.accuracy:.3f} ({low:.3f} to {high:.3f}), {of} trials of {classes} classes"
    most = max(np.unique(table["label"], return_counts=True)[1]) / of
    return PublicRow(typed, said, authors, None, f"the most frequent class alone: {most:.2f}")


# The sources ---------------------------------------------------------------------------------------------------------


def perineal(folder: Path) -> Iterator[PublicRow]:
    """Meat under a ball of 1 cm, which approaches, presses with 1 N, holds, and leaves."""
    for book, sheets in ((BOOK, ("FF1*", "FF2*", "RDG1*", "RDG2*")), (SILICONE, ("230515-P002*",))):
        for sheet in sheets:
            (folder / book).stat()
            apart_m = gap_m(folder / book, sheet.rstrip("*"))
            options = {"tip": "sphere:0.01", "thickness_m": round(apart_m, 4), "bonded": True, "poisson": "0.45,0.5"}
            typed, found, said = indented(folder, f"{book}#{sheet}", **options)
            kept = [one.force_kept for one in found.curves if one.force_kept] if found else []
            said += f"; a hold keeps {np.median(kept):.0%} of the force (median)" if kept else ""
            why = "thickness: the distance of the tools where the test began; the ball is that of the authors' model"
            yield PublicRow(typed, said, "no modulus; curves alone", None, why)


def gap_m(book: Path, sheet: str) -> float:
    """Distance of the tools at the begin of a test."""
    with open_reader(book) as reader:
        name = next(one for one in reader.topics if one.rpartition("/")[2].startswith(sheet))
        return 1e-3 * float(next(iter(reader.messages([name]))).value["Ecartement entre outils"])


def vhb(folder: Path) -> Iterator[PublicRow]:
    """Strips in tension: no poke, and no modulus is right."""
    for name in ("1d5", "6d0"):
        typed, _, said = indented(folder, f"single-step-relaxation/original_data/{name}.csv", tip="disc:0.02")
        why = "a strip in tension is no poke, and the command has no geometry for it"
        yield PublicRow(typed, said, "stress over stretch", None, why)


def elastomers(folder: Path) -> Iterator[PublicRow]:
    """Tension of elastomers: stresses without a force."""
    source = "Tensile-Tests-Data/Ecoflex 00-30.csv"
    typed, _, said = indented(folder, source, tip="disc:0.006")
    yield PublicRow(
        typed, said, "hyperelastic constants by tension", None, "stress over strain of a dumb-bell: no poke"
    )
    lines = (folder / source).read_text(encoding="utf-8").splitlines()
    rows = len(lines) - 1 - next(at for at, line in enumerate(lines) if line.startswith("Time"))
    yield read(folder / source, source, f"{rows} rows below the form", rows)


def read(path: Path, source: str, authors: str, rows: int) -> PublicRow:
    """What `import` reads of a table."""
    with open_reader(path) as reader:
        (topic,) = reader.topics.values()
        found = sum(1 for _ in reader.messages([topic.name]))
    units = sorted({one for one in topic.units.values() if one})
    said = f"{found} rows of {len(topic.units)} columns; units {', '.join(units) or 'none'}"
    return PublicRow(f"deformscope import --inspect '{source}'", said, authors, found == rows)


def phantoms(folder: Path) -> Iterator[PublicRow]:
    """Silicones by their recipes: moduli by compression, without curves."""
    source = "data/processed/phantoms_table.csv"
    row = read(folder / source, source, "moduli of thirteen phantoms, 5.42 to 152.7 kPa", 13)
    yield PublicRow(row.typed, row.came, row.authors, row.holds, "the table has more rows than the text has phantoms")


def grasps(folder: Path) -> Iterator[PublicRow]:
    """Squeezes by an iCub's hand of bottles and cans: empty, half full, full."""
    paths = sorted((folder / "iCubGraspDataset").glob("*.txt"))
    said = "nothing in the repository"
    try:
        with open_reader(paths[0]) as reader:
            came = f"{len(reader.topics)} table"
    except InputError as error:
        came = f"refused: {str(error).partition(' | ')[0]}"
    why = "lines of encoders and of each finger take turns; the last five alone were read before"
    yield PublicRow(f"deformscope import --inspect {paths[0].name}", came, said, None, why)
    names = [re.sub(r"_\d+$", "", one.stem) for one in paths]
    values = [squeeze_features(one) for one in paths]
    table: dict[str, Any] = {"label": np.array(names)}
    table |= {part: np.stack([one[part] for one in values]) for part in values[0]}
    yield classified(table, "deformscope classify grasps.npz", said)
    for container in FRUITS:
        chosen = np.array([one.endswith(container) for one in names])
        part = {name: value[chosen] for name, value in table.items()}
        yield classified(part, f"deformscope classify {container}.npz", said)


def squeeze_features(path: Path) -> dict[str, FloatArray]:
    """Encoders (9,), and mean, deviation, most and least (4,) of each finger's taxels (0 = pressed), at the end and
    their change."""
    lines = path.read_text().split("\n")[1:]
    blocks = [lines[at : at + BLOCK] for at in range(0, len(lines) - BLOCK + 1, BLOCK)]
    parts = [[np.array(line.split(), float) for line in blocks[at]] for at in (0, -1)]
    ends = [np.concatenate([[f.mean(), f.std(), f.max(), f.min()] for f in one[2 : 2 + FINGERS]]) for one in parts]
    return {
        "encoders": np.append(parts[1][0], parts[1][0] - parts[0][0]),
        "tactile": np.append(ends[1], ends[1] - ends[0]),
    }


def nodules(folder: Path) -> Iterator[PublicRow]:
    """A phantom with nodules, under a tactile sensor that presses and turns; the truth of each place is in the file."""
    from scipy.io import loadmat

    for name, of in (("presence_exp", "a nodule or none"), ("properties_exp", "kinds of nodules")):
        found = loadmat(folder / "data" / f"{name}.mat")
        labels, groups, features = [], [], []
        for key in sorted(one for one in found if one.startswith("Rotate_")):
            row, column = (int(one) - 1 for one in key.split("_")[1:3])
            truth = int(found["nodules"][row, column, 0])
            labels.append(str(bool(truth)) if name.startswith("presence") else str(truth))
            groups.append(f"place {row + 1}, {column + 1}")
            way = found[key].astype(float) - found[key][:1]
            features.append(np.concatenate([np.abs(way).max(axis=0).ravel(), way[-1].ravel()]))
        table = {"label": np.array(labels), "group": np.array(groups), "tactile": np.array(features)}
        typed = f"deformscope classify {name}.npz"
        row_found = classified(table, typed, f"{of}, at 16 places")
        why = f"{row_found.why}; places are left out as wholes: each has its own nodule"
        yield PublicRow(typed, row_found.came, row_found.authors, None, why)


def membrane(folder: Path) -> Iterator[PublicRow]:
    """A membrane that is pressed, with the wrench of a sensor: the log as a table, imported."""
    log = json.loads((folder / "demo" / "0" / "data.json").read_text())
    wrench = np.array([one[3] for one in log])
    rows = np.column_stack([[one[0] for one in log], wrench])
    names = ["force_x_n", "force_y_n", "force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm"]
    columns = ", ".join(f'"{one}" = "{one}"' for one in names)
    units = ", ".join(f'"{one}" = "{"N m" if one.endswith("nm") else "N"}"' for one in names)
    text = '[[streams]]\ndevice = "wrist"\nkind = "wrench"\ntopics = ["wrench.csv"]\ntime = "t"\ntime_unit = "s"\n'
    with tempfile.TemporaryDirectory() as out:
        source, map_file = Path(out) / "wrench.csv", Path(out) / "map.toml"
        np.savetxt(source, rows, delimiter=",", header=",".join(["t", *names]), comments="", fmt="%.9f")
        map_file.write_text(f"{text}columns = {{{columns}}}\nunits = {{{units}}}\n")
        recording = Path(out) / "run.rrd"
        ds.import_recording(source, map=map_file, record=recording)
        frames = list(read_items(recording, kinds=(WrenchFrame,)))
    force_n = np.array([one.force_n.sum(axis=0) for one in frames if isinstance(one, WrenchFrame)])
    peak, stated = (float(np.linalg.norm(one, axis=1).max()) for one in (force_n, wrench[:, :3]))
    said = f"{len(frames)} wrenches, largest force {peak:.3f} N"
    why = "data.json as a table; clouds and pressures are .npy, which import does not read"
    authors = f"{len(log)} wrenches, largest force {stated:.3f} N"
    holds = len(frames) == len(log) and abs(peak - stated) < 1e-6
    yield PublicRow("deformscope import wrench.csv --map map.toml --record run.rrd", said, authors, holds, why)


def force_curve(folder: Path) -> Iterator[PublicRow]:
    """A cell under a bead: the curve of nanite's own tests, as JPK's software exports it."""
    options = {"tip": "sphere:2e-5", "poisson": "0.5", "depth_column": "-height"}
    with tempfile.TemporaryDirectory() as out:
        (Path(out) / "spot3.txt").write_text(jpk_text(folder / "tests" / "data" / "fmt-jpk-fd_spot3-0192.jpk-force"))
        typed, _, said = indented(Path(out), "spot3.txt", **options)
        yield PublicRow(typed, said, "4.349e-05 N/mm in the header", None, "the piezo's way alone would be too soft")
        typed, found, said = indented(Path(out), "spot3.txt", machine_n_per_mm=4.349e-5, **options)
    authors = f"{pressure(NANITE_PA)} (tests/test_indent.py)"
    if found is None:
        yield PublicRow(typed, said, authors, False)
        return
    why = "a paraboloid of 10 um on a half-space, as theirs; they fit the whole curve"
    yield PublicRow(typed, said, authors, inside(NANITE_PA, found.interval_pa), why)
    low, high = (-1e6 * one for one in found.curves[0].contact_interval_m[::-1])
    came = f"contact at {-1e6 * found.curves[0].contact_m:.3f} um ({low:.3f} to {high:.3f})"
    authors = f"{1e6 * NANITE_CONTACT_M:.3f} um"
    yield PublicRow(typed, came, authors, inside(1e6 * NANITE_CONTACT_M, (low, high)), why)
    one = found.curves[0]
    for part in (1.0, 0.5):
        young_pa, contact_m = paraboloid(one.along_m + one.contact_m, one.force_n, 1e-5, part)
        came = f"{pressure(young_pa)}, contact at {-1e6 * contact_m:.3f} um"
        yield PublicRow(
            f"their fit, up to {part:.0%} of the force", came, authors, None, "by least squares on the force"
        )


def paraboloid(along_m: FloatArray, force_n: FloatArray, radius_m: float, part: float) -> tuple[float, float]:
    """E (nu = 0.5) and contact point by least squares on the loading's force, up to a part of its peak, as nanite."""
    from scipy.optimize import least_squares

    last = int(np.argmax(force_n >= part * force_n.max()))
    way, force = along_m[:last], force_n[:last] / force_n.max()
    size_m = float(np.ptp(way))

    def off(at: FloatArray) -> FloatArray:
        dent = np.maximum((way - way[-1]) / size_m + at[1], 0.0)
        return np.asarray(at[0] * dent**1.5 + at[2] - force)

    scale, dent, _ = least_squares(off, [30.0, 0.1, 0.0], x_scale=[10.0, 0.01, 0.01]).x
    young_pa = 0.75 * 0.75 * scale * force_n.max() / (np.sqrt(radius_m) * size_m**1.5)
    return float(young_pa), float(way[-1] - dent * size_m)


def jpk_text(path: Path) -> str:
    """A `.jpk-force` file, as JPK's software exports it as text: measured height and force of each segment."""
    with zipfile.ZipFile(path) as packed:
        names = set(packed.namelist())

        def said(name: str) -> dict[str, str]:
            lines = packed.read(name).decode("latin-1").splitlines() if name in names else []
            return dict(line.split("=", 1) for line in lines if "=" in line)

        shared, parts = said("shared-data/header.properties"), []
        for head in sorted(one for one in names if re.fullmatch(r"segments/\d+/segment-header.properties", one)):
            own, columns, spring = said(head), [], 0.0
            heights = ("measuredHeight", "capacitiveSensorHeight", "strainGaugeHeight", "height")
            files = {one: f"{head.rpartition('/')[0]}/channels/{one}.dat" for one in (*heights, "vDeflection")}
            height = next(one for one in heights if files[one] in names)
            for channel, slot in ((height, "nominal"), ("vDeflection", "force")):
                number = own.get(f"channel.{channel}.lcd-info.*")
                about, at = (own, f"channel.{channel}.") if number is None else (shared, f"lcd-info.{number}.")
                encoder = f"{at}{'data.' if number is None else ''}encoder"
                raw = packed.read(files[channel])
                count = int(own.get(f"channel.{channel}.data.num-points", own["force-segment-header.num-points"]))
                values = scaled(np.frombuffer(raw, f">i{len(raw) // count}").astype(float), about, encoder)
                chain = []
                while about.get(f"{at}conversion-set.conversion.{slot}.defined") == "true":
                    chain.append(f"{at}conversion-set.conversion.{slot}")
                    slot = about[f"{chain[-1]}.base-calibration-slot"]
                for conversion in reversed(chain):
                    values = scaled(values, about, conversion)
                columns.append(values)
                spring = float(about[f"{chain[0]}.scaling.multiplier"])
            parts += ["", f"# columns: height vDeflection\n# units: m N\n# springConstant: {spring:.8g}"]
            parts += [f"{one:.9e} {other:.9e}" for one, other in zip(*columns, strict=True)]
    return "\n".join([*parts, ""])


def scaled(values: FloatArray, about: dict[str, str], name: str) -> FloatArray:
    """Values (n,) by a linear scaling of a header."""
    factor, offset = (float(about[f"{name}.scaling.{one}"]) for one in ("multiplier", "offset"))
    return values * factor + offset


def chiaro(folder: Path) -> Iterator[PublicRow]:
    """A soft gel under a bead in water, with the instrument's own modulus in the header."""
    options = {"tip": "sphere:55e-6", "poisson": "0.5", "depth_column": "Piezo (nm)", "machine_n_per_mm": 1.9e-5}
    name = "fmt-chiaro-txt_AEBP1_Indentation_002"
    with tempfile.TemporaryDirectory() as out, zipfile.ZipFile(folder / "tests" / "data" / f"{name}.zip") as packed:
        (Path(out) / f"{name}.txt").write_bytes(packed.read(f"{name}.txt"))
        typed, found, said = indented(Path(out), f"{name}.txt", **options)
    why = "the instrument's own fit is Hertz's; the tip is pulled with a third of the force"
    held = found is not None and inside(CHIARO_PA, found.interval_pa)
    yield PublicRow(typed, said, f"{pressure(CHIARO_PA)} for nu = 0.5", held, why)
    if found is not None:
        one = found.curves[0]
        low, high = one.plane_interval_pa
        said = f"E / (1 - nu^2) {pressure(one.plane_pa)} ({pressure(low)} to {pressure(high)})"
        yield PublicRow(typed, said, pressure(CHIARO_PLANE_PA), inside(CHIARO_PLANE_PA, (low, high)), why)


def fused_silica(folder: Path) -> Iterator[PublicRow]:
    """Glass under a Berkovich tip, which flows as well as bends: the loading law does not hold there."""
    source = "micromechanics_indentationGUI/Examples/Example1/FusedSilica.xlsx#Test 1"
    typed, found, said = indented(folder, source, tip="cone:70.3", poisson="0.18")
    if found is None:
        yield PublicRow(typed, said)
        return
    why = "a cone of the tip's area; glass flows below it, so that loading is too soft"
    held = inside(1e9 * FUSED_GPA, found.interval_pa)
    yield PublicRow(typed, said, f"{FUSED_GPA:g} GPa, the material's", held, why)
    unloading = found.curves[0].unloading_pa
    said = f"by the unloading {pressure(unloading)}" if unloading else "no unloading"
    why = "both without the tip's real area, which the workbook calibrates later"
    yield PublicRow(typed, said, f"{WORKBOOK_GPA:g} GPa by the unloading, in the workbook", None, why)


def cell(folder: Path) -> Iterator[PublicRow]:
    """A palpation device of one axis: counts, without units."""
    source = "src/2020-05-10_16-50__Data_From_Arduino.txt"
    typed, _, said = indented(folder, source, tip="sphere:0.01")
    yield PublicRow(typed, said, why="force in counts, angles of motors: no force and no depth")


SOURCES = {
    "perineal_indentation": Source("SarahIaquinta", "167a9648", "GPL-3.0", perineal),
    "palpation_analysis": Source("lucascimeca", "baaf8416", "none", nodules),
    "phantom-material-database": Source("abubakardawood", "67c91c1e", "CC-BY-4.0 (data)", phantoms),
    "Soft-Robotics-Materials-Database": Source("LucMarechal", "8ff66c3b", "ODbL-1.0", elastomers),
    "VHB4910_data": Source("Chongran-Zhao", "a23efd8c", "none", vhb),
    "icub_grasp_dataset": Source("clear-nus", "87dceeca", "none", grasps),
    "punyo_force_estimation": Source("uiuc-iml", "985bf321", "MIT", membrane),
    "nanite": Source("AFM-analysis", "77636ddf", "GPL-3.0", force_curve),
    "afmformats": Source("AFM-analysis", "731b5ad8", "MIT", chiaro),
    "indentationGUI": Source("micromechanics", "e772f430", "MIT", fused_silica),
    "didactic_palpation_device": Source("KaYZeRT", "03941325", "none", cell),
}


def try_source(case: tuple[str, str]) -> PublicOutcome:
    """The uses of a source's checkout; a file that it lacks is a row of its own."""
    name, folder = case
    if not Path(folder).is_dir():
        return PublicOutcome(name, ())
    rows: list[PublicRow] = []
    try:
        rows += SOURCES[name].rows(Path(folder))
    except FileNotFoundError as error:
        rows.append(PublicRow("", f"left out: no {Path(str(error.filename)).name} in the checkout"))
    return PublicOutcome(name, tuple(rows))


def trials(options: PublicOptions) -> list[Trials[Any, Any]]:
    if not options.folder.is_dir():
        raise InputError("a folder of checkouts", str(options.folder), "git clone into it what the table names")
    return [Trials("sources", try_source, [(name, str(options.folder / name)) for name in SOURCES])]


def report(options: PublicOptions, seconds: float, found: Sequence[PublicOutcome]) -> StudyReport:
    rows: list[list[str]] = []
    given: list[dict[str, object]] = []
    for outcome in found:
        about = SOURCES[outcome.source]
        address = f"github.com/{about.owner}/{outcome.source}"
        where = f"{address} @ {about.commit}, licence: {about.licence}"
        given.append({"source": outcome.source, "address": address, "commit": about.commit, "licence": about.licence})
        given[-1]["rows"] = [asdict(row) for row in outcome.rows]
        for row in outcome.rows or (PublicRow("", f"skipped: no folder {outcome.source}"),):
            held = "" if row.holds is None else "yes" if row.holds else "no"
            rows.append([where, row.typed, row.came, row.authors, held, row.why])
    heads = ["source", "typed", "came", "authors", "held", "why"]
    return StudyReport([Table(rows, heads, f"Public measurements, {seconds:.0f} s")], given)


STUDY = Study(PublicOptions, trials, report)
