"""Plastic deformation: when it comes, what it keeps, and the engine against the reference."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.msm import clusters, reference
from deformscope.stages.msm.materials import Plasticity
from deformscope.stages.msm.plastic import PlasticMsm
from deformscope.stages.msm.reference import Basis, Volume
from deformscope.stages.msm.solver import Msm
from tests.cases import slow
from tests.stages.bodies import SPACING_M, Pushed, lattice, pushed
from tests.stages.msm import reference_material as spec
from tests.stages.msm.reference_material import Yielding


def _turn(rng: np.random.Generator, dim: int) -> FloatArray:
    q = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    q[:, 0] *= np.sign(np.linalg.det(q))
    return q


def _engine(body: Pushed, device: str, **kind: object) -> Msm:
    """By index lists, as what yields is."""
    grouped = clusters.Clusters(list(body.clusters(3)), len(body.rest))
    return Msm(body.rest, grouped, body.held, device=device, **kind)  # type: ignore[arg-type]


def _sizes(plastic: FloatArray) -> FloatArray:
    """|S^p - I|_2 of (..., d, d)."""
    return np.asarray(np.linalg.norm(plastic - np.eye(plastic.shape[-1]), 2, axis=(-2, -1)))


def _identities(body: Pushed) -> list[FloatArray]:
    return [np.eye(body.rest.shape[1])] * body.clusters(3).count


def _random_plastic(rng: np.random.Generator, count: int, dim: int, size: float = 0.3) -> FloatArray:
    s = np.eye(dim) + rng.normal(0, size / dim, (count, dim, dim))
    return np.asarray(
        s / np.cbrt(np.linalg.det(s))[:, None, None] if dim == 3 else s / np.sqrt(np.linalg.det(s))[:, None, None]
    )


SHAPES = [(5, 5), (4, 3, 4)]
PLANE_FIRST = [SHAPES[0], slow(SHAPES[1])]
"""For many candidates, whose kernels in space nothing else compiles."""


@pytest.mark.parametrize(("volume", "theta"), [("scale", 0.0), ("scale", 0.4), ("project", 0.6)])
@pytest.mark.parametrize("basis", ["linear", slow("quadratic")])
@pytest.mark.parametrize("shape", SHAPES)
def test_goals_of_a_yielded_body_are_those_of_its_new_rest_vectors(
    device: str, shape: tuple[int, ...], basis: Basis, volume: Volume, theta: float
) -> None:
    """The engine keeps the fits of the first rest shape; the reference replaces every rest vector (Müller 2005)."""
    rng = np.random.default_rng(1)
    body = pushed(shape, rng)
    rest = reference.build_rest(body.rest, body.clusters(3), body.held, basis=basis)
    plastic = _random_plastic(rng, len(rest.clusters), len(shape))
    engine = PlasticMsm(_engine(body, device, basis=basis), Plasticity(0.1))
    found = engine.residual(body.rest, 0.7, theta, volume=volume, plastic=plastic)[0]
    x = body.rest + rng.normal(0, 0.002, body.rest.shape)
    for at, got in ((body.rest, found), (x, engine.residual(x, 0.7, theta, volume=volume, plastic=plastic)[0])):
        expected = spec.goals(at, rest, 0.7, theta, plastic=plastic, volume=volume, basis=basis) - at
        assert np.abs(got - expected).max() < 1e-9 * SPACING_M


@pytest.mark.parametrize("shape", [slow((5, 4)), (3, 3, 3)])
def test_a_load_ends_where_the_reference_ends(device: str, shape: tuple[int, ...]) -> None:
    body = pushed(shape, np.random.default_rng(3))
    rest = reference.build_rest(body.rest, body.clusters(3), body.held)
    for theta, duration in ((0.0, None), (0.5, 0.05)):
        engine = PlasticMsm(_engine(body, device), Plasticity(0.05, creep=8.0, maximum=0.2))
        x, plastic = body.rest, _identities(body)
        for held in (body.held_position, body.rest[body.held]):
            found = engine.load(held, 0.6, theta, duration=duration, tolerance=1e-12)
            assert found.converged.all()
            x, plastic = spec.load(
                x, rest, held, plastic, Yielding(0.05, 8.0, 0.2), beta=0.6, theta=theta, duration=duration
            )
            np.testing.assert_allclose(engine.plastic[0], plastic, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(found.position[0], x, rtol=0.0, atol=1e-9 * engine.body.extent)
        assert _sizes(engine.plastic).max() > 0.02


def test_candidates_side_by_side_are_those_alone(device: str) -> None:
    """On a CPU from four on they go through the lanes of one computation."""
    body = pushed((5, 5), np.random.default_rng(5))
    strains = np.array([0.02, 0.05, 0.08, 0.2, 0.5, 0.03, 0.04, 0.06, 0.07])
    together = PlasticMsm(_engine(body, device), Plasticity(strains), len(strains))
    found = together.load(body.held_position, 0.6, tolerance=1e-12)
    for row in (0, 3, 8):
        alone = PlasticMsm(_engine(body, device), Plasticity(float(strains[row])))
        expected = alone.load(body.held_position, 0.6, tolerance=1e-12)
        # one may go on for another round while a neighbour does; what is left then is below the yield strain's share
        limit = 2e-3 * strains[row]
        np.testing.assert_allclose(together.plastic[row], alone.plastic[0], rtol=0.0, atol=limit)
        np.testing.assert_allclose(found.position[row], expected.position[0], rtol=0.0, atol=limit * SPACING_M)
        np.testing.assert_allclose(found.strain[row], expected.strain[0], rtol=0.0, atol=1e-9)


def _same(device: str, found: FloatArray, expected: FloatArray, limit: float) -> None:
    """To the last bit; a GPU's compiler fuses products and sums as it sees fit, so there within a limit."""
    if device == "cpu":
        np.testing.assert_array_equal(found, expected)
    else:
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=limit)


