"""The stages that run with the devices: the frames that each uses, and its computation.

A stage is a pure function of the frames that its result names: the same frames give the same result to the last bit."""

import dataclasses
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, cast

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.arrays import FloatArray, ImageArray, IntArray
from deformscope.errors import InputError
from deformscope.experiments.fit.whole_motion import ParticleOptions, hold_what_is_seen, observe
from deformscope.frames import (
    ArmFrame,
    ColorFrame,
    DepthFrame,
    Frame,
    Item,
    Kind,
    SessionNote,
    Stream,
    TactileFrame,
    WrenchFrame,
)
from deformscope.rig.rig_file import Rig
from deformscope.robot.placement import Placement
from deformscope.stages.fit.calibrate import FitOptions, Model, calibrate
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.map.exploration import SurfaceEstimate, TouchEstimate
from deformscope.stages.map.surface import fit_surface
from deformscope.stages.poke.contact import ArmCompliance, TipKind, fit_approach, fitted_law
from deformscope.stages.poke.tip_wrench import CarriedTool, SensorWindow, TipWrench, tip_wrench
from deformscope.stages.regions.touches import MapGrid
from deformscope.stages.see.arrows import FlowArrows, flow_arrows, region_of
from deformscope.stages.see.cloud import Box, Intrinsics, perceive
from deformscope.stages.see.flow import flow_both_ways
from deformscope.stages.see.particles import ParticleGrid, Tracked, advance, seed_grid, start
from deformscope.stages.see.tactile import TactileContact, tactile_contact
from deformscope_drivers.arm.kinematics import rotation_from_euler_xyz

StageName = Literal["flow", "beta", "surface", "tactile", "contact", "wrench"]
"""Stages that run while a rig is recorded or shown."""

PARTICLES_ALONG = 9
"""Particles along the longer side of the region if neither shape nor spacing is given: a fit takes 0.2 s."""
CANDIDATES = 12
"""Number of values of beta that the sweep tries before it refines: a finer sweep finds the same result."""
NOISE_SHARE = 0.005
"""Share of a tactile sensor's full scale, below which a texel is not in contact."""
CELL_M = 0.01
"""Cell size of the map of a surface [m]."""
DEPTH_ALONG = 160
"""Number of pixels used along a depth image's longer side: lone points are found among 12 000 points in 0.1 s."""
ABOVE_M, BELOW_M = 0.02, 0.03
"""Height range around the surface's top at rest whose points count as surface."""
TOUCHING_N = 0.5
"""Force from which an approach is in contact; it is over at half of it."""
BEFORE_S, LONGEST_S = 0.5, 8.0
"""Data of an approach before that, and its longest duration."""
ALONG_WAY = 0.5
"""Least share of the force along the arm's way: the angle between them is below 60 degrees. An arm that moves through
the air while its sensor is pressed, as on `lab:bench`, gives no stiffness."""
ZERO_NS, HALF_NS = 250_000_000, 60_000_000
"""Time in free air that gives the zero of a force at the tip, and half the window of arm states around a reading: in
0.12 s a pose known to 20 um gives an acceleration within 20 mm/s2 at 125 Hz. A shorter one is noisier by its power of
2.5, a longer one misses a faster motion."""
MOST_WAITING = 10_000
"""Readings, and states of the arm, that wait for a slow computation: 10 s."""
FOLLOW = 0.01
"""Share by which the force without contact follows each reading."""


