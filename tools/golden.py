"""Whether a change left behind what it should: every command's output here and at another commit, compared.

python tools/golden.py BASE [--only NAME...] [--keep FOLDER] [--list]

Runs the lines of `CASES`, with small settings, once with the code of BASE and once with that of this checkout, each
case in an empty folder, and compares exit statuses, what is printed, and every file that is written: JSON by key and
value, arrays, pictures by pixel, HTML, and recordings by entity, column and value. Times, paths, stamps and versions
are masked by name (`MASKED_KEYS`, `MASKED_ROWS`, `MASKED_COLUMNS`). Exits with 1 where anything differs, and names it.

--keep FOLDER: where outputs are left; those of a commit that are there already are not made again
"""

import argparse
import contextlib
import difflib
import json
import math
import os
import re
import shlex
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
QUIET = "--viewer none"


@dataclass(frozen=True, slots=True)
class Case:
    """Lines that are typed one after another in one folder.

    on_clock: what is recorded follows the host's clock: entities and columns are compared, values are not, nor what is
    printed but the names of its rows; refused: lines may fail
    """

    lines: tuple[str, ...]
    on_clock: bool = False
    refused: bool = False


def _of(*lines: str, on_clock: bool = False, refused: bool = False) -> Case:
    return Case(lines, on_clock, refused)


def _explore(options: str, *further: str) -> Case:
    return _of(f"explore {options} {QUIET} --json e.json --picture e.png --map e.npz --record e.rrd", *further)