@pytest.mark.parametrize(("shape", "size"), [(SHAPES[0], 1), (SHAPES[0], 9), (SHAPES[1], 1), slow(SHAPES[1], 9)])
def test_below_the_yield_strain_nothing_differs_to_the_last_bit(device: str, shape: tuple[int, ...], size: int) -> None:
    body = pushed(shape, np.random.default_rng(6))
    elastic = _engine(body, device)
    engine = PlasticMsm(elastic, Plasticity(3.0, creep=30.0), size)
    beta = np.linspace(0.6, 0.2, size)
    for theta in (0.0, 0.5):
        found = engine.load(body.held_position, beta, theta)
        engine.load(body.rest[body.held], beta, theta)
        assert not found.flowed.any()
        assert 0.05 < found.strain.max() < 3.0
        expected = elastic.relax(body.held_position, beta, theta, volume="project", start=body.rest)
        engine.start(body.rest)
        again = engine.load(body.held_position, beta, theta)
        _same(device, again.position, expected.position, 2e-9 * elastic.extent)  # twice the default tolerance
    assert np.all(engine.plastic == np.eye(len(shape)))


def _bar(device: str, dim: int = 2) -> tuple[Msm, FloatArray]:
    """One cluster of which both ends are held, so that its strain is what they are given."""
    rest = lattice((3,) * dim)
    ends = np.flatnonzero((rest[:, 0] <= 0.0) | (rest[:, 0] >= rest[:, 0].max() - 1e-9))
    return Msm(rest, clusters.single(len(rest)), ends, device=device), rest


def test_a_stretched_bar_yields_by_what_is_above_its_yield_strain(device: str) -> None:
    """Known answer. Two ends held 10 % apart: A = diag(1.1, 1). The flow ends where the elastic stretch is 1 + yield;
    with S^p = diag(s, 1 / s) that is 1.1 / s = 1.04 along, 1 / (1 / s) = s across, whose strain is less than 0.1.
    """
    body, rest = _bar(device)
    engine = PlasticMsm(body, Plasticity(0.06))
    held = rest[body.held] * np.array([1.1, 1.0])
    found = engine.load(held, 0.0, settled=1e-9)
    assert found.strain[0, 0] == pytest.approx(0.1, abs=1e-9)
    s = 1.1 / 1.06
    # the middle row is free: it follows the plastic shape, and the fit across with it
    a = found.position[0]
    q, p = rest - rest.mean(axis=0), a - a.mean(axis=0)
    fit = (p.T @ q) @ np.linalg.inv(q.T @ q)
    elastic = fit @ np.linalg.inv(engine.plastic[0, 0])
    assert np.linalg.svd(elastic, compute_uv=False)[0] == pytest.approx(1.06, abs=1e-6)
    np.testing.assert_allclose(engine.plastic[0, 0], np.diag([s, 1 / s]), rtol=0.0, atol=1e-6)


