"""Volume conserved by projection: the nearest matrix of measure 1, the energy behind it, and warp's answers.

Annotations here are read by warp while the kernel is made, so they are not quoted."""

import functools
import itertools
from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.optimize import minimize

from deformscope.arrays import FloatArray
from deformscope.stages.msm import clusters, reference
from deformscope.stages.msm.functions import functions_for
from deformscope.stages.msm.lanes import module_options
from tests.cases import slow, slow_but
from tests.stages import reference_states
from tests.stages.bodies import lattice

PRECISIONS = ["float64", slow("float32")]
NEAREST_TOLERANCE = {"float64": 1e-12, "float32": 3e-6}
"""Nearest matrices of well-conditioned ones, against the reference."""

DISTANCE_TOLERANCE = {"float64": 1e-14, "float32": 2e-6}
"""How much further than the reference's the nearest matrix may be, whatever the matrix, as a share of its size."""

SPANS = [(2, 2), (2, 1), (3, 3), (3, 2), (3, 1)]
"""Dimension and spanned directions: full clusters, sheets and lines."""


def _proper(rng: np.random.Generator, dim: int) -> FloatArray:
    q = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    q[:, 0] *= np.sign(np.linalg.det(q))
    return q


def _measure(b: FloatArray, span_count: int) -> float:
    if span_count == len(b):
        return float(np.linalg.det(b))
    return float(np.prod(np.linalg.svd(b[:, :span_count], compute_uv=False)))


def _matrices(kind: str, count: int, dim: int, span_count: int, rng: np.random.Generator) -> FloatArray:
    """(count, dim, dim), 0 beyond the first span_count columns."""
    b = rng.normal(size=(count, dim, dim))
    turns = [np.stack([_proper(rng, dim) for _ in range(count)]) for _ in range(2)]
    if kind == "near":
        b = turns[0] @ (np.eye(dim) + 0.2 * b)
    elif kind == "inverted":
        b = turns[0] @ (np.diag([-1.0, *[1.0] * (dim - 1)]) + 0.2 * b)
    elif kind == "wide":
        b = turns[0] * 10.0 ** rng.uniform(-6.0, 3.0, (count, 1, dim)) @ turns[1]
    elif kind == "expanded":  # about where the nearest matrix stops being the evenly scaled one
        b = turns[0] * (rng.uniform(1.2, 2.6, (count, 1, 1)) * rng.uniform(1.0, 1.2, (count, 1, dim))) @ turns[1]
    b[:, :, span_count:] = 0.0
    return b


def _hard_cases(dim: int) -> FloatArray:
    """Points, lines, mirror images, ties, crushed and hugely expanded."""
    even = [factor * np.eye(dim) for factor in (0.0, 1e-12, 1e-6, 1.0, 1.9, 2.0, 3.0, 1e3, 1e6, -1e-6, -1.0, -1e3)]
    ones = [factor * np.ones((dim, dim)) for factor in (1e-6, 1.0, 1e3)]
    last = [np.diag([*[1e3] * (dim - 1), end]) for end in (0.0, 1e-6, -1e-6, -1e3)]
    first = [np.diag([start, *[1e-12] * (dim - 1)]) for start in (1.0, 1e6)]
    return np.stack([*even, *ones, *last, *first])


def test_nearest_matrices_by_hand() -> None:
    def nearest(*diagonal: float, span_count: int | None = None) -> FloatArray:
        b = np.diag(diagonal)
        return reference_states.project_measure(b, len(b) if span_count is None else span_count)

    np.testing.assert_allclose(nearest(1.2, 1.2, 1.2), np.eye(3), atol=1e-12)
    np.testing.assert_allclose(nearest(0.5, 0.5), np.eye(2), atol=1e-12)
    # turned inside out, worked backwards by s = s' - mu / s' from mu = 0.5 and s' = (2, 0.5), mu = 0.4 and (2, 1, 0.5)
    np.testing.assert_allclose(nearest(1.75, -0.5), np.diag([2.0, 0.5]), atol=1e-12)
    np.testing.assert_allclose(nearest(1.8, 0.6, -0.3), np.diag([2.0, 1.0, 0.5]), atol=1e-12)
    # stretched so far that one side collapses: s' = (4, 1/4), mu = -1/2
    np.testing.assert_allclose(nearest(4.125, 2.25), np.diag([4.0, 0.25]), atol=1e-12)
    # flat: the area of a sheet, the length of a line; the rest stays 0
    np.testing.assert_allclose(nearest(1.5, 1.5, 0.0, span_count=2), np.diag([1.0, 1.0, 0.0]), atol=1e-12)
    np.testing.assert_allclose(nearest(3.0, 0.0, 0.0, span_count=1), np.diag([1.0, 0.0, 0.0]), atol=1e-12)
    np.testing.assert_array_equal(nearest(0.0, 0.0, 0.0, span_count=0), np.zeros((3, 3)))