CASES: Mapping[str, Case] = {
    "beta-tension": _of(
        f"calibrate beta sample:tension {QUIET} --json e.json --record e.rrd --picture e.png --report e.html",
        "verify e.rrd --json v.json",
        "replay e.rrd --json r.json",
        "export e.rrd --images images --json x.json",
    ),
    "beta-pair": _of(
        f"calibrate beta sample:pair {QUIET} --json e.json --record e.rrd --picture e.png --report e.html",
        "replay e.rrd --json r.json",
    ),
    "beta-poke": _of(
        f"calibrate beta sample:poke {QUIET} --thickness-m 0.05 --json e.json --record e.rrd --save m.npz",
        f"predict m.npz --poke 'at=0.1,0.1 depth=0.005' {QUIET} --json p.json --out p.npz --picture p.png",
    ),
    "beta-video": _of(f"calibrate beta sample:video {QUIET} --json e.json --record e.rrd --candidates 30"),
    "theta-pair": _of(f"calibrate theta sample:pair {QUIET} --json e.json --record e.rrd --picture e.png"),
    "axes-pair": _of(
        f"calibrate axes sample:pair {QUIET} --json e.json --record e.rrd --picture e.png --report e.html"
    ),
    "field-pair": _of(f"calibrate field sample:pair {QUIET} --json e.json --record e.rrd --picture e.png"),
    "yield-video": _of(f"calibrate yield sample:video --at 3,5 {QUIET} --json e.json --record e.rrd --picture e.png"),
    "viscous-video": _of(
        f"calibrate viscous sample:video --at 3,5 {QUIET} --json e.json --record e.rrd --report e.html", refused=True
    ),
    "flow": _of(f"flow A.png B.png {QUIET} --out f.npz --json e.json --picture e.png --record e.rrd"),
    "explore": _explore(
        "lab:two-60-150 --touches 4 --seed 3",
        "verify e.rrd --json v.json",
        "replay e.rrd --json r.json",
        f"replay e.rrd --set threshold=0.1 --json s.json --record s.rrd {QUIET}",
    ),
    "explore-clean": _explore("lab:disc --touches 3 --seed 1 --clean --beta-model none"),
    "explore-relaxed": _explore("lab:two-60c30-150c30 --touches 3 --seed 2 --hold 2 --feel relaxed --beta-model none"),
    "explore-inclusions": _explore("lab:buried --goal inclusions --touches 4 --seed 1", "replay e.rrd --json r.json"),
    "explore-quick": _explore("lab:egg-crate --pace quick --touches 3 --seed 1 --border 0.01 --beta-model none"),
    "explore-gripper": _explore("lab:two-60-150 --robot gripper --camera realsense --touches 2 --beta-model none"),
    "explore-fault": _of(
        "explore lab:two-60-150 --touches 3 --fault force-silent@2 --beta-model none --json e.json --record e.rrd",
        refused=True,
    ),
    "squeeze": _of(
        f"squeeze lab:containers --content rice --container box-01 --seed 4 {QUIET} --json s.json --record s.rrd",
        "verify s.rrd --json v.json",
        "replay s.rrd --json r.json",
        f"squeeze lab:containers --content water --container cylinder-02 --dataset d --seed 5 {QUIET} --json t.json",
        "dataset list d --trials --json d.json",
    ),
    "classify": _of(
        f"classify sample:squeezes --quick {QUIET} --json c.json --report c.html --save m.npz --record c.rrd",
        f"squeeze lab:containers --container box-03 --model m.npz --seed 6 {QUIET} --json s.json",
    ),
    "record": _of(
        f"record lab:bench --seconds 2 --stage flow --stage contact {QUIET} --record r.rrd --json r.json",
        "verify r.rrd --json v.json",
        "replay r.rrd --json p.json",
        on_clock=True,
    ),
    "reproduce-cubes": _of(f"reproduce cubes --quick --out o {QUIET} --jobs 1 --json e.json"),
    "reproduce-table41": _of(
        f"reproduce table41 --scenes two-60-150,disc --seeds 1 --touches 3 --closed-form --jobs 1 --out o {QUIET}"
        " --json e.json"
    ),
    "reproduce-chapter4": _of(f"reproduce chapter4 --quick --seeds 1 --jobs 1 --out o {QUIET} --json e.json"),
    "reproduce-containers": _of(f"reproduce containers --quick --trials 20 --jobs 1 --out o {QUIET} --json e.json"),
    "refusals": _of(
        "explore lab:nothing",
        "calibrate beta missing.npz",
        "calibrate beta A.png",
        "explore lab:two-60-150 --feel relaxed",
        "replay A.png",
        "verify A.png",
        "squeeze lab:containers",
        "classify A.png",
        "predict A.png --poke x",
        "record missing.toml",
        "explore --list-scenarios",
        "doctor missing.toml",
        refused=True,
    ),
    "doctor": _of("rig new rig.toml --doubles", on_clock=True),
    "help": _of(
        "--help", "explore --help", "calibrate beta --help", "squeeze --help", "classify --help", "replay --help"
    ),
}
"""Small settings of every command that computes, on samples and in the laboratory."""
SLOW = ("reproduce-cubes", "reproduce-chapter4", "reproduce-containers")
"""Minutes each: left out unless `--only` names them or `--all` asks for them."""

