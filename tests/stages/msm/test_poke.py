"""A tip on a body: what it touches, what slips, how force and depth belong together."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.msm import clusters, reference
from deformscope.stages.msm.poke import SETTLED, Law, Poke, PokeSetup, Tip, hold, press, settle
from deformscope.stages.poke.layers import MeasuredSurface, below
from tests.stages import reference_states

AT = np.array([0.06, 0.06, 0.03])
LAW = Law(0.4, 0.6, 3)


@pytest.fixture(scope="module")
def scene() -> PokeSetup:
    x, y = np.meshgrid(np.arange(13) * 0.01, np.arange(13) * 0.01, indexing="ij")
    layers = below(MeasuredSurface(np.column_stack([x.ravel(), y.ravel(), np.full(169, 0.03)]), 0.03), spacing=0.01)
    grouped = clusters.lattice(layers.rest, layers.shape, layers.cell, 3)
    return PokeSetup(layers.rest, grouped, layers.bottom, layers.top, np.array([0.0, 0.0, -1.0]), 0.01)


def forces(scene: PokeSetup, position: FloatArray, held: FloatArray, law: Law = LAW) -> FloatArray:
    """Reaction at every particle by the float64 reference."""
    rest = reference.build_rest(scene.rest, scene.clusters, held)
    return reference_states.reaction(position, rest, law.beta, law.theta)


def test_a_flat_tip_touches_its_footprint_and_pushes_it_down(scene: PokeSetup) -> None:
    found = press(scene, LAW, Poke(AT, Tip("flat", (0.02, 0.04), slips=False), depth=0.003))
    place = scene.rest[found.touched]
    assert len(found.touched) == 3 * 5
    assert np.abs(place[:, 0] - 0.06).max() <= 0.01 + 1e-9
    assert np.abs(place[:, 1] - 0.06).max() <= 0.02 + 1e-9
    np.testing.assert_allclose(found.position[found.touched], place - [0.0, 0.0, 0.003], atol=1e-12)
    np.testing.assert_array_equal(found.position[scene.fixed], scene.rest[scene.fixed])
    held = np.concatenate([scene.fixed, found.touched])
    pull = forces(scene, found.position, held)
    assert np.abs(pull[np.setdiff1d(np.arange(len(scene.rest)), held)]).max() < 1e-6 * np.abs(pull).max()
    assert found.reaction == pytest.approx(-pull[found.touched, 2].sum(), rel=1e-6)
    assert found.converged


def test_particles_that_slip_are_pulled_at_by_nothing_sideways_and_lower_the_force(scene: PokeSetup) -> None:
    tip = Tip("flat", (0.04,))
    slips = press(scene, LAW, Poke(AT, tip, depth=0.003))
    sticks = press(scene, LAW, Poke(AT, dataclasses.replace(tip, slips=False), depth=0.003))
    pull = forces(scene, slips.position, np.concatenate([scene.fixed, slips.touched]))[slips.touched]
    assert np.abs(pull[:, :2]).max() < 0.02 * np.abs(pull[:, 2]).max()
    np.testing.assert_allclose(slips.position[slips.touched, 2], 0.027, atol=1e-12)
    assert 0.9 * sticks.reaction < slips.reaction < sticks.reaction


@pytest.mark.parametrize("lattice", [True, False])
def test_what_slips_is_found_at_once_where_rounds_would_end(scene: PokeSetup, lattice: bool) -> None:
    """The same state as slides of held particles come to, one after another; by lists of the clusters' members too."""
    if not lattice:
        scene = dataclasses.replace(scene, clusters=clusters.Clusters(list(scene.clusters), len(scene.rest)))
    touched = scene.open[np.abs(scene.rest[scene.open, :2] - 0.06).max(axis=1) < 0.0201]
    pushed = scene.rest[touched] - [0.0, 0.0, 0.003]
    laws = [LAW, Law(0.7, 0.0, 3), Law(0.2, 1.0, 3)]
    bodies = (hold(scene, touched, LAW, "float64", "cpu", slips=slips) for slips in (True, False))
    at_once, in_rounds = (settle(scene, body, laws, touched, pushed, slips=True, start=None) for body in bodies)
    assert at_once.converged.all()
    assert in_rounds.converged.all()
    np.testing.assert_allclose(at_once.position, in_rounds.position, atol=2 * SETTLED * 0.003)
    np.testing.assert_array_equal(at_once.hold, at_once.position[:, touched])
    np.testing.assert_allclose(at_once.hold[..., 2], 0.027, atol=1e-15)
    side = {name: np.abs(one.pull[..., :2]).max() for name, one in (("once", at_once), ("rounds", in_rounds))}
    assert side["once"] < 1e-6 * np.abs(at_once.pull[..., 2]).max()
    assert side["once"] < 0.01 * side["rounds"]


def test_what_slips_is_not_stepped(scene: PokeSetup) -> None:
    touched = scene.open[np.abs(scene.rest[scene.open, :2] - 0.06).max(axis=1) < 0.0101]
    body = hold(scene, touched, LAW, "float64", "cpu", slips=True)
    with pytest.raises(ValueError, match="slipping"):
        body.start()


