"""How long a new process takes to its first result, with kernels to compile and with kernels compiled before."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from deformscope.bench.bodies import counted
from deformscope.bench.plan import BenchPlan, Note
from deformscope.bench.timing import OURS, TimingRow
from studies.engines.first_result import SIDE

WARM_STARTS = 3


def cold(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """From process start to the first static state, less the time that imports take."""
    what = f"first static state, {counted(SIDE**3)}"
    with tempfile.TemporaryDirectory() as cache:
        note("cold: first result, compiling")
        result_s, import_s = _start(plan.device, cache)
        yield TimingRow("cold", f"{what}, empty kernel cache", OURS, "s", (result_s,), facts={"import_s": import_s})
        note("cold: first result, compiled before")
        again = [_start(plan.device, cache) for _ in range(1 if plan.quick else WARM_STARTS)]
        facts = {"import_s": min(seconds for _, seconds in again)}
        yield TimingRow("cold", f"{what}, kernels compiled", OURS, "s", tuple(s for s, _ in again), facts=facts)


def _start(device: str, cache: str) -> tuple[float, float]:
    """Seconds of a new process from its start to its result without imports, and of its imports."""
    # Both processes read the same clock, so that starting the interpreter counts too.
    began_s = time.perf_counter()
    ended = subprocess.run(
        [sys.executable, "-m", "studies.engines.first_result", device],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"WARP_CACHE_PATH": cache, "PYTHONPATH": search_path()},
    )
    answer = json.loads(ended.stdout)
    return answer["ended_s"] - began_s - answer["import_s"], answer["import_s"]


def search_path() -> str:
    """Module path of this process, for a child process."""
    return os.pathsep.join(str(Path(folder).resolve()) for folder in sys.path)