# What runs, and how --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Stages to run, with their devices and options: everything that determines their results besides the frames.

    color, depth, tactile, wrench, arm: devices by name; lossless: colour images are recorded as PNG
    particles, cluster_size: as in `calibrate beta`; longest_px: longer side to which images are reduced
    focal_px, center_px, distortion, T_surface_camera: focal length, centre, distortion and pose of the camera of the
    depth camera; size_m, thickness_m: size and thickness of the surface [m]
    T_ee_tip: (4, 4) the tool's tip, whose z axis points at the pressed surface, to the arm's end [m]
    R_tip_force: (3, 3) forces in the sensor's axes to the tip's, over the sensor's gain; empty = the same
    tip: its shape; set_force_n: force at which stiffness is reported; compliance_m_per_n, compliance_sd: the arm's
    compliance and its deviation [m/N]
    T_ee_center: (4, 4) middle of the tip to the arm's end [m]; weight_n, weight_center_m, sensor_m: as in `Tool`"""

    names: tuple[StageName, ...] = ()
    color: str = ""
    depth: str = ""
    tactile: str = ""
    wrench: str = ""
    arm: str = ""
    lossless: bool = False
    particles: ParticleOptions = field(default_factory=ParticleOptions)
    cluster_size: int = 3
    longest_px: int = 160
    focal_px: tuple[float, float] = (0.0, 0.0)
    center_px: tuple[float, float] = (0.0, 0.0)
    distortion: tuple[float, ...] = ()
    T_surface_camera: tuple[tuple[float, ...], ...] = ()
    size_m: tuple[float, float] = (0.0, 0.0)
    thickness_m: float = 0.0
    T_ee_tip: tuple[tuple[float, ...], ...] = ()
    R_tip_force: tuple[tuple[float, ...], ...] = ()
    set_force_n: float = 3.0
    compliance_m_per_n: float = 0.0
    compliance_sd: float = 0.0
    tip: TipKind = "sphere"
    T_ee_center: tuple[tuple[float, ...], ...] = ()
    weight_n: tuple[float, float, float] = (0.0, 0.0, 0.0)
    weight_center_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


NEEDS: dict[StageName, tuple[Kind, ...]] = {
    "flow": ("color",),
    "beta": ("color",),
    "surface": ("depth",),
    "tactile": ("tactile",),
    "contact": ("wrench", "arm"),
    "wrench": ("wrench", "arm"),
}
"""The kinds of devices whose frames a stage uses; its results belong to the first."""
REFERENCE: dict[str, Literal["first", "previous"]] = {"flow": "previous", "beta": "first"}
"""The second image of image stages, besides the newest."""


def for_rig(options: LiveOptions, rig: Rig, streams: Sequence[Stream] = ()) -> LiveOptions:
    """The options completed from a rig file's devices and poses; the colour camera may be given already.

    streams: streams of the devices, where they are not the file's.
    Raises InputError where the rig lacks a device or a calibration that a stage needs."""
    kinds: dict[str, Kind] = {one.device: one.kind for one in streams}
    kinds = kinds or {entry.name: entry.driver.kind for entry in rig.devices}
    found: dict[str, Any] = {}
    for name in options.names:
        for kind in NEEDS[name]:
            found[kind] = _device_for(name, kind, options.color if kind == "color" else "", rig, kinds)
    found["lossless"] = bool(streams) or found.get("color") in rig.record.lossless
    camera, tool = rig.camera, rig.tool
    if "surface" in options.names:
        given = {"focal_px": camera.focal_px, "center_px": camera.center_px, "T_arm_camera": camera.T_arm_camera}
        if missing := [name for name, value in given.items() if value is None]:
            raise InputError("a calibrated camera for --stage surface", f"no {missing[0]} in [camera]", where=rig.name)
        if rig.surface.T_arm_surface is None:
            raise InputError("a place for --stage surface", "no T_arm_surface in [surface]", where=rig.name)
        T_surface_camera = np.linalg.inv(np.array(rig.surface.T_arm_surface)) @ np.array(camera.T_arm_camera)
        found |= {"focal_px": camera.focal_px, "center_px": camera.center_px, "distortion": camera.distortion}
        found |= {"T_surface_camera": tuple(map(tuple, T_surface_camera.tolist()))}
        found |= {"size_m": rig.surface.size_m, "thickness_m": rig.surface.top_m}
    if {"contact", "wrench"} & set(options.names):
        found["T_ee_center"] = tuple(map(tuple, Placement(np.eye(4), tool).T_ee_center.tolist()))
        found |= {"weight_n": tool.weight_n or (0.0, 0.0, 0.0), "sensor_m": tool.sensor_m}
        found["weight_center_m"] = tool.weight_center_m or (0.0, 0.0, 0.0)
        along = np.eye(4)
        along[2, 3] = tool.length_m
        found |= {"T_ee_tip": tool.T_ee_tip or tuple(map(tuple, along.tolist())), "tip": tool.tip}
        found |= {"set_force_n": rig.workspace.target_force_n}
        if tool.R_tip_force is not None or tool.force_gain != 1.0:
            turn = np.eye(3) if tool.R_tip_force is None else np.array(tool.R_tip_force)
            found["R_tip_force"] = tuple(map(tuple, (turn / tool.force_gain).tolist()))
        found |= {"compliance_m_per_n": tool.compliance_m_per_n or 0.0, "compliance_sd": tool.compliance_sd}
    return dataclasses.replace(options, **found)


