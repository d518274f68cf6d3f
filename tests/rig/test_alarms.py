"""Alarms of sensors: what is stuck or at the end of its range is named once, what is still within its noise is not."""

from collections.abc import Iterator

import numpy as np
import pytest

from deformscope.frames import ColorFrame, DepthFrame, HealthReport, Item, PadLayout, Stream, TactileFrame, WrenchFrame
from deformscope.rig.alarms import TEXEL_END, WRENCH_END, SensorAlarms
from deformscope_drivers.clock import Stamp
from deformscope_drivers.health import Health, Link

TIP = Stream("tip", "wrench", "optoforce")
PADS = Stream(
    "pads", "tactile", "dsa", pads=tuple(PadLayout(f"pad {at}", 2, 3, (0.003, 0.003), at, at, 1) for at in (0, 1))
)
CAMERA = Stream("camera", "color", "webcam")
DEPTH = Stream("above", "depth", "depth_camera")
AFTER_S: dict[str, float | None] = {"tip": 2.0, "pads": 2.0}


def wrenches(counts: np.ndarray, rate_hz: float = 100.0, overload: range = range(0)) -> Iterator[list[Item]]:
    """In batches of a tenth of a second, as a rig gives them. counts: (k, 3)"""
    step = int(rate_hz / 10)
    frames: list[Item] = [
        WrenchFrame(
            Stamp(round(at / rate_hz * 1e9)), at, row, np.full((1, 3), np.nan), overload=at in overload, device="tip"
        )
        for at, row in enumerate(counts)
    ]
    yield from (frames[at : at + step] for at in range(0, len(frames), step))


def said(alarms: SensorAlarms, batches: Iterator[list[Item]]) -> list[tuple[str, str, float]]:
    return [(note.about, note.text, note.host_ns / 1e9) for batch in batches for note in alarms.look(batch)]


def noise(seconds: float, sigma: float, rate_hz: float = 100.0, seed: int = 1000) -> np.ndarray:
    return np.rint(np.random.default_rng(seed).normal(5.0, sigma, (int(seconds * rate_hz), 3))).astype(np.int64)


def test_one_dead_axis_is_named_when_it_dies_and_when_it_lives_again() -> None:
    counts = noise(10.0, 3.0)
    counts[300:700, 1] = 12
    found = said(SensorAlarms([TIP], AFTER_S), wrenches(counts))
    assert [(about, text) for about, text, _ in found] == [
        ("alarm", "tip: stuck at the same count: fy"),
        ("alarm-over", "tip: stuck at the same count: fy"),
    ]
    assert 5.0 <= found[0][2] <= 5.2  # the rig's 2 s after it died
    assert 7.9 <= found[1][2] <= 8.2  # and not at once when it lives: alarms do not flicker


@pytest.mark.parametrize("sigma", [0.3, 0.5, 1.0, 5.0])
def test_what_is_within_the_noise_is_no_alarm(sigma: float) -> None:
    """A quiet sensor gives the same count most of the time: of 0.3 counts of noise 90 %."""
    assert said(SensorAlarms([TIP], AFTER_S), wrenches(noise(120.0, sigma))) == []


def test_a_quiet_sensor_is_given_longer_than_the_rig_does() -> None:
    """At 0.2 counts of noise two equal readings are nothing: 4 s of them happen, 60 s do not."""
    counts = noise(160.0, 0.2)
    counts[10000:] = counts[10000]
    found = said(SensorAlarms([TIP], AFTER_S), wrenches(counts))
    assert {text for about, text, _ in found if about == "alarm"} == {
        f"tip: stuck at the same count: {axis}" for axis in ("fx", "fy", "fz")
    }
    assert all(about == "alarm" and at > 104.0 for about, _, at in found)


def test_a_rig_may_let_readings_stay_the_same() -> None:
    assert said(SensorAlarms([TIP], {"tip": None}), wrenches(np.full((2000, 3), 7))) == []


