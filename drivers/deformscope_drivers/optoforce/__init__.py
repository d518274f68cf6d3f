"""OptoForce force sensors (OMD, HEX) on their DAQ, over USB, UART or CAN."""

from deformscope_drivers.optoforce.config import OptoforceConfig as OptoforceConfig
from deformscope_drivers.optoforce.config import Sensitivity as Sensitivity
from deformscope_drivers.optoforce.counter import CounterStep as CounterStep
from deformscope_drivers.optoforce.device import DaqSettings as DaqSettings
from deformscope_drivers.optoforce.device import Optoforce as Optoforce
from deformscope_drivers.optoforce.double import OMD_20_SE_40N as OMD_20_SE_40N
from deformscope_drivers.optoforce.double import OptoforceDouble as OptoforceDouble
from deformscope_drivers.optoforce.double import Sensors as Sensors
from deformscope_drivers.optoforce.measurement import ForceMeasurement as ForceMeasurement
from deformscope_drivers.optoforce.protocol import Kind as Kind
from deformscope_drivers.optoforce.protocol import Status as Status
