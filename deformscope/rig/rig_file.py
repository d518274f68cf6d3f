"""The rig file: the devices, their ports, and the robot's limits.

TOML, read strictly: an unknown key is an error, because a limit with a typing mistake would be no limit. `lab:NAME`
names a simulated rig that came with the installation."""

import dataclasses
import difflib
import math
import os
import stat
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from deformscope.errors import InputError
from deformscope.file_io import SAMPLE_SCHEME, nearest, resolve, sample_names
from deformscope.rig import sections
from deformscope.rig.sections import CalibratedSection
from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS, DeviceDriver

LAB_SCHEME = "lab:"
EXAMPLE = "deformscope rig new RIG.toml"
NAME_HINT = "letters, digits, - and _, 64 at most"
NAME_CHARACTERS = 64
FILE_BYTES = 100_000
"""Largest rig file: a larger TOML file can be made so that reading it takes minutes."""
PLACE_CHARACTERS = 80
DEEPEST = 16
"""Largest depth of nested tables and lists; a rig needs half of it."""


@dataclass(frozen=True, slots=True)
class RigDevice:
    """One device of a rig.

    name: its name in frames and recordings; config: its driver's own configuration
    double: run a simulated device in its place
    trusted: whether a vendor's library that the configuration names is loaded from any folder
    late_ns: its delay, by `calibrate time` [ns]: it is subtracted from its stamps"""

    name: str
    driver: DeviceDriver
    config: Any
    double: bool = False
    trusted: bool = False
    late_ns: int = 0

    def make(self) -> Device[Any]:
        """The real device, not opened. Raises InputError if its section is incomplete, for example without port and
        bus, or names a library outside of the system's folders while the rig is not trusted."""
        config = self.config
        try:
            if getattr(config, "library", None) and not self.trusted:
                config = dataclasses.replace(config, library=str(system_library(config.library_file())))
            return self.driver.make(config)
        except (DeviceError, InputError) as error:
            raise InputError.about(error, f"device {self.name}") from error


@dataclass(frozen=True, slots=True)
class Camera:
    """Projection and pose of the depth camera.

    device: name of the device; focal_px: (fx, fy); center_px: (cx, cy) [px]
    distortion: OpenCV's k1, k2, p1, p2, k3; T_arm_camera: 4x4, camera to arm base [m]
    doubt_m: uncertainty of T_arm_camera at the surface: points within this distance of the stick are left out"""

    device: str = ""
    focal_px: tuple[float, float] | None = None
    center_px: tuple[float, float] | None = None
    distortion: tuple[float, ...] = ()
    T_arm_camera: tuple[tuple[float, ...], ...] | None = None
    doubt_m: float = 0.0

    def __post_init__(self) -> None:
        sections.check(0 <= self.doubt_m <= 0.03, "doubt_m between 0 and 0.03", self.doubt_m)
        if self.focal_px is not None:
            sections.check(min(self.focal_px) > 0, "focal_px above 0", self.focal_px)
        if self.T_arm_camera is not None:
            sections.check_transform("T_arm_camera", self.T_arm_camera)


CONTACT_SDS, RESOLVED_SDS = 4.0, 10.0
"""Deviations of an arm's own force that mean contact, as which noise counts once in some hundred touches; that a set
force has at least, whose stiffness is then known to a tenth."""


