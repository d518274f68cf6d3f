"""Calibration: known truths are found inside the stated interval at about its stated level, and verdicts are honest."""

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation, calibrate
from deformscope.stages.fit.estimate import verdict
from deformscope.stages.msm import clusters, reference
from studies.reproduce.pressed_cubes import thesis_cubes
from tests.cases import slow_but
from tests.stages import reference_states
from tests.stages.bodies import Pushed, lattice, pushed

BETA_BOUNDS, THETA_BOUNDS = (0.0, 0.99), (0.0, 1.0)
THETA_MODEL = Model("theta", "quadratic", None, beta=0.99)


def observation(body: Pushed, deformed: FloatArray, **more: object) -> Observation:
    count = len(body.rest)
    given = {"observed": np.ones(count, dtype=bool), "shape": body.shape, "cell": np.arange(count)} | more
    return Observation(body.rest, deformed, body.held, **given)  # type: ignore[arg-type]


def truth(body: Pushed, size: int, beta: float) -> FloatArray:
    """Static state by the float64 reference, not by the engine that is fitted."""
    spec = reference.build_rest(body.rest, body.clusters(size), body.held)
    state, residual = reference_states.relax(spec, body.held_position, beta=beta)
    assert residual < 1e-8
    return state


@pytest.mark.parametrize(
    ("dim", "size", "beta"),
    slow_but([(3, 3, 0.62), (2, 3, 0.975)], [(2, 2, 0.35), (2, 4, 0.9), (3, 3, 0.62), (2, 3, 0.975)]),
)
def test_exact_data_give_the_exact_value(device: str, dim: int, size: int, beta: float) -> None:
    body = pushed((5, 6) if dim == 2 else (3, 4, 4), np.random.default_rng(size))
    seen = observation(body, truth(body, size, beta))
    for method in ("sweep", "gradient"):
        options = FitOptions(Model(cluster_size=size, device=device), BETA_BOUNDS, method=method)
        found = calibrate([seen], options).estimate
        assert found.value == pytest.approx(beta, abs=2e-4), method
        assert found.verdict == "identified"
        assert found.aee < 1e-6
    stated = calibrate(
        [observation(body, seen.deformed, noise=np.zeros(len(body.rest)))],
        FitOptions(Model(cluster_size=size), BETA_BOUNDS),
    )
    assert stated.estimate.interval[0] <= stated.estimate.value <= stated.estimate.interval[1]
    assert stated.estimate.verdict == "identified"


@pytest.mark.parametrize("ratio", [0.25, 0.4])
def test_a_misfit_body_has_the_theta_of_least_squares_and_the_thesis_value_beside_it(ratio: float) -> None:
    """Value, interval and posterior of one definition: on finite elements, which no theta fits, the two differ."""
    (cube,), _ = thesis_cubes((ratio,), (5,), (0.01,))
    seen, dense = cube.seen, np.linspace(0.0, 1.0, 2001)
    found = calibrate([seen], FitOptions(THETA_MODEL, THETA_BOUNDS))
    states = THETA_MODEL.body(seen).relax(seen.deformed[seen.held], THETA_MODEL.beta, dense).position
    off = np.linalg.norm(states - seen.deformed, axis=2)
    squares, mean = (dense[(off**power).mean(axis=1).argmin()] for power in (2, 1))
    assert abs(squares - mean) > 3e-3
    one = found.estimate
    assert one.value == pytest.approx(squares, abs=2e-3)
    assert one.least_aee == pytest.approx((mean, off.mean(axis=1).min()), abs=1e-3)
    assert one.aee > one.least_aee[1]
    assert one.interval[0] < one.value < one.interval[1]
    assert abs(found.inferred.posterior.rank(one.value) - 0.5) < 0.15
    given = one.as_json()
    assert (given["value"], given["least_aee"]["theta"]) == (one.value, one.least_aee[0])
    assert given["least_aee"]["aee_m"] < given["aee_m"]


