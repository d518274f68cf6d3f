"""Forces out of a DAQ's readings: readings and their arrival in, measurements, losses and doubts out.

It has no port and no thread: the device uses it, and so does the replay of a recording's bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deformscope_drivers.clock import Stamp
from deformscope_drivers.errors import SettingsRefused
from deformscope_drivers.optoforce.counter import CounterStep, CounterTrack, Gap
from deformscope_drivers.optoforce.measurement import FloatArray, ForceMeasurement
from deformscope_drivers.optoforce.plausibility import doubts
from deformscope_drivers.optoforce.protocol import Kind, Reading
from deformscope_drivers.optoforce.sensitivity import Sensitivity


class ForceMeasurer:
    """Each reading goes through `follow` and then `measure`.

    kind: what hangs on the DAQ, by the first reading; None before it
    offset: (channels, axes) counts to subtract where the DAQ does not do so itself; None = none
    track: the counter of the readings; doubted, unusable, overloaded: how many readings were
    name: of the device, for messages
    """

    def __init__(self, sensitivities: Sequence[Sensitivity], name: str) -> None:
        self._reports, self._name = sensitivities, name
        self._per_count: FloatArray | None = None
        self._nominal_counts: list[tuple[float, ...]] | None = None
        self._before: Reading | None = None
        self.kind: Kind | None = None
        self.offset: FloatArray | None = None
        self.track = CounterTrack()
        self.doubted = self.unusable = self.overloaded = 0

    def follow(self, reading: Reading, host_ns: int) -> Gap:
        """What the counter says of a reading. host_ns: when it arrived [ns]. Raises SettingsRefused where the first one
        is of another sensor than the sensitivity reports."""
        if self.kind is None:
            self._learn_kind(reading.kind)
        gap = self.track.follow(reading.counter, host_ns, twin=reading == self._before)
        self._before = reading
        return gap

    def measure(
        self, reading: Reading, host_ns: int, gap: Gap, *, zeroed: bool = False, zero_in_doubt: bool = False
    ) -> ForceMeasurement:
        """The loads of a reading. gap: of `follow`; zeroed: the DAQ subtracts the zero point itself; zero_in_doubt:
        whether it does is not known"""
        known = reading.kind is self.kind
        found = doubts(reading, self._nominal_counts if known else None)
        if gap.verdict in (CounterStep.JUMPED, CounterStep.LATE, CounterStep.REPEATED):
            found += ("counter",)
        if not known:
            found += ("kind",)
        if zero_in_doubt:
            found += ("zero",)
        self.doubted += bool(found)
        self.unusable += not reading.status.usable
        self.overloaded += bool(reading.status.overload)
        return ForceMeasurement(
            Stamp(host_ns, reading.counter),
            reading.kind,
            reading.status,
            reading.counts,
            self._per_count if known else None,
            None if zeroed or not known else self.offset,
            gap.lost,
            gap.verdict,
            found,
        )

    def _learn_kind(self, kind: Kind) -> None:
        """Now that it is known what hangs on the DAQ: do the sensitivity reports fit?"""
        reports = self._reports
        if reports and (len(reports) != kind.channels or any(report.axes != kind.axes for report in reports)):
            raise SettingsRefused(
                f"{len(reports)} sensors of {reports[0].axes} axes, as in `sensitivity`",
                f"a {kind.value} DAQ: {kind.channels} of {kind.axes}",
                "one sensitivity report for each sensor",
                self._name,
            )
        if self.offset is not None and self.offset.shape != (kind.channels, kind.axes):
            self.offset = None  # another sensor hangs there now
        self.kind = kind
        self._per_count = np.stack([report.per_count for report in reports]) if reports else None
        self._nominal_counts = [report.counts_at_nominal for report in reports] or None
