"""Squeezes of the laboratory beside what was simulated: their events, the tracked container, the change of depth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.experiments.squeeze_features import (
    SqueezeGeometry,
    TrialFeatures,
    container_model,
    frame_ns,
    trial_features,
)
from deformscope.experiments.squeeze_frames import SqueezeFrames
from deformscope.files.squeeze_dataset import TrialRow
from deformscope.experiments.squeeze_trial import row_of
from deformscope.lab.container_setup import ContainerLab
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.squeeze.container import ModelRenderer
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.patch import SIDE_PX
from deformscope.stages.squeeze.track import PoseEstimate
from deformscope.studies.containers import SqueezeJob, squeeze_trial

LOST_SHARE = 0.1
"""Of the frames and readings of each device, at random, and besides one run of `LOST_RUN` of them."""
LOST_RUN = 5


@dataclass(frozen=True, slots=True)
class EventError:
    """How far an event was found from the truth. periods: after it, in sample periods of its device; held: whether its
    interval held the truth"""

    periods: float
    held: bool


@dataclass(frozen=True, slots=True)
class PoseError:
    """How far a tracked pose was from the truth in the directions that the tracker reports as observed.

    shift_m, turn_deg: in these; observed: how many of the 6; good, reason: the tracker's own verdict
    """

    shift_m: float
    turn_deg: float
    observed: int
    good: bool
    reason: str


@dataclass(frozen=True, slots=True)
class SqueezeErrors:
    """One squeeze beside its truth. row: as a data set keeps it

    first, steady: of the events with all frames; first_lost, steady_lost: with frames lost; None = not found
    poses: of each tracked image
    depth_rms_m, depth_mean_m: of the change of depth over the patch, measured less true; noise_m: deviation of one
    pixel of the camera there; NaN where there was no visual feature
    """

    row: TrialRow
    first: EventError | None
    steady: EventError | None
    first_lost: EventError | None
    steady_lost: EventError | None
    poses: tuple[PoseError, ...]
    depth_rms_m: float
    depth_mean_m: float
    noise_m: float


@dataclass
class _True:
    """What was simulated in each control period."""

    when_ns: list[int] = field(default_factory=list)
    T_hand_container: list[FloatArray] = field(default_factory=list)
    inward_m: list[FloatArray] = field(default_factory=list)

    def note(self, made: ContainerLab) -> None:
        now = made.lab.simulated.world
        self.when_ns.append(made.lab.clock())
        self.T_hand_container.append(now.T_hand_container)
        self.inward_m.append(now.inward_m())

    def at(self, when_ns: int) -> int:
        """Place of the control period nearest to a time."""
        return int(np.abs(np.array(self.when_ns) - when_ns).argmin())


def squeeze_errors(job: SqueezeJob) -> SqueezeErrors:
    """One squeeze of the laboratory, compared; in any process."""
    true = _True()
    trial = squeeze_trial(job, true.note)
    row, found = row_of(trial.entry, trial.found.features), trial.found.features
    nan = float("nan")
    if found is None:
        return SqueezeErrors(row, None, None, None, None, (), nan, nan, nan)
    truth = trial.made.lab.truth()
    first_ns, steady_ns = truth.contact_ns or 0, truth.steady_ns or 0
    all_of = _event_errors(found.events, first_ns, steady_ns)
    periods = found.events.tactile_period_s, found.events.hand_period_s
    lost = _event_errors(with_losses(trial.frames, job.seed).events(), first_ns, steady_ns, periods)
    T_camera_hand = np.linalg.inv(truth.T_hand_camera)
    poses = tuple(
        pose_error(pose, T_camera_hand @ true.T_hand_container[true.at(when_ns)])
        for (when_ns, _), pose in zip(found.tracked, found.poses, strict=True)
    )
    return SqueezeErrors(row, *all_of, *lost, poses, *_depth_errors(trial.made, trial.geometry, trial.frames, found, true))


def with_losses(frames: SqueezeFrames, seed: int) -> SqueezeFrames:
    """The same squeeze without `LOST_SHARE` of what each device gave, and without a run of `LOST_RUN`."""
    random = np.random.default_rng([seed, 0x105])

    def thinned(given: Sequence[object]) -> list[object]:
        lost = random.random(len(given)) < LOST_SHARE
        begin = int(random.integers(max(len(given) - LOST_RUN, 1)))
        lost[begin : begin + LOST_RUN] = True
        return [one for one, gone in zip(given, lost, strict=True) if not gone]

    return dataclasses.replace(
        frames,
        tactile=thinned(frames.tactile),  # type: ignore[arg-type]
        hands=thinned(frames.hands),  # type: ignore[arg-type]
        depth=thinned(frames.depth),  # type: ignore[arg-type]
    )


def _event_errors(
    found: SqueezeEvents, first_ns: int, steady_ns: int, periods_s: tuple[float, float] | None = None
) -> tuple[EventError | None, EventError | None]:
    """periods_s: of tactile frames and of the hand's readings, None = as found"""
    tactile_s, hand_s = periods_s or (found.tactile_period_s, found.hand_period_s)
    return (
        _event_error(found.first_ns, found.first_interval_ns, first_ns, tactile_s),
        _event_error(found.steady_ns, found.steady_interval_ns, steady_ns, hand_s),
    )


