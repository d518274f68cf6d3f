"""Tasks on a Ray cluster that the test starts on this machine; what is refused without one."""

from __future__ import annotations

import importlib.util
import json
import socket
import subprocess
import sys
from typing import Any

import pytest

from deformscope.errors import InputError
from deformscope.executor.ray_cluster import RayWorkers
from tests.executor.test_tasks import paths_of_tests
from tests.patience import PATIENCE_S

WITHOUT_RAY = "Ray is not installed: pip install 'deformscope[ray]'"
HAS_RAY = importlib.util.find_spec("ray") is not None


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Of 200 tasks, and of a sweep, on two nodes, one of which was killed."""
    if not HAS_RAY:
        pytest.skip(WITHOUT_RAY)
    command = [sys.executable, "-m", "tests.executor.on_ray", str(tmp_path_factory.mktemp("traces"))]
    ran = subprocess.run(
        command, capture_output=True, text=True, timeout=4 * PATIENCE_S, check=False, env=paths_of_tests()
    )
    assert ran.returncode == 0, ran.stderr
    found: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    return found


def test_each_task_comes_back_once_though_a_node_was_killed(told: dict[str, Any]) -> None:
    assert sorted(told["right"]) == [number for number in range(200) if number != 7]
    assert told["refused"] == {"7": ["expected a number that is liked; got 7"]}
    assert told["processes"] <= 4 + 2  # warm, but for those that took the place of the killed


def test_what_the_killed_node_computed_was_tried_elsewhere_with_the_reason(told: dict[str, Any]) -> None:
    again = {number for number, count in told["attempts"].items() if count > 1}

    assert again <= told["again"].keys()
    assert all(
        reasons[0].startswith(("NodeDiedError", "WorkerCrashedError", "OwnerDiedError"))
        for reasons in told["again"].values()
    )


def test_a_sweep_of_files_that_are_sent_gives_what_one_process_gives(told: dict[str, Any]) -> None:
    """A thousand, and a node is killed after a third of them."""
    assert told["swept"]["equal"] is True
    assert told["swept"]["lines"] == 1000  # each once


def test_a_worker_of_another_version_is_named(told: dict[str, Any]) -> None:
    assert told["other"].startswith("expected workers of version 0.0.7; got one of ")


def test_the_memory_of_whoever_asks_is_bounded(told: dict[str, Any]) -> None:
    assert told["peak_mb"] < 500


@pytest.mark.skipif(HAS_RAY, reason="Ray is installed")
def test_without_ray_it_is_said_how_it_is_had() -> None:
    with pytest.raises(InputError, match=r"pip install 'deformscope\[ray\]'"):
        RayWorkers("127.0.0.1:6379")


@pytest.mark.skipif(not HAS_RAY, reason=WITHOUT_RAY)
def test_an_address_that_nobody_answers_is_refused_at_once() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(InputError, match=r"a Ray cluster that answers; got connection refused"):
        RayWorkers(f"127.0.0.1:{port}")
    with pytest.raises(InputError, match="HOST:PORT"):
        RayWorkers("somewhere")