@pytest.mark.parametrize(("dim", "span_count"), SPANS)
def test_no_matrix_of_measure_1_is_nearer(dim: int, span_count: int) -> None:
    rng = np.random.default_rng(dim * 10 + span_count)
    kinds = ("near", "inverted", "expanded", "wide")
    for b in np.concatenate([_matrices(kind, 10, dim, span_count, rng) for kind in kinds]):
        p = reference_states.project_measure(b, span_count)
        assert _measure(p, span_count) == pytest.approx(1.0, rel=1e-8)
        others = p + 10.0 ** rng.uniform(-4.0, 1.0, (300, 1, 1)) * rng.normal(size=(300, dim, dim))
        others[:, :, span_count:] = 0.0
        measures = np.array([_measure(other, span_count) for other in others])
        if span_count == dim:
            others[measures < 0.0, :, 0] *= -1.0
        others /= np.abs(measures)[:, None, None] ** (1.0 / span_count)
        least = np.sum((p - b) ** 2)
        assert np.all(np.sum((others - b) ** 2, axis=(1, 2)) >= least * (1.0 - 1e-12))


@pytest.mark.parametrize("kind", ["near", "inverted", "expanded"])
def test_a_general_optimiser_finds_nothing_nearer(kind: str) -> None:
    rng = np.random.default_rng(3)
    for b in _matrices(kind, 3, 3, 3, rng):
        p = reference_states.project_measure(b, 3)
        found = []
        for start in (np.eye(3), _proper(rng, 3), p + 0.3 * rng.normal(size=(3, 3))):
            end = minimize(
                lambda x, b=b: np.sum((x - b.ravel()) ** 2),
                start.ravel(),
                method="SLSQP",
                constraints={"type": "eq", "fun": lambda x: np.linalg.det(x.reshape(3, 3)) - 1.0},
                options={"maxiter": 300, "ftol": 1e-14},
            )
            if abs(np.linalg.det(end.x.reshape(3, 3)) - 1.0) < 1e-9:
                found.append(end.fun)
        assert min(found) == pytest.approx(np.sum((p - b) ** 2), rel=1e-6)


@pytest.mark.parametrize(("dim", "span_count"), SPANS)
def test_the_nearest_matrix_turns_with_its_argument(dim: int, span_count: int) -> None:
    rng = np.random.default_rng(4)
    for b in _matrices("normal", 10, dim, span_count, rng):
        left, right = _proper(rng, dim), np.eye(dim)
        right[:span_count, :span_count] = _proper(rng, span_count) if span_count > 1 else 1.0
        turned = reference_states.project_measure(left @ b @ right, span_count)
        np.testing.assert_allclose(turned, left @ reference_states.project_measure(b, span_count) @ right, atol=1e-8)


def test_hard_cases_stay_finite_and_of_measure_1() -> None:
    for dim, span_count in SPANS:
        for b in _hard_cases(dim):
            b[:, span_count:] = 0.0
            p = reference_states.project_measure(b, span_count)
            assert np.isfinite(p).all()
            s = np.linalg.svd(p[:, :span_count], compute_uv=False)
            if s[0] < 1e5:  # beyond, the rounding of the largest value is as large as the smallest one
                assert _measure(p, span_count) == pytest.approx(1.0, rel=1e-3)


BODIES: list[tuple[tuple[int, ...], int, reference.Basis]] = [
    ((4, 3, 3), 2, "linear"),
    ((4, 3, 3), 2, "quadratic"),
    ((4, 3, 3), 3, "quadratic"),
    ((5, 4), 3, "linear"),
    ((5, 4), 3, "quadratic"),
    ((5, 4, 1), 3, "linear"),
    ((5, 4, 1), 3, "quadratic"),
    ((6, 1, 1), 3, "linear"),
    ((6, 1), 3, "linear"),
]
QUICK = [BODIES[0], BODIES[4], BODIES[5], BODIES[8]]
"""In space, in the plane, a sheet and a rod."""


def _body(shape: tuple[int, ...], size: int, basis: reference.Basis, rng: np.random.Generator) -> reference.Rest:
    rest = lattice(shape, 1.0)
    grouped = clusters.lattice(rest, shape, np.arange(len(rest)), size)
    return reference.build_rest(rest, grouped, np.array([], dtype=int), rng.uniform(0.5, 2.0, len(rest)), basis)


