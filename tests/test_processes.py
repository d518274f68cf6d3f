"""Processes beside this one."""

import os
import signal
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from deformscope.processes import BLAS_THREADS, SPAWN, follow_parent, starting
from tests.patience import PATIENCE_S

WITHOUT_GUARD = """
from concurrent.futures import ProcessPoolExecutor
from deformscope.processes import SPAWN, follow_parent, starting
print("the script runs", flush=True)
with starting():
    pool = ProcessPoolExecutor(1, SPAWN, follow_parent)
    print(pool.submit(abs, -3).result(), flush=True)
"""


def test_a_script_that_does_not_guard_itself_runs_once(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(WITHOUT_GUARD)
    ran = subprocess.run(
        [sys.executable, script],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == "the script runs\n3\n"


def test_they_have_one_thread_of_blas_leave_signals_to_their_parent_and_the_parent_as_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    main = sys.modules["__main__"]
    with starting():
        pool = ProcessPoolExecutor(1, SPAWN, follow_parent)
        child = pool.submit(os.getpid).result(PATIENCE_S)
    os.kill(child, signal.SIGINT)
    assert [pool.submit(os.getenv, name).result(PATIENCE_S) for name in BLAS_THREADS] == ["1", "1", "1"]
    assert pool.submit(os.getpid).result(PATIENCE_S) == child
    assert sys.modules["__main__"] is main
    assert (os.environ["OMP_NUM_THREADS"], os.environ.get("MKL_NUM_THREADS")) == ("2", None)
    pool.shutdown()


def blocked() -> bool:
    """Whether a Ctrl-C waits."""
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_a_ctrl_c_does_not_end_them_while_they_begin() -> None:
    with starting():
        pool = ProcessPoolExecutor(1, SPAWN)
        begun = pool.submit(blocked)
    assert begun.result(PATIENCE_S)
    assert not blocked()
    pool.shutdown()


INTERRUPTED = """
import threading, time
import numpy as np
from deformscope.stages.squeeze import evaluation
from deformscope.stages.squeeze.table import LabelledTable

def an_hour(*given, **named):
    print("a split is computed", flush=True)
    time.sleep(3600.0)

evaluation.run_split = an_hour
label = np.repeat(["empty", "rice"], 12)
table = LabelledTable(label, None, {"tactile": np.random.default_rng(0).normal(size=(24, 3))})
evaluation.evaluate(table, evaluation.EvaluationOptions(splits=4, workers=2))
"""


def test_a_ctrl_c_waits_for_no_split_of_a_classification(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=paths
    ) as running:
        began = running.stdout.readline()
        running.send_signal(signal.SIGINT)
        try:
            _, errors = running.communicate(timeout=PATIENCE_S)
        finally:
            running.kill()
    assert began.startswith(b"a split is computed")
    assert b"KeyboardInterrupt" in errors
