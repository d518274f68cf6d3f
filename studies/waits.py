"""`python -m studies waits`: processor time and memory of commands that a person waits for, and their growth with work.

python -m studies waits --only fit --rounds 3
python -m studies waits --against ../other-checkout --rounds 3 --jobs 2
python -m studies waits --only touches,seconds,devices,recordings --most 10000 --jobs 4

Processor time includes that of child processes. Builds take turns: on a busy machine both are disturbed alike. `record`
runs in real time, so fewer jobs than half the processors leave it undisturbed.
"""

import csv
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Literal, get_args

import numpy as np

from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.pictures.report import Table
from studies.runner import Study, StudyOptions, StudyReport, Trials

ROOT = Path(__file__).resolve().parents[1]
QUIET = "--viewer none"
Part = Literal["explore", "demo", "recording", "fit", "touches", "seconds", "devices", "recordings"]
PARTS: tuple[Part, ...] = get_args(Part)
CHAINS: dict[Part, tuple[str, ...]] = {
    "explore": (f"explore lab:two-60-150 --touches 8 --seed 3 {QUIET} --record e.rrd --json e.json",),
    "demo": (f"demo {QUIET} --record d.rrd",),
    "recording": (
        f"record lab:bench --seconds 60 {QUIET} --record r.rrd",
        "verify r.rrd",
        f"replay r.rrd {QUIET}",
        "export r.rrd --to mcap --out mcap",
        "export r.rrd --to parquet --out parquet",
        "rosbags-convert --src mcap/r.mcap --dst converted.bag",  # another program's export of the same messages
    ),
    "fit": (f"calibrate beta sample:pair {QUIET}",),
}
"""Lines that are typed one after another in one folder."""

GROWING: dict[Part, tuple[int, ...]] = {
    "touches": (4, 8, 16, 32, 64),
    "seconds": (10, 100, 1000, 3600),
    "devices": (1, 3, 6, 12),
    "recordings": (10, 100, 1000, 10_000, 100_000),
}
"""What grows: touches of an exploration; seconds of one force sensor at 1 kHz; sensors of 100 s each; files of a
catalog. Sensors are tables that are imported: nothing waits for a device."""
RATE_HZ, SENSOR_S = 1000, 100


@dataclass(frozen=True, slots=True)
class WaitsOptions(StudyOptions):
    """Measure processor time and memory of commands that a person waits for, against another build, and growth
    with work."""

    only: Annotated[
        tuple[Part, ...] | None, flags.one_word("CASE,CASE...", flags.some_of(PARTS), flags.joined(",")), flags.unset
    ] = None
    """Measure only these: explore, demo, recording, fit; or growth with touches, seconds, devices and recordings;
    default: the first four."""
    against: Annotated[Path | None, flags.one_word("FOLDER", Path), flags.unset] = None
    """Checkout of another build, which takes turns; growth is of this build alone."""
    rounds: flags.SomeFlag = None
    """How often each is measured; default: once."""
    most: flags.SomeFlag = None
    """Leave out larger numbers of what grows."""


