"""RSI's two messages: the controller's in each of its cycles, and the answer that it requires within it.

XML in a datagram each. The controller's `<Rob>` has the axes' angles, the flange's pose, and IPOC, the time of its
cycle [ms]; the answer `<Sen>` repeats IPOC and has the corrections of the axes. Other elements that a configuration
lets the controller send are ignored. Formats: ros-industrial kuka_experimental (kuka_rsi_hw_interface,
kuka_rsi_simulator; BSD-3), whose answers these are to the last byte."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

from deformscope_drivers.errors import ProtocolViolation

MOST_BYTES = 4096
"""Largest size of a datagram: real ones have some 600 bytes."""
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
POSE = ("X", "Y", "Z", "A", "B", "C")


@dataclass(frozen=True, slots=True)
class RobMessage:
    """joints_deg: (6,) angles of the axes (AIPos); pose: (6,) X, Y, Z [mm] and A, B, C [deg] of the tool in the
    controller's present base (RIst), None if it is not sent; setpoint_deg: (6,) ASPos; late: answers that came too late
    since the last one in time (Delay); ipoc: counter of this cycle [ms]; currents: (6,) currents of the motors (MACur),
    in the controller's own units, empty where they are not sent"""

    joints_deg: tuple[float, ...]
    ipoc: int
    pose: tuple[float, ...] | None = None
    setpoint_deg: tuple[float, ...] | None = None
    late: int = 0
    currents: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class SenMessage:
    """corrections_deg: (6,) corrections of the axes [deg]; ipoc: counter of the cycle that is answered; kind: type of
    the message, as configured in the controller"""

    corrections_deg: tuple[float, ...]
    ipoc: int
    kind: str = "ImFree"


def decode_rob(data: bytes) -> RobMessage:
    """The controller's message. Raises ProtocolViolation for another datagram, or one without a required element."""
    root = _root(data, "Rob")
    delay = root.find("Delay")
    return RobMessage(
        _values(root, "AIPos", AXES),
        _ipoc(root),
        _values(root, "RIst", POSE) if root.find("RIst") is not None else None,
        _values(root, "ASPos", AXES) if root.find("ASPos") is not None else None,
        0 if delay is None else _whole(delay.get("D", ""), "Delay D"),
        _values(root, "MACur", AXES) if root.find("MACur") is not None else (),
    )


def encode_rob(message: RobMessage) -> bytes:
    """The message that a controller sends, with the elements in kuka_experimental's ros_rsi_ethernet.xml; and MACur if
    there are currents (DEF_MACur)."""
    parts = ['<Rob Type="KUKA">']
    for tag, names, values in (
        ("RIst", POSE, message.pose),
        ("RSol", POSE, message.pose),
        ("AIPos", AXES, message.joints_deg),
        ("ASPos", AXES, message.setpoint_deg),
        ("MACur", AXES, message.currents),
    ):
        if values:
            parts.append(_element(tag, names, [f"{value:.4f}" for value in values], "/>"))
    parts.append(f'<Delay D="{message.late}"/><IPOC>{message.ipoc}</IPOC></Rob>')
    return "".join(parts).encode("ascii")


def encode_sen(message: SenMessage) -> bytes:
    """The answer; six digits after the point, as C++'s std::to_string has them."""
    corrections = _element("AK", AXES, [f"{value:.6f}" for value in message.corrections_deg], " />")
    return f'<Sen Type="{message.kind}">{corrections}<IPOC>{message.ipoc}</IPOC></Sen>'.encode("ascii")


def decode_sen(data: bytes) -> SenMessage:
    """A controller's decoding of an answer. Raises ProtocolViolation."""
    root = _root(data, "Sen")
    return SenMessage(_values(root, "AK", AXES), _ipoc(root), root.get("Type", ""))


def _element(tag: str, names: Sequence[str], values: Sequence[str], end: str) -> str:
    return f"<{tag} " + " ".join(f'{name}="{value}"' for name, value in zip(names, values, strict=True)) + end


def _root(data: bytes, tag: str) -> ET.Element:
    if len(data) > MOST_BYTES or b"<!" in data:  # nothing of RSI's has a document type, or entities
        raise ProtocolViolation(f"a <{tag}> of up to {MOST_BYTES} bytes", f"{len(data)} bytes of something else")
    try:
        root = ET.fromstring(data)
    except ET.ParseError as error:
        raise ProtocolViolation(f"a <{tag}> in XML", f"{data[:40]!r}: {error}") from error
    if root.tag != tag:
        raise ProtocolViolation(f"a <{tag}>", f"a <{root.tag[:40]}>", "the configuration of RSI's ETHERNET object")
    return root


def _values(root: ET.Element, tag: str, names: Sequence[str]) -> tuple[float, ...]:
    element = root.find(tag)
    if element is None:
        raise ProtocolViolation(f"<{tag}> in <{root.tag}>", "none", f"DEF_{tag} in RSI's ethernet configuration")
    try:
        values = tuple(float(element.attrib[name]) for name in names)
    except (KeyError, ValueError) as error:
        raise ProtocolViolation(f"<{tag}> with {', '.join(names)}", f"{dict(element.attrib)}"[:200]) from error
    if not all(map(math.isfinite, values)):
        raise ProtocolViolation(f"<{tag}> with finite numbers", f"{values}")
    return values


def _ipoc(root: ET.Element) -> int:
    return _whole(root.findtext("IPOC") or "", "IPOC")


def _whole(text: str, what: str) -> int:
    try:
        return int(text)
    except ValueError as error:
        raise ProtocolViolation(f"{what}, a whole number", repr(text[:40])) from error