@dataclass(frozen=True, slots=True)
class Tool:
    """The tip of the arm.

    length_m: distance from the arm's end to the tip; tip: its shape; radius_m: radius of the tip
    T_ee_tip: 4x4, tip to the arm's end [m]; default: along z by length_m
    R_tip_force: 3x3, forces in the sensor's axes to the tip's: signs, and a turn about the stick; default: the same
    stick_radius_m: radius of the thickest part between the arm's end and the tip, such as a force sensor: it is removed
    from the camera's image
    compliance_m_per_n: how far the tip stays behind where the arm says it is, for each newton that it presses with;
    compliance_sd: its deviation [m/N]. `deformscope calibrate arm` measures both
    force_gain: the sensor's forces over true forces; force_gain_sd: its deviation, None = not measured: that
    of the data sheet. `deformscope calibrate force --weight` measures both
    force_noise_n: deviation of a reading, and force_off_n: of the force in a touch after its zero, where an arm's own
    force is read (`driver = "arm"`) [N]; 0 = those of a force sensor. `deformscope calibrate wrench` measures both
    weight_n: (3,) weight of all that the force sensor carries, in the base frame, which is taken out of its readings as
    the arm turns; weight_center_m: (3,) its centre of mass in the sensor's frame. `deformscope calibrate tool` measures
    both
    sensor_m: (3,) origin of the force sensor's frame in that of the arm's end [m], about which its torques are
    """

    length_m: float = 0.1
    tip: str = "sphere"
    radius_m: float = 0.01
    T_ee_tip: tuple[tuple[float, ...], ...] | None = None
    compliance_m_per_n: float | None = None
    compliance_sd: float = 0.0
    stick_radius_m: float = 0.008
    R_tip_force: tuple[tuple[float, ...], ...] | None = None
    force_gain: float = 1.0
    force_gain_sd: float | None = None
    force_noise_n: float = 0.0
    force_off_n: float = 0.0
    weight_n: tuple[float, float, float] | None = None
    weight_center_m: tuple[float, float, float] | None = None
    sensor_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        sections.check(0 <= self.length_m <= 1, "length_m between 0 and 1", self.length_m)
        sections.check(self.tip in ("sphere", "disc", "flat"), 'tip = "sphere", "disc" or "flat"', repr(self.tip))
        sections.check(0 < self.stick_radius_m <= 0.1, "stick_radius_m above 0 and up to 0.1", self.stick_radius_m)
        sections.check(0 < self.radius_m <= 0.2, "radius_m above 0 and up to 0.2", self.radius_m)
        if self.T_ee_tip is not None:
            sections.check_transform("T_ee_tip", self.T_ee_tip)
        if self.R_tip_force is not None:
            sections.check_orthogonal("R_tip_force", self.R_tip_force)
        given = self.compliance_m_per_n
        sections.check(given is None or 0 <= given < 0.01, "compliance_m_per_n between 0 and 0.01", given)
        sections.check(0 <= self.compliance_sd < 0.01, "compliance_sd between 0 and 0.01", self.compliance_sd)
        sections.check(0.5 <= self.force_gain <= 2, "force_gain between 0.5 and 2", self.force_gain)
        weight_n = 0.0 if self.weight_n is None else math.hypot(*self.weight_n)
        sections.check(0 <= weight_n <= 100, "weight_n of 100 N or less", self.weight_n)
        sections.check(math.hypot(*self.sensor_m) <= 1, "sensor_m within 1 m", self.sensor_m)
        known_to = self.force_gain_sd
        sections.check(known_to is None or 0 <= known_to <= 0.2, "force_gain_sd between 0 and 0.2", known_to)
        errors_n = self.force_noise_n, self.force_off_n
        sections.check(all(0 <= one <= 20 for one in errors_n), "force_noise_n and force_off_n from 0 to 20", errors_n)

    @property
    def contact_n(self) -> float:
        """Force that means contact [N]."""
        return max(0.1, CONTACT_SDS * math.hypot(self.force_noise_n, self.force_off_n))

    @property
    def resolved_n(self) -> float:
        """The smallest set force of a touch [N]; 0 with a force sensor."""
        return RESOLVED_SDS * math.hypot(self.force_noise_n, self.force_off_n)


USUAL_THICKNESS_M = 0.05
"""Height at which a surface without a stated thickness is sought."""


@dataclass(frozen=True, slots=True)
class SurfaceSection:
    """The explored surface: a sample on a table, whose corner is the origin of the surface frame.

    size_m: sides along x and y; thickness_m: thickness above the table, whose top is at z = 0; None = measured relative
    to the table around it, or unknown if no table is visible: then no modulus is reported
    T_arm_surface: 4x4, surface frame to arm base [m]: x and y along the edges, z up
    scene: a simulated table (`deformscope explore --list-scenarios`), where arm, force sensor and camera are doubles
    hidden: seed from which the true places of these doubles are drawn, to be found by `deformscope calibrate`; None =
    they are at the places in this file"""

    size_m: tuple[float, float] = (0.6, 0.4)
    thickness_m: float | None = None
    T_arm_surface: tuple[tuple[float, ...], ...] | None = None
    scene: str = ""
    hidden: int | None = None

    def __post_init__(self) -> None:
        sections.check(all(0.05 <= side <= 2 for side in self.size_m), "size_m between 0.05 and 2", self.size_m)
        given = self.thickness_m
        sections.check(given is None or 0.005 <= given <= 0.5, "thickness_m between 0.005 and 0.5", given)
        if self.T_arm_surface is not None:
            sections.check_transform("T_arm_surface", self.T_arm_surface)

    @property
    def top_m(self) -> float:
        """Height at which the surface is sought, above the table [m]."""
        return USUAL_THICKNESS_M if self.thickness_m is None else self.thickness_m