def _states(rest: FloatArray, rng: np.random.Generator) -> list[FloatArray]:
    """Noisy, compressed, inverted, expanded and turned."""
    dim = rest.shape[1]
    mirror = np.array([1.2, *[0.9] * (dim - 2), -0.6])
    shapes = [rest, rest * 0.5, rest * mirror, rest * 1.7, rest @ _proper(rng, dim)]
    return [x + rng.normal(0, 0.2, rest.shape) for x in shapes]


@pytest.mark.parametrize("theta", [slow(0.0), 0.6, slow(1.0)])
@pytest.mark.parametrize(("shape", "size", "basis"), slow_but(QUICK, BODIES))
def test_reaction_is_the_gradient_of_the_energy(
    shape: tuple[int, ...], size: int, basis: reference.Basis, theta: float
) -> None:
    rng = np.random.default_rng(5)
    body = _body(shape, size, basis, rng)
    h = 1e-6
    for x in _states(body.position, rng):
        direction = rng.normal(size=x.shape)
        after, before = (reference_states.energy(x + step * direction, body, 0.8, theta) for step in (h, -h))
        force = reference_states.reaction(x, body, 0.8, theta)
        size_of_slope = np.linalg.norm(force) * np.linalg.norm(direction)
        assert np.sum(force * direction) == pytest.approx((after - before) / (2 * h), abs=1e-7 * size_of_slope)


@pytest.mark.parametrize("basis", ["linear", "quadratic"])
def test_reaction_is_the_gradient_for_free_form_clusters(basis: reference.Basis) -> None:
    """Uneven clusters: their quadratic terms lean on the linear ones, so that the fit must give way as a whole."""
    rng = np.random.default_rng(6)
    rest = rng.uniform(0, 3, (30, 3))
    grouped = clusters.nearest(rest, 14)
    body = reference.build_rest(rest, grouped, np.array([], dtype=int), rng.uniform(0.5, 2.0, 30), basis)
    for x in _states(rest, rng):
        direction = rng.normal(size=x.shape)
        h = 1e-6
        after, before = (reference_states.energy(x + step * direction, body, 0.9, 0.7) for step in (h, -h))
        slope = np.sum(reference_states.reaction(x, body, 0.9, 0.7) * direction)
        assert slope == pytest.approx((after - before) / (2 * h), rel=1e-6)


@pytest.mark.parametrize(("shape", "size", "basis"), slow_but(QUICK[1:], BODIES))
def test_a_step_to_the_goals_never_raises_the_energy(shape: tuple[int, ...], size: int, basis: reference.Basis) -> None:
    rng = np.random.default_rng(7)
    body = _body(shape, size, basis, rng)
    for x in (*_states(body.position, rng), rng.normal(size=body.position.shape)):
        for beta, theta in ((0.99, 1.0), (0.5, 0.3)):
            state, stored = x, reference_states.energy(x, body, beta, theta)
            for _ in range(4):
                state = reference_states.goals(state, body, beta, theta, volume="project")
                before, stored = stored, reference_states.energy(state, body, beta, theta)
                assert stored <= before * (1.0 + 1e-12)


def test_without_conservation_both_modes_are_the_same() -> None:
    rng = np.random.default_rng(8)
    for shape, size, basis in BODIES:
        body = _body(shape, size, basis, rng)
        x = _states(body.position, rng)[0]
        scaled = reference_states.goals(x, body, 0.7, 0.0, volume="scale")
        np.testing.assert_array_equal(reference_states.goals(x, body, 0.7, 0.0, volume="project"), scaled)


@pytest.mark.parametrize("basis", ["linear", "quadratic"])
def test_full_conservation_of_one_cluster_gives_it_the_rest_volume_in_both_modes(basis: reference.Basis) -> None:
    rng = np.random.default_rng(9)
    rest = lattice((4, 4, 4), 1.0)
    body = reference.build_rest(rest, clusters.single(64), np.array([], dtype=int), basis=basis)
    x = rest * [1.3, 0.8, 0.6] + rng.normal(0, 0.1, rest.shape)
    modes: tuple[reference.Volume, ...] = ("scale", "project")
    for volume in modes:
        goal = reference_states.goals(x, body, 1.0, 1.0, volume=volume)
        (cluster,) = body.clusters
        p = (goal - goal.mean(axis=0)) / cluster.radius
        assert np.linalg.det((p.T @ cluster.q_basis @ cluster.inverse)[:, :3]) == pytest.approx(1.0)
    # nearer to where it is than the evenly scaled one
    away = [np.sum((reference_states.goals(x, body, 1.0, 1.0, volume=volume) - x) ** 2) for volume in modes]
    assert away[1] < away[0]


