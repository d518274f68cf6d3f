"""What is shown of a body in space: all of a volume, the surroundings of a poke on a large surface."""

import numpy as np
import pytest

from deformscope.pictures.close_up import close_up
from deformscope.stages.fit.estimate import Comparison
from tests.log import synthetic


def poked(depth: float = 0.002, at: tuple[float, float] = (0.2, 0.15)) -> Comparison:
    """A slab's top of 60 x 40 cm, pressed down over some centimetres."""
    axes = np.meshgrid(np.linspace(0, 0.6, 61), np.linspace(0, 0.4, 41), indexing="ij")
    flat = np.stack(axes, axis=-1).reshape(-1, 2)
    rest = np.column_stack([flat, np.full(len(flat), 0.05)])
    dent = depth * np.exp(-np.sum(((flat - at) / 0.02) ** 2, axis=1))
    down = np.array([0.0, 0.0, -1.0])
    return Comparison(
        rest,
        rest + dent[:, None] * down,
        rest + 0.9 * dent[:, None] * down,
        np.ones(len(rest), dtype=bool),
        np.flatnonzero(dent > 0.95 * depth) if depth else np.array([0]),
        "m",
    )


def test_a_volume_is_shown_whole() -> None:
    shown = close_up(synthetic.pair_in_space())
    assert not shown.surface
    assert shown.heights == 1.0
    np.testing.assert_allclose(shown.low[:2], 0.0)
    np.testing.assert_allclose(shown.high[:2], 0.1)


@pytest.mark.parametrize("depth", [0.0002, 0.002, 0.008])
def test_a_poke_is_shown_close_and_drawn_out(depth: float) -> None:
    shown = close_up(poked(depth))
    assert shown.surface
    np.testing.assert_allclose(shown.middle[:2], [0.2, 0.15], atol=1e-6)
    side = float((shown.high - shown.low)[:2].max())
    assert 0.08 <= side < 0.15
    fills = shown.heights * depth / side
    assert 0.1 < fills <= 0.25
    assert shown.heights / 10.0 ** np.floor(np.log10(shown.heights)) in (1.0, 2.0, 5.0)
    inside = poked(depth).rest[shown.holds(poked(depth).rest)]
    assert len(inside) == len(np.unique(inside[:, 0])) * len(np.unique(inside[:, 1])) < 300


def test_a_poke_at_the_rim_stays_on_the_surface() -> None:
    shown = close_up(poked(at=(0.0, 0.2)))
    assert shown.low[0] == 0.0
    assert shown.high[0] < 0.1


def test_nothing_moved() -> None:
    still = close_up(poked(0.0))
    assert still.heights == 1.0
    np.testing.assert_allclose(still.high - still.low, [0.6, 0.4, 0.0], atol=1e-12)


def test_deep_dents_are_not_drawn_out() -> None:
    assert close_up(poked(0.05)).heights == 1.0