def _device_for(stage: str, kind: Kind, wanted: str, rig: Rig, kinds: Mapping[str, Kind]) -> str:
    """The device of a kind: the one that is named, else the camera of `[camera]`, else the first."""
    names = [name for name, known in kinds.items() if known == kind]
    if wanted and wanted not in names:
        raise InputError(
            f"one of {', '.join(names) or 'no colour cameras'} after --camera", repr(wanted), where=rig.name
        )
    if not names:
        raise InputError(f"a {kind} device for --stage {stage}", "none in the rig", where=rig.name)
    return wanted or (rig.camera.device if rig.camera.device in names else names[0])


def stages_of(options: LiveOptions, streams: Sequence[Stream]) -> "tuple[Stage, ...]":
    """The stages that run on these devices, which are open or were recorded."""
    pads = {stream.device: stream for stream in streams if stream.kind == "tactile"}
    return tuple(Stage(name, options, pads[options.tactile] if name == "tactile" else None) for name in options.names)


@dataclass(frozen=True, slots=True)
class Stage:
    """A stage on devices. stream: stream of the tactile sensor, None for other stages"""

    name: StageName
    options: LiveOptions
    stream: Stream | None = None

    @property
    def device(self) -> str:
        """The device to whose newest frame its results belong."""
        device: str = getattr(self.options, NEEDS[self.name][0])
        return device

    def chooser(self) -> "Chooser":
        """Selects its frames from all items."""
        if self.name == "contact":
            return ApproachChooser(self.options.wrench, self.options.arm)
        if self.name == "wrench":
            return WrenchChooser(self.options.wrench, self.options.arm)
        return NewestFrame(self.device, REFERENCE.get(self.name, ""))

    def packed(self, frames: Sequence[Frame]) -> Any:
        """Input of a process, from the frames that a result will name."""
        return STAGES[self.name][0](frames)

    def compute(self, packed: Any) -> object:
        """The result. Compute the stage's result. It is a pure function: the same frames give the same result to the
        last bit."""
        return STAGES[self.name][1](self, packed)


class Chooser(Protocol):
    """Picks the frames of the next result."""

    skipped: int
    """Number of frames (or approaches) since the last `take` that newer ones replaced before a result was computed from
    them."""

    @property
    def lacks(self) -> str:
        """Text of the items that are missing for a first result."""

    def see(self, item: Item) -> None: ...

    def take(self) -> tuple[Frame, ...] | None:
        """The frames of the next result, the newest last; None without new ones."""


class NewestFrame:
    """The newest frame of a device, with its first frame or the one that was taken before."""

    def __init__(self, device: str, reference: Literal["", "first", "previous"] = "") -> None:
        self.skipped = 0
        self._device, self._reference = device, reference
        self._other: Frame | None = None
        self._newest: Frame | None = None

    @property
    def lacks(self) -> str:
        return f"{'no' if self._other is None else 'only one'} frame of {self._device} came"

    def see(self, item: Item) -> None:
        if not isinstance(item, Frame) or item.device != self._device:
            return
        if self._reference and self._other is None:
            self._other = item
            return
        self.skipped += self._newest is not None
        self._newest = item

    def take(self) -> tuple[Frame, ...] | None:
        newest, self._newest = self._newest, None
        if newest is None:
            return None
        frames = (newest,) if self._other is None else (self._other, newest)
        if self._reference == "previous":
            self._other = newest
        return frames


