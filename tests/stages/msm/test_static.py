"""Static states: never silently wrong, and independent of what they do not depend on."""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.msm import clusters, iteration, reference
from deformscope.stages.msm.clusters import Clusters
from deformscope.stages.msm.reference import Rest, Volume
from deformscope.stages.msm.solver import Msm, Precision, Relaxed
from tests.cases import Patch, slow_but
from tests.stages import reference_states
from tests.stages.bodies import SPACING_M, lattice, pushed

TIGHT = 1e-13
"""Tolerance of states that others are measured against: next to rounding. Their own flag may fail there."""

MODES: tuple[tuple[Volume, float], ...] = (("scale", 0.0), ("project", 0.6))
"""The two with an energy: their states are its minima."""


def _turn(rng: np.random.Generator, dim: int) -> FloatArray:
    q = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    q[:, 0] *= np.sign(np.linalg.det(q))
    return q


def _rms(rows: FloatArray) -> FloatArray:
    """(B, K, d) -> (B,)"""
    return np.sqrt(np.mean(np.sum(rows**2, axis=-1), axis=-1))


@dataclass(frozen=True)
class Press:
    """A lattice between two plates, of which the upper comes down, a little unevenly so that nothing is symmetric.

    Candidates are all combinations of parameters: beta, theta (B,), and held positions (B, n, d)."""

    rest: FloatArray
    grouped: Clusters
    held: IntArray
    beta: FloatArray
    theta: FloatArray
    held_position: FloatArray
    start: FloatArray

    @property
    def spec(self) -> Rest:
        return reference.build_rest(self.rest, self.grouped, self.held)


BETAS = (0.0, 0.5, 0.8, 0.95, 0.99)
THETAS = (0.3, 1.0)
SHARES = (0.1, 0.2, 0.3, 0.45, 0.6)
"""By which the body is pressed together."""

PRESSED = [((6, 9), 3), ((8, 6), 2), ((4, 4, 5), 3), ((3, 4, 5), 2)]
"""Four bodies of 50 candidates each."""


def _press(shape: tuple[int, ...], size: int) -> Press:
    rng = np.random.default_rng(1)
    rest = lattice(shape)
    up = rest[:, -1]
    low, high = np.flatnonzero(up <= 0.0), np.flatnonzero(up >= up.max() - 1e-9)
    held = np.concatenate([low, high])
    beta, theta, share = np.array(list(itertools.product(BETAS, THETAS, SHARES))).T
    position = np.repeat(rest[held][None], len(beta), axis=0)
    position[:, len(low) :, -1] -= share[:, None] * up.max()
    position[:, len(low) :, :-1] += rng.normal(0, 0.02 * SPACING_M, position[:, len(low) :, :-1].shape)
    start = rest + rng.normal(0, 0.02 * SPACING_M, rest.shape)
    return Press(rest, clusters.lattice(rest, shape, np.arange(len(rest)), size), held, beta, theta, position, start)


def _left(press: Press, found: Relaxed, rows: BoolArray, volume: Volume) -> FloatArray:
    """Root mean square of goal - position by the reference, for some rows."""
    spec = press.spec
    return np.array(
        [
            _rms((reference_states.goals(x, spec, float(b), float(t), volume=volume) - x)[None])[0]
            for x, b, t in zip(found.position[rows], press.beta[rows], press.theta[rows], strict=True)
        ]
    )


@pytest.mark.parametrize(("shape", "size"), slow_but([PRESSED[0], PRESSED[2]], PRESSED))
def test_with_projection_every_pressed_body_converges_to_what_the_equations_hold(
    device: str, shape: tuple[int, ...], size: int
) -> None:
    press = _press(shape, size)
    engine = Msm(press.rest, press.grouped, press.held, device=device)
    found = engine.relax(press.held_position, press.beta, press.theta, volume="project", start=press.start)
    failed = np.column_stack([press.beta, press.theta, found.residual / engine.extent])[~found.converged]
    assert found.converged.all(), f"beta, theta, residual: {failed}"
    assert not found.diverged.any()
    # what is left is shorter than the distance to go, of which `converged` speaks (1e-9 of the extent)
    assert _left(press, found, found.converged, "project").max() < 1e-9 * engine.extent
    np.testing.assert_array_equal(found.position[:, press.held], _as_held(engine, press))


def _as_held(engine: Msm, press: Press) -> FloatArray:
    """Held positions as they come out of spacings again."""
    rest = engine.rest[press.held]
    return rest + (press.held_position - rest) / engine.scale * engine.scale