MASKED_KEYS = re.compile(
    r"^(seconds|slowest_s|compute_s|session_s|ended_s|recording|recordings|version|versions|git.*|created|began|host|machine|path"
    r"|report|dataset|model|trial|time|elapsed.*|python|platform|digest.*|sha256|bytes|size.*|stamp.*|session)$"
)
"""Of JSON: times, paths, stamps, and what depends on them."""
MASKED_ROWS = re.compile(
    r"^\W*(.*git commit|.* left$|time|recording|supervisor looked|report|model|picture|maps?|written|in \d)"
)
MASKED_TEXT = (
    (re.compile(r"/[\w./+-]*/"), "PATH/"),
    (re.compile(r"\d{4}-?\d\d-?\d\d[T -]?\d\d:?\d\d(:?\d\d)?Z?"), "STAMP"),
    (re.compile(r"\b\d+(\.\d+)? (s|ms|min|MB|MiB|KiB|kB)\b"), "TIME"),
    (re.compile(r"\b[0-9a-f]{7,64}\b"), "HASH"),
)
MASKED_COLUMNS = re.compile(
    r"display|^/cost$|depth_range|log_time|log_tick|chunk|row_id|RowId|properties|seconds|compute|lateness|late_|host_ns"
)
"""Of recordings: rerun's own clock, what was measured of this machine, and pictures that are thinned by its clock."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("base", help="the commit to compare with")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="cases; default: all but the slow ones")
    parser.add_argument("--all", action="store_true", help="the slow cases too")
    parser.add_argument("--keep", type=Path, default=None, metavar="FOLDER", help="leave the outputs there")
    parser.add_argument("--list", action="store_true", help="name the cases, and do nothing else")
    given = parser.parse_args()
    names = given.only or [name for name in CASES if given.all or name not in SLOW]
    if given.list or not set(names) <= set(CASES):
        print("\n".join(CASES))
        return 0 if given.list else 2
    commit = subprocess.run(
        ["git", "rev-parse", "--short=12", given.base], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()
    with contextlib.ExitStack() as stack:
        folder = given.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        code = folder.resolve() / "code" / commit
        if not code.exists():
            archived = subprocess.run(["git", "archive", commit], cwd=ROOT, check=True, capture_output=True).stdout
            with tarfile.open(fileobj=BytesIO(archived)) as packed:
                packed.extractall(code, filter="data")
        differing = 0
        for name in names:
            began = time.monotonic()
            outputs = [
                outputs_of(name, code, folder.resolve() / "outputs" / commit / name, again=False),
                outputs_of(name, ROOT, folder.resolve() / "outputs" / "head" / name, again=True),
            ]
            found = differences(*outputs, on_clock=CASES[name].on_clock)
            if not CASES[name].refused:
                found += [f"{line} fails at the base" for line in failures(outputs[0])]
            found += replayed(name, outputs[0], folder.resolve() / "outputs" / "replayed" / name)
            differing += bool(found)
            print(f"{name:<22} {'differs' if found else 'equal':<8} {time.monotonic() - began:6.1f} s", flush=True)
            for line in found[:40]:
                print(f"    {line}", flush=True)
    print(f"{len(names) - differing} of {len(names)} equal to {commit}")
    return int(differing > 0)


def outputs_of(name: str, code: Path, folder: Path, *, again: bool) -> Path:
    """The folder in which the lines of a case were typed; each line's output is in a file of its number."""
    ended = folder / "ended"
    lines = "\n".join(CASES[name].lines)
    if not again and ended.exists() and ended.read_text(encoding="utf-8") == lines:
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    for image, sample in (("A.png", "frame_152.png"), ("B.png", "frame_210.png")):
        (folder / image).write_bytes((code / "deformscope" / "samples" / "tension" / sample).read_bytes())
    for number, line in enumerate(CASES[name].lines):
        (folder / f"{number}.printed").write_text(typed(line, code, folder), encoding="utf-8")
    ended.write_text(lines, encoding="utf-8")
    return folder


def typed(line: str, code: Path, folder: Path) -> str:
    """What a command with that code prints in a folder, and its exit status."""
    kept = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment = kept | {
        "PYTHONPATH": os.pathsep.join([str(code), str(code / "drivers")]),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "COLUMNS": "140",
        "TERM": "dumb",
    }
    module = "studies" if line.startswith("reproduce ") else "deformscope"
    command = [sys.executable, "-m", module, *shlex.split(line)]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    return f"$ {line}\n{done.stdout}--- stderr\n{done.stderr}--- exit status {done.returncode}\n"


def replayed(name: str, base: Path, folder: Path) -> list[str]:
    """How what the base recorded replays with this checkout's code, where that differs from how it did at the base."""
    found: list[str] = []
    for number, line in enumerate(CASES[name].lines):
        recording = base / (*shlex.split(line), "")[1]
        if not line.startswith("replay ") or not recording.is_file():
            continue
        folder.mkdir(parents=True, exist_ok=True)
        for path in base.glob(f"{recording.name}*"):
            (folder / path.name).write_bytes(path.read_bytes())
        came, was = typed(f"{line} --overwrite", ROOT, folder), (base / f"{number}.printed").read_text(encoding="utf-8")
        came = came.replace(f"$ {line} --overwrite", f"$ {line}")
        found += [f"replay of the base's {recording.name}: {one}" for one in _text(was, came, CASES[name].on_clock)]
    return found


