"""What deformscope needs of an arm that a person places."""

import contextlib

from deformscope_drivers.interface import DeviceDriver
from deformscope_drivers.manual_arm.device import ManualArm, ManualArmConfig

DRIVER = DeviceDriver(
    "arm",
    ManualArmConfig,
    ManualArm,
    simulated=lambda config, scene: contextlib.nullcontext(ManualArm(config)),
    example=lambda: ManualArmConfig(start_m=(0.3, -0.3, 0.4)),
)
