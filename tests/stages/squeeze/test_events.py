"""First contact and steady state from sampled signals of which the truth is known."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.squeeze.events import EventRule, SqueezeEvents, squeeze_events
from tests.cases import slow_but

RULE = EventRule()
START_S = 10.0


def squeezed(
    seed: int, *, dropped: float = 0.0, noise_counts: float = 4.0
) -> tuple[SqueezeEvents, float, float, float, float]:
    """Events of a finger that closes at 6 deg/s, touches, and comes to rest; true times and both periods [s]."""
    random = np.random.default_rng(seed)
    touch_s, rest_s = START_S + random.uniform(1.0, 2.0), random.uniform(0.2, 0.8)
    tactile_s = START_S + np.arange(0.0, 5.0, 1 / 25.0) + random.uniform(0.0, 0.04)
    hand_s = START_S + np.arange(0.0, 5.0, 1 / 50.0) + random.uniform(0.0, 0.02)
    tactile_s = tactile_s[(random.random(len(tactile_s)) >= dropped) | (tactile_s < START_S + 0.5)]
    hand_s = hand_s[random.random(len(hand_s)) >= dropped]
    counts = 2000.0 * np.clip((tactile_s - touch_s) / rest_s, 0.0, 1.0)
    sums = np.stack([counts + random.normal(0.0, noise_counts, len(tactile_s)), 0.0 * counts], axis=1)
    angle = 6.0 * np.minimum(hand_s, touch_s + rest_s)
    found = squeeze_events(
        np.rint(1e9 * tactile_s).astype(np.int64),
        sums,
        np.rint(1e9 * hand_s).astype(np.int64),
        np.stack([angle, angle], axis=1),
        RULE,
    )
    return found, touch_s, touch_s + rest_s, 1 / 25.0, 1 / 50.0


@pytest.mark.parametrize("dropped", slow_but([0.1], [0.0, 0.1]))
def test_they_are_within_two_sample_periods_in_95_percent(dropped: float) -> None:
    right = []
    for seed in range(200):
        found, first_s, steady_s, tactile_s, hand_s = squeezed(seed, dropped=dropped)
        first = abs(found.first_ns / 1e9 - first_s) <= 2 * tactile_s
        right.append(first and abs(found.steady_ns / 1e9 - steady_s) <= 2 * max(tactile_s, hand_s))
    assert np.mean(right) >= 0.95


def test_their_intervals_hold_the_truth() -> None:
    for seed in range(50):
        found, first_s, steady_s, _, hand_s = squeezed(seed)
        low, high = (when / 1e9 for when in found.first_interval_ns)
        assert low <= first_s <= high
        low, high = (when / 1e9 for when in found.steady_interval_ns)
        assert low - hand_s <= steady_s <= high


def test_noise_alone_is_no_contact() -> None:
    when = np.arange(0, 200) * 40_000_000
    random = np.random.default_rng(0)
    angles = np.zeros((len(when), 2))
    found = squeeze_events(when, random.normal(0.0, 15.0, (len(when), 2)), when, angles, RULE)
    assert (found.first_ns, found.steady_ns) == (0, 0)


def test_a_single_frame_is_no_contact_and_a_finger_that_goes_on_is_not_steady() -> None:
    when = np.arange(1, 101) * 40_000_000
    sums = np.zeros((100, 2))
    sums[50, 0] = 500.0
    moving = np.stack([0.24 * np.arange(100.0)] * 2, axis=1)
    assert squeeze_events(when, sums, when, moving, RULE).first_ns == 0
    sums[60:] = 500.0
    found = squeeze_events(when, sums, when, moving, RULE)
    assert found.first_ns == (when[59] + when[60]) // 2
    assert found.steady_ns == 0


def test_the_rule_can_be_tuned() -> None:
    when = np.arange(1, 101) * 40_000_000
    sums = np.repeat(np.arange(100.0)[:, None] * 2.0, 2, axis=1)
    sums[:20] = 0.0
    still = np.zeros((100, 2))
    assert squeeze_events(when, sums, when, still, EventRule(onset_counts=100.0)).first_ns == (when[50] + when[51]) // 2
    assert squeeze_events(when, sums, when, still, EventRule(onset_counts=60.0)).first_ns == (when[30] + when[31]) // 2


def test_axes_that_close_within_the_tolerance_are_not_still_yet() -> None:
    when = np.arange(1, 101) * 20_000_000
    sums = np.full((100, 2), 500.0)
    sums[:10] = 0.0
    closing = np.stack([0.12 * np.minimum(np.arange(100.0), 60.0)] * 2, axis=1)  # a reading within 0.15 deg of the next
    assert squeeze_events(when, sums, when, closing, RULE).steady_ns == when[60]


def test_a_run_of_lost_frames_widens_the_interval_around_the_middle_of_the_gap() -> None:
    when = np.delete(np.arange(1, 101) * 40_000_000, np.arange(50, 55))
    sums = np.where(when[:, None] > 51 * 40_000_000, 500.0, 0.0) * [1.0, 1.0]
    found = squeeze_events(when, sums, when, np.zeros((len(when), 2)), RULE)
    assert found.first_ns == (when[49] + when[50]) // 2
    assert found.first_interval_ns == (when[49], when[50])


def test_too_little_is_refused() -> None:
    few = np.arange(2) * 40_000_000
    with pytest.raises(InputError, match="more than 6 frames"):
        squeeze_events(few, np.zeros((2, 2)), few, np.zeros((2, 2)), RULE)
