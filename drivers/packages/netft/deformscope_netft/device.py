"""The sensors as devices, and the measurer that a replay uses too."""

import http.client
import urllib.parse
from collections import deque
from collections.abc import Iterable

import numpy as np

from deformscope_drivers.clock import Clock, ClockFit, Stamp, monotonic_ns
from deformscope_drivers.device import ROUND_S, StreamDevice
from deformscope_drivers.errors import NotConnected, SettingsRefused
from deformscope_drivers.health import Description, Identity, Link
from deformscope_drivers.interface import FloatArray, Wrench
from deformscope_drivers.transport import Transport, UdpTransport
from deformscope_netft import protocol
from deformscope_netft.config import HexConfig, NetftConfig

PAGE = "/netftapi2.xml"
PAGE_BYTES, PAGE_S = 1 << 16, 2.0
SILENCE_S = 1.0
LATE_RECORDS = 1000
"""Missing records that are remembered: one of them that comes after all was late."""
GAIN_OFF = 0.02
"""Greatest share by which counts of the rig file may be off those of the page."""
AGAIN_RECORDS = 3
"""Records in sequence, further back than the last one, from which a stream has begun again."""
STILL_READINGS, STILL_N, STILL_NM = 50, 0.5, 0.05
"""Readings before a zero, and how much they may vary: standard deviation of each axis."""


class Measurer:
    """Forces out of records, in their order; without port and thread.

    lost: records that are missing before the last one; refused: reason against it, empty = none"""

    def __init__(self, config: NetftConfig | HexConfig) -> None:
        self._per_count: FloatArray | None = None
        if config.counts_per_n is not None and config.counts_per_nm is not None:
            self._set(config.counts_per_n, config.counts_per_nm)
        self._given = self._per_count is not None
        self._last: int | None = None
        self._missing: deque[int] = deque(maxlen=LATE_RECORDS)
        self._back = self._back_run = 0
        self.lost = 0
        self.refused = ""

    def learn(self, page: protocol.Calibration) -> None:
        """Take the sensor's own calibration, unless the configuration has one."""
        if not self._given:
            self._set(page.counts_per_n, page.counts_per_nm)

    def measure(self, record: protocol.Record, host_ns: int) -> Wrench | None:
        """The reading of a record; None for one that is late, repeated or without a calibration."""
        number = record.rdt_sequence
        step = 1 if self._last is None else (number - self._last) % protocol.WRAP
        self.lost, self.refused = 0, ""
        if step == 0 or step >= protocol.WRAP // 2:
            if number in self._missing:
                self._missing.remove(number)
                self.lost, self.refused = -1, "late"  # it was counted as lost
                return None
            self._back_run = self._back_run + 1 if number == (self._back + 1) % protocol.WRAP else 1
            self._back = number
            if self._back_run < AGAIN_RECORDS:
                self.refused = "repeated"
                return None
            self._missing.clear()  # the stream has begun again
        else:
            self.lost = step - 1
            self._missing.extend(range(max(number - self.lost, number - LATE_RECORDS), number))
        self._last, self._back_run = number, 0
        if self._per_count is None:
            self.refused = "no calibration"
            return None
        load = self.load(np.array(record.counts, float))
        saturated = ("fx", "fy", "fz", "tx", "ty", "tz") if record.status & protocol.SATURATED else ()
        return Wrench(
            Stamp(host_ns, record.ft_sequence),
            (record.counts,),
            load[None, :3],
            load[None, 3:],
            saturated,
            not record.status & ~protocol.MONITOR,
        )

    def load(self, counts: FloatArray) -> FloatArray:
        """(6,) forces and torques [N, N m] of counts (6,)."""
        assert self._per_count is not None
        return counts * self._per_count

    def _set(self, counts_per_n: float, counts_per_nm: float) -> None:
        self._per_count = 1.0 / np.array([counts_per_n] * 3 + [counts_per_nm] * 3)


