"""Squeezes of the laboratory compared with the simulated truth: their events, the tracked container, the change of
depth."""

import dataclasses
import gc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.experiments.squeeze.features import SqueezeGeometry, TrialFeatures, trial_features
from deformscope.experiments.squeeze.frames import SqueezeFrames, frame_ns
from deformscope.experiments.squeeze.placing import row_of
from deformscope.experiments.squeeze.tracking import container_model
from deformscope.files.squeeze_dataset import TrialRow
from deformscope.lab.container_setup import ContainerLab
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.squeeze.container import ContainerModel, ModelRenderer
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.patch import SIDE_PX, filled
from deformscope.stages.squeeze.track import PoseEstimate
from deformscope.stages.squeeze.trial import SqueezeFeatures
from studies.kinect import NOISE_PER_M
from studies.reproduce.container_trials import SqueezedTrial, SqueezeJob, squeeze_trial

T = TypeVar("T")

LOST_SHARE = 0.1
"""Share of each device's frames and readings that is lost at random; one run of `LOST_RUN` is lost in addition."""
LOST_RUN = 5
PERIODS, SHIFT_M, TURN_DEG = 2.0, 0.002, 1.0
"""Tolerances of an event, and of a pose in the observed directions."""
OFF = 5.0
"""Tolerance of a change of depth, in standard deviations of its stated noise."""
LARGER = 1.15
NEAR_MM = 500
NAN = float("nan")

Numbers = dict[str, float | str]
"""Results of one squeeze, by name."""


@dataclass(frozen=True, slots=True)
class PoseError:
    """Error of a tracked pose in the directions that the tracker reports as observed. good: its own verdict"""

    shift_m: float
    turn_deg: float
    good: bool

    @property
    def off(self) -> bool:
        """Whether the error is larger than its tolerance."""
        return self.shift_m > SHIFT_M or self.turn_deg > TURN_DEG


@dataclass
class SimulatedSqueeze:
    """The simulated truth of each control period."""

    when_ns: list[int] = field(default_factory=list)
    T_hand_container: list[FloatArray] = field(default_factory=list)
    inward_m: list[FloatArray] = field(default_factory=list)

    def note(self, made: ContainerLab) -> None:
        """Store the present simulated state."""
        now = made.lab.simulated.world
        self.when_ns.append(made.lab.clock())
        self.T_hand_container.append(now.T_hand_container)
        self.inward_m.append(now.inward_m())

    def at(self, when_ns: int) -> int:
        """Place of the control period nearest to a time."""
        return int(np.abs(np.array(self.when_ns) - when_ns).argmin())


def squeeze_errors(job: SqueezeJob) -> tuple[TrialRow, Numbers]:
    """One squeeze of the laboratory as stored in a data set, and its errors; runs in any process.

    first, steady: times of events less the true ones, in sample periods of their device; and those with lost frames;
    held: 1 if the interval holds the truth. tracked, refused, used_off: images tracked, refused, and not refused but
    wrong; shift_mm, turn_deg: largest errors of images that were not refused. depth_rms_mm, depth_mean_mm: measured
    change of depth less the true one over the patch; noise_mm, depth_stated_mm: noise of one pixel of the camera,
    simulated and stated; depth_off: number of the depth_known values, measured or filled in, with an error of more than
    OFF times the stated noise; wrong_..., hidden_...: tracked, refused and used_off for a model 15 % larger than the
    container, and for a hidden lower half"""
    simulated = SimulatedSqueeze()
    trial = squeeze_trial(job, simulated.note)
    row, numbers = row_of(trial.entry, trial.found.features), _numbers(trial, simulated, job.seed)
    del trial, simulated
    gc.collect()  # laboratory and images hold each other: some 20 MB a trial
    return row, numbers


def _numbers(trial: SqueezedTrial, simulated: SimulatedSqueeze, seed: int) -> Numbers:
    entry, found = trial.entry, trial.found.features
    numbers: Numbers = {"trial": entry.trial, "content": entry.content, "container": entry.container_type}
    if found is None:
        return numbers | {"stopped": entry.discarded or "no features"}
    truth = trial.made.lab.truth()
    true_ns = truth.contact_ns or 0, truth.steady_ns or 0
    periods_s = found.events.tactile_period_s, found.events.hand_period_s
    numbers |= event_errors(found.events, true_ns, periods_s, "")
    numbers |= event_errors(with_losses(trial.frames, seed).events(), true_ns, periods_s, "_lost")
    poses = pose_errors(found, truth.T_hand_camera, simulated)
    numbers |= _tracked("", poses)
    good = [one for one in poses if one.good]
    numbers |= {
        "shift_mm": max((1e3 * one.shift_m for one in good), default=NAN),
        "turn_deg": max((one.turn_deg for one in good), default=NAN),
    }
    numbers |= _depth_errors(trial, found, simulated)
    for name, spoil in SPOILED.items():
        spoiled = trial_features(*spoil(trial.frames, trial.geometry))
        numbers |= _tracked(f"{name}_", pose_errors(spoiled, truth.T_hand_camera, simulated))
    return numbers


