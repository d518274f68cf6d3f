"""Kinova Jaco2 over the vendor's own library: `from deformscope_drivers.jaco import Jaco, JacoConfig`."""

from deformscope_drivers.arm.device import CartesianVelocity as CartesianVelocity
from deformscope_drivers.arm.device import JointVelocity as JointVelocity
from deformscope_drivers.errors import MotionStopped as MotionStopped
from deformscope_drivers.errors import NotStopped as NotStopped
from deformscope_drivers.jaco.chains import urdf_path as urdf_path
from deformscope_drivers.jaco.config import EthernetAddresses as EthernetAddresses
from deformscope_drivers.jaco.config import JacoConfig as JacoConfig
from deformscope_drivers.jaco.config import Workspace as Workspace
from deformscope_drivers.jaco.device import Jaco as Jaco
from deformscope_drivers.jaco.device import open_jaco as open_jaco
from deformscope_drivers.jaco.double import JacoDouble as JacoDouble
from deformscope_drivers.jaco.errors import CommLayerMissing as CommLayerMissing
from deformscope_drivers.jaco.errors import CommunicationTimeout as CommunicationTimeout
from deformscope_drivers.jaco.errors import NoDeviceFound as NoDeviceFound
from deformscope_drivers.jaco.errors import NotHomed as NotHomed
from deformscope_drivers.jaco.errors import NotReached as NotReached
from deformscope_drivers.jaco.errors import SymbolMissing as SymbolMissing
from deformscope_drivers.jaco.errors import UnknownCode as UnknownCode
from deformscope_drivers.jaco.errors import VendorError as VendorError
from deformscope_drivers.jaco.reading import JacoState as JacoState
