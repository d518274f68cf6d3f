"""The interface between deformscope and the package of a device, version 1.

A package has a `DeviceDriver` for each driver, registered as an entry point; `pip install` is all that a user does:

    [project.entry-points."deformscope.devices"]
    mysensor = "deformscope_mysensor:DRIVER"

The name is that of `driver = "mysensor"` in a rig file. Devices are subclasses of `deformscope_drivers.device.Device`,
which says rate, losses, clock (`health()`), serial number (`identity()`) and what it is (`describe()`). The protocols
below are what is asked besides, by kind. Values are in SI units, or in the unit that ends their name."""

import dataclasses
import importlib.metadata
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

import numpy as np
import numpy.typing as npt

from deformscope_drivers.clock import Clock, Stamp
from deformscope_drivers.doubles import Double
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.framing import FrameDecoder
from deformscope_drivers.health import Description
from deformscope_drivers.health import PadLayout as PadLayout

if TYPE_CHECKING:
    from deformscope_drivers.arm import Arm
    from deformscope_drivers.arm.kinematics import Chain
    from deformscope_drivers.device import Device

VERSION = 1
"""Version of this interface. It rises when a package of an earlier version no longer works."""
GROUP = "deformscope.devices"
Kind = Literal["color", "depth", "tactile", "wrench", "arm", "hand"]
"""What a device gives: colour or depth images, pressures on pads, forces (and torques), an arm's state, a hand's."""
FloatArray = npt.NDArray[np.float64]


# What is asked of a device, by kind -----------------------------------------------------------------------------------


class ForceReading(Protocol):
    """Reading of a force sensor, in the sensor's own frame: a right-handed frame in which positive z is compression.

    counts: (channels, axes) as the sensor sent them; they change from one reading to the next, so that a frozen sensor
    is noticed; overload: axes beyond their range; usable: sensor and wire report no fault
    force_n: (channels, 3) [N], raises DeviceError where the worth of a count is not known
    torque_nm: (channels, 3) [N m], None for a sensor of three axes"""

    @property
    def stamp(self) -> Stamp: ...

    @property
    def counts(self) -> tuple[tuple[int, ...], ...]: ...

    @property
    def force_n(self) -> FloatArray: ...

    @property
    def torque_nm(self) -> FloatArray | None: ...

    @property
    def overload(self) -> Sequence[str]: ...

    @property
    def usable(self) -> bool: ...


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """A plain `ForceReading`."""

    stamp: Stamp
    counts: tuple[tuple[int, ...], ...]
    force_n: FloatArray
    torque_nm: FloatArray | None = None
    overload: tuple[str, ...] = ()
    usable: bool = True


class ForceSensor(Protocol):
    """Force sensor (kind `wrench`): a device of `ForceReading`. Its configuration has `rate_hz`."""

    def zero(self) -> object:
        """Take the present load for zero, 50 readings later at the latest. Raises SettingsRefused where the load
        varies."""


class PadReading(Protocol):
    """pads: (rows, columns) uint16 counts of each pad"""

    @property
    def stamp(self) -> Stamp: ...

    @property
    def pads(self) -> Sequence[npt.NDArray[np.uint16]]: ...


class TactileArray(Protocol):
    """Pads of a hand (kind `tactile`): a device of `PadReading`. `describe` has their layout."""

    def pressure_pa(self, reading: Any) -> Sequence[FloatArray]:
        """(rows, columns) pressure on the texels of each pad [Pa]."""


class AxesReading(Protocol):
    """Axes of a hand (kind `hand`). position_deg, velocity_deg_s: (axes,) [deg], [deg/s]; state: one for each axis,
    with a word as its name; temperature_c: None = not known [deg C]"""

    @property
    def stamp(self) -> Stamp: ...

    @property
    def position_deg(self) -> FloatArray: ...

    @property
    def velocity_deg_s(self) -> FloatArray: ...

    @property
    def state(self) -> Sequence[Enum]: ...

    @property
    def temperature_c(self) -> FloatArray | None: ...