@dataclass(frozen=True, slots=True)
class Workspace:
    """Range of the tip, and limits of its force and speed. The default force and speed are far below those that injure
    a person.

    low_m, high_m: corners of a box in the arm's base frame [m]
    arm_low_m, arm_high_m: corners of another box, for elbow, wrist and stick as well as the tip [m]; None = none
    target_force_n, soft_stop_n, hard_stop_n: force of a touch, force at which the arm backs away, and at which it stops
    [N]; contact_speed_m_s: speed in contact and in the last 3 cm before it; travel_speed_m_s: elsewhere [m/s]
    force_silent_s, arm_silent_s, camera_silent_s: limits on silence that stop the arm (the camera's while it is needed;
    None = 1.6 of its periods). Set longer ones for slower devices, or on a busy machine
    time: 0.5 s at most, in which an arm goes up to 25 mm
    arm_frozen_s: stop if the arm receives commands and its joints have not changed at all for this time. The limit is
    longer than an arm takes to begin to move (None = 0.09, or 1.2 times arm_silent_s if that is longer)
    collision_nm: stop if a joint's torque differs by this from its mean of the last 2 s, besides the effect of the
    force on the tip, of an arm that reports torques [Nm]; 0 = no check
    """

    low_m: tuple[float, float, float] | None = None
    high_m: tuple[float, float, float] | None = None
    target_force_n: float = 3.0
    soft_stop_n: float = 8.0
    hard_stop_n: float = 15.0
    contact_speed_m_s: float = 0.02
    travel_speed_m_s: float = 0.05
    force_silent_s: float = 0.03
    arm_silent_s: float = 0.075
    arm_frozen_s: float | None = None
    camera_silent_s: float | None = None
    collision_nm: float = 4.0
    arm_low_m: tuple[float, float, float] | None = None
    arm_high_m: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        _check_box(self.low_m, self.high_m, "")
        _check_box(self.arm_low_m, self.arm_high_m, "arm_")
        forces = self.target_force_n, self.soft_stop_n, self.hard_stop_n
        sections.check(0 < forces[0] < forces[1] < forces[2], "0 < target_force_n < soft_stop_n < hard_stop_n", forces)
        sections.check(forces[2] <= 50, "hard_stop_n up to 50", forces[2])
        speeds = self.contact_speed_m_s, self.travel_speed_m_s
        sections.check(0 < speeds[0] <= speeds[1] <= 0.2, "0 < contact_speed_m_s <= travel_speed_m_s <= 0.2", speeds)
        for name in ("force_silent_s", "arm_silent_s", "arm_frozen_s", "camera_silent_s"):
            given_s = getattr(self, name)
            sections.check(given_s is None or 0.01 <= given_s <= 0.5, f"{name} between 0.01 and 0.5", given_s)
        sections.check(0 <= self.collision_nm <= 50, "collision_nm between 0 and 50", self.collision_nm)

    @property
    def arm_box(self) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
        """arm_low_m and arm_high_m; None = none."""
        return None if self.arm_low_m is None or self.arm_high_m is None else (self.arm_low_m, self.arm_high_m)


def _check_box(low_m: Sequence[float] | None, high_m: Sequence[float] | None, kind: str) -> None:
    sections.check((low_m is None) == (high_m is None), f"both {kind}low_m and {kind}high_m, or neither", "one of them")
    if low_m is not None and high_m is not None:
        rising = all(low < high for low, high in zip(low_m, high_m, strict=True))
        sections.check(rising, f"{kind}low_m below {kind}high_m in every axis", f"{low_m}, {high_m}")


@dataclass(frozen=True, slots=True)
class TouchSection:
    """How the tip touches. tangential: during the press the tip is "held" on the surface's normal, or "free" to follow
    forces across it (Thesis 4.4)"""

    tangential: Literal["held", "free"] = "held"


