"""The foam law against closed forms, linear elasticity, finite differences and what any material must obey."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.plateau_world import OgdenFoam, stress_and_tangent
from studies.reproduce.virtual_foams import uniaxial

TWO_TERMS = OgdenFoam((3.0e3, 40.0), (12.0, -4.0), 0.2)


def gradients(d: int, count: int = 6) -> FloatArray:
    """Deformation gradients with strains up to some 50 %, none inverted."""
    rng = np.random.default_rng(d)
    every = np.eye(d) + 0.2 * rng.standard_normal((4 * count, d, d))
    return every[np.linalg.det(every) > 0.2][:count]


def turned(d: int) -> FloatArray:
    if d == 3:
        return Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    return Rotation.from_rotvec([0.0, 0.0, 0.8]).as_matrix()[:2, :2]


def energy(law: OgdenFoam, gradient: FloatArray) -> FloatArray:
    return law.energy(np.linalg.svd(gradient, compute_uv=False).T)


@pytest.mark.parametrize("d", [2, 3])
def test_stress_is_the_energys_derivative_and_tangent_the_stresss(d: int) -> None:
    at = gradients(d)
    stress, tangent = stress_and_tangent(TWO_TERMS, at)
    h = 1e-6
    for i in range(d):
        for j in range(d):
            step = np.zeros((d, d))
            step[i, j] = h
            slope = (energy(TWO_TERMS, at + step) - energy(TWO_TERMS, at - step)) / (2 * h)
            change = (stress_and_tangent(TWO_TERMS, at + step)[0] - stress_and_tangent(TWO_TERMS, at - step)[0]) / (
                2 * h
            )
            np.testing.assert_allclose(stress[:, i, j], slope, rtol=1e-6, atol=1e-6 * abs(stress).max())
            np.testing.assert_allclose(tangent[..., i, j], change, rtol=1e-6, atol=1e-6 * abs(tangent).max())


@pytest.mark.parametrize("d", [2, 3])
def test_small_strains_are_linear_elasticity(d: int) -> None:
    law, nu = TWO_TERMS, TWO_TERMS.poisson
    shear = law.young / (2 * (1 + nu))
    lame = law.young * nu / ((1 + nu) * (1 - 2 * nu))
    one = np.eye(d)
    hooke = lame * np.einsum("ij,kl->ijkl", one, one)
    hooke += shear * (np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one))
    stress, tangent = stress_and_tangent(law, one[None])
    np.testing.assert_allclose(stress, 0.0, atol=1e-12 * law.young)
    np.testing.assert_allclose(tangent[0], hooke, rtol=1e-12, atol=1e-12 * law.young)


@pytest.mark.parametrize("d", [2, 3])
def test_turning_the_body_or_the_axes_changes_nothing_else(d: int) -> None:
    at, turn = gradients(d), turned(d)
    stress, _ = stress_and_tangent(TWO_TERMS, at)
    body, _ = stress_and_tangent(TWO_TERMS, turn @ at)
    axes, _ = stress_and_tangent(TWO_TERMS, at @ turn)
    np.testing.assert_allclose(body, turn @ stress, rtol=1e-10, atol=1e-10 * abs(stress).max())
    np.testing.assert_allclose(axes, stress @ turn, rtol=1e-10, atol=1e-10 * abs(stress).max())
    cauchy = stress @ np.swapaxes(at, 1, 2)  # no torque: it is symmetric
    np.testing.assert_allclose(cauchy, np.swapaxes(cauchy, 1, 2), rtol=0, atol=1e-10 * abs(cauchy).max())


def test_tangent_is_smooth_where_two_stretches_meet() -> None:
    turn = turned(2)
    exact, near = (turn @ np.diag([0.7, 0.7 * (1 + gap)])[None] @ turn.T for gap in (0.0, 1e-5))
    meeting, apart = (stress_and_tangent(TWO_TERMS, at)[1] for at in (exact, near))
    np.testing.assert_allclose(meeting, apart, rtol=0, atol=1e-3 * abs(apart).max())


@pytest.mark.parametrize("stretch", [0.3, 0.6, 0.9, 1.2])
@pytest.mark.parametrize("a", [-4.0, 6.0, 20.0])
def test_one_term_in_uniaxial_stress_is_known_in_closed_form(a: float, stretch: float) -> None:
    mu = 5.0e3
    widthless = uniaxial(OgdenFoam((mu,), (a,), 0.0), stretch)
    assert widthless[0] == pytest.approx(2 * mu / a * (stretch ** (a - 1) - 1 / stretch), rel=1e-9)
    assert widthless[1] == pytest.approx(1.0, abs=1e-12)
    law = OgdenFoam((mu,), (a,), 0.25)
    b = law.volume_share
    # no stress across: b l^a q^2 + q - (1 + b) = 0 in q = (lateral stretch)^a
    q = 2 * (1 + b) / (1 + np.sqrt(1 + 4 * b * (1 + b) * stretch**a))
    along = 2 * mu / a * (stretch**a - 1 + b * (stretch**a * q**2 - 1)) / stretch
    stress, lateral = uniaxial(law, stretch)
    assert stress == pytest.approx(along, rel=1e-9)
    assert lateral == pytest.approx(q ** (1 / a), rel=1e-9)


def test_foam_yields_and_stops_getting_wider() -> None:
    law = OgdenFoam((1.0e4,), (20.0,), 0.3)
    slight, half = (1 - s for s in (1e-5, 0.5))
    assert -np.log(uniaxial(law, slight)[1]) / np.log(slight) == pytest.approx(0.3, rel=1e-3)
    assert -np.log(uniaxial(law, half)[1]) / np.log(half) < 0.1
    plateau = 2.0e4 * (1 + law.volume_share) / 20.0
    assert -uniaxial(law, half)[0] == pytest.approx(plateau / half, rel=1e-3)


@pytest.mark.parametrize(
    ("shear", "exponent", "poisson"),
    [((1.0,), (2.0, 3.0), 0.1), ((), (), 0.1), ((-1.0,), (2.0,), 0.1), ((1.0,), (0.0,), 0.1), ((1.0,), (2.0,), 0.5)],
)
def test_what_is_no_foam_is_refused(shear: tuple[float, ...], exponent: tuple[float, ...], poisson: float) -> None:
    with pytest.raises(InputError, match="expected"):
        OgdenFoam(shear, exponent, poisson)
