"""The arms whose joints are known, by the name of their model."""

from deformscope_drivers.arm.kinematics import Chain
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.manual_arm.device import MANUAL


def chains() -> dict[str, Chain]:
    """The chains of joints of all installed arms, by model."""
    return {model: chain for driver in DRIVERS.of_kind("arm") for model, chain in driver.chains().items()}


def chain_of(model: str) -> Chain | None:
    """An arm's chain of joints; None where a person places it. Raises DeviceError for an unknown model."""
    if model == MANUAL:
        return None
    if (chain := chains().get(model)) is None:
        raise DeviceError(f"an arm of {', '.join(chains())}", model, "pip install the package of its driver")
    return chain
