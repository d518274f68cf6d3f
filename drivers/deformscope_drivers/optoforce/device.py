"""OptoForce's DAQ as a device: settings stored in a shadow copy, checked zeroing, losses found by its counter."""

import math
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from deformscope_drivers.clock import Clock, ClockFit, Unwrap, monotonic_ns
from deformscope_drivers.device import StreamDevice
from deformscope_drivers.errors import CommandRefused, NoReply, SettingsRefused
from deformscope_drivers.health import Description, Identity, Link
from deformscope_drivers.optoforce import protocol
from deformscope_drivers.optoforce.config import OptoforceConfig, filter_of, speed_of
from deformscope_drivers.optoforce.counter import WRAP, CounterStep, Gap
from deformscope_drivers.optoforce.measurement import ForceMeasurement, ForceMeasurer
from deformscope_drivers.transport import CAN_FRAME_BYTES, Transport, serial_or_can

REPLY_S = 0.3
"""A DAQ that acknowledges does so within a few milliseconds; some firmware never does."""
SILENCE_S = 1.0
SILENCE_READINGS = 10
"""A DAQ that should send is lost when nothing came for this long, or for this many periods if that is longer."""
RESTART_S = 0.1
"""A gap this long, or of `SILENCE_READINGS`, may hide a restart: then the settings are sent again, to be safe."""
ZERO_REST_S = 0.005
"""Time between clearing the zero point and setting it: at least 2 ms, or the DAQ ignores it."""
STILL_COUNTS = 30.0
STILL_S = 0.25
STILL_READINGS = 10
STILL_PARTS = 5
SETTLED = 6.0
"""Time constants of the filter after which a changed zero point has gone through it."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DaqSettings:
    """The settings last sent to the DAQ, which cannot be read back. zeroed: the DAQ subtracts a zero point"""

    speed: protocol.Speed
    filter: protocol.Filter
    zeroed: bool = False


class Optoforce(StreamDevice[ForceMeasurement]):
    """A DAQ with its sensors. `with Optoforce(OptoforceConfig(port="/dev/ttyACM0")) as sensor: ...`

    Opening sends the settings and waits for the first reading. After a lost link, or a restart of the DAQ, they are
    sent again; a lost zero point is subtracted here from then on.
    transport, clock: used instead of the configuration's port and the host's clock (in a simulated laboratory)"""

    settings: DaqSettings
    _zero_in_doubt: bool
    _unwrap: Unwrap | None

    def __init__(
        self, config: OptoforceConfig, *, transport: Transport | None = None, clock: Clock = monotonic_ns
    ) -> None:
        self.config = config
        self._fill_to = CAN_FRAME_BYTES if config.bus else 1
        super().__init__(
            transport
            or serial_or_can(
                config.port,
                config.bus,
                baudrate=config.baudrate,
                receive_id=config.receive_id,
                send_id=config.send_id,
                bitrate=config.bitrate,
            ),
            reconnect=config.reconnect,
            stuck_after_s=config.stuck_after_s,
            clock=clock,
        )
        self._begin_session()

    # What a user calls -----------------------------------------------------------------------------------------------

    @property
    def kind(self) -> protocol.Kind | None:
        """Type of the sensors at the DAQ; None before the first reading."""
        return self._measurer.kind

    @property
    def offset_counts(self) -> FloatArray | None:
        """(channels, axes) counts that `zero` took away; None = nothing was taken away."""
        return self._measurer.offset

    def zero(self, *, still_counts: float = STILL_COUNTS) -> FloatArray:
        """Take the present load for zero; returns the counts that it was, (channels, axes).

        still_counts: how much the readings may vary meanwhile. Raises SettingsRefused when they vary more, when the
        sensor is not usable or overloaded, and when they are not near zero afterwards. Takes about a second."""
        return self._do(lambda: self._zero(still_counts), 60.0)

    def identity(self) -> Identity:
        """The sensors of the DAQ, and its serial number if it was requested."""
        return Identity(f"OptoForce {self._measurer.kind.value}" if self._measurer.kind else "OptoForce", self._serial)

    def describe(self) -> Description:
        channels = 4 if self.kind is protocol.Kind.FOUR_CHANNEL else 1
        return Description(self.config.rate_hz, channels, self.kind is protocol.Kind.SIX_AXIS)

    def serial_number(self) -> str:
        """The serial number; raises NoReply with firmware that has none."""
        return self._do(self._ask_serial, 10.0)

    # What the base class asks for ------------------------------------------------------------------------------------

    def _make_decoder(self) -> protocol.Decoder:
        return protocol.Decoder(self._fill_to)

    def _start(self) -> None:
        if self._link is not Link.LOST:
            self._begin_session()
        self._measurer.kind = None
        self._restart = ""
        if self.config.serial and (came := self._ask_serial()) != self.config.serial:
            advice = "another port, or this sensor's own sensitivity report"
            raise SettingsRefused(f"serial number {self.config.serial}", came, advice, self.name)
        self._change(self.settings)
        if self.config.zero_at_start and self._measurer.offset is None:
            self._zero(STILL_COUNTS)

    def _receive(self, timeout_s: float) -> Iterable[ForceMeasurement]:
        if self._restart:
            reason, self._restart = self._restart, ""
            self._send_settings(replace(self.settings, zeroed=False))
            self._report_link(Link.CONNECTED, f"{reason}; its settings were sent again")
        return super()._receive(timeout_s)

    def _measure(self, event: protocol.Reply, host_ns: int) -> Iterable[ForceMeasurement]:
        if not isinstance(event, protocol.Reading):
            return []
        gap = self._measurer.follow(event, host_ns)
        if gap.lost:
            self._count_lost(gap.lost)
        self._look_for_restart(gap, host_ns)
        self._before_ns = host_ns
        step, unfit = self._measurer.track.step, (CounterStep.JUMPED, CounterStep.LATE, CounterStep.REPEATED)
        if step is not None and gap.verdict not in unfit:
            if self._unwrap is None or self._clock_fit is None or gap.verdict is CounterStep.RESTARTED:
                tick_ns = self.settings.speed * 1e6 / step
                self._unwrap, self._clock_fit = Unwrap(WRAP, tick_ns), ClockFit(tick_ns)
            self._clock_fit.add(self._unwrap(event.counter, host_ns), host_ns)
        zeroed, in_doubt = self.settings.zeroed, self._zero_in_doubt
        return [self._measurer.measure(event, host_ns, gap, zeroed=zeroed, zero_in_doubt=in_doubt)]

    def _fingerprint(self, reading: ForceMeasurement) -> Hashable:
        return reading.counts

    def _extra_health(self) -> dict[str, float]:
        measurer, track = self._measurer, self._measurer.track
        return {
            "unacknowledged": self._unacknowledged,
            "unusable": measurer.unusable,
            "overloaded": measurer.overloaded,
            "doubted": measurer.doubted,
            "damaged_counters": track.damaged,
            "repeated": track.repeated,
            "late": track.late,
            "restarts": track.restarts,
        }

    # Within: all in the device's thread ------------------------------------------------------------------------------

    def _begin_session(self) -> None:
        self.settings = DaqSettings(speed_of(self.config.rate_hz), filter_of(self.config.filter_hz))
        self._measurer = ForceMeasurer(self.config.sensitivities, self.name)
        self.acknowledges: bool | None = None  # whether the DAQ answered the last settings
        self._serial = ""
        self._restart = ""
        self._zero_in_doubt = False
        self._before_ns = 0
        self._unwrap = None
        self._unacknowledged = 0

    def _change(self, wanted: DaqSettings) -> None:
        """Send speed and filter, and see that readings come.

        Every `Configure` affects the zero point as well, and the effect of a second 255 on it is not documented. So it
        is cleared, and its value is subtracted here."""
        self._send_settings(replace(wanted, zeroed=False))
        if wanted.speed:
            self._next(1)

    def _send_settings(self, wanted: DaqSettings) -> None:
        zero = protocol.Zero.SET if wanted.zeroed else protocol.Zero.CLEAR
        command = protocol.Configure(wanted.speed, wanted.filter, zero)
        self._zero_in_doubt |= wanted.zeroed != self.settings.zeroed
        self._forget_counter(wanted.speed)
        try:
            reply = self._ask(
                protocol.encode(command),
                lambda event: event if isinstance(event, protocol.ConfigReply) else None,
                REPLY_S,
                what="an acknowledgement",
            )
        except NoReply:
            self.acknowledges = False
            self._unacknowledged += 1
        else:
            self.acknowledges = True
            self._zero_in_doubt = False
            if reply.result != 0:
                raise CommandRefused(reply.result, "settings refused", f"setting {wanted}", where=self.name)
        self.settings = wanted
        self._zero_in_doubt = False
        self._forget_counter(wanted.speed)
        self._expect(wanted.speed.rate_hz or None)
        quiet_s = max(SILENCE_S, SILENCE_READINGS * wanted.speed * 1e-3)
        self._silence_ns = round(quiet_s * 1e9) if wanted.speed else None

    def _look_for_restart(self, gap: Gap, host_ns: int) -> None:
        """A DAQ that was switched off and on sends at its defaults, and has forgotten its zero point."""
        if gap.verdict is CounterStep.RESTARTED:
            self._restart = "the DAQ restarted"
            self.settings = replace(self.settings, zeroed=False)
        elif gap.verdict is CounterStep.LOST:
            period_ns = self.settings.speed * 1e6
            pause_ns = max(host_ns - self._before_ns, gap.lost * period_ns)
            if pause_ns >= max(RESTART_S * 1e9, SILENCE_READINGS * period_ns):
                self._restart = f"nothing for {pause_ns / 1e9:.3g} s: the DAQ may have restarted"
                self._zero_in_doubt |= self.settings.zeroed

    def _forget_counter(self, speed: protocol.Speed) -> None:
        self._measurer.track.restart(speed * 1e6 if speed else None)
        self._unwrap = self._clock_fit = None

    def _ask_serial(self) -> str:
        reply = self._ask(
            protocol.encode(protocol.SerialRequest()),
            lambda event: event if isinstance(event, protocol.SerialReply) else None,
            REPLY_S,
            tries=2,
            what="a serial number",
        )
        self._serial = reply.serial
        return reply.serial

    def _zero(self, still_counts: float) -> FloatArray:
        rate_hz = self.settings.speed.rate_hz
        if not rate_hz:
            raise SettingsRefused("a DAQ that sends", "one that is stopped", "rate_hz = 1000", self.name)
        count = max(STILL_READINGS, math.ceil(STILL_S * rate_hz))
        cutoff_hz = self.settings.filter.cutoff_hz
        settling_s = 0.0 if cutoff_hz is None else SETTLED / (2.0 * math.pi * cutoff_hz)
        settle = math.ceil((ZERO_REST_S + settling_s) * rate_hz)
        self._still_mean(count, still_counts, "the zero point is unchanged")
        self._measurer.offset = None
        self._send_settings(replace(self.settings, zeroed=False))
        self._next(settle)
        before = self._still_mean(count, still_counts, "the zero point is cleared")
        self._send_settings(replace(self.settings, zeroed=True))
        self._next(settle)
        after = self._still_mean(count, still_counts, "the zero point is set, perhaps wrongly")
        if np.abs(after).max() > still_counts:
            self._send_settings(replace(self.settings, zeroed=False))
            expected = f"readings within {still_counts:g} counts of zero"
            came = f"{np.array2string(after, precision=0)}; the zero point is cleared again"
            raise SettingsRefused(expected, came, "zero() once more", self.name)
        self._measurer.offset = before - after
        self._measurer.offset.setflags(write=False)
        return self._measurer.offset

    def _still_mean(self, count: int, still_counts: float, state: str) -> FloatArray:
        """(channels, axes) mean of a number of readings; refused if they vary."""
        readings = self._next(count)
        bad = next((reading for reading in readings if not reading.status.usable or reading.overload), None)
        if bad is not None:
            raise SettingsRefused("a sensor without faults", f"{bad.status}; {state}", "unload it", self.name)
        counts = np.array([reading.counts for reading in readings if not reading.doubts], float)
        if len(counts) < STILL_PARTS:
            came = f"{len(counts)} of {count}; {state}"
            raise SettingsRefused("plausible readings", came, "check the cable", self.name)
        means = np.stack([part.mean(axis=0) for part in np.array_split(counts, STILL_PARTS)])
        varies = max(float(np.ptp(means, axis=0).max()), float(counts.std(axis=0).max()))
        if varies > still_counts:
            expected = f"readings that vary by less than {still_counts:g} counts"
            advice = "keep what touches the sensor at rest; zero(still_counts=...)"
            raise SettingsRefused(expected, f"{varies:.3g}; {state}", advice, self.name)
        return np.asarray(counts.mean(axis=0))

    def _next(self, count: int) -> list[ForceMeasurement]:
        wait_s = max(SILENCE_S, SILENCE_READINGS * self.settings.speed * 1e-3) + 2e-3 * count * self.settings.speed
        return self._gather(
            count, wait_s, "check power, cable and port; is it an OptoForce DAQ with protocol 1.4 or later?"
        )
