"""A simulated DSACON32m, byte for byte: a state machine that is fed bytes and time. It uses no port, thread or clock.

Its behaviour is that of the protocol reference (protocols.md 1a). Assumed, where that is incomplete: the error codes
for commands that cannot be carried out, that sensitivity is a gain on the counts (0.5 = 1), that texels below the
threshold are sent as 0, and the factory values."""

from dataclasses import dataclass

import numpy as np

from deformscope_drivers.doubles import Line
from deformscope_drivers.dsa import messages
from deformscope_drivers.dsa.messages import TEXEL_MAX
from deformscope_drivers.dsa.pads import SCHUNK_PA_PER_COUNT
from deformscope_drivers.dsa.protocol import CommandDecoder, Faulty, encode
from deformscope_drivers.dsa.scene import GraspScene, Scene, sdh_matrices
from deformscope_drivers.framing import Skipped

SERIAL_BYTES_PER_S = 11_520
"""115 200 baud, 8N1."""

FRAME_PERIOD_NS = -(-1_000_000_000 // 30)
BOOT_S = 8.0
"""A real controller's time from power to answers."""

BOOT_NOISE = b"\x1b[5n"
BOOT_NOISE_S = (7.0, 7.41, 7.82)

FACTORY_SENSITIVITY = 0.5
FACTORY_THRESHOLD = 20
NOISE_COUNTS = 4.0

_THRESHOLD_FROM = 268
_SENSITIVITY_READ_BACK_BROKEN_UP_TO = 218


@dataclass
class _MatrixSettings:
    """Settings of one matrix: sensitivity, 0 to 1; threshold, counts below which a texel reads 0."""

    sensitivity: float = FACTORY_SENSITIVITY
    threshold: int = FACTORY_THRESHOLD


class DsaDouble:
    """`PtyWire(DsaDouble())`, or `MemoryTransport(DsaDouble(), clock)`.

    software_version: decides which quirks it has (268 and 269: fewest); serial_number: serial number of controller and
    sensor; matrices: the matrices that it describes (default: the SDH's six); scene: pressures on them [Pa] (default:
    `GraspScene`); pa_per_count: pressure per count of a texel at sensitivity 0.5; noise_counts: standard deviation,
    before the threshold; bytes_per_s: the line's, None = as over TCP; boot_s: time from power-up to answers (`BOOT_S`
    for that of a real one); seed: seed of scene and noise; first_timestamp_ms: the clock at power-up"""

    def __init__(
        self,
        *,
        software_version: int = 269,
        serial_number: int = 4321,
        matrices: list[messages.MatrixInfo] | None = None,
        scene: Scene | None = None,
        pa_per_count: float = SCHUNK_PA_PER_COUNT,
        noise_counts: float = NOISE_COUNTS,
        bytes_per_s: float | None = SERIAL_BYTES_PER_S,
        boot_s: float = 0.0,
        seed: int = 0,
        first_timestamp_ms: int = 0,
    ) -> None:
        self.matrices = sdh_matrices() if matrices is None else matrices
        self.cells = sum(matrix.cells for matrix in self.matrices)
        self._shapes = [(matrix.cells_y, matrix.cells_x) for matrix in self.matrices]
        self._scene = GraspScene(self._shapes, seed) if scene is None else scene
        self._software_version = software_version
        self._serial_number = serial_number
        self._pa_per_count = pa_per_count
        self._noise_counts = noise_counts
        self._random = np.random.default_rng(seed)
        self._boot_ns = round(boot_s * 1e9)
        self._first_timestamp_ms = first_timestamp_ms
        self._stored = [_MatrixSettings() for _ in self.matrices]
        self._line = Line(bytes_per_s)
        self._acquisition = 0
        self._start(0)

    # The double's protocol (deformscope_drivers.doubles.Double) ------------------------------------------------------

    def power_up(self, now_ns: int) -> None:
        """Start as after switching on; settings made persistent are still there."""
        self._line.clear()
        self._start(now_ns)
        if self._boot_ns:
            for at_s in BOOT_NOISE_S:
                self._line.send(BOOT_NOISE, now_ns + round(at_s / BOOT_S * self._boot_ns))

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes from the host; before it has booted, they are lost."""
        self._take_frames(now_ns)
        if now_ns < self._ready_ns:
            return
        for event in self._decoder.feed(data):
            if isinstance(event, Skipped):
                continue
            if (reply := self._carry_out(event, now_ns)) is not None:
                self._line.send(encode(reply), now_ns)

    def due(self, now_ns: int) -> bytes:
        """Bytes that have left the line by now."""
        self._take_frames(now_ns)
        return self._line.due(now_ns)

    def next_ns(self, now_ns: int) -> int | None:
        """When the next byte has been sent, or the next frame is taken."""
        moments = [self._line.next_ns(), self._next_frame_ns()]
        return min((moment for moment in moments if moment is not None), default=None)

    # Measuring -------------------------------------------------------------------------------------------------------

    def texels(self, time_s: float) -> messages.TexelArray:
        """(cells,) counts of one frame, `time_s` after power-up."""
        counts = []
        for pressure_pa, shape, settings in zip(self._scene(time_s), self._shapes, self._settings, strict=True):
            if np.shape(pressure_pa) != shape:
                raise ValueError(f"a scene's pressures have the matrix's shape {shape}; got {np.shape(pressure_pa)}")
            gain = settings.sensitivity / FACTORY_SENSITIVITY
            exact = np.asarray(pressure_pa, np.float64) / self._pa_per_count
            noisy = gain * exact + self._random.normal(0.0, self._noise_counts, shape)
            whole = np.clip(np.rint(noisy), 0, TEXEL_MAX).astype(np.uint16)
            counts.append(np.where(whole < settings.threshold, 0, whole).astype(np.uint16).ravel())
        return np.concatenate(counts)

    def _take_frames(self, now_ns: int) -> None:
        while (at_ns := self._next_frame_ns()) is not None and at_ns <= now_ns:
            since_ns = at_ns - self._power_ns
            timestamp_ms = (self._first_timestamp_ms + since_ns // 1_000_000) % (1 << 32)
            flags = messages.FRAME_RLE if self._acquisition & messages.Acquisition.RLE else 0
            self._line.send(encode(messages.Reading(timestamp_ms, flags, self.texels(since_ns / 1e9))), at_ns)
            self._frame_ns = at_ns + FRAME_PERIOD_NS

    def _next_frame_ns(self) -> int | None:
        """The next frame is sent as soon as the line is free, but no more than 30 a second."""
        return max(self._frame_ns, self._line.free_ns) if self._acquisition & messages.Acquisition.ON else None

    # Commands --------------------------------------------------------------------------------------------------------

    def _start(self, now_ns: int) -> None:
        self._power_ns = now_ns
        self._ready_ns = now_ns + self._boot_ns
        self._decoder = CommandDecoder()
        self._settings = [_MatrixSettings(one.sensitivity, one.threshold) for one in self._stored]
        self._acquisition = 0
        self._frame_ns = now_ns

    def _carry_out(self, command: messages.Command | Faulty, now_ns: int) -> messages.Reply | None:
        match command:
            case Faulty():
                return messages.Ack(command.id, command.error)
            case messages.ConfigureAcquisition():
                self._acquisition = command.flags
                self._frame_ns = max(self._frame_ns, now_ns)
                return messages.Ack(messages.Id.ACQUISITION)
            case messages.QueryController():
                acquiring = 0x40 if self._acquisition & messages.Acquisition.ON else 0
                return messages.ControllerInfo(
                    error=messages.SUCCESS,
                    serial_number=self._serial_number,
                    hardware_version=0x10,
                    software_version=self._software_version,
                    status=0x80 | acquiring,
                    features=0x10,  # RS-232
                    sensor_controller_type=0,
                    active_interface=0,
                    can_baud=0,
                    can_id=0,
                )
            case messages.QuerySensor():
                return messages.SensorInfo(messages.SUCCESS, len(self.matrices), 0, 1, self._serial_number, 0)
            case messages.QueryMatrix():
                return self._matrix_reply(messages.Id.MATRIX, command.matrix)
            case messages.QuerySensitivity():
                return self._matrix_reply(messages.Id.SENSITIVITY, command.matrix)
            case messages.QueryThreshold():
                if self._software_version < _THRESHOLD_FROM:
                    return messages.Ack(messages.Id.THRESHOLD, messages.UNKNOWN_COMMAND)
                return self._matrix_reply(messages.Id.THRESHOLD, command.matrix)
            case messages.SetSensitivity():
                if not 0.0 <= command.sensitivity <= 1.0:
                    return messages.Ack(messages.Id.SET_SENSITIVITY, messages.WRONG_PARAMETER)
                value = FACTORY_SENSITIVITY if command.flags & messages.Adjust.FACTORY else command.sensitivity
                return self._set(messages.Id.SET_SENSITIVITY, command.flags, command.matrix, sensitivity=value)
            case messages.SetThreshold():
                if self._software_version < _THRESHOLD_FROM:
                    return messages.Ack(messages.Id.SET_THRESHOLD, messages.UNKNOWN_COMMAND)
                if command.threshold > TEXEL_MAX:
                    return messages.Ack(messages.Id.SET_THRESHOLD, messages.WRONG_PARAMETER)
                threshold = FACTORY_THRESHOLD if command.flags & messages.Adjust.FACTORY else command.threshold
                return self._set(messages.Id.SET_THRESHOLD, command.flags, command.matrix, threshold=threshold)

    def _matrix_reply(self, id: messages.Id, matrix: int) -> messages.Reply:
        if matrix >= len(self.matrices):
            return messages.Ack(id, messages.INDEX)
        settings = self._settings[matrix]
        if id == messages.Id.MATRIX:
            return self.matrices[matrix]
        if id == messages.Id.THRESHOLD:
            return messages.ThresholdInfo(messages.SUCCESS, settings.threshold)
        broken = self._software_version <= _SENSITIVITY_READ_BACK_BROKEN_UP_TO
        current = FACTORY_SENSITIVITY if broken else settings.sensitivity
        return messages.SensitivityInfo(messages.SUCCESS, 0x02, current, FACTORY_SENSITIVITY)

    def _set(self, id: messages.Id, flags: int, matrix: int, **values: float) -> messages.Ack | None:
        if matrix >= len(self.matrices):
            return messages.Ack(id, messages.INDEX)
        persistent = bool(flags & messages.Adjust.PERSISTENT)
        chosen = range(len(self.matrices)) if flags & messages.Adjust.ALL else (matrix,)
        for settings in [self._settings, self._stored] if persistent else [self._settings]:
            for index in chosen:
                for name, value in values.items():
                    setattr(settings[index], name, value)
        return None if persistent else messages.Ack(id)  # the firmware does not answer what it stores
