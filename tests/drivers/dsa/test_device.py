"""The tactile controller as a device: started, set, read, commanded while it streams, lost and found again."""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from deformscope_drivers import errors
from deformscope_drivers.device import Reconnect
from deformscope_drivers.dsa import Dsa, DsaConfig, DsaDouble
from deformscope_drivers.dsa.double import BOOT_S
from deformscope_drivers.dsa.messages import Ack, ConfigureAcquisition, Reading, SetSensitivity
from deformscope_drivers.dsa.pads import Curve
from deformscope_drivers.dsa.protocol import CommandDecoder, encode, stop, stream
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.wires import PtyWire, TcpWire
from tests.drivers.contract import Bench, DeviceContract, wait_until
from tests.drivers.faults import Faults, FaultyDouble

S = 1_000_000_000
QUICK = Reconnect(0.01, 0.1)


class Desk:
    """A device on a double in memory; time goes on when the device waits."""

    def __init__(self, double=None, **config) -> None:
        self.clock = SimulatedClock()
        self.double = double if double is not None else DsaDouble()
        self.wire = MemoryTransport(self.double, self.clock)
        self.device = Dsa(DsaConfig(**config), transport=self.wire, clock=self.clock)

    def __enter__(self) -> Dsa:
        return self.device.open(own_thread=False)

    def __exit__(self, *_) -> None:
        self.device.close()

    def run(self, seconds: float) -> list:
        until = self.clock() + round(seconds * S)
        readings = []
        while self.clock() < until:
            readings += self.device.poll((until - self.clock()) / S)
        return readings


class Ears(DsaDouble):
    """Writes down what it hears, and can be made to misbehave."""

    def __init__(self, **options) -> None:
        super().__init__(**options)
        self.heard: list = []
        self.unanswered = 0  # commands to pass over in silence
        self.answers: dict[type, list] = {}  # instead of its own, by kind of command, one after the other
        self._ears = CommandDecoder()

    def _carry_out(self, command, now_ns):
        self.heard.append(command)
        if self.unanswered:
            self.unanswered -= 1
            return None
        if self.answers.get(type(command)):
            return self.answers[type(command)].pop(0)
        return super()._carry_out(command, now_ns)


def settings(double: DsaDouble) -> list[tuple[float, int]]:
    """Sensitivity and threshold of each matrix."""
    return [(matrix.sensitivity, matrix.threshold) for matrix in double._settings]


def test_it_asks_what_it_is_before_it_streams() -> None:
    desk = Desk(Ears(), sensitivity=0.75, threshold=(1, 2, 3, 4, 5, 6))
    with desk as device:
        kinds = [type(command).__name__ for command in desk.double.heard]
        assert kinds == [
            "ConfigureAcquisition",
            "QueryController",
            "QuerySensor",
            *["QueryMatrix"] * 6,
            "SetSensitivity",
            *["QuerySensitivity"] * 6,
            *["SetThreshold", "QueryThreshold"] * 6,
            "ConfigureAcquisition",
        ]
        assert desk.double.heard[0] == stop()
        assert desk.double.heard[-1] == stream()
        assert device.controller.software_version == 269
        assert device.sensor.matrix_count == 6
        assert [(matrix.cells_y, matrix.cells_x) for matrix in device.matrices] == [(14, 6), (13, 6)] * 3
        assert [pad.name for pad in device.pads][2:4] == ["thumb_proximal", "thumb_distal"]
        assert device.identity().serial == "4321"
        assert settings(desk.double) == [(0.75, threshold) for threshold in range(1, 7)]


def test_before_it_is_opened_nothing_is_known() -> None:
    device = Desk().device
    assert device.matrices == ()
    with pytest.raises(errors.NotConnected):
        _ = device.controller


def test_a_controller_that_is_still_starting() -> None:
    desk = Desk(DsaDouble(boot_s=BOOT_S))
    desk.double.power_up(0)
    with desk as device:
        assert 8.0 < desk.clock() / S < 12.0
        assert device.health().skipped_bytes == len(b"\x1b[5n" * 3)
        assert desk.run(0.2)


def test_a_controller_that_streams_to_nobody() -> None:
    desk = Desk(DsaDouble(first_timestamp_ms=5000))
    desk.double.receive(encode(stream(rle=False)), 0)
    desk.clock.advance_to(3 * S)
    with desk:
        assert desk.run(0.5)[0].stamp.device_ticks > 5000


def test_nothing_answers() -> None:
    desk = Desk(Ears())
    desk.double.unanswered = 100
    with pytest.raises(errors.NoReply, match="answer to stop"), desk:
        pass
    assert desk.double.heard == [stop()] * 4
    assert desk.clock() / S == pytest.approx(12.0, abs=0.3)


