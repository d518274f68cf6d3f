"""The world and touch surfaces: a sparse process is an exact one, its hyper-parameters those of all points."""

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.gaussian_process import Kernel
from deformscope.stages.map import surface
from deformscope.stages.map.surface import HeightProcess, fit_surface
from deformscope.stages.regions.touches import MapGrid
from tests.cases import slow_but

KERNEL = Kernel.of_length(0.008, 0.06)
SIZE = np.array([0.6, 0.4])


def drawn(rng: np.random.Generator, places: FloatArray, kernel: Kernel = KERNEL) -> FloatArray:
    """Heights of one surface that such a process makes."""
    covariance = kernel.between(places, places)
    covariance.flat[:: len(places) + 1] += 1e-9 * kernel.sigma_e**2
    return np.asarray(np.linalg.cholesky(covariance) @ rng.normal(size=len(places)))


def with_a_hole(rng: np.random.Generator, count: int) -> FloatArray:
    places = rng.uniform(size=(3 * count, 2)) * SIZE
    return places[np.hypot(*(places - [0.35, 0.2]).T) > 0.06][:count]


def exact(
    surface: HeightProcess, points: FloatArray, noise: FloatArray, asked: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean and deviation by the equations of the thesis, 4.3 and 4.4, in float64."""
    places = points[:, :2]
    factor = cho_factor(surface.kernel.between(places, places) + np.diag(noise**2))
    across = surface.kernel.between(places, asked)
    mean = surface.level_m + across.T @ cho_solve(factor, points[:, 2] - surface.level_m)
    variance = surface.kernel.sigma_e**2 - np.sum(across * cho_solve(factor, across), axis=0)
    return mean, np.sqrt(variance)


def log_likelihood(kernel: Kernel, places: FloatArray, value: FloatArray, noise: FloatArray) -> float:
    covariance = kernel.between(places, places) + np.diag(noise**2)
    sign, log_det = np.linalg.slogdet(covariance)
    assert sign > 0
    return float(-0.5 * (value @ np.linalg.solve(covariance, value) + log_det + len(value) * np.log(2 * np.pi)))


@pytest.mark.parametrize("length_m", slow_but([0.06], [0.03, 0.06, 0.25]))
def test_mean_and_deviation_are_an_exact_processs_also_in_a_hole(length_m: float) -> None:
    rng = np.random.default_rng(1)
    places = with_a_hole(rng, 900)
    noise = rng.uniform(0.5e-3, 3e-3, 900)
    heights = 0.05 + drawn(rng, places, Kernel.of_length(0.008, length_m)) + noise * rng.normal(size=900)
    points = np.column_stack([places, heights])
    grid = MapGrid((0.6, 0.4), 0.01)
    surface = fit_surface(points, noise_m=noise)
    found = surface.on(grid)
    mean, deviation = exact(surface, points, surface.noise_m, grid.centres_m)
    hole = np.hypot(*(grid.centres_m - [0.35, 0.2]).T) < 0.04
    assert deviation[hole].min() > np.median(deviation[~hole])
    assert found.mean_m.shape == (40, 60)
    np.testing.assert_allclose(found.mean_m.ravel(), mean, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.deviation_m.ravel(), deviation, rtol=2e-3)


def test_hyper_parameters_are_the_likeliest_of_an_exact_process() -> None:
    rng = np.random.default_rng(2)
    places = with_a_hole(rng, 500)
    value = drawn(rng, places) + rng.normal(size=500) * 0.002
    surface = fit_surface(np.column_stack([places, value]))
    value = value - surface.level_m

    def cost(x: FloatArray) -> float:
        sigma_e, length, noise = np.exp(x)
        return -log_likelihood(Kernel.of_length(sigma_e, length), places, value, np.full(500, noise))

    start = np.log([surface.kernel.sigma_e, surface.kernel.length_m, surface.noise_m[0]])
    best = minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3, "maxiter": 150})
    np.testing.assert_allclose(np.exp(start), np.exp(best.x), rtol=0.05)  # weak priors move sigma_e by some per cent
    assert -cost(start) > -best.fun - 0.1
    assert surface.learned.log_likelihood == pytest.approx(-cost(start), abs=1.0)
    assert surface.evidence == pytest.approx(-cost(start), abs=0.05)


def test_known_hyper_parameters_come_back_from_all_points() -> None:
    rng = np.random.default_rng(3)
    coarse = MapGrid((0.6, 0.4), 0.02).centres_m
    truth = drawn(rng, coarse)
    places = rng.uniform(size=(6000, 2)) * SIZE
    noisy = np.linalg.solve(KERNEL.between(coarse, coarse) + 1e-8 * KERNEL.sigma_e**2 * np.eye(len(coarse)), truth)
    heights = KERNEL.between(places, coarse) @ noisy + rng.normal(size=6000) * 1.5e-3
    surface = fit_surface(np.column_stack([places, heights]))
    assert surface.noise_m == pytest.approx(1.5e-3, rel=0.03)
    assert surface.kernel.length_m == pytest.approx(0.06, rel=0.1)
    assert surface.kernel.sigma_e == pytest.approx(0.008, rel=0.3)


@pytest.mark.slow
def test_nine_in_ten_true_heights_lie_in_the_90_per_cent_bands() -> None:
    inside = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        every = np.concatenate([with_a_hole(rng, 300), rng.uniform(size=(60, 2)) * SIZE])
        heights = drawn(rng, every, Kernel.of_length(0.005, rng.uniform(0.04, 0.15)))
        noisy = heights[:300] + rng.normal(size=300) * 2e-3
        found = fit_surface(np.column_stack([every[:300], noisy])).at(every[300:])
        inside.append(np.abs(found.mean - heights[300:]) < 1.645 * found.deviation)
    assert 0.85 < np.mean(inside) < 0.95


def test_slopes_are_the_surfaces_finite_differences_and_so_is_their_deviation() -> None:
    rng = np.random.default_rng(4)
    places = with_a_hole(rng, 400)
    points = np.column_stack([places, drawn(rng, places) + rng.normal(size=400) * 1e-3])
    surface = fit_surface(points)
    asked = np.array([[0.1, 0.1], [0.35, 0.2], [0.55, 0.05]])
    step = 1e-4
    slope = surface.slopes(asked)
    for axis in range(2):
        away = step * np.eye(2)[axis]
        ahead, behind = surface.at(asked + away), surface.at(asked - away)
        np.testing.assert_allclose(slope.mean[:, axis], (ahead.mean - behind.mean) / (2 * step), atol=1e-5)
        # covariance of the two heights, by the exact process
        factor = cho_factor(surface.kernel.between(places, places) + np.diag(surface.noise_m**2))
        both = np.concatenate([asked + away, asked - away])
        across = surface.kernel.between(places, both)
        covariance = surface.kernel.between(both, both) - across.T @ cho_solve(factor, across)
        n = len(asked)
        differences = np.hstack([np.eye(n), -np.eye(n)]) / (2 * step)
        variance = np.diag(differences @ covariance @ differences.T)
        np.testing.assert_allclose(slope.deviation[:, axis] ** 2, variance, rtol=0.02)


def test_normals_stand_on_a_tilted_plane() -> None:
    places = np.random.default_rng(5).uniform(size=(600, 2)) * SIZE
    points = np.column_stack([places, 0.2 * places[:, 0] - 0.1 * places[:, 1]])
    normals = fit_surface(points).normals(np.array([[0.3, 0.2], [0.1, 0.3]]))
    expected = np.array([-0.2, 0.1, 1.0]) / np.sqrt(1.05)
    np.testing.assert_allclose(normals, [expected, expected], atol=2e-3)


def test_constant_few_and_repeated_points_still_make_a_surface() -> None:
    flat = np.column_stack([MapGrid((0.6, 0.4), 0.05).centres_m, np.full(96, 0.05)])
    level = fit_surface(flat).at(np.array([[0.3, 0.2], [0.0, 0.0]]))
    np.testing.assert_allclose(level.mean, 0.05, atol=1e-6)
    assert (level.deviation < 1e-5).all()
    few = fit_surface(np.array([[0.1, 0.1, 0.05], [0.5, 0.1, 0.051], [0.3, 0.3, 0.049]]))
    assert np.isfinite(few.at(np.array([[0.3, 0.2]])).mean).all()
    repeated = np.repeat(flat[:20], 10, axis=0)
    repeated[:, 2] += np.random.default_rng(0).normal(size=200) * 1e-3
    assert fit_surface(repeated).noise_m[0] == pytest.approx(1e-3, rel=0.2)
    on_a_line = np.column_stack([np.linspace(0, 0.5, 50), np.zeros(50), np.linspace(0, 0.01, 50)])
    assert fit_surface(on_a_line).at(np.array([[0.25, 0.0]])).mean[0] == pytest.approx(0.005, abs=1e-4)


def test_a_length_stays_within_its_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface, "MOST_SINES", 300)  # a small basis has its shortest length sooner
    places = np.random.default_rng(8).uniform(size=(1000, 2)) * SIZE
    rough = np.sin(places[:, 0] / 0.03) * np.sin(places[:, 1] / 0.03) * 0.01
    length = fit_surface(np.column_stack([places, rough])).kernel.length_m
    shorter, longer = surface.RANGE
    half = 0.5 * np.ptp(places, axis=0)
    assert 270 < surface.HilbertBasis.size(half, length / shorter, length * longer) <= 300.001


def test_outliers_are_left_out_where_asked_and_named() -> None:
    rng = np.random.default_rng(9)
    places = rng.uniform(size=(400, 2)) * SIZE
    heights = 0.005 * np.sin(places[:, 0] / 0.1) + rng.normal(size=400) * 1e-3
    wild = rng.choice(400, 8, replace=False)
    heights[wild] += rng.choice([-1.0, 1.0], 8) * rng.uniform(0.02, 0.05, 8)
    points = np.column_stack([places, heights])
    kept = fit_surface(points, outlier_sd=4.5)
    assert set(np.flatnonzero(~kept.used)) >= set(wild)
    assert np.count_nonzero(~kept.used) < 10
    assert kept.noise_m[0] == pytest.approx(1e-3, rel=0.08)
    assert fit_surface(points).used.all()


def test_far_from_all_points_the_surface_falls_back_to_what_is_known_before() -> None:
    rng = np.random.default_rng(10)
    places = rng.uniform(size=(200, 2)) * [0.2, 0.4]
    points = np.column_stack([places, drawn(rng, places)])
    surface = fit_surface(points, within_m=((0.0, 0.0), (0.8, 0.4)))
    far = surface.at(np.array([[0.75, 0.2]]))
    assert far.deviation[0] == pytest.approx(surface.kernel.sigma_e, rel=1e-3)
    assert far.mean[0] == pytest.approx(surface.level_m, abs=1e-6)


@pytest.mark.parametrize(
    ("points", "options", "match"),
    [
        (np.zeros((2, 3)), {}, "3 surface points"),
        (np.zeros((5, 2)), {}, r"points \(n, 3\)"),
        (np.full((5, 3), np.nan), {}, "finite points"),
        (np.zeros((5, 3)), {"noise_m": np.zeros(5)}, "noise above 0"),
        (np.zeros((5, 3)), {"noise_m": np.ones(4)}, "a noise for each"),
        (np.random.default_rng(0).uniform(size=(50, 3)), {"within_m": ((0.0, 0.0), (1e3, 1e3))}, "inducing points"),
    ],
)
def test_what_makes_no_surface_is_refused(points: FloatArray, options: dict[str, FloatArray], match: str) -> None:
    with pytest.raises(InputError, match=match):
        fit_surface(points, **options)  # type: ignore[arg-type]


def test_the_same_points_give_the_same_bits() -> None:
    rng = np.random.default_rng(11)
    points = np.column_stack([rng.uniform(size=(400, 2)) * SIZE, rng.normal(size=400) * 1e-3])
    grid = MapGrid((0.6, 0.4), 0.02)
    one, two = (fit_surface(points.copy()).on(grid) for _ in range(2))
    np.testing.assert_array_equal(one.mean_m, two.mean_m)
    np.testing.assert_array_equal(one.deviation_m, two.deviation_m)


@pytest.mark.slow
def test_twelve_thousand_points_are_as_exact() -> None:
    rng = np.random.default_rng(12)
    places = with_a_hole(rng, 12_000)
    wave = rng.normal(size=(2, 300)) / 0.06
    heights = 0.008 * np.sqrt(2 / 300) * np.cos(places @ wave + rng.uniform(0, 6.28, 300)).sum(axis=1)
    points = np.column_stack([places, heights + rng.normal(size=12_000) * 1.5e-3])
    surface = fit_surface(points)
    asked = MapGrid((0.6, 0.4), 0.02).centres_m
    mean, deviation = exact(surface, points, surface.noise_m, asked)
    np.testing.assert_allclose(surface.at(asked).mean, mean, rtol=0, atol=1e-6)
    np.testing.assert_allclose(surface.at(asked).deviation, deviation, rtol=1e-3)
