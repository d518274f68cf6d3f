"""How long the engine takes, for comparing one commit with another. No time is asserted: machines differ.

make bench-suite
.venv/bin/python -m pytest -p benchmark -m bench tests/bench --benchmark-compare
"""

from functools import partial
from typing import Any

import numpy as np
import pytest

from deformscope.bench.bodies import BenchBody, cube
from deformscope.stages.msm.solver import Msm, Precision

pytestmark = pytest.mark.bench

BETA = 0.7
STEPS = 200
"""In one call, so that setting up, some ms, is a small part of it."""


@pytest.fixture(params=[6, 8, 11], ids=["216", "512", "1331"])
def body(request: pytest.FixtureRequest) -> BenchBody:
    return cube(request.param)


def engine(body: BenchBody, device: str, precision: Precision = "float64") -> Any:
    return Msm(body.rest, body.clusters(3), body.held, precision=precision, device=device)


def test_step(benchmark: Any, body: BenchBody, device: str) -> None:
    msm = engine(body, device, "float32")
    benchmark.extra_info["steps"] = STEPS
    benchmark(lambda: msm.step(msm.start(), body.held_position, BETA, steps=STEPS))


def test_relax(benchmark: Any, body: BenchBody, device: str) -> None:
    assert benchmark(partial(engine(body, device).relax, body.held_position, BETA)).converged.all()


def test_sweep(benchmark: Any, body: BenchBody, device: str) -> None:
    assert benchmark(partial(engine(body, device).relax, body.held_position, np.arange(100) * 0.01)).converged.all()