def _event_error(found_ns: int, interval_ns: tuple[int, int], true_ns: int, period_s: float) -> EventError | None:
    if not found_ns or not true_ns:
        return None
    return EventError((found_ns - true_ns) / 1e9 / period_s, interval_ns[0] <= true_ns <= interval_ns[1])


def pose_error(found: PoseEstimate, true: FloatArray) -> PoseError:
    """true: (4, 4) T_camera_container"""
    off = np.linalg.inv(found.T_camera_container) @ true
    turn = Rotation.from_matrix(off[:3, :3]).as_rotvec() * found.lever_m
    known = found.directions[found.observed]
    seen = known.T @ (known @ np.concatenate([off[:3, 3], turn]))
    return PoseError(
        float(np.linalg.norm(seen[:3])),
        float(np.degrees(np.linalg.norm(seen[3:]) / found.lever_m)),
        int(found.observed.sum()),
        found.good,
        found.reason,
    )


def _depth_errors(
    made: ContainerLab, geometry: SqueezeGeometry, frames: SqueezeFrames, found: TrialFeatures, true: _True
) -> tuple[float, float, float]:
    """Root mean square and mean of the patch's change of depth, measured less true, and the camera's noise there."""
    features, view = found.features, made.lab.view
    if features.vision is None or features.patch_px is None:
        return (float("nan"),) * 3
    at = true.at(next(frame_ns(one) for one in frames.during(frames.depth) if frame_ns(one) >= found.events.steady_ns))
    pose = np.linalg.inv(view.T_world_camera) @ true.T_hand_container[at]
    hand = min(frames.hands, key=lambda one: abs(frame_ns(one) - true.when_ns[at]))
    exact = view.render(true.inward_m[at], true.T_hand_container[at], np.asarray(hand.position_deg, np.float64)).depth_m
    seen = view.intrinsics
    camera = Intrinsics((seen.fx_px, seen.fy_px), (seen.cx_px, seen.cy_px))
    offset = np.arange(SIDE_PX) - SIDE_PX // 2
    column, row = np.meshgrid(offset + int(features.patch_px[0]), offset + int(features.patch_px[1]))
    rigid = ModelRenderer(container_model(geometry.container), camera).render(pose, np.stack([column, row], axis=-1))
    measured = np.isfinite(features.vision)
    error = (features.vision - (exact[row, column] - rigid.depth_m))[measured]
    error = error[np.isfinite(error)]
    distance = float(np.nanmedian(exact[row, column][measured]))
    return float(np.sqrt(np.mean(error**2))), float(error.mean()), view.config.noise_per_m * distance**2