def failures(folder: Path) -> list[str]:
    """Lines of a case that ended neither well nor with named losses."""
    printed = [path.read_text(encoding="utf-8").splitlines() for path in sorted(folder.glob("*.printed"))]
    return [lines[0] for lines in printed if lines[-1].split()[-1] not in ("0", "3")]


# Comparing -----------------------------------------------------------------------------------------------------------


def differences(base: Path, head: Path, *, on_clock: bool) -> list[str]:
    """What differs between two folders of outputs, a line each."""
    named = [
        {str(path.relative_to(one)): path for path in sorted(one.rglob("*")) if path.is_file()} for one in (base, head)
    ]
    if on_clock:
        named = [{name: path for name, path in one.items() if path.suffix != ".ledger"} for one in named]
    found = [
        f"{name}: written at {'base' if name in named[0] else 'head'} alone"
        for name in sorted(set(named[0]) ^ set(named[1]))
    ]
    for name in sorted(set(named[0]) & set(named[1])):
        found += [f"{name}: {line}" for line in _file(named[0][name], named[1][name], on_clock)]
    return found


def _file(base: Path, head: Path, on_clock: bool) -> list[str]:
    match base.suffix:
        case ".json":
            return list(_json(json.loads(base.read_text()), json.loads(head.read_text()), "", on_clock))
        case ".printed" | ".html" | ".txt" | ".md":
            return _text(base.read_text(errors="replace"), head.read_text(errors="replace"), on_clock)
        case ".npz":
            return list(_arrays(dict(np.load(base, allow_pickle=False)), dict(np.load(head, allow_pickle=False))))
        case ".png" | ".jpg":
            return _picture(base, head)
        case ".rrd":
            return list(_recording(base, head, on_clock))
        case ".jsonl":
            rows = [[json.loads(line) for line in path.read_text().splitlines()] for path in (base, head)]
            return list(_json(*rows, "", on_clock))
        case ".parquet":
            import pyarrow.parquet

            tables = [pyarrow.parquet.read_table(path).to_pydict() for path in (base, head)]
            return list(_json(*tables, "", on_clock))
        case ".ledger" | "":
            return []
        case _:
            return [] if base.read_bytes() == head.read_bytes() else ["bytes differ"]


def _json(base: Any, head: Any, where: str, on_clock: bool) -> Iterator[str]:
    if isinstance(base, dict) and isinstance(head, dict):
        for key in sorted(set(base) ^ set(head)):
            yield f"{where}.{key}: at {'base' if key in base else 'head'} alone"
        for key in base:
            if key in head and not MASKED_KEYS.match(key):
                yield from _json(base[key], head[key], f"{where}.{key}", on_clock)
    elif on_clock:
        return
    elif isinstance(base, list) and isinstance(head, list) and len(base) == len(head):
        for index, (one, other) in enumerate(zip(base, head, strict=True)):
            yield from _json(one, other, f"{where}[{index}]", on_clock)
    elif isinstance(base, str) and isinstance(head, str):
        if _masked(base) != _masked(head):
            yield f"{where}: {base!r} became {head!r}"
    elif base != head and not (isinstance(base, float) and isinstance(head, float) and math.isnan(base + head)):
        yield f"{where}: {base!r} became {head!r}"


def _masked(text: str) -> str:
    for pattern, word in MASKED_TEXT:
        text = pattern.sub(word, text)
    return text


def _text(base: str, head: str, on_clock: bool) -> list[str]:
    lines = [[_masked(line) for line in one.splitlines() if not MASKED_ROWS.match(line)] for one in (base, head)]
    if on_clock:
        lines = [sorted(re.split(r"\s{2,}|\d", line.strip())[0] for line in one) for one in lines]
    changed = difflib.unified_diff(*lines, lineterm="", n=0)
    return [line[:300] for line in changed if line[:1] in "+-" and line[:3] not in ("+++", "---")]


