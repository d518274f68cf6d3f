"""The most memory of a test's own program."""

import threading
from collections.abc import Callable
from pathlib import Path


def peak_mib() -> float:
    """Of this process since its program began [MiB]. `ru_maxrss` begins with that of the process that started it: after
    hundreds of tests, growth would not be seen below it."""
    return _status_mib("VmHWM")


def peak_of_own_mib(work: Callable[[], object]) -> float:
    """The most [MiB] during `work`, looked at every 2 ms, without the pages of mapped files, which the kernel
    takes back where memory is short."""
    done, looked = threading.Event(), [_status_mib("RssAnon")]

    def look() -> None:
        while not done.wait(0.002):
            looked.append(_status_mib("RssAnon"))

    watch = threading.Thread(target=look)
    watch.start()
    try:
        work()
    finally:
        done.set()
        watch.join()
    return max(looked)


def _status_mib(name: str) -> float:
    return int(Path("/proc/self/status").read_text().split(f"{name}:")[1].split()[0]) / 1024
