"""A process's first static state: `python -m studies.engines.first_result DEVICE` prints its time."""

import time

BEGAN_S = time.perf_counter()

import json  # noqa: E402  # after the clock has started
import sys  # noqa: E402

import numpy as np  # noqa: E402, F401  # what users have loaded anyway
import scipy.spatial  # noqa: E402, F401
import warp as wp  # noqa: E402

from deformscope.bench.bodies import poked  # noqa: E402
from deformscope.stages.msm.solver import Msm  # noqa: E402

SIDE = 6


def main(device: str) -> None:
    """The cube's static state; seconds that imports took, and the clock's reading at the end."""
    imported_s = time.perf_counter()
    wp.config.log_level = wp.LOG_ERROR
    body = poked(SIDE)
    Msm(body.rest, body.clusters(3), body.held, device=device).relax(body.held_position, 0.7)
    print(json.dumps({"import_s": imported_s - BEGAN_S, "ended_s": time.perf_counter()}))


if __name__ == "__main__":
    main(sys.argv[1])
