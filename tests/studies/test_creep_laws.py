"""The touches by hereditary integrals are what their laws say; a study counts what is said of them."""

import numpy as np
import pytest

from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.poke.creep import fit_creep
from studies.creep import STUDY, CreepCoverageConfig
from studies.creep_laws import LAWS, UP, LawOutcome, law_cases, law_table
from studies.independent import viscoelastic


def test_a_held_force_creeps_by_the_compliance() -> None:
    """One branch: d^p grows by 1 + j (1 - exp(-t / l)) with l = tau / (1 - g) under a force that came at once."""
    share, time_s = 0.3, 0.5
    law = viscoelastic.prony(np.array([share]), np.array([time_s]))
    made = viscoelastic.touched(law, 1.0 - share, 6.0, np.array([6.0]), np.random.default_rng(2))
    assert made.force_n[made.loading :].mean() == pytest.approx(viscoelastic.SET_N, abs=0.02)
    ended_n_per_mm = 1e-3 * viscoelastic.SET_N / made.place_m[-50:].mean()
    give_m = viscoelastic.ARM_M_PER_N * viscoelastic.SET_N
    assert 1e-3 * viscoelastic.SET_N / (made.place_m[-50:].mean() - give_m) == pytest.approx(
        made.relaxed_n_per_mm, rel=0.02
    )
    assert ended_n_per_mm < made.relaxed_n_per_mm < made.at_once_n_per_mm
    assert made.kept[0] > 1.0 - share, "a part relaxed while it came down"


@pytest.mark.parametrize(
    ("law", "at_s", "expected"),
    [
        (viscoelastic.prony(np.array([0.2, 0.1]), np.array([1.0, 5.0])), 5.0, 0.7 + 0.2 * np.exp(-5.0) + 0.1 / np.e),
        (viscoelastic.power_law(0.2, 0.5), 1.5, 0.25**0.2),
        (viscoelastic.logarithmic(0.1, 0.1), 0.9, 1.0 / 1.1),
        (viscoelastic.fractional_zener(0.4, 2.0), 2.0, 0.6 + 0.4 * 0.4275835761558070),
        (viscoelastic.stretched(0.4, 2.0, 0.6), 2.0, 0.6 + 0.4 / np.e),
    ],
)
def test_laws_are_what_they_are_called(law: viscoelastic.Modulus, at_s: float, expected: float) -> None:
    assert law(np.array([0.0, at_s])) == pytest.approx([1.0, expected])


def test_the_study_counts_reasons_and_what_holds() -> None:
    outcomes = [
        LawOutcome(
            "power law since .3 to 3 s, 8 s",
            ("no-plateau",),
            (True, None, None, True),
            (True, True, False),
            None,
            None,
            0.8,
        ),
        LawOutcome(
            "power law since .3 to 3 s, 8 s", (), (False, False, None, True), (True, True, True), 0.3, True, 0.2
        ),
    ]
    table, lines = law_table(outcomes)
    (line,) = lines
    assert line["no_plateau"].rate == 0.5
    assert (line["endless_over_70"].rate, line["endless_over_90"].rate) == (0.5, 0.0)
    assert (line["share_held"].hits, line["share_held"].cases) == (1, 2)
    assert (line["mean_time_held"].hits, line["mean_time_held"].cases) == (0, 1)
    assert line["force_held_end"].rate == 0.5
    assert (line["open"].hits, line["open"].cases) == (1, 1)
    assert len(table.rows) == 1
    assert len(law_cases(2)) == 2 * len(LAWS)


@pytest.mark.slow
def test_what_a_hold_did_not_see_is_named() -> None:
    laws = STUDY.trials(CreepCoverageConfig(objects=1, laws=12))[1]
    wanted = [one for one in laws.cases if one.law in ("one branch of 15 to 60 s, 8 s", "elastic, 8 s")]
    slow, elastic = [], []
    for case, one in zip(wanted, [laws.try_one(case) for case in wanted], strict=True):
        (elastic if "elastic" in case.law else slow).append(one)
    assert sum("short-record" in one.reasons for one in slow) >= 10
    assert sum(bool(one.reasons) for one in elastic) <= 1
    assert np.mean([one.kept for one in slow]) > 0.75


def test_the_force_kept_is_right_where_much_relaxed_on_the_way_down() -> None:
    """Under a power law the dent at the set force is much deeper than the one at once: the approach took longer."""
    law, after_s = viscoelastic.power_law(0.2, 0.001), np.array([0.5, 8.0])
    made = viscoelastic.touched(law, 0.0, 8.0, after_s, np.random.default_rng(2))
    fit = fit_creep(
        made.time_s,
        -made.place_m[:, None] * UP,
        made.force_n[:, None] * UP,
        UP,
        loading=made.loading,
        held=len(made.time_s),
        arm=ArmCompliance(viscoelastic.ARM_M_PER_N, viscoelastic.ARM_OFF_M_PER_N),
        radius_m=viscoelastic.RADIUS_M,
    )
    said = [one.share for one in fit.force_kept if one.after_s in (0.5, fit.held_s)]
    assert said == pytest.approx(made.kept, abs=0.015)