# The stages ----------------------------------------------------------------------------------------------------------


def _images(frames: Sequence[Frame]) -> tuple[ImageArray, ...]:
    return tuple(cast(ColorFrame, frame).image for frame in frames)


def _flow(stage: Stage, packed: Any) -> FlowArrows:
    """Dense optical flow from the image that was used before to the newest one."""
    before, after = packed
    return flow_arrows(before, after, stage.options.particles.roi_rect, stage.options.longest_px)


def _beta(stage: Stage, packed: Any) -> MomentFit:
    """Particles of the first image where they are in the newest one, and the beta that this pose alone gives.

    A pose that cannot be fitted (too few particles seen, or no held ones) gives particles and the reason."""
    particles = stage.options.particles
    fit = FitOptions(Model(cluster_size=stage.options.cluster_size), candidates=CANDIDATES)
    rest, now = (region_of(image, particles.roi_rect, stage.options.longest_px) for image in packed)
    size = rest.image.shape[:2]
    spacing = None if particles.spacing_px is None else particles.spacing_px / rest.scale
    if spacing is None and particles.grid is None:
        spacing = max(size) / PARTICLES_ALONG
    small = seed_grid(size, None, particles.grid, spacing)
    moved = advance(start(small), *flow_both_ways(rest.image, now.image))
    scale = rest.scale  # from here on in pixels of the whole image
    grid = ParticleGrid(rest.whole(small.rest_px), small.shape, small.cell, small.spacing_px * scale)
    tracked = Tracked(
        *(rest.whole(moved.position_px), moved.noise_px * scale, moved.seen, moved.forward_backward_px * scale)
    )
    nothing = MomentFit(
        rest_px=grid.rest_px,
        observed_px=tracked.position_px,
        simulated_px=np.full_like(tracked.position_px, np.nan),
        seen=tracked.seen,
        held=np.zeros(0, np.int64),
        noise_px=tracked.noise_px,
        parameter="beta",
    )
    try:
        held, _ = hold_what_is_seen(grid, tracked, particles.held, particles.contact_rect)
        found = calibrate([observe(grid, tracked, held, particles)], fit)
    except InputError as error:
        return dataclasses.replace(nothing, verdict_text=f"unidentified: {error}")
    estimate = found.estimate
    return dataclasses.replace(
        nothing,
        simulated_px=found.comparisons[0].simulated,
        held=held,
        value=estimate.value,
        interval=estimate.interval,
        verdict=estimate.verdict,
        verdict_text=estimate.verdict_text(),
        aee_px=estimate.aee,
        explained=nothing.explained if estimate.explained is None else estimate.explained,
    )


def _depth(frames: Sequence[Frame]) -> tuple[ImageArray, float]:
    frame = cast(DepthFrame, frames[-1])
    return frame.depth, frame.unit_m


def _surface(stage: Stage, packed: Any) -> SurfaceEstimate:
    """The surface that the newest depth image shows, as a Gaussian process of its points (Thesis eq. 4.3, 4.4)."""
    depth, unit_m = packed
    options = stage.options
    (width, height), top = options.size_m, options.thickness_m
    box = Box((0.0, 0.0, top - BELOW_M), (width, height, top + ABOVE_M))
    every = max(round(max(depth.shape) / DEPTH_ALONG), 1)
    (fx, fy), (cx, cy) = options.focal_px, options.center_px
    camera = Intrinsics((fx / every, fy / every), (cx / every, cy / every), options.distortion)
    T_surface_camera = np.array(options.T_surface_camera, dtype=np.float64)
    seen = perceive(depth[::every, ::every] * unit_m, camera, T_surface_camera, box, cell_m=CELL_M)
    surface = fit_surface(seen.points_m, noise_m=seen.noise_m, within_m=((0.0, 0.0), options.size_m))
    heights = surface.on(MapGrid(options.size_m, CELL_M))
    return SurfaceEstimate(seen.points_m, heights.mean_m, heights.deviation_m, CELL_M)