@pytest.mark.slow
@pytest.mark.parametrize("beta", [0.0, 0.99])
def test_truth_at_a_bound_is_held_and_named(beta: float) -> None:
    body = pushed((5, 6), np.random.default_rng(11))
    rng = np.random.default_rng(12)
    clean = truth(body, 3, beta)
    hits = 0
    for case in range(12):
        noisy = clean + rng.normal(0, 2e-4, clean.shape)
        seen = observation(body, noisy, noise=np.full(len(clean), 2e-4))
        found = calibrate([seen], FitOptions(Model(), BETA_BOUNDS, candidates=60, seed=case)).estimate
        inside = found.interval[0] <= beta <= found.interval[1]
        hits += inside
        assert not inside or found.verdict in ("at-bound", "unidentified")
    assert hits >= 9


def test_more_noise_means_a_wider_interval_and_a_weaker_verdict() -> None:
    body = pushed((5, 6), np.random.default_rng(13))
    clean = truth(body, 3, 0.6)
    widths, verdicts = [], []
    for sigma in (5e-5, 5e-4, 5e-3):
        noisy = clean + np.random.default_rng(1).normal(0, sigma, clean.shape)
        seen = observation(body, noisy, noise=np.full(len(clean), sigma))
        found = calibrate([seen], FitOptions(Model(), BETA_BOUNDS)).estimate
        widths.append(found.interval[1] - found.interval[0])
        verdicts.append(found.verdict)
    assert widths[0] < widths[1] < widths[2]
    assert verdicts[0] == "identified"
    assert verdicts[-1] == "unidentified"


def test_the_estimate_repeats_bit_for_bit() -> None:
    body = pushed((5, 6), np.random.default_rng(14))
    noisy = truth(body, 3, 0.6) + np.random.default_rng(1).normal(0, 3e-4, body.rest.shape)
    every = [calibrate([observation(body, noisy)], FitOptions(Model(), BETA_BOUNDS, seed=3)) for _ in range(2)]
    assert every[0].estimate.as_json() == every[1].estimate.as_json()


def test_unseen_particles_do_not_count() -> None:
    body = pushed((6, 6), np.random.default_rng(15))
    clean = truth(body, 3, 0.5)
    seen_mask = np.ones(len(clean), dtype=bool)
    free = np.flatnonzero(~clusters.held_mask(len(clean), body.held))
    seen_mask[free[::4]] = False
    broken = clean.copy()
    broken[~seen_mask] = np.nan
    found = calibrate([observation(body, broken, observed=seen_mask)], FitOptions(Model(), BETA_BOUNDS))
    assert found.estimate.value == pytest.approx(0.5, abs=1e-3)
    assert np.isfinite(found.estimate.aee)


def test_a_pose_that_is_not_held_is_reported() -> None:
    body = pushed((5, 6), np.random.default_rng(22))
    one = dataclasses.replace(observation(body, body.rest + 1e-3), held=np.array([0]))
    assert not one.pose_held
    assert dataclasses.replace(one, held=np.array([0, 5])).pose_held
    assert calibrate([one], FitOptions(Model(), BETA_BOUNDS, candidates=10)).estimate.settings["pose_held"] is False


@pytest.mark.slow
def test_joint_fit_is_narrower_than_each() -> None:
    rng = np.random.default_rng(16)
    bodies = [pushed((5, 6), rng) for _ in range(4)]
    every = [
        observation(b, truth(b, 3, 0.55) + rng.normal(0, 3e-4, b.rest.shape), noise=np.full(len(b.rest), 3e-4))
        for b in bodies
    ]
    alone = [calibrate([one], FitOptions(Model(), BETA_BOUNDS)).estimate.interval for one in every]
    joint = calibrate(every, FitOptions(Model(), BETA_BOUNDS))
    assert len(joint.comparisons) == 4
    low, high = joint.estimate.interval
    assert high - low < np.median([b - a for a, b in alone])
    assert low - 0.02 <= 0.55 <= high + 0.02


