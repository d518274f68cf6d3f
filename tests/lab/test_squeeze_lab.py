"""Squeezes through the real drivers, over the doubles."""

import pickle

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.frames import DepthFrame, HandFrame, TactileFrame
from deformscope.lab.container_constants import PA_PER_COUNT
from deformscope.lab.live_squeeze_lab import (
    CLOSED_DEG,
    CLOSING_AXES,
    OPEN_DEG,
    ContainerCase,
    ContainerTruth,
    SqueezeLab,
)

PERIOD_NS = 100_000_000
MOVING, BLOCKED = "positioning", "cw_blocked"


def squeezed(lab: SqueezeLab, periods: int = 25) -> tuple[list[object], ContainerTruth]:
    """All that the devices gave of a squeeze of so many tenths of a second, and what was true in the end."""
    items: list[object] = []
    with lab.source() as source:
        lab.hand.set_current_limits(0.3)
        lab.hand.move(dict.fromkeys(CLOSING_AXES, CLOSED_DEG), velocity_deg_s=12.0, wait=False)
        for _ in range(periods):
            lab.wait_until(lab.clock() + PERIOD_NS)
            items += source.take(0.0)
        truth = lab.truth()
        lab.hand.stop()
    return items, truth


@pytest.fixture(scope="module")
def rice() -> tuple[SqueezeLab, list[object], ContainerTruth]:
    lab = SqueezeLab(ContainerCase("rice", "box-07", seed=3), camera_hz=5.0)
    return lab, *squeezed(lab)


def test_the_hand_closes_until_the_container_holds_it(rice: tuple[SqueezeLab, list[object], ContainerTruth]) -> None:
    _, items, truth = rice
    hand = [item for item in items if isinstance(item, HandFrame)]
    last = hand[-1]
    assert last.state[1] == last.state[5] == BLOCKED
    assert OPEN_DEG[1] + 5.0 < last.position_deg[1] < CLOSED_DEG - 3.0
    assert truth.contact_ns < truth.steady_ns < hand[-1].stamp.host_ns
    moving = [one for one in hand if one.stamp.host_ns < truth.contact_ns]
    assert all(one.state[1] == MOVING for one in moving[10:])
    still = [one.position_deg[1] for one in hand if one.stamp.host_ns >= truth.steady_ns]
    assert np.ptp(still) < 0.1
    assert truth.force_n == pytest.approx([4.5, 4.5], abs=1.0)
    assert (truth.dent_m > 0.001).all()


def test_pads_feel_what_the_fingers_press(rice: tuple[SqueezeLab, list[object], ContainerTruth]) -> None:
    _, items, truth = rice
    tactile = [item for item in items if isinstance(item, TactileFrame)]
    for matrix, force_n in ((1, truth.force_n[0]), (5, truth.force_n[1])):
        felt_n = tactile[-1].pressure_pa[matrix].sum() * 0.0034**2
        assert felt_n == pytest.approx(force_n, rel=0.15)  # gains differ from texel to texel
    assert tactile[-1].counts.max() < 4095
    for matrix in (0, 2, 3, 4):
        assert tactile[-1].pressure_pa[matrix].sum() < 100 * PA_PER_COUNT
    touched = next(one for one in tactile if one.counts.sum() > 100)
    period_ns = np.diff([one.stamp.host_ns for one in tactile]).max()
    assert truth.contact_ns is not None
    assert 0 <= touched.stamp.host_ns - truth.contact_ns <= 2 * period_ns


def test_the_camera_sees_the_dent(rice: tuple[SqueezeLab, list[object], ContainerTruth]) -> None:
    lab, items, truth = rice
    images = [item for item in items if isinstance(item, DepthFrame)]
    assert images[0].depth.shape == (480, 640)
    exact = lab.view.render(truth.inward_m, truth.T_hand_container, np.array(OPEN_DEG))
    known = (exact.seen == 4) & np.isfinite(exact.depth_m)
    measured = images[-1].depth[known] > 0
    finite = images[-1].depth[known][measured] * images[-1].unit_m - exact.depth_m[known][measured]
    assert 0.9 < len(finite) / known.sum() < 1.0  # some are missing
    assert abs(np.median(finite)) < 3e-4
    behind = np.abs(finite) < 0.01
    assert finite[behind].std() == pytest.approx(1.4e-3, rel=0.35)  # Kinect's noise at 1 m


def test_the_same_seed_gives_the_same_bytes_and_another_one_others() -> None:
    runs = [
        squeezed(SqueezeLab(ContainerCase("yogurt", "box-02", seed=seed), camera_hz=2.0), 18)[0] for seed in (5, 5, 6)
    ]
    same, again, other = ([pickle.dumps(item) for item in run] for run in runs)
    assert same == again
    assert same != other


def test_contents_that_are_made_alike_cannot_be_told_apart() -> None:
    runs = [
        squeezed(SqueezeLab(ContainerCase(c, "box-02", seed=5, alike=True), camera_hz=2.0), 18)[0]
        for c in ("empty", "rice")
    ]
    first, second = ([pickle.dumps(item) for item in run] for run in runs)
    assert first == second


@pytest.mark.parametrize(("content", "container"), [("sand", "box-01"), ("rice", "bag-01")])
def test_unknown_contents_and_containers_are_refused(content: str, container: str) -> None:
    with pytest.raises(InputError):
        SqueezeLab(ContainerCase(content, container))