def _tactile(stage: Stage, packed: Any) -> TactileContact:
    """Centre of pressure, contact area and force of every pad in the newest tactile frame."""
    assert stage.stream is not None
    texel_m = [pad.texel_m for pad in stage.stream.pads]
    return tactile_contact(packed, texel_m, NOISE_SHARE * stage.stream.full_scale_pa)


@dataclass(frozen=True, slots=True)
class ApproachReadings:
    """Readings of arm and force sensor of an approach.

    arm_ns: (m,) stamps; position_m: (m, 3) position of the arm's end; rotation_rad: (m, 3) its Euler angles, in the
    arm's base; force_ns: (n,); force_n: (n, 3) force of the tip on the surface, in the tip's frame"""

    arm_ns: IntArray
    position_m: FloatArray
    rotation_rad: FloatArray
    force_ns: IntArray
    force_n: FloatArray


class ApproachChooser:
    """The newest approach that has ended: contact by force, the arm's way since shortly before. contact_ns: its time"""

    before_s, longest_s = BEFORE_S, LONGEST_S

    def __init__(self, wrench: str, arm: str) -> None:
        self.skipped = self.contact_ns = self._force_ns = 0
        self._wrench, self._arm = wrench, arm
        self._recent: deque[ArmFrame | WrenchFrame] = deque()
        self._free_n: FloatArray | None = None
        self._since_ns: int | None = None
        self._ended: tuple[Frame, ...] | None = None

    @property
    def lacks(self) -> str:
        if self._free_n is None:
            return f"no force of {self._wrench} arrived"
        began = self._since_ns is not None
        return (
            "an approach has not ended" if began else f"no approach: {self._wrench} measures less than {TOUCHING_N:g} N"
        )

    def see(self, item: Item) -> None:
        if isinstance(item, ArmFrame) and item.device == self._arm:
            self._recent.append(item)
        elif isinstance(item, WrenchFrame) and item.device == self._wrench and np.isfinite(item.force_n[0]).all():
            self._recent.append(item)
            force, ns = item.force_n[0], item.stamp.host_ns
            if self._free_n is None:
                self._free_n = force
            passed_s, self._force_ns = (ns - self._force_ns) / 1e9, ns
            change_n = float(np.linalg.norm(force - self._free_n))
            if self._since_ns is None:
                if change_n > TOUCHING_N:
                    self._since_ns = ns
                else:
                    self._free_n = self._free_n + self._follow(passed_s) * (force - self._free_n)
            elif change_n < 0.5 * TOUCHING_N or ns - self._since_ns > self.longest_s * 1e9:
                self._end()
        span_ns = (self.before_s + (self.longest_s if self._since_ns is not None else 0.0)) * 1e9
        while self._recent and self._recent[-1].stamp.host_ns - self._recent[0].stamp.host_ns > span_ns:
            self._recent.popleft()

    def _end(self) -> None:
        self.contact_ns, self._since_ns = self._since_ns or 0, None
        self.skipped += self._ended is not None
        self._ended = tuple(self._recent)
        self._recent.clear()

    def _follow(self, passed_s: float) -> float:
        """Share by which the force without contact follows a reading, after this time since the one before."""
        return FOLLOW

    def take(self) -> tuple[Frame, ...] | None:
        ended, self._ended = self._ended, None
        return ended


