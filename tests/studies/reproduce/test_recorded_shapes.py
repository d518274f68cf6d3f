"""A recording whose timelines are beta and theta: a row at every value, each the static state that is solved anew."""

from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from deformscope.arrays import FloatArray
from deformscope.stages.msm import reference
from studies.__main__ import main
from studies.reproduce import shapes
from tests.stages import reference_states


def rows(path: Path, entity: str, timeline: str, component: str = "Points2D:positions") -> dict[int, FloatArray]:
    """What stands at each step of a timeline; nothing of it stands on another one."""
    found = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == f"/{entity}" and not chunk.is_static:
            assert chunk.timeline_names == [timeline]
            batch = chunk.to_record_batch()
            steps, values = (batch.column(name).to_pylist() for name in (timeline, component))
            found |= {step: np.array(value) for step, value in zip(steps, values, strict=True)}
    return found


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("shapes") / "msm.rrd"
    assert main(["reproduce", "shapes", "--record", str(path), "--viewer", "none"]) == 0
    return path


def free(body: shapes.HeldLattice, position: FloatArray) -> FloatArray:
    """(n, 2) of the particles that are looked at and not held."""
    held = np.isin(np.arange(len(position)), body.seen.held)[:, None] * np.ones(position.shape[1])
    return body.side(position)[body.side(held)[..., 0] == 0]


def test_the_sheet_stands_at_every_beta_as_an_independent_solve_has_it(recording: Path) -> None:
    body = shapes.sheet()
    seen = body.seen
    found = rows(recording, "beta/clusters-of-3-x-3-one-particle-pressed/particles", "beta")
    rest = reference.build_rest(seen.rest, body.model.grouping(seen), seen.held)
    assert sorted(found) == list(range(100))
    for step in (0, 37, 80):
        solved = reference_states.relax(rest, seen.deformed[seen.held], beta=step / 100.0)[0]
        np.testing.assert_allclose(found[step], free(body, solved), atol=1e-6)


def test_the_cube_stands_at_every_theta_as_an_independent_solve_has_it(recording: Path) -> None:
    body = shapes.cube()
    seen, name = body.seen, "theta/middle-layer-of-a-cube-pressed-by-3-cm"
    found, volume = (
        rows(recording, f"{name}/particles", "theta"),
        rows(recording, f"plot/{name}", "theta", "Scalars:scalars"),
    )
    rest = reference.build_rest(seen.rest, body.model.grouping(seen), seen.held, basis="quadratic")
    assert sorted(found) == sorted(volume) == list(range(101))
    for step in (0, 30):
        solved = reference_states.relax(
            rest, seen.deformed[seen.held], beta=shapes.CUBE_BETA, theta=step / 100.0, tolerance=1e-8
        )[0]
        np.testing.assert_allclose(found[step], free(body, solved), atol=1e-5)
    assert volume[0].item() == pytest.approx(70.0, abs=1e-3)
    assert volume[99].item() > 90.0
