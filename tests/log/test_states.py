"""A recording whose timelines are beta and theta: a row at every value, each the static state that is solved anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from deformscope.cli import main
from deformscope.reproduce import shapes
from deformscope.stages.msm import reference
from deformscope.stages.msm.state_sweep import PressedLattice, sweep_states


def rows(path: Path, entity: str, timeline: str, component: str) -> dict[int, np.ndarray]:
    """What stands at each step of a timeline."""
    found = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == f"/{entity}" and not chunk.is_static:
            assert chunk.timeline_names == [timeline]
            batch = chunk.to_record_batch()
            for step, values in zip(
                batch.column(timeline).to_pylist(), batch.column(component).to_pylist(), strict=True
            ):
                found[step] = np.array(values)
    return found


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shapes")
    path = folder / "msm.rrd"
    flags = ["--record", str(path), "--out", str(folder / "out"), "--viewer", "none"]
    assert main(["reproduce", "shapes", *flags]) == 0
    assert {one.name for one in (folder / "out").iterdir()} == {
        *(f"figure-3.{number}.png" for number in (5, 7, 8, 13)),
        *("searches.csv", "states.csv"),
    }
    return path


def free(lattice: PressedLattice, position: np.ndarray) -> np.ndarray:
    """(n, 2) of the particles that are looked at and not held."""
    return lattice.seen(position)[~np.isin(lattice.shown, lattice.held)]


def test_the_sheet_stands_at_every_beta_as_an_independent_solve_has_it(recording: Path) -> None:
    lattice = shapes.sheet()
    found = rows(recording, "beta/clusters-of-3-x-3-one-particle-pressed/particles", "beta", "Points2D:positions")
    rest = reference.build_rest(lattice.rest, lattice.clusters, lattice.held)

    assert sorted(found) == list(range(100))
    for step in (0, 37, 80):
        solved = reference.relax(rest, lattice.target, beta=step / 100.0)[0]
        np.testing.assert_allclose(found[step], free(lattice, solved), atol=1e-6)


def test_the_cube_stands_at_every_theta_as_it_is_solved_anew(recording: Path) -> None:
    lattice = shapes.cube()
    found = rows(recording, "theta/middle-layer-of-a-cube-pressed-by-3-cm/particles", "theta", "Points2D:positions")

    assert sorted(found) == list(range(101))
    for step in (0, 30, 99):
        alone = sweep_states(lattice, "theta", np.array([step / 100.0]), shapes.CUBE_BETA)
        np.testing.assert_allclose(found[step], free(lattice, alone.position[0]), atol=1e-6)
    volume = rows(recording, "plot/size/theta/middle-layer-of-a-cube-pressed-by-3-cm", "theta", "Scalars:scalars")
    assert volume[0].item() == pytest.approx(70.0, abs=1e-3)
    assert volume[99].item() > 90.0
