"""The fit of a simulator's parameters, to a simulator whose answers are known: linear finite elements, and contact that
gives way."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from deformscope.lab.elasticity import ElasticBox
from deformscope.stages.msm.poke import Tip
from deformscope.stages.poke.poke_fit import SeenPoke
from deformscope.stages.simulate.slab_mesh import slab_mesh
from deformscope.stages.simulate.target_fit import (
    MeasuredPoke,
    Stopped,
    TargetParameters,
    TargetPoke,
    fit_target,
    followed,
    score_beyond_edge,
    surface_moved,
    target_score,
)

MESH = slab_mesh((np.linspace(0.0, 0.08, 9), np.linspace(0.0, 0.08, 9), np.linspace(0.0, 0.03, 4)))
TRUE = TargetParameters(40e3, 0.35, 1e5)
START = TargetParameters(60e3, 0.2, 1e4)
GIVES = 3e5
"""Force per penetration, of a contact of 1e5 / s^2 [N/m]."""
POKES = (((0.04, 0.04), 0.001), ((0.03, 0.04), 0.002), ((0.04, 0.05), 0.003))


class Elements:
    """Trilinear finite elements on the mesh's grid, pressed by a flat tip, behind a spring for the contact."""

    def __init__(self, allowed: int = 1000) -> None:
        self.runs, self.allowed = 0, allowed

    def __call__(self, parameters: TargetParameters, pokes: Sequence[MeasuredPoke]) -> list[TargetPoke]:
        self.runs += 1
        if self.runs > self.allowed:
            raise Stopped
        box = ElasticBox(*MESH.axes, young=parameters.young, poisson=parameters.poisson, element="trilinear")
        return [_pressed(box, parameters.contact, one.seen.at, one.depth) for one in pokes]


def _pressed(box: ElasticBox, contact: float, at: np.ndarray, depth: np.ndarray) -> TargetPoke:
    under = box.plane(2, 0.03) & (np.abs(box.nodes[:, :2] - at[:2]) <= 0.0101).all(axis=1)
    held = np.zeros(box.nodes.shape, dtype=bool)
    held[box.plane(2, 0.0)] = True
    held[under, 2] = True
    moved = np.zeros(held.shape)
    moved[under, 2] = -1.0
    unit = box.hold(held).solve(moved)
    stiffness, gives = float(-unit.force[under, 2].sum()), GIVES * contact / 1e5
    sunk = depth * gives / (gives + stiffness)
    displaced = unit.displacement[box.corners] * sunk[-1]
    return TargetPoke(stiffness * sunk, depth - sunk, MESH.vertices, displaced)


def measured(parameters: TargetParameters = TRUE) -> list[MeasuredPoke]:
    """What such pokes of the true body show, at places of its upper face."""
    axis = np.linspace(0.01, 0.07, 9)
    places = np.stack(np.meshgrid(axis, axis, [0.03], indexing="ij"), axis=-1).reshape(-1, 3)
    none = np.zeros((0, 3))
    found = []
    for at, depth in POKES:
        seen = SeenPoke(np.array([*at, 0.03]), Tip("flat", (0.02, 0.02)), depth, none, none, places, places, None, 1.0)
        poke = MeasuredPoke("", seen, np.array([0.5, 1.0]) * depth, np.ones(2))
        answer = Elements()(parameters, [poke])[0]
        seen = replace(seen, moved=surface_moved(MESH, poke, answer), force=float(answer.force[-1]))
        found.append(MeasuredPoke("", seen, poke.depth, answer.force))
    return found


def test_the_parameters_that_made_the_pokes_are_found() -> None:
    pokes = measured()
    target = Elements()
    fit = fit_target(MESH, pokes, target, START, (True, True, True))
    assert fit.converged
    assert target.runs <= 21
    assert fit.parameters.young == pytest.approx(TRUE.young, rel=0.03)
    assert fit.parameters.poisson == pytest.approx(TRUE.poisson, abs=0.02)
    assert fit.determined("young")
    assert fit.determined("poisson")
    assert fit.errors[-1] < 0.1 * fit.errors[0]
    for poke, answer in zip(pokes, fit.answers, strict=True):
        score = target_score(MESH, poke, answer, "elements")
        assert abs(score.force_error or 0.0) < 0.02
        assert score.surface_error < 0.02


