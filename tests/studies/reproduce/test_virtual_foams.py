"""The five foams keep what their makers state and what the text on them promises."""

import pytest
from scipy.stats import spearmanr

from deformscope.lab.plateau_world import OgdenFoam
from deformscope.lab.scenes import PLATE_M2
from studies.reproduce.virtual_foams import FOAMS, Foam, uniaxial


def test_they_are_those_of_the_thesis() -> None:
    assert [foam.name for foam in FOAMS] == ["24/80", "28/150", "39/120", "39/200", "50/230"]


@pytest.mark.parametrize("foam", FOAMS, ids=lambda foam: foam.name)
def test_hardness_is_the_force_at_40_percent(foam: Foam) -> None:
    assert -uniaxial(foam.law(), 0.6)[0] * PLATE_M2 == pytest.approx(foam.hardness, rel=1e-9)


@pytest.mark.parametrize("foam", FOAMS, ids=lambda foam: foam.name)
def test_density_makes_it_densify_as_gibson_and_ashby_say(foam: Foam) -> None:
    law = foam.law()
    weightless = OgdenFoam(law.shear[:1], law.exponent[:1], law.poisson)
    limit = 1 - 1.4 * foam.density / 1200
    assert uniaxial(law, 0.35)[0] / uniaxial(weightless, 0.35)[0] == pytest.approx(0.35 / (limit - 0.65), rel=1e-9)


def test_denser_of_two_equal_foams_is_firmer_when_pressed_far() -> None:
    light, dense = (Foam(density, 120.0, 12.0, 0.1).law() for density in (24.0, 50.0))
    assert uniaxial(dense, 0.6)[0] == pytest.approx(uniaxial(light, 0.6)[0], rel=1e-9)
    assert uniaxial(dense, 0.3)[0] / uniaxial(light, 0.3)[0] > 1.1


def test_what_was_chosen_does_not_go_with_hardness() -> None:
    hardness = [foam.hardness for foam in FOAMS]
    assert abs(spearmanr(hardness, [foam.plateau for foam in FOAMS]).statistic) <= 0.1 + 1e-9
    assert abs(spearmanr(hardness, [foam.poisson for foam in FOAMS]).statistic) <= 0.1 + 1e-9
