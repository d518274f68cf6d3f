"""Date and accuracy of each part of a rig's calibration: `deformscope calibrate` writes them with the values."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Collection
from dataclasses import dataclass

from deformscope.rig.sections import check

DAYS = {"arm": 365, "place": 30, "tip": 180, "camera": 90, "force": 180, "time": 365}
"""Days after which each calibration is repeated: a table is moved sooner than a stick is bent. Chosen."""

LATEST_S = 0.5
"""Largest offset between two clocks [s] in `calibrate time`."""


@dataclass(frozen=True, slots=True)
class CalibrationEntry:
    """One measurement.

    date: date of the calibration; half_m, half_deg: half widths of the 90 % intervals of a translation along x, y, z
    [m] and of a turn about them [deg], in the transform's target frame; half_size_m: half widths of the intervals of a
    surface's sides [m]; half_gain: half width of the interval of the force sensor's gain
    offset_s, half_s: delay of `device` relative to the force sensor `beside`, below 0 a lead
    oldest_days: age at which it is measured again, None = the usual one of its kind"""

    date: datetime.date
    half_m: tuple[float, ...] = ()
    half_deg: tuple[float, ...] = ()
    half_size_m: tuple[float, ...] = ()
    half_gain: float | None = None
    offset_s: float | None = None
    half_s: float | None = None
    device: str = ""
    beside: str = ""
    oldest_days: int | None = None

    def __post_init__(self) -> None:
        check(isinstance(self.date, datetime.date), "date = YEAR-MONTH-DAY", self.date)
        halves = (*self.half_m, *self.half_deg, *self.half_size_m, self.half_gain or 0.0)
        check(all(value >= 0.0 for value in halves), "half widths of 0 or more", halves)
        check(self.oldest_days is None or self.oldest_days > 0, "oldest_days above 0", self.oldest_days)

    def days(self, today: datetime.date) -> int:
        """Its age in days; 0 for a date after today, as on a computer whose clock is behind."""
        return max((today - self.date).days, 0)


@dataclass(frozen=True, slots=True)
class CalibratedSection:
    """Calibrations of a rig; None = not measured by `deformscope calibrate`."""

    arm: CalibrationEntry | None = None
    place: CalibrationEntry | None = None
    tip: CalibrationEntry | None = None
    camera: CalibrationEntry | None = None
    force: CalibrationEntry | None = None
    time: CalibrationEntry | None = None

    def late_ns(self, devices: Collection[str]) -> dict[str, int]:
        """The delay of a device, by name [ns]: only the later of the two compared devices has one, so that no stamp
        lies in the future. devices: names of all devices. Raises InputError for an unknown device."""
        if self.time is None or self.time.offset_s is None or not self.time.device:
            return {}
        one, other, offset_s = self.time.device, self.time.beside, self.time.offset_s
        for name in (one, other):
            check(name in devices, f"[calibrated.time] device and beside out of {', '.join(devices)}", name)
        check(abs(offset_s) <= LATEST_S, f"[calibrated.time] offset_s within {LATEST_S:g} s", offset_s)
        return {one if offset_s >= 0.0 else other: round(1e9 * abs(offset_s))}

    def ages(self, today: datetime.date | None = None) -> dict[str, CalibrationAge]:
        """How old each measured calibration is, by name."""
        now = today if today is not None else datetime.datetime.now(tz=datetime.UTC).date()
        found = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {
            name: CalibrationAge(one.days(now), one.oldest_days or DAYS[name])
            for name, one in found.items()
            if one is not None
        }


@dataclass(frozen=True, slots=True)
class CalibrationAge:
    """days: age in days; at_most: age at which it is measured again"""

    days: int
    at_most: int

    @property
    def young(self) -> bool:
        """Whether the calibration may still be used."""
        return self.days <= self.at_most
