"""Converts each driver's measurements to frames: the only module that uses both."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope import frames
from deformscope.rig.driver_table import Driver
from deformscope_drivers.device import Device
from deformscope_drivers.dsa.messages import TEXEL_MAX
from deformscope_drivers.dsa.pads import to_pressure
from deformscope_drivers.optoforce.protocol import Kind as Sensors

if TYPE_CHECKING:
    from deformscope_drivers.arm import ArmState
    from deformscope_drivers.depth_camera import DepthImage
    from deformscope_drivers.dsa import Dsa, TactileReading
    from deformscope_drivers.optoforce import ForceMeasurement
    from deformscope_drivers.sdh import HandReading
    from deformscope_drivers.webcam import ColorImage

FINGER_CLOSED = 6800.0
"""Position of a closed finger of a Jaco (protocol reference, section 3)."""


def to_frame(kind: frames.Kind, reading: object, index: int, name: str, device: object) -> frames.Frame:
    """A driver's reading as a frame. index: its place in the device's stream; name: name of the device in its rig"""
    return _FRAMES[kind](reading, index, name, device)


def describe(name: str, driver: Driver, device: Device[Any], *, simulated: bool) -> frames.Stream:
    """Description of an open device before its first frame."""
    who = device.identity()
    opened: Any = device
    known: dict[str, Any] = {}
    match driver.kind:
        case "tactile":
            known = _of_tactile(opened)
        case "wrench":
            known = {
                "channels": 4 if opened.kind is Sensors.FOUR_CHANNEL else 1,
                "torques": opened.kind is Sensors.SIX_AXIS,
            }
        case "arm":
            known = {"urdf": opened.urdf}
    return frames.Stream(name, driver.kind, driver.name, simulated, who.serial, who.firmware, **known)


def _color(reading: "ColorImage", index: int, name: str, device: object) -> frames.Frame:
    return frames.ColorFrame(reading.stamp, index, reading.image, name)


def _depth(reading: "DepthImage", index: int, name: str, device: object) -> frames.Frame:
    return frames.DepthFrame(reading.stamp, index, reading.depth, reading.unit_m, reading.color, name)


def _tactile(reading: "TactileReading", index: int, name: str, device: "Dsa") -> frames.Frame:
    counts = np.concatenate([pad.ravel() for pad in reading.pads])
    return frames.TactileFrame(reading.stamp, index, counts, tuple(device.pressure_pa(reading)), name)


def _wrench(reading: "ForceMeasurement", index: int, name: str, device: object) -> frames.Frame:
    counts = np.array(reading.counts, np.int64)
    known = reading.per_count is not None
    force_n = reading.force_n if known else np.full((len(counts), 3), np.nan)
    torque_nm = reading.torque_nm if known else None
    return frames.WrenchFrame(
        reading.stamp, index, counts.ravel(), force_n, torque_nm, bool(reading.overload), reading.usable, name
    )


def _arm(reading: "ArmState", index: int, name: str, device: object) -> frames.Frame:
    force_n, torque_nm = np.array(reading.wrench[:3]), np.array(reading.wrench[3:])
    return frames.ArmFrame(
        stamp=reading.stamp,
        index=index,
        joint_deg=np.array(reading.joints_deg),
        joint_velocity_deg_s=np.array(reading.rates_deg_s),
        joint_torque_nm=np.array(reading.torques_nm),
        position_m=np.array(reading.position_m),
        rotation_rad=np.array(reading.theta_rad),
        force_n=force_n,
        torque_nm=torque_nm,
        finger=np.array(reading.fingers) / FINGER_CLOSED,
        queued=reading.fifo_count,
        device=name,
    )


def _hand(reading: "HandReading", index: int, name: str, device: object) -> frames.Frame:
    temperature_c = np.full(9, np.nan) if reading.temperature_c is None else np.array(reading.temperature_c)
    states = tuple(state.name.lower() for state in reading.state)
    position_deg, velocity_deg_s = np.array(reading.position_deg), np.array(reading.velocity_deg_s)
    return frames.HandFrame(reading.stamp, index, position_deg, velocity_deg_s, temperature_c, states, name)


def _of_tactile(device: "Dsa") -> dict[str, Any]:
    pads = tuple(
        frames.Pad(
            pad.name,
            matrix.cells_y,
            matrix.cells_x,
            (matrix.texel_width_mm / 1e3, matrix.texel_height_mm / 1e3),
            index,
            pad.finger,
            int(pad.part),
        )
        for index, (pad, matrix) in enumerate(zip(device.pads, device.matrices, strict=True))
    )
    full = to_pressure([np.array([[TEXEL_MAX]], np.uint16)] * len(pads), device.config.calibration)
    return {"pads": pads, "full_scale_pa": float(max(map(np.max, full)))}


_FRAMES: dict[frames.Kind, Callable[[Any, int, str, Any], frames.Frame]] = {
    "color": _color,
    "depth": _depth,
    "tactile": _tactile,
    "wrench": _wrench,
    "arm": _arm,
    "hand": _hand,
}