def test_error_is_the_mean_over_all_particles() -> None:
    body = pushed((5, 6), np.random.default_rng(17))
    noisy = truth(body, 3, 0.5) + np.random.default_rng(2).normal(0, 3e-4, body.rest.shape)
    found = calibrate([observation(body, noisy)], FitOptions(Model(), BETA_BOUNDS))
    distance = np.linalg.norm(found.comparisons[0].simulated - noisy, axis=1)
    assert np.all(distance[body.held] < 1e-12)
    assert found.estimate.aee == pytest.approx(distance.mean(), rel=1e-9)
    free = ~clusters.held_mask(len(noisy), body.held)
    assert found.estimate.aee_free == pytest.approx(distance[free].mean(), rel=1e-9)
    assert found.estimate.curve.parameter[found.estimate.curve.aee.argmin()] == pytest.approx(
        found.estimate.least_aee[0], abs=0.0101
    )


def test_force_scales_the_stiffness() -> None:
    """With the same positions, a force three times as large means a stiffness three times as large."""
    body = pushed((5, 6), np.random.default_rng(18))
    clean = truth(body, 3, 0.5)
    contact = body.held[5:]
    value = {}
    for force in (1.0, 3.0):
        seen = observation(body, clean, force_n=force, contact=contact)
        found = calibrate([seen], FitOptions(Model(), BETA_BOUNDS)).estimate
        value[force] = found.stiffness[0]
        low, high = found.stiffness[1]
        assert low <= value[force] <= high
    assert value[3.0] == pytest.approx(3.0 * value[1.0])
    # what a body of that stiffness pushes back with is the force that was given
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    net = reference_states.reaction(clean, spec, 0.5)[contact].sum(axis=0)
    assert np.linalg.norm(net) * value[1.0] == pytest.approx(1.0, rel=1e-3)


def test_motion_that_the_model_does_not_explain_tells_nothing() -> None:
    body = pushed((6, 7), np.random.default_rng(24))
    moved = truth(body, 3, 0.5) - body.rest
    free = np.flatnonzero(~clusters.held_mask(len(moved), body.held))
    moved[free] = moved[np.random.default_rng(1).permutation(free)]
    found = calibrate([observation(body, body.rest + moved)], FitOptions(Model(), BETA_BOUNDS)).estimate
    assert found.verdict == "unidentified"
    assert found.identifiability.explained < 0.3
    assert "% of the motion" in found.verdict_text() or "do not identify it" in found.verdict_text()


@pytest.mark.parametrize("what", ["rest", "shift", "turn", "stretch"])
def test_motions_that_fit_every_value_tell_nothing(what: str) -> None:
    """A rigid motion, and a uniform stretch of a body of 2x2 clusters, are static for every beta."""
    rest = lattice((5, 6))
    angle = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    moved = {
        "rest": rest,
        "shift": rest + np.array([0.05, -0.02]),
        "turn": rest @ angle.T,
        "stretch": rest * [1.2, 1.0],
    }[what]
    edges = np.flatnonzero((rest[:, 0] <= 0.0) | (rest[:, 0] >= rest[:, 0].max() - 1e-9))
    seen = Observation(rest, moved, edges, np.ones(30, dtype=bool), shape=(5, 6), cell=np.arange(30))
    found = calibrate([seen], FitOptions(Model(cluster_size=2), BETA_BOUNDS)).estimate
    assert found.verdict == "unidentified"
    assert found.aee < 1e-9


@pytest.mark.slow
def test_residuals_decide_about_the_stated_noise_where_they_can() -> None:
    """Of many particles the residuals show the noise, whatever was stated; residuals that are no noise do not."""
    body = pushed((8, 9), np.random.default_rng(20))
    clean = truth(body, 3, 0.6)
    noise = np.random.default_rng(3).normal(0, 1.0, clean.shape)
    widths = {}
    for real in (2e-4, 0.0):
        for stated in (5e-5, 1e-4, 8e-4):
            seen = observation(body, clean + real * noise, noise=np.full(len(clean), stated), held_measured=True)
            low, high = calibrate([seen], FitOptions(Model(), BETA_BOUNDS, candidates=40)).estimate.interval
            widths[real, stated] = high - low
    reported = [widths[2e-4, stated] for stated in (5e-5, 1e-4, 8e-4)]
    assert max(reported) < 1.25 * min(reported)
    assert widths[0.0, 8e-4] > 2.0 * widths[0.0, 1e-4] > 3.0 * widths[0.0, 5e-5]


