"""Bringing an arm up, in the order that the vendor's own driver keeps, and letting it go again."""

import contextlib
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deformscope_drivers.arm.kinematics import Chain, pose_error, rotation_from_euler_xyz, transform
from deformscope_drivers.errors import DeviceError, NotConnected, SettingsRefused
from deformscope_drivers.jaco.chains import CHAINS
from deformscope_drivers.jaco.config import EthernetAddresses, JacoConfig
from deformscope_drivers.jaco.errors import NoDeviceFound
from deformscope_drivers.jaco.library import Functions, api_version, call, devices, read
from deformscope_drivers.jaco.structures import (
    AngularPosition,
    CartesianPosition,
    DeviceType,
    EthernetCommConfig,
    GeneralInformations,
    KinovaDevice,
    PositionType,
    TrajectoryPoint,
    actuator_values,
    cartesian_values,
)
from deformscope_drivers.jaco.zones import set_zones

PAUSE_S = 0.05  # between stopping the control and starting it again
CONFIGURATION_GAP_S = 0.1  # between two writes to the arm's configuration
SEARCH_FIRST_S = 0.5  # before an arm that was not found is sought again; then twice as long each time
GRAVITY_MANUAL = 0
POSE_MM, POSE_DEG = 5.0, 2.0
"""Models and tools differ by centimetres; what an arm that is led by its joystick moves within a call is less."""

_MODELS = {
    DeviceType.JACO2_6DOF: "j2n6s300",
    DeviceType.JACO2_6DOF_ASSISTIVE: "j2n6s300",
    DeviceType.SPHERICAL_6DOF: "j2s6s300",
    DeviceType.SPHERICAL_7DOF: "j2s7s300",
}


@dataclass(frozen=True, slots=True)
class JacoIdentity:
    """The arm that was opened, and its library and connection.

    library_version: the vendor's library's; firmware: version in the device list; chain: its kinematics"""

    serial: str
    model: str
    firmware: tuple[int, int, int]
    library_version: tuple[int, int, int]
    chain: Chain


def bring_up(functions: Functions, config: JacoConfig, pause: Callable[[float], None]) -> JacoIdentity:
    """Initialise the library, choose the arm, and take control of it; nothing moves without a command to the fingers.
    pause: function that waits for this number of seconds. Raises the named exception of any error."""
    version = api_version(functions)
    device = _find(functions, config, pause)
    call(functions, "SetActiveDevice", device)
    read(functions, "GetGeneralInformations", GeneralInformations)
    identity = _identify(device, version, config, functions.where)
    # after a cold boot the arm may ignore the first start; erase what an earlier program may have left
    call(functions, "StartControlAPI")
    call(functions, "StopControlAPI")
    call(functions, "EraseAllTrajectories")
    pause(PAUSE_S)
    call(functions, "StartControlAPI")
    call(functions, "SetGravityType", GRAVITY_MANUAL)
    pause(CONFIGURATION_GAP_S)
    call(functions, "SetTorqueSafetyFactor", 1.0)
    if config.protection_zones is not None:
        pause(CONFIGURATION_GAP_S)
        set_zones(functions, config.protection_zones, lambda: pause(CONFIGURATION_GAP_S))
    zero = TrajectoryPoint()
    zero.Position.Type = PositionType.CARTESIAN_VELOCITY
    call(functions, "SendBasicTrajectory", zero)
    if config.initialize_fingers:
        call(functions, "InitFingers")
    return identity


def check_pose(functions: Functions, chain: Chain) -> None:
    """Raise SettingsRefused unless the arm reports its hand where its model's kinematics have it.

    Everything else takes the hand's pose from the joint angles. An arm of another model than it reports, or one with a
    stored tool offset, would move and touch at wrong places."""
    angles = read(functions, "GetAngularPosition", AngularPosition)
    pose = cartesian_values(read(functions, "GetCartesianPosition", CartesianPosition).Coordinates)
    later = read(functions, "GetAngularPosition", AngularPosition)  # it may be moved by its joystick meanwhile
    both = [actuator_values(one.Actuators, chain.joint_count) for one in (angles, later)]
    ours = chain.end_effector(np.mean(both, axis=0))
    theirs = transform(rotation_from_euler_xyz(*pose[3:]), pose[:3])
    error = pose_error(ours, theirs)
    off_mm, off_deg = 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
    if not (off_mm <= POSE_MM and off_deg <= POSE_DEG):
        within = f"within {POSE_MM:g} mm and {POSE_DEG:g} deg of the pose of a {chain.name} at these angles"
        came = f"one that the arm reports {off_mm:.1f} mm and {off_deg:.1f} deg away"
        advice = (
            "another `model`; or set the tool offset that is stored in the arm to zero (SetEndEffectorOffset, Kinova's "
            "Development Center): the tool belongs into the rig file"
        )
        raise SettingsRefused(f"the arm's hand {within}", came, advice, functions.where)


