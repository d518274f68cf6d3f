"""A double stands in for a device wherever the rig file says that the device is, without hardware and kernel's CAN."""

import os
import re
from importlib import resources
from pathlib import Path

import pytest

from deformscope.lab.double_device import double_device
from deformscope.lab.rig_members import member_of
from deformscope.rig.rig_file import parse_rig
from deformscope_drivers.interface import DRIVERS
from tests.cases import slow_but
from tests.patience import PATIENCE_S

ONE = "{ counts_at_nominal = [NUMBERS], nominal = [NUMBERS] }"
THREE, SIX = (ONE.replace("NUMBERS", ", ".join(["1.0"] * count)) for count in (3, 6))
WAYS = {
    "optoforce": [
        "",
        'port = "/dev/ttyACM0"',
        'port = "socket://192.168.1.1:5"',
        'port = "rfc2217://host:5"',
        'bus = "socketcan:can0"',
        'bus = "pcan:PCAN_USBBUS1"\nreceive_id = 5\nsend_id = 6',
        'serial = "ANOTHER"',
        f"sensitivity = {SIX}",
        f"sensitivity = [{', '.join([THREE] * 4)}]",
        "zero_at_start = true",
    ],
    "dsa": ["", 'port = "/dev/ttyUSB0"', 'port = "socket://192.168.1.1:13000"'],
    "sdh": [
        "",
        'port = "/dev/ttyUSB0"',
        'port = "socket://192.168.1.1:23"',
        'bus = "socketcan:can0"',
        'bus = "socketcan:can0"\nchecksum = true',
        'port = "/dev/ttyUSB0"\nprotocol = "binary"',
    ],
    "jaco": ["", 'connection = "ethernet"', 'library = "/opt/kinova/api"\nserial = "PJ00650"', 'model = "j2s7s300"'],
    "webcam": ["", "port = 3", 'port = "/dev/v4l/by-id/none"'],
    "depth_camera": ["", 'port = "usb:1-2"', 'port = "walk.oni"', 'library = "/tmp/x"'],
}

CASES = [(driver, way) for driver, ways in WAYS.items() for way in ways]
QUICK = [case for case in CASES if not re.search("socket:|rfc2217|ANOTHER", case[1])]


@pytest.mark.parametrize(("driver", "way"), slow_but(QUICK, CASES))
def test_a_double_needs_nothing_of_what_the_file_names(driver: str, way: str) -> None:
    (entry,) = parse_rig(f'[devices.a]\ndriver = "{driver}"\ndouble = true\n{way}', "r").devices
    with member_of(entry) as member, member.device as device:
        device.next(20.0)


def test_the_example_is_for_every_device_that_can_be_doubled() -> None:
    text = (resources.files("deformscope") / "lab" / "rig-example.toml").read_text(encoding="utf-8")
    devices = parse_rig(text, "example").devices
    assert {entry.driver.name for entry in devices} == set(WAYS)
    assert any(getattr(entry.config, "bus", "").startswith("socketcan:") for entry in devices)


def test_a_double_on_a_port_has_a_process_of_its_own_that_ends_with_it() -> None:
    driver = DRIVERS["optoforce"]
    with double_device("optoforce", driver.config(rate_hz=333)) as device:
        process = int(device.config.port.split("/")[2])
        assert int(Path(f"/proc/{process}/stat").read_text().split()[3]) == os.getpid()
        with device.readings() as readings:
            device.open()
            assert readings.get(PATIENCE_S) is not None
            device.close()
    assert not Path(f"/proc/{process}").exists()
