"""Yielding from recorded motion: a known yield strain and creep are found again, and nothing where nothing yielded."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.motion import Motion
from deformscope.stages.materials.plasticity import YieldOptions, fit_yield
from deformscope.stages.msm import clusters
from deformscope.stages.msm.materials import Plasticity
from deformscope.stages.msm.plastic import PlasticMsm
from deformscope.stages.msm.solver import Msm
from tests.cases import slow_but
from tests.stages.bodies import SPACING_M, lattice

BETA = 0.7


def pressed(
    shape: tuple[int, ...],
    yield_strain: float,
    *,
    noise: float = 0.01,
    seed: int = 0,
    depth: float = 1.4,
    creep: float = np.inf,
    dt: float | None = None,
    frames: int = 4,
) -> Motion:
    """A block on its lowest layer, pressed in the middle of its top by `depth` spacings, and let go.

    noise: of every coordinate, held ones too, as a share of the depth"""
    rng = np.random.default_rng(seed)
    rest = lattice(shape)
    low = np.flatnonzero(rest[:, -1] <= 0.0)
    top = np.flatnonzero(rest[:, -1] >= rest[:, -1].max() - 1e-9)
    middle = rest[:, :-1].max(axis=0) / 2.0
    pressing = np.concatenate([low, top[np.linalg.norm(rest[top][:, :-1] - middle, axis=1) <= 1.01 * SPACING_M]])
    grouped = clusters.lattice(rest, shape, np.arange(len(rest)), 3)
    body = PlasticMsm(Msm(rest, grouped, pressing), Plasticity(yield_strain, creep))
    loads = [*np.linspace(0.0, 1.0, frames // 2 + 1)[1:], *np.linspace(1.0, 0.3, frames // 2), 0.0, 0.0]
    states, held = [], np.zeros((len(loads), len(rest)), dtype=bool)
    for frame, load in enumerate(loads):
        index = pressing if load else low
        position = rest[index]
        position[len(low) :, -1] -= load * depth * SPACING_M
        body.hold(index)
        states.append(body.load(position, BETA, duration=dt, settled=1e-4).position[0])
        held[frame, index] = True
    motion = np.stack(states)
    motion += rng.normal(0.0, noise * depth * SPACING_M, motion.shape)
    duration = None if dt is None else np.full(len(loads), dt)
    return Motion(rest, motion, held, duration, tuple(shape), np.arange(len(rest)))


@pytest.mark.parametrize(
    ("shape", "truth"), [((7, 5), 0.08), pytest.param((5, 5, 4), 0.06, marks=pytest.mark.slow, id="in-space")]
)
def test_a_known_yield_strain_is_found_again_under_one_percent_noise(shape: tuple[int, ...], truth: float) -> None:
    found = fit_yield(pressed(shape, truth), YieldOptions(beta=BETA))
    assert found.converged
    assert found.yield_strain.value == pytest.approx(truth, rel=0.04)
    assert found.verdict == "identified"
    assert found.explained > 0.9
    low, high = found.yield_strain.interval
    assert 0.8 * truth < low < high < 1.2 * truth
    assert found.elastic_deviation > 3.0 * found.deviation
    # the noise that was put in is the noise that is left
    assert found.settings["noise"] == pytest.approx(0.014 * SPACING_M, rel=0.1)
    # the error is least at the estimate
    strain, rms = found.curve
    assert strain[np.argmin(rms)] == pytest.approx(found.yield_strain.value, rel=0.03)


@pytest.mark.slow
def test_beta_is_found_along_with_it() -> None:
    found = fit_yield(pressed((7, 5), 0.08))
    assert found.yield_strain.value == pytest.approx(0.08, rel=0.05)
    assert found.beta.value == pytest.approx(BETA, abs=0.03)
    low, high = found.beta.interval
    assert low < found.beta.value < high
    assert not found.beta.given


@pytest.mark.slow
def test_creep_is_found_where_time_is_known() -> None:
    motion = pressed((7, 5), 0.06, creep=3.0, dt=0.1, frames=8)
    found = fit_yield(motion, YieldOptions(beta=BETA, creep="fit"))
    assert found.yield_strain.value == pytest.approx(0.06, rel=0.08)
    assert found.creep.value == pytest.approx(3.0, rel=0.05)
    low, high = found.creep.interval
    assert low < 3.0 < high
    given = fit_yield(motion, YieldOptions(beta=BETA, creep=3.0))
    assert given.creep.given
    assert given.yield_strain.value == pytest.approx(0.06, rel=0.05)


@pytest.mark.parametrize("seed", slow_but([0], range(2)))
def test_where_nothing_yielded_only_a_lower_end_is_reported(seed: int) -> None:
    found = fit_yield(pressed((6, 4), 5.0, seed=seed), YieldOptions(beta=BETA))
    assert found.verdict == "unidentified"
    low, high = found.yield_strain.interval
    assert high is None
    assert 0.5 * found.largest_strain < low < 5.0
    assert found.deviation == pytest.approx(found.elastic_deviation, rel=0.02)


@pytest.mark.slow
def test_without_noise_the_truth_is_within_the_interval() -> None:
    found = fit_yield(pressed((6, 4), 0.07, noise=0.0), YieldOptions(beta=BETA))
    low, high = found.yield_strain.interval
    assert low <= 0.07 <= high
    assert found.yield_strain.value == pytest.approx(0.07, rel=3e-3)


@pytest.mark.slow
def test_particles_that_were_not_seen_do_not_count() -> None:
    motion = pressed((6, 4), 0.07)
    lost = motion.position.copy()
    lost[:, 20][~motion.held[:, 20]] = np.nan
    lost[3, 10] = np.nan
    found = fit_yield(Motion(motion.rest, lost, motion.held, None, motion.shape, motion.cell), YieldOptions(beta=BETA))
    assert found.yield_strain.value == pytest.approx(0.07, rel=0.06)


def test_the_public_form() -> None:
    reported = fit_yield(pressed((6, 4), 5.0, frames=4), YieldOptions(beta=BETA)).as_json()
    interval = reported["interval"]
    assert isinstance(interval, list)
    assert interval[1] is None
    assert reported["verdict"] == "unidentified"
    assert reported["beta"] == {"value": BETA, "interval": [BETA, BETA], "given": True}
    assert reported["creep_per_s"] is None


def _broken(**change: object) -> Motion:
    rest: FloatArray = lattice((4, 3))
    held = np.zeros((3, len(rest)), dtype=bool)
    held[:, :3] = True
    parts = {"rest": rest, "position": np.repeat(rest[None], 3, axis=0), "held": held} | change
    return Motion(**parts)  # type: ignore[arg-type]


def test_motions_that_make_no_sense_are_refused() -> None:
    missing = np.repeat(lattice((4, 3))[None], 3, axis=0)
    missing[1, 0] = np.nan
    with pytest.raises(InputError, match="held of shape"):
        _broken(held=np.zeros((2, 12), dtype=bool))
    with pytest.raises(InputError, match="positions of the held"):
        _broken(position=missing)
    with pytest.raises(InputError, match="held particles in every frame"):
        _broken(held=np.zeros((3, 12), dtype=bool))
    with pytest.raises(InputError, match="time between frames"):
        fit_yield(_broken(), YieldOptions(creep="fit"))
    with pytest.raises(InputError, match="none, fit or a rate"):
        YieldOptions(creep="soon")


@pytest.mark.slow
def test_a_motion_that_the_model_does_not_explain_has_no_yield_strain() -> None:
    """Particles that go each its own way, between prescribed ones that are pressed and let go."""
    motion = pressed((5, 4), 0.08)
    astray = np.random.default_rng(4).normal(0.0, 0.6 * SPACING_M, motion.position.shape)
    position = np.where(motion.held[:, :, None], motion.position, motion.position + astray)
    found = fit_yield(dataclasses.replace(motion, position=position), YieldOptions(beta=BETA))
    assert found.explained < 0.3
    assert found.verdict == "unidentified"
    assert found.as_json()["explained"] == found.explained