@dataclass(frozen=True, slots=True)
class Record:
    """How the rig is recorded.

    folder: where recordings go that are not named; raw: record the bytes of every wire in addition to their values
    lossless: cameras whose colour images are recorded as PNG, because results are computed from them (ten times the
    bytes of JPEG)"""

    folder: str = "runs"
    raw: bool = True
    lossless: tuple[str, ...] = ()


SECTIONS: dict[str, Any] = {
    "camera": Camera,
    "tool": Tool,
    "shape": sections.ShapeSection,
    "surface": SurfaceSection,
    "workspace": Workspace,
    "touch": TouchSection,
    "hand": sections.HandSection,
    "container": sections.ContainerSection,
    "squeeze": sections.SqueezeSection,
    "record": Record,
    "calibrated": CalibratedSection,
    "certificate": sections.CertificateSection,
}
"""Sections of a rig file besides its devices."""


@dataclass(frozen=True, slots=True)
class Rig:
    """A rig, read from its file.

    name: name of the file, for titles; text: the file, for recordings; folder: folder of the file, to which its paths
    are relative"""

    name: str
    text: str
    devices: tuple[RigDevice, ...]
    camera: Camera = field(default_factory=Camera)
    tool: Tool = field(default_factory=Tool)
    shape: sections.ShapeSection = field(default_factory=sections.ShapeSection)
    surface: SurfaceSection = field(default_factory=SurfaceSection)
    workspace: Workspace = field(default_factory=Workspace)
    touch: TouchSection = field(default_factory=TouchSection)
    hand: sections.HandSection = field(default_factory=sections.HandSection)
    container: sections.ContainerSection = field(default_factory=sections.ContainerSection)
    squeeze: sections.SqueezeSection = field(default_factory=sections.SqueezeSection)
    record: Record = field(default_factory=Record)
    calibrated: CalibratedSection = field(default_factory=CalibratedSection)
    certificate: sections.CertificateSection | None = None
    folder: Path = Path()

    @property
    def tip_text(self) -> str:
        """The tip, as a certificate states it."""
        return f"{self.tool.tip} of {2e3 * self.tool.radius_m:.4g} mm"

    def corrected(self) -> "Rig":
        """The rig without what its certificate found. Raises InputError without one, and for one of another tip.

        A scale of depth is taken out of the force: under a ball on a thick sample F grows with depth^1.5. Gain, scale
        and tip are known together better than each: the gain has the deviation of the whole bias."""
        found, tool, hint = self.certificate, self.tool, "deformscope certify RIG --sample NAME --save"
        if found is None or tool.compliance_m_per_n is None:
            raise InputError("[certificate], and [tool] compliance_m_per_n", "none", hint, self.name)
        if found.tip != self.tip_text:
            raise InputError(f"a certificate of this tip, a {self.tip_text}", f"of a {found.tip}", hint, self.name)
        value = {name: one[0] for name, one in found.causes.items()}.get
        tool = dataclasses.replace(
            tool,
            radius_m=tool.radius_m * math.exp(value("tip radius", 0.0)),
            force_gain=tool.force_gain * math.exp(value("force gain", 0.0) - 1.5 * value("depth scale", 0.0)),
            force_gain_sd=min(math.log((1.0 + found.interval[1]) / (1.0 + found.interval[0])) / 3.29, 0.2),
            compliance_m_per_n=max(tool.compliance_m_per_n + value("compliance", 0.0), 0.0),
            compliance_sd=found.causes.get("compliance", (0.0, tool.compliance_sd))[1],
        )
        late_ns = round(1e9 * value("clock", 0.0))
        late = {"wrench": max(late_ns, 0), "arm": max(-late_ns, 0)}
        devices = [dataclasses.replace(one, late_ns=one.late_ns + late.get(one.driver.kind, 0)) for one in self.devices]
        return dataclasses.replace(self, tool=tool, devices=tuple(devices))