def test_too_few_particles_for_the_quadratic_terms_leave_the_volume_free() -> None:
    """Four uneven particles in the plane: the squares alone fit every displacement, so any A does, of any measure."""
    rng = np.random.default_rng(10)
    rest = np.array([[0.0, 0.0], [1.0, 0.3], [0.2, 1.1], [1.6, 1.9]])
    body = reference.build_rest(rest, clusters.single(4), np.array([], dtype=int), basis="quadratic")
    x = rest * 0.5 + rng.normal(0, 0.1, rest.shape)
    plain = reference_states.goals(x, body, 0.9)
    np.testing.assert_array_equal(reference_states.goals(x, body, 0.9, 1.0, volume="project"), plain)


def test_a_cluster_of_one_particle_has_no_volume_to_keep() -> None:
    rest = lattice((2, 2, 2), 1.0)
    grouped = clusters.Clusters([np.array([i]) for i in range(8)], 8)
    bases: tuple[reference.Basis, ...] = ("linear", "quadratic")
    for basis in bases:
        body = reference.build_rest(rest, grouped, np.array([], dtype=int), basis=basis)
        np.testing.assert_array_equal(reference_states.goals(2.0 * rest, body, 0.5, 1.0, volume="project"), 2.0 * rest)


def test_time_steps_take_the_mode() -> None:
    rng = np.random.default_rng(15)
    body = _body((4, 3, 3), 2, "linear", rng)
    x = _states(body.position, rng)[0]
    after, _ = reference_states.step(x, np.zeros_like(x), body, x[:0], beta=0.9, theta=0.8, volume="project")
    np.testing.assert_allclose(after, reference_states.goals(x, body, 0.9, 0.8, volume="project"), atol=1e-14)


@pytest.mark.parametrize("beta", [0.9, slow(0.99)])
def test_overlapping_clusters_pressed_flat_come_to_rest(beta: float) -> None:
    """30 % compression, where eq. 3.17 runs away; theta widens the waist, as it should."""
    shape = (6, 6, 6)
    rest = lattice(shape)
    low, high = np.flatnonzero(rest[:, 2] <= 0), np.flatnonzero(rest[:, 2] >= rest[:, 2].max() - 1e-9)
    held = np.concatenate([low, high])
    position = rest[held].copy()
    position[len(low) :, 2] *= 0.7
    body = reference.build_rest(rest, clusters.lattice(rest, shape, np.arange(len(rest)), 3), held)
    widths = []
    for theta in (0.0, 0.5, 1.0):
        x, residual = reference_states.relax(
            body, position, beta=beta, theta=theta, volume="project", tolerance=1e-10, max_iterations=500
        )
        assert residual < 1e-9
        widths.append(np.ptp(x.reshape(*shape, 3)[:, :, 2, 0], axis=0).mean())
    assert widths[0] < widths[1] < widths[2]


@functools.cache
def _kernel(dim: int, precision: str) -> Any:
    """One that projects each matrix of an array, and changes it."""
    functions = functions_for(dim, getattr(wp, precision))
    square, vec = functions.square, functions.vec
    project, project_change = functions.project, functions.project_change
    module = f"test_projection_{dim}d_{precision}"
    wp.get_module(module).options.update(module_options(getattr(wp, precision)))

    @wp.kernel(module=module, enable_backward=False)
    def project_all(
        b: wp.array(dtype=square),
        direction: wp.array(dtype=square),
        span_count: int,
        change_out: wp.array(dtype=square),
        slope_out: wp.array(dtype=square),
        stretch_out: wp.array(dtype=vec),
    ):
        i = wp.tid()
        change, u, v, stretch, mu = project(b[i], span_count)
        change_out[i] = change
        stretch_out[i] = stretch
        slope_out[i] = project_change(u, v, stretch, mu, span_count, direction[i])

    return project_all, square, vec