def test_a_given_parameter_stays_and_is_not_called_determined() -> None:
    given = replace(START, poisson=TRUE.poisson)
    fit = fit_target(MESH, measured(), Elements(), given, (True, False, True))
    assert fit.parameters.poisson == TRUE.poisson
    assert not fit.determined("poisson")
    assert fit.determined("young")


def test_a_contact_that_hardly_gives_way_is_not_determined() -> None:
    """Its force is the same for any stiffness far above the body's."""
    hard = replace(TRUE, contact=3e7)
    fit = fit_target(MESH, measured(hard), Elements(), replace(hard, young=60e3), (True, True, True))
    assert not fit.determined("contact")
    assert fit.determined("young")
    assert fit.parameters.young == pytest.approx(hard.young, rel=0.03)


class Balanced(Elements):
    """The same, with a modulus that falls where Poisson's ratio rises: a step of one alone makes the forces worse."""

    def __call__(self, parameters: TargetParameters, pokes: Sequence[MeasuredPoke]) -> list[TargetPoke]:
        lost = np.exp(20.0 * ((TRUE.poisson - START.poisson) ** 2 - (parameters.poisson - START.poisson) ** 2))
        return super().__call__(replace(parameters, young=parameters.young * float(lost)), pokes)


def test_a_step_that_is_cut_short_keeps_the_balance_of_its_parameters() -> None:
    """Poisson's ratio is .15 away, and a step is at most .1."""
    start = replace(TRUE, poisson=START.poisson)
    fit = fit_target(MESH, measured(), Balanced(), start, (True, True, True))
    assert fit.converged
    assert fit.parameters.young == pytest.approx(TRUE.young, rel=0.03)
    assert fit.parameters.poisson == pytest.approx(TRUE.poisson, abs=0.02)


def test_noise_widens_the_deviations() -> None:
    rng = np.random.default_rng(1)
    noisy = []
    for one in measured():
        moved = one.seen.moved + rng.normal(0.0, 0.2 * one.seen.depth, one.seen.moved.shape)
        noisy.append(replace(one, seen=replace(one.seen, moved=moved)))
    clean, rough = (fit_target(MESH, some, Elements(), START, (True, True, True)) for some in (measured(), noisy))
    assert rough.deviation[1] > 2.0 * clean.deviation[1]


def test_when_it_is_stopped_the_best_so_far_remains() -> None:
    """After five runs: the first, three for the derivatives, and one better."""
    fit = fit_target(MESH, measured(), Elements(allowed=5), START, (True, True, True))
    assert not fit.converged
    assert len(fit.errors) == 2
    assert fit.errors[1] < fit.errors[0]
    early = fit_target(MESH, measured(), Elements(allowed=2), START, (True, True, True))
    assert early.parameters.young == pytest.approx(START.young)
    assert not early.determined("young")


def test_of_heights_alone_sideways_motion_is_not_compared() -> None:
    poke = measured()[2]
    answer = Elements()(TRUE, [poke])[0]
    heights = replace(poke, seen=replace(poke.seen, heights_only=True))
    moved = surface_moved(MESH, heights, answer)
    np.testing.assert_array_equal(moved[:, :2], 0.0)
    assert moved[:, 2].min() == pytest.approx(poke.seen.moved[:, 2].min(), rel=0.05)


