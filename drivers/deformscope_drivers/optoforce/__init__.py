"""OptoForce force sensors (OMD, HEX) on their DAQ, over USB, UART or CAN."""

from deformscope_drivers.optoforce.config import OptoforceConfig
from deformscope_drivers.optoforce.counter import CounterStep
from deformscope_drivers.optoforce.device import DaqSettings, Optoforce
from deformscope_drivers.optoforce.double import OMD_20_SE_40N, OptoforceDouble, Sensors
from deformscope_drivers.optoforce.measurement import ForceMeasurement
from deformscope_drivers.optoforce.protocol import Kind, Status
from deformscope_drivers.optoforce.sensitivity import Sensitivity

__all__ = [
    "OMD_20_SE_40N",
    "CounterStep",
    "DaqSettings",
    "ForceMeasurement",
    "Kind",
    "Optoforce",
    "OptoforceConfig",
    "OptoforceDouble",
    "Sensitivity",
    "Sensors",
    "Status",
]
