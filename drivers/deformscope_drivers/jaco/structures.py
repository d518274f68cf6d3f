"""Data of Kinova's library: C structures by their published layout, and the numbers that go into them.

Layouts are facts of the published headers (KinovaTypes.h, BSD-3), naturally aligned; sizes were checked against the
library 5.2.0. Positions are metres and radians (ThetaX, ThetaY, ThetaZ turn about x, the new y, the new z), joints
degrees, fingers 0 (open) to 6800 (closed)."""

import ctypes
import struct
from ctypes import c_char, c_double, c_float, c_int, c_short, c_ubyte, c_uint, c_ulong, c_ushort
from enum import IntEnum
from typing import Any

from deformscope_drivers.arm.device import JointVelocity, Velocity

STRING_LENGTH = 20
DEVICE_COUNT_MAX = 20
FINGER_COUNT = 3
FINGER_CLOSED = 6800.0
ZONES_MAX, ZONE_POINTS = 10, 8


class PositionType(IntEnum):
    """Kind of a trajectory point.

    CARTESIAN_VELOCITY: X, Y, Z in m/s in the base frame, ThetaX, ThetaY, ThetaZ in rad/s in the end effector's frame
    ANGULAR_VELOCITY: degrees per second; both velocities for one cycle of 10 ms"""

    CARTESIAN_VELOCITY = 7
    ANGULAR_VELOCITY = 8


class ShapeType(IntEnum):
    """Shape of a protection zone; the header states that all others are not used."""

    PRISM_SQUARE_BASE_Z = 2


class RetractType(IntEnum):
    """Status of the home pose ("ready"), in `QuickStatus`."""

    NORMAL_TO_READY = 0
    READY_STANDBY = 1
    READY_TO_RETRACT = 2
    RETRACT_STANDBY = 3
    RETRACT_TO_READY = 4
    NORMAL_STANDBY = 5
    NOT_INITIALIZED = 6


HOMED = (RetractType.READY_STANDBY, RetractType.NORMAL_STANDBY)
"""Status of an arm that was at home since it was switched on."""


class DeviceType(IntEnum):
    """Type of the arm."""

    JACO1 = 0
    MICO_6DOF = 1
    MICO_4DOF = 2
    JACO2_6DOF = 3
    JACO2_4DOF = 4
    MICO_6DOF_ASSISTIVE = 5
    JACO2_6DOF_ASSISTIVE = 6
    SPHERICAL_6DOF = 7
    SPHERICAL_7DOF = 8


def _alike(kind: type[Any], names: str) -> list[tuple[str, type[Any]]]:
    """Fields (name, type) of a C structure, all of one type. names: separated by spaces, in the structure's order"""
    return [(name, kind) for name in names.split()]


class CartesianInfo(ctypes.Structure):
    _fields_ = _alike(c_float, "X Y Z ThetaX ThetaY ThetaZ")


class AngularInfo(ctypes.Structure):
    _fields_ = [(f"Actuator{i}", c_float) for i in range(1, 8)]


class FingersPosition(ctypes.Structure):
    _fields_ = [(f"Finger{i}", c_float) for i in range(1, 4)]


class CartesianPosition(ctypes.Structure):
    _fields_ = [("Coordinates", CartesianInfo), ("Fingers", FingersPosition)]


class AngularPosition(ctypes.Structure):
    _fields_ = [("Actuators", AngularInfo), ("Fingers", FingersPosition)]


class UserPosition(ctypes.Structure):
    _fields_ = [
        ("Type", c_int),
        ("Delay", c_float),
        ("CartesianPosition", CartesianInfo),
        ("Actuators", AngularInfo),
        ("HandMode", c_int),
        ("Fingers", FingersPosition),
    ]


class Limitation(ctypes.Structure):
    """Speed limits of a point: 1 translation [m/s] or joints 1-3 [deg/s], 2 rotation [rad/s] or the others [deg/s]."""

    _fields_ = [(f"{kind}Parameter{i}", c_float) for kind in ("speed", "force", "acceleration") for i in range(1, 4)]


class TrajectoryPoint(ctypes.Structure):
    _fields_ = [
        ("Position", UserPosition),
        *_alike(c_int, "LimitationsActive SynchroType"),
        ("Limitations", Limitation),
    ]


class TrajectoryFIFO(ctypes.Structure):
    _fields_ = [("TrajectoryCount", c_uint), ("UsedPercentage", c_float), ("MaxSize", c_uint)]


class JoystickCommand(ctypes.Structure):
    _fields_ = [
        ("ButtonValue", c_short * 16),
        *_alike(c_float, "InclineLeftRight InclineForwardBackward Rotate MoveLeftRight MoveForwardBackward PushPull"),
    ]


class KinovaDevice(ctypes.Structure):
    _fields_ = [
        *_alike(c_char * STRING_LENGTH, "SerialNumber Model"),
        *_alike(c_int, "VersionMajor VersionMinor VersionRelease DeviceType DeviceID"),
    ]


class SensorsInfo(ctypes.Structure):
    """Supply [V], [A], acceleration of the base [g], temperatures [deg C]."""

    _fields_ = [
        *_alike(c_float, "Voltage Current AccelerationX AccelerationY AccelerationZ"),
        *((f"ActuatorTemp{i}", c_float) for i in range(1, 8)),
        *((f"FingerTemp{i}", c_float) for i in range(1, 4)),
    ]


