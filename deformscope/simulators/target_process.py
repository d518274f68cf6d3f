"""A simulator's process: one line of JSON asks, lines of JSON answer; none of it needs the simulator here."""

import contextlib
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from deformscope.errors import InputError
from deformscope.processes import BLAS_THREADS, END_S, RENEW_S


@dataclass(frozen=True, slots=True)
class Target:
    """tried: its version with which it was tried; install: what pip installs for it; timestep_s: its default time step
    [s]; contact: where the fit of its stiffness of contact begins, per modulus; unit: the unit of that stiffness"""

    tried: str
    install: str
    timestep_s: float
    contact: float
    unit: str


TARGETS = {
    "mujoco": Target("4.0.0", "mujoco==4.0.0", 0.005, 2.0, "/s^2"),
    "newton": Target("1.8.0", "newton==1.8.0 usd-core==26.11 newton-usd-schemas==0.6.0", 0.001, 0.3, "N/m a vertex"),
}


class TargetFailed(InputError):
    """The target's own error, in one line with its version."""


class TargetProcess:
    """A target in a process of its own. python: its interpreter, None = this one. Raises InputError where it does not
    start, or does not find the target."""

    def __init__(self, target: str, python: Path | None = None) -> None:
        self.target, self.version, self._python, self._over = target, "", sys.executable, ""
        if python is not None:
            self._python = shutil.which(python) or str(python.absolute())
        script = Path(__file__).with_name(f"{target}_child.py")
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  # closed with the process
        env = os.environ | dict.fromkeys(BLAS_THREADS, "1")
        pipe = subprocess.PIPE
        try:
            self._process = subprocess.Popen(
                [self._python, "-I", str(script)],
                stdin=pipe,
                stdout=pipe,
                stderr=self._said,
                env=env,
                text=True,
                start_new_session=True,  # a Ctrl-C is this process's
            )
        except OSError as error:
            self._said.close()
            raise InputError("a Python interpreter after --python", error.strerror or "none", where=python) from None
        self._lines: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, name=target, daemon=True).start()
        try:
            self.version = str(next(self.ask({"do": "version"}))["version"])
        except TargetFailed:
            self.close()
            raise

    def ask(self, request: dict[str, object], keep_on: Callable[[], bool] = lambda: True) -> Iterator[dict[str, Any]]:
        """The answers to a request, as they come. keep_on: asked while none comes; without it the process is ended.
        Raises TargetFailed with the target's error, and again once the process is over."""
        assert self._process.stdin is not None
        if self._over:
            raise self._failed(self._over)
        with contextlib.suppress(OSError):  # what it said is below
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        for _ in cast("Sequence[object]", request.get("pokes", (None,))):
            if (line := self._next(keep_on)) is None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(END_S)
                self._said.seek(0)
                last = self._said.read().decode(errors="replace").strip().splitlines() or ["no message"]
                self.close()
                self._over = f"ended with status {self._process.returncode}: {last[-1]}"
                raise self._failed(self._over)
            try:
                found = json.loads(line)
            except ValueError:
                raise self._failed(f"no JSON: {line.strip()[:80]}") from None
            if "error" in found:
                raise self._failed(found["error"])
            yield found

    def _next(self, keep_on: Callable[[], bool]) -> str | None:
        while True:
            try:
                return self._lines.get(timeout=RENEW_S)
            except queue.Empty:
                if not keep_on():
                    self.close()
                    self._over = "stopped"
                    raise self._failed(self._over) from None

    def _failed(self, text: str) -> TargetFailed:
        name, about = f"{self.target} {self.version}", TARGETS[self.target]
        if not self.version:
            return TargetFailed(f"{name}in {self._python}", text, f"pip install {about.install} there, or --python")
        hint = f"a shorter --timestep-s, a longer --limit-s, or {self.target} {about.tried}"
        return TargetFailed("the target to move the body", f"{name}: {text}", hint)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._said):
            with contextlib.suppress(OSError, ValueError):
                pipe and pipe.close()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put(None)


@contextlib.contextmanager
def target_process(target: str, python: Path | None) -> Iterator[TargetProcess]:
    """Such a process, ended at the end of the context."""
    process = TargetProcess(target, python)
    try:
        yield process
    finally:
        process.close()
