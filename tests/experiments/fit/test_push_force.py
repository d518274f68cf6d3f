"""Force and depth of a contact that a hand-held camera films: turns of the camera are no depth."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.experiments.fit.push_force import HAND_TURN, TURN_SD, Pushed, PushOptions, found_by_force, with_force
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation, calibrate
from deformscope.stages.fit.force import contact_stiffness
from deformscope.stages.materials.press_cycle import PressForce
from deformscope.stages.see.particles import ParticleGrid, Rect, Tracked, seed_grid, select_held

GRID: ParticleGrid = seed_grid((300, 700), Rect(40, 60, 600, 160), (4, 15), None, None)
CONTACT = Rect(480, 60, 120, 40)
PARTS = ("left", "contact")
FPS, FRAMES, FORCE_N, DEPTH_PX = 30.0, 30, 2.0, 24.0
TURN = 4e-3 * np.sin(np.arange(FRAMES) / 4.0)
HELD = select_held(GRID, PARTS, CONTACT)


def bent(depth: float) -> FloatArray:
    """A beam that is held at the left, [px]: it slides like a guided one."""
    share = np.clip((GRID.rest_px[:, 0] - 40.0) / 440.0, 0.0, 1.0)
    down = depth * share**2 * (3.0 - 2.0 * share)
    return np.asarray(GRID.rest_px + np.column_stack([np.zeros(len(down)), down]))


def filmed(position: FloatArray, turn: float) -> FloatArray:
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray((position - (350.0, 150.0)) @ np.array([[c, s], [-s, c]]) + (350.0, 150.0))


def pushed(turns: FloatArray) -> Pushed:
    """What is found of a camera that turned by TURN, of which `turns` was seen."""
    depth = DEPTH_PX * np.clip((np.arange(FRAMES) - 5) / 20.0, 0.0, 1.0) ** 2
    count = len(GRID.rest_px)
    history = [
        Tracked(filmed(bent(one), turn), np.full(count, 0.05), np.ones(count, dtype=bool), np.zeros(count))
        for one, turn in zip(depth, TURN, strict=True)
    ]
    last = history[-1]
    seen = Observation(
        GRID.rest_px, last.position_px, HELD, last.seen, noise=last.noise_px, shape=GRID.shape, cell=GRID.cell,
        unit="px", metres_per_unit=1e-4, held_measured=True,
    )  # fmt: skip
    clock = np.arange(0.0, 4.0, 0.02)
    force = np.interp(clock - 1.7, np.arange(FRAMES) / FPS, FORCE_N * depth / DEPTH_PX)
    force += 2e-3 * np.random.default_rng(0).standard_normal(len(clock))
    log = PressForce(clock, force, 2e-3)
    times = (np.arange(FRAMES) / FPS).tolist()
    return with_force(seen, GRID, history, times, turns, PARTS, CONTACT, PushOptions(), log, 0.9)


def test_a_camera_that_turns_moves_neither_clock_nor_depth() -> None:
    found = pushed(TURN)
    assert found.offset is not None
    assert found.offset.value == pytest.approx(1.7, abs=0.2 / FPS)
    assert found.seen.force_n == pytest.approx(FORCE_N, rel=0.01)
    value, (low, high) = contact_stiffness([found.seen], 0.9) or (0.0, (0.0, 0.0))
    truth = FORCE_N / (0.1 * DEPTH_PX)
    assert value == pytest.approx(truth, rel=0.02)
    assert low <= truth <= high
    assert high - low < 0.15 * truth


def test_an_unknown_turn_is_named_and_in_the_interval() -> None:
    found = pushed(np.append(0.0, np.full(FRAMES - 1, np.nan)))
    assert found.seen.turn_sd == HAND_TURN
    _, (low, high) = contact_stiffness([found.seen], 0.9) or (0.0, (0.0, 0.0))
    assert high - low > 0.15 * FORCE_N / (0.1 * DEPTH_PX)
    estimate = calibrate([found.seen], FitOptions(Model(), candidates=8)).estimate
    known = dataclasses.replace(found, seen=dataclasses.replace(found.seen, turn_sd=TURN_SD))
    for one, named in ((found, True), (known, False)):
        reasons = found_by_force(estimate, one, PushOptions(), 0).reasons
        assert any("turned the camera" in doubt.text for doubt in reasons) == named