def test_creep_sets_the_pace(device: str) -> None:
    """Known answer: with both ends held and beta = 0, S^p flows by 1 - creep dt of what is left each time."""
    body, rest = _bar(device)
    held = rest[body.held] * np.array([1.1, 1.0])
    engine = PlasticMsm(body, Plasticity(0.0, creep=2.0))
    factor, s = np.array([1.1, 1.0]), np.array([1.0, 1.0])
    for _ in range(4):
        engine.load(held, 0.0, duration=0.05)
        p = engine.load(held, 0.0, duration=0.0).position[0]
        grown = 1.0 + 0.1 * (factor / s - 1.0)
        s = s * grown / np.sqrt(grown.prod())
        q = rest - rest.mean(axis=0)
        factor = np.diag((p - p.mean(axis=0)).T @ q @ np.linalg.inv(q.T @ q))
        np.testing.assert_allclose(np.diag(engine.plastic[0, 0]), s, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("shape", PLANE_FIRST)
def test_a_set_stays_after_unloading_where_it_yielded(device: str, shape: tuple[int, ...]) -> None:
    body = pushed(shape, np.random.default_rng(7))
    strains = np.array([0.02, 0.05, 0.1, 0.2, 2.0])
    engine = PlasticMsm(_engine(body, device), Plasticity(strains), len(strains))
    assert engine.load(body.held_position, 0.6).flowed.tolist() == [True, True, True, True, False]
    near = np.flatnonzero(body.rest[:, 0] <= 0.0)
    engine.hold(near)  # the tool has gone
    left = engine.load(body.rest[near], 0.6)
    assert left.converged.all()
    dent = np.linalg.norm(left.position - body.rest, axis=2).max(axis=1) / SPACING_M
    assert np.all(dent[:-1] > 0.05)
    assert dent[-1] < 1e-6


@pytest.mark.parametrize("shape", PLANE_FIRST)
def test_the_bound_and_the_volume_are_kept(device: str, shape: tuple[int, ...]) -> None:
    body = pushed(shape, np.random.default_rng(8), push=2.0)
    bounds = np.array([0.0, 0.02, 0.1, 0.3, np.inf])
    engine = PlasticMsm(_engine(body, device), Plasticity(0.01, creep=20.0, maximum=bounds), len(bounds))
    for _ in range(2):
        engine.load(body.held_position, 0.7)
        np.testing.assert_allclose(np.linalg.det(engine.plastic), 1.0, rtol=0.0, atol=1e-12)
        largest = _sizes(engine.plastic).max(axis=1)
        assert np.all(largest <= bounds + 1e-12)
        np.testing.assert_allclose(largest[1:3], bounds[1:3], rtol=1e-9)  # they were reached
        body = dataclasses.replace(body, held_position=1.2 * body.held_position - 0.2 * body.rest[body.held])


@pytest.mark.parametrize("shape", SHAPES)
def test_a_turned_body_flows_as_it_would_have_unturned(device: str, shape: tuple[int, ...]) -> None:
    """Turned in space, S^p is the same; turned at rest too, it turns along."""
    rng = np.random.default_rng(9)
    body, turn = pushed(shape, rng), _turn(rng, len(shape))
    engines = [PlasticMsm(_engine(body, device), Plasticity(0.04)) for _ in range(2)]
    expected = engines[0].load(body.held_position, 0.6, tolerance=1e-12, settled=1e-6)
    engines[1].start(body.rest @ turn.T)
    found = engines[1].load(body.held_position @ turn.T, 0.6, tolerance=1e-12, settled=1e-6)
    np.testing.assert_allclose(found.position, expected.position @ turn.T, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(engines[1].plastic, engines[0].plastic, rtol=0.0, atol=1e-7)
    rested = Pushed(body.rest @ turn.T, body.shape, body.held, body.held_position @ turn.T)
    other = PlasticMsm(
        Msm(rested.rest, clusters.Clusters(list(body.clusters(3)), len(rested.rest)), body.held, device=device),
        Plasticity(0.04),
    )
    other.load(rested.held_position, 0.6, tolerance=1e-12, settled=1e-6)
    np.testing.assert_allclose(other.plastic, turn @ engines[0].plastic @ turn.T, rtol=0.0, atol=1e-7)


def test_a_purely_volumetric_strain_does_not_flow_away(device: str) -> None:
    """S^p keeps the volume: what is left above the yield strain stays, and the load ends all the same."""
    rest = lattice((3, 3, 3))
    shell = np.delete(np.arange(27), 13)
    engine = PlasticMsm(Msm(rest, clusters.single(27), shell, device=device), Plasticity(0.05))
    found = engine.load(rest[shell] * 1.2, 0.5)
    assert found.converged.all()
    assert found.strain[0, 0] == pytest.approx(0.2, abs=1e-3)
    np.testing.assert_allclose(engine.plastic[0, 0], np.eye(3), rtol=0.0, atol=1e-3)


def test_a_cluster_turned_inside_out_stays_finite(device: str) -> None:
    rest = lattice((3, 3))
    body = Msm(rest, clusters.single(9), np.arange(8), device=device)
    engine = PlasticMsm(body, Plasticity(0.05, creep=200.0, maximum=0.5))
    engine.load(rest[:8] * np.array([1.0, -0.7]), 0.5)
    engine.load(rest[:8] * np.array([1.0, -0.7]), 0.5, duration=0.04)
    assert np.isfinite(engine.plastic).all()
    np.testing.assert_allclose(np.linalg.det(engine.plastic), 1.0, rtol=0.0, atol=1e-9)


def test_a_sheet_in_space_flows_as_one_in_the_plane(device: str) -> None:
    flat = pushed((5, 5), np.random.default_rng(10))
    lists = list(flat.clusters(3))
    space = Msm(np.pad(flat.rest, [(0, 0), (0, 1)]), clusters.Clusters(lists, len(flat.rest)), flat.held, device=device)
    plane, sheet = PlasticMsm(_engine(flat, device), Plasticity(0.04)), PlasticMsm(space, Plasticity(0.04))
    expected = plane.load(flat.held_position, 0.6, tolerance=1e-12, settled=1e-6)
    found = sheet.load(np.pad(flat.held_position, [(0, 0), (0, 1)]), 0.6, tolerance=1e-12, settled=1e-6)
    np.testing.assert_allclose(found.position[0, :, :2], expected.position[0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(sheet.plastic[0, :, :2, :2], plane.plastic[0], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(sheet.plastic[0, :, 2], [[0.0, 0.0, 1.0]] * len(lists), rtol=0.0, atol=1e-12)


def test_lattice_windows_yield_by_lists_of_themselves(device: str) -> None:
    body = pushed((5, 5), np.random.default_rng(11))
    windows = PlasticMsm(Msm(body.rest, body.clusters(3), body.held, device=device), Plasticity(0.04))
    lists = PlasticMsm(_engine(body, device), Plasticity(0.04))
    np.testing.assert_array_equal(
        windows.load(body.held_position, 0.6).position, lists.load(body.held_position, 0.6).position
    )


@pytest.mark.slow  # for the kernels of single precision, which nothing else compiles
def test_single_precision_flows_alike(device: str) -> None:
    body = pushed((4, 3, 4), np.random.default_rng(12))
    engines = [PlasticMsm(_engine(body, device, precision=each), Plasticity(0.05)) for each in ("float64", "float32")]
    found = [engine.load(body.held_position, 0.6) for engine in engines]
    assert found[1].converged.all()
    np.testing.assert_allclose(engines[1].plastic, engines[0].plastic, rtol=0.0, atol=3e-3)
    np.testing.assert_allclose(found[1].position, found[0].position, rtol=0.0, atol=1e-3 * engines[0].body.extent)


def test_what_it_does_not_do_is_refused(device: str) -> None:
    body = pushed((4, 4), np.random.default_rng(13))
    held = body.rest.copy()
    everything = Msm(body.rest, body.clusters(3), np.arange(len(body.rest)), device=device)
    with pytest.raises(ValueError, match="free particles"):
        PlasticMsm(everything, Plasticity(0.1)).load(held, 0.5)
    with pytest.raises(ValueError, match="yield_strain of 0 or more"):
        Plasticity(-0.1)
    with pytest.raises(ValueError, match="3 candidates"):
        PlasticMsm(_engine(body, device), Plasticity(0.1), 3).load(body.held_position, np.array([0.2, 0.8]))
