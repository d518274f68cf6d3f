"""Schunk's SDH and SDH2 hand: its motion. Its tactile pads have a controller and line of their own (package `dsa`)."""

from deformscope_drivers.sdh.codes import AxisState as AxisState
from deformscope_drivers.sdh.codes import Controller as Controller
from deformscope_drivers.sdh.codes import VelocityProfile as VelocityProfile
from deformscope_drivers.sdh.config import SdhConfig as SdhConfig
from deformscope_drivers.sdh.device import CurrentMode as CurrentMode
from deformscope_drivers.sdh.device import Sdh as Sdh
from deformscope_drivers.sdh.double import Port as Port
from deformscope_drivers.sdh.double import SdhDouble as SdhDouble
from deformscope_drivers.sdh.results import HandReading as HandReading
from deformscope_drivers.sdh.results import MoveResult as MoveResult
from deformscope_drivers.sdh.results import Outcome as Outcome