@pytest.mark.parametrize("bounds", [(0.5, 0.5), (0.9, 0.1), (-0.1, 0.5), (0.0, 1.0), (0.0, float("nan"))])
def test_ranges_that_cannot_be_searched_are_refused(bounds: tuple[float, float]) -> None:
    body = pushed((4, 4), np.random.default_rng(21))
    with pytest.raises(InputError, match="range"):
        calibrate([observation(body, body.rest + 1e-4)], FitOptions(Model(), bounds))


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ((0.4, 0.5), "identified"),
        ((0.3, 0.6), "weak"),
        ((0.1, 0.85), "unidentified"),
        ((0.0, 0.1), "at-bound"),
        ((0.9, 0.99), "at-bound"),
        ((0.0, 0.99), "unidentified"),
    ],
)
def test_verdicts(ends: tuple[float, float], expected: str) -> None:
    assert verdict(ends, BETA_BOUNDS) == expected


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda o: {"held": np.array([], dtype=int)}, "at least one held"),
        (lambda o: {"held": np.arange(len(o.rest))}, "some free"),
        (lambda o: {"deformed": np.where(np.arange(len(o.rest))[:, None] == 9, np.nan, o.deformed)}, "NaN"),
        (lambda o: {"rest": np.concatenate([o.rest[:1], o.rest[:-1]])}, "duplicate"),
        (lambda o: {"rest": o.rest * [1.0, 0.0] + [[0.0, 0.0]]}, "duplicate|line"),
        (lambda o: {"observed": np.zeros(len(o.rest), dtype=bool)}, "observed"),
    ],
)
def test_unusable_observations_are_refused(spoil: object, words: str) -> None:
    body = pushed((5, 6), np.random.default_rng(19))
    seen = observation(body, body.rest + 1e-4)
    with pytest.raises(InputError, match=words):
        dataclasses.replace(seen, **spoil(seen))  # type: ignore[operator]


def _block(path: Path) -> Observation:
    with np.load(path) as file:
        rest = file["X_grid"].reshape(-1, 2)
        deformed = rest + file["u_grid"].reshape(-1, 2)
    held = np.concatenate([np.arange(15), [6 * 15 + 7]])
    return Observation(rest, deformed, held, np.ones(105, dtype=bool), shape=(7, 15), cell=np.arange(105))


def test_beta_of_a_linear_block_is_blind_to_its_modulus(shared_data: Path) -> None:
    files = sorted((shared_data / "fem").glob("block_lin_nu0.30_E*_disp10mm.npz"))
    assert len(files) == 5
    every = [calibrate([_block(path)], FitOptions(Model(cluster_size=3), BETA_BOUNDS)).estimate for path in files[::2]]
    values = [one.value for one in every]
    assert max(values) - min(values) < 1e-3
    assert 0.67 < every[0].least_aee[0] < 0.73  # the thesis's, of the least AEE
    assert {one.stiffness_verdict for one in every} == {"unidentified"}


@pytest.mark.slow
def test_theta_of_a_cube_rises_with_poissons_ratio(shared_data: Path) -> None:
    for depth in (1, 3):
        values = []
        for nu in ("0.00", "0.10", "0.25", "0.40", "0.49"):
            with np.load(shared_data / "fem" / f"cube_lin_n06_d{depth}cm_nu{nu}.npz") as file:
                rest, deformed = file["X"], file["X"] + file["u"]
                held = np.concatenate([file["top"], file["bottom"]])
            seen = Observation(rest, deformed, held, np.ones(len(rest), dtype=bool))
            sweep = calibrate([seen], FitOptions(THETA_MODEL, THETA_BOUNDS)).estimate
            assert sweep.converged
            values.append(sweep.value)
        assert all(after > before + 0.05 for before, after in pairwise(values[:4]))
        assert values[4] >= values[3]
        assert values[0] < 0.02
        descent = calibrate([seen], FitOptions(THETA_MODEL, THETA_BOUNDS, method="gradient")).estimate
        assert descent.value == pytest.approx(values[4], abs=2e-3)