class NetftSensor(StreamDevice[Wrench]):
    """`with NetftSensor(NetftConfig(port="udp://192.168.1.1:49152")) as sensor:`, or with a HexConfig.

    transport, clock: used instead of the configuration's port and the host's clock (in a simulated laboratory)"""

    def __init__(
        self, config: NetftConfig | HexConfig, *, transport: Transport | None = None, clock: Clock = monotonic_ns
    ) -> None:
        self.config = config
        self._measurer = Measurer(config)
        self._page: protocol.Calibration | None = None
        self._networked = transport is None
        super().__init__(
            transport or UdpTransport(config.port),
            silence_s=max(SILENCE_S, 10.0 / config.rate_hz),
            stuck_after_s=config.stuck_after_s,
            clock=clock,
        )

    def identity(self) -> Identity:
        if isinstance(self.config, HexConfig):
            return Identity("OnRobot HEX")
        return Identity("ATI Net F/T") if self._page is None else Identity(self._page.model, self._page.serial)

    def describe(self) -> Description:
        return Description(self.config.rate_hz, torques=True)

    def zero(self) -> None:
        """Take the present load for zero, by the sensor's own bias. Raises SettingsRefused where the load varies."""
        self._do(self._zero, 30.0)

    # What the base class asks for ------------------------------------------------------------------------------------

    def _make_decoder(self) -> protocol.Decoder:
        return protocol.Decoder()

    def _start(self) -> None:
        self._measurer = Measurer(self.config)
        looks = self._networked and self._link is not Link.LOST
        if isinstance(self.config, NetftConfig) and (looks or self._wants_page(self.config)):
            self._read_page(self.config)
        self._send(protocol.request(protocol.Command.STOP))
        self._transport.drain(ROUND_S, ROUND_S)
        if isinstance(self.config, HexConfig):
            self._send(protocol.request(protocol.Command.SPEED, round(1000.0 / self.config.rate_hz)))
            self._send(protocol.request(protocol.Command.FILTER, protocol.FILTERS_HZ.index(self.config.filter_hz)))
        self._clock_fit = ClockFit(1e9 / self.config.rate_hz)
        self._expect(self.config.rate_hz)
        self._send(protocol.request(protocol.Command.STREAM))
        self._next(1)

    def _stop(self) -> None:
        self._send(protocol.request(protocol.Command.STOP))

    def _measure(self, event: protocol.Record | protocol.Calibration, host_ns: int) -> Iterable[Wrench]:
        if not isinstance(event, protocol.Record):
            return []
        reading = self._measurer.measure(event, host_ns)
        if self._measurer.lost:
            self._count_lost(self._measurer.lost)
        if self._measurer.refused:
            self._count_refused(self._measurer.refused)
        return [] if reading is None else [reading]

    def _fingerprint(self, reading: Wrench) -> tuple[tuple[int, ...], ...]:
        return reading.counts

    # Within: all in the device's thread ------------------------------------------------------------------------------

    @staticmethod
    def _wants_page(config: NetftConfig) -> bool:
        return config.counts_per_n is None or bool(config.serial)

    def _read_page(self, config: NetftConfig) -> None:
        """Read the sensor's page, and keep it among the recorded bytes: a replay has its calibration too. Where the
        configuration needs nothing of it, one that cannot be read is no error."""
        host = urllib.parse.urlsplit(config.port).hostname or ""
        where = f"http://{host}:{config.http_port}{PAGE}"
        advice = "`port` with its address; where its page is off, counts_per_n and counts_per_nm of its calibration"
        link = http.client.HTTPConnection(host, config.http_port, timeout=PAGE_S)
        try:
            link.request("GET", PAGE)
            content = link.getresponse().read(PAGE_BYTES)
        except (OSError, http.client.HTTPException) as error:
            if not self._wants_page(config):
                return
            came = " ".join(str(error).split()) or type(error).__name__
            raise NotConnected("the sensor's page", came, advice, where) from error
        finally:
            link.close()
        content = content.lstrip()
        page = next(iter(protocol.Decoder().feed(content)), None) if content.startswith(b"<") else None
        if not isinstance(page, protocol.Calibration):
            if not self._wants_page(config):
                return
            raise SettingsRefused("a page with counts per force and torque, and known units", "another", advice, where)
        if page.rate_hz and page.rate_hz != config.rate_hz:
            raise SettingsRefused(f"rate_hz = {page.rate_hz:g}, as on its page", f"{config.rate_hz:g}", where=where)
        if config.serial and page.serial != config.serial:
            raise SettingsRefused(f"serial number {config.serial}", page.serial or "none", "another port", where)
        for name in ("counts_per_n", "counts_per_nm"):
            given, right = getattr(config, name), getattr(page, name)
            if given is not None and abs(given / right - 1.0) > GAIN_OFF:
                try_this = "take both keys out of the rig file: the page's counts are then used"
                raise SettingsRefused(f"{name} = {right:g}, as on its page", f"{given:g}", try_this, where)
        self._record_raw(content, self._clock())
        self._measurer.learn(page)
        self._page = page

    def _next(self, count: int) -> list[Wrench]:
        wait_s = SILENCE_S + 2.0 * count / self.config.rate_hz
        return self._gather(count, wait_s, "check power, cable, address and firewall; is RDT enabled on its page?")

    def _zero(self) -> None:
        before = self._next(STILL_READINGS)
        counts = np.array([one.counts[0] for one in before], float)
        if not all(one.usable for one in before):
            raise SettingsRefused("a sensor without faults", "a status with faults", "see its page", self.name)
        varies = self._measurer.load(counts.std(axis=0))
        if (varies > [STILL_N] * 3 + [STILL_NM] * 3).any():
            came = f"standard deviations of {np.array2string(varies, precision=3)} N and N m"
            raise SettingsRefused("a load at rest", came, "keep what touches the sensor at rest", self.name)
        self._send(protocol.request(protocol.Command.BIAS, 255 if isinstance(self.config, HexConfig) else 0))
        self._next(STILL_READINGS)