def _project(
    b: FloatArray, direction: FloatArray, span_count: int, precision: str, device: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Nearest matrices (n, d, d) less b, their change along `direction` less it, and their stretches (n, d)."""
    kernel, square, vec = _kernel(b.shape[1], precision)
    inputs = [wp.array(values, dtype=square, device=device) for values in (b, direction)]
    outputs = [wp.full(len(b), dtype(wp.nan), dtype=dtype, device=device) for dtype in (square, square, vec)]
    wp.launch(kernel, dim=len(b), inputs=[*inputs, span_count], outputs=outputs, device=device)
    change, slope, stretch = (out.numpy().astype(np.float64) for out in outputs)
    return change, slope, stretch


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("dim", "span_count"), SPANS)
def test_warp_agrees_with_the_reference(device: str, precision: str, dim: int, span_count: int) -> None:
    rng = np.random.default_rng(11)
    for kind in ("near", "inverted", "expanded", "wide"):
        b = _matrices(kind, 30, dim, span_count, rng)  # the reference takes a millisecond for each
        expected = np.stack([reference_states.project_measure(matrix, span_count) for matrix in b])
        change, _, stretch = _project(b, np.zeros_like(b), span_count, precision, device)
        size = np.maximum(1.0, np.abs(b).max(axis=(1, 2)))
        further = np.linalg.norm(change, axis=(1, 2)) - np.linalg.norm(expected - b, axis=(1, 2))
        assert np.all(np.abs(further) < DISTANCE_TOLERANCE[precision] * size), kind
        np.testing.assert_allclose(np.prod(stretch[:, :span_count], axis=1), 1.0, rtol=DISTANCE_TOLERANCE[precision])
        if kind == "near":
            np.testing.assert_allclose(b + change, expected, atol=NEAREST_TOLERANCE[precision])


@pytest.mark.parametrize("precision", PRECISIONS)
def test_warp_stays_finite_in_hard_cases(device: str, precision: str) -> None:
    rng = np.random.default_rng(12)
    for dim, span_count in (*SPANS, (2, 0), (3, 0)):
        b = _hard_cases(dim)
        b[:, :, span_count:] = 0.0
        direction = rng.normal(size=b.shape)
        direction[:, :, span_count:] = 0.0
        change, slope, _ = _project(b, direction, span_count, precision, device)
        assert np.isfinite(change).all()
        assert np.isfinite(slope).all()
        expected = np.stack([reference_states.project_measure(matrix, span_count) for matrix in b])
        size = np.maximum(1.0, np.abs(b).max(axis=(1, 2)))
        further = np.linalg.norm(change, axis=(1, 2)) - np.linalg.norm(expected - b, axis=(1, 2))
        assert np.all(np.abs(further) < DISTANCE_TOLERANCE[precision] * size)


@pytest.mark.parametrize(("dim", "span_count"), SPANS)
def test_the_derivative_agrees_with_differences(device: str, dim: int, span_count: int) -> None:
    rng = np.random.default_rng(13)
    h = 1e-5
    for kind in ("near", "inverted", "normal"):
        b = _matrices(kind, 100, dim, span_count, rng)
        direction = rng.normal(size=b.shape)
        direction[:, :, span_count:] = 0.0
        _, slope, _ = _project(b, direction, span_count, "float64", device)
        after, before = (
            _project(b + step * direction, direction, span_count, "float64", device)[0] for step in (h, -h)
        )
        # some lie near a tie, where the slope itself changes fast: most must agree closely, all roughly
        error = np.abs((after - before) / (2 * h) - slope).max(axis=(1, 2)) / np.maximum(
            1.0, np.abs(slope).max(axis=(1, 2))
        )
        assert np.quantile(error, 0.9) < 1e-7
        assert error.max() < 1e-4


@pytest.mark.slow  # for the kernels of single precision, which take seconds to compile
@pytest.mark.parametrize(("dim", "span_count"), SPANS)
def test_the_derivative_in_single_precision_is_that_in_double(device: str, dim: int, span_count: int) -> None:
    rng = np.random.default_rng(13)
    for kind in ("near", "inverted", "normal"):
        b = _matrices(kind, 100, dim, span_count, rng)
        direction = rng.normal(size=b.shape)
        direction[:, :, span_count:] = 0.0
        _, slope, _ = _project(b, direction, span_count, "float64", device)
        _, rounded, _ = _project(b, direction, span_count, "float32", device)
        error = np.abs(rounded - slope).max(axis=(1, 2)) / np.maximum(1.0, np.abs(slope).max(axis=(1, 2)))
        assert error.max() < 1e-4


@pytest.mark.parametrize(("dim", "span_count"), SPANS)
def test_the_derivative_is_symmetric(device: str, dim: int, span_count: int) -> None:
    """It is a second derivative: solvers count on it."""
    rng = np.random.default_rng(14)
    units = np.zeros((dim * span_count, dim, dim))
    for row, (i, j) in enumerate(itertools.product(range(dim), range(span_count))):
        units[row, i, j] = 1.0
    for b in _matrices("normal", 5, dim, span_count, rng):
        _, slopes, _ = _project(np.broadcast_to(b, units.shape).copy(), units, span_count, "float64", device)
        hessian = slopes[:, :, :span_count].reshape(len(units), -1)
        np.testing.assert_allclose(hessian, hessian.T, atol=1e-10 * max(1.0, np.abs(hessian).max()))
