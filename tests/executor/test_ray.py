"""Tasks on a Ray cluster that the test starts on this machine; what is refused without one."""

import importlib.util
import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from deformscope.errors import InputError
from deformscope.executor.ray_cluster import RayWorkers
from tests.cases import slow
from tests.executor.test_tasks import paths_of_tests
from tests.patience import PATIENCE_S

WITHOUT_RAY = "Ray is not installed: pip install 'deformscope[ray]'"
HAS_RAY = importlib.util.find_spec("ray") is not None


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Of 200 tasks, and of a sweep, on two nodes, one of which was killed."""
    return on_ray(tmp_path_factory.mktemp("traces"), "computed")


def on_ray(folder: Path, part: str) -> dict[str, Any]:
    if not HAS_RAY:
        pytest.skip(WITHOUT_RAY)
    command = [sys.executable, "-m", "tests.executor.on_ray", str(folder), part]
    ran = subprocess.run(
        command, capture_output=True, text=True, timeout=4 * PATIENCE_S, check=False, env=paths_of_tests()
    )
    assert ran.returncode == 0, ran.stderr
    found: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    return found


@pytest.mark.slow
def test_each_task_comes_back_once_though_a_node_was_killed(told: dict[str, Any]) -> None:
    assert sorted(told["right"]) == [number for number in range(200) if number != 7]
    assert told["refused"] == {"7": ["expected a number that is liked; got 7"]}
    assert told["processes"] <= 4 + 2  # warm, but for those that took the place of the killed


@pytest.mark.slow
def test_what_the_killed_node_computed_was_tried_elsewhere_with_the_reason(told: dict[str, Any]) -> None:
    again = {number for number, count in told["attempts"].items() if count > 1}
    assert again <= told["again"].keys()
    assert all(
        reasons[0].startswith(("NodeDiedError", "WorkerCrashedError", "OwnerDiedError"))
        for reasons in told["again"].values()
    )


@pytest.mark.slow
def test_a_sweep_of_files_that_are_sent_gives_what_one_process_gives(told: dict[str, Any]) -> None:
    """A node is killed after a third of them."""
    assert told["swept"]["equal"] is True
    assert told["swept"]["lines"] == 300  # each once


def test_a_small_cluster_computes_and_refuses(tmp_path: Path) -> None:
    told = on_ray(tmp_path, "small")
    assert sorted(told["right"]) == [number for number in range(10) if number != 7]
    assert told["refused"] == {"7": ["expected a number that is liked; got 7"]}


@pytest.mark.slow
def test_the_documented_line_typed_in_a_shell_computes_all(tmp_path: Path) -> None:
    """On a cluster that listens on the loopback alone; a node is killed after a quarter."""
    told = on_ray(tmp_path, "typed")
    assert (told["status"], told["count"], told["equal"]) == (0, 8, True), told["said"]
    assert "GCS" not in told["said"]


@pytest.mark.slow
def test_a_worker_of_another_version_is_named(told: dict[str, Any]) -> None:
    assert told["other"].startswith("expected workers of version 0.0.7; got one of ")


@pytest.mark.slow
def test_the_memory_of_whoever_asks_is_bounded(told: dict[str, Any]) -> None:
    assert told["peak_mib"] < 500


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


@pytest.mark.skipif(not HAS_RAY, reason=WITHOUT_RAY)
@pytest.mark.parametrize(
    ("before", "said"),
    [
        (
            "from deformscope.executor import ray_cluster; ray_cluster.JOIN_S = 3",
            "none that takes this process within 3",
        ),
        slow("import ray", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0"),
    ],
)
def test_what_cannot_be_joined_is_one_line_with_the_address_to_give(before: str, said: str, tmp_path: Path) -> None:
    """A server that is none of Ray's: it takes connections, and answers nothing."""
    (tmp_path / "a.npz").touch()
    code = f"import sys; {before}; from deformscope.cli import main; sys.exit(main(sys.argv[1:]))"
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        flags = ["--out", str(tmp_path / "out"), "--executor", "ray", "--address", address]
        ran = subprocess.run(
            [sys.executable, "-c", code, "sweep", str(tmp_path), *flags, "--", "calibrate", "beta"],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
            env=paths_of_tests(),
        )
    assert ran.returncode == 2
    assert [line for line in ran.stderr.splitlines() if line.strip()] == [ran.stderr.splitlines()[-1]]
    assert said in ran.stderr
    assert address in ran.stderr
