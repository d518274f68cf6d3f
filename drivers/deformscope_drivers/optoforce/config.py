"""Connection of a DAQ, its rate, and the forces of its sensors' counts."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.optoforce.protocol import Filter, Speed
from deformscope_drivers.transport import check_way

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


@dataclass(frozen=True, slots=True)
class OptoforceConfig:
    """Settings of a DAQ: either `port` or `bus`, and whatever differs from a DAQ as sold.

    port: serial port or address (`/dev/ttyACM0`, `socket://host:port`); bus: CAN bus (`socketcan:can0`), with the ids
    of the DAQ's packets and of the host's
    rate_hz: 1000, 333, 100, 30, 10, or 0 = it sends nothing; filter_hz: 500, 150, 50, 15, 5, 1.5, or 0 = no filter
    sensitivity: the sensor's sensitivity report, one for each channel of a 4-channel DAQ; without it, readings are in
    counts; serial: refuse any other; asks for an answer that only some firmware gives
    zero_at_start: take the load at opening for zero
    reconnect: None = a lost link ends the session; stuck_after_s: None = readings may stay the same for ever.

    Raises ValueError for a rate, a filter or sensors that no DAQ has, NotConnected for a kind of port or bus that is
    not accepted."""

    port: str = ""
    bus: str = ""
    rate_hz: float = 1000
    filter_hz: float = 150
    sensitivity: Sensitivity | tuple[Sensitivity, ...] | None = None
    serial: str = ""
    zero_at_start: bool = False
    receive_id: int = 0x100
    send_id: int = 0x101
    bitrate: int = 1_000_000
    baudrate: int = 1_000_000
    reconnect: Reconnect | None = RECONNECT
    stuck_after_s: float | None = 5.0

    def __post_init__(self) -> None:
        check_way(self.port, self.bus)
        speed_of(self.rate_hz)
        filter_of(self.filter_hz)
        axes = [report.axes for report in self.sensitivities]
        if axes not in ([], [3], [6], [3, 3, 3, 3]):
            raise ValueError(f"expected one sensitivity report, or 4 of 3 axes; got reports of {axes} axes")

    @property
    def sensitivities(self) -> tuple[Sensitivity, ...]:
        """The reports, none to four."""
        given = self.sensitivity
        return () if given is None else (given,) if isinstance(given, Sensitivity) else tuple(given)


SPEEDS = {1000: Speed.HZ_1000, 333: Speed.HZ_333, 100: Speed.HZ_100, 30: Speed.HZ_30, 10: Speed.HZ_10, 0: Speed.STOP}
FILTERS = {filter_.cutoff_hz or 0: filter_ for filter_ in Filter}


def speed_of(rate_hz: float) -> Speed:
    """The DAQ's setting for a rate [Hz]; raises ValueError where it has none."""
    if rate_hz not in SPEEDS:
        raise ValueError(f"expected a rate of {_listed(SPEEDS)} Hz; got {rate_hz:g}")
    return SPEEDS[int(rate_hz)]


def filter_of(filter_hz: float) -> Filter:
    """The DAQ's setting for a cut-off frequency [Hz], 0 = none; raises ValueError where it has none."""
    if filter_hz not in FILTERS:
        raise ValueError(f"expected a filter of {_listed(FILTERS)} Hz; got {filter_hz:g}")
    return FILTERS[filter_hz]


def _listed(choices: dict[int, Speed] | dict[float, Filter]) -> str:
    return ", ".join(f"{choice:g}" for choice in sorted(choices, reverse=True))
