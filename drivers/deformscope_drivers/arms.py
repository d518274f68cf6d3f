"""The arms whose joints are known, by the name of their model."""

from deformscope_drivers.arm.kinematics import Chain
from deformscope_drivers.jaco.chains import CHAINS as JACO
from deformscope_drivers.kuka.config import CHAINS as KUKA
from deformscope_drivers.manual_arm.device import MANUAL

CHAINS: dict[str, Chain] = {**JACO, **KUKA}


def chain_of(model: str) -> Chain | None:
    """An arm's chain of joints; None where a person places it. Raises KeyError for a model that is not known."""
    return None if model == MANUAL else CHAINS[model]
