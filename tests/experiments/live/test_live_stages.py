"""Stages beside devices: which frames they take, what is counted, what they find, and that a replay finds the same."""

import dataclasses
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from deformscope.arrays import ImageArray
from deformscope.errors import InputError
from deformscope.experiments.fit.whole_motion import ParticleOptions
from deformscope.experiments.live.device_stages import (
    ApproachChooser,
    Chooser,
    LiveOptions,
    NewestFrame,
    Stage,
    compute,
    for_rig,
    stages_of,
)
from deformscope.experiments.live.live_stages import StageCounts, StageProcesses, live_stages, used_frames
from deformscope.experiments.live.replay_stages import replay_stages
from deformscope.frames import (
    ArmFrame,
    ColorFrame,
    Frame,
    Item,
    PadLayout,
    StageResult,
    Stream,
    TactileFrame,
    UsedFrames,
    WrenchFrame,
)
from deformscope.images import decode_image, encode_jpeg
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording.items import read_stage_results
from deformscope.recording.recorder import Recorder
from deformscope.rig.rig_file import Tool, load_rig
from deformscope.session import Step
from deformscope.stages.map.exploration import StageFailure, SurfaceEstimate, TouchEstimate
from deformscope.stages.see.tactile import TactileContact
from deformscope_drivers.clock import Stamp, monotonic_ns


class ByHand:
    """Computes nothing until the test says so."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]] = []

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.waiting.append((future, function, arguments))
        return future

    def finish(self) -> None:
        future, function, arguments = self.waiting.pop()
        future.set_result(function(*arguments))

    def die(self) -> None:
        self.waiting.pop()[0].set_exception(RuntimeError("killed"))


class AtOnce(ByHand):
    """Has computed it when the next items come."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        future = super().submit(function, *arguments)
        self.finish()
        return future


@dataclasses.dataclass(frozen=True)
class Doubled:
    """A stage that doubles a frame's index, and fails at 13."""

    device: str = "pads"
    name: str = "tactile"

    def chooser(self) -> Chooser:
        return NewestFrame(self.device)

    def packed(self, frames: Sequence[Frame]) -> Any:
        return frames[-1].index

    def compute(self, packed: Any) -> object:
        if packed == 13:
            raise InputError("luck", "13")
        return 2 * packed


def pads(index: int, device: str = "pads") -> TactileFrame:
    return TactileFrame(Stamp(monotonic_ns()), index, np.zeros(0, np.int64), (), device)


class Session:
    """The experiment, driven by hand. now_s: on its clock, None = the host's; notes: with their time [s]"""

    def __init__(
        self, stages: Sequence[Stage], beside: Mapping[str, ByHand], now_s: float | None = None, **more: Any
    ) -> None:
        self._over = False
        self.now_s = now_s
        self.notes: list[tuple[float, str, str]] = []
        self._experiment = live_stages(stages, beside, lambda items: self._over, clock=self._clock, **more)
        next(self._experiment)

    def _clock(self) -> int:
        return monotonic_ns() if self.now_s is None else round(self.now_s * 1e9)

    def send(self, given: Sequence[Item], now_s: float | None = None) -> tuple[Any, ...]:
        self.now_s = now_s
        step = self._experiment.send(given)
        self.notes += [(note.host_ns / 1e9, note.about, note.text) for note in step.notes]
        return step.results

    def end(self) -> dict[str, StageCounts]:
        self._over = True
        with pytest.raises(StopIteration) as end:
            self._experiment.send([])
        found: dict[str, StageCounts] = end.value.value
        return found


