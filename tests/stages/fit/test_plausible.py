"""Lengths that cannot be metres are refused, with what to try; those that can be are not."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.plausible import check_metres, check_poke, check_same_unit, size_note
from tests.stages.bodies import lattice

CUBE = lattice((4, 4, 4), 0.03)  # 9 cm
EVERYONE = np.ones(len(CUBE), dtype=bool)


def stretched(by: float, seed: int = 0) -> FloatArray:
    """The cube, drawn out along x, turned, and put elsewhere."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    return np.asarray((CUBE * [1.0 + by, 1.0, 1.0]) @ turn.T + [3.0, -2.0, 0.5])


@pytest.mark.parametrize("unit", [1e3, 1e2, 640 / 0.09], ids=["millimetres", "centimetres", "pixels"])
def test_other_units_are_not_taken_for_metres(unit: float) -> None:
    check_metres(CUBE)
    with pytest.raises(InputError, match=r"expected positions in metres.*try: divide by 1000 if"):
        check_metres(unit * CUBE)


def test_inches_are_noted() -> None:
    assert size_note(CUBE) is None
    note = size_note(CUBE / 0.0254)
    assert note is not None
    assert "3.54 m large" in note


def test_one_unit_is_asked_of_rest_and_deformed() -> None:
    for by in (0.0, 0.5, 2.0, -0.6):
        check_same_unit(CUBE, stretched(by), EVERYONE)
    for unit in (1e3, 1e2, 1 / 0.0254):
        with pytest.raises(InputError, match="the unit of rest"):
            check_same_unit(CUBE, unit * CUBE, EVERYONE)
    some = EVERYONE.copy()
    some[5] = False
    lost = CUBE.copy()
    lost[5] = np.nan
    check_same_unit(CUBE, lost, some)


def test_noise_is_smaller_than_the_body() -> None:
    check_metres(CUBE, np.full(len(CUBE), 0.0005))
    with pytest.raises(InputError, match="noise in metres"):
        check_metres(CUBE, np.full(len(CUBE), 0.5))


@pytest.mark.parametrize(
    ("thickness", "depth", "tip", "said"),
    [
        (0.05, 3.0, 0.02, "try: depths are in metres"),
        (0.05, 0.05, 0.02, "less deep than the 50 mm"),
        (50.0, 0.003, 0.02, "a thickness in metres"),
        (0.05, 0.003, 20.0, "a tip in metres"),
    ],
)
def test_a_poke_fits_the_material(thickness: float, depth: float, tip: float, said: str) -> None:
    check_poke(CUBE, 0.05, 0.003, 0.02)
    with pytest.raises(InputError, match=said):
        check_poke(CUBE, thickness, depth, tip)
