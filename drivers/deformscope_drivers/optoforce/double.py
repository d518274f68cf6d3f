"""A byte-exact simulated DAQ with its sensors: a state machine that is fed bytes and time."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope_drivers.doubles import Line
from deformscope_drivers.optoforce import protocol
from deformscope_drivers.optoforce.config import Sensitivity

SAMPLE_NS = 1_000_000
"""The DAQ samples and filters at 1 kHz, whatever its speed."""
ZERO_REST_NS = 2_000_000
"""How long the zero point must have been cleared before it can be set again (JHU's driver found this out)."""
FILTER_MEMORY = 8.0
"""Time constants after which a filter has forgotten; what lies longer ago is not computed."""

FloatArray = npt.NDArray[np.float64]
Scene = Callable[[float], npt.ArrayLike]
"""Time [s] on the clock that the double is fed -> loads [N], [N m], (axes,) or (channels, axes)."""

OMD_20_SE_40N = Sensitivity(counts_at_nominal=(16037.0, 16037.0, 16037.0), nominal=(40.0, 40.0, 40.0))
"""The only sensor whose sensitivity is published: OMD-20-SE-40N, serial number ISE0A129. Another sensor has another."""


_WELL = protocol.Status.of()


@dataclass(frozen=True, slots=True)
class Sensors:
    """The simulated sensors.

    scene: the loads; sensitivity: sensitivity of each channel, or of all
    offset_counts: what every axis reads without load before it is zeroed
    noise_counts: standard deviation of a sample, before the filter
    overload_ratio: beyond this multiple of the nominal load an axis says that it is overloaded (an assumption)
    saturation_ratio: largest reading of an axis, as a multiple of its nominal load (assumed)
    clock_ppm: rate of the DAQ's clock above that of the host's
    counts_samples: the counter counts samples at 1 kHz, not readings (it is not documented which)
    acknowledges: the DAQ answers `Configure`; some firmware does not"""

    kind: protocol.Kind = protocol.Kind.THREE_AXIS
    scene: Scene = lambda time_s: (0.0, 0.0, 0.0)
    sensitivity: Sensitivity | Sequence[Sensitivity] | None = None
    serial: str = "ISE0A129"
    offset_counts: float = 120.0
    noise_counts: float = 5.0
    overload_ratio: float = 1.2
    saturation_ratio: float = 1.8
    clock_ppm: float = 0.0
    counts_samples: bool = False
    acknowledges: bool = True
    bytes_per_s: float | None = None
    seed: int = 0

    def sensitivities(self) -> list[Sensitivity]:
        """The sensitivity of each channel."""
        given = self.sensitivity
        if given is None:
            given = OMD_20_SE_40N if self.kind.axes == 3 else Sensitivity((8000.0,) * 6, (100.0,) * 3 + (2.0,) * 3)
        each = [given] * self.kind.channels if isinstance(given, Sensitivity) else list(given)
        if len(each) != self.kind.channels or any(one.axes != self.kind.axes for one in each):
            raise ValueError(f"expected {self.kind.channels} sensitivities of {self.kind.axes} axes; got {each}")
        return each


@dataclass(slots=True)
class _VolatileSettings:
    """Settings that power-off loses.

    cleared_ns: since when the zero point is cleared; None = it is set"""

    speed: protocol.Speed = protocol.Speed.HZ_100
    filter: protocol.Filter = protocol.Filter.HZ_15
    cleared_ns: int | None = None


class OptoforceDouble:
    """A DAQ. It starts at 100 Hz with the 15 Hz filter, the defaults of a real DAQ.

    The filter is a first-order low-pass on samples at 1 kHz; the order of the real one is not known. An unknown
    setting is refused with result 1, which is an assumption: only 0 is documented.

    unplugged: channels without their sensor, which read 0 and report it; 0 is the first
    silent: the DAQ hangs, and sends nothing"""

    def __init__(self, sensors: Sensors | None = None) -> None:
        self.sensors = sensors or Sensors()
        kind = self.sensors.kind
        each = self.sensors.sensitivities()
        self._per_load = np.array([[1.0] * kind.axes]) / np.stack([one.per_count for one in each])
        nominal = np.array([one.counts_at_nominal for one in each], float)
        self._overload: list[float] = (self.sensors.overload_ratio * nominal).ravel().tolist()
        self._saturation: list[float] = np.minimum(self.sensors.saturation_ratio * nominal, 32767.0).ravel().tolist()
        self._sample_ns = SAMPLE_NS / (1.0 + self.sensors.clock_ppm * 1e-6)
        self._line = Line(self.sensors.bytes_per_s)
        self.unplugged: set[int] = set()
        self.silent = False
        self.power_up(0)

    @property
    def zeroed(self) -> bool:
        """The zero point is set, and not as it came from the factory."""
        return self.settings.cleared_ns is None

    def power_up(self, now_ns: int) -> None:
        """Start as after switching on: defaults, zero point cleared, counter at 0."""
        self.settings = _VolatileSettings(cleared_ns=now_ns - ZERO_REST_NS)
        self._commands = protocol.CommandDecoder()
        self._line.clear()
        self._random = np.random.default_rng(self.sensors.seed)
        self._noise: list[list[float]] = []  # of the next samples, last first
        self._started_ns = now_ns
        self._sample = 0  # the next one to be taken
        self._next_sent = int(self.settings.speed)
        self._sent = 0
        # numbers of all axes of all channels, as lists: a thousand times a second, short arrays cost more
        self._filtered: list[float] | None = None
        self._zero = [0.0] * len(self._overload)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes that the host sent, in pieces of any size."""
        self._run_until(now_ns)
        for command in self._commands.feed(data):
            match command:
                case protocol.Configure():
                    self._configure(command, now_ns)
                case protocol.SerialRequest():
                    self._line.send(protocol.encode(protocol.SerialReply(self.sensors.serial)), now_ns)

    def due(self, now_ns: int) -> bytes:
        """Bytes that have left the device by now and were not handed out before."""
        self._run_until(now_ns)
        return self._line.due(now_ns)

    def next_ns(self, now_ns: int) -> int | None:
        """When `due` next has bytes, without any from the host."""
        self._run_until(now_ns)
        times = [self._line.next_ns(), self._time_ns(self._next_sent) if self.settings.speed else None]
        return min((time for time in times if time is not None), default=None)

    def _configure(self, asked: protocol.Configure, now_ns: int) -> None:
        try:
            speed, filter_, zero = protocol.Speed(asked.speed), protocol.Filter(asked.filter), protocol.Zero(asked.zero)
        except ValueError:
            self._acknowledge(1, now_ns)
            return
        settings = self.settings
        if speed is not settings.speed:
            settings.speed = speed
            self._next_sent = self._sample_at(now_ns) + int(speed)
        settings.filter = filter_
        self._set_zero(zero, now_ns)
        self._acknowledge(0, now_ns)

    def _set_zero(self, zero: protocol.Zero, now_ns: int) -> None:
        settings = self.settings
        if zero is protocol.Zero.CLEAR:
            self._zero = [0.0] * len(self._zero)
            settings.cleared_ns = now_ns if settings.cleared_ns is None else settings.cleared_ns
        elif settings.cleared_ns is not None and now_ns - settings.cleared_ns >= ZERO_REST_NS:
            self._take_samples(self._sample_at(now_ns))
            self._zero = [float(round(count)) for count in self._filtered or [0.0] * len(self._zero)]
            settings.cleared_ns = None

    def _acknowledge(self, result: int, now_ns: int) -> None:
        if self.sensors.acknowledges:
            self._line.send(protocol.encode(protocol.ConfigReply(result)), now_ns)

    def _run_until(self, now_ns: int) -> None:
        speed = self.settings.speed
        while speed and (sent_ns := self._time_ns(self._next_sent)) <= now_ns:
            self._take_samples(self._next_sent)
            if not self.silent:
                assert self._filtered is not None
                axes = self.sensors.kind.axes
                counts = [
                    min(max(round(count - zero), -32768), 32767)
                    for count, zero in zip(self._filtered, self._zero, strict=True)
                ]
                for channel in self.unplugged:
                    counts[channel * axes : (channel + 1) * axes] = [0] * axes
                counter = self._sample - 1 if self.sensors.counts_samples else self._sent
                rows = tuple(tuple(counts[first : first + axes]) for first in range(0, len(counts), axes))
                reading = protocol.Reading(self.sensors.kind, counter % 0x10000, self._status(), rows)
                self._line.send(protocol.encode(reading), sent_ns)
            self._sent += 1
            self._next_sent += int(speed)

    def _sample_at(self, now_ns: int) -> int:
        """The number of the last sample taken by now_ns [ns]; the first one is 0."""
        return math.floor((now_ns - self._started_ns) / self._sample_ns)

    def _time_ns(self, sample: int) -> int:
        """When a sample is taken, by the DAQ's own clock, without any drift of rounding."""
        return self._started_ns + round(sample * self._sample_ns)

    def _take_samples(self, last: int) -> None:
        """Take and filter the samples up to the one of number `last`."""
        cutoff_hz = self.settings.filter.cutoff_hz
        weight = 1.0 if cutoff_hz is None else 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * SAMPLE_NS * 1e-9)
        memory = 1 if cutoff_hz is None else math.ceil(FILTER_MEMORY / weight)
        offset, noise = self.sensors.offset_counts, self.sensors.noise_counts
        for sample in range(max(self._sample, last - memory + 1), last + 1):
            load = np.asarray(self.sensors.scene(self._time_ns(sample) * 1e-9), float) * self._per_load
            if not self._noise:  # drawn for many samples at once, which costs as much as for a few
                self._noise = self._random.standard_normal((256, len(self._zero)))[::-1].tolist()
            counts = [
                min(max(one + offset + chance * noise, -most), most)
                for one, chance, most in zip(load.ravel().tolist(), self._noise.pop(), self._saturation, strict=True)
            ]
            before = counts if self._filtered is None else self._filtered
            self._filtered = [old + weight * (new - old) for old, new in zip(before, counts, strict=True)]
        self._sample = max(self._sample, last + 1)

    def _status(self) -> protocol.Status:
        """The troubled sensor's; where several are, the first one's."""
        assert self._filtered is not None
        offset, limits = self.sensors.offset_counts, self._overload
        beyond = [abs(count - offset) > most for count, most in zip(self._filtered, limits, strict=True)]
        if not self.unplugged and not any(beyond):
            return _WELL
        over = np.reshape(beyond, (-1, self.sensors.kind.axes))
        over[list(self.unplugged)] = False
        troubled = sorted(self.unplugged | set(np.flatnonzero(over.any(axis=1)).tolist()))
        return protocol.Status.of(
            protocol.DaqState.OK,
            protocol.SensorState.NOT_DETECTED if self.unplugged else protocol.SensorState.OK,
            tuple(name for axis, name in enumerate(protocol.AXES[: over.shape[1]]) if over[:, axis].any()),
            several_sensors=len(troubled) > 1,
            sensor_number=troubled[0] + 1 if self.sensors.kind is protocol.Kind.FOUR_CHANNEL else 0,
        )