def test_the_newest_frame_wins_and_the_others_are_counted() -> None:
    worker = ByHand()
    session = Session([Doubled()], {"tactile": worker})
    assert session.send([pads(0), pads(1), pads(2), pads(9, "others")]) == ()
    assert session.send([pads(3)]) == ()  # still computing
    assert session.send([pads(4), pads(5)]) == ()
    worker.finish()
    (first,) = session.send([pads(6)])
    worker.finish()
    (second,) = session.send([])
    assert (first.result, first.used, first.skipped) == (4, (UsedFrames("pads", 2, 2),), 2)
    assert (second.result, second.used, second.skipped) == (12, (UsedFrames("pads", 6, 6),), 3)
    assert first.late_s >= 0.0
    counts = session.end()["tactile"]
    assert (counts.frames, counts.results, counts.failures, counts.skipped) == (7, 2, 0, 5)
    assert len(counts.late_s) == 2


def test_what_was_not_finished_counts_as_skipped() -> None:
    worker = ByHand()
    session = Session([Doubled()], {"tactile": worker})
    session.send([pads(0), pads(1)])
    session.send([pads(2), pads(3)])
    counts = session.end()["tactile"]
    assert (counts.frames, counts.results, counts.skipped) == (4, 0, 4)
    assert counts.as_json()["lag_ms"] is None


def test_a_stage_that_fails_says_so_and_goes_on() -> None:
    session = Session([Doubled()], {"tactile": AtOnce()})
    session.send([pads(13)])
    (failed,) = session.send([pads(14)])
    (after,) = session.send([])
    assert isinstance(failed.result, StageFailure)
    assert failed.result.reason == "expected luck; got 13"
    assert after.result == 28
    assert session.end()["tactile"].failures == 1


def test_a_process_that_dies_is_a_failure_too() -> None:
    worker = ByHand()
    session = Session([Doubled()], {"tactile": worker})
    session.send([pads(1)])
    worker.die()
    (failed,) = session.send([pads(2)])
    worker.finish()
    (after,) = session.send([])
    assert isinstance(failed.result, StageFailure)
    assert "killed" in failed.result.reason
    assert after.result == 4


def at(time_s: float, index: int, device: str = "pads") -> TactileFrame:
    return dataclasses.replace(pads(index, device), stamp=Stamp(round(time_s * 1e9)))


def test_a_stage_whose_device_is_silent_says_so_after_a_second_and_once() -> None:
    session = Session([Doubled()], {"tactile": AtOnce()}, 0.0)
    for step in range(60):
        session.send([at(0.1 * step, step, "others")], 0.1 * step)
    assert session.notes == [(1.0, "stage", "tactile gives nothing: no frame of pads came")]
    counts = session.end()["tactile"]
    assert (counts.frames, counts.results, counts.nothing) == (0, 0, "no frame of pads came")


def test_a_slow_first_result_is_said_within_a_second_and_that_it_came() -> None:
    worker = ByHand()
    session = Session([Doubled()], {"tactile": worker}, 0.0)
    for step in range(40):
        session.send([at(0.1 * step, step)], 0.1 * step)
    worker.finish()
    session.send([], 4.0)
    assert session.notes == [
        (1.0, "stage", "tactile gives nothing: the first result is still being computed"),
        (4.0, "stage-over", "tactile gives results"),
    ]


def test_what_is_computed_from_a_frame_that_came_late_is_not_called_slow_at_once() -> None:
    worker = ByHand()
    session = Session([Doubled()], {"tactile": worker}, 0.0)
    session.send([], 1.5)
    session.send([at(2.0, 1)], 2.0)
    session.send([], 2.9)
    session.send([], 3.0)
    assert [(when, text) for when, _, text in session.notes] == [
        (1.5, "tactile gives nothing: no frame of pads came"),
        (3.0, "tactile gives nothing: the first result is still being computed"),
    ]