def _tracked(start: str, poses: Sequence[PoseError]) -> Numbers:
    return {
        f"{start}tracked": len(poses),
        f"{start}refused": sum(not one.good for one in poses),
        f"{start}used_off": sum(one.good and one.off for one in poses),
    }


# Events --------------------------------------------------------------------------------------------------------------


def with_losses(frames: SqueezeFrames, seed: int) -> SqueezeFrames:
    """The squeeze without `LOST_SHARE` of each device's items, and without a run of `LOST_RUN`."""
    random = np.random.default_rng([seed, 0x105])

    def thinned(given: Sequence[T]) -> list[T]:
        lost = random.random(len(given)) < LOST_SHARE
        begin = int(random.integers(max(len(given) - LOST_RUN, 1)))
        lost[begin : begin + LOST_RUN] = True
        return [one for one, gone in zip(given, lost, strict=True) if not gone]

    kept = thinned(frames.tactile), thinned(frames.hands), thinned(frames.depth)
    return dataclasses.replace(frames, tactile=kept[0], hands=kept[1], depth=kept[2])


def event_errors(
    found: SqueezeEvents, true_ns: tuple[int, int], periods_s: tuple[float, float], ending: str
) -> Numbers:
    """Errors of the times of first contact and steady state, each with its true time and its device's period; NaN = not
    found."""
    numbers: Numbers = {}
    for name, when_ns, interval_ns, at_ns, period_s in (
        ("first", found.first_ns, found.first_interval_ns, true_ns[0], periods_s[0]),
        ("steady", found.steady_ns, found.steady_interval_ns, true_ns[1], periods_s[1]),
    ):
        known = bool(when_ns and at_ns)
        numbers[f"{name}{ending}"] = (when_ns - at_ns) / 1e9 / period_s if known else NAN
        numbers[f"{name}_held{ending}"] = float(known and interval_ns[0] <= at_ns <= interval_ns[1])
    return numbers


# Poses ---------------------------------------------------------------------------------------------------------------


def pose_errors(found: TrialFeatures, T_hand_camera: FloatArray, simulated: SimulatedSqueeze) -> list[PoseError]:
    """Pose error of each tracked image. T_hand_camera: (4, 4) the true pose [m]"""
    T_camera_hand = np.linalg.inv(T_hand_camera)
    return [
        pose_error(one.pose, T_camera_hand @ simulated.T_hand_container[simulated.at(one.when_ns)])
        for one in found.tracked
    ]


def pose_error(found: PoseEstimate, true: FloatArray) -> PoseError:
    """true: (4, 4) T_camera_container"""
    off = np.linalg.inv(found.T_camera_container) @ true
    turn = Rotation.from_matrix(off[:3, :3]).as_rotvec() * found.lever_m
    known = found.directions[found.observed]
    seen = known.T @ (known @ np.concatenate([off[:3, 3], turn]))
    turned = float(np.degrees(np.linalg.norm(seen[3:]) / found.lever_m))
    return PoseError(float(np.linalg.norm(seen[:3])), turned, found.good)


def wrong_model(frames: SqueezeFrames, geometry: SqueezeGeometry) -> tuple[SqueezeFrames, SqueezeGeometry]:
    """The rig file names a container that is larger than the real one."""
    x, y, z = (LARGER * side for side in geometry.container.size_m)
    return frames, dataclasses.replace(geometry, container=dataclasses.replace(geometry.container, size_m=(x, y, z)))