class WrenchChooser:
    """The newest reading with states of the arm on both sides, besides those of the first ZERO_NS, in free air. A tare
    of the sensor starts it again."""

    def __init__(self, wrench: str, arm: str) -> None:
        self.skipped = 0
        self._wrench, self._arm = wrench, arm
        self._free: list[Frame] = []
        self._arms: deque[ArmFrame] = deque(maxlen=MOST_WAITING)
        self._readings: deque[WrenchFrame] = deque(maxlen=MOST_WAITING)
        self._since_ns = 0

    @property
    def lacks(self) -> str:
        return f"no force of {self._wrench} in {1e-9 * ZERO_NS:g} s of states of {self._arm}"

    def see(self, item: Item) -> None:
        if isinstance(item, SessionNote) and item.about == "tare" and item.text == self._wrench:
            self._free, self._since_ns = [], 0
            self._arms.clear()
            self._readings.clear()
        elif isinstance(item, ArmFrame) and item.device == self._arm and np.isfinite(item.position_m).all():
            self._arms.append(item)
            self._since_ns = self._since_ns or item.stamp.host_ns
        elif isinstance(item, WrenchFrame) and item.device == self._wrench and np.isfinite(item.force_n[0]).all():
            self._readings.append(item)

    def take(self) -> tuple[Frame, ...] | None:
        if not self._arms:
            return None
        newest_ns, since_ns = self._arms[-1].stamp.host_ns, self._since_ns
        if not self._free:
            if newest_ns < since_ns + ZERO_NS + HALF_NS or not self._readings:
                return None
            readings = [one for one in self._readings if 0 <= one.stamp.host_ns - since_ns <= ZERO_NS]
            arms = [one for one in self._arms if one.stamp.host_ns <= since_ns + ZERO_NS]
            if not readings:
                self._since_ns = 0
                return None
            self._free = [*arms, *readings]
        ready = [
            one for one in self._readings if since_ns + ZERO_NS + HALF_NS < one.stamp.host_ns <= newest_ns - HALF_NS
        ]
        if not ready:
            return None
        now = ready[-1]
        while self._readings and self._readings[0].stamp.host_ns <= now.stamp.host_ns:
            self._readings.popleft()
        while self._arms[0].stamp.host_ns < now.stamp.host_ns - HALF_NS:
            self._arms.popleft()
        self.skipped += len(ready) - 1
        around = [one for one in self._arms if one.stamp.host_ns <= now.stamp.host_ns + HALF_NS]
        return (*self._free, *around, now)


def _wrench_windows(frames: Sequence[Frame]) -> tuple[SensorWindow, SensorWindow]:
    """The window of free air, and that of the last reading."""
    now = cast(WrenchFrame, frames[-1])
    arms = [frame for frame in frames if isinstance(frame, ArmFrame)]
    free = [frame for frame in frames[:-1] if isinstance(frame, WrenchFrame)]
    last_ns = now.stamp.host_ns - HALF_NS
    middle_ns = (free[0].stamp.host_ns + free[-1].stamp.host_ns) // 2
    return (
        _window([one for one in arms if one.stamp.host_ns < last_ns], free, middle_ns),
        _window([one for one in arms if one.stamp.host_ns >= last_ns], [now], now.stamp.host_ns),
    )


def _window(arms: Sequence[ArmFrame], readings: Sequence[WrenchFrame], at_ns: int) -> SensorWindow:
    torques_nm = [one.torque_nm[0] for one in readings if one.torque_nm is not None]
    return SensorWindow(
        np.array([1e-9 * (one.stamp.host_ns - at_ns) for one in arms]),
        np.array([one.position_m for one in arms]).reshape(-1, 3),
        np.array([rotation_from_euler_xyz(*one.rotation_rad.tolist()) for one in arms]).reshape(-1, 3, 3),
        np.mean([one.force_n[0] for one in readings], axis=0),
        np.mean(torques_nm, axis=0) if torques_nm else None,
    )


def _tip_wrench(stage: Stage, packed: Any) -> TipWrench:
    """Force and torque of the tip on the world, without weight and motion of the tool."""
    options = stage.options
    turn = np.array(options.R_tip_force) if options.R_tip_force else np.eye(3)
    gain = 1.0 / float(np.linalg.norm(turn[0]))
    tool = CarriedTool(
        np.array(options.T_ee_center),
        np.array(options.sensor_m),
        gain * turn,
        np.array(options.weight_n),
        np.array(options.weight_center_m),
    )
    free, now = packed
    return tip_wrench(free, now, tool, gain)


def _approach(frames: Sequence[Frame]) -> ApproachReadings:
    arms = [frame for frame in frames if isinstance(frame, ArmFrame)]
    forces = [frame for frame in frames if isinstance(frame, WrenchFrame)]
    return ApproachReadings(
        np.array([frame.stamp.host_ns for frame in arms], np.int64),
        np.array([frame.position_m for frame in arms]).reshape(-1, 3),
        np.array([frame.rotation_rad for frame in arms]).reshape(-1, 3),
        np.array([frame.stamp.host_ns for frame in forces], np.int64),
        np.array([frame.force_n[0] for frame in forces]).reshape(-1, 3),
    )


