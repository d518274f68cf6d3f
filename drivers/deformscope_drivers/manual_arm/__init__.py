"""An arm that a person places: a stick on a stand or a slide, or an arm that gives no access to its control."""

from deformscope_drivers.manual_arm.device import ManualArm as ManualArm
from deformscope_drivers.manual_arm.device import ManualArmConfig as ManualArmConfig
from deformscope_drivers.manual_arm.device import StandDouble as StandDouble
