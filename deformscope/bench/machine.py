"""Conditions of a figure besides the code: the machine, and its load."""

from __future__ import annotations

import os
import platform
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import warp as wp

from deformscope.stages.msm.lanes import VECTOR_BITS
from deformscope.version import __version__


def machine(device: str) -> dict[str, object]:
    """Facts for the JSON. load: mean of the last minute; other processes make every figure larger."""
    gpu = None if device == "cpu" else wp.get_device(device)
    return {
        "cpu": _cpu(),
        "vector_bits": VECTOR_BITS,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "device": device,
        "gpu": None if gpu is None else gpu.name,
        "gpu_memory_bytes": None if gpu is None else gpu.total_memory,
        "system": platform.platform(),
        "python": platform.python_version(),
        "deformscope": __version__,
        "warp": wp.config.version,
        "numpy": np.__version__,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())
