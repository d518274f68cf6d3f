"""Errors of a first Kinect on exact pictures of the simulated camera, for studies without a camera's driver."""

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.lab.ray_camera import DepthViewConfig, Rendered

NOISE_PER_M, MISSING, STEP_M, FAR_M = 1.425e-3, 0.01, 1e-3, 3.5
"""Deviation of depth z is NOISE_PER_M z^2 [m] (1.4 mm at 1 m: Khoshelham and Oude Elberink 2012); share of pixels
without depth, step of depth, and farthest depth."""


def observed_m(exact: Rendered, random: np.random.Generator, noise_per_m: float = NOISE_PER_M) -> FloatArray:
    """Depth (H, W) that the camera reports [m], 0 for missing points: noise along the view, steps, and points missing
    at random and at grazing angles."""
    depth = np.nan_to_num(exact.depth_m, nan=0.0)
    measured = (depth > 0.0) & (np.abs(exact.facing) >= np.sin(np.deg2rad(DepthViewConfig().grazing_deg)))
    measured &= random.random(depth.shape) >= MISSING
    depth = depth + random.standard_normal(depth.shape) * noise_per_m * depth**2
    measured &= depth <= FAR_M
    return np.where(measured, np.clip(np.rint(depth / STEP_M), 1, 65535), 0.0) * STEP_M
