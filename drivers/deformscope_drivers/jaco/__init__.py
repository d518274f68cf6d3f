"""Kinova Jaco2 over the vendor's own library: `from deformscope_drivers.jaco import Jaco, JacoConfig`."""

from deformscope_drivers.jaco.commands import CartesianTarget, CartesianVelocity, JointTarget, JointVelocity
from deformscope_drivers.jaco.config import EthernetAddresses, JacoConfig, Workspace
from deformscope_drivers.jaco.device import Jaco
from deformscope_drivers.jaco.double import JacoDouble
from deformscope_drivers.jaco.errors import (
    CommLayerMissing,
    CommunicationTimeout,
    MotionStopped,
    NoDeviceFound,
    NotReached,
    NotStopped,
    SymbolMissing,
    UnknownCode,
    VendorError,
)
from deformscope_drivers.jaco.state import JacoState
from deformscope_drivers.jaco.urdf import urdf_path

__all__ = [
    "CartesianTarget",
    "CartesianVelocity",
    "CommLayerMissing",
    "CommunicationTimeout",
    "EthernetAddresses",
    "Jaco",
    "JacoConfig",
    "JacoDouble",
    "JacoState",
    "JointTarget",
    "JointVelocity",
    "MotionStopped",
    "NoDeviceFound",
    "NotReached",
    "NotStopped",
    "SymbolMissing",
    "UnknownCode",
    "VendorError",
    "Workspace",
    "urdf_path",
]
