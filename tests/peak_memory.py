"""The most memory of a test's own program."""

from pathlib import Path


def peak_mib() -> float:
    """Of this process since its program began [MiB]. `ru_maxrss` begins with that of the process that started it: after
    hundreds of tests, growth would not be seen below it."""
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
