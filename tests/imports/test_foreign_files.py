"""Whatever a well-formed foreign file declares: it is taken, or refused in a line, in bounded memory."""

import os
import subprocess
import sys

import pytest

from tests.cases import slow
from tests.patience import PATIENCE_S


@pytest.mark.parametrize(("first", "count"), [(790, 8), slow(0, 790), slow(798, 9_202)])
def test_no_foreign_file_ends_a_command_unexpectedly(first: int, count: int) -> None:
    """Each case in a process of its own; `python -m tests.imports.fuzz_foreign SEED 1` repeats one."""
    pytest.importorskip("rosbags")
    quiet = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "tests.imports.fuzz_foreign", str(first), str(count)]
    done = subprocess.run(command, capture_output=True, text=True, env=quiet, timeout=count * PATIENCE_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"# {count} cases: 0 failed" in done.stdout