def test_what_is_asked_again_where_no_answer_came() -> None:
    desk = Desk(Ears())
    desk.double.unanswered = 2
    with desk:
        assert desk.double.heard.count(stop()) == 3
        assert desk.run(0.2)


def test_geometry_that_cannot_be_is_refused() -> None:
    matrices = DsaDouble().matrices
    broken = [*matrices[:5], replace(matrices[5], texel_width_mm=float("nan"))]
    with pytest.raises(errors.ProtocolViolation, match="matrix 5"), Desk(DsaDouble(matrices=broken)):
        pass


def test_other_sensors_than_the_sdhs() -> None:
    desk = Desk(DsaDouble(matrices=DsaDouble().matrices[:2]), sensitivity=(0.5, 0.25))
    with desk:
        (reading, *_) = desk.run(0.2)
    assert [pad.shape for pad in reading.pads] == [(14, 6), (13, 6)]


def press(time_s: float) -> list[np.ndarray]:
    pads = [np.zeros(shape) for shape in [(14, 6), (13, 6)] * 3]
    pads[3][12, 5] = 2000.0
    return pads


def test_a_press_comes_out_where_it_is() -> None:
    desk = Desk(DsaDouble(scene=press, noise_counts=0, pa_per_count=1.0), calibration=(2.0,))
    with desk as device:
        reading = desk.run(0.2)[-1]
        contact = device.contacts(reading)[3]
        assert [pad.shape for pad in reading.pads] == [(14, 6), (13, 6)] * 3
        assert reading.pads[3][12, 5] == 2000
        assert reading.texels.sum() == 2000
        assert device.pressure_pa(reading)[3].max() == 4000.0
        assert contact.force_n == pytest.approx(4000.0 * 3.4e-3**2)
        assert contact.center_m == pytest.approx((2.5 * 3.4e-3, 6 * 3.4e-3))
        with pytest.raises(ValueError, match="read-only"):
            reading.pads[0][0, 0] = 1


def test_a_curve_for_all() -> None:
    desk = Desk(DsaDouble(scene=press, noise_counts=0, pa_per_count=1.0), calibration=(Curve((0, 4000), (0, 8e4)),))
    with desk as device:
        assert device.pressure_pa(desk.run(0.2)[-1])[3].max() == 40_000.0


@pytest.mark.parametrize(("rle", "slowest", "fastest"), [(False, 11.6, 11.84), (True, 20.0, 30.0)])
def test_real_rates(rle: bool, slowest: float, fastest: float) -> None:
    """Raw at 115 200 baud: 985 bytes a frame, 11.7 frames a second."""
    desk = Desk(rle=rle)
    with desk as device:
        desk.run(0.5)
        assert slowest <= len(desk.run(6.0)) / 6 <= fastest
        assert device.health().skipped_bytes == 0


def test_stamps_carry_the_controllers_clock_beyond_its_32_bits() -> None:
    desk = Desk(DsaDouble(first_timestamp_ms=2**32 - 500))
    with desk as device:
        ticks = [reading.stamp.device_ticks for reading in desk.run(4.0)]
        assert ticks[0] < 2**32 < ticks[-1]
        assert 1 <= min(np.diff(ticks)) <= max(np.diff(ticks)) < 100
        assert device.health().refused == {}
        assert device.health().clock.tick_ns == pytest.approx(1e6, rel=0.02)


class Wire(MemoryTransport):
    """Lets a test put bytes of its own among the device's."""

    def __init__(self, double, clock) -> None:
        super().__init__(double, clock)
        self.slipped_in = b""

    def read(self, timeout_s: float) -> bytes:
        slipped_in, self.slipped_in = self.slipped_in, b""
        return slipped_in or super().read(timeout_s)


class Quiet(DsaDouble):
    """It acknowledges its stream and sends no frame."""

    def _next_frame_ns(self) -> int | None:
        return None


def slipped(*timestamps_ms: int) -> tuple[Dsa, list]:
    """The readings that come of frames with those times."""
    clock = SimulatedClock()
    wire = Wire(Quiet(matrices=[replace(DsaDouble().matrices[0], cells_x=2, cells_y=1)]), clock)
    device = Dsa(DsaConfig(silence_s=60.0), transport=wire, clock=clock).open(own_thread=False)
    readings = []
    for timestamp_ms in timestamps_ms:
        wire.slipped_in = encode(Reading(timestamp_ms, 0, np.array([1, 2], np.uint16)))
        readings += device.poll(0.03)
    return device, [reading.stamp.device_ticks for reading in readings]


def test_a_time_repeated_is_no_new_frame() -> None:
    device, ticks = slipped(100, 100, 133)
    assert ticks == [100, 133]
    assert device.health().extra["repeated"] == 1
    assert device.health().received == 2


def test_one_frame_out_of_time_is_refused() -> None:
    device, ticks = slipped(100, 133 + (1 << 20), 166, 133 + (1 << 22), 200)
    assert ticks == [100, 166, 200]
    assert device.health().refused == {"timestamp": 2}


