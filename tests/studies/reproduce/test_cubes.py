"""Experiment 3.A on small cubes: known answers, what theta does, and what overlapping clusters do better."""

import dataclasses
import io
import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.fit.model import Model, Observation, distances
from studies.output import write_rows
from studies.reproduce import cubes_figures
from studies.reproduce.pressed_cubes import (
    SIDE_M,
    Cube,
    CubeFit,
    CubeResult,
    ModelTime,
    compared,
    cube_from_pair,
    dense_curve,
    depths_of,
    equal_share,
    examine,
    rises,
    spreads,
    standard_error,
    thesis_cubes,
)
from tests.cases import slow, slow_but
from tests.stages.bodies import lattice

MODEL = Model("theta", "quadratic", None)


@pytest.fixture(scope="module")
def found() -> list[CubeResult]:
    """Cubes of 4^3 and 5^3 at two depths, three Poisson's ratios."""
    cubes, _ = thesis_cubes((0.0, 0.25, 0.45), (4, 5), (0.01, 0.03))
    options = CubeFit()
    return [examine(cube, options, yes) for cube, yes in zip(cubes, compared(cubes, options.compare), strict=True)]


def of_the_model(theta: float, side: int = 5, depth: float = 0.03) -> Cube:
    """A cube that deforms just as one quadratic cluster does."""
    rest = lattice((side,) * 3, SIDE_M / (side - 1))
    held = np.flatnonzero((rest[:, 2] < 1e-9) | (rest[:, 2] > SIDE_M - 1e-9))
    deformed = rest.copy()
    deformed[rest[:, 2] > SIDE_M - 1e-9, 2] -= depth
    seen = Observation(rest, deformed, held, np.ones(len(rest), dtype=bool))
    deformed = MODEL.body(seen).relax(deformed[held], MODEL.beta, theta).position[0]
    return Cube(Observation(rest, deformed, held, np.ones(len(rest), dtype=bool)), 0.3, depth, "model")


@pytest.mark.parametrize(
    ("method", "theta"), slow_but([("sweep", 0.137)], itertools.product(("sweep", "gradient"), (0.137, 0.62)))
)
def test_a_cube_of_the_model_gives_its_theta(method: str, theta: float) -> None:
    one = examine(of_the_model(theta), CubeFit(method=method), False)  # type: ignore[arg-type]
    assert one.value == pytest.approx(theta, abs=1e-4)
    assert one.theta.interval[0] <= theta + 1e-4
    assert one.theta.interval[1] >= theta - 1e-4
    assert one.theta.converged


def test_theta_rises_with_poissons_ratio_from_nothing_to_all(found: list[CubeResult]) -> None:
    assert rises(found)
    assert all(one.value == 0.0 for one in found if one.cube.poisson == 0.0)
    assert all(one.theta.converged for one in found)


@pytest.mark.parametrize("method", ["sweep", slow("gradient")])
def test_no_theta_of_a_dense_grid_has_a_lower_error(found: list[CubeResult], method: str) -> None:
    """The thesis's descent stops where the error changes little; ours may not be above the grid by 0.1 %."""
    for one in found[::3]:
        cube = one.cube
        again = one if method == "sweep" else examine(cube, CubeFit(method="gradient"), False)
        position = (
            MODEL.body(cube.seen).relax(cube.seen.deformed[cube.seen.held], 0.99, np.linspace(0.0, 1.0, 2001)).position
        )
        lowest = distances(position, cube.seen.deformed).mean(axis=1).min()
        assert again.grid_aee == pytest.approx(lowest)
        assert again.aee <= 1.001 * lowest + 1e-12
        assert again.over_grid <= 1e-3
        assert again.theta.converged


@pytest.mark.parametrize("poisson", [0.25, 0.49])
def test_overlapping_clusters_barrel_and_one_cluster_cannot(poisson: float) -> None:
    """One quadratic cluster lacks the cubic terms of a barrel between two equal plates, whatever its beta."""
    (cube,), _ = thesis_cubes((poisson,), (7,), (0.03,))
    one = examine(cube, CubeFit(), True)
    assert one.ratio <= 0.5
    assert one.one_cluster.aee >= 0.8 * one.aee
    row, along, out = cubes_figures.side_line(cube)
    observed, single, clustered = (
        position[row[3], out] - position[row[1], out]
        for position in (cube.seen.deformed, one.simulated, one.overlapping.position)
    )
    assert along == 2
    assert len(row) == 7
    assert abs(single) < 0.02 * observed
    assert clustered > 0.5 * observed