class QuickStatus(ctypes.Structure):
    """Flags; the header says 0 means on for control, force control and current limitation."""

    _fields_ = _alike(
        c_ubyte,
        "Finger1Status Finger2Status Finger3Status RetractType RetractComplexity ControlEnableStatus "
        "ControlActiveModule ControlFrameType CartesianFaultState ForceControlStatus CurrentLimitationStatus "
        "RobotType RobotEdition TorqueSensorsStatus",
    )


class ForcesInfo(ctypes.Structure):
    """Joint torques [Nm], then force [N] and torque [Nm] at the end effector."""

    _fields_ = [(f"Actuator{i}", c_float) for i in range(1, 8)] + _alike(c_float, "X Y Z ThetaX ThetaY ThetaZ")


class EthernetCommConfig(ctypes.Structure):
    """Addresses in network byte order, as inet_addr gives them; times in milliseconds."""

    _fields_ = [
        *_alike(c_ulong, "localIpAddress subnetMask robotIpAddress"),
        *_alike(c_ushort, "localCmdport localBcastPort robotPort"),
        ("rxTimeOutInMs", c_ulong),
    ]


class GeneralInformations(ctypes.Structure):
    """Nearly all information of the arm; only documented fields of the header are useful."""

    _fields_ = [
        *_alike(c_double, "TimeAbsolute TimeFromStartup"),
        ("IndexStartup", c_uint),
        ("ExpansionLong1", c_int),
        *_alike(c_float, "TimeStampSavings ExpansionFloat SupplyVoltage TotalCurrent Power AveragePower"),
        *_alike(c_float * 3, "Acceleration SensorExpansion"),
        *_alike(c_uint, "CodeVersion CodeRevision"),
        *_alike(c_ushort, "Status Controller ControlMode HandMode ConnectedActuatorCount PositionType"),
        ("ErrorsSpiExpansion", c_ushort * 2),
        *_alike(c_ushort, "ErrorsMainSPICount ErrorsExternalSPICount ErrorsMainCANCount ErrorsExternalCANCount"),
        ("ActualSystemStatus", c_uint * 11),
        *_alike(UserPosition, "Position Command Current Force"),
        ("ActualLimitations", Limitation),
        ("ControlIncrement", c_float * 7),
        ("FingerControlIncrement", c_float * 3),
        ("ActualJoystickCommand", JoystickCommand),
        *_alike(c_uint * 4, "PeripheralsConnected PeripheralsDeviceID"),
        ("ActuatorsTemperatures", c_float * 7),
        *_alike(c_float * 3, "FingersTemperatures FutureTemperatures"),
        ("ActuatorsCommErrors", c_int * 7),
        ("FingersCommErrors", c_int * 3),
        ("ExpansionLong2", c_int),
        *_alike(c_double, "ControlTimeAbsolute ControlTimeFromStartup"),
        ("ExpansionsBytes", c_ubyte * 192),
    ]


class ZoneShape(ctypes.Structure):
    """Points 0 to 3 are the corners of the base, one after the other; the z of point 4 is that of the top."""

    _fields_ = [*_alike(c_int, "shapeType Expansion1"), ("Points", CartesianInfo * ZONE_POINTS)]


class Zone(ctypes.Structure):
    """A box in which the hand moves no faster than the zone's limit; 0 = it may not enter."""

    _fields_ = [
        *_alike(c_int, "ID Expansion1"),
        ("zoneShape", ZoneShape),
        ("zoneLimitation", Limitation),
        ("Expansion2", c_int),
    ]


class ZoneList(ctypes.Structure):
    _fields_ = [*_alike(c_int, "NbZones Expansion1"), ("Zones", Zone * ZONES_MAX)]


DeviceList = KinovaDevice * DEVICE_COUNT_MAX
ApiVersion = c_int * 3
CartesianRates = c_float * 6
AngularRates = c_float * 7


def cartesian_values(info: CartesianInfo) -> tuple[float, float, float, float, float, float]:
    """X, Y, Z, ThetaX, ThetaY, ThetaZ."""
    return (info.X, info.Y, info.Z, info.ThetaX, info.ThetaY, info.ThetaZ)


def actuator_values(info: AngularInfo, joint_count: int) -> tuple[float, ...]:
    """Values of the joints that the arm has: Actuator7 of a six-joint arm is never written, and not given."""
    return struct.unpack_from(f"{joint_count}f", info)


def finger_values(info: FingersPosition) -> tuple[float, float, float]:
    """Finger1, Finger2, Finger3."""
    return (info.Finger1, info.Finger2, info.Finger3)


def sensor_temperatures(info: SensorsInfo, joint_count: int) -> tuple[float, ...]:
    """Temperatures of the joints that the arm has [deg C]."""
    return tuple(getattr(info, f"ActuatorTemp{i}") for i in range(1, joint_count + 1))


def velocity_point(velocity: Velocity) -> TrajectoryPoint:
    """The point that asks for a velocity during one cycle of the arm (the device sends those of joints alone)."""
    point = TrajectoryPoint()
    if isinstance(velocity, JointVelocity):
        point.Position.Type = PositionType.ANGULAR_VELOCITY
        point.Position.Actuators = AngularInfo(*velocity.rates_deg_s)
    else:
        point.Position.Type = PositionType.CARTESIAN_VELOCITY
        point.Position.CartesianPosition = CartesianInfo(*velocity.linear_m_s, *velocity.angular_rad_s)
    return point
