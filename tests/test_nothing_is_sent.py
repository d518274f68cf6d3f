"""Nothing leaves this machine: rerun's usage statistics and its question for a newer version are off."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from deformscope.cli.common import EXIT_LOSSES
from deformscope.page.server.viewer_files import viewer_executable
from tests.offline import NO_NAMESPACES
from tests.patience import PATIENCE_S
from tools.screenshot import LAVAPIPE

ROOT = Path(__file__).resolve().parents[1]
UNKIND = {
    "FORCE_RERUN_ANALYTICS": "1",
    "NO_PROXY": "*",
    "no_proxy": "*",
    "HTTPS_PROXY": "",
    "TELEMETRY_ENABLED": "true",
}
"""What of a user's environment would switch rerun's questions on again."""

PAGE = """
    from deformscope.page.server.page_server import PageServer
    from tests.page.pages import get, root
    with PageServer("bench") as page:
        assert get(page, root(page) + "re_viewer.js")[0] == 200
"""
FILE = """
    from deformscope.recording.facts import run_rrd
    assert run_rrd("stats", "recordings/tension.rrd") == ""
"""
COMMAND = """
    import sys
    from deformscope.cli import main
    sys.exit(main(["record", "lab:bench", "--seconds", ".1", "--viewer", "page", "--record", sys.argv[1] + "/run.rrd"]))
"""
WINDOW = """
    import os, signal, threading, time
    from rerun.experimental import ViewerClient
    from deformscope.recording import live
    os.environ["DISPLAY"] = ":0"
    live.window_options = lambda: ["--headless"]
    viewer = live.start_viewer()
    live.wait_for_viewer(viewer, threading.Event())
    ViewerClient.connect(viewer.url).get_state()  # it asks for a newer version as it starts
    time.sleep(1)
    os.kill(viewer.pid, signal.SIGKILL)
"""
RERUN = "import subprocess, sys; subprocess.run([sys.argv[2], 'rrd', 'stats', 'recordings/tension.rrd'])"


def looked_up(script: str, home: Path, **environment: str) -> list[str]:
    """Host names that a script of Python's asks for, in a home directory and a network of its own."""
    environment = {
        "HOME": str(home),
        "PATH": os.environ["PATH"],
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "drivers")]),
        "VK_ICD_FILENAMES": str(LAVAPIPE),
    } | environment
    arguments = [sys.executable, "-c", textwrap.dedent(script), str(home.parent), str(viewer_executable())]
    done = subprocess.run(
        [sys.executable, "-m", "tests.offline", *arguments],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    if done.returncode == NO_NAMESPACES:
        pytest.skip(f"no network of its own here: {done.stdout}")
    assert done.returncode in (0, EXIT_LOSSES), done.stderr  # a busy machine may lose a reading
    return [line.split()[-1] for line in done.stdout.splitlines() if line.startswith("looked up ")]


def files_of_rerun(home: Path) -> list[str]:
    return [str(path) for path in home.rglob("*") if "rerun" in str(path.relative_to(home))]


@pytest.mark.parametrize("script", [PAGE, FILE, WINDOW, COMMAND], ids=["page", "file", "window", "command"])
def test_nothing_is_asked_or_kept(tmp_path: Path, script: str) -> None:
    if script is WINDOW and not LAVAPIPE.exists():
        pytest.skip("no software Vulkan driver")
    home = tmp_path / "home"
    home.mkdir()
    assert looked_up(script, home, **UNKIND) == []
    assert files_of_rerun(home) == []


def test_rerun_by_itself_keeps_and_asks(tmp_path: Path) -> None:
    """Without that the test above shows nothing."""
    home = tmp_path / "home"
    home.mkdir()
    looked_up(RERUN, home)
    assert any("analytics" in path for path in files_of_rerun(home))
    assert looked_up(
        "import socket, contextlib\nwith contextlib.suppress(OSError):\n  socket.gethostbyname('a.test')", home
    ) == ["a.test"]
