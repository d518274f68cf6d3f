"""A depth camera on a program's scene: what it adds to a view, its faults, real and simulated time."""

import numpy as np
import pytest

from deformscope_drivers.depth_camera import DepthImage, Intrinsics, SyntheticDepthCamera, SyntheticDepthConfig, View
from deformscope_drivers.device import Reconnect
from deformscope_drivers.errors import LinkLost, Stale
from deformscope_drivers.health import Link
from deformscope_drivers.memory import SimulatedClock
from tests.drivers.contract import Bench, DeviceContract, wait_until

QUICK = Reconnect(0.01, 0.1)
EXACT = SyntheticDepthConfig(noise_per_m=0.0)
PERIOD_NS = 33_333_333


def flat(depth_m: float, shape: tuple[int, int] = (6, 8)) -> View:
    return View(np.full(shape, depth_m), np.zeros((*shape, 3), np.uint8))


def seen(camera: SyntheticDepthCamera, view: View) -> DepthImage:
    """What a camera on a simulated clock makes of one view."""
    camera.open(own_thread=False)
    camera.push(view)
    (picture,) = camera.poll()
    camera.close()
    return picture


def on_simulated_clock(config: SyntheticDepthConfig, scene=None) -> SyntheticDepthCamera:
    return SyntheticDepthCamera(scene, config, clock=SimulatedClock(), reconnect=None)


class TestSyntheticDepthCamera(DeviceContract):
    @pytest.fixture
    def bench(self) -> Bench:
        config = SyntheticDepthConfig(rate_hz=200.0)
        camera = SyntheticDepthCamera(lambda time_s: flat(1.0 + 0.1 * time_s), config, reconnect=QUICK)
        return Bench(camera, camera.unplug, camera.plug, camera.stop, camera.resume)


class TestPushed(DeviceContract):
    """Filled by a program at its own pace, here as fast as pictures are taken."""

    @pytest.fixture
    def bench(self):
        import threading

        camera = SyntheticDepthCamera(config=EXACT, reconnect=QUICK)
        done = threading.Event()
        paused = threading.Event()

        def fill() -> None:
            while not done.wait(0.004):
                if not paused.is_set():
                    camera.push(flat(1.0))

        filler = threading.Thread(target=fill)
        filler.start()
        yield Bench(camera, camera.unplug, camera.plug, paused.set, paused.clear)
        done.set()
        filler.join()


def test_depth_comes_in_steps_of_its_unit() -> None:
    depth_m = np.array([[0.5004, 0.5006, 1.23456, 10.0]])
    picture = seen(on_simulated_clock(EXACT), View(depth_m))
    assert picture.depth.tolist() == [[500, 501, 1235, 10000]]
    assert picture.unit_m == 0.001
    assert picture.color is None
    fine = seen(on_simulated_clock(SyntheticDepthConfig(unit_m=1e-4, noise_per_m=0.0, far_m=5.0)), View(depth_m))
    assert fine.depth.tolist() == [[5004, 5006, 12346, 0]]


def test_what_cannot_be_measured_is_nothing() -> None:
    config = SyntheticDepthConfig(noise_per_m=0.0, near_m=0.4, far_m=3.0)
    picture = seen(on_simulated_clock(config), View(np.array([[np.nan, 0.0, -1.0, np.inf, 0.3, 3.5, 1.0]])))
    assert picture.depth.tolist() == [[0, 0, 0, 0, 0, 0, 1000]]
    np.testing.assert_array_equal(np.isnan(picture.depth_m()), [[True] * 6 + [False]])
    assert picture.depth_m()[0, 6] == pytest.approx(1.0)


@pytest.mark.parametrize("depth_m", [1.0, 2.0, 4.0])
def test_noise_grows_with_the_square_of_depth(depth_m: float) -> None:
    picture = seen(on_simulated_clock(SyntheticDepthConfig(unit_m=1e-4)), flat(depth_m, (200, 200)))
    error_m = picture.depth_m() - depth_m
    assert error_m.std() == pytest.approx(1.425e-3 * depth_m**2, rel=0.02)
    assert abs(error_m.mean()) < 4 * 1.425e-3 * depth_m**2 / 200


def test_a_share_of_the_pixels_is_missing() -> None:
    picture = seen(on_simulated_clock(SyntheticDepthConfig(missing=0.1)), flat(1.0, (200, 200)))
    assert (picture.depth == 0).mean() == pytest.approx(0.1, abs=0.01)


