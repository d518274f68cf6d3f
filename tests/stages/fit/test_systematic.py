"""Errors of the tool and the camera: the displacements, and what they do to an interval."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.fit import noise
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation, calibrate
from deformscope.stages.fit.noise import OFFS, SCALE_ROUNDS, ErrorModel, Measured
from deformscope.stages.fit.residuals import Residuals
from deformscope.stages.fit.systematic import camera_modes, tool_modes
from studies.beta import observed
from studies.independent.observed import Errors, pushed_clusters
from tests.cases import Patch


def test_a_tool_shifts_and_turns_its_particles_and_what_is_fixed() -> None:
    held = np.array([[0.0, 0.0], [0.0, 1.0], [3.0, 0.0], [3.0, 1.0]])
    touched = np.array([False, False, True, True])
    modes = tool_modes(held, touched)
    assert modes.shape == (4, 2, 6)
    np.testing.assert_allclose(np.linalg.norm(modes, axis=1).max(axis=0), 1.0)
    for mode in np.moveaxis(modes, -1, 0):
        moved = (held + 1e-4 * mode)[touched]
        assert np.linalg.norm(moved[1] - moved[0]) == pytest.approx(1.0, abs=1e-7)


def test_a_camera_that_is_off_moves_everything_in_proportion_to_the_place() -> None:
    places = np.random.default_rng(0).random((30, 2))
    modes = camera_modes(places).reshape(60, -1)
    assert modes.shape[1] == 4
    scale = 0.01 * (places - places.mean(axis=0)).ravel()
    assert np.linalg.lstsq(np.column_stack([modes, np.tile(np.eye(2), (30, 1))]), scale, rcond=None)[1][0] < 1e-20


def _measured(count: int = 7) -> tuple[Measured, FloatArray]:
    """Places and noise of some particles, and how the held ones move the others, (count, 2, 6)."""
    rng = np.random.default_rng(1)
    rest, held = rng.random((count, 2)), rng.random((3, 2)) + np.array([2.0, 0.0])
    given = rest, held, np.full(count, 0.1), np.full(3, 0.2), True, 0.3, 1e-9
    touched = np.array([True, True, False])
    return Measured(*given, touched=touched, shift=0.05), 0.3 * rng.standard_normal((count, 2, 6))


def test_products_are_those_of_the_whole_covariance() -> None:
    measured, response = _measured()
    errors = ErrorModel(measured)
    every = errors.hypotheses
    residual = np.random.default_rng(2).standard_normal((2, 7, 2))
    rows = np.flatnonzero(every.held & (every.size == 0.0))
    assert len(rows) == len(OFFS)
    assert np.exp(every.log_prior).sum() == pytest.approx(1.0)
    found = errors.products(residual, response, rows)
    flat, each = response.reshape(14, 6), residual.reshape(2, 14)
    modes = errors.modes(response, held=True).reshape(14, -1)
    for at, row in enumerate(rows):
        scale, camera, shift, other = every.off[row]
        off = modes * [np.sqrt(2.0) * scale, *3 * [camera], *2 * [shift], *3 * [other]]
        covariance = 0.01 * np.eye(14) + 0.04 * flat @ flat.T + off @ off.T
        np.testing.assert_allclose(found.product[at], each @ np.linalg.solve(covariance, each.T), rtol=1e-8)
        # the whole log determinant, less what the stated noise has of it
        assert found.log_det[at] == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-8)


def test_a_camera_that_is_off_does_not_enlarge_the_noise_by_which_its_errors_are_measured(monkeypatch: Patch) -> None:
    """The scale of white noise is found of what errors of tool and camera leave, in rounds."""
    scales = []
    for rounds in (1, SCALE_ROUNDS):
        monkeypatch.setattr(noise, "SCALE_ROUNDS", rounds)
        measured, response = _measured(60)
        measured = dataclasses.replace(measured, noise=np.full(60, 2e-4), held_noise=np.full(3, 2e-4))
        errors = ErrorModel(measured)
        every = errors.hypotheses
        seen = errors.modes(response, held=True)
        residual = 3.0 * seen[..., 0] + 2e-4 * np.random.default_rng(3).standard_normal((60, 2))
        row = np.flatnonzero(every.held & (every.size == 0.0) & (every.off[:, 0] > 0.0))[:1]
        errors.products(residual[None], response, row, settle=True)
        scales.append(float(np.exp(errors.log_scale[row[0]])))
    assert scales[0] > 5.0
    assert scales[1] == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(("scale", "likely"), [(0.0, "nothing"), (0.02, "scale")])
def test_evidence_shows_whether_a_scale_is_wrong(scale: float, likely: str) -> None:
    measured, response = _measured(60)
    measured = dataclasses.replace(measured, noise=np.full(60, 2e-3), held_noise=np.full(3, 2e-3))
    errors = ErrorModel(measured)
    every = errors.hypotheses
    assert measured.held_rest is not None
    places = np.concatenate([measured.rest, measured.held_rest])
    wrong = scale * (places - places.mean(axis=0)) + 2e-3 * np.random.default_rng(3).standard_normal(places.shape)
    residual = wrong[:60] - response @ wrong[60:].ravel()
    found = errors.evidence(residual[None], response).log_likelihood[:, 0]
    weight = np.exp(found - found.max())
    weight /= weight.sum()
    exact, only_scale = every.off[:, 0] == 0.0, (every.off[:, 0] > 0.0) & (every.off[:, 1] == 0.0)
    before, after = (
        np.array([each[exact].sum(), each[only_scale].sum()]) for each in (np.exp(every.log_prior), weight)
    )
    gained = after / before
    assert (gained[0] > 1.5) if likely == "nothing" else (after[0] < 1e-3 and gained[1] > 1.5)


def _pulled(shift_m: float, noise_m: float = 1e-4) -> Observation:
    shape = (5, 6)
    rest = 0.01 * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 2)
    near, tool = np.flatnonzero(rest[:, 0] == 0.0), np.array([25, 26])
    held = np.concatenate([near, tool])
    place = rest[held] + np.where(np.isin(held, tool)[:, None], [0.006, 0.003], 0.0)
    seen = Observation(rest, rest.copy(), held, np.ones(30, bool), np.full(30, 1e-4), shape=shape, cell=np.arange(30))
    true = Model(cluster_size=3).body(seen).relax(place, 0.6).position[0]
    true = true + noise_m * np.random.default_rng(2).standard_normal(true.shape)
    true[tool] += [shift_m, 0.0]
    return dataclasses.replace(seen, deformed=true)


def test_what_a_tool_is_off_by_is_found_with_the_parameter() -> None:
    """1 mm against the push: taken for another beta where the residuals are projected on what beta can change."""
    found = calibrate([_pulled(-1e-3)], FitOptions(Model(cluster_size=3), candidates=40)).estimate
    assert found.interval[0] <= 0.6 <= found.interval[1]


def test_a_tool_that_is_off_is_no_reason_to_blame_single_particles_where_registration_may_be() -> None:
    options = FitOptions(Model(cluster_size=3), candidates=40)
    seen = _pulled(7e-4)
    sure, unsure = (calibrate([dataclasses.replace(seen, held_shift=shift)], options).estimate for shift in (0.0, 1e-3))
    assert "held-off" in [one.code for one in sure.reasons]
    assert not unsure.reasons
    assert unsure.interval[0] <= 0.6 <= unsure.interval[1]


@pytest.mark.slow
def test_what_details_show_of_a_tool_that_is_right_narrows_the_interval() -> None:
    """Nearly clean data, whose misfit outweighs noise and is a hundredth of what tool and camera may be off by, tell
    more than data with white noise of a quarter of that."""
    seen = _pulled(0.0)
    true = _pulled(0.0, noise_m=0.0).deformed
    wave = np.sin(2.0 * np.pi * seen.rest[:, ::-1] / 0.03)
    clean = dataclasses.replace(seen, deformed=true + 5e-6 * wave, noise=np.full(30, 5e-7))
    fits = [calibrate([one], FitOptions(Model(cluster_size=3), candidates=40)) for one in (clean, seen)]
    assert fits[0].inferred.explanations[0].misfit() > fits[0].inferred.noise
    ends, rough = (one.estimate.interval for one in fits)
    assert ends[0] <= 0.6 <= ends[1]
    assert ends[1] - ends[0] < rough[1] - rough[0]


@pytest.mark.slow
@pytest.mark.parametrize("number", [3, 9, 12])
def test_hypotheses_that_a_coarse_grid_contradicts_count_where_a_fine_one_does_not(
    number: int, monkeypatch: Patch
) -> None:
    """Errors that are smooth and have hardly any white noise: candidates far apart leave more than they explain."""
    errors = Errors(cells=3.0, pressed=True)
    body = pushed_clusters(np.random.default_rng([1500, number]), errors, 2)

    def width() -> float:
        options = FitOptions(Model(cluster_size=body.clusters), (0.0, 0.99), candidates=40)
        return float(np.ptp(calibrate([observed(body, errors)], options).estimate.interval))

    some, choose = width(), Residuals.choose

    def all_of_them(part: Residuals, position: FloatArray, response: FloatArray) -> None:
        choose(part, position, response)
        part.chosen = np.arange(len(part.errors.hypotheses.size))

    monkeypatch.setattr(Residuals, "choose", all_of_them)
    assert some == pytest.approx(width(), rel=0.05)
