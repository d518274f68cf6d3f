"""Keys of a rig file."""

from dataclasses import dataclass

from deformscope_drivers.transport import check_port
from deformscope_netft.protocol import FILTERS_HZ

HEX_COUNTS_PER_N, HEX_COUNTS_PER_NM = 10_000.0, 100_000.0


@dataclass(frozen=True, slots=True)
class NetftConfig:
    """An ATI Net F/T box or an Axia.

    port: its address; rate_hz: records a second, as set on its page
    counts_per_n, counts_per_nm: None = from its page, at http_port
    serial: refuse any other; stuck_after_s: None = readings may stay the same for ever.

    Raises ValueError, NotConnected"""

    port: str = "udp://192.168.1.1:49152"
    rate_hz: float = 1000.0
    counts_per_n: float | None = None
    counts_per_nm: float | None = None
    http_port: int = 80
    serial: str = ""
    stuck_after_s: float | None = 5.0

    def __post_init__(self) -> None:
        _check(self.port, self.rate_hz, 7000.0)
        if (self.counts_per_n is None) != (self.counts_per_nm is None):
            raise ValueError("expected both counts_per_n and counts_per_nm, or neither; got one")
        if self.counts_per_n is not None and not (self.counts_per_n > 0 and (self.counts_per_nm or 0) > 0):
            raise ValueError(f"expected counts above 0; got {self.counts_per_n} and {self.counts_per_nm}")


@dataclass(frozen=True, slots=True)
class HexConfig:
    """An OnRobot HEX at its Ethernet converter or Compute Box.

    port: its address; rate_hz: records a second, a divisor of 1000; filter_hz: 500, 150, 50, 15, 5, 1.5, 0 = none
    stuck_after_s: None = readings may stay the same for ever. Raises ValueError, NotConnected"""

    port: str = "udp://192.168.1.1:49152"
    rate_hz: float = 500.0
    filter_hz: float = 15.0
    stuck_after_s: float | None = 5.0

    def __post_init__(self) -> None:
        _check(self.port, self.rate_hz, 500.0)
        if 1000.0 % self.rate_hz:
            raise ValueError(f"expected a rate_hz that divides 1000; got {self.rate_hz:g}")
        if self.filter_hz not in FILTERS_HZ:
            known = ", ".join(f"{one:g}" for one in FILTERS_HZ)
            raise ValueError(f"expected a filter of {known} Hz; got {self.filter_hz:g}")

    @property
    def counts_per_n(self) -> float:
        """Counts of 1 N."""
        return HEX_COUNTS_PER_N

    @property
    def counts_per_nm(self) -> float:
        """Counts of 1 N m."""
        return HEX_COUNTS_PER_NM


def _check(port: str, rate_hz: float, fastest_hz: float) -> None:
    check_port(port)
    if not port.startswith("udp://"):
        raise ValueError(f"expected port = udp://HOST:PORT; got {port}")
    if not 1.0 <= rate_hz <= fastest_hz:
        raise ValueError(f"expected a rate_hz of 1 to {fastest_hz:g}; got {rate_hz:g}")
