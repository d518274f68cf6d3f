"""Schunk's SDH and SDH2 hand: its motion. Its tactile pads have a controller and line of their own (package `dsa`)."""

from deformscope_drivers.sdh.codes import AxisState, Controller, Grasp, VelocityProfile
from deformscope_drivers.sdh.config import SdhConfig
from deformscope_drivers.sdh.device import CurrentMode, Sdh, Toward
from deformscope_drivers.sdh.double import Port, SdhDouble
from deformscope_drivers.sdh.results import HandReading, MoveResult, Outcome, StopReport

__all__ = [
    "AxisState",
    "Controller",
    "CurrentMode",
    "Grasp",
    "HandReading",
    "MoveResult",
    "Outcome",
    "Port",
    "Sdh",
    "SdhConfig",
    "SdhDouble",
    "StopReport",
    "Toward",
    "VelocityProfile",
]