def test_the_end_of_an_axis_and_an_overload() -> None:
    counts = noise(5.0, 3.0)
    counts[120:140, 2] = -WRENCH_END
    alarms = SensorAlarms([TIP], AFTER_S)
    batches = list(wrenches(counts, overload=range(120, 125)))
    found = said(alarms, iter(batches[:15]))
    assert [text for _, text, _ in found] == [
        "tip: saturated: fz at the end of its range",
        "tip: saturated: the sensor reports an overload",
    ]
    assert alarms.of("tip") == tuple(text.removeprefix("tip: ") for _, text, _ in found)
    assert [about for about, _, _ in said(alarms, iter(batches[15:]))] == ["alarm-over", "alarm-over"]
    assert alarms.of("tip") == ()


def test_texels_by_their_pad() -> None:
    random = np.random.default_rng(1000)
    alarms, found = SensorAlarms([PADS], AFTER_S), []
    for at in range(150):  # 30 a second
        counts = np.rint(random.normal(400.0, 3.0, 12)).astype(np.uint16)
        counts[:2] = 0  # not pressed: no alarm
        counts[7] = 900
        counts[8:10] = TEXEL_END if at >= 90 else counts[8:10]
        found += alarms.look([TactileFrame(Stamp(round(at / 30 * 1e9)), at, counts, (), "pads")])
    assert [(note.about, note.text) for note in found] == [
        ("alarm", "pads: stuck at the same count: 1 texels of pad 1"),
        ("alarm", "pads: saturated: 2 texels of pad 1 at the end of their range"),
    ]


def test_pictures_that_show_nothing() -> None:
    white, grey = np.full((64, 64, 3), 255, np.uint8), np.full((64, 64, 3), 90, np.uint8)
    nothing, some = np.zeros((64, 64), np.uint16), np.full((64, 64), 500, np.uint16)
    alarms = SensorAlarms([CAMERA, DEPTH], {})
    texts = [
        [
            note.text
            for note in alarms.look(
                [ColorFrame(Stamp(at), at, image, "camera"), DepthFrame(Stamp(at), at, depth, 1e-3, device="above")]
            )
        ]
        for at, (image, depth) in enumerate([(grey, some), (white, nothing), (white // 2, some), (white, nothing)])
    ]
    assert texts == [
        [],
        ["camera: saturated: 100 % of the picture at its brightest", "above: saturated: no pixel within its range"],
        [],
        [],
    ]


def test_what_a_driver_finds_stuck_is_passed_on() -> None:
    alarms, seen = SensorAlarms([CAMERA], {}), []
    for at_s, stuck in ((1, False), (2, True), (3, True), (4, False)):
        health = Health(Link.CONNECTED, age_s=0.01, stuck=stuck)
        seen.append([note.about for note in alarms.look([HealthReport(at_s * 10**9, (("camera", health),))])])
    assert seen == [[], ["alarm"], [], ["alarm-over"]]


def test_an_alarm_goes_on_where_its_device_falls_silent() -> None:
    """Looks at health go on, and other pictures of the same camera: neither shows that the sensor is well again."""
    counts = noise(24.0, 3.0)
    counts[100:130, 2] = WRENCH_END
    counts[1600:, 2] = WRENCH_END
    batches = list(wrenches(counts))
    alarms = SensorAlarms([TIP, DEPTH], AFTER_S)
    assert [about for about, _, _ in said(alarms, iter(batches[:13]))] == ["alarm"]
    alarms.look([DepthFrame(Stamp(10**9), 0, np.zeros((64, 64), np.uint16), 1e-3, device="above")])
    silent = Health(Link.LOST, age_s=9.0)
    for at_s in range(2, 12):
        assert alarms.look([HealthReport(at_s * 10**9, (("tip", silent), ("above", silent)))]) == []
        assert alarms.look([ColorFrame(Stamp(at_s * 10**9), at_s, np.full((64, 64, 3), 90, np.uint8), "above")]) == []
    assert alarms.of("tip") == ("saturated: fz at the end of its range",)
    assert alarms.of("above") == ("saturated: no pixel within its range",)
    # it comes back after 10.7 s, well: cleared as any other alarm, and not at once
    found = said(alarms, iter(batches[120:140]))
    assert [about for about, _, _ in found] == ["alarm-over"]
    assert 13.0 - 0.1 <= found[0][2] <= 13.2
    # and where it comes back as it went, it is the same alarm
    assert [about for about, _, _ in said(alarms, iter(batches[160:165]))] == ["alarm"]
    assert not [text for _, text, _ in said(alarms, iter(batches[200:])) if "saturated" in text]
