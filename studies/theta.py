"""`python -m studies theta`: theta where errors are shared, tracks wrong or lost, and at other settings.

python -m studies theta --only "another" --objects 100
"""

from __future__ import annotations

from deformscope.cli.study import Study
from studies.beta import DisturbedCoverageConfig, theta

STUDY = Study(DisturbedCoverageConfig, theta)
