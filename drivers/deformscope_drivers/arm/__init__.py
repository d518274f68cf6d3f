"""Parts that every arm has: its states, velocities that expire, a halt, its chain of joints and its limits."""

from deformscope_drivers.arm.device import Arm as Arm
from deformscope_drivers.arm.device import ArmState as ArmState
from deformscope_drivers.arm.device import CartesianVelocity as CartesianVelocity
from deformscope_drivers.arm.device import JointVelocity as JointVelocity
from deformscope_drivers.errors import MotionStopped as MotionStopped
from deformscope_drivers.errors import NotMovedByCommands as NotMovedByCommands
from deformscope_drivers.errors import NotStopped as NotStopped
