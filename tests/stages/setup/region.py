"""Whether the region of an estimated transform, an ellipsoid over all its six components together, holds another."""

import numpy as np
import scipy

from deformscope.arrays import FloatArray
from deformscope.stages.setup.transform import LEVEL, TransformEstimate


def region_holds(estimate: TransformEstimate, T: FloatArray) -> bool:
    """T: (4, 4)"""
    off = estimate.deviation(T)
    squared = float(off @ np.linalg.solve(estimate.covariance, off)) / len(off)
    return squared <= float(scipy.stats.f.ppf(LEVEL, len(off), estimate.dof))
