"""Devices for an exploration, not yet opened: arm, force sensor at its end and depth camera, real or doubles.

`rig_setup` makes a `Setup` from a rig file; a laboratory makes its own (`deformscope.lab.scene_lab`)."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.rig.rig_file import Rig, RigDevice, Workspace
from deformscope.rig.sections import CalibrationAge, ShapeSection
from deformscope.rig.source import RigMember, RigSource
from deformscope.robot.advice import advice
from deformscope.robot.by_hand import Person
from deformscope.robot.description import AS_CAPSULES, RobotDescription, describe
from deformscope.robot.placement import Placement
from deformscope.robot.preflight import FORCE_TURNED
from deformscope.robot.robot import Robot, RobotStopped, Waits, Watch, sleep_until
from deformscope.robot.supervisor import Limits
from deformscope_drivers.arm.kinematics import transform
from deformscope_drivers.arm.wrench import ArmWrench, ArmWrenchConfig
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS

ROLES = ("arm", "wrench", "depth")
"""Kinds of the arm, of the force sensor at its end, and of the camera."""
CAMERA_HZ = 30.0
"""Common rates of depth cameras (OpenNI2, RealSense), used if the rig file gives no other."""
FEWEST_PERIODS = 1.5
"""Number of a device's own periods that its limit on silence has at least, because a late reading is no fault."""
T_BASE_SURFACE = transform(np.eye(3), (-0.30, -0.55, 0.0))
"""(4, 4) surface frame to the arm's base frame [m] by default: the arm is 0.15 m beyond the middle of the long edge at
y = 0.4 m, and the far corners are 0.63 m from its axis."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """True properties of a simulated surface. labels: (rows, columns) region of each cell, None without regions;
    inclusions_m: (n, 4) balls below it: x and y of the middle, radius, depth of the uppermost point [m]"""

    labels: IntArray | None
    inclusions_m: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """Projection and pose of the depth camera.

    focal_px, center_px: (x, y) focal length and centre, None = those in its images; distortion: OpenCV's k1, k2, p1,
    p2, k3; T_surface_camera: (4, 4), None = not known; doubt_m: how far off it may be where the surface is; rate_hz"""

    focal_px: tuple[float, float] | None = None
    center_px: tuple[float, float] | None = None
    distortion: tuple[float, ...] = ()
    T_surface_camera: npt.NDArray[np.floating] | None = None
    doubt_m: float = 0.0
    rate_hz: float = CAMERA_HZ


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Opened by `source`, then made one robot by `robot`.

    open_source: opens all devices; names: names of arm, force sensor and camera among them
    compliance_m_per_n, compliance_sd: the arm's compliance under a push and its deviation [m/N]; calibrated: the
    required calibrations before the arm moves, by name, and whether they are done; ages: ages of the calibrations
    simulated: all devices are simulated; truth: the simulation's true values, None without a simulation
    runs_itself: the devices have separate threads and the host's clock, so that they continue during any computation
    zeroed: the force sensor's zero is taken as the devices open
    true_force_n: the largest true contact force so far [N], None if only the sensor measures it
    person: places the arm; None = an arm with motors; described: shape of the robot
    certificate: the rig's bias, by its certificate, as text; empty = none
    press: has a simulated finger press the tip with (3,) [N, surface frame]; None = a person does
    own_wrench: how the arm's own force is read in place of a force sensor; None = a sensor"""

    size_m: tuple[float, float]
    placement: Placement
    workspace: Workspace
    camera: CameraView
    open_source: Callable[[], AbstractContextManager[RigSource]]
    names: tuple[str, str, str]
    compliance_m_per_n: float = 0.0
    compliance_sd: float = 0.0
    calibrated: Mapping[str, bool] = field(default_factory=dict)
    ages: Mapping[str, CalibrationAge] = field(default_factory=dict)
    simulated: bool = False
    truth: Truth | None = None
    runs_itself: bool = True
    zeroed: bool = False
    true_force_n: Callable[[], float] | None = None
    person: Person | None = None
    clock: Clock = monotonic_ns
    wait_until: Waits = sleep_until
    described: RobotDescription = AS_CAPSULES
    certificate: str = ""
    press: Callable[[FloatArray], None] | None = None
    own_wrench: ArmWrenchConfig | None = None

    @property
    def max_force_n(self) -> float | None:
        """The largest true contact force so far [N]; None with real devices, where only the sensor measures it."""
        return None if self.true_force_n is None else self.true_force_n()

    def check_force(self, set_force_n: float) -> None:
        """Raises InputError for a set force [N] that the arm's own force does not resolve."""
        if set_force_n < (least_n := self.placement.tool.resolved_n):
            advice = "a larger one, up to 5 N" if least_n <= 5.0 else "a force sensor at the arm's end"
            raise InputError(
                f"a set force of {least_n:.2f} N or more, for the arm's own force", f"{set_force_n:g} N", advice
            )

    def robot(self, source: RigSource, watch: Watch | None = None) -> Robot:
        """The robot over the open devices, once its arm has reported. watch: as for `Robot`.

        Raises InputError where a device is not well."""
        arm, force, camera = (source.device(name) for name in self.names)
        if not self.zeroed:
            try:
                force.zero()  # type: ignore[attr-defined]
            except DeviceError as error:
                raise InputError.about(error, f"device {self.names[1]}") from error
        limits = Limits.of(self.workspace, camera_hz=self.camera.rate_hz)
        if isinstance(force, ArmWrench):  # as silent as its arm
            silent_s = max(limits.force_silent_s, limits.arm_silent_s) + force.delay_ns / 1e9
            limits = replace(limits, force_silent_s=silent_s)
        robot = Robot(
            arm,  # type: ignore[arg-type]
            force,  # type: ignore[arg-type]
            self.placement,
            limits,
            camera=camera,
            clock=self.clock,
            wait_until=self.wait_until,
            watch=watch,
            compliance_m_per_n=max(0.0, self.compliance_m_per_n - 2.0 * self.compliance_sd),
            doubt_m=self.camera.doubt_m,
        )
        return seen(robot)