def test_a_first_failure_is_said_with_its_frame_and_another_only_where_the_reason_changes() -> None:
    @dataclasses.dataclass(frozen=True)
    class Fails(Doubled):
        def compute(self, packed: Any) -> object:
            raise InputError("luck" if packed < 5 else "light", str(packed))

    session = Session([Fails()], {"tactile": AtOnce()}, 0.0)
    for step in range(10):
        session.send([at(0.01 * step, step)], 0.01 * step)
    session.send([], 0.1)
    assert session.notes == [
        (0.01, "stage", "tactile gives nothing: expected luck; got 0"),
        (0.06, "stage", "tactile gives nothing: expected light; got 5"),
    ]
    counts = session.end()["tactile"]
    assert counts.as_json()["reasons"] == {"expected luck; got 0": 5, "expected light; got 5": 5}
    assert counts.nothing == ""


def test_a_reason_that_comes_and_goes_is_not_said_with_each_frame() -> None:
    session = Session([Doubled()], {"tactile": AtOnce()}, 0.0)
    for step in range(100):
        session.send([at(0.01 * step, 13 if step % 2 else 1)], 0.01 * step)
    assert [text for _, _, text in session.notes] == [
        "tactile gives nothing: expected luck; got 13",
        "tactile gives results",
    ]


def test_a_stage_that_does_not_keep_up_says_once_how_late_it_is() -> None:
    worker = ByHand()
    session = Session([Doubled()], {"tactile": worker}, 0.0)
    seen: list[StageResult] = []
    for step in range(1, 90):
        results = session.send([at(0.1 * step, step)], 0.1 * step)
        seen += results
        if step % 5 == 0:
            worker.finish()
    (late,) = [text for _, _, text in session.notes if "newest" in text]
    assert late.startswith("tactile takes the newest of pads's frames, 2 of 6 so far: ")
    assert late.endswith(" ms behind its frame")
    assert [one.used[-1].last for one in seen] == [1, *range(6, 86, 5)]  # the newest when the one before was done
    counts = session.end()["tactile"]
    assert counts.results + counts.skipped == counts.frames
    assert counts.left > 3 * counts.results


def test_the_summary_has_rates_lag_and_what_was_skipped_by_reason() -> None:
    worker = ByHand()
    seen: list[StageResult] = []
    session = Session([Doubled()], {"tactile": worker}, 1.0, watch=seen.append)
    session.send([at(0.0, index) for index in range(4)], 1.0)
    worker.finish()
    session.send([at(0.1, 5), at(0.1, 6)], 1.1)
    session.send([at(0.2, 7)], 3.0)
    counts = session.end()["tactile"]
    found = counts.as_json()
    assert [one.used[-1].last for one in seen] == [3]
    assert (found["frames"], found["results"], found["skipped"]) == (7, 1, 6)
    assert found["skipped_by"] == {"newer": 4, "ended": 2}
    assert found["rate_hz"] == pytest.approx(0.5)
    assert set(found) == {
        *("frames", "results", "failures", "skipped", "lag_ms", "rate_hz", "skipped_by", "reasons", "nothing")
    }
    assert "6 skipped (4 for newer ones, 2 at the end)" in counts.to_text()


def test_two_stages_do_not_wait_for_each_other() -> None:
    slow, fast = ByHand(), AtOnce()
    session = Session([Doubled(name="flow"), Doubled()], {"flow": slow, "tactile": fast})
    session.send([pads(1)])
    results = [result for index in (2, 3) for result in session.send([pads(index)])]
    assert [(one.stage, one.result) for one in results] == [("tactile", 2), ("tactile", 4)]


def test_flow_is_from_the_image_used_before_and_beta_from_the_first() -> None:
    previous, first = NewestFrame("pads", "previous"), NewestFrame("pads", "first")
    taken: dict[str, list[list[int]]] = {"previous": [], "first": []}
    for index in range(6):
        for name, chooser in (("previous", previous), ("first", first)):
            chooser.see(pads(index))
            if index in (2, 5) and (frames := chooser.take()) is not None:
                taken[name].append([frame.index for frame in frames])
    assert taken == {"previous": [[0, 2], [2, 5]], "first": [[0, 2], [0, 5]]}
    assert previous.skipped == first.skipped == 3


