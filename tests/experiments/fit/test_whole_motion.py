"""What held-out error chooses: the held set, cluster size, alpha and dt that made a motion; or that none can tell."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.fit.whole_motion import (
    ParticleOptions,
    Selectable,
    Selection,
    TrackedMotion,
    fit_motion,
    held_sets,
    select,
    simulated,
)
from deformscope.log.over_picture import summary
from deformscope.stages.fit.calibrate import FitOptions, Model
from deformscope.stages.fit.dynamics import Pace, step_through
from deformscope.stages.msm import clusters
from deformscope.stages.msm.solver import Msm
from deformscope.stages.see.particles import ParticleGrid, Tracked

ROWS, COLUMNS, SPACING_PX, NOISE_PX = 9, 8, 20.0, 0.1
BETA = 0.7
MODEL = Model()


def grid() -> ParticleGrid:
    x, y = 30.0 + SPACING_PX * np.arange(COLUMNS), 30.0 + SPACING_PX * np.arange(ROWS)
    rest = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return ParticleGrid(rest, (ROWS, COLUMNS), np.arange(len(rest)), np.full(2, SPACING_PX))


def sheared(frames: int, *, size: int = 3, pace: Pace | None = None, fps: float = 10.0, seed: int = 1) -> TrackedMotion:
    """A sheet whose bottom row stands and whose top row is bent and sheared: what is held is top and bottom."""
    lattice = grid()
    rest = lattice.rest_px
    held = np.concatenate([np.arange(COLUMNS), np.arange(len(rest) - COLUMNS, len(rest))])
    body = Msm(rest, clusters.lattice(rest, lattice.shape, lattice.cell, size), held)
    pull = np.zeros((len(held), 2))
    pull[:COLUMNS] = np.stack([np.linspace(0.0, 30.0, COLUMNS), 15.0 * np.sin(np.arange(COLUMNS))], axis=1)
    way: FloatArray = rest[held] + np.linspace(0.0, 1.0, frames + 1)[1:, None, None] * pull
    times = [index / fps for index in range(frames + 1)]
    if pace is None:
        moved = body.relax(way, np.full(frames, BETA)).position
    else:
        pace = Pace(pace.alpha, pace.dt, tuple(times[1:]))
        moved = step_through(body, way, np.array([BETA]), 0.0, pace)[0][0]
    rng = np.random.default_rng(seed)
    seen = np.ones(len(rest), dtype=bool)
    history = [Tracked(rest, np.zeros(len(rest)), seen, np.zeros(len(rest)))]
    for position in moved:
        noisy = position + rng.normal(0.0, NOISE_PX, position.shape)
        history.append(Tracked(noisy, np.full(len(rest), NOISE_PX), seen, np.zeros(len(rest))))
    return TrackedMotion(lattice, history, times)


def chosen(motion: TrackedMotion, what: tuple[Selectable, ...], model: Model = MODEL, **particles: object) -> Selection:
    return select(motion, ParticleOptions(**particles), FitOptions(model), what)  # type: ignore[arg-type]


def test_a_wrong_held_set_is_found_out() -> None:
    found = chosen(sheared(4), ("held",), held=("bottom",))
    assert found.way.parts == ("top", "bottom")
    wrong = next(row for row in found.table if row.held == ("bottom",))
    right = next(row for row in found.table if row.chosen)
    assert wrong.held_out > 5.0 * right.held_out
    assert right.held_out < 2.0 * NOISE_PX
    assert right.value == pytest.approx(BETA, abs=0.02)
    assert "bottom cannot" not in found.text


def test_holding_more_does_not_win_by_itself() -> None:
    """All ways are judged by the same particles, which none of them holds."""
    found = chosen(sheared(4), ("held",), held=("border",))
    assert found.way.parts == ("top", "bottom")
    assert "border fit as well" in found.text


@pytest.mark.parametrize("size", [2, 4])
def test_the_cluster_size_that_made_the_motion_is_chosen(size: int) -> None:
    found = chosen(sheared(4, size=size), ("cluster-size",))
    assert found.way.model.cluster_size == size
    assert found.text == f"clusters: {size} a side"


@pytest.mark.parametrize("alpha", [0.25, 0.75])
def test_alpha_of_a_fast_motion_is_found(alpha: float) -> None:
    found = chosen(sheared(6, pace=Pace(alpha, 2e-3, ()), fps=50.0), ("alpha",))
    assert found.way.pace.alpha == alpha
    assert f"alpha {alpha:g}" in found.text
    row = next(row for row in found.table if row.chosen)
    assert row.alpha == alpha
    assert row.value == pytest.approx(BETA, abs=0.03)


def test_dt_of_a_fast_motion_is_found() -> None:
    assert chosen(sheared(5, pace=Pace(0.5, 5e-3, ()), fps=50.0), ("dt",), Model(alpha=0.5)).way.pace.dt == 5e-3


def test_a_slow_motion_cannot_tell_alpha() -> None:
    found = chosen(sheared(3, pace=Pace(0.5, 2e-3, ()), fps=0.5), ("alpha",))
    assert found.way.pace is None
    assert found.text.startswith("the motion was slow enough to be static: it does not determine alpha")
    assert sum(row.chosen for row in found.table) == 1
    assert next(row for row in found.table if row.chosen).alpha is None


def test_nothing_to_select_keeps_what_was_asked_for() -> None:
    found = chosen(sheared(2), (), Model(cluster_size=4))
    assert (found.table, found.text) == ((), "")
    assert found.way.model.cluster_size == 4


def test_a_fast_motion_is_fitted_by_time_stepping() -> None:
    motion = sheared(5, pace=Pace(0.25, 2e-3, ()), fps=50.0)
    particles = ParticleOptions()
    fit = FitOptions(Model(), candidates=15)
    found, way = fit_motion(motion, particles, fit, ("alpha",))
    estimate = found.estimate
    assert estimate.settings["dynamic"] is True
    assert estimate.settings["alpha"] == 0.25
    assert estimate.interval[0] <= BETA <= estimate.interval[1]
    told = estimate.as_json()["selection"]
    assert isinstance(told, list)
    assert {"cluster_size", "held", "alpha", "dt", "held_out_aee", "fit_aee", "beta", "chosen"} <= set(told[0])
    page = summary(estimate)
    assert page.count(", static |") == 1
    assert page.count("alpha 0.25, dt 0.002 s |") == 1
    assert estimate.selection_text in page
    shown = simulated(motion, particles, way, found)
    assert len(shown) == 6
    assert np.abs(shown[-1].simulated - shown[-1].observed).max() < 6.0 * NOISE_PX
    # taken for a row of static states, the same motion gives another beta
    static, _ = fit_motion(motion, particles, fit, ())
    assert abs(static.estimate.value - BETA) > 2.0 * abs(estimate.value - BETA)
    assert static.estimate.aee_free > 2.0 * estimate.aee_free


def test_frames_are_thinned_evenly_and_hold_the_last() -> None:
    motion = sheared(7)
    np.testing.assert_array_equal(motion.frames(100), np.arange(1, 8))
    assert motion.frames(3).tolist() == [1, 4, 7]
    assert motion.frames(0).tolist() == [7]


def test_held_sets_hold_the_tool_where_there_is_one() -> None:
    assert held_sets(ParticleOptions(held=("left",)))[0] == ("left",)
    with_tool = held_sets(ParticleOptions(held=("bottom", "contact"), contact=(0.0, 0.0, 9.0, 9.0)))
    assert all("contact" in parts for parts in with_tool)


def test_too_few_particles_to_judge_by() -> None:
    motion = sheared(2)
    few = TrackedMotion(
        ParticleGrid(motion.grid.rest_px[: 4 * COLUMNS], (4, COLUMNS), np.arange(4 * COLUMNS), motion.grid.spacing_px),
        [
            Tracked(m.position_px[: 4 * COLUMNS], m.noise_px[: 4 * COLUMNS], np.arange(4 * COLUMNS) < 18, m.noise_px)
            for m in motion.history
        ],
        motion.times,
    )
    with pytest.raises(InputError, match="free with all held parts"):
        chosen(few, ("held",), held=("top", "left"))