@dataclass(frozen=True, slots=True)
class WaitCase:
    """Lines to time. build: checkout whose code runs; named: their case; size: amount of what grows"""

    build: str
    named: Part
    lines: tuple[str, ...]
    size: int = 0


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of one command line. cpu_s: processor time; wall_s: duration [s]; memory_mb: peak of its largest process"""

    line: str
    cpu_s: float
    wall_s: float
    memory_mb: float


def trials(options: WaitsOptions) -> list[Trials[WaitCase, list[Cost]]]:
    """A case for each round and build, and for each size of what grows."""
    builds = [ROOT, *([options.against.resolve()] if options.against is not None else [])]
    for build in builds:
        if not (build / "deformscope" / "__main__.py").is_file():
            raise InputError("a checkout, for --against", "a folder without deformscope/__main__.py", where=build)
    wanted = options.only or tuple(CHAINS)
    cases = [
        WaitCase(str(build), name, CHAINS[name])
        for _ in range(options.rounds or 1)
        for name in wanted
        if name in CHAINS
        for build in builds
    ]
    cases += [
        WaitCase(str(ROOT), name, _growing(name, size), size)
        for name in wanted
        for size in GROWING.get(name, ())
        if size <= (options.most or size)
    ]
    return [Trials("runs", measure, cases)]


def _growing(what: Part, size: int) -> tuple[str, ...]:
    """Lines whose cost grows with `size`."""
    if what == "touches":
        return (f"explore lab:two-60-150 --touches {size} --seed 3 {QUIET} --record e.rrd",)
    if what == "recordings":
        return ("catalog many",)
    return (f"import tables --map map.toml {QUIET} --record i.rrd", "verify i.rrd", "export i.rrd --to parquet --out p")


def measure(case: WaitCase) -> list[Cost]:
    """The cost of each line of a case, in an empty folder. Raises InputError where one ends with an error."""
    with tempfile.TemporaryDirectory() as folder:
        if case.named in ("seconds", "devices"):
            seconds, devices = (case.size, 1) if case.named == "seconds" else (SENSOR_S, case.size)
            _write_tables(Path(folder), seconds, devices)
        elif case.named == "recordings":
            _copy_recordings(Path(folder), case)
        return [run(case.build, line, Path(folder)) for line in case.lines]


def run(build: str, line: str, folder: Path) -> Cost:
    """The cost of one command line of a build."""
    paths = os.pathsep.join((build, str(Path(build) / "drivers")))
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}  # as a user has it
    words = shlex.split(line)
    foreign = Path(sys.executable).with_name(words[0])
    program = [str(foreign), *words[1:]] if foreign.is_file() else [sys.executable, "-m", "deformscope", *words]
    began_s = time.perf_counter()
    with (folder / "output.txt").open("wb") as output:
        process = subprocess.Popen(
            program,
            cwd=folder,
            env={**kept, **threads, "PYTHONPATH": paths},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        _, status, used = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - began_s
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 3):  # 3: done, with losses that it names
        last = (folder / "output.txt").read_text(errors="replace").strip().splitlines()[-1:]
        raise InputError("a command that ends well", f"status {process.returncode}: {' '.join(last)}", where=line)
    return Cost(line, used.ru_utime + used.ru_stime, wall_s, used.ru_maxrss / 1024)


def _write_tables(folder: Path, seconds: int, devices: int) -> None:
    """Tables of forces, and the map with which they are imported."""
    (folder / "tables").mkdir()
    for number in range(devices):
        rng = np.random.default_rng(number)
        with (folder / "tables" / f"tip{number}.csv").open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(("t", "Fx", "Fy", "Fz"))
            for begin in range(seconds):
                forces = rng.integers(-4000, 4000, (RATE_HZ, 3)).tolist()
                rows.writerows((begin * RATE_HZ + at, *force) for at, force in enumerate(forces))
    (folder / "map.toml").write_text(
        "".join(
            f'[[streams]]\ndevice = "tip{number}"\nkind = "wrench"\ntopics = ["tip{number}.csv"]\n'
            'columns = {"force_x_n" = "Fx", "force_y_n" = "Fy", "force_z_n" = "Fz"}\n'
            'units = {"Fx" = "mN", "Fy" = "mN", "Fz" = "mN"}\ntime = "t"\ntime_unit = "ms"\n'
            for number in range(devices)
        ),
        encoding="utf-8",
    )


def _copy_recordings(folder: Path, case: WaitCase) -> None:
    """A folder with many recordings, which are links to one."""
    run(case.build, f"{CHAINS['fit'][0]} --record one.rrd", folder)
    many = folder / "many"
    many.mkdir()
    for number in range(case.size):
        for end in (".rrd", ".rrd.ledger"):
            os.link(folder / f"one{end}", many / f"run-{number:06d}{end}")


def report(options: WaitsOptions, seconds: float, outcomes: Sequence[list[Cost]]) -> StudyReport:
    """Medians of each line, and their ratio to those of another build; growth."""
    (run_cases,) = trials(options)
    found: dict[tuple[Part, int, int, str], list[Cost]] = {}
    for case, costs in zip(run_cases.cases, outcomes, strict=True):
        for place, cost in enumerate(costs):
            found.setdefault((case.named, place, case.size, case.build), []).append(cost)
    ours = {key[:3]: costs for key, costs in found.items() if key[3] == str(ROOT)}
    theirs = {key[:3]: costs for key, costs in found.items() if key[3] != str(ROOT)}
    tables = [_compared(ours, theirs), _growth(ours)]
    json = [
        {"case": name, "size": size, "build": "this" if build == str(ROOT) else "other", **asdict(one)}
        for (name, _, size, build), costs in found.items()
        for one in costs
    ]
    return StudyReport([table for table in tables if table.rows], {"runs": json})


Found = Mapping[tuple[Part, int, int], Sequence[Cost]]


def _compared(ours: Found, theirs: Found) -> Table:
    rows = []
    for key, costs in ours.items():
        if key[0] not in CHAINS:
            continue
        before = theirs.get(key, ())
        ratios = [one.cpu_s / other.cpu_s for one, other in zip(costs, before, strict=False)]
        rows.append(
            (
                costs[0].line,
                f"{median(one.cpu_s for one in costs):.3g}",
                f"{median(one.cpu_s for one in before):.3g}" if before else "",
                f"{median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f})" if ratios else "",
                f"{median(one.wall_s for one in costs):.3g}",
                f"{max(one.memory_mb for one in costs):.0f}",
                f"{max(one.memory_mb for one in before):.0f}" if before else "",
            )
        )
    names = ("line", "CPU [s]", "other", "ratio", "duration [s]", "memory [MB]", "other")
    return Table(rows, names, "Medians; ratio of CPU: median over rounds, and range; memory: largest")


def _growth(ours: Found) -> Table:
    """Exponents p of a + b n^p, from the differences of three sizes that follow one another."""
    rows = []
    for name, place in dict.fromkeys(key[:2] for key in ours if key[0] in GROWING):
        sizes = [key[2] for key in ours if key[:2] == (name, place)]
        costs = [ours[name, place, size][0] for size in sizes]
        more, work = np.diff([one.cpu_s for one in costs]), np.diff(sizes)
        slopes = np.log(np.maximum(more[1:], 1e-3) / np.maximum(more[:-1], 1e-3)) / np.log(work[1:] / work[:-1])
        rows.append(
            (
                name,
                " ".join(costs[0].line.split()[:1]),
                ", ".join(map(str, sizes)),
                ", ".join(f"{one.cpu_s:.3g}" for one in costs),
                ", ".join(f"{slope:.2f}" for slope in slopes),
                ", ".join(f"{one.memory_mb:.0f}" for one in costs),
            )
        )
    names = ("grows", "command", "sizes", "CPU [s]", "exponent", "memory [MB]")
    return Table(rows, names, "Exponent of the growth from each three sizes; 1 = linear")


STUDY = Study(WaitsOptions, trials, report)