@pytest.mark.parametrize(("shape", "size"), slow_but([PRESSED[2]], PRESSED))
def test_pressed_bodies_with_eq_3_17_converge_or_say_that_they_did_not(
    device: str, shape: tuple[int, ...], size: int
) -> None:
    press = _press(shape, size)
    engine = Msm(press.rest, press.grouped, press.held, device=device)
    found = engine.relax(press.held_position, press.beta, press.theta, volume="scale", start=press.start)
    assert np.isfinite(found.position).all()
    assert not np.any(found.converged & found.diverged)
    assert found.converged.mean() > 0.5
    assert _left(press, found, found.converged, "scale").max() < 1e-9 * engine.extent


@pytest.mark.slow
def test_second_beginnings_have_the_iterations_that_they_need(device: str) -> None:
    """Bodies at beta .95 and .99, which come to their state slowly: each converges, or runs away and says so."""
    press = _press(*PRESSED[3])
    engine = Msm(press.rest, press.grouped, press.held, device=device)
    found = engine.relax(press.held_position, press.beta, press.theta, volume="scale", start=press.start)
    assert np.all(found.converged | found.diverged)
    assert found.converged.sum() >= 40
    assert _left(press, found, found.converged, "scale").max() < 1e-9 * engine.extent


def test_bodies_that_slip_and_come_to_no_state_say_so(device: str) -> None:
    """Time steps, which tell whether a second beginning runs away, are of bodies that do not slip alone."""
    press = _press(*PRESSED[1])
    pressed = press.held[
        press.held_position.reshape(-1, *press.rest[press.held].shape)[0, :, -1] != press.rest[press.held, -1]
    ]
    engine = Msm(press.rest, press.grouped, press.held, device=device, slipping=(pressed, press.rest.shape[1] - 1))
    found = engine.relax(press.held_position, press.beta, press.theta, volume="scale", start=press.start)
    assert found.converged.any()
    assert not found.converged.all()
    assert np.isfinite(found.position).all()


def test_a_second_beginning_whose_time_is_over_leaves_the_nearer_state(device: str, monkeypatch: Patch) -> None:
    press = _press(*PRESSED[1])
    engine = Msm(press.rest, press.grouped, press.held, device=device)
    first = engine.relax(
        press.held_position, press.beta, press.theta, volume="scale", start=press.start, max_iterations=4_000
    )
    resumed = ~(first.converged | first.diverged) & (press.theta > 0.0)
    assert resumed.any()
    relax = Msm.relax

    def without_time(self: Msm, *args: Any, **how: Any) -> Any:
        return relax(self, *args, **{**how, "limit_s": 0.0})

    monkeypatch.setattr(Msm, "relax", without_time)
    found = relax(engine, press.held_position, press.beta, press.theta, volume="scale", start=press.start)
    assert np.array_equal(found.out_of_time, resumed)
    assert np.all(found.error[resumed] <= first.error[resumed])


def test_pressed_bodies_that_converged_with_eq_3_17_are_as_near_as_they_say(device: str) -> None:
    press = _press(*PRESSED[0])
    engine = Msm(press.rest, press.grouped, press.held, device=device)
    found = engine.relax(press.held_position, press.beta, press.theta, volume="scale", start=press.start)
    assert np.all(found.error[found.converged] <= 1e-9 * engine.extent)


@pytest.mark.parametrize("volume", ["project", "scale"])
@pytest.mark.parametrize(("shape", "size"), slow_but([PRESSED[2]], PRESSED))
def test_single_precision_is_never_silently_wrong(
    device: str, shape: tuple[int, ...], size: int, volume: Volume
) -> None:
    press = _press(shape, size)
    engine = Msm(press.rest, press.grouped, press.held, precision="float32", device=device)
    found = engine.relax(press.held_position, press.beta, press.theta, volume=volume, start=press.start)
    assert np.isfinite(found.position).all()
    assert not np.any(found.converged & found.diverged)
    assert found.converged.mean() > 0.4  # eq. 3.17 has no stable state for many
    limit = 3e-5 * engine.extent  # its default tolerance
    assert _left(press, found, found.converged, volume).max() < limit
    if volume == "project":
        assert np.all(found.error[found.converged] <= limit)