def let_go(functions: Functions) -> DeviceError | None:
    """Stop the arm and release it, continuing after any failure; returns why its trajectories could not be erased, or
    nothing."""
    not_erased = _try(functions, "EraseAllTrajectories")
    if not_erased is not None:
        not_erased = _try(functions, "EraseAllTrajectories")
    for name in ("StopForceControl", "StopControlAPI", "CloseAPI"):
        _try(functions, name)
    return not_erased


def _try(functions: Functions, name: str) -> DeviceError | None:
    try:
        call(functions, name)
    except DeviceError as error:
        return error
    return None


def _find(functions: Functions, config: JacoConfig, pause: Callable[[float], None]) -> KinovaDevice:
    """The arm that is meant. One that is not found is sought again: after a crash the first search often fails."""
    wait_s = SEARCH_FIRST_S
    for attempt in range(1, config.open_attempts + 1):
        try:
            if config.connection == "ethernet":
                call(functions, "InitEthernetAPI", ethernet_structure(config.ethernet))
            else:
                call(functions, "InitAPI")
            functions.function("RefresDevicesList")()  # whether there is an arm shows in the list itself
            return _choose(devices(functions), config.serial, functions.where)
        except NoDeviceFound:
            with contextlib.suppress(DeviceError):
                call(functions, "CloseAPI")
            if attempt == config.open_attempts:
                raise
            pause(wait_s)
            wait_s *= 2
    raise AssertionError("open_attempts is at least 1")


def ethernet_structure(addresses: EthernetAddresses) -> EthernetCommConfig:
    """The vendor's structure: addresses in network byte order within a native integer, times in milliseconds."""
    local, mask, robot = (
        struct.unpack("=I", socket.inet_aton(address))[0]
        for address in (addresses.local_ip, addresses.subnet_mask, addresses.robot_ip)
    )
    return EthernetCommConfig(
        localIpAddress=local,
        subnetMask=mask,
        robotIpAddress=robot,
        localCmdport=addresses.local_command_port,
        localBcastPort=addresses.local_broadcast_port,
        robotPort=addresses.robot_port,
        rxTimeOutInMs=round(addresses.receive_timeout_s * 1000),
    )


def _choose(found: list[KinovaDevice], serial: str | None, where: str) -> KinovaDevice:
    serials = [_text(device.SerialNumber) for device in found]
    if not found:
        raise NoDeviceFound("GetDevices", where)
    if serial is None:
        if len(found) > 1:
            raise NotConnected(
                "one arm, or the serial number of the one to use", f"arms {', '.join(serials)}", "give `serial`", where
            )
        return found[0]
    if serial not in serials:
        raise NotConnected(f"the arm {serial}", f"arms {', '.join(serials)}", "check the serial number", where)
    return found[serials.index(serial)]


def _identify(device: KinovaDevice, version: tuple[int, int, int], config: JacoConfig, where: str) -> JacoIdentity:
    said = _MODELS.get(DeviceType(device.DeviceType)) if device.DeviceType in DeviceType.__members__.values() else None
    model = config.model or said
    if model is None:
        expected = f"an arm whose geometry is known ({', '.join(sorted(CHAINS))})"
        advice = "give `model` if it is one of them nevertheless"
        raise SettingsRefused(expected, f"one of type {device.DeviceType}", advice, where)
    if said is not None and said != model:
        raise SettingsRefused(f"a {model}", f"an arm that reports {said} as its model", "correct `model`", where)
    return JacoIdentity(
        serial=_text(device.SerialNumber),
        model=model,
        firmware=(device.VersionMajor, device.VersionMinor, device.VersionRelease),
        library_version=version,
        chain=CHAINS[model],
    )


def _text(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("ascii", "replace").strip()
