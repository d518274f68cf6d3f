"""What deformscope needs of an arm that a person places."""

import contextlib

from deformscope_drivers.clock import Clock
from deformscope_drivers.interface import ArmInLab, DeviceDriver, FloatArray
from deformscope_drivers.manual_arm.device import ManualArm, ManualArmConfig, StandDouble


def _in_lab(config: ManualArmConfig, start_deg: FloatArray | None, clock: Clock) -> ArmInLab:
    arm = ManualArm(config, clock=clock)
    return ArmInLab(arm, StandDouble(arm.T_base_end_effector))


DRIVER = DeviceDriver(
    "arm",
    ManualArmConfig,
    ManualArm,
    simulated=lambda config, scene: contextlib.nullcontext(ManualArm(config)),
    example=lambda: ManualArmConfig(start_m=(0.3, -0.3, 0.4)),
    in_lab=_in_lab,
)
