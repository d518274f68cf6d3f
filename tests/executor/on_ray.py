"""Tasks, and a sweep, on a Ray cluster of two nodes on this machine's loopback, one of which is killed midway in each;
what came of it, as JSON. `python -m tests.executor.on_ray FOLDER`: nothing of Ray stays in the process of a test."""

from __future__ import annotations

import json
import os
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

# The last has the driver look for its node on the loopback, as Ray does on systems with other firewalls.
os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}

import numpy as np
from ray.cluster_utils import Cluster

import deformscope as ds
from deformscope.errors import InputError
from deformscope.executor.opened import open_workers
from deformscope.executor.tasks import OtherVersion, compute, run_attempt

STORE_BYTES = 200_000_000
TASKS, FILES = 200, 1000


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
    lines = (out / "tasks.jsonl").read_text().splitlines()
    return {"equal": equal, "lines": len(lines), "seconds": found.seconds}


def main(folder: str) -> None:
    """Two cores a node: four workers at most."""
    node = {"num_cpus": 2, "object_store_memory": STORE_BYTES, "node_ip_address": "127.0.0.1"}
    cluster = Cluster(initialize_head=True, head_node_args=node | {"include_dashboard": False})
    second = cluster.add_node(**node)
    cluster.wait_for_nodes()
    found = {}
    with open_workers("ray", cluster.address, None) as workers:
        for count, one in enumerate(compute(workers, traced, ((folder, n) for n in range(TASKS))), start=1):
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
    told = {
        "right": [n for n, one in found.items() if one.value is not None and one.value[0] == n**2],
        "refused": {n: one.reasons for n, one in found.items() if one.error is not None},
        "again": {n: one.reasons for n, one in found.items() if one.error is None and one.reasons},
        "attempts": dict(attempts),
        "processes": len({one.value[1] for one in found.values() if one.value is not None}),
        "other": other,
        "swept": files,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }
    print(json.dumps(told))
    cluster.shutdown()


if __name__ == "__main__":
    main(sys.argv[1])
