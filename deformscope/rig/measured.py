"""Converts each driver's measurements to frames: the only module that uses both."""

from collections.abc import Callable
from typing import Any

import numpy as np

from deformscope import frames
from deformscope_drivers.arm import ArmState
from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import AxesReading, DeviceDriver, ForceReading, PadReading, TactileArray


def to_frame(kind: frames.Kind, reading: object, index: int, name: str, device: object) -> frames.Frame:
    """A driver's reading as a frame. index: its place in the device's stream; name: name of the device in its rig"""
    return _FRAMES[kind](reading, index, name, device)


def describe(name: str, driver: DeviceDriver, device: Device[Any], *, simulated: bool) -> frames.Stream:
    """Description of an open device before its first frame."""
    who, said = device.identity(), device.describe()
    return frames.Stream(
        name,
        driver.kind,
        driver.name,
        simulated,
        who.serial,
        who.firmware,
        said.pads,
        said.urdf,
        said.channels,
        said.torques,
        full_scale_pa=said.full_scale_pa,
    )


def _tactile(reading: PadReading, index: int, name: str, device: TactileArray) -> frames.Frame:
    counts = np.concatenate([pad.ravel() for pad in reading.pads])
    return frames.TactileFrame(reading.stamp, index, counts, tuple(device.pressure_pa(reading)), name)


def _wrench(reading: ForceReading, index: int, name: str, device: object) -> frames.Frame:
    counts = np.array(reading.counts, np.int64)
    try:
        force_n, torque_nm = reading.force_n, reading.torque_nm
    except DeviceError:  # the worth of a count is not known
        force_n, torque_nm = np.full((len(counts), 3), np.nan), None
    return frames.WrenchFrame(
        reading.stamp, index, counts.ravel(), force_n, torque_nm, bool(reading.overload), reading.usable, name
    )


_OF_STATES = {
    "joint_deg": "joints_deg",
    "joint_velocity_deg_s": "rates_deg_s",
    "joint_torque_nm": "torques_nm",
    "position_m": "position_m",
    "rotation_rad": "theta_rad",
    "finger": "fingers",
}
"""Fields of an arm's frame, and those of the driver's state that they are."""


def _arm(reading: ArmState, index: int, name: str, device: object) -> frames.Frame:
    values = {ours: np.array(getattr(reading, theirs)) for ours, theirs in _OF_STATES.items()}
    values |= {"force_n": np.array(reading.wrench[:3]), "torque_nm": np.array(reading.wrench[3:])}
    return frames.ArmFrame(stamp=reading.stamp, index=index, queued=reading.fifo_count, device=name, **values)


def state_of(frame: frames.ArmFrame) -> ArmState:
    """The driver's state of a frame, which has all but the motors' currents."""
    values: dict[str, Any] = {theirs: tuple(getattr(frame, ours).tolist()) for ours, theirs in _OF_STATES.items()}
    wrench = (*frame.force_n.tolist(), *frame.torque_nm.tolist())
    return ArmState(stamp=frame.stamp, wrench=wrench, fifo_count=frame.queued, **values)


def _hand(reading: AxesReading, index: int, name: str, device: object) -> frames.Frame:
    temperature_c = np.full(9, np.nan) if reading.temperature_c is None else np.array(reading.temperature_c)
    states = tuple(state.name.lower() for state in reading.state)
    position_deg, velocity_deg_s = np.array(reading.position_deg), np.array(reading.velocity_deg_s)
    return frames.HandFrame(reading.stamp, index, position_deg, velocity_deg_s, temperature_c, states, name)


_FRAMES: dict[frames.Kind, Callable[[Any, int, str, Any], frames.Frame]] = {
    "color": lambda reading, index, name, _: frames.ColorFrame(reading.stamp, index, reading.image, name),
    "depth": lambda reading, index, name, _: frames.DepthFrame(
        reading.stamp, index, reading.depth, reading.unit_m, reading.color, name
    ),
    "tactile": _tactile,
    "wrench": _wrench,
    "arm": _arm,
    "hand": _hand,
}
