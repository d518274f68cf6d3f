"""KUKA arms through RSI (RobotSensorInterface): `from deformscope_drivers.kuka import Kuka, KukaConfig`."""

from deformscope_drivers.kuka.config import KukaConfig as KukaConfig
from deformscope_drivers.kuka.device import Kuka as Kuka
from deformscope_drivers.kuka.device import open_kuka as open_kuka
from deformscope_drivers.kuka.double import KukaDouble as KukaDouble
from deformscope_drivers.kuka.port import UdpWire as UdpWire
