"""The vendor's library on the user's machine, called through ctypes; nothing of the vendor's is shipped.

There are two libraries: USBCommandLayerUbuntu.so, and EthCommandLayerUbuntu.so whose functions have the prefix
`Ethernet_`. Neither exports all that the headers declare, so each function is looked up when it is first called.
Parameters that the headers write as `T &` are pointers; points and devices go by value."""

import ctypes
from collections.abc import Callable
from ctypes import POINTER, c_float, c_int
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

from deformscope_drivers.errors import LibraryMissing
from deformscope_drivers.jaco import structures
from deformscope_drivers.jaco.errors import OK, SymbolMissing, error_of

Connection = Literal["usb", "ethernet"]
LIBRARY_NAMES: dict[Connection, str] = {"usb": "USBCommandLayerUbuntu.so", "ethernet": "EthCommandLayerUbuntu.so"}
PREFIXES: dict[Connection, str] = {"usb": "", "ethernet": "Ethernet_"}

S = TypeVar("S", bound=ctypes.Structure)

# name: argument types; each returns an int, 1 for success (GetDevices: how many devices, its status by pointer)
SIGNATURES: dict[str, tuple[Any, ...]] = {
    # the library and its devices
    "GetAPIVersion": (structures.ApiVersion,),
    "InitAPI": (),
    "InitEthernetAPI": (POINTER(structures.EthernetCommConfig),),
    "CloseAPI": (),
    "RefresDevicesList": (),  # the vendor's spelling
    "GetDevices": (structures.DeviceList, POINTER(c_int)),
    "SetActiveDevice": (structures.KinovaDevice,),
    "GetGeneralInformations": (POINTER(structures.GeneralInformations),),
    # control and motion
    "StartControlAPI": (),
    "StopControlAPI": (),
    "SendBasicTrajectory": (structures.TrajectoryPoint,),
    "EraseAllTrajectories": (),
    "GetGlobalTrajectoryInfo": (POINTER(structures.TrajectoryFIFO),),
    "MoveHome": (),
    "InitFingers": (),
    # readings
    **{
        f"GetAngular{what}": (POINTER(structures.AngularPosition),)
        for what in ("Position", "Velocity", "Force", "ForceGravityFree", "Current")
    },
    **dict.fromkeys(("GetCartesianPosition", "GetCartesianForce"), (POINTER(structures.CartesianPosition),)),
    "GetCommandVelocity": (structures.CartesianRates, structures.AngularRates),
    "GetForcesInfo": (POINTER(structures.ForcesInfo),),
    "GetSensorsInfo": (POINTER(structures.SensorsInfo),),
    "GetQuickStatus": (POINTER(structures.QuickStatus),),
    # protection zones
    "EraseAllProtectionZones": (),
    "SetProtectionZone": (structures.ZoneList,),
    "GetProtectionZone": (POINTER(structures.ZoneList),),
    # force
    "StopForceControl": (),
    "SetTorqueSafetyFactor": (c_float,),
    "SetGravityType": (c_int,),
}


def library_file(path: str | Path, connection: Connection) -> Path:
    """The library file of a path: the file itself, or the file of the vendor's name in a folder."""
    chosen = Path(path).expanduser()
    return chosen / LIBRARY_NAMES[connection] if chosen.is_dir() else chosen


class Functions(Protocol):
    """The vendor's functions by name: the library itself, or a double of it."""

    @property
    def where(self) -> str:
        """The library's path, for errors."""

    def function(self, name: str) -> Callable[..., int]:
        """The function of that name without prefix, taking the structures of `structures`."""


class Library:
    """The vendor's shared library. The vendor's library, which is not loaded before the first call of a function."""

    def __init__(self, path: str | Path | None = None, connection: Connection = "usb") -> None:
        """path: the library, or the folder that holds it; None leaves the search to the system's loader."""
        if connection not in PREFIXES:
            raise ValueError(f"expected a connection among {', '.join(PREFIXES)}; came {connection!r}")
        self.where = LIBRARY_NAMES[connection] if path is None else str(library_file(path, connection))
        self._prefix = PREFIXES[connection]
        self._handle: ctypes.CDLL | None = None
        self._functions: dict[str, Callable[..., int]] = {}

    def load(self) -> ctypes.CDLL:
        """The loaded library; raises LibraryMissing with the searched places."""
        if self._handle is None:
            try:
                self._handle = ctypes.CDLL(self.where)
            except OSError as error:
                advice = (
                    "get it from Kinova (it is in the kinova-ros repository, kinova_driver/lib) and give its path, "
                    "or put its folder into LD_LIBRARY_PATH before this program starts"
                )
                raise LibraryMissing("the vendor's library", str(error), advice, self.where) from error
        return self._handle

    def function(self, name: str) -> Callable[..., int]:
        """A function by its name without prefix; raises SymbolMissing where this library does not export it."""
        found = self._functions.get(name)
        if found is None:
            symbol = self._prefix + name
            handle = self.load()
            try:
                found = handle[symbol]
            except AttributeError as error:
                advice = "check that the connection (usb or ethernet) is that of the library, and its version (5.2.0)"
                raise SymbolMissing(
                    f"a library that exports {symbol}", "none of that name", advice, self.where
                ) from error
            found.argtypes = SIGNATURES[name]
            found.restype = c_int
            self._functions[name] = found
        return found


def call(functions: Functions, name: str, *arguments: object) -> None:
    """Call a function and raise the named exception if its code is not success."""
    code = functions.function(name)(*arguments)
    if code != OK:
        raise error_of(code, name, functions.where)


def read(functions: Functions, name: str, kind: type[S]) -> S:
    """Call a function that fills one structure, zeroed before: six-joint arms do not change the seventh joint."""
    response = kind()
    call(functions, name, response)
    return response


def devices(functions: Functions) -> list[structures.KinovaDevice]:
    """The arms that the library lists."""
    listed, status = structures.DeviceList(), c_int(OK)
    count = functions.function("GetDevices")(listed, status)
    if status.value != OK:
        raise error_of(status.value, "GetDevices", functions.where)
    return list(listed[: max(0, min(count, len(listed)))])


def api_version(functions: Functions) -> tuple[int, int, int]:
    """The library's own version."""
    version = structures.ApiVersion()
    call(functions, "GetAPIVersion", version)
    return (version[0], version[1], version[2])