def test_a_clock_set_anew_is_believed_at_its_second_frame() -> None:
    device, ticks = slipped(90_000, 90_033, 12, 45, 78)
    assert ticks == [90_000, 90_033, 45, 78]
    assert device.health().refused == {"timestamp": 1}
    assert device.health().extra["clock_restarts"] == 1


def test_pressed_texels_that_never_change_are_stuck() -> None:
    desk = Desk(DsaDouble(scene=press, noise_counts=0), stuck_after_s=1.0)
    with desk as device:
        desk.run(2.0)
        assert device.health().stuck
        with pytest.raises(errors.Stale, match="same reading"):
            device.latest(1.0)


def test_nothing_pressed_is_not_stuck() -> None:
    desk = Desk(DsaDouble(scene=lambda time_s: [0 * pad for pad in press(0.0)]), stuck_after_s=1.0)
    with desk as device:
        desk.run(2.0)
        assert not device.health().stuck
        device.latest(1.0)


def test_five_frames_may_come_before_an_answer() -> None:
    class Late(Ears):
        def _carry_out(self, command, now_ns):
            answer = super()._carry_out(command, now_ns)
            if isinstance(command, SetSensitivity):
                for number in range(1, 6):
                    self._line.send(encode(Reading(60_000 + 33 * number, 1, np.zeros(486, np.uint16))), now_ns)
            return answer

    desk = Desk(Late(), sensitivity=0.25)
    readings = desk.device.readings()
    with desk:
        assert [reading.stamp.device_ticks for reading in readings.take()[:5]] == [60_033 + 33 * i for i in range(5)]


def test_sensitivity_acts() -> None:
    desk = Desk(DsaDouble(scene=press, noise_counts=0, pa_per_count=1.0), sensitivity=(0.5, 0.5, 0.5, 0.25, 0.5, 0.5))
    with desk:
        assert desk.run(0.2)[-1].pads[3].max() == 1000


def test_threshold_acts() -> None:
    for threshold, seen in ((2000, 2000), (2001, 0)):
        desk = Desk(DsaDouble(scene=press, noise_counts=0, pa_per_count=1.0), threshold=threshold)
        with desk:
            assert desk.run(0.2)[-1].pads[3].max() == seen


@pytest.mark.parametrize(
    "config",
    [
        {"sensitivity": 1.5},
        {"sensitivity": (0.5, -0.1)},
        {"sensitivity": float("nan")},
        {"threshold": 5000},
        {"threshold": -1},
        {"frame_rate_hz": 0},
    ],
)
def test_a_configuration_out_of_limits(config) -> None:
    with pytest.raises(errors.OutOfLimits):
        DsaConfig(**config)


def test_settings_for_other_matrices_than_there_are() -> None:
    with pytest.raises(errors.SettingsRefused, match="each of 6 matrices"), Desk(sensitivity=(0.5, 0.5)):
        pass


def test_an_error_code_has_its_name() -> None:
    desk = Desk(Ears(), sensitivity=0.5)
    desk.double.answers[SetSensitivity] = [Ack(0x0F, 15)]
    with pytest.raises(errors.CommandRefused, match="access denied") as caught, desk:
        pass
    assert (caught.value.code, caught.value.name) == (15, "access denied")


def test_the_first_stop_may_end_half_a_command_of_another() -> None:
    desk = Desk(Ears())
    desk.double.answers[ConfigureAcquisition] = [Ack(3, 11)]
    with desk:
        assert desk.run(0.2)


def test_a_command_that_came_damaged_is_sent_again() -> None:
    desk = Desk(Ears(), sensitivity=0.75)
    desk.double.answers[SetSensitivity] = [Ack(0x0F, 11)]
    with desk:
        assert settings(desk.double)[0][0] == 0.75


def test_pending_is_no_answer_yet() -> None:
    class Slow(DsaDouble):
        def _carry_out(self, command, now_ns):
            if isinstance(command, SetSensitivity):
                self._line.send(encode(Ack(0x0F, 25)), now_ns)
            return super()._carry_out(command, now_ns)

    desk = Desk(Slow(), sensitivity=0.75)
    with desk:
        assert settings(desk.double)[0][0] == 0.75


def test_settings_that_did_not_take_are_refused() -> None:
    desk = Desk(Ears(), sensitivity=0.75)
    desk.double.answers[SetSensitivity] = [Ack(0x0F)]
    with pytest.raises(errors.SettingsRefused, match=r"sensitivity 0\.75 of matrix 0"), desk:
        pass


@pytest.mark.parametrize("version", [218, 267])
def test_thresholds_that_the_firmware_does_not_have(version: int) -> None:
    with (
        pytest.raises(errors.SettingsRefused, match="firmware 268"),
        Desk(DsaDouble(software_version=version), threshold=5),
    ):
        pass


