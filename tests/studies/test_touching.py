"""What is recorded of an approach: where it stops, what it reads, and that it is the world's own force and depth."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.scenes import built_in
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld
from studies.touching import Approach, Sensing, approach

BALL = RigidTip(radius=0.01)
AT = np.array([0.3, 0.2])
QUIET = Sensing(position_sd_m=0.0, force_sd_n=0.0)


@pytest.fixture(scope="module")
def soft() -> SlabWorld:
    return SlabWorld(built_in("homogeneous-60"))


@pytest.fixture(scope="module")
def rigid() -> SlabWorld:
    return SlabWorld(built_in("homogeneous-rigid"))


def touch(world: SlabWorld, sensing: Sensing = QUIET, seed: int = 0, **options: float) -> Approach:
    return approach(world, BALL, AT, sensing=sensing, random=np.random.default_rng(seed), **options)


def test_it_stops_at_the_force(soft: SlabWorld) -> None:
    found = touch(soft)
    assert found.reached
    assert found.level_n == 3.0
    assert found.true_force_n[-1] == pytest.approx(3.0, rel=1e-6)
    assert found.true_force_n.max() <= 3.0 + 1e-9
    np.testing.assert_allclose(found.force_n, found.true_force_n[:, None] * [0, 0, 1])


def test_every_sample_is_what_the_world_says(soft: SlabWorld) -> None:
    """The curve between the depths that are solved is good to 0.5 %."""
    found = touch(soft)
    for at in range(60, len(found.time_s), 7):
        known = soft.press(BALL, found.position_m[at])
        assert found.true_force_n[at] == pytest.approx(known.normal_force_n, rel=5e-3)
        assert found.true_depth_m[at] == pytest.approx(known.depth_m, abs=1e-9)


def test_it_comes_at_its_pace_from_above(soft: SlabWorld) -> None:
    found = touch(soft)
    np.testing.assert_allclose(np.diff(found.time_s)[:-1], 0.01)
    assert 0.0 < np.diff(found.time_s)[-1] <= 0.01 + 1e-9
    np.testing.assert_allclose(np.diff(found.position_m[:, 2])[:-1], -1e-4)
    assert found.position_m[0, 2] == pytest.approx(0.05 + 0.01 + 0.005)
    assert not found.true_force_n[found.true_depth_m < 0.0].any()
    slow = touch(soft, Sensing(speed_m_s=0.005, position_sd_m=0.0, force_sd_n=0.0))
    assert slow.time_s[-1] == pytest.approx(2.0 * found.time_s[-1])


def test_noise_is_as_reported(soft: SlabWorld) -> None:
    clean = touch(soft, dwell_s=5.0)
    noisy = touch(soft, Sensing(), dwell_s=5.0)
    assert (noisy.position_m - clean.position_m).std(axis=0) == pytest.approx([1e-4] * 3, rel=0.12)
    assert (noisy.force_n - clean.force_n).std(axis=0) == pytest.approx([0.02] * 3, rel=0.12)
    assert np.ptp(noisy.true_depth_m[-500:]) == 0.0


def test_a_shallow_dent_is_pressed_harder(rigid: SlabWorld) -> None:
    found = touch(rigid)
    assert found.level_n == 5.0
    assert found.true_force_n[-1] == pytest.approx(5.0, rel=1e-6)
    assert found.true_depth_m[-1] < 0.0003
    assert touch(rigid, shallow_m=0.0).level_n == 3.0


def test_a_deep_dent_ends_at_the_depth(soft: SlabWorld) -> None:
    found = touch(soft, max_depth_m=0.004)
    assert not found.reached
    assert found.true_depth_m[-1] == pytest.approx(0.004)
    assert found.true_force_n[-1] < 3.0


def test_an_arm_that_gives_seems_to_go_deeper(soft: SlabWorld, rigid: SlabWorld) -> None:
    for world in (soft, rigid):
        stiff, weak = touch(world), touch(world, Sensing(position_sd_m=0.0, force_sd_n=0.0, arm_n_per_m=5000.0))
        assert weak.true_depth_m[-1] == pytest.approx(stiff.true_depth_m[-1], rel=1e-3, abs=3e-6)
        deeper = stiff.position_m[-1, 2] - weak.position_m[-1, 2]
        assert deeper == pytest.approx(weak.true_force_n[-1] / 5000.0, abs=3e-6)


def test_on_a_slope_it_comes_along_the_normal() -> None:
    world = SlabWorld(built_in("bumpy", 2))
    found = touch(world)
    normal = world.scene.normal(AT)
    way = found.position_m[0] - found.position_m[-1]
    np.testing.assert_allclose(way / np.linalg.norm(way), normal, atol=1e-9)
    np.testing.assert_allclose(found.force_n[-1], 3.0 * normal, rtol=1e-5)


def test_a_seed_repeats(soft: SlabWorld) -> None:
    one, two, other = (touch(soft, Sensing(), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.position_m, two.position_m)
    np.testing.assert_array_equal(one.force_n, two.force_n)
    assert (one.force_n != other.force_n).all()


def test_forces_that_make_no_sense_are_refused(soft: SlabWorld) -> None:
    with pytest.raises(InputError, match="forces above 0"):
        touch(soft, set_force_n=6.0)