def hidden(frames: SqueezeFrames, geometry: SqueezeGeometry) -> tuple[SqueezeFrames, SqueezeGeometry]:
    """An object hides the lower half of the container."""
    depth = []
    for one in frames.depth:
        image = one.depth.copy()
        image[image.shape[0] // 2 :] = NEAR_MM
        depth.append(dataclasses.replace(one, depth=image))
    return dataclasses.replace(frames, depth=depth), geometry


Spoil = Callable[[SqueezeFrames, SqueezeGeometry], tuple[SqueezeFrames, SqueezeGeometry]]
SPOILED: Mapping[str, Spoil] = {"wrong": wrong_model, "hidden": hidden}


# Depth ---------------------------------------------------------------------------------------------------------------


def _depth_errors(trial: SqueezedTrial, found: TrialFeatures, simulated: SimulatedSqueeze) -> Numbers:
    features, view = found.features, trial.made.lab.view
    if features.vision is None or features.patch_px is None:
        return {"no_vision": features.reason}
    images = trial.frames.during(trial.frames.depth)
    at = simulated.at(next(frame_ns(one) for one in images if frame_ns(one) >= found.events.steady_ns))
    T_camera_container = np.linalg.inv(view.T_world_camera) @ simulated.T_hand_container[at]
    seen = view.intrinsics
    camera = Intrinsics((seen.fx_px, seen.fy_px), (seen.cx_px, seen.cy_px))
    offset = np.arange(SIDE_PX) - SIDE_PX // 2
    column, row = np.meshgrid(offset + int(features.patch_px[0]), offset + int(features.patch_px[1]))
    pixels = np.stack([column, row], axis=-1)
    wall, rigid = (
        ModelRenderer(model, camera).render(T_camera_container, pixels).depth_m
        for model in (ContainerModel(*view.mesh(simulated.inward_m[at])), container_model(trial.geometry.container))
    )
    numbers = depth_errors(features, wall - rigid)
    noise_m = NOISE_PER_M * float(np.nanmedian(wall)) ** 2
    return numbers | {"noise_mm": 1e3 * noise_m}


def depth_errors(features: SqueezeFeatures, change_m: FloatArray) -> Numbers:
    """Errors of the measured depths, and of all depths with those that were filled in, which add no noise.

    change_m: (61, 61) change of the simulated wall, also behind the finger; NaN outside the container: a measured value
    there is an error"""
    assert features.vision is not None
    assert features.noise_m is not None
    measured, known = np.isfinite(features.vision), np.isfinite(change_m)
    error = np.where(known, filled(features.vision) - change_m, np.inf)
    off = np.abs(error) / features.noise_m
    both = measured & known
    return {
        "depth_rms_mm": 1e3 * float(np.sqrt(np.mean(error[both] ** 2))),
        "depth_mean_mm": 1e3 * float(error[both].mean()),
        "depth_stated_mm": 1e3 * features.noise_m,
        "depth_missing": features.missing,
        "depth_known": int((measured | known).sum()),
        "depth_off": int((off > OFF)[measured | known].sum()),
        "depth_worst": float(off[measured].max()),
        "depth_filled_worst": float(off[known & ~measured].max(initial=0.0)),
    }


# All of them ---------------------------------------------------------------------------------------------------------


def truth_rows(every: Sequence[Numbers]) -> list[tuple[str, str]]:
    """Statistics of many squeezes."""
    squeezed = [one for one in every if "stopped" not in one]
    rows = [("squeezes", f"{len(every)}, {len(every) - len(squeezed)} of them stopped early")]
    for ending, frames in (
        ("", "all frames"),
        ("_lost", f"{LOST_SHARE:.0%} of the frames and a run of {LOST_RUN} lost"),
    ):
        for name, event in (("first", "first contact"), ("steady", "steady state")):
            off = numbers_of(squeezed, f"{name}{ending}")
            held = numbers_of(squeezed, f"{name}_held{ending}")
            words = f"{np.mean(np.abs(off) <= PERIODS):.1%} within {PERIODS:g} sample periods, "
            words += f"mean {np.nanmean(off):+.2f}, largest {np.nanmax(np.abs(off)):.2f}; "
            rows.append((f"{event}, {frames}", f"{words}interval holds the truth in {np.mean(held):.1%}"))
    shift, turn = numbers_of(squeezed, "shift_mm"), numbers_of(squeezed, "turn_deg")
    within = np.mean((shift <= 1e3 * SHIFT_M) & (turn <= TURN_DEG))
    words = f"{within:.1%} within {1e3 * SHIFT_M:g} mm and {TURN_DEG:g} deg where observed, "
    rows.append(("pose", f"{words}largest {np.nanmax(shift):.2f} mm and {np.nanmax(turn):.2f} deg"))
    depth, noise = numbers_of(squeezed, "depth_rms_mm"), numbers_of(squeezed, "noise_mm")
    mean = numbers_of(squeezed, "depth_mean_mm")
    words = f"{np.mean(depth <= noise):.1%} within the noise of a pixel ({np.nanmean(noise):.2f} mm): root mean square "
    words += f"{np.nanmean(depth):.2f} mm, largest {np.nanmax(depth):.2f}; mean {np.nanmean(mean):+.2f} mm"
    rows.append(("change of depth", words))
    far, known, worst, filled_worst, missing = (
        numbers_of(squeezed, f"depth_{name}") for name in ("off", "known", "worst", "filled_worst", "missing")
    )
    words = f"{np.nansum(far):.0f} of {np.nansum(known):.0f} values; largest measured {np.nanmax(worst):.1f}, "
    words += f"filled in {np.nanmax(filled_worst):.1f}; {np.nanmean(missing):.0%} missing"
    rows.append((f"off by {OFF:g} times the stated noise", words))
    names = {"": "tracks", "wrong_": "tracks, model 15 % too large", "hidden_": "tracks, lower half hidden"}
    for start, name in names.items():
        tracked, refused, used = (
            int(numbers_of(squeezed, start + one).sum()) for one in ("tracked", "refused", "used_off")
        )
        rows.append((name, f"{tracked}, {refused} refused, {used} not refused and off by more"))
    return rows


def numbers_of(every: Sequence[Numbers], name: str) -> FloatArray:
    """(n,) number of each squeeze, NaN if it has none."""
    return np.array([float(one.get(name, NAN)) for one in every])
