"""Implausible values of a reading that passed its checksum: the byte sum misses many double errors."""

from __future__ import annotations

from collections.abc import Sequence

from deformscope_drivers.optoforce.protocol import DaqState, Kind, Reading, SensorState

PLAUSIBLE_RATIO = 2.0
"""Largest plausible reading, as a multiple of the nominal force: about the end of the sensor's range."""

TORQUE_BITS = 0x70
KNOWN_DAQ = frozenset(DaqState)
KNOWN_SENSOR = frozenset(SensorState)
SENSOR_NUMBERS = 4


def doubts(reading: Reading, nominal_counts: Sequence[Sequence[float]] | None) -> tuple[str, ...]:
    """Why a reading is unreliable; empty without a reason. nominal_counts: (channels, axes), what each axis reads at
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
