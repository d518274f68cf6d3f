"""Who computes many cases: flags that every command with many cases has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from deformscope.config import flags
from deformscope.config.options import Flags
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class ExecutorOptions(Flags):
    """Who computes the cases."""

    executor: Literal["local", "ray"] = "local"
    """Processes of this machine, or a Ray cluster that runs already, with this version on all nodes
    (deformscope[ray]). Its statistics of use are turned off."""
    address: Annotated[str | None, flags.one_word("ADDRESS", str), flags.unset] = None
    """Of the Ray cluster: HOST:PORT where this machine is a node of it, ray://HOST:PORT otherwise."""

    def check(self) -> None:
        if self.executor == "ray" and self.address is None:
            raise InputError("the --address of a Ray cluster", "none", "as `ray start --head` names it")
        if self.executor == "local" and self.address is not None:
            raise InputError("--executor ray with --address", "--executor local", "leave --address out")