@pytest.mark.slow
def test_resolution_moves_theta_by_the_share_of_held_particles() -> None:
    """With the same share of mass held, theta of 5^3 and 9^3 agrees far better than with equal masses."""
    (coarse, fine), _ = thesis_cubes((0.25,), (5, 9), (0.03,))
    values = [examine(cube, CubeFit(), False).value for cube in (coarse, fine)]
    shares = [equal_share(cube.seen, 0.99) for cube in (coarse, fine)]
    assert values[0] - values[1] > 0.1
    assert abs(shares[0] - shares[1]) < 0.2 * (values[0] - values[1])


def test_finite_elements_are_linear_and_keep_the_plates() -> None:
    cubes, (time,) = thesis_cubes((0.4,), (5,), (0.01, 0.03))
    shallow, deep = (cube.seen.deformed - cube.seen.rest for cube in cubes)
    np.testing.assert_allclose(3.0 * shallow, deep, atol=1e-15)
    np.testing.assert_allclose(deep[cubes[0].seen.held][:, :2], 0.0)
    np.testing.assert_allclose(cubes[0].seen.rest, lattice((5, 5, 5), 0.025), atol=1e-15)
    assert sorted({float(z) for z in deep[cubes[0].seen.held, 2]}) == [-0.03, 0.0]
    assert (time.resolution, cubes[1].resolution, depths_of(cubes)) == ("5^3", "5^3", [0.01, 0.03])


def pair(**more: object) -> bytes:
    cube = of_the_model(0.3, side=4)
    raw = io.BytesIO()
    seen = cube.seen
    np.savez(raw, rest=seen.rest, deformed=seen.deformed, held=seen.held, **more)  # type: ignore[arg-type]
    return raw.getvalue()


def test_a_pair_s_ratio_is_in_the_file_or_in_its_name() -> None:
    assert cube_from_pair(pair(nu=0.31), "a_nu0.10.npz").poisson == 0.31
    for name, ratio in (("cube_lin_n06_d3cm_nu0.25.npz", 0.25), ("b-nu_.4.npz", 0.4), ("nu0.npz", 0.0)):
        assert cube_from_pair(pair(), f"folder_nu0.9/{name}").poisson == ratio
    reported = cube_from_pair(pair(nu=0.31), "a.npz")
    assert reported.depth == pytest.approx(0.03)
    assert reported.resolution == "4^3"


def test_a_pair_without_a_possible_ratio_is_refused() -> None:
    with pytest.raises(InputError, match=r"expected nu \(Poisson's ratio\)"):
        cube_from_pair(pair(), "cube.npz")
    with pytest.raises(InputError, match=r"up to 0\.5; got 0\.7"):
        cube_from_pair(pair(nu=0.7), "cube.npz")
    with pytest.raises(InputError, match="pair file"):
        cube_from_pair(b"nothing", "cube.npz")


def test_points_without_a_lattice_and_boxes_have_a_name_too() -> None:
    rest = np.random.default_rng(0).uniform(0.0, 0.1, (60, 3))
    held = np.flatnonzero((rest[:, 2] < 0.02) | (rest[:, 2] > 0.08))
    deformed = rest * [1.02, 1.02, 0.9]
    cloud = Cube(Observation(rest, deformed, held, np.ones(60, dtype=bool)), 0.2, 0.01, "cloud")
    box = Cube(Observation(rest, deformed, held, np.ones(60, dtype=bool), shape=(3, 4, 5)), 0.2, 0.01, "box")
    assert (cloud.resolution, box.resolution) == ("60 particles", "3x4x5")
    one = examine(cloud, CubeFit(), True)
    assert one.theta.converged
    assert one.overlapping is not None


def test_standard_error_of_the_mean() -> None:
    assert standard_error([1.0, 2.0, 3.0]) == pytest.approx(1.0 / np.sqrt(3.0))
    assert np.isnan(standard_error([1.0]))