def seen(robot: Robot) -> Robot:
    """The same once its arm has reported. Raises InputError where a device is not well."""
    try:
        while not robot.arm_seen:
            robot.cycle()
    except RobotStopped as stopped:
        verdict = stopped.verdict
        came = f"{verdict.fault}: {verdict.reason}"
        raise InputError("devices without faults", came, f"see to {advice(verdict.fault)}") from stopped
    return robot


class SimulatedDevices(Protocol):
    """The scenes of a rig's doubles.

    opener: as for `RigSource`; other attributes as in `Setup`"""

    @property
    def runs_itself(self) -> bool: ...

    @property
    def clock(self) -> Clock: ...

    @property
    def wait_until(self) -> Waits: ...

    @property
    def opener(self) -> Callable[[], None] | None: ...

    def devices(self, entries: Sequence[RigDevice]) -> AbstractContextManager[dict[str, Device[Any]]]:
        """Doubles of these devices, not opened, by name."""


class SimulatedTable(SimulatedDevices, Protocol):
    """A table (`deformscope.lab.live_lab.LiveLab`); attributes as in `Setup`."""

    size_m: tuple[float, float]
    truth: Truth

    @property
    def T_surface_camera(self) -> FloatArray:
        """(4, 4) [m]."""

    @property
    def max_force_n(self) -> float: ...

    @property
    def person(self) -> Person | None: ...

    def push_tip(self, force_n: FloatArray) -> None:
        """Push the tip with (3,) [N] in the surface frame."""


@contextmanager
def open_rig(
    rig: Rig,
    double: Callable[[RigDevice], AbstractContextManager[RigMember]],
    simulated: SimulatedDevices | None,
    around: Sequence[RigDevice],
) -> Iterator[RigSource]:
    """All devices of a rig file, open. double: makes a device of the rig that nothing is simulated around, or its
    double; simulated: the world `around` the doubles, None = none"""
    with ExitStack() as stack:
        made = {} if simulated is None else stack.enter_context(simulated.devices(around))
        members = [
            RigMember(entry.name, entry.driver, made[entry.name], simulated=True, late_ns=entry.late_ns)
            if entry.name in made
            else stack.enter_context(double(entry))
            for entry in rig.devices
        ]
        opener, clock, wait_until = None, monotonic_ns, None
        if simulated is not None:
            opener, clock = simulated.opener, simulated.clock
            wait_until = None if simulated.runs_itself else simulated.wait_until
        with RigSource(members, raw=rig.record.raw, clock=clock, opener=opener, wait_until=wait_until) as source:
            yield source