def test_a_read_back_that_is_broken_is_not_believed() -> None:
    desk = Desk(DsaDouble(software_version=218), sensitivity=0.75)
    with desk:
        assert desk.run(0.2)


def test_on_a_bad_wire_no_wrong_texels_come() -> None:
    clean = DsaDouble(scene=press, noise_counts=0, pa_per_count=1.0)
    double = FaultyDouble(clean, Faults(noise=2e-3, flip=2e-3, cut=2e-3, split=0.01), seed=7)  # for each 16 bytes
    desk = Desk(double)
    with desk as device:
        readings = desk.run(20.0)
        health = device.health()
        assert len(readings) > 400
        assert sum(double.counts.values()) > 10
        assert all(reading.texels.sum() == reading.pads[3][12, 5] == 2000 for reading in readings)
        assert health.skipped_bytes > 0
        assert health.refused["checksum"] > 0


def test_a_link_on_which_only_rubbish_comes_is_lost() -> None:
    class Garbled(DsaDouble):
        garbled = False

        def due(self, now_ns: int) -> bytes:
            return bytes(byte ^ 0x11 for byte in super().due(now_ns)) if self.garbled else super().due(now_ns)

    desk = Desk(Garbled(), silence_s=0.5)
    with desk:
        assert desk.run(0.2)
        desk.double.garbled = True
        since_ns = desk.clock()
        with pytest.raises(errors.LinkLost, match="none without errors"):
            desk.run(2.0)
        assert 0.4 < (desk.clock() - since_ns) / S < 0.7


def test_after_power_was_lost_everything_is_set_again() -> None:
    double = DsaDouble()
    with PtyWire(double) as wire:
        config = DsaConfig(port=wire.port, sensitivity=0.75, threshold=(20, 20, 55, 20, 20, 20))
        with Dsa(config, reconnect=QUICK) as device:
            wire.unplug()
            wait_until(lambda: device.link != "connected")
            double.power_up(time.monotonic_ns())
            wire.plug()
            wait_until(lambda: device.link == "connected")
            assert settings(double) == [(0.75, 20)] * 2 + [(0.75, 55)] + [(0.75, 20)] * 3
            assert device.next(5.0).texels.size == 486
            assert device.health().reconnects == 1


def test_a_controller_switched_off_and_on_behind_a_link_that_stays() -> None:
    double = DsaDouble()
    with PtyWire(double) as wire, Dsa(DsaConfig(port=wire.port, silence_s=0.3), reconnect=QUICK) as device:
        device.next(5.0)
        double.power_up(time.monotonic_ns())
        wait_until(lambda: device.health().reconnects == 1)
        assert device.next(5.0).stamp.device_ticks < 60_000


def test_over_tcp() -> None:
    with TcpWire(DsaDouble(bytes_per_s=None)) as wire, Dsa(DsaConfig(port=wire.port, rle=False)) as device:
        assert wire.port.startswith("socket://")
        assert device.next(5.0).texels.size == 486


@pytest.mark.realtime
def test_a_paced_pty_shows_the_real_rate() -> None:
    """Wide tolerance: the exact figure is tested in simulated time."""
    with PtyWire(DsaDouble()) as wire, Dsa(DsaConfig(port=wire.port, rle=False)) as device:
        readings = device.readings()
        first, *_, last = (readings.get(5.0) for _ in range(12))
        rate_hz = 11 / ((last.stamp.host_ns - first.stamp.host_ns) / S)
        assert 6.0 < rate_hz < 13.0
        assert last.stamp.device_ticks - first.stamp.device_ticks == pytest.approx(11 * 85.5, abs=3)


class Switch(DsaDouble):
    """Can be made to fall silent."""

    silent = False

    def due(self, now_ns: int) -> bytes:
        data = super().due(now_ns)
        return b"" if self.silent else data

    def fall_silent(self) -> None:
        self.silent = True

    def speak(self) -> None:
        self.silent = False


class TestOverAPty(DeviceContract):
    @pytest.fixture
    def bench(self) -> Iterator[Bench]:
        with PtyWire(double := Switch()) as wire:
            yield Bench(
                Dsa(DsaConfig(port=wire.port), reconnect=QUICK),
                wire.unplug,
                wire.plug,
                double.fall_silent,
                double.speak,
                lambda: Dsa(DsaConfig(port=wire.port)),
            )


@pytest.mark.slow
class TestOverTcp(DeviceContract):
    @pytest.fixture
    def bench(self) -> Iterator[Bench]:
        with TcpWire(double := Switch(bytes_per_s=None)) as wire:
            device = Dsa(DsaConfig(port=wire.port), reconnect=QUICK)
            yield Bench(device, wire.unplug, wire.plug, double.fall_silent, double.speak)
