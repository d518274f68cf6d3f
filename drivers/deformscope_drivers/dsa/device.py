"""The SDH's tactile sensors as a device: started in the right order, set as configured, its frames stamped and cut up.

with Dsa(DsaConfig(port="/dev/ttyUSB0")) as dsa:
    for reading in dsa:
        print(dsa.contacts(reading))
"""

import contextlib
from collections.abc import Hashable, Iterable
from typing import Any, Self, TypeVar

import numpy as np

from deformscope_drivers import errors
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.device import RECONNECT, Reconnect, StreamDevice
from deformscope_drivers.dsa import messages
from deformscope_drivers.dsa.config import DsaConfig
from deformscope_drivers.dsa.measurer import TactileMeasurer, TactileReading, TimestampStatus
from deformscope_drivers.dsa.pads import FloatArray, Pad, PadContact, pad_contact, to_pressure
from deformscope_drivers.dsa.protocol import Decoder, encode, stop, stream
from deformscope_drivers.health import Description, Identity, PadLayout
from deformscope_drivers.transport import SerialTransport, Transport

BAUDRATE = 115_200

STOP_TIMEOUT_S = 3.0
STOP_TRIES = 4
"""A controller that was just switched on answers after 8 s; Schunk's software waits as long."""

REPLY_TIMEOUT_S = 1.0
REPLY_TRIES = 3
SETTLE_S = 0.05
"""Time in which answers to earlier requests, and frames, may still arrive. (Schunk's software waits 1 s after the first
stop. Answers come in order, so a late one to it is past when the controller has reported its identity.)"""

CELLS_MAX = (0xFFFF - 5) // 2
"""More would not fit a packet."""

THRESHOLD_FROM = 268
SENSITIVITY_READ_BACK_FROM = 219
SENSITIVITY_TOLERANCE = 0.005


ReplyT = TypeVar("ReplyT", bound=messages.Reply)
T = TypeVar("T")


