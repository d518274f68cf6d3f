"""Other engines, run in child processes that report the time of a number of steps."""

import json
import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec

from deformscope.bench.timing import Timing
from deformscope.errors import InputError
from studies.engines.starting import search_path

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class PeerFailed(Exception):
    """The engine's process failed. The message is the last line that it printed."""


def require_peers() -> None:
    """Raises InputError if the engine for all comparisons is not installed."""
    if find_spec("pypbd") is None:
        raise InputError(
            "the package pypbd, which --peers compares with", "none here", "pip install 'deformscope[peers]'"
        )


class Peer:
    """One engine with a cube of side^3 particles, on one thread. `with Peer("pypbd", 11) as peer: peer.steps(100)`.

    device: where newton runs; facts: its description of the body that it built"""

    def __init__(self, engine: str, side: int, device: str = "cpu") -> None:
        self.engine, self.side, self.device = engine, side, device
        self.facts: dict[str, object] = {}

    def __enter__(self) -> "Peer":
        self._stderr = tempfile.TemporaryFile("w+")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "studies.engines.peer_process", self.engine, str(self.side), self.device],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            text=True,
            cwd=tempfile.gettempdir(),  # some leave their logs where they run
            start_new_session=True,  # Ctrl-C is for us; we end it
            env=os.environ | ONE_THREAD | {"PYTHONPATH": search_path()},
        )
        try:
            self.facts = json.loads(self._answer())
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()
        self._stderr.close()

    def steps(self, count: int) -> Timing:
        """One run of a number of steps from the start: the time of one."""
        assert self._process.stdin is not None
        print(count, file=self._process.stdin, flush=True)
        wall_s, cpu_s = (float(word) for word in self._answer().split())
        return Timing(wall_s, cpu_s).per(count)

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._stderr.seek(0)
            said = self._stderr.read().strip().splitlines()
            raise PeerFailed(said[-1] if said else "it ended without an error message")
        return line
