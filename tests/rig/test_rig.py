"""Rig files: what is read, and what is refused in words that help."""

import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.frames import DepthFrame
from deformscope.lab.rig_members import members_of
from deformscope.rig.rig_file import load_rig, parse_rig, scenario_names
from deformscope.rig.source import RigSource
from tests.patience import PATIENCE_S

TIP = '[devices.tip]\ndriver = "optoforce"\nport = "/dev/ttyACM0"\n'


def refused(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_rig(text, "rig.toml")
    assert str(caught.value).endswith("rig.toml")
    return str(caught.value)


def test_a_device_is_its_drivers_configuration() -> None:
    rig = parse_rig(
        TIP + "rate_hz = 333\nsensitivity = { counts_at_nominal = [10.0, 10, 10], nominal = [1, 1, 1] }", "a/bench.toml"
    )
    (tip,) = rig.devices
    assert rig.name == "bench"
    assert (tip.name, tip.driver.name, tip.double) == ("tip", "optoforce", False)
    assert tip.config.port == "/dev/ttyACM0"
    assert tip.config.rate_hz == 333
    assert tip.config.sensitivities[0].counts_at_nominal == (10.0, 10.0, 10.0)


def test_a_misspelt_key_is_an_error_that_names_the_right_one() -> None:
    assert refused(TIP + "rate_hx = 5") == (
        "expected known keys in [devices.tip]; got 'rate_hx' | try: rate_hz | rig.toml"
    )
    assert "try: workspace" in refused(TIP + "[workspce]\ntarget_force_n = 1.0")
    assert "try: hard_stop_n" in refused(TIP + "[workspace]\nhard_stop = 1.0")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "at least one [devices.NAME] section; got none"),
        ("[devices]", "at least one [devices.NAME] section"),
        ("[devices.a]\nport = 'x'", "driver out of arm, depth_camera, dsa, image_folder"),
        ("[devices.a]\ndriver = 'optofarce'", "got 'optofarce' | try: driver = \"optoforce\" | "),
        ("[devices.a]\ndriver = 'franka'", "got 'franka' | try: pip install its package, or deformscope new-device"),
        ('[devices."a b"]\ndriver = "dsa"', "a device's name of letters, digits, - and _, 64 at most; got 'a b'"),
        (TIP + 'double = "yes"', "double = true or false; got 'yes'"),
        (TIP + 'rate_hz = "fast"', "rate_hz: expected"),
        (TIP + "rate_hz = 500", "500"),
        (TIP + "[workspace]\ntarget_force_n = 9.0", "target_force_n < soft_stop_n < hard_stop_n"),
        (TIP + "[workspace]\nhard_stop_n = 500.0", "hard_stop_n up to 50"),
        (TIP + "[workspace]\nlow_m = [0, 0, 0]", "both low_m and high_m"),
        (TIP + "[workspace]\nlow_m = [0, 0, 0]\nhigh_m = [1, 1, -1]", "low_m below high_m"),
        (TIP + "[workspace]\ntarget_force_n = nan", "target_force_n"),
        (TIP + "[tool]\ntip = 'knife'", "tip = "),
        (TIP + "[tool]\ncompliance_m_per_n = 0.2", "compliance_m_per_n between 0 and 0.01"),
        (TIP + "[surface]\nsize_m = [0.6]", "size_m"),
        (TIP + "[surface]\nsize_m = [0.6, 40]", "size_m between 0.05 and 2"),
        (TIP + "[surface]\nthickness_m = 50", "thickness_m between"),
        (TIP + "[surface]\nT_arm_surface = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]", "4 rows of 4"),
        (TIP + "[workspace]\nforce_silent_s = 3", "force_silent_s between 0.01 and 0.5"),
        (TIP + "[touch]\ntangential = 'loose'", "[touch] with valid keys; got tangential: invalid enum value 'loose'"),
        (TIP + "[camera]\ndevice = 'top'", "[camera] device out of tip; got 'top'"),
        (TIP + "[camera]\nT_arm_camera = [[1,0,0,0],[0,1,0,0],[0,0,1,0]]", "4 rows of 4"),
        (TIP + "[camera]\nT_arm_camera = [[1,0,0,0],[0,1,0,0],[0,0,2,0],[0,0,0,1]]", "whose rotation is one"),
        (TIP + "[camera]\nT_arm_camera = [[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]", "no mirror image"),
        (TIP + "[camera]\nT_arm_camera = [[1,0,0,500],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "in metres"),
        ('[devices.a]\ndriver = "video_file"\ndouble = true', "video_file needs none"),
        ("devices = 3", "at least one"),
        ("[devices.a", "a rig file in TOML"),
    ],
)
def test_what_is_wrong_is_said(text: str, words: str) -> None:
    assert words in refused(text)


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no such file.*rig new"):
        load_rig(tmp_path / "none.toml")
    with pytest.raises(InputError, match="lab:bench"):
        load_rig("lab:beach")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="without text"):
        load_rig(tmp_path / "binary.toml")


def test_every_simulated_rig_is_one() -> None:
    assert "bench" in scenario_names()
    for name in scenario_names():
        rig = load_rig(f"lab:{name}")
        assert rig.name == f"lab:{name}"
        assert all(device.double for device in rig.devices)


def test_the_example_is_a_rig() -> None:
    text = (resources.files("deformscope") / "lab" / "rig-example.toml").read_text(encoding="utf-8")
    rig = parse_rig(text, "example")
    assert {device.driver.name for device in rig.devices} == {
        "optoforce",
        "dsa",
        "sdh",
        "jaco",
        "webcam",
        "depth_camera",
    }
    assert rig.workspace.low_m == (-0.4, -0.66, 0.0)


def test_a_file_stands_in_for_a_camera(tmp_path: Path) -> None:
    (device,) = parse_rig('[devices.cam]\ndriver = "image_folder"\npath = "frames"\nfps = 5', "r").devices
    assert device.driver.make(device.config).path == Path("frames")


@pytest.mark.slow
def test_in_the_rig_of_containers_the_camera_sees_the_box_between_the_fingers() -> None:
    with members_of(load_rig("lab:containers")) as members, RigSource(members, raw=False) as source:
        assert [(one.name, one.simulated) for one in members] == [
            *(("hand", True), ("pads", True), ("depth", True), ("camera", True))
        ]
        until = time.monotonic() + PATIENCE_S
        seen: list[DepthFrame] = []
        while not seen and time.monotonic() < until:
            seen += [item for item in source.take(0.1) if isinstance(item, DepthFrame)]
    depth_m = seen[0].depth * seen[0].unit_m
    assert depth_m[(depth_m > 0.0) & (depth_m < 0.9 * np.median(depth_m[depth_m > 0.0]))].size > 1000