def test_a_force_is_reached_and_is_that_of_its_depth(scene: PokeSetup) -> None:
    tip = Tip("flat", (0.02,))
    deep = press(scene, LAW, Poke(AT, tip, force=2.0), stiffness=80.0)
    assert deep.converged
    assert 80.0 * deep.reaction == pytest.approx(2.0, rel=1e-3)
    assert press(scene, LAW, Poke(AT, tip, depth=deep.depth)).reaction == pytest.approx(deep.reaction, rel=2e-3)


def test_twice_the_stiffness_asks_for_half_the_depth_while_strain_is_small(scene: PokeSetup) -> None:
    soft, hard = (press(scene, LAW, Poke(AT, Tip("flat", (0.02,)), force=0.2), stiffness=k) for k in (100.0, 200.0))
    assert soft.depth == pytest.approx(2.0 * hard.depth, rel=0.01)


def test_a_ball_touches_more_the_deeper_it_is_pulls_at_nothing_and_overlaps_nothing(scene: PokeSetup) -> None:
    tip, counts = Tip("sphere", (0.08,)), []
    for depth in (0.0005, 0.003, 0.008):
        found = press(scene, LAW, Poke(AT, tip, depth=depth))
        assert found.converged
        pull = forces(scene, found.position, np.concatenate([scene.fixed, found.touched]))
        assert pull[found.touched, 2].max() < 1e-4 * np.abs(pull[:, 2]).max()
        away = np.linalg.norm(scene.rest[scene.open, :2] - AT[:2], axis=1)
        ball = 0.03 - depth + 0.04 - np.sqrt(np.maximum(0.04**2 - away**2, 0.0))
        under = away < 0.04
        assert (found.position[scene.open, 2] <= ball + 2e-3 * depth)[under].all()
        counts.append(len(found.touched))
    assert counts[0] == 1
    assert counts[0] < counts[1] < counts[2]


def test_a_ball_stiffens_as_it_sinks_in(scene: PokeSetup) -> None:
    shallow, deep = (press(scene, LAW, Poke(AT, Tip("sphere", (0.08,)), depth=d)).reaction for d in (0.002, 0.008))
    assert 4.0 * 1.3 < deep / shallow < 4.0**1.9


def test_a_disc_has_the_force_between_its_inner_and_its_outer_square(scene: PokeSetup) -> None:
    force = {
        name: press(scene, LAW, Poke(AT, tip, depth=0.002)).reaction
        for name, tip in {
            "inner": Tip("flat", (0.04 / np.sqrt(2),)),
            "disc": Tip("disc", (0.04,)),
            "outer": Tip("flat", (0.04,)),
        }.items()
    }
    assert force["inner"] < force["disc"] < force["outer"]


def test_a_tip_between_the_particles_touches_the_nearest(scene: PokeSetup) -> None:
    found = press(scene, LAW, Poke(AT + np.array([0.004, 0.003, 0.0]), Tip("flat", (0.001,)), depth=0.001))
    assert len(found.touched) == 1
    np.testing.assert_allclose(scene.rest[found.touched[0]], AT)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Tip("flat", ()), "tip size above 0"),
        (lambda: Tip("disc", (0.01, 0.02)), "one size"),
        (lambda: Tip("sphere", (float("nan"),)), "tip size above 0"),
        (lambda: Poke(AT, Tip("disc", (0.01,))), "depth or a force"),
        (lambda: Poke(AT, Tip("disc", (0.01,)), depth=0.1, force=1.0), "depth or a force"),
        (lambda: Poke(AT, Tip("disc", (0.01,)), depth=-0.1), "above 0"),
        (lambda: Poke(AT * np.nan, Tip("disc", (0.01,)), depth=0.1), "finite place"),
    ],
)
def test_tips_and_pokes_that_cannot_be_are_refused(make: object, said: str) -> None:
    with pytest.raises(InputError, match=said):
        make()  # type: ignore[operator]


def test_a_poke_beside_the_body_and_a_force_without_a_stiffness_are_refused(scene: PokeSetup) -> None:
    with pytest.raises(InputError, match="outside it"):
        press(scene, LAW, Poke(np.array([0.5, 0.5, 0.03]), Tip("flat", (0.02,)), depth=0.001))
    with pytest.raises(InputError, match="stiffness"):
        press(scene, LAW, Poke(AT, Tip("flat", (0.02,)), force=1.0))


def test_in_the_plane_a_tip_comes_from_the_side_it_is_reported() -> None:
    x, y = np.meshgrid(np.arange(9) * 0.01, np.arange(6) * 0.01, indexing="ij")
    rest = np.column_stack([x.ravel(), y.ravel()])
    grouped = clusters.lattice(rest, (9, 6), np.arange(54), 3)
    fixed = np.flatnonzero(rest[:, 0] <= 0.0)
    toward = np.array([-1.0, 0.0])
    scene = PokeSetup(rest, grouped, fixed, np.flatnonzero(rest[:, 0] >= 0.08 - 1e-9), toward, 0.01)
    found = press(scene, Law(0.5, 0.0, 3), Poke(np.array([0.08, 0.025]), Tip("flat", (0.03,)), depth=0.004))
    assert len(found.touched) == 4
    np.testing.assert_allclose(found.position[found.touched, 0], 0.076, atol=1e-12)
    assert found.reaction > 0.0