def test_the_surface_within_a_cell_of_a_flat_tips_edge_neither_counts_nor_is_fitted() -> None:
    """Cells of 10 mm, a tip of 20 mm: points 1 to 9 mm beyond its edge fall out, of a ball none."""
    across = np.array([0.0, 0.009, 0.011, 0.019, 0.021, 0.03])
    places = np.column_stack([0.04 + across, np.full(6, 0.04), np.full(6, 0.03)])
    poke = measured()[0]
    flat = replace(poke.seen, points=places, moved=np.zeros((6, 3)))
    disc, ball = (replace(flat, tip=Tip(shape, (0.02,))) for shape in ("disc", "sphere"))
    for seen, kept in ((flat, 4), (disc, 4), (ball, 6)):
        assert followed(MESH, seen).sum() == kept
    assert not followed(MESH, flat)[[2, 3]].any()
    spoilt = poke.seen.moved.copy()
    spoilt[~followed(MESH, poke.seen)] += 1.0
    assert (~followed(MESH, poke.seen)).any()
    wrong = replace(poke, seen=replace(poke.seen, moved=spoilt))
    answer = Elements()(TRUE, [poke])[0]
    assert score_beyond_edge(MESH, wrong, answer) == score_beyond_edge(MESH, poke, answer) < 1e-6
    assert target_score(MESH, wrong, answer, "elements").surface_error > 1.0
    fit = fit_target(MESH, [wrong, *measured()[1:]], Elements(), START, (True, True, True))
    assert fit.parameters.poisson == pytest.approx(TRUE.poisson, abs=0.02)


EDGE = 0.04


class TwoMaterials(Elements):
    """The same with the second material beyond EDGE."""

    def __call__(self, parameters: TargetParameters, pokes: Sequence[MeasuredPoke]) -> list[TargetPoke]:
        self.runs += 1
        soft, firm = parameters.moduli
        box = ElasticBox(
            *MESH.axes,
            young=lambda centres: np.where(centres[:, 0] < EDGE, soft, firm),
            poisson=parameters.poisson,
            element="trilinear",
        )
        return [_pressed(box, parameters.contact, one.seen.at, one.depth) for one in pokes]


def test_each_material_that_was_poked_gets_its_modulus() -> None:
    """Unseen pokes, one on the border, are the test."""
    true = TargetParameters(20e3, 0.3, 1e5, (4.0,))
    start = TargetParameters(30e3, 0.3, 1e5, (1.5,))
    places = [
        replace(one, seen=replace(one.seen, at=np.array([x, 0.04, 0.03]))) for one in measured() for x in (0.02, 0.06)
    ]
    press = TwoMaterials()
    pokes = [replace(one, force=press(true, [one])[0].force) for one in places]
    pokes = [
        replace(one, seen=replace(one.seen, moved=surface_moved(MESH, one, press(true, [one])[0]))) for one in pokes
    ]
    fit = fit_target(MESH, pokes[:2], press, start, (True, False, True, True))
    assert fit.parameters.moduli == pytest.approx(true.moduli, rel=0.03)
    assert fit.determined("young")
    assert fit.determined("ratio 1")
    border = replace(pokes[0], seen=replace(pokes[0].seen, at=np.array([0.04, 0.05, 0.03])))
    for unseen in (*pokes[2:], border):
        force, known = (press(parameters, [unseen])[0].force for parameters in (fit.parameters, true))
        np.testing.assert_allclose(force, known, rtol=0.03)


def test_a_material_without_pokes_keeps_its_share() -> None:
    true = TargetParameters(20e3, 0.3, 1e5, (4.0,))
    press = TwoMaterials()
    poke = measured()[0]
    poke = replace(poke, seen=replace(poke.seen, at=np.array([0.02, 0.04, 0.03])))
    answer = press(true, [poke])[0]
    poke = replace(poke, force=answer.force, seen=replace(poke.seen, moved=surface_moved(MESH, poke, answer)))
    fit = fit_target(MESH, [poke], press, TargetParameters(30e3, 0.3, 1e5, (4.0,)), (True, False, False, False))
    assert fit.parameters.moduli == pytest.approx(true.moduli, rel=0.03)
    assert not fit.determined("ratio 1")
