"""A device whose clock is late, as `calibrate time` found: its stamps are put back, and what they were is kept."""

from pathlib import Path

import pytest

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.frames import RawBytes, TactileFrame, WrenchFrame
from deformscope.recording.items import read_items
from deformscope.recording.reader import Replay, read_rows
from deformscope.rig.rig_file import parse_rig
from deformscope.rows import OF_DEVICES
from tests.page.pages import page_script
from tests.page.test_rig_on_page import started
from tests.verified import verify_here

LATE_NS = 20_000_000
RIG = """
[devices.tip]
driver = "optoforce"
double = true

[devices.pads]
driver = "dsa"
double = true

[calibrated.time]
date = 2026-01-02
"""
LATE = 'offset_s = {offset}\ndevice = "pads"\nbeside = "{beside}"\n'


def test_a_recording_has_stamps_put_back_and_as_they_arrived(tmp_path: Path) -> None:
    rig, recording = tmp_path / "rig.toml", tmp_path / "late.rrd"
    rig.write_text(RIG + LATE.format(offset=0.02, beside="tip"))
    assert main(["record", str(rig), "--seconds", "0.4", "--record", str(recording), "--viewer", "none"]) == 0
    assert verify_here(recording) == 0
    assert main(["replay", str(recording), "--viewer", "none"]) == 0  # its bytes give the same, put back alike
    assert first_ns(recording) >= 0
    items = list(read_items(recording))
    pads = [one for one in items if isinstance(one, TactileFrame)]
    arrivals = {one.host_ns for one in items if isinstance(one, RawBytes) and one.device == "pads"}
    assert pads
    assert {one.stamp.late_ns for one in pads} == {LATE_NS}
    assert {one.stamp.arrived_ns for one in pads} <= arrivals
    assert not arrivals.intersection(one.stamp.host_ns for one in pads)
    assert {one.stamp.late_ns for one in items if isinstance(one, WrenchFrame)} == {None}


def first_ns(recording: Path) -> int:
    """Session time of the oldest that a recording holds [ns]."""
    return min(row.session_ns for row in read_rows(Replay(recording), OF_DEVICES))


def test_a_session_begins_before_its_latest_device_has_seen_anything(tmp_path: Path) -> None:
    """Also of a file that begins between two readings, and where devices open faster than their stamps are put back."""
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG + LATE.format(offset=0.5, beside="tip") + f'[record]\nfolder = "{tmp_path}"\n')
    whole = tmp_path / "whole.rrd"
    words = ("record", str(rig), "--record", str(whole))
    with started(*words, folder=tmp_path) as command, page_script(command.page, "a") as one:
        one.until(lambda state: "stop-recording" in state["commands"] and state["devices"])
        assert one.command("stop-recording")[0] == "begun"
        one.until(lambda state: "start-recording" in state["commands"])
        assert one.command("start-recording")[0] == "begun"
        one.until(lambda state: state["recorded_bytes"] > 0 and "stop-recording" in state["commands"])
        one.command("stop")
        found = command.ended()
    assert found["recordings"][0] == str(whole)
    for file in map(Path, found["recordings"]):
        kept = [one for one in read_items(file) if isinstance(one, TactileFrame)]
        assert {one.stamp.late_ns for one in kept} == {500_000_000}
        assert 0 <= first_ns(file) < 2e9


@pytest.mark.parametrize(
    ("lines", "late"),
    [
        (LATE.format(offset=0.02, beside="tip"), {"pads": LATE_NS}),
        (LATE.format(offset=-0.02, beside="tip"), {"tip": LATE_NS}),
        ("offset_s = 0.02\n", {}),
    ],
    ids=["late", "early", "of whom is not said"],
)
def test_the_later_of_two_is_put_back(lines: str, late: dict[str, int]) -> None:
    assert {entry.name: entry.late_ns for entry in parse_rig(RIG + lines, "rig").devices if entry.late_ns} == late


@pytest.mark.parametrize(
    ("offset", "beside", "match"), [(0.02, "nose", "out of tip, pads"), (9.0, "tip", "within 0.5 s")]
)
def test_what_cannot_be_applied_is_refused(offset: float, beside: str, match: str) -> None:
    with pytest.raises(InputError, match=match):
        parse_rig(RIG + LATE.format(offset=offset, beside=beside), "rig")