@dataclass(frozen=True, slots=True, eq=False)
class RigParts:
    """The robot's parts from a rig file. devices: those of `ROLES`; raises InputError without one."""

    rig: Rig
    devices: tuple[RigDevice, ...]
    placement: Placement
    T_surface_camera: FloatArray | None
    described: RobotDescription = AS_CAPSULES

    @classmethod
    def of(cls, rig: Rig) -> "RigParts":
        devices = tuple(only_device(rig, kind) for kind in ROLES)
        force = devices[1]
        if not force.double and (lacking := force.driver.lacks(force.config)):
            raise InputError(lacking, "none", "its section of the rig file", force.name)
        _check_rates(rig, devices)
        # ages count from the time of measurement, so a device's time offset stays below the limit on its silence
        limits = Limits.of(rig.workspace, camera_hz=float(devices[2].config.fps or CAMERA_HZ))
        camera_s = limits.camera_periods * limits.camera_period_s
        for entry, silent_s in zip(devices, (limits.arm_silent_s, limits.force_silent_s, camera_s), strict=True):
            if entry.late_ns >= 1e9 * silent_s:
                least = f"{entry.name} with a delay below its limit on silence, {silent_s:g} s"
                came = f"{entry.late_ns / 1e9:g} s, by calibrate time"
                raise InputError(least, came, "a faster link, or a longer ..._silent_s in [workspace]", rig.name)
        names = ", ".join(entry.name for entry in devices)
        sensors = [one for one in devices if not isinstance(one.config, ArmWrenchConfig)]
        doubled = ", ".join(entry.name for entry in sensors if entry.double)
        real = ", ".join(entry.name for entry in sensors if not entry.double)
        if rig.tool.tip != "sphere":
            raise InputError('[tool] tip = "sphere", to explore with', repr(rig.tool.tip), where=rig.name)
        if not rig.surface.scene and doubled:
            expected = f"{names} all real, or all doubled with a [surface] scene"
            raise InputError(expected, f"{doubled} doubled", 'scene = "two-60-150"', rig.name)
        if rig.surface.scene and real:
            raise InputError(f"double = true for {names}, with a [surface] scene", f"{real} real", where=rig.name)
        given, camera = rig.surface.T_arm_surface, rig.camera.T_arm_camera
        T_base_surface = T_BASE_SURFACE if given is None else np.array(given, dtype=np.float64)
        T_surface_camera = None
        if camera is not None:
            T_surface_camera = np.asarray(np.linalg.inv(T_base_surface) @ np.array(camera), dtype=np.float64)
        return cls(rig, devices, Placement(T_base_surface, rig.tool), T_surface_camera, description_of(rig, devices[0]))


