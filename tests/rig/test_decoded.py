"""A recording's bytes give its frames again; one byte or one value that was altered is found."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.frames import (
    Frame,
    HandFrame,
    HealthReport,
    Item,
    RawBytes,
    Stream,
    TactileFrame,
    WrenchFrame,
    host_ns,
)
from deformscope.log.layout import RIG as RIG_APPLICATION
from deformscope.log.layout import RigLayout
from deformscope.recording.recorder import Recorder
from deformscope.rig.decoded import compare_with_bytes
from deformscope.rig.rig_file import parse_rig
from deformscope.rig.source import RigMember, RigSource
from deformscope_drivers.dsa import Dsa, DsaDouble
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.optoforce import Optoforce, OptoforceDouble
from deformscope_drivers.sdh import Sdh
from deformscope_drivers.sdh.double import Port, SdhDouble

RIG = """
[devices.tip]
driver = "optoforce"
port = "memory"
sensitivity = { counts_at_nominal = [16037.0, 16037.0, 16037.0], nominal = [40.0, 40.0, 40.0] }
[devices.pads]
driver = "dsa"
port = "memory"
[devices.hand]
driver = "sdh"
port = "memory"
[devices.arm]
driver = "jaco"
"""
SECONDS = 2
Recorded = tuple[list[Item], tuple[Stream, ...], int]


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    """Two seconds of three devices on a simulated clock."""
    clock = SimulatedClock(10**9)
    configs = {entry.name: entry.config for entry in parse_rig(RIG, "rig").devices}

    def wire(double: Any) -> Any:
        return MemoryTransport(double, clock)

    devices: dict[str, Any] = {
        "tip": Optoforce(configs["tip"], transport=wire(OptoforceDouble()), clock=clock),
        "pads": Dsa(configs["pads"], transport=wire(DsaDouble()), clock=clock),
        "hand": Sdh(configs["hand"], transport=wire(SdhDouble(Port.RS232)), clock=clock),
    }
    drivers = {"tip": "optoforce", "pads": "dsa", "hand": "sdh"}
    members = [RigMember(name, DRIVERS[drivers[name]], device) for name, device in devices.items()]

    def opener() -> None:
        for device in devices.values():
            device.open(own_thread=False)

    items: list[Item] = []
    with RigSource(members, clock=clock, opener=opener) as source:
        start_ns = source.start_ns
        while clock() < start_ns + SECONDS * 10**9:
            for device in devices.values():
                device.poll(0.005)
            items += source.take(0.0)
        streams = source.streams
        source.close()
        items += [*source.rest(), source.look()]
    return sorted(items, key=host_ns), streams, start_ns


def test_the_bytes_give_the_frames_to_the_last_bit(recorded: Recorded) -> None:
    items, streams, _ = recorded
    found = {one.device: one for one in compare_with_bytes(parse_rig(RIG, "rig"), streams, items)}
    for device, kind, least in (("tip", WrenchFrame, 1900), ("pads", TactileFrame, 20), ("hand", HandFrame, 10)):
        count = sum(isinstance(item, kind) for item in items)
        assert (found[device].frames, found[device].compared, found[device].difference) == (count, count, "")
        assert count > least


def of(items: list[Item], kind: type, device: str, at: float = 0.7) -> int:
    """The place of one of these, at a share of all."""
    places = [
        place
        for place, item in enumerate(items)
        if isinstance(item, kind) and not isinstance(item, HealthReport) and item.device == device  # type: ignore[union-attr]
    ]
    return places[int(at * len(places))]


def flipped(item: Item) -> Item:
    """One bit of one byte in the middle."""
    assert isinstance(item, RawBytes)
    assert not item.sent
    middle = len(item.data) // 2
    data = item.data[:middle] + bytes([item.data[middle] ^ 1]) + item.data[middle + 1 :]
    return dataclasses.replace(item, data=data)


def next_up(field: str) -> Callable[[Item], Item]:
    def change(item: Item) -> Item:
        value = getattr(item, field)
        if isinstance(value, tuple):
            return dataclasses.replace(item, **{field: (np.nextafter(value[0], np.inf), *value[1:])})
        if value.dtype.kind == "f":
            return dataclasses.replace(item, **{field: np.nextafter(value, np.inf)})
        return dataclasses.replace(item, **{field: value + value.dtype.type(1)})

    return change


ALTERED = [
    *(("pads", kind, change) for kind, change in ((RawBytes, flipped), (TactileFrame, next_up("pressure_pa")))),
    *(("tip", kind, change) for kind, change in ((RawBytes, flipped), (WrenchFrame, next_up("force_n")))),
    ("tip", WrenchFrame, next_up("counts")),
    *(("hand", kind, change) for kind, change in ((RawBytes, flipped), (HandFrame, next_up("velocity_deg_s")))),
]


@pytest.mark.parametrize(("device", "kind", "change"), ALTERED)
def test_one_altered_byte_or_value_is_found(
    recorded: Recorded, device: str, kind: type, change: Callable[[Item], Item]
) -> None:
    items, streams, _ = recorded
    place = of(items, kind, device)
    if kind is RawBytes:  # one that was received
        while items[place].sent:  # type: ignore[union-attr]
            place = of(items[: place - 1], kind, device, 0.999)
    altered = [*items[:place], change(items[place]), *items[place + 1 :]]
    different = [one for one in compare_with_bytes(parse_rig(RIG, "rig"), streams, altered) if one.difference]
    assert [one.device for one in different] == [device]


def test_a_frame_that_is_missing_or_came_of_nothing_is_found(recorded: Recorded) -> None:
    items, streams, _ = recorded
    place = of(items, TactileFrame, "pads")
    rig = parse_rig(RIG, "rig")
    (lost,) = (one for one in compare_with_bytes(rig, streams, [*items[:place], *items[place + 1 :]]) if one.difference)
    assert "which was not recorded" in lost.difference
    first = of(items, RawBytes, "hand")
    bytes_lost = [item for at, item in enumerate(items) if not (at > first and isinstance(item, RawBytes))]
    found = {one.device: one.difference for one in compare_with_bytes(rig, streams, bytes_lost)}
    assert all("which its bytes do not contain" in found[device] for device in ("tip", "pads", "hand"))


def test_replay_of_a_rigs_recording(recorded: Recorded, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    items, streams, start_ns = recorded
    arm = Stream("arm", "arm", "jaco")
    place = of(items, TactileFrame, "pads")
    for name, given in (("r", items), ("x", [*items[:place], next_up("counts")(items[place]), *items[place + 1 :]])):
        with Recorder(
            tmp_path / f"{name}.rrd", "none", {"rig": RIG, "rig_name": "rig"}, application=RIG_APPLICATION
        ) as made:
            made.start(RigLayout((*streams, arm)), start_ns)
            made.write(given)
    assert main(["replay", str(tmp_path / "r.rrd"), "--json", "-"]) == 0
    out = capfd.readouterr()
    told = json.loads(out.out)
    frames = sum(isinstance(item, Frame) for item in items)
    assert told["identical"] is True
    assert sum(one["compared"] for one in told["devices"]) == frames
    assert {one["device"]: one["left_out"] for one in told["devices"]}["arm"] == "its driver gives no bytes"
    assert f"{frames} frames decoded again, identical" in out.err
    with Recorder(tmp_path / "n.rrd", "none", {"rig": "", "rig_name": "rig"}, application=RIG_APPLICATION) as made:
        made.start(RigLayout((arm,)), start_ns)
    assert main(["replay", str(tmp_path / "n.rrd")]) == 0
    assert "identical" not in "".join(capfd.readouterr()), "nothing was compared"
    assert main(["replay", str(tmp_path / "x.rrd"), "--json", str(tmp_path / "x.json")]) == 2
    error = capfd.readouterr().err.splitlines()[-1]
    assert "got another counts of frame" in error
    assert "of pads" in error
    assert json.loads((tmp_path / "x.json").read_text())["identical"] is False
