"""Workers on a Ray cluster that the user has started; deformscope starts no cluster."""

import importlib.util
import logging
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Collection
from typing import Any

from deformscope.errors import InputError
from deformscope.executor.tasks import WorkerLost
from deformscope.processes import RENEW_S

ANSWER_S = 5.0
"""Time within which a cluster's address must answer."""
JOIN_S = 25.0
"""Time within which a cluster must take this process. Ray itself tries for minutes."""
ONE_MACHINE = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""Where this is 0, Ray takes the loopback's address as that of this machine, on any system."""
TRY = "import sys, ray; ray.init(address=sys.argv[1], log_to_driver=False)"
LOOPBACK = ("127.0.0.1", "localhost", "::1")
COUNT_S = 5.0
"""Period of counting the cores, because nodes come and go."""


class RayWorkers:
    """Workers on the cores of a cluster. Tasks of a node that ends are tried on others."""

    def __init__(self, address: str, limit: int | None = None) -> None:
        """address: HOST:PORT of a cluster that this machine is part of, or ray://HOST:PORT of any; limit: tasks under
        way at most. Raises InputError if nothing answers."""
        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        if importlib.util.find_spec("ray") is None:
            hint = "pip install 'deformscope[ray]', or --executor local"
            raise InputError("the package ray for --executor ray", "none here", hint)
        # Ray itself waits long for an address that does not answer
        host, colon, port = address.removeprefix("ray://").rpartition(":")
        if not colon or not port.isdecimal():
            raise InputError("HOST:PORT or ray://HOST:PORT after --address", repr(address))
        try:
            socket.create_connection((host.strip("[]"), int(port)), ANSWER_S).close()
        except (OSError, OverflowError, ValueError) as error:
            raise _nobody(address, str(getattr(error, "strerror", None) or error).lower()) from error
        _stay_on_loopback(address)
        import ray

        try:  # in a process that can be ended: this call prints lines, and nothing else ends it
            subprocess.run([sys.executable, "-Pc", TRY, address], capture_output=True, timeout=JOIN_S, check=False)
            ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
        except subprocess.TimeoutExpired as error:
            raise _nobody(address, f"none that takes this process within {JOIN_S:g} s") from error
        except Exception as error:  # of many kinds, also of another version of Ray or Python
            raise _nobody(address, " ".join(str(error).split())[:300]) from error
        self._ray: Any = ray  # its types are known where it is installed
        self._limit, self._cores, self._counted = limit, 0, 0.0
        self._remote: dict[Callable[..., Any], Any] = {}

    @property
    def capacity(self) -> int:
        """Largest number of tasks under way: one a core. Waiting for a core counts for a task's time limit."""
        if time.monotonic() - self._counted > COUNT_S or not self._cores:
            self._counted = time.monotonic()
            self._cores = int(self._ray.cluster_resources().get("CPU", 0))
        return max(self._cores if self._limit is None else min(self._cores, self._limit), 1)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        if function not in self._remote:
            self._remote[function] = self._ray.remote(num_cpus=1, max_retries=0)(function)
        return self._remote[function].remote(*arguments)

    def ready(self, under_way: Collection[Any]) -> list[Any]:
        done: list[Any] = self._ray.wait(list(under_way), num_returns=1, timeout=RENEW_S)[0]
        return done

    def result(self, attempt: Any) -> Any:
        errors = self._ray.exceptions
        try:
            return self._ray.get(attempt)
        except errors.RayTaskError as error:
            if isinstance(error.cause, ModuleNotFoundError) and str(error.cause.name).startswith("deformscope"):
                raise InputError("deformscope on all nodes", str(error.cause), "install it there") from error
            raise error.cause from None
        except (errors.RaySystemError, errors.RayError) as error:
            if "No module named 'deformscope" in str(error):
                raise InputError("deformscope on all nodes", "a node without", "install it there") from error
            words = str(error).strip().split(". ")[0].splitlines()[0]
            raise WorkerLost(f"{type(error).__name__}: {words}") from error

    def give_up(self, attempt: Any) -> None:
        self._ray.cancel(attempt, force=True)

    def close(self) -> None:
        self._ray.shutdown()


def _stay_on_loopback(address: str) -> None:
    """Ray takes this machine's other address in place of a loopback address, also where the cluster listens on the
    loopback alone (2.60, `ray._private.services.resolve_ip_for_localhost`). The variable, which Ray reads as it is
    imported, keeps it there."""
    host, _, port = address.rpartition(":")
    if host not in LOOPBACK:
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        try:
            one.connect(("8.8.8.8", 80))  # as Ray finds its own address; no packet is sent
            socket.create_connection((one.getsockname()[0], int(port)), ANSWER_S).close()
        except OSError:
            if "ray" in sys.modules and os.environ.get(ONE_MACHINE) != "0":
                hint = f"{ONE_MACHINE}=0 in the environment, as Ray was imported before"
                raise InputError("a cluster on this machine's own address", "loopback alone", hint, address) from None
            os.environ[ONE_MACHINE] = "0"


def _nobody(address: str, came: str) -> InputError:
    hint = "--address with the address that ray start --head prints, or ray://HOST:10001 outside of the cluster"
    return InputError("a Ray cluster that answers", came, hint, address)