class ArmBody(Protocol):
    """A simulated arm, which moves as its device commands it."""

    @property
    def T_base_links(self) -> FloatArray:
        """Present poses (k, 4, 4) of its joints and, last, of its end effector in the base frame [m]."""

    @property
    def T_base_end_effector(self) -> FloatArray:
        """(4, 4) pose of the end effector [m]."""

    def push(self, wrench: npt.ArrayLike) -> None:
        """From now on (6,) force and torque act on the end effector, in the base frame [N, N m]."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmInLab:
    """A simulated arm among other simulated things. arm: the driver's device, not opened; wire: connection of device
    and double, entered before the arm is opened; None = no thread or process runs; faults: what can go wrong with it on
    a simulated clock, by kind: arm-cable, arm-silent, arm-invalid, arm-turns, arm-frozen"""

    arm: "Arm[Any]"
    body: ArmBody
    wire: AbstractContextManager[Any] | None = None
    faults: Mapping[str, Callable[[], None]] = dataclasses.field(default_factory=dict)


# A package's drivers --------------------------------------------------------------------------------------------------

Scene = Callable[[float], Any]
"""What a double measures: time [s] -> for a force sensor (6,) the force and torque on it [N, N m], for a colour camera
an RGB image (H, W, 3) uint8, for a depth camera a `depth_camera.View`."""


class Redecoder(ABC):
    """Makes readings from one device's recorded bytes, as its driver did: with the same decoder and measurer.

    config: the driver's configuration; said: description of the device, as recorded; name: its name, for messages
    left_out: parts of a frame that its bytes do not determine; compares: the fields of a frame that they determine,
    besides the stamp; listening: whether received bytes are for the decoder now
    late_answers: answers that were too late for the driver give no frame"""

    left_out = ""
    listening = True
    late_answers: ClassVar[bool] = False
    compares: tuple[str, ...]

    def __init__(self, config: Any, said: Description, name: str) -> None:
        self.config, self.said, self.name = config, said, name

    @abstractmethod
    def begin(self) -> FrameDecoder[Any]:
        """Begin a new link, with a new decoder."""

    @abstractmethod
    def measure(self, event: Any, host_ns: int) -> Any:
        """The reading in one event of the decoder; None without one."""

    def send(self, data: bytes) -> None:  # noqa: B027
        """Note bytes that the host sent."""

    def resume(self) -> None:  # noqa: B027
        """Note that the driver set up the device again on the same link."""

    def device(self) -> Any:  # noqa: B027
        """What stands for the device where a reading needs it, as `TactileArray.pressure_pa`."""


@dataclass(frozen=True, slots=True)
class DeviceDriver:
    """A package's description of a driver.

    kind: kind of its frames
    config: its configuration, a frozen dataclass, most often with a default for each field. The fields are the keys in
    a rig file; its `__post_init__` refuses values with ValueError or DeviceError. Fields that are known: `port` (serial
    port, `socket://`, `udp://`), `bus` (CAN, with receive_id, send_id and bitrate), `serial` (the only device that is
    accepted), `rate_hz` and `filter_hz` (force sensor; 0 or none = unfiltered), `fps` (camera), `state_hz` and `model`
    (arm), `library` (a vendor's), `stuck_after_s` (readings that stay the same for so long mean a stuck sensor)
    make: makes a device from a configuration, not opened
    double: makes a byte-exact double for a configuration and a scene (None = one of its own), for any wire
    simulated: the same for a device without bytes: the device itself, not opened, within a context
    redecoder: makes readings from its recorded bytes; None = it exchanges none
    lacks: what a configuration lacks for values in SI units, in words; empty = nothing; complete: the same
    configuration with what it lacks, as that of the double; example: makes a configuration, None = of its defaults
    chains: an arm's kinematics by `config.model`, first that of a configuration without a model; none = a person places
    it; in_lab: makes a simulated arm for a configuration, first joint angles (n,) [deg], None = any, and a clock;
    controller_files: name and text of each file that sets up its controller
    probed: it can be opened with only its port or bus, without a motion; interface: version of this interface; name:
    that of its entry point, set where it is found"""

    kind: Kind
    config: type[Any]
    make: "Callable[[Any], Device[Any]]"
    double: Callable[[Any, Scene | None], Double] | None = None
    simulated: "Callable[[Any, Scene | None], AbstractContextManager[Device[Any]]] | None" = None
    redecoder: type[Redecoder] | None = None
    lacks: Callable[[Any], str] = lambda config: ""
    complete: Callable[[Any], Any] = lambda config: config
    example: Callable[[], Any] | None = None
    chains: "Callable[[], Mapping[str, Chain]]" = dict
    in_lab: Callable[[Any, FloatArray | None, Clock], ArmInLab] | None = None
    controller_files: Callable[[Any], Mapping[str, str]] | None = None
    probed: bool = False
    interface: int = VERSION
    name: str = ""

    @property
    def doubled_config(self) -> Any:
        """A configuration for its double."""
        return self.complete(self.example() if self.example is not None else self.config())

    @property
    def doubled(self) -> bool:
        """Whether it has a double."""
        return self.double is not None or self.simulated is not None

    def chain(self, config: Any, urdf: Path | None = None) -> "Chain | None":
        """The joints of an arm with this configuration, which may have its own as `chain`; None where a person places
        it. urdf: what the arm reported"""
        chains = self.chains()
        model = getattr(config, "model", "") or (urdf.stem if urdf is not None else next(iter(chains), ""))
        return getattr(config, "chain", None) or chains.get(model)


class Drivers(Mapping[str, DeviceDriver]):
    """The installed drivers by name. Only the driver that is asked for is imported."""

    def __init__(self) -> None:
        self._entries: dict[str, importlib.metadata.EntryPoint] = {}
        self._loaded: dict[str, DeviceDriver] = {}

    def __getitem__(self, name: str) -> DeviceDriver:
        """Raises KeyError for a name of no package, DeviceError for a package that cannot be used."""
        if name not in self._loaded:
            entry = self._found()[name]
            package = f"driver {name} ({entry.value})"
            advice = "ask its author, or pip install --upgrade it and deformscope"
            try:
                driver = entry.load()
            except Exception as error:  # whatever a package of others does as it is imported
                came = f"{type(error).__name__}: {' '.join(str(error).split())}"
                raise DeviceError("a package that can be imported", came, advice, package) from error
            if not isinstance(driver, DeviceDriver) or driver.interface != VERSION:
                version = getattr(driver, "interface", "none")
                raise DeviceError(f"a DeviceDriver of interface {VERSION}", f"{version}", advice, package)
            self._loaded[name] = dataclasses.replace(driver, name=name)
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return name in self._found()

    def __iter__(self) -> Iterator[str]:
        return iter(self._found())

    def __len__(self) -> int:
        return len(self._found())

    def of_kind(self, kind: str = "") -> list[DeviceDriver]:
        """The usable drivers of a kind, empty = of all."""
        found = []
        for name in self:
            try:
                found.append(self[name])
            except DeviceError:  # reported where a rig file names it
                continue
        return [driver for driver in found if kind in ("", driver.kind)]

    def _found(self) -> dict[str, importlib.metadata.EntryPoint]:
        if not self._entries:
            entries = [*importlib.metadata.entry_points(group=GROUP), *_of_checkout()]
            # of two with one name this project's: no package replaces a driver unnoticed
            entries.sort(key=lambda entry: (entry.name, entry.dist is None or entry.dist.name == "deformscope"))
            self._entries = {entry.name: entry for entry in entries}
        return self._entries


def _of_checkout() -> list[importlib.metadata.EntryPoint]:
    """The entry points of this project where it runs from its checkout: a driver that was added there needs no new
    installation."""
    path = Path(__file__).parents[2] / "pyproject.toml"
    if not path.is_file():
        return []
    project = tomllib.loads(path.read_text(encoding="utf-8"))["project"]
    own = project["entry-points"][GROUP] if project["name"] == "deformscope" else {}
    return [importlib.metadata.EntryPoint(name, value, GROUP) for name, value in own.items()]


DRIVERS = Drivers()
"""Every installed driver, by the name that a rig file uses."""