@pytest.mark.parametrize("volume", ["project", "scale"])
@pytest.mark.parametrize(("shape", "size"), slow_but([], [PRESSED[0], PRESSED[3]]))
def test_what_converged_in_single_precision_is_near_what_double_precision_makes_of_it(
    device: str, shape: tuple[int, ...], size: int, volume: Volume
) -> None:
    """A residual within rounding proves little where a body is soft: its distance to the static state does."""
    press = _press(shape, size)
    engine = Msm(press.rest, press.grouped, press.held, precision="float32", device=device)
    found = engine.relax(press.held_position, press.beta, press.theta, volume=volume, start=press.start)
    exact = Msm(press.rest, press.grouped, press.held, device=device).relax(
        press.held_position,
        press.beta,
        press.theta,
        volume=volume,
        start=found.position,
        tolerance=1e-8,  # far below what is asked of single precision, and within reach of a warm start
    )
    known = found.converged & exact.converged
    assert known.sum() >= 15
    assert _rms(found.position - exact.position)[known].max() < 3e-5 * engine.extent  # its default tolerance


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "size"), [((12, 30), 2), ((6, 6, 8), 2), ((6, 6, 8), 4), ((5, 5, 20), 3)])
def test_with_projection_larger_pressed_bodies_converge(device: str, shape: tuple[int, ...], size: int) -> None:
    press = _press(shape, size)
    engine = Msm(press.rest, press.grouped, press.held, device=device)
    found = engine.relax(press.held_position, press.beta, press.theta, volume="project", start=press.start)
    failed = np.column_stack([press.beta, press.theta, found.residual / engine.extent])[~found.converged]
    assert found.converged.all(), f"beta, theta, residual: {failed}"
    assert _left(press, found, found.converged, "project").max() < 1e-9 * engine.extent


@pytest.mark.parametrize(("volume", "theta"), MODES)
@pytest.mark.parametrize("shape", [(6, 7), (4, 4, 4)])
def test_the_start_does_not_matter(device: str, shape: tuple[int, ...], volume: Volume, theta: float) -> None:
    """Moderate pushes, which leave one state to go to; starts up to half a spacing off, at once and one by one."""
    rng = np.random.default_rng(11)
    body = pushed(shape, rng)
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    starts = body.rest + rng.normal(0, 0.3 * SPACING_M, (6, *body.rest.shape))
    for beta in (0.2, 0.8, 0.95):
        expected = engine.relax(body.held_position, beta, theta, volume=volume, tolerance=1e-11)
        together = engine.relax(body.held_position, beta, theta, volume=volume, start=starts, tolerance=1e-11)
        assert together.converged.all()
        limit = 1e-9 * engine.extent  # two estimates of 1e-11, of a mean over some 60 particles
        np.testing.assert_allclose(together.position - expected.position, 0.0, atol=limit)
        alone = engine.relax(body.held_position, beta, theta, volume=volume, start=starts[0], tolerance=1e-11)
        np.testing.assert_allclose(alone.position, expected.position, rtol=0.0, atol=limit)


@pytest.mark.parametrize(("volume", "theta"), MODES)
@pytest.mark.parametrize("shape", [(6, 5), (4, 3, 4)])
def test_stepping_comes_to_the_static_state_whatever_dt(
    device: str, shape: tuple[int, ...], volume: Volume, theta: float
) -> None:
    body = pushed(shape, np.random.default_rng(12))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    static = engine.relax(body.held_position, 0.6, theta, volume=volume, tolerance=1e-12).position
    for dts in ((2e-3, 2e-3), (1e-4, 2e-2)):
        state = engine.start()
        # half the way each: a motion goes on over a change of dt
        for dt in dts:
            moved = engine.step(state, body.held_position, 0.6, theta, volume=volume, alpha=0.6, dt=dt, steps=4000)
        np.testing.assert_allclose(moved, static, rtol=0.0, atol=1e-9 * engine.extent)


