"""What the engine is compared with: no time is asserted, only that it computes what it says."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.cli import EXIT_INPUT
from deformscope.stages.msm import reference
from deformscope.stages.msm.clusters import lattice
from studies.__main__ import main
from studies.engines import peers
from studies.engines.numpy_step import NumpyLattice
from studies.engines.peers import Peer
from tests.cases import Capture, Patch
from tests.stages import reference_states

WITHIN = 1e-12
"""Both are float64; positions and velocities differ by rounding alone."""


@pytest.mark.parametrize(("shape", "size"), [((5, 6, 7), 3), ((4, 4, 5), 2), ((7, 9), 4), ((9, 10, 9), 9)])
def test_numpy_takes_the_reference_s_step(shape: tuple[int, ...], size: int) -> None:
    d, rng = len(shape), np.random.default_rng(0)
    rest = np.indices(shape, dtype=float).reshape(d, -1).T
    held = np.zeros(shape, dtype=bool)
    held[0] = held[-1] = True
    index = np.flatnonzero(held)
    x, v = rest + 0.3 * rng.standard_normal(rest.shape), rng.standard_normal(rest.shape)
    body = reference.build_rest(rest, lattice(rest, shape, np.arange(len(rest)), size), index)
    x_wanted, v_wanted = reference_states.step(x, v, body, rest[index] + 0.1, beta=0.7, alpha=0.8, dt=1.0)
    x_new, v_new = NumpyLattice.build(size, held).step(
        x.T.reshape(d, *shape), v.T.reshape(d, *shape), (rest[index] + 0.1).T, 0.7, alpha=0.8, dt=1.0
    )
    np.testing.assert_allclose(x_new.reshape(d, -1).T, x_wanted, rtol=0, atol=WITHIN)
    np.testing.assert_allclose(v_new.reshape(d, -1).T, v_wanted, rtol=0, atol=WITHIN)


def test_other_engines_that_are_not_installed_are_asked_for(monkeypatch: Patch, capsys: Capture) -> None:
    monkeypatch.setattr(peers, "find_spec", lambda name: None)
    assert main(["speed", "--quick", "--peers"]) == EXIT_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert "pip install 'deformscope[peers]'" in line


def test_pypbd_keeps_every_cluster_and_moves() -> None:
    pytest.importorskip("pypbd")
    with Peer("pypbd", 5) as peer:
        assert peer.facts["constraints_kept"] == peer.facts["clusters"] == 27
        assert isinstance(moved := peer.facts["moved_spacings_rms"], float)
        assert moved > 0.01
        assert peer.steps(3).wall_s > 0


def measured(tmp_path: Path, *flags: str) -> list[dict[str, Any]]:
    assert main(["speed", "--quick", "--repeats", "1", *flags, "--json", str(tmp_path / "speed.json")]) == 0
    return list(json.loads((tmp_path / "speed.json").read_text(encoding="utf-8"))["rows"])


@pytest.mark.slow
def test_memory_of_bodies_that_are_large_enough(tmp_path: Path) -> None:
    rows = measured(tmp_path, "--sizes", "64,13824", "--only", "memory")
    assert all(row["unit"] == "B/particle (process)" and row["what"].startswith("13 824") for row in rows)
    assert len(rows) in (0, 2)  # some systems do not report it


def test_only_the_cases_asked_for_on_the_device_asked_for(tmp_path: Path, device: str) -> None:
    rows = measured(tmp_path, "--only", "theta", "--device", device)
    assert {row["case"] for row in rows} == {"theta"}
    assert json.loads((tmp_path / "speed.json").read_text(encoding="utf-8"))["machine"]["device"].startswith(device)


def test_a_case_that_is_not_there_is_refused(capsys: Capture) -> None:
    assert main(["speed", "--only", "step,walk"]) == EXIT_INPUT
    assert "'walk'" in capsys.readouterr().err


@pytest.mark.slow  # compiles kernels of quadratic clusters
def test_each_comparison_gives_rows(tmp_path: Path, capsys: Capture) -> None:
    rows = measured(tmp_path, "--sizes", "64")
    assert list(dict.fromkeys(row["case"] for row in rows)) == [
        *("step", "sweep", "theta", "surface", "cold")  # too small a body for its memory
    ]
    assert [row["who"] for row in rows[:2]] == ["deformscope", "NumPy, batched SVD"]
    assert rows[1]["costs"] > 0
    assert all(row["median"] > 0 for row in rows)
    assert "64 particles, clusters of 3^3" in capsys.readouterr().out