def test_frames_are_named_by_stretches() -> None:
    frames = [pads(4), pads(5), pads(6), pads(2, "arm"), pads(7)]
    assert used_frames(frames) == (UsedFrames("arm", 2, 2), UsedFrames("pads", 4, 7))


def foam(pressed_px: float = 0.0, height: int = 240, width: int = 320) -> ImageArray:
    """Specks of foam that a plate at the upper edge shortens."""
    grains = np.random.default_rng(0).random((height // 4, width // 4)).repeat(4, 0).repeat(4, 1).astype(np.float32)
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
    source = height - (height - rows) * height / (height - pressed_px)
    seen = cv2.remap(grains, columns, source, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.repeat((60 + 150 * seen).astype(np.uint8)[..., None], 3, axis=2)


def test_beta_follows_particles_in_pixels_of_the_whole_image() -> None:
    stage = Stage("beta", LiveOptions(("beta",), color="camera"))
    found: Any = compute(stage, (foam(), foam(16.0)))
    down = 16.0 * (240 - found.rest_px[:, 1]) / 240
    inner = found.seen & (found.rest_px[:, 1] > 40)
    assert inner.sum() >= 30
    np.testing.assert_allclose(
        found.observed_px[inner], found.rest_px[inner] + np.column_stack([0 * down, down])[inner], atol=0.5
    )
    np.testing.assert_array_equal(found.simulated_px[found.held], found.observed_px[found.held])
    assert found.aee_px < 1.0
    assert found.interval[0] <= found.value <= found.interval[1]
    assert found.verdict in ("identified", "weak", "at-bound", "unidentified")
    assert found.verdict_text.removeprefix("weak, ").startswith(found.verdict.split("-")[0])


def test_a_pose_that_cannot_be_fitted_has_particles_and_a_reason() -> None:
    particles = ParticleOptions(held=("bottom", "contact"), contact=(40.0, 40.0, 80.0, 80.0))
    hidden = foam()
    hidden[:, :160] = hidden[::-1, 160:].copy()  # something else stands there
    found: Any = compute(Stage("beta", LiveOptions(("beta",), color="camera", particles=particles)), (foam(), hidden))
    assert found.verdict == "unidentified"
    assert "held particles of 'contact' that can be tracked" in found.verdict_text
    assert math.isnan(found.value)
    assert 0 < found.seen.sum() < len(found.seen)


def test_a_level_surface_is_level() -> None:
    looks_down = ((1.0, 0.0, 0.0, 0.1), (0.0, -1.0, 0.0, 0.1), (0.0, 0.0, -1.0, 0.6), (0.0, 0.0, 0.0, 1.0))
    options = LiveOptions(
        ("surface",),
        depth="depth",
        focal_px=(285.0, 285.0),
        center_px=(79.5, 59.5),
        T_surface_camera=looks_down,
        size_m=(0.2, 0.2),
        thickness_m=0.05,
    )
    depth = np.full((120, 160), 542, np.uint16)  # 8 mm above the nominal 0.55 m
    depth[50:60, 70:80] = 400  # something that hangs over it
    found = compute(Stage("surface", options), (depth, 1e-3))
    assert isinstance(found, SurfaceEstimate)
    assert found.height_m.shape == (20, 20)
    np.testing.assert_allclose(found.height_m, 0.058, atol=5e-4)
    assert (found.deviation_m > 0.0).all()


TIP = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.1), (0.0, 0.0, 0.0, 1.0))
"""A stick of 10 cm along the arm's z axis, which points where the tool does."""
STIFF = 2.0e4
"""k of F = k d^1.5 [N/m^1.5]."""


def approach(
    seconds: float = 2.0,
    contact_s: float = 1.0,
    speed_m_s: float = 0.01,
    law: Callable[[float], float] = lambda depth_m: STIFF * depth_m**1.5,
) -> list[Frame]:
    """An arm that goes down along -z with its tool upside down, and a force sensor. law: force [N] of a depth [m],
    default: a sphere's"""
    down = (math.pi, 0.0, 0.0)
    frames: list[Frame] = []
    for step in range(round(seconds * 1000)):
        time_s = step / 1000
        stamp = Stamp(1_000_000_000 + step * 1_000_000)
        depth = speed_m_s * max(time_s - contact_s, 0.0)
        if time_s > seconds - 0.2:  # away again
            depth = max(depth - 0.1 * (time_s - seconds + 0.2), 0.0)
        force = np.array([[0.0, 0.0, law(depth)]]) + 0.3  # a tare that is not zero
        frames.append(WrenchFrame(stamp, step, np.zeros(3, np.int64), force, device="tip"))
        if step % 10 == 0:
            height = 0.5 - speed_m_s * time_s if time_s <= seconds - 0.2 else 0.5
            nothing = np.zeros(3)
            arm = (nothing, nothing, nothing, np.array([0.1, 0.2, height]), np.array(down), nothing, nothing, nothing)
            frames.append(ArmFrame(stamp, step // 10, *arm))
    return frames


def test_an_approach_is_found_and_its_stiffness_is_known() -> None:
    chooser = ApproachChooser("tip", "arm")
    taken = None
    for frame in approach():
        chooser.see(frame)
        taken = taken or chooser.take()
    assert taken is not None
    stage = Stage("contact", LiveOptions(("contact",), wrench="tip", arm="arm", T_ee_tip=TIP, set_force_n=3.0))
    found = compute(stage, stage.packed(taken))
    assert isinstance(found, TouchEstimate)
    depth_m = (3.0 / STIFF) ** (2 / 3)
    assert found.stiffness_n_per_mm == pytest.approx(3e-3 / depth_m, rel=0.05)
    assert found.depth_m == pytest.approx(depth_m, rel=0.05)
    np.testing.assert_allclose(found.normal, [0.0, 0.0, 1.0], atol=1e-6)
    assert chooser.take() is None


@pytest.mark.parametrize("shape", ["disc", "flat"])
def test_a_flat_punch_gives_the_stiffness_of_a_linear_foam(shape: str) -> None:
    """Sneddon (1965): F = 2 a E / (1 - nu^2) d. As a ball's touch the same approach is 5 % too soft."""
    stiff_n_per_m = 2.0 * 0.01 * 40e3 / (1.0 - 0.3**2)
    bench = load_rig("lab:bench")
    frames = approach(1.6, law=lambda depth_m: stiff_n_per_m * depth_m)
    noise = np.random.default_rng(5)
    frames = [
        dataclasses.replace(one, force_n=one.force_n + noise.normal(0.0, 0.05, one.force_n.shape))
        if isinstance(one, WrenchFrame)
        else one
        for one in frames
    ]
    off = {}
    for tip in (shape, "sphere"):
        options = for_rig(LiveOptions(("contact",)), dataclasses.replace(bench, tool=Tool(tip=tip)))
        stage = Stage("contact", dataclasses.replace(options, T_ee_tip=TIP, set_force_n=3.0, compliance_m_per_n=0.0))
        found = compute(stage, stage.packed(frames))
        assert isinstance(found, TouchEstimate)
        off[tip] = abs(1e3 * found.stiffness_n_per_mm / stiff_n_per_m - 1.0)
    assert off[shape] < 0.01
    assert off["sphere"] > 0.03


def test_a_force_without_an_arm_that_moves_is_refused() -> None:
    still = [
        dataclasses.replace(frame, position_m=np.array([0.1, 0.2, 0.5])) if isinstance(frame, ArmFrame) else frame
        for frame in approach()
    ]
    stage = Stage("contact", LiveOptions(("contact",), wrench="tip", arm="arm", T_ee_tip=TIP))
    with pytest.raises(InputError, match="an arm that moves into the surface"):
        compute(stage, stage.packed(still))


def test_a_force_across_the_way_of_the_arm_is_refused() -> None:
    aside = [
        dataclasses.replace(frame, position_m=frame.position_m[[2, 1, 0]]) if isinstance(frame, ArmFrame) else frame
        for frame in approach()
    ]
    stage = Stage("contact", LiveOptions(("contact",), wrench="tip", arm="arm", T_ee_tip=TIP))
    with pytest.raises(InputError, match=r"an arm that presses along its direction of motion; got -?0% of the force"):
        compute(stage, stage.packed(aside))


def test_a_device_that_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text('[devices.pads]\ndriver = "dsa"\ndouble = true\n')
    rig = load_rig(str(path))
    assert for_rig(LiveOptions(("tactile",)), rig).tactile == "pads"
    with pytest.raises(InputError, match="a color device for --stage beta; got none in the rig"):
        for_rig(LiveOptions(("tactile", "beta")), rig)
    with pytest.raises(InputError, match="a wrench device for --stage contact"):
        for_rig(LiveOptions(("contact",)), rig)


def test_a_camera_that_is_not_calibrated_is_refused_and_the_bench_is() -> None:
    bench = load_rig("lab:bench")
    camera = dataclasses.replace(bench.camera, T_arm_camera=None)
    with pytest.raises(InputError, match="no T_arm_camera in"):
        for_rig(LiveOptions(("surface",)), dataclasses.replace(bench, camera=camera))
    with pytest.raises(InputError, match="one of camera after --camera; got 'webcam'"):
        for_rig(LiveOptions(("flow",), color="webcam"), bench)
    found = for_rig(LiveOptions(("flow", "surface", "contact")), bench)
    assert (found.color, found.depth, found.wrench, found.arm) == ("camera", "depth", "tip", "arm")
    assert found.size_m == (0.36, 0.26)


PADS = (PadLayout("thumb_distal", 4, 3, (3.4e-3, 3.4e-3), 0, 1, 1),)
STREAMS = (Stream("camera", "color", "webcam"), Stream("pads", "tactile", "dsa", pads=PADS, full_scale_pa=3000.0))
OPTIONS = LiveOptions(("flow", "tactile"), color="camera", tactile="pads", longest_px=80)


def items(changed: bool = False) -> list[list[Item]]:
    """Two batches of images and pressures; the last image may be another one."""
    random = np.random.default_rng(3)
    found: list[list[Item]] = []
    for index in range(4):
        stamp = Stamp(1_000_000_000 + index * 100_000_000)
        image = foam(2.0 * index + (3.0 if changed and index == 3 else 0.0))
        pressure = np.maximum(random.normal(200.0, 300.0, (4, 3)), 0.0)
        counts = np.zeros(12, np.int64)
        found.append([ColorFrame(stamp, index, image), TactileFrame(stamp, index, counts, (pressure,), "pads")])
    return found


def record(path: Path, given: list[list[Item]], results: Sequence[StageResult]) -> None:
    settings = {"rig": "", "rig_name": "test", "seed": 0, "stages": dataclasses.asdict(OPTIONS)}
    with Recorder(path, settings=settings, application=RIG) as recorder:
        recorder.start(RigLayout(tuple(STREAMS), (("flow", "camera"), ("tactile", "pads"))), 1_000_000_000)
        for batch in given:
            recorder.write(batch)
        recorder.write(Step(tuple(results)))


def computed(given: list[list[Item]]) -> list[StageResult]:
    stages: tuple[Stage, ...] = stages_of(OPTIONS, STREAMS)
    session = Session(stages, {"flow": AtOnce(), "tactile": AtOnce()})
    return [result for batch in [*given, []] for result in session.send(batch)]


def test_a_replay_finds_the_same_and_an_altered_image_shows(tmp_path: Path) -> None:
    results = computed(items())
    assert [one.stage for one in results] == ["tactile", *["flow", "tactile"] * 3]
    record(tmp_path / "same.rrd", items(), results)
    record(tmp_path / "other.rrd", items(changed=True), results)
    same, other = replay_stages(tmp_path / "same.rrd"), replay_stages(tmp_path / "other.rrd")
    assert (same.results, same.failures, same.different) == (7, (), {"flow": 0.0, "tactile": 0.0})
    assert other.different["tactile"] == 0.0
    assert other.different["flow"] > 1e-3


def test_results_come_back_as_they_were(tmp_path: Path) -> None:
    results = computed(items())
    results.append(
        dataclasses.replace(results[-1], host_ns=results[-1].host_ns + 1, result=StageFailure("flow", 0, "r", "t"))
    )
    record(tmp_path / "r.rrd", items(), results)
    found = read_stage_results(tmp_path / "r.rrd")
    assert len(found) == len(results)
    for one, other in zip(found, sorted(results, key=lambda one: (one.host_ns, one.stage)), strict=True):
        assert dataclasses.replace(one, result=None) == dataclasses.replace(other, result=None)
        assert type(one.result) is type(other.result)
        if isinstance(one.result, TactileContact) and isinstance(other.result, TactileContact):
            np.testing.assert_array_equal(one.result.center_m, other.result.center_m)
            np.testing.assert_array_equal(one.result.force_n, other.result.force_n)


def test_a_frame_that_is_missing_is_named(tmp_path: Path) -> None:
    record(tmp_path / "r.rrd", items()[:3], computed(items()))
    with pytest.raises(InputError, match="no frame 3 of"):
        replay_stages(tmp_path / "r.rrd")


def test_a_stage_sees_the_image_as_it_is_recorded() -> None:
    session = Session(stages_of(OPTIONS, STREAMS)[:1], {"flow": AtOnce()})
    images: list[ImageArray] = [foam(), foam(5.0)]
    session.send([ColorFrame(Stamp(1), 0, images[0]), ColorFrame(Stamp(2), 1, images[1])])
    (found,) = session.send([])
    decoded = tuple(decode_image(encode_jpeg(image), "image") for image in images)
    expected: Any = compute(stages_of(OPTIONS, STREAMS)[0], decoded)
    raw: Any = compute(stages_of(OPTIONS, STREAMS)[0], tuple(images))
    result: Any = found.result
    np.testing.assert_array_equal(result.flow_px, expected.flow_px)
    assert not np.array_equal(result.flow_px, raw.flow_px)


@pytest.mark.slow
def test_a_process_computes_and_is_replaced_when_it_has_died() -> None:
    processes = StageProcesses(["tactile"], int_nothing)
    with processes as beside:
        worker = beside["tactile"]
        assert worker.submit(math.sqrt, 9.0).result(60) == 3.0
        with pytest.raises(Exception, match="terminated abruptly"):
            worker.submit(os_exit).result(60)
        assert worker.submit(math.sqrt, 16.0).result(60) == 4.0


@pytest.mark.slow
def test_a_recording_goes_before_every_stage() -> None:
    here = priority()
    with StageProcesses(["tactile", "contact"], int_nothing) as beside:
        assert {one.submit(priority).result(60) for one in beside.values()} == {19}
    with StageProcesses(["tactile"], int_nothing, nice=max(here, 12)) as beside:
        assert beside["tactile"].submit(priority).result(60) == max(here, 12)
        with pytest.raises(BrokenProcessPool):
            beside["tactile"].submit(os_exit).result(60)
        assert beside["tactile"].submit(priority).result(60) == max(here, 12)
    assert priority() == here


def priority() -> int:
    return os.getpriority(os.PRIO_PROCESS, 0)


@pytest.mark.slow
def test_what_a_process_computes_in_the_end_is_given_up() -> None:
    with StageProcesses(["tactile"], int_nothing) as beside:
        worker = beside["tactile"]
        process = worker.submit(os.getpid).result(60)
        worker.submit(time.sleep, 3600.0)
    assert not Path(f"/proc/{process}").exists()


def int_nothing() -> None:
    """No engine."""


def os_exit() -> None:
    import os

    os._exit(1)
