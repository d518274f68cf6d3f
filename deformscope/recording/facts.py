"""Content and end of a recording, and `rerun rrd`, each in a child process: damaged bytes can crash rerun's reader.

python -m deformscope.recording.facts run.rrd [brief]    one line of JSON: the fields of `Facts`
"""

import dataclasses
import json
import re
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deformscope.errors import InputError
from deformscope.file_io import utf8_path
from deformscope.recording.rrd_file import has_footer

TIMEOUT_S = 600.0
MEMORY, BEGIN_BYTES = Path("/dev/shm"), 32 << 20


@dataclass(frozen=True, slots=True)
class Facts:
    """The readable part of a recording, up to its damage.

    application, recording: rerun's ids; outcome: what the run recorded at its end, empty if it was interrupted
    losses: numbers of losses by device and kind (`deformscope.recording.losses`); counts: frames by device, and inputs
    until_s: session time of the last row [s], None without one; damage: reason for the end of reading, empty = none
    discarded: its discarded parts (`deformscope.recording.ledger`)
    absent: devices that the recording names and of which no frame was read"""

    application: str = ""
    recording: str = ""
    outcome: dict[str, Any] = field(default_factory=dict)
    losses: dict[str, dict[str, float]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    until_s: float | None = None
    damage: str = ""
    discarded: list[dict[str, Any]] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)


def salvage(path: Path, readable: Path) -> tuple[Facts, str]:
    """Write the readable part of a recording as another one. Returns its content, and the place where reading ended
    before the end of the file, empty = it was read completely."""
    damage = run_rrd("merge", path, "-o", readable)
    refused = damage and run_rrd("merge", "--continue-on-error", path, "-o", readable)
    return Facts(damage=refused) if refused else read_facts(readable), damage


def is_recoverable(path: Path) -> bool:
    """Whether `deformscope recover` can read a part of an unfinished recording, judged by its beginning if it has no
    footer. Its own disk may be full: the copy is made in memory where that is possible."""
    if has_footer(path):  # the format, which nothing is read without, may stand at its end
        return bool(read_facts(path, brief=True).counts)
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as scratch:
        begin, readable = (Path(scratch) / name for name in ("begin.rrd", "readable.rrd"))
        with path.open("rb") as file:
            begin.write_bytes(file.read(BEGIN_BYTES))
        return bool(salvage(begin, readable)[0].counts)


def read_facts(path: Path, *, brief: bool = False) -> Facts:
    """Read the facts in a child process; an error or crash of it becomes `damage`. brief: report only whether there are
    any"""
    done = _run([sys.executable, "-m", __name__, str(path), *(["brief"] if brief else [])])
    if isinstance(done, str):
        return Facts(damage=done)
    try:
        return Facts(**json.loads(done.stdout.splitlines()[-1]))
    except (ValueError, IndexError, TypeError):
        words = done.stderr.split()
        return Facts(damage=f"its reader failed: {' '.join(words[-30:])}" if words else "its reader failed")


def run_rrd(*arguments: str | Path) -> str:
    """Run `rerun rrd ...` of the installed wheel; returns its error in a line, empty if it succeeded."""
    from deformscope.page.server.viewer_files import viewer_environment, viewer_executable

    words = (str(utf8_path(one)) if isinstance(one, Path) else one for one in arguments)
    done = _run([str(viewer_executable()), "rrd", *words], viewer_environment())
    if isinstance(done, str):
        return done
    if done.returncode == 0:
        return ""
    output = [line for line in re.sub(r"\x1b\[\d*m", "", done.stderr + done.stdout).splitlines() if line.strip()]
    reason = [line for line in output if "footer" in line] or output[-1:]
    return " ".join(reason[0].split())[:300] if reason else "rerun refuses it without a message"


def _run(command: list[str], environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str] | str:
    """To its end, or the reason against it."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, env=environment)
    except subprocess.TimeoutExpired:
        return f"it was not read within {TIMEOUT_S:g} s"
    if done.returncode < 0:
        return f"its bytes end rerun's reader ({signal.Signals(-done.returncode).name})"
    return done


def gather_facts(path: Path, *, brief: bool = False) -> Facts:
    """Read the facts in this process. brief: as in `read_facts`"""
    from deformscope.recording.reader import Replay

    facts: dict[str, Any] = {}
    counts: Counter[str] = Counter()
    named: set[str] = set()
    try:
        replay = Replay(path, trust=True)
        facts["application"], facts["recording"] = replay.identity
        if {"rig", "label"} <= (settings := json.loads(replay.properties.get("settings", "{}"))).keys():
            named |= tomllib.loads(settings["rig"]).get("devices", {}).keys()  # `record` opens all of them
        for chunk in replay.chunks("/**"):
            if chunk.is_static and "stream" in chunk.to_record_batch().schema.names:
                named.add(chunk.entity_path.rpartition("/")[2])
            if chunk.is_static or "session" not in chunk.timeline_names:
                continue
            batch = chunk.to_record_batch()
            times_ns = [time_ns for time_ns in batch.column("session").cast("int64").to_pylist() if time_ns is not None]
            facts["until_s"] = max(facts.get("until_s", 0.0), max(times_ns, default=0) / 1e9)
            if (counted := _counted(chunk.entity_path, batch.schema.names)) is not None:
                counts[counted] += batch.num_rows
                counts["frames"] += batch.num_rows if counted.endswith("/frames") else 0
                if brief:
                    return Facts(counts=dict(counts))
        facts["outcome"], facts["losses"] = replay.outcome, replay.losses
        facts["discarded"] = [dataclasses.asdict(one) for one in replay.discarded]
    except InputError as error:
        facts["damage"] = str(error).split(" | ")[0]
    except Exception as error:  # damaged bytes make the readers raise what they like
        facts["damage"] = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return Facts(counts=dict(counts), absent=sorted(one for one in named if not counts[f"{one}/frames"]), **facts)


def _counted(entity: str, columns: list[str]) -> str | None:
    """Name under which a row of these columns counts; None if it is part of something that counts elsewhere."""
    parts = entity.strip("/").split("/")
    if any(column.endswith("Frame:stamp.host_ns") for column in columns):
        return f"{parts[-1]}/frames"
    return "inputs" if "InputFile:name" in columns else None


if __name__ == "__main__":
    print(json.dumps(dataclasses.asdict(gather_facts(Path(sys.argv[1]), brief=len(sys.argv) > 2)), default=str))