def load_rig(where: str | Path, *, trusted: bool = False) -> Rig:
    """Read a rig file, or the simulated rig `lab:NAME`. Raises InputError, with the error and its place. trusted:
    vendors' libraries that it names may be loaded from any folder"""
    text = str(where)
    if text.startswith(LAB_SCHEME):
        name, names = text.removeprefix(LAB_SCHEME), scenario_names()
        if name not in names:
            raise InputError("a simulated rig", text, "one of " + ", ".join(f"lab:{one}" for one in names))
        scenario = resources.files("deformscope") / "lab" / "scenarios" / f"{name}.toml"
        return parse_rig(scenario.read_text(encoding="utf-8"), text)
    try:
        content = _read_regular(resolve(text)).decode("utf-8")
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: ~ of a user that there is not
        came = getattr(error, "strerror", None) or (
            "a file without text" if isinstance(error, UnicodeDecodeError) else _line(error)
        )
        near = nearest(text, scenario_names(), LAB_SCHEME) or nearest(text, sample_names(), SAMPLE_SCHEME) or EXAMPLE
        raise InputError("a rig file (TOML), or lab:NAME", came.lower(), near, text) from error
    return parse_rig(content, text, trusted=trusted)


def _read_regular(path: Path) -> bytes:
    """A file's bytes; raises InputError for a source without an end, as a device or a pipe, and a too large file."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe without a writer would block
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise InputError("a rig file (TOML), or lab:NAME", "no regular file", EXAMPLE, path)
        content = os.fdopen(descriptor, "rb", closefd=False).read(FILE_BYTES + 1)
    finally:
        os.close(descriptor)
    if len(content) > FILE_BYTES:
        raise InputError(f"a rig file of up to {FILE_BYTES // 1000} kB", "a larger one", EXAMPLE, path)
    return content


def scenario_names() -> list[str]:
    """The simulated rigs that came with the installation."""
    folder = resources.files("deformscope") / "lab" / "scenarios"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def parse_rig(text: str, where: str, *, trusted: bool = False, others: Sequence[str] = ()) -> Rig:
    """Parse a file's text into a rig.; where: its name, for messages; trusted: as in `load_rig`; others: devices
    without an installed driver, which it may name too: the result is without them"""
    try:
        content = tomllib.loads(text)
    except Exception as error:  # also RecursionError, and ValueError for numbers of thousands of digits
        raise InputError("a rig file in TOML", _line(error), "https://toml.io", where) from error
    try:
        _check_values(content)
        _check_keys(content, ("devices", *SECTIONS), "the rig file")
        devices = content.get("devices", {})
        if not isinstance(devices, dict) or not (devices or others):
            raise InputError("at least one [devices.NAME] section", "none")
        given = {name: content[name] for name in SECTIONS if content.get(name) is not None}
        read = {name: _read(SECTIONS[name], one, f"[{name}]") for name, one in given.items()}
        late = section.late_ns(devices) if (section := read.get("calibrated")) else {}
        members = tuple(
            _device(name, given, trusted, late.get(name, 0))
            for name, given in devices.items()
            if name not in others or not isinstance(given, dict) or str(given.get("driver")) in DRIVERS
        )
        rig = Rig(Path(where).stem, text, members, **read, folder=Path(where).expanduser().parent)
        names = dict.fromkeys((*devices, *others))
        if rig.camera.device and rig.camera.device not in names:
            raise InputError(f"[camera] device out of {', '.join(names)}", repr(rig.camera.device))
        if unknown := [name for name in rig.record.lossless if name not in names]:
            raise InputError(f"[record] lossless out of {', '.join(names)}", ", ".join(map(repr, unknown)))
        return rig
    except InputError as error:
        raise InputError.about(error, where) from error


def _check_values(content: dict[str, Any]) -> None:
    """Every number is finite, every text printable, and nothing nested so deep that looking at it is a risk itself."""
    waiting: list[tuple[str, Any, int]] = [("", content, 0)]
    while waiting:
        place, value, depth = waiting.pop()
        if isinstance(value, dict | list):
            sections.check(depth < DEEPEST, f"at most {DEEPEST} levels of tables and lists", f"more in {place}")
            inner = dict(enumerate(value)) if isinstance(value, list) else value
            if odd := [key for key in inner if not str(key).isprintable()]:
                raise InputError("keys without control characters", repr(str(odd[0])[:PLACE_CHARACTERS]))
            waiting += (
                (f"{place}.{key}"[-PLACE_CHARACTERS:].lstrip("."), one, depth + 1) for key, one in inner.items()
            )
        elif isinstance(value, int | float):
            sections.check(
                abs(value) <= sys.float_info.max, f"{place} that is finite", "inf, nan, or a number that is too large"
            )
        elif isinstance(value, str):
            sections.check(value.isprintable(), f"{place} without control characters", repr(value[:PLACE_CHARACTERS]))


def _device(name: str, given: object, trusted: bool, late_ns: int) -> RigDevice:
    section = f"[devices.{name}]"
    if len(name) > NAME_CHARACTERS or not name.replace("-", "").replace("_", "").isalnum():
        raise InputError(f"a device's name of {NAME_HINT}", repr(name))
    if not isinstance(given, dict):
        raise InputError(f"a section {section}", type(given).__name__)
    rest = dict(given)
    asked = str(rest.pop("driver", ""))
    if asked not in DRIVERS:
        near = nearest(asked, DRIVERS, like=0.6)
        hint = f'driver = "{near}"' if near else "pip install its package, or deformscope new-device"
        raise InputError(f"{section} driver out of {', '.join(DRIVERS)}", repr(asked) if asked else "none", hint)
    try:
        driver = DRIVERS[asked]
    except DeviceError as error:
        raise InputError.about(error, section) from error
    double = rest.pop("double", False)
    if not isinstance(double, bool):
        raise InputError(f"{section} double = true or false", repr(double))
    if double and not driver.doubled:
        raise InputError(f"{section} without double: {driver.name} needs none", "double = true")
    return RigDevice(name, driver, _read(driver.config, rest, section), double, trusted, late_ns)


def _read(kind: type[Any], given: object, section: str) -> Any:
    """A section as its dataclass, strictly: known keys, right types, values that its checks accept."""
    import msgspec

    if not isinstance(given, dict):
        raise InputError(f"a section {section}", type(given).__name__)
    _check_keys(given, [entry.name for entry in dataclasses.fields(kind) if entry.init], section)
    try:
        return msgspec.convert(given, kind)
    except msgspec.ValidationError as error:
        what, at, place = str(error).partition(" - at `$.")  # Expected `int`, got `str` - at `$.speed`
        came = f"{place.rstrip('`')}: {what[0].lower()}{what[1:]}" if at else what
        raise InputError(f"{section} with valid keys", came) from error
    except InputError as error:
        expected, _, came = str(error).removeprefix("expected ").partition("; got ")
        came, _, advice = came.partition(" | try: ")
        advice = advice or "lengths in m, forces in N, speeds in m/s"
        raise InputError(f"{section} with {expected}", came, advice) from error
    except DeviceError as error:
        raise InputError.about(error, section) from error
    except Exception as error:  # a driver's own check; its errors are not of one kind
        raise InputError(f"{section} that its driver accepts", _line(error)) from error


def _check_keys(given: Mapping[str, object], known: Sequence[str], section: str) -> None:
    if unknown := [key for key in given if key not in known]:
        near = difflib.get_close_matches(unknown[0], known, n=1)
        hint = f"{near[0]}" if near else ", ".join(known)
        raise InputError(f"known keys in {section}", ", ".join(map(repr, unknown)), hint)


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


# Vendors' libraries: a loaded one runs with the user's rights, and rig files come from anywhere -----------------------

SYSTEM_FOLDERS = tuple(
    map(Path, ("/lib", "/lib32", "/lib64", "/usr/lib", "/usr/lib32", "/usr/lib64", "/usr/local/lib", "/opt"))
)
ADMINISTRATOR = 0
"""User and group id of the administrator."""
TRY = (
    "install it there, or use --trust-rig, which loads the library that the rig file names and runs it with your rights"
)


def system_library(path: Path) -> Path:
    """The path of a library without links.

    Raises InputError unless it is in one of the system's folders that only the administrator can change."""
    try:
        real = path.resolve()
        folder = next((one for one in map(Path.resolve, SYSTEM_FOLDERS) if real.is_relative_to(one)), None)
        if folder is None:
            listed = ", ".join(map(str, SYSTEM_FOLDERS))
            raise InputError(f"a vendor's library in one of {listed}", "one elsewhere", TRY, path)
        for part in (real, *real.parents):
            if part.exists() and not _is_the_administrators(part):
                raise InputError("a library that only the administrator can change", f"{part} is others'", TRY, path)
            if part == folder:
                break
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: links in a circle
        raise InputError("a readable vendor's library", str(error), TRY, path) from error
    return real


def _is_the_administrators(path: Path) -> bool:
    status = path.stat()
    writable = status.st_mode & stat.S_IWOTH or (status.st_mode & stat.S_IWGRP and status.st_gid != ADMINISTRATOR)
    return status.st_uid == ADMINISTRATOR and not writable
