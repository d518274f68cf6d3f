"""A recording from its first contact on, and other settings as a layer over what was recorded."""

import dataclasses
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from matplotlib.colors import to_hex

from deformscope.errors import InputError
from deformscope.frames import SessionNote, Stream, TactileFrame, WrenchFrame
from deformscope.log.exploration.results import comparison_rrd
from deformscope.log.layout import RIG, RigLayout
from deformscope.page.server.messages import Playback
from deformscope.page.server.page_server import PageServer
from deformscope.pictures import exploration as pictures
from deformscope.pictures.figures import canvas
from deformscope.recording.reader import Replay, Row
from deformscope.recording.recorder import Recorder
from deformscope.runs.aligned import aligned_series, first_contact_ns
from deformscope.stages.map.exploration import PhaseStart
from deformscope_drivers.clock import Stamp
from tests.log import synthetic_exploration as synthetic
from tests.page.test_in_browser import FAKE_VIEWER, browser, shown, until

__all__ = ["browser", "shown"]

S = 1_000_000_000
RATE_HZ = 100


def forces(force_n: np.ndarray) -> list[WrenchFrame]:
    """At RATE_HZ, along z, over a load of 0.3 N that is always there. force_n: (n,)"""
    return [
        WrenchFrame(Stamp(at * S // RATE_HZ), at, np.zeros(3, np.int64), np.array([[0.3, 0.0, one]]), device="tip")
        for at, one in enumerate(force_n)
    ]


def ramp(contact_s: float, seconds: float = 5.0) -> np.ndarray:
    """1 N a second from the contact on."""
    return np.maximum(np.arange(0.0, seconds, 1 / RATE_HZ) - contact_s, 0.0)


def rows(*items: Any) -> list[Row]:
    """At their own times."""
    return [Row(item.stamp.host_ns if hasattr(item, "stamp") else item.host_ns, 0, item) for item in items]


def recorded(path: Path, force_n: np.ndarray) -> Path:
    with Recorder(path, settings={"rig_name": "one"}, application=RIG) as recorder:
        recorder.start(RigLayout((Stream("tip", "wrench", "optoforce"),)), 0)
        recorder.write(forces(force_n))
    return path


def test_the_first_contact_is_found_by_force_pads_or_phases() -> None:
    assert first_contact_ns(rows(*forces(ramp(2.0)))) == pytest.approx(2.54 * S, abs=0.03 * S)
    assert first_contact_ns(rows(*forces(np.linspace(0.0, 1.0, 3000)))) is None  # it drifts
    stepped = forces(np.where(np.arange(300) < 100, 2.0, 0.0))
    assert first_contact_ns(rows(*stepped)) == S
    assert first_contact_ns(rows(*[*stepped[:100], SessionNote(S - 1, "tare", "tip"), *stepped[100:]])) is None
    pads = [
        TactileFrame(Stamp(at * S // 30), at, np.full(6, 20 if at >= 60 else 0, np.uint16), (np.zeros((2, 3)),), "pads")
        for at in range(90)
    ]
    assert first_contact_ns(rows(*pads)) == pytest.approx(59.5 / 30 * S, abs=1e6)
    phases = [Row(at * S, 1, PhaseStart(name, 0)) for at, name in enumerate(("travel", "approach", "press", "press"))]
    assert first_contact_ns([*rows(*forces(ramp(0.5))), *phases]) == 2 * S  # an exploration says when it presses


def test_measurements_of_a_recording_are_since_its_first_contact(tmp_path: Path) -> None:
    found = aligned_series(Replay(recorded(tmp_path / "soft.rrd", ramp(1.0))))
    (one,) = found.values()
    assert list(found) == ["tip"]
    assert one.since_ns[0] == pytest.approx(-1.54 * S, abs=0.03 * S)
    assert one.values[np.searchsorted(one.since_ns, 2 * S)] == pytest.approx(2.54, abs=0.05)
    with pytest.raises(InputError, match=r"a recording with a contact.*air\.rrd"):
        aligned_series(Replay(recorded(tmp_path / "air.rrd", 0.0 * ramp(1.0))))


def test_other_settings_are_drawn_beside_the_recorded_in_two_colours_and_named() -> None:
    recorded_maps = synthetic.maps(4)
    other = dataclasses.replace(recorded_maps, labels=np.zeros_like(recorded_maps.labels), region_count=1)
    axes: Any = canvas(4.0, 3.0).add_axes((0.1, 0.1, 0.8, 0.7))
    pictures.draw_region_comparison(axes, recorded_maps, other, "threshold = 0.5")
    handles = axes.get_legend().legend_handles
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names[0].startswith(f"recorded: {recorded_maps.region_count} regions")
    assert names[1].startswith("threshold = 0.5: 1 region (")
    assert len({to_hex(handle.get_color()) for handle in handles}) == 2
    most = max(float((recorded_maps.labels == one).mean()) for one in range(recorded_maps.region_count))
    assert f"{100 * most:.0f} % of the surface the same" in axes.get_legend().get_title().get_text()
    touches = [synthetic.touch(number) for number in range(3)]
    softer = [dataclasses.replace(one, stiffness_n_per_mm=one.stiffness_n_per_mm / 2) for one in touches]
    axes = canvas(4.0, 3.0).add_axes((0.1, 0.1, 0.8, 0.7))
    pictures.draw_touch_comparison(axes, "stiffness", touches, softer, "x")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["recorded", "x"]
    drawn = [container.lines[0].get_ydata() for container in axes.containers]
    assert drawn[1] == pytest.approx(drawn[0] / 2)


TWO_S_BEFORE = bytes([3 << 3 | 2, 11, 1 << 3]) + bytes.fromhex("80d8a9c6f8ffffffff01") + bytes([5 << 3, 1])
PLAYS = """
window.asked = [];
window.wasm_bindgen.WebHandle.prototype.add_receiver = function () { window.handle = this; };
window.wasm_bindgen.WebHandle.prototype.viewer_control = async (bytes) => window.asked.push([...bytes]);
"""


def test_the_page_lays_it_over_the_recording_once_that_is_there(shown: Any, tmp_path: Path) -> None:
    file = tmp_path / "mine.rrd"
    file.write_bytes(b"RRF2")
    story = [(S, synthetic.touch(0)), (2 * S, synthetic.maps(1))]
    layer = comparison_rrd(
        ("deformscope-exploration", "one"), [], (0.6, 0.4), story, [one for _, one in story], "x = 1"
    )
    shown.route(
        "**/re_viewer.js", lambda route: route.fulfill(body=FAKE_VIEWER + PLAYS, content_type="text/javascript")
    )
    shown.route("**/re_viewer_bg.wasm", lambda route: route.fulfill(body=""))
    with PageServer("mine.rrd", file) as page:
        playback = Playback("session", 9 * S, S // 10, from_ns=-2 * S)
        page.session.show(playback=playback)
        shown.goto(page.address)
        until(shown, lambda: shown.evaluate("window.handle !== undefined"))
        until(shown, lambda: shown.inner_text("#moment") == "-2.00 of 9.00 s")
        page.offer("layer.rrd", layer, "application/octet-stream")
        page.session.show(playback=msgspec.structs.replace(playback, layer="layer.rrd"))
        assert shown.evaluate("window.pieces") == []
        shown.evaluate("window.handle.tell({ type: 'recording_open' })")
        until(shown, lambda: shown.evaluate("window.pieces") == [len(layer)])
        # where it stood: of -2 s, as protobuf has negative numbers, ten bytes of two's complement
        until(shown, lambda: any(bytes(one).endswith(TWO_S_BEFORE) for one in shown.evaluate("window.asked")))