def rig_setup(
    parts: RigParts,
    double: Callable[[RigDevice], AbstractContextManager[RigMember]],
    table: SimulatedTable | None = None,
    give: tuple[float, float] = (0.0, 0.0),
    person: Person | None = None,
) -> Setup:
    """All devices of a rig file.

    double: makes a device of the rig that nothing is simulated around, or its double
    table: table of a `[surface] scene`, over which arm, force sensor and camera are doubles
    person: the person who places a real arm without motors
    give: compliance of a simulated arm and its deviation [m/N], used if the rig file has none"""
    rig, simulated = parts.rig, table is not None
    tool, camera = rig.tool, rig.camera
    known = camera.focal_px is not None and camera.center_px is not None
    as_written = simulated and rig.surface.hidden is None
    compliance = (tool.compliance_m_per_n, tool.compliance_sd)
    if tool.compliance_m_per_n is None:
        compliance = give if simulated else (0.0, 0.0)
    fps = parts.devices[2].config.fps
    force = parts.devices[1].config
    own = force if isinstance(force, ArmWrenchConfig) else None
    return Setup(
        size_m=table.size_m if as_written and table is not None else rig.surface.size_m,
        placement=parts.placement,
        workspace=rig.workspace,
        camera=CameraView(
            camera.focal_px if known else None,
            camera.center_px if known else None,
            camera.distortion,
            table.T_surface_camera if as_written and table is not None else parts.T_surface_camera,
            camera.doubt_m,
            float(fps or (10.0 if simulated else CAMERA_HZ)),
        ),
        open_source=partial(open_rig, rig, double, table, parts.devices),
        names=(parts.devices[0].name, parts.devices[1].name, parts.devices[2].name),
        compliance_m_per_n=compliance[0] or 0.0,
        compliance_sd=compliance[1],
        calibrated={
            "[surface] T_arm_surface": as_written or rig.surface.T_arm_surface is not None,
            "[camera] T_arm_camera": as_written or camera.T_arm_camera is not None,
            "[tool] compliance_m_per_n": simulated or tool.compliance_m_per_n is not None,
            FORCE_TURNED: as_written or tool.R_tip_force is not None,
            **({} if own is None else {"[tool] force_off_n": tool.force_off_n > 0.0}),
        },
        described=parts.described,
        ages=rig.calibrated.ages(),
        certificate="" if rig.certificate is None else str(rig.certificate),
        simulated=simulated,
        truth=None if table is None else table.truth,
        runs_itself=table is None or table.runs_itself,
        true_force_n=None if table is None else lambda: table.max_force_n,
        person=person if table is None else table.person,
        clock=monotonic_ns if table is None else table.clock,
        wait_until=sleep_until if table is None else table.wait_until,
        press=None if table is None else table.push_tip,
        own_wrench=own,
    )


def _check_rates(rig: Rig, devices: tuple[RigDevice, ...]) -> None:
    """Raises InputError where a device's period is longer than the limit on its silence allows."""
    workspace = rig.workspace
    for entry, key, silent_s in zip(
        devices,
        ("state_hz", "rate_hz", "fps"),
        (workspace.arm_silent_s, workspace.force_silent_s, workspace.camera_silent_s),
        strict=True,
    ):
        hz = getattr(entry.config, key)
        if silent_s is not None and hz is not None and hz * silent_s < FEWEST_PERIODS:
            least = (
                f"{key} of {FEWEST_PERIODS / silent_s:.0f} or more for {entry.name}, which fails after "
                f"{silent_s:g} s of silence"
            )
            raise InputError(least, f"{hz:g}", "a higher rate, or a longer ..._silent_s in [workspace]", rig.name)


def only_device(rig: Rig, kind: str, use: str = "to explore with", name: str = "", driver: str = "") -> RigDevice:
    """The one device of a kind. use: its purpose, for the message; name, driver: name and driver of it, empty = any
    (for a depth camera, the one that `[camera]` names); raises InputError if there is none, or several"""
    name = rig.camera.device or "" if kind == "depth" else name
    of_kind = [one for one in rig.devices if one.driver.kind == kind and driver in ("", one.driver.name)]
    found = [one for one in of_kind if name in ("", one.name)]
    if len(found) != 1:
        drivers = [driver] if driver else [one.name for one in DRIVERS.of_kind(kind)]
        came = "none" if not found else ", ".join(entry.name for entry in found)
        named = " or ".join(f'"{one}"' for one in drivers)
        raise InputError(f"one device with driver = {named}, {use}", came, "the rig file", rig.name)
    return found[0]


def description_of(rig: Rig, arm: RigDevice) -> RobotDescription:
    """The robot's description from [shape]. Raises InputError, with the error."""
    if rig.shape == ShapeSection():
        return AS_CAPSULES
    chains = arm.driver.chains()
    if chains and arm.config.model is None:
        raise InputError('model = "..." of the arm, besides [shape]', "none", f'model = "{min(chains)}"', arm.name)
    try:
        return describe(rig.shape, chains[arm.config.model] if chains else None, rig.folder)
    except InputError as error:
        raise InputError.about(error, "[shape]") from error
