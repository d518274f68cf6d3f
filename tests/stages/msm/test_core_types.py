"""Whether solves converge does not depend on how the BLAS rounds: the same tests with other kernels of it."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]

NEEDS = {"Haswell": "avx2", "SkylakeX": "avx512f"}
"""What a processor must have for the kernels that OpenBLAS has for a core type."""

HANG_ON_CONVERGENCE = "cpu and 3D and quadratic and scale and 0.3"
"""Tests whose solves have no energy, the hardest of all; `make test-cores` runs every test of stages."""

RUN = """
import sys, numpy, threadpoolctl, pytest
blas = [one for one in threadpoolctl.threadpool_info() if one.get("internal_api") == "openblas"]
if not blas:
    sys.exit(77)
assert {one["architecture"] for one in blas} == {sys.argv[1]}, blas
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "tests/stages/msm/test_linear_map.py", "-k", sys.argv[2]]))
"""


def _flags() -> set[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return set()
    return set(next((line for line in lines if line.startswith("flags")), "").split())


@pytest.mark.slow
@pytest.mark.parametrize("core", NEEDS)
def test_solves_converge_with_every_kernel_of_the_blas(core: str) -> None:
    if platform.machine() not in ("x86_64", "AMD64") or NEEDS[core] not in _flags():
        pytest.skip(f"the processor has no {NEEDS[core]}, which OpenBLAS needs for {core}")
    environment = os.environ | {"OPENBLAS_CORETYPE": core, "PYTHONPATH": os.pathsep.join(sys.path)}
    ran = subprocess.run(
        [sys.executable, "-c", RUN, core, HANG_ON_CONVERGENCE],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
    )
    if ran.returncode == 77:
        pytest.skip("NumPy here does not use OpenBLAS")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert " passed" in ran.stdout
