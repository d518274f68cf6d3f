"""A DAQ's reading in physical units: forces with a sensitivity report, counts otherwise.

Both the device and the replay of a recording's bytes use this module, which has neither port nor thread."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope_drivers.clock import Stamp
from deformscope_drivers.errors import DeviceError, SettingsRefused
from deformscope_drivers.optoforce.config import Sensitivity
from deformscope_drivers.optoforce.counter import CounterStep, CounterTrack, Gap
from deformscope_drivers.optoforce.protocol import DaqState, Kind, Reading, SensorState, Status

PLAUSIBLE_RATIO = 2.0
"""Largest plausible reading, as a multiple of the nominal force: about the end of the sensor's range."""

OVERLOAD_BITS, TORQUE_BITS = 0x3F0, 0x70
KNOWN_DAQ = frozenset(DaqState)
KNOWN_SENSOR = frozenset(SensorState)
SENSOR_NUMBERS = 4


def doubts(reading: Reading, nominal_counts: Sequence[Sequence[float]] | None) -> tuple[str, ...]:
    """Why a reading with a right checksum, which misses many double errors, is unreliable; empty without a reason.
    nominal_counts: (channels, axes), what each axis reads at
    its nominal load, from the sensor's sensitivity report; None = not known, and then no load is too large"""
    found = []
    if not _status_is_defined(reading):
        found.append("status")
    if nominal_counts is not None and any(
        abs(count) > PLAUSIBLE_RATIO * nominal
        for channel, nominals in zip(reading.counts, nominal_counts, strict=True)
        for count, nominal in zip(channel, nominals, strict=True)
    ):
        found.append("load")
    return tuple(found)


def _status_is_defined(reading: Reading) -> bool:
    status = reading.status
    if not status:
        return True
    no_torque = reading.kind is not Kind.SIX_AXIS
    return (
        status.daq in KNOWN_DAQ
        and status.sensor in KNOWN_SENSOR
        and status.sensor_number <= SENSOR_NUMBERS
        and not (no_torque and status & TORQUE_BITS)
    )


FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ForceMeasurement:
    """Loads on all channels at one moment, in each sensor's own frame. Positive Fz is compression, as far as is known.

    stamp: arrival, with the DAQ's counter (u16, wraps) as ticks
    status: status of DAQ and sensors; counts: (channels, axes) counts as sent
    per_count: (channels, axes) load of a count [N], [N m]; None = no sensitivity report was given
    offset_counts: (channels, axes) counts subtracted here, because the DAQ has lost its zero point; lost_before: number
    of readings missing directly before this one; negative corrects an earlier count that was too large
    follows: the counter's interpretation
    doubts: why it is unreliable: `status` and `load` are out of range, `counter` and `kind` do not follow the earlier
    ones, `zero` = it arrived while the zero point was changed or may have been lost"""

    stamp: Stamp
    kind: Kind
    status: Status
    counts: tuple[tuple[int, ...], ...]
    per_count: FloatArray | None = None
    offset_counts: FloatArray | None = None
    lost_before: int = 0
    follows: CounterStep = CounterStep.NEXT
    doubts: tuple[str, ...] = ()

    @property
    def load(self) -> FloatArray:
        """(channels, axes) forces [N] and torques [N m]. Raises DeviceError without a sensitivity report."""
        if self.per_count is None:
            raise DeviceError(
                "a sensitivity report, with the force of a count",
                "none that fits this sensor: it differs from sensor to sensor",
                "OptoforceConfig(sensitivity=Sensitivity(counts_at_nominal=..., nominal=...)); counts need none",
            )
        counts = np.array(self.counts, float)
        if self.offset_counts is not None:
            counts -= self.offset_counts
        return counts * self.per_count

    @property
    def force_n(self) -> FloatArray:
        """(channels, 3) Fx Fy Fz [N]. Raises DeviceError without a sensitivity report."""
        return self.load[:, :3]

    @property
    def torque_nm(self) -> FloatArray | None:
        """(channels, 3) Tx Ty Tz [N m]; None for a sensor that measures none. Raises as `force_n` does."""
        return self.load[:, 3:] if self.kind is Kind.SIX_AXIS else None

    @property
    def overload(self) -> tuple[str, ...]:
        """The overloaded axes, of `fx fy fz tx ty tz`."""
        return self.status.overload

    @property
    def usable(self) -> bool:
        """DAQ and sensor are well, and nothing speaks against the reading; it may be overloaded."""
        return self.status.usable and not self.doubts


class ForceMeasurer:
    """Forces out of a DAQ's readings: each reading goes through `follow`, which finds losses, and then `measure`.

    kind: what hangs on the DAQ, by the first reading; None before it
    offset: (channels, axes) counts to subtract where the DAQ does not do so itself; None = none
    track: the counter of the readings; doubted, unusable, overloaded: how many readings were
    name: name of the device, for messages"""

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
        """The interpretation of a reading's counter. host_ns: when it arrived [ns]. Raises SettingsRefused where the
        first one is of another sensor than the sensitivity reports."""
        if self.kind is None:
            kind, reports = reading.kind, self._reports
            if reports and (len(reports) != kind.channels or any(report.axes != kind.axes for report in reports)):
                expected = f"{len(reports)} sensors of {reports[0].axes} axes, as in `sensitivity`"
                came = f"a {kind.value} DAQ: {kind.channels} of {kind.axes}"
                raise SettingsRefused(expected, came, "one sensitivity report for each sensor", self._name)
            if self.offset is not None and self.offset.shape != (kind.channels, kind.axes):
                self.offset = None  # another sensor hangs there now
            self.kind = kind
            self._per_count = np.stack([report.per_count for report in reports]) if reports else None
            self._nominal_counts = [report.counts_at_nominal for report in reports] or None
        gap = self.track.follow(reading.counter, host_ns, twin=reading == self._before)
        self._before = reading
        return gap

    def measure(
        self, reading: Reading, host_ns: int, gap: Gap, *, zeroed: bool = False, zero_in_doubt: bool = False
    ) -> ForceMeasurement:
        """The loads of a reading. gap: gap before it, from `follow`; zeroed: the DAQ subtracts the zero point itself;
        zero_in_doubt: whether it does is not known"""
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
        self.overloaded += bool(reading.status & OVERLOAD_BITS)
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
