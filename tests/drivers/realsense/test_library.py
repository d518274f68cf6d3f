"""The driver on librealsense itself, over a camera made of software; skipped where pyrealsense2 is not installed."""

import importlib.util
import itertools

import numpy as np
import pytest

from deformscope_drivers.depth_camera import Realsense, RealsenseConfig
from deformscope_drivers.errors import NotConnected, SettingsRefused

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("pyrealsense2") is None, reason="pip install deformscope[realsense]"
)
LIBRARY = "tests.drivers.realsense.software_camera"
PATIENCE_S = 60.0
SMALL = {"width": 64, "height": 48, "fps": 30, "warm_up_s": 0.1}


def test_pictures_of_the_librarys_own_pipeline() -> None:
    """Each with its number as depth; one number is missing, and the clock begins anew."""
    with Realsense(RealsenseConfig(**SMALL), library=LIBRARY) as camera:
        pictures = camera.readings()
        seen = [pictures.get(PATIENCE_S) for _ in range(75)]
        health = camera.health()
    assert camera.identity().serial == "42"
    assert (camera.intrinsics.fx_px, camera.intrinsics.cy_px) == (60.0, 23.0)
    assert {picture.unit_m for picture in seen} == {0.001}
    numbers = [int(picture.depth[0, 0]) - 1000 for picture in seen]
    assert set(np.diff(numbers)) == {1, 2}
    assert health.lost == 1
    steps = [b.stamp.device_ticks - a.stamp.device_ticks for a, b in itertools.pairwise(seen)]
    assert all(abs(step - 1e6 / 30 * count) < 2 for step, count in zip(steps, np.diff(numbers), strict=True))


@pytest.mark.parametrize(
    ("keys", "kind", "words"),
    [
        ({"fps": 60}, SettingsRefused, "64x48 at 60 Hz; got a camera on USB (unknown) without it | try: one of 64x48"),
        ({"preset": "hand"}, SettingsRefused, "preset hand; got object doesn't support option Visual Preset"),
        ({"unit_m": 0.0001}, SettingsRefused, "steps of 0.0001 m; got This option is read-only!"),
        ({"serial": "43"}, NotConnected, "RealSense camera 43; got 42"),
    ],
)
def test_what_the_library_refuses_is_said_in_our_words(keys: dict, kind: type[Exception], words: str) -> None:
    with pytest.raises(kind) as caught:
        Realsense(RealsenseConfig(**(SMALL | keys)), library=LIBRARY).open()
    assert words in str(caught.value)
