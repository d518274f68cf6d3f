"""Tasks, and a sweep, on a Ray cluster of two nodes on this machine's loopback, one of which is killed midway in each;
what came of it, as JSON. Nothing of Ray stays in the process of a test.

python -m tests.executor.on_ray FOLDER small|typed|computed
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# The last has this process look for its node on the loopback, as Ray does on systems with other firewalls.
os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}

import numpy as np
from ray.cluster_utils import Cluster

import deformscope as ds
from deformscope.errors import InputError
from deformscope.executor.local import open_workers
from deformscope.executor.tasks import OtherVersion, TaskOutcome, compute, run_attempt
from deformscope.file_io import sample_path
from deformscope.files.result_table import read_table
from tests.peak_memory import peak_mib

TYPED = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
"""The environment of a shell."""
STORE_BYTES = 200_000_000
TASKS, FILES, PAIRS = 200, 300, 8


def traced(task: tuple[str, int]) -> tuple[int, int]:
    """A number squared, and where; a line is left for each attempt."""
    folder, number = task
    with (Path(folder) / f"attempts-{os.getpid()}").open("a") as file:
        file.write(f"{number}\n")
    time.sleep(0.05)
    if number == 7:
        raise InputError("a number that is liked", "7")
    return number**2, os.getpid()


def mean_of(source: str) -> dict[str, float]:
    """Of the numbers in a file."""
    return {"mean": float(np.load(source)["values"].mean())}


def swept(cluster: Cluster, node: dict[str, object], folder: Path) -> dict[str, object]:
    """Files that are sent over, with a node killed midway: whether they give what they give here, each once."""
    from tests.executor.on_ray import mean_of  # of a module that workers can import, which `__main__` is not

    drawn = np.random.default_rng(4)
    for number in range(FILES):
        np.savez(folder / f"{number}.npz", values=drawn.normal(size=50))
    second = cluster.add_node(**node)
    cluster.wait_for_nodes()

    def kill(what: str, done: int, of: int) -> None:
        if done == FILES // 3:
            cluster.remove_node(second, allow_graceful=False)

    out, at = folder / "out", cluster.address
    found = ds.sweep(mean_of, folder, out=out, executor="ray", address=at, send=True, progress=kill)
    rows = {row["source"]: row["mean"] for row in found.table.to_pylist()}
    equal = rows == {str(path.resolve()): mean_of(str(path))["mean"] for path in folder.glob("*.npz")}
    return {"equal": equal, "lines": len((out / "tasks.jsonl").read_text().splitlines()), "seconds": found.seconds}


def typed(cluster: Cluster, node: dict[str, object], folder: Path) -> dict[str, object]:
    """The documented line in a process of its own, as from a shell, with a node killed midway, and the same without a
    cluster."""
    with np.load(sample_path("pair") / "pair.npz") as pair:
        rest, deformed = pair["rest"], pair["deformed"]
        for number in range(PAIRS):
            arrays = {name: pair[name] for name in pair.files} | {
                "deformed": rest + (1 - number / 99) * (deformed - rest)
            }
            np.savez(folder / f"{number}.npz", **arrays)
    second = cluster.add_node(**node)
    cluster.wait_for_nodes()
    line = [sys.executable, "-m", "deformscope", "sweep", str(folder), "--out"]
    fit = ["--", "calibrate", "beta", "--method", "gradient"]
    out, alone = folder / "out", folder / "alone"
    on_ray = [*line, str(out), "--executor", "ray", "--address", cluster.address, *fit]
    with subprocess.Popen(on_ray, env=TYPED, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as ran:
        journal = out / "tasks.jsonl"
        while ran.poll() is None and not (journal.exists() and journal.read_bytes().count(b"\n") >= PAIRS // 4):
            time.sleep(0.02)
        cluster.remove_node(second, allow_graceful=False)
        said = ran.communicate()[1]
    subprocess.run([*line, str(alone), "--workers", "1", *fit], env=TYPED, capture_output=True, check=True)
    values = [
        {row["source"]: row["beta"] for row in read_table(one / "results.parquet").to_pylist()} for one in (out, alone)
    ]
    return {"status": ran.returncode, "said": said, "equal": values[0] == values[1], "count": len(values[0])}


def main(folder: str, part: str) -> None:
    """Two cores a node: four workers at most. part: `small` on one node, `typed`, or the rest"""
    node = {"num_cpus": 2, "object_store_memory": STORE_BYTES, "node_ip_address": "127.0.0.1"}
    cluster = Cluster(initialize_head=True, head_node_args=node | {"include_dashboard": False})
    if part == "small":
        told = outcomes({one.item[1]: one for one in tasks_on(cluster, folder, 10)})
    else:
        told = typed(cluster, node, Path(folder)) if part == "typed" else computed(cluster, node, folder)
    print(json.dumps(told))
    cluster.shutdown()


def tasks_on(cluster: Cluster, folder: str, count: int) -> Iterator[TaskOutcome[Any, Any]]:
    with open_workers("ray", cluster.address, None) as workers:
        yield from compute(workers, traced, ((folder, n) for n in range(count)))


def outcomes(found: dict[int, TaskOutcome[Any, Any]]) -> dict[str, object]:
    return {
        "right": [n for n, one in found.items() if one.value is not None and one.value[0] == n**2],
        "refused": {n: one.reasons for n, one in found.items() if one.error is not None},
    }


def computed(cluster: Cluster, node: dict[str, object], folder: str) -> dict[str, object]:
    """Tasks and a sweep from this process."""
    second = cluster.add_node(**node)
    cluster.wait_for_nodes()
    found = {}
    for count, one in enumerate(tasks_on(cluster, folder, TASKS), start=1):
        found[one.item[1]] = one
        if count == TASKS // 4:
            cluster.remove_node(second, allow_graceful=False)
    other = ""
    with open_workers("ray", cluster.address, None) as workers:
        try:
            workers.result(workers.submit(run_attempt, "0.0.7", None, traced, (folder, -1)))
        except OtherVersion as error:
            other = str(error)
    files = swept(cluster, node, Path(tempfile.mkdtemp(dir=folder)))
    attempts = Counter(line for path in Path(folder).glob("attempts-*") for line in path.read_text().splitlines())
    return outcomes(found) | {
        "again": {n: one.reasons for n, one in found.items() if one.error is None and one.reasons},
        "attempts": dict(attempts),
        "processes": len({one.value[1] for one in found.values() if one.value is not None}),
        "other": other,
        "swept": files,
        "peak_mib": peak_mib(),
    }


if __name__ == "__main__":
    main(*sys.argv[1:])