class Dsa(StreamDevice[TactileReading]):
    """The Weiss DSACON32m tactile controller of a Schunk SDH.

    The controller's description (`controller`, `sensor`, `matrices`) is there once it is open. The configured settings
    are set at every connection: a controller that was switched off loses them.
    config: how it runs; transport: instead of the configuration's port"""

    def __init__(
        self,
        config: DsaConfig,
        *,
        transport: Transport | None = None,
        reconnect: Reconnect | None = RECONNECT,
        clock: Clock = monotonic_ns,
    ) -> None:
        self._measurer = TactileMeasurer()
        super().__init__(
            transport or SerialTransport(config.port, BAUDRATE),
            silence_s=config.silence_s,
            reconnect=reconnect,
            stuck_after_s=config.stuck_after_s,
            clock=clock,
        )
        self.config = config
        self._controller: messages.ControllerInfo | None = None
        self._sensor: messages.SensorInfo | None = None
        self.matrices: tuple[messages.MatrixInfo, ...] = ()  # matrix = 2 * finger + part, by `Pad.of_matrix`
        self._begin()

    def open(self, *, own_thread: bool = True) -> Self:
        """Connect, and set what the configuration says. Raises NotConnected, NoReply, SettingsRefused..."""
        if not self.is_open:
            self._begin()
        return super().open(own_thread=own_thread)

    # What it is ------------------------------------------------------------------------------------------------------

    @property
    def controller(self) -> messages.ControllerInfo:
        """Serial number, firmware and state at the last opening. Raises NotConnected before it."""
        return self._known(self._controller)

    @property
    def sensor(self) -> messages.SensorInfo:
        """Number of matrices, and the sensor's serial number. Raises NotConnected before the first opening."""
        return self._known(self._sensor)

    @property
    def pads(self) -> tuple[Pad, ...]:
        """The pads by matrix."""
        return tuple(Pad.of_matrix(matrix) for matrix in range(len(self.matrices)))

    # What a reading means --------------------------------------------------------------------------------------------

    def pressure_pa(self, reading: TactileReading) -> list[FloatArray]:
        """For each matrix the pressure on its texels (rows, columns) [Pa], by the configured calibration."""
        return to_pressure(reading.pads, self.config.calibration)

    def contacts(self, reading: TactileReading) -> list[PadContact]:
        """For each matrix contact area, force and centre of pressure."""
        pressures_pa = self.pressure_pa(reading)
        return [
            pad_contact(counts, pressure_pa, matrix)
            for counts, pressure_pa, matrix in zip(reading.pads, pressures_pa, self.matrices, strict=True)
        ]

    def describe(self) -> Description:
        pads = tuple(
            PadLayout(
                pad.name,
                matrix.cells_y,
                matrix.cells_x,
                (matrix.texel_width_mm / 1e3, matrix.texel_height_mm / 1e3),
                index,
                pad.finger,
                int(pad.part),
            )
            for index, (pad, matrix) in enumerate(zip(self.pads, self.matrices, strict=True))
        )
        full = to_pressure([np.array([[messages.TEXEL_MAX]], np.uint16)] * len(pads), self.config.calibration)
        return Description(pads=pads, full_scale_pa=float(max(map(np.max, full))))

    def identity(self) -> Identity:
        """Identity that the controller reported while connecting."""
        if self._controller is None:
            return Identity("Weiss DSACON32m")
        return Identity("Weiss DSACON32m", str(self._controller.serial_number), str(self._controller.software_version))

    # The stream device's part ----------------------------------------------------------------------------------------

    def _make_decoder(self) -> Decoder:
        return self._measurer.connect()

    def _start(self) -> None:
        """Stop, discard data in transit, query its identity, set it, and start its stream."""
        self._silence_ns = None
        self._acknowledged(stop(), "stop", STOP_TIMEOUT_S, STOP_TRIES)
        self._settle(SETTLE_S)
        self._controller = self._query(messages.QueryController(), messages.ControllerInfo, "query of the controller")
        self._sensor = self._query(messages.QuerySensor(), messages.SensorInfo, "query of the sensor")
        matrices = []
        for index in range(self._sensor.matrix_count):
            matrix = self._query(messages.QueryMatrix(index), messages.MatrixInfo, f"query of matrix {index}")
            sizes = np.array([matrix.texel_width_mm, matrix.texel_height_mm])
            if not matrix.cells or not np.isfinite(sizes).all() or (sizes <= 0).any():
                came = f"{matrix.cells_x} x {matrix.cells_y} of {sizes[0]:g} x {sizes[1]:g} mm"
                raise errors.ProtocolViolation(f"texels and their size for matrix {index}", came, where=self.name)
            matrices.append(matrix)
        cells = sum(matrix.cells for matrix in matrices)
        if not 0 < cells <= CELLS_MAX:
            raise errors.ProtocolViolation(f"matrices of 1 to {CELLS_MAX} texels in all", f"{cells}", where=self.name)
        self.matrices = tuple(matrices)
        self._measurer.describe([(matrix.cells_y, matrix.cells_x) for matrix in matrices])
        for number, sensitivity in self._by_matrix("sensitivity", self.config.sensitivity):
            self._set_sensitivity(number, sensitivity)
        for number, threshold in self._by_matrix("threshold", self.config.threshold):
            self._set_threshold(number, threshold)
        self._expect(0.0)
        self._begin_stream()
        command = stream(rle=self.config.rle, frame_rate_hz=self.config.frame_rate_hz)
        self._acknowledged(command, "start of streaming")
        self._silence_ns = round(self.config.silence_s * 1e9)
        self._measured_ns = self._clock()

    def _stop(self) -> None:
        with contextlib.suppress(errors.DeviceError):
            self._send(encode(stop()))

    def _measure(self, event: messages.Reading | messages.Reply, host_ns: int) -> Iterable[TactileReading]:
        found = self._measurer.measure(event, host_ns)
        if found is TimestampStatus.JUMPED:
            self._count_refused("timestamp")
        if not isinstance(found, TactileReading):
            return []
        self._measured_ns = host_ns
        self._clock_fit = self._measurer.clock_fit
        return [found]

    def _receive(self, timeout_s: float) -> Iterable[TactileReading]:
        readings = list(super()._receive(timeout_s))
        if self._silence_ns is not None and self._clock() - self._measured_ns > self._silence_ns:
            expected, came = "frames from the controller", f"none without errors for {self.config.silence_s:g} s"
            raise errors.LinkLost(expected, came, "check cable and baud rate", self.name)
        return readings

    def _fingerprint(self, reading: TactileReading) -> Hashable:
        """Pads that nothing touches may read all zeros for ever."""
        return reading.texels.tobytes() if reading.texels.any() else None

    def _extra_health(self) -> dict[str, float]:
        return {"repeated": self._measurer.repeated, "clock_restarts": self._measurer.restarts}

    # Within: all in the device's thread ------------------------------------------------------------------------------

    def _by_matrix(self, name: str, value: T | tuple[T, ...] | None) -> list[tuple[int | None, T]]:
        """The configured values, each with its matrix; None = all of them."""
        if not isinstance(value, tuple):
            return [] if value is None else [(None, value)]
        if len(value) != len(self.matrices):
            expected = f"a {name} for each of {len(self.matrices)} matrices"
            raise errors.SettingsRefused(expected, f"{len(value)}", "one number for all", self.name)
        return list(enumerate(value))

    def _set_sensitivity(self, matrix: int | None, wanted: float) -> None:
        """Set it, and read it back where the firmware can."""
        flags = messages.Adjust.ALL if matrix is None else 0
        self._acknowledged(messages.SetSensitivity(flags, matrix or 0, wanted), "set sensitivity")
        if self.controller.software_version < SENSITIVITY_READ_BACK_FROM:
            return
        for index in range(len(self.matrices)) if matrix is None else (matrix,):
            reported = self._query(messages.QuerySensitivity(index), messages.SensitivityInfo, "query of sensitivity")
            if not abs(reported.current - wanted) <= SENSITIVITY_TOLERANCE:
                expected = f"sensitivity {wanted:g} of matrix {index}"
                raise errors.SettingsRefused(expected, f"{reported.current:g}", where=self.name)

    def _set_threshold(self, matrix: int | None, wanted: int) -> None:
        """Set it, and read it back."""
        version = self.controller.software_version
        if version < THRESHOLD_FROM:
            advice = "no threshold in the configuration"
            raise errors.SettingsRefused(f"firmware {THRESHOLD_FROM} for thresholds", f"{version}", advice, self.name)
        flags = messages.Adjust.ALL if matrix is None else 0
        self._acknowledged(messages.SetThreshold(flags, matrix or 0, wanted), "set threshold")
        for index in range(len(self.matrices)) if matrix is None else (matrix,):
            reported = self._query(messages.QueryThreshold(index), messages.ThresholdInfo, "query of threshold")
            if reported.threshold != wanted:
                raise errors.SettingsRefused(
                    f"threshold {wanted} of matrix {index}", f"{reported.threshold}", where=self.name
                )

    def _acknowledged(
        self, command: messages.Command, doing: str, timeout_s: float = REPLY_TIMEOUT_S, tries: int = REPLY_TRIES
    ) -> None:
        self._query(command, messages.Ack, doing, timeout_s, tries)

    def _query(
        self,
        command: messages.Command,
        kind: type[ReplyT],
        doing: str,
        timeout_s: float = REPLY_TIMEOUT_S,
        tries: int = REPLY_TRIES,
    ) -> ReplyT:
        """The reply to a command, sent again where none came or its checksum did not arrive intact."""
        packet = encode(command)
        id = packet[3]

        def accept(event: messages.Reading | messages.Reply) -> Any:
            return event if _is_answer(event, id) and not isinstance(event, messages.Reading) else None

        error = messages.CHECKSUM
        for tries_left in reversed(range(tries)):
            try:
                reply: messages.Reply = self._ask(packet, accept, timeout_s, what=f"an answer to {doing}")
            except errors.NoReply:
                if not tries_left or self._closing.is_set():
                    raise
                self._settle(SETTLE_S)
                continue
            if reply.error == messages.SUCCESS and isinstance(reply, kind):
                return reply
            error = reply.error
            if error != messages.CHECKSUM:
                break
        raise self._refusal(error, doing)

    def _refusal(self, code: int, doing: str) -> errors.DeviceError:
        if code == messages.SUCCESS:
            return errors.ProtocolViolation(f"what {doing} asks for", "another answer", where=self.name)
        return errors.CommandRefused(code, messages.error_name(code), doing, where=self.name)

    def _settle(self, wait_s: float) -> None:
        """Let answers that are still in transit come, and discard them; readings are published."""
        until_ns = self._clock() + round(wait_s * 1e9)
        while (left_ns := until_ns - self._clock()) > 0:
            for event, host_ns in self._listen(left_ns / 1e9):
                for reading in self._measure(event, host_ns):
                    self._publish(reading)

    def _begin(self) -> None:
        self._measurer = TactileMeasurer()
        self._measured_ns = 0
        self._begin_stream()

    def _begin_stream(self) -> None:
        """Frames are requested again, and the controller's clock may have been reset meanwhile."""
        self._measurer.begin_stream()
        self._clock_fit = self._measurer.clock_fit

    def _known(self, reported: T | None) -> T:
        if reported is None:
            raise errors.NotConnected("a device that was opened", "one that was not", "open() it", self.name)
        return reported


def _is_answer(event: messages.Reading | messages.Reply, id: int) -> bool:
    """Whether an event ends the wait for the answer to a command; `pending` does not."""
    if isinstance(event, messages.Reading) or event.error == messages.PENDING:
        return False
    return (event.command if isinstance(event, messages.Ack) else messages.LAYOUT_OF[type(event)].id) == id