def test_spreads_group_by_ratio_and_by_what_is_asked(found: list[CubeResult]) -> None:
    of_all = spreads(found)
    of_each = spreads(found, lambda cube: cube.resolution)
    assert [(s.poisson, s.of, s.count) for s in of_all] == [(0.0, "", 4), (0.25, "", 4), (0.45, "", 4)]
    values = [one.value for one in found if one.cube.poisson == 0.25]
    assert of_all[1].mean == pytest.approx(np.mean(values))
    assert of_all[1].sem == pytest.approx(np.std(values, ddof=1) / 2.0)
    assert [s.of for s in of_each[:2]] == ["4^3", "5^3"]
    rows = cubes_figures.sem_rows(found)
    assert [row["by"] for row in rows] == ["settings"] * 3 + ["resolution"] * 6 + ["depth"] * 6
    assert {row["of"] for row in rows[9:]} == {"1 cm", "3 cm"}


@pytest.mark.parametrize(
    ("values", "strictly", "to_bound"),
    [
        ([0.1, 0.2, 0.3], True, True),
        ([0.1, 1.0, 1.0], False, True),
        ([0.1, 0.2, 0.2], False, False),
        ([0.1, 1.0, 0.9], False, False),
        ([0.2, 0.1, 1.0], False, False),
    ],
)
def test_a_theta_that_does_not_rise_is_noticed(
    found: list[CubeResult], values: list[float], strictly: bool, to_bound: bool
) -> None:
    """At one resolution alone, in any order; at the end of the range it need not rise if that is allowed."""
    fine = [one for one in found if one.cube.resolution == "5^3"]
    coarse = next(one for one in found if one.cube.resolution == "4^3")
    reported = [
        dataclasses.replace(
            coarse,
            cube=dataclasses.replace(coarse.cube, poisson=0.1 * number),
            theta=dataclasses.replace(coarse.theta, least_aee=(value, 0.0)),
        )
        for number, value in enumerate(values)
    ]
    assert rises([*reported[::-1], *fine]) is strictly
    assert rises([*reported[::-1], *fine], to_bound=True) is to_bound


def test_overlapping_clusters_are_fitted_to_the_deepest_of_each_kind() -> None:
    cubes, _ = thesis_cubes((0.1, 0.2), (3, 4), (0.01, 0.02))
    assert [cube.depth for cube, yes in zip(cubes, compared(cubes, "deepest"), strict=True) if yes] == [0.02] * 4
    assert sum(compared(cubes, "all")) == 8
    assert sum(compared(cubes, "none")) == 0


def test_the_dense_curve_is_the_error_in_any_number_of_parts() -> None:
    (cube,), _ = thesis_cubes((0.3,), (4,), (0.02,))
    body = MODEL.body(cube.seen)
    whole, some = dense_curve(cube.seen, body, 0.99, 11), dense_curve(cube.seen, body, 0.99, 5001)
    np.testing.assert_allclose(whole.aee, some.aee[::500], rtol=1e-6)


def test_figures_and_tables_are_drawn(found: list[CubeResult], tmp_path: Path) -> None:
    cubes_figures.draw_theta(tmp_path / "a.png", found)
    cubes_figures.draw_errors(tmp_path / "b.png", found)
    cubes_figures.draw_clusters(tmp_path / "c.png", found, 2)
    cubes_figures.draw_resolution(tmp_path / "d.png", found)
    write_rows(tmp_path / "cubes.csv", cubes_figures.cube_rows(found))
    for name in "abcd":
        image = cv2.imread(str(tmp_path / f"{name}.png"))
        assert image is not None
        for colour in ("#0072B2", "#D55E00"):  # two resolutions, depths or ratios have their colours
            bgr = [int(colour[i : i + 2], 16) for i in (5, 3, 1)]
            assert np.count_nonzero((image == bgr).all(axis=2)) > 100
    lines = (tmp_path / "cubes.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + len(found)
    assert lines[1].startswith("0,4^3,64,0.01,0,")
    assert len({line.count(",") for line in lines[:1]}) == 1


def test_the_table_of_times_sets_ours_beside_the_thesis_s() -> None:
    rows = cubes_figures.time_rows([ModelTime("6^3", 1e-5, 2e-5, 0.5), ModelTime("5^3", 1e-5, 2e-5, 0.5)], [])
    assert (rows[0]["msm_step_ms"], rows[0]["thesis_msm_frame_ms"], rows[0]["thesis_comsol_ms"]) == (0.01, 6.1, 3000.0)
    assert (rows[1]["thesis_msm_frame_ms"], rows[1]["elements_ms"]) == (None, None)