@pytest.mark.parametrize(("volume", "theta"), [*MODES, pytest.param("scale", 0.3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("shape", [(6, 7), (4, 3, 5)])
def test_turned_and_moved_bodies_have_turned_and_moved_states(
    device: str, precision: Precision, shape: tuple[int, ...], volume: Volume, theta: float
) -> None:
    rng = np.random.default_rng(13)
    body = pushed(shape, rng)
    dim = len(shape)
    turn, away = _turn(rng, dim), rng.normal(0, 5 * SPACING_M, dim)
    grouped = body.clusters(3)
    engine = Msm(body.rest, grouped, body.held, precision=precision, device=device)
    expected = engine.relax(body.held_position, 0.7, theta, volume=volume)
    assert expected.converged[0]
    expected_moved = expected.position @ turn + away
    limit = (1e-8 if precision == "float64" else 3e-4) * engine.extent  # ten times the default tolerance
    # everything with it, and only its held particles: a body has no notion of where it was at rest
    whole = Msm(body.rest @ turn + away, grouped, body.held, precision=precision, device=device)
    found = whole.relax(body.held_position @ turn + away, 0.7, theta, volume=volume)
    np.testing.assert_allclose(found.position, expected_moved, rtol=0.0, atol=limit)
    found = engine.relax(body.held_position @ turn + away, 0.7, theta, volume=volume, start=body.rest @ turn + away)
    np.testing.assert_allclose(found.position, expected_moved, rtol=0.0, atol=limit)


@pytest.mark.parametrize(("volume", "theta"), [*MODES, pytest.param("scale", 0.3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("shape", [(6, 7), (4, 3, 5)])
def test_size_does_not_matter(
    device: str, precision: Precision, shape: tuple[int, ...], volume: Volume, theta: float
) -> None:
    """Bodies of 1 mm, 10 cm and 10 m."""
    body = pushed(shape, np.random.default_rng(14))
    extent = float(np.ptp(body.rest))
    ends = []
    for size_m in (1e-3, 0.1, 10.0):
        by = size_m / extent
        engine = Msm(body.rest * by, body.clusters(3), body.held, precision=precision, device=device)
        found = engine.relax(body.held_position * by, 0.8, theta, volume=volume)
        assert found.converged[0]
        if volume == "project" or theta == 0.0:
            assert found.error[0] <= {"float64": 1e-9, "float32": 3e-5}[precision] * size_m
        ends.append(found.position / by)
    # the last digits of the input differ with its scale, and with them the states, within the default tolerance
    limit = (1e-8 if precision == "float64" else 3e-4) * extent
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=limit)
    np.testing.assert_allclose(ends[2], ends[0], rtol=0.0, atol=limit)


@pytest.mark.parametrize("grouping", ["lattice", "lists", "single"])
@pytest.mark.parametrize(("volume", "theta"), MODES)
def test_masses_weigh_as_in_the_reference(device: str, grouping: str, volume: Volume, theta: float) -> None:
    rng = np.random.default_rng(15)
    body = pushed((5, 6), rng)
    grouped = body.clusters(3 if grouping != "single" else 9)
    if grouping == "lists":
        grouped = clusters.Clusters(list(grouped), len(body.rest))
    mass = rng.uniform(0.5, 2.0, len(body.rest))
    mass[14] = 100.0
    states = []
    for each in (mass, 2.0 * mass, 1e-6 * mass, None):
        engine = Msm(body.rest, grouped, body.held, mass=each, device=device)
        found = engine.relax(body.held_position, 0.7, theta, volume=volume, tolerance=1e-11)
        assert found.converged[0]
        states.append(found.position[0])
    limit = 1e-9 * engine.extent
    np.testing.assert_allclose(states[1], states[0], rtol=0.0, atol=limit)
    np.testing.assert_allclose(states[2], states[0], rtol=0.0, atol=limit)
    spec = reference.build_rest(body.rest, grouped, body.held, mass)
    left = reference_states.goals(states[0], spec, 0.7, theta, volume=volume) - states[0]
    assert np.abs(left).max() < 1e-10 * engine.extent
    # the heavy particle matters: even masses give another state
    assert np.abs(states[3] - states[0]).max() > 1e-3 * engine.extent


ERROR_CASES = 30
"""For each way to conserve volume."""


@pytest.mark.parametrize(("volume", "theta"), [*MODES, ("scale", 0.2)])
@pytest.mark.parametrize("tolerance", slow_but([1e-5], [1e-3, 1e-5, 1e-7]))
def test_error_is_no_smaller_than_the_error(device: str, tolerance: float, volume: Volume, theta: float) -> None:
    rng = np.random.default_rng(16)
    for case in range(ERROR_CASES):
        shape = tuple(int(n) for n in (rng.integers(4, 10, 2) if case % 2 else rng.integers(3, 6, 3)))
        body = pushed(shape, rng, push=0.7)
        engine = Msm(body.rest, body.clusters(int(rng.integers(2, 5))), body.held, device=device)
        beta = 1.0 - 10.0 ** rng.uniform(-2.0, 0.0)
        loose = engine.relax(body.held_position, beta, theta, volume=volume, tolerance=tolerance)
        if not loose.converged[0]:
            assert volume == "scale"
            assert theta > 0.0
            continue
        # from where it is: some bodies have more than one state
        tight = engine.relax(
            body.held_position, beta, theta, volume=volume, tolerance=TIGHT, start=loose.position, max_iterations=20_000
        )
        assert tight.residual[0] < 1e-12 * engine.extent
        error = _rms((loose.position - tight.position)[:, engine.free])[0]
        assert error <= loose.error[0] + 1e-11 * engine.extent, (case, shape, beta, error / loose.error[0])
        assert loose.error[0] <= tolerance * engine.extent


@pytest.mark.parametrize("size", [3, 9])
@pytest.mark.parametrize("shape", [(6, 5), (4, 3, 4)])
def test_a_tolerance_that_rounding_forbids_is_no_divergence(device: str, shape: tuple[int, ...], size: int) -> None:
    body = pushed(shape, np.random.default_rng(17))
    engine = Msm(body.rest, body.clusters(size), body.held, device=device)
    found = engine.relax(body.held_position, np.linspace(0.1, 0.9, 20), tolerance=1e-17)
    assert found.residual.max() < 1e-11 * engine.extent
    assert not found.diverged.any()


@pytest.mark.parametrize(("volume", "theta"), [*MODES, pytest.param("scale", 0.3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("shape", [(12, 12, 12), (22, 22, 22)])
def test_a_solve_whose_time_is_over_says_so_and_what_is_left(
    device: str, shape: tuple[int, ...], volume: Volume, theta: float
) -> None:
    """Kernels that stay for some hundred evaluations, and a preconditioned lattice."""
    body = pushed(shape, np.random.default_rng(19))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    found = engine.relax(body.held_position, 0.95, theta, volume=volume, limit_s=0.0)
    assert found.out_of_time.all()
    assert not found.converged.any()
    assert not found.diverged.any()
    left = _rms(engine.residual(found.position, 0.95, theta, volume=volume))
    assert 1e-9 * engine.extent < left[0] < 10.0 * found.residual[0]
    if volume == "project" or theta == 0.0:  # an accelerated step follows the last residual of the others
        assert found.residual[0] < 10.0 * left[0]
    assert not engine.relax(body.held_position, 0.95, theta, volume=volume, limit_s=600.0).out_of_time.any()


@pytest.mark.parametrize(("volume", "theta"), [*MODES, pytest.param("scale", 0.3, marks=pytest.mark.slow)])
def test_one_long_solve_tells_that_it_runs(device: str, monkeypatch: Patch, volume: Volume, theta: float) -> None:
    monkeypatch.setattr(iteration, "TELL_EVERY_S", 0.0)
    body = pushed((22, 22, 22), np.random.default_rng(20))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    seen: list[tuple[int, int]] = []
    found = engine.relax(
        body.held_position, 0.9, theta, volume=volume, progress=lambda done, of: seen.append((done, of))
    )
    assert found.converged.all()
    assert seen[-1] == (1, 1)
    assert seen.count((0, 1)) > 3  # within its linear equations, too


@pytest.mark.parametrize(("volume", "theta"), [*MODES, pytest.param("scale", 0.3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("shape", [(7, 9), (4, 4, 5)])
def test_warm_starts_cost_less_and_change_nothing(
    device: str, precision: Precision, shape: tuple[int, ...], volume: Volume, theta: float
) -> None:
    body = pushed(shape, np.random.default_rng(18))
    engine = Msm(body.rest, body.clusters(3), body.held, precision=precision, device=device)
    beta = np.linspace(0.5, 0.8, 5)
    cold = engine.relax(body.held_position, beta, theta, volume=volume)
    near = engine.relax(body.held_position, beta + 0.003, theta, volume=volume).position
    warm = engine.relax(body.held_position, beta, theta, volume=volume, start=near)
    assert cold.converged.all()
    assert warm.converged.all()
    assert warm.iterations.sum() < cold.iterations.sum()
    limit = (1e-8 if precision == "float64" else 3e-4) * engine.extent  # ten times the default tolerance
    np.testing.assert_allclose(warm.position, cold.position, rtol=0.0, atol=limit)
    again = engine.relax(body.held_position, beta, theta, volume=volume, start=warm.position)
    assert again.converged.all()
    assert again.iterations.sum() < cold.iterations.sum()  # it earns its flag anew
    np.testing.assert_allclose(again.position, warm.position, rtol=0.0, atol=limit)
    # one start for all is the same as that start for each
    each = engine.relax(body.held_position, beta, theta, volume=volume, start=np.repeat(near[:1], 5, axis=0))
    shared = engine.relax(body.held_position, beta, theta, volume=volume, start=near[0])
    np.testing.assert_array_equal(shared.position, each.position)