def _arrays(base: Mapping[str, Any], head: Mapping[str, Any]) -> Iterator[str]:
    for name in sorted(set(base) | set(head)):
        if name not in base or name not in head:
            yield f"{name}: at {'base' if name in base else 'head'} alone"
        elif MASKED_KEYS.match(name):
            continue
        elif base[name].dtype != head[name].dtype or base[name].shape != head[name].shape:
            yield f"{name}: {base[name].dtype} {base[name].shape} became {head[name].dtype} {head[name].shape}"
        elif base[name].dtype.kind in "US":
            if [_masked(str(one)) for one in base[name].flat] != [_masked(str(one)) for one in head[name].flat]:
                yield f"{name}: {str(base[name])[:100]} became {str(head[name])[:100]}"
        elif not np.array_equal(base[name], head[name], equal_nan=base[name].dtype.kind == "f"):
            apart = np.abs(base[name].astype(float) - head[name].astype(float))
            yield f"{name}: differs by up to {np.nanmax(apart):.3g} in {np.count_nonzero(apart)} of {apart.size} values"


def _picture(base: Path, head: Path) -> list[str]:
    import cv2

    one, other = (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in (base, head))
    if one is None or other is None or one.shape != other.shape:
        return [f"picture of {None if one is None else one.shape} became {None if other is None else other.shape}"]
    apart = np.count_nonzero((one != other).reshape(*one.shape[:2], -1).any(axis=2))
    return [f"{apart} of {one.shape[0] * one.shape[1]} pixels differ"] if apart else []


Column = tuple[str, str]


def _recording(base: Path, head: Path, on_clock: bool) -> Iterator[str]:
    one, other = columns_of(base), columns_of(head)
    for entity, column in sorted(set(one) ^ set(other)):
        yield f"{entity} {column}: at {'base' if (entity, column) in one else 'head'} alone"
    if on_clock:
        return
    for key in sorted(set(one) & set(other)):
        if (said := _values(one[key], other[key])) is not None:
            yield f"{key[0]} {key[1]}: {said}"


def _values(base: list[Any], head: list[Any]) -> str | None:
    if len(base) != len(head):
        return f"{len(base)} values became {len(head)}"
    for index, (one, other) in enumerate(zip(base, head, strict=True)):
        if one != other and _masked(repr(one)) != _masked(repr(other)):
            return f"value {index} of {len(base)}: {repr(one)[:120]} became {repr(other)[:120]}"
    return None


def columns_of(path: Path) -> dict[Column, list[Any]]:
    """Every value of each column of each entity of a recording, in the order of its rows.

    Rows of a column are put in order by its timelines: how they were portioned does not show. rerun's own clock, and
    columns that measure this machine, are left out.
    """
    from rerun.chunk import RrdReader

    rows: dict[Column, list[tuple[tuple[str, ...], Any]]] = {}
    for chunk in RrdReader(str(path)).stream().to_chunks():
        batch = chunk.to_record_batch()
        entity = str(chunk.entity_path)
        if MASKED_COLUMNS.search(entity):
            continue
        names = [name for name in batch.schema.names if not MASKED_COLUMNS.search(name)]
        times = [name for name in names if name in ("session", "frame", "touch", "step")]
        stamps = list(zip(*(batch.column(name).cast("int64").to_pylist() for name in times), strict=True))
        for name in names:
            if name in times or name.startswith("rerun.controls"):
                continue
            values = batch.column(name).to_pylist()
            at = stamps or [()] * len(values)
            held = rows.setdefault((entity, name), [])
            held += [
                (tuple(f"{one:020d}" for one in stamp if one is not None), value)
                for stamp, value in zip(at, values, strict=True)
                if value is not None
            ]
    return {key: [value for _, value in sorted(held, key=lambda row: row[0])] for key, held in rows.items()}


if __name__ == "__main__":
    sys.exit(main())
