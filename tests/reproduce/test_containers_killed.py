"""`reproduce containers` killed by -9 with its workers at work: it goes on, and its trials are those of one process."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp")

from deformscope.cli import reproduce_containers
from deformscope.config import ContainersConfig
from deformscope.files.squeeze_dataset import SqueezeDataset
from deformscope.reproduce.containers import squeeze_jobs
from tests.executor.test_tasks import paths_of_tests
from tests.patience import PATIENCE_S

TRIALS = 5
SQUEEZED = """
import sys
from pathlib import Path
from tests.reproduce.test_containers_killed import squeeze_into
squeeze_into(Path(sys.argv[1]), 2)
"""


def squeeze_into(folder: Path, workers: int) -> SqueezeDataset:
    """Some of the command's trials, each written as it is done."""
    reproduce_containers.KEPT_TOGETHER = 1
    dataset = SqueezeDataset(folder)
    jobs = squeeze_jobs(folder, 20, 0, 0, 0)[:TRIALS]
    reproduce_containers._squeeze(dataset, jobs, ContainersConfig.of(workers=workers))
    return dataset


def entries(dataset: SqueezeDataset) -> dict[str, Any]:
    """What the index says of each trial, but for when it was made."""
    return {one.trial: dataclasses.replace(one, recorded_at="") for one in dataset.entries()}


@pytest.mark.slow
def test_trials_are_those_of_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Slow: ten squeezes are simulated."""
    monkeypatch.setattr(reproduce_containers, "KEPT_TOGETHER", 1)
    killed = SqueezeDataset(tmp_path / "killed")
    with subprocess.Popen([sys.executable, "-c", SQUEEZED, str(killed.folder)], env=paths_of_tests()) as running:
        until = time.monotonic() + 5 * PATIENCE_S
        while not killed.exists:
            assert running.poll() is None
            assert time.monotonic() < until
            time.sleep(0.05)
        running.kill()
    kept = {one.trial for one in killed.entries()}

    squeeze_into(killed.folder, 2)
    whole = squeeze_into(tmp_path / "whole", 1)
    assert 0 < len(kept) < TRIALS
    assert entries(killed) == entries(whole)
    ours, theirs = killed.table().modalities, whole.table().modalities
    assert all(np.array_equal(np.sort(ours[one], axis=0), np.sort(theirs[one], axis=0)) for one in theirs)