def _contact(stage: Stage, packed: Any) -> TouchEstimate:
    """Stiffness of the touched place, by arm and force sensor alone."""
    options = stage.options
    arm = ArmCompliance(options.compliance_m_per_n, options.compliance_sd)
    if options.R_tip_force:
        packed = dataclasses.replace(packed, force_n=packed.force_n @ np.array(options.R_tip_force).T)
    return fit_contact(packed, np.array(options.T_ee_tip, dtype=np.float64), options.set_force_n, arm, options.tip)


def fit_contact(
    approach: ApproachReadings, T_ee_tip: FloatArray, set_force_n: float, arm: ArmCompliance, tip: TipKind
) -> TouchEstimate:
    """The law of an approach, along the way that the tip took while it pressed. T_ee_tip: (4, 4) [m].

    Raises InputError where the arm did not press, and where the law cannot be fitted."""
    if len(approach.arm_ns) < 2:
        raise InputError("an arm that reports its pose during contact", f"{len(approach.arm_ns)} states")
    rotations = np.stack([rotation_from_euler_xyz(*angles) for angles in approach.rotation_rad])
    turned, tip_m = rotations @ T_ee_tip[:3, :3], approach.position_m + rotations @ T_ee_tip[:3, 3]
    at_arm = [np.interp(approach.arm_ns, approach.force_ns, approach.force_n[:, axis]) for axis in range(3)]
    force_n = -np.einsum("nij,nj->ni", turned, np.stack(at_arm, axis=1))
    peak = int(np.argmax(np.linalg.norm(force_n, axis=1)))
    way = tip_m[peak] - tip_m[0]
    length = float(np.linalg.norm(way))
    if length < 1e-4:
        raise InputError("an arm that moves into the surface", f"{length * 1e3:.2g} mm of way")
    normal, pressed_n = -way / length, force_n[peak] - force_n[0]
    share = float(pressed_n @ normal / np.linalg.norm(pressed_n))
    if not share >= ALONG_WAY:  # nan: no force at all
        raise InputError(
            "an arm that presses along its direction of motion", f"{share:.0%} of the force in that direction"
        )
    time_s = (approach.arm_ns - approach.arm_ns[0]) / 1e9
    fit = fit_approach(time_s, tip_m, force_n, normal, tip=tip, set_force_n=set_force_n, arm=arm)
    along, force_n, tip_m = -(tip_m @ normal)[: peak + 1], force_n[: peak + 1], tip_m[: peak + 1]
    return TouchEstimate(
        number=1,
        xyz_m=tip_m[peak],
        normal=normal,
        approach_m=along - along[0],
        approach_n=force_n @ normal,
        fitted_n=fitted_law(fit, arm, along),
        contact_m=fit.contact_m - float(along[0]),
        stiffness_n_per_mm=fit.stiffness_n_per_mm,
        stiffness_interval=fit.interval_n_per_mm,
        rigid=fit.rigid,
        depth_m=fit.dent_m(min(fit.at_force_n, fit.peak_force_n)),
        peak_force_n=fit.peak_force_n,
        observed_m=np.zeros((0, 3)),
        simulated_m=np.zeros((0, 3)),
    )


STAGES: dict[StageName, tuple[Callable[[Sequence[Frame]], Any], Callable[[Stage, Any], object]]] = {
    "flow": (_images, _flow),
    "beta": (_images, _beta),
    "surface": (_depth, _surface),
    "tactile": (lambda frames: cast(TactileFrame, frames[-1]).pressure_pa, _tactile),
    "contact": (_approach, _contact),
    "wrench": (_wrench_windows, _tip_wrench),
}
"""The stages' inputs, from their frames, and their computations."""


def compute(stage: Stage, packed: Any) -> object:
    """A stage's result, computed on one thread, so that it does not depend on the number of cores."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            return stage.compute(packed)
    finally:
        cv2.setNumThreads(threads)
