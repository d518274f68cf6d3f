"""An arm that a person places: a stick on a stand or a slide, or an arm that gives no access to its control."""

from deformscope_drivers.placed.config import PlacedArmConfig as PlacedArmConfig
from deformscope_drivers.placed.device import PlacedArm as PlacedArm
from deformscope_drivers.placed.double import StandDouble as StandDouble
