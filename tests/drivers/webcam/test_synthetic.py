"""A colour camera on a program's scene."""

import numpy as np
import pytest

from deformscope_drivers.device import Reconnect
from deformscope_drivers.memory import SimulatedClock
from deformscope_drivers.webcam import SyntheticCamera, SyntheticCameraConfig
from tests.drivers.contract import Bench, DeviceContract

QUICK = Reconnect(0.01, 0.1)


def scene(time_s: float) -> np.ndarray:
    return np.full((6, 8, 3), round(time_s * 100) % 256, np.uint8)


class TestSyntheticCamera(DeviceContract):
    @pytest.fixture
    def bench(self) -> Bench:
        camera = SyntheticCamera(scene, SyntheticCameraConfig(rate_hz=200.0), reconnect=QUICK)
        return Bench(camera, camera.unplug, camera.plug, camera.stop, camera.resume)


def test_a_scene_is_seen_at_its_times() -> None:
    clock = SimulatedClock(5_000_000)
    camera = SyntheticCamera(scene, SyntheticCameraConfig(rate_hz=100.0), clock=clock).open(own_thread=False)
    images = [image for _ in range(10) for image in camera.poll(0.01)]
    camera.close()
    assert [int(image.image[0, 0, 0]) for image in images[:5]] == [0, 1, 2, 3, 4]
    assert [image.stamp.device_ticks for image in images[:3]] == [0, 10_000, 20_000]
    assert [image.stamp.host_ns for image in images[:3]] == [5_000_000, 15_000_000, 25_000_000]


def test_noise_is_the_same_under_the_same_seed() -> None:
    def pictures(seed: int) -> np.ndarray:
        config = SyntheticCameraConfig(noise=3.0, seed=seed)
        camera = SyntheticCamera(lambda _: np.full((60, 80, 3), 128, np.uint8), config, clock=SimulatedClock())
        camera.open(own_thread=False)
        images = [image.image for _ in range(4) for image in camera.poll(0.05)]
        camera.close()
        return np.stack(images)

    first = pictures(1)
    np.testing.assert_array_equal(first, pictures(1))
    assert (first != pictures(2)).any()
    assert first.std() == pytest.approx(3.0, rel=0.05)
