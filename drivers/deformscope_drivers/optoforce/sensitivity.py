"""Force of a count: in each sensor's own sensitivity report, and nowhere else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """A sensor's sensitivity report.

    counts_at_nominal: what each axis reads at its nominal load: Fx Fy Fz, or Fx Fy Fz Tx Ty Tz
    nominal: nominal loads [N], [N m] for torques.

    Raises ValueError unless both have 3 numbers, or both 6, all finite, the nominal ones positive."""

    counts_at_nominal: tuple[float, ...]
    nominal: tuple[float, ...]

    def __post_init__(self) -> None:
        counts, nominal = np.array(self.counts_at_nominal, float), np.array(self.nominal, float)
        if counts.shape != nominal.shape or counts.shape not in {(3,), (6,)}:
            raise ValueError(
                "expected a sensitivity report of 3 counts at 3 nominal loads (Fx Fy Fz), or 6 at 6; "
                f"got {len(self.counts_at_nominal)} at {len(self.nominal)}"
            )
        both = np.concatenate([counts, nominal])
        if not (np.isfinite(both) & (both > 0)).all():
            raise ValueError(
                "expected positive counts and nominal loads, as in the sensitivity report; "
                f"got {self.counts_at_nominal} at {self.nominal}"
            )

    @property
    def axes(self) -> int:
        """3 or 6."""
        return len(self.nominal)

    @property
    def per_count(self) -> FloatArray:
        """(axes,) what one count is worth [N], [N m]."""
        per_count: FloatArray = np.array(self.nominal, float) / np.array(self.counts_at_nominal, float)
        return per_count