def test_a_run_is_the_same_under_the_same_seed() -> None:
    def run(seed: int) -> list[tuple[int, bytes]]:
        config = SyntheticDepthConfig(seed=seed, missing=0.1)
        camera = on_simulated_clock(config, lambda time_s: flat(1.0 + time_s)).open(own_thread=False)
        pictures = [picture for _ in range(50) for picture in camera.poll(0.02)]
        camera.close()
        return [(picture.stamp.host_ns, picture.depth.tobytes()) for picture in pictures]

    first = run(5)
    assert first == run(5)
    assert [data for _, data in first] != [data for _, data in run(6)]
    assert [at for at, _ in first[:3]] == [0, PERIOD_NS, 2 * PERIOD_NS]


def test_pictures_have_the_cameras_time_and_its_projection() -> None:
    intrinsics = Intrinsics.from_field_of_view(8, 6, 1.0, 0.8)
    config = SyntheticDepthConfig(rate_hz=100.0, intrinsics=intrinsics)
    camera = on_simulated_clock(config, lambda time_s: flat(1.0 + time_s)).open(own_thread=False)
    pictures = [camera.next(1.0) for _ in range(3)]
    camera.close()
    assert [picture.stamp.device_ticks for picture in pictures] == [0, 10_000, 20_000]
    assert pictures[0].intrinsics == intrinsics
    assert [round(float(np.nanmean(picture.depth_m())), 2) for picture in pictures] == [1.0, 1.01, 1.02]


def test_nobody_fetches_for_long_and_the_oldest_are_lost() -> None:
    camera = on_simulated_clock(EXACT, lambda time_s: flat(1.0 + time_s)).open(own_thread=False)
    camera.poll()
    camera._clock.advance_to(10 * PERIOD_NS)
    assert [picture.stamp.device_ticks // 33_333 for picture in camera.poll()] == [7, 8, 9, 10]
    assert camera.health().lost == 6
    camera.close()


def test_dropped_pictures_are_counted() -> None:
    camera = on_simulated_clock(EXACT, lambda time_s: flat(1.0 + time_s)).open(own_thread=False)
    ticks = [camera.next(1.0).stamp.device_ticks]
    camera.drop(3)
    ticks.append(camera.next(1.0).stamp.device_ticks)
    camera.close()
    assert ticks[1] - ticks[0] == pytest.approx(4 * 33_333, abs=3)
    assert camera.health().lost == 3


def test_a_frozen_picture_is_reported_in_simulated_time() -> None:
    config = SyntheticDepthConfig(stuck_after_s=0.5)
    camera = on_simulated_clock(config, lambda time_s: flat(1.0)).open(own_thread=False)
    for _ in range(60):
        camera.next(1.0)
    assert not camera.health().stuck  # noise alone makes pictures differ
    camera.freeze()
    for _ in range(60):
        camera.next(1.0)
    assert camera.health().stuck
    with pytest.raises(Stale, match="readings that change"):
        camera.latest(1.0)
    camera.freeze(False)
    camera.next(1.0)
    assert not camera.health().stuck
    camera.close()


def test_a_camera_that_stops_is_lost_where_it_should_send() -> None:
    config = SyntheticDepthConfig(rate_hz=200.0, silence_s=0.1)
    with SyntheticDepthCamera(lambda time_s: flat(1.0 + time_s), config, reconnect=QUICK) as camera:
        camera.next(5.0)
        camera.stop()
        wait_until(lambda: camera.link is Link.LOST)
        assert "expected a picture; got none for" in camera.health().reason
        camera.resume()
        camera.next(5.0)


def test_unplugged_in_simulated_time() -> None:
    camera = on_simulated_clock(EXACT, lambda time_s: flat(1.0)).open(own_thread=False)
    camera.next(1.0)
    camera.unplug()
    with pytest.raises(LinkLost, match="unplugged"):
        camera.next(1.0)
    camera.close()


def test_more_views_than_are_taken_are_lost_and_counted() -> None:
    camera = on_simulated_clock(EXACT).open(own_thread=False)
    for index in range(70):
        camera.push(flat(1.0 + index / 100))
    pictures = camera.poll()
    camera.close()
    assert [int(picture.depth[0, 0]) for picture in pictures] == [1000 + 10 * index for index in range(6, 70)]
    assert camera.health().lost == 6
