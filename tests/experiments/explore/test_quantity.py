"""What of a touch is mapped, and which search an exploration begins with: as the options say."""

import dataclasses

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.experiments.explore.options import (
    ApparentStiffness,
    ExploreOptions,
    RelaxedStiffness,
    StiffnessAtReferenceSpeed,
)
from deformscope.experiments.explore.search import InclusionSearch, RegionSearch
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.map.measured import TouchMeasurement
from deformscope.stages.poke.creep import REFERENCE_SPEED_M_S, CreepFit
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import MapGrid, StiffnessSample, TouchErrorModel

FELT = StiffnessSample(np.array([0.1, 0.1]), log_stiffness=0.2, log_sd=0.03)
RIGID = dataclasses.replace(FELT, rigid=True)
CREEP = CreepFit(
    instant_n_per_mm=1.2,
    instant_interval=(1.1, 1.3),
    relaxed_n_per_mm=0.8,
    relaxed_interval=(0.7, 0.9),
    relaxed_log_sd=0.04,
    share=0.3,
    share_interval=(0.2, 0.4),
    time_s=1.0,
    time_interval=(0.5, 2.0),
    loss=0.25,
    loss_interval=(0.2, 0.3),
    held_s=5.0,
    speed_m_s=0.02,
    verdict="viscous",
    log_at_reference=-0.05,
    log_at_reference_sd=0.01,
)


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        (ExploreOptions(), ApparentStiffness),
        (ExploreOptions(hold_s=5.0), StiffnessAtReferenceSpeed),
        (ExploreOptions(hold_s=5.0, feel="relaxed"), RelaxedStiffness),
    ],
)
def test_options_carry_what_is_mapped(options: ExploreOptions, kind: type) -> None:
    quantity = options.quantity
    assert type(quantity) is kind
    assert quantity.stiffness(RIGID, None, 0.01) is RIGID, "something rigid neither creeps nor relaxes"


def test_touches_compare_at_one_speed_where_their_creep_was_fitted_and_are_doubted_where_not() -> None:
    quantity = StiffnessAtReferenceSpeed()
    fitted, fast, same = (
        quantity.stiffness(FELT, creep, speed)
        for creep, speed in ((CREEP, 0.02), (None, 10.0 * REFERENCE_SPEED_M_S), (None, REFERENCE_SPEED_M_S))
    )
    assert fitted.log_stiffness == FELT.log_stiffness + CREEP.log_at_reference
    assert fast.log_stiffness == FELT.log_stiffness
    assert fast.log_sd > same.log_sd == FELT.log_sd


def test_a_touch_without_its_creep_has_no_relaxed_stiffness() -> None:
    relaxed = RelaxedStiffness().stiffness(FELT, CREEP, None)
    assert RelaxedStiffness().stiffness(FELT, None, None) is None
    assert np.exp(relaxed.log_stiffness) == pytest.approx(CREEP.relaxed_n_per_mm)


def test_options_carry_what_is_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    few = RegionPosterior.before_touches
    monkeypatch.setattr(
        RegionPosterior, "before_touches", lambda *given, seed: few(*given, particle_count=50, seed=seed)
    )
    grid, error = MapGrid((0.2, 0.2), 0.02), TouchErrorModel(gain_sd=0.02)
    regions, inclusions = (
        options.search(grid, error)
        for options in (ExploreOptions(), ExploreOptions(goal="inclusions", inclusion_m=0.02))
    )
    assert type(regions) is RegionSearch
    assert isinstance(inclusions, InclusionSearch)
    assert [one.posterior.prior.error.gain_sd for one in (regions, inclusions)] == [0.02, 0.02]


def test_an_approach_is_a_touch_without_its_hold_and_its_way_back() -> None:
    time_s, along, up = np.arange(9.0), np.zeros((9, 3)), np.array([0.0, 0.0, 1.0])
    whole = TouchMeasurement(up[:2], up, time_s, along, along, np.zeros((0, 3)), True, loading=4, held=7)
    assert whole.approach.time_s.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert whole.approach.force_n.shape == (4, 3)
    assert whole.approach.held is None
    approach = whole.approach
    assert approach.approach is approach


def test_a_touch_whose_end_was_not_seen_has_no_relaxed_stiffness() -> None:
    unseen = dataclasses.replace(
        CREEP,
        relaxed_n_per_mm=None,
        relaxed_interval=None,
        relaxed_log_sd=None,
        reasons=(Doubt("short-record", "the relaxed state was not seen"),),
    )
    with pytest.raises(InputError, match="the relaxed state was not seen"):
        RelaxedStiffness().stiffness(FELT, unseen, None)
