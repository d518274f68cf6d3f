"""The hand's driver on simulated hands: in memory on a simulated clock, over pty, socket and CAN."""

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from deformscope_drivers import sdh
from deformscope_drivers.device import Reconnect
from deformscope_drivers.doubles import Double
from deformscope_drivers.errors import (
    CommandRefused,
    DeviceError,
    LinkLost,
    NoReply,
    NotConnected,
    OutOfLimits,
    ProtocolViolation,
    SettingsRefused,
)
from deformscope_drivers.health import Link
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.sdh.codes import ERRORS
from deformscope_drivers.wires import CanWire, PtyWire, TcpWire
from tests.drivers.buses import udp_bus
from tests.drivers.contract import PATIENCE_S, Bench, DeviceContract, wait_until
from tests.drivers.faults import Faults, FaultyDouble

QUICK = Reconnect(0.01, 0.1)
POSE = [0.0, -20.0, 20.0, -20.0, 20.0, -20.0, 20.0]


def silence(double: sdh.SdhDouble, silent: bool) -> None:
    double.silent = silent


def config(**settings) -> sdh.SdhConfig:
    return sdh.SdhConfig(**{"rate_hz": 80.0, "reply_timeout_s": 0.1, "reconnect": QUICK, **settings})


def bench_of(double: sdh.SdhDouble, wire: PtyWire | TcpWire, **settings) -> Bench:
    return Bench(
        sdh.Sdh(config(port=wire.port, **settings)),
        wire.unplug,
        wire.plug,
        lambda: silence(double, True),
        lambda: silence(double, False),
    )


@pytest.mark.parametrize("firmware", ["0.0.3.2", pytest.param("0.0.2.10", marks=pytest.mark.slow)])  # binary; ASCII
class TestOverAPty(DeviceContract):
    @pytest.fixture
    def bench(self, firmware: str) -> Iterator[Bench]:
        double = sdh.SdhDouble(firmware=firmware)
        with PtyWire(double) as wire:
            yield bench_of(double, wire, rate_hz=40.0)


@pytest.mark.slow  # pyserial waits 0.3 s with every socket that is closed
class TestOverTcp(DeviceContract):
    @pytest.fixture
    def bench(self) -> Iterator[Bench]:
        double = sdh.SdhDouble(sdh.Port.TCP)
        with TcpWire(double) as wire:
            yield bench_of(double, wire)


def test_over_tcp() -> None:
    with TcpWire(sdh.SdhDouble(sdh.Port.TCP)) as wire, sdh.Sdh(config(port=wire.port)) as hand:
        assert hand.about.binary
        assert hand.move({1: 5.0}, velocity_deg_s=80.0).outcome is sdh.Outcome.REACHED


@pytest.mark.parametrize("bus", ["virtual:sdh", udp_bus()], ids=["virtual", "udp"])
class TestOverCan(DeviceContract):
    @pytest.fixture
    def bench(self, bus: str) -> Iterator[Bench]:
        double = sdh.SdhDouble(sdh.Port.CAN)
        with CanWire(double, bus, receive_id=43, send_id=42) as wire:
            del wire  # a bus stays when a device leaves it: what is seen is silence
            device = sdh.Sdh(config(bus=bus))
            yield Bench(device, None, None, lambda: silence(double, True), lambda: silence(double, False))


@dataclass
class Lab:
    double: sdh.SdhDouble
    clock: SimulatedClock
    hand: sdh.Sdh
    transport: MemoryTransport

    def run(self, seconds: float) -> None:
        until_ns = self.clock() + round(seconds * 1e9)
        while self.clock() < until_ns:
            self.hand.poll((until_ns - self.clock()) / 1e9)

    def position_deg(self) -> tuple[float, ...]:
        return self.double.position_deg(self.clock())


Make = Callable[..., Lab]


@pytest.fixture
def lab() -> Iterator[Make]:
    opened: list[Lab] = []

    def make(double: sdh.SdhDouble | None = None, wire: Double | None = None, **settings) -> Lab:
        double = double or sdh.SdhDouble()
        clock = SimulatedClock()
        double.power_up(0)
        transport = MemoryTransport(wire or double, clock)
        hand = sdh.Sdh(config(port="memory", **settings), transport=transport, clock=clock)
        opened.append(Lab(double, clock, hand.open(own_thread=False), transport))
        return opened[-1]

    yield make
    for made in opened:
        made.hand.close()


def test_opening_is_schunks_way(lab: Make) -> None:
    double = sdh.SdhDouble(firmware="0.0.2.15", serial_number="77")
    made = lab(double)
    about = made.hand.about
    assert (about.firmware, about.serial_number, about.binary) == ("0.0.2.15", "77", True)
    assert about.limits.velocity_max_deg_s[:2] == (80.0, 100.0)
    assert about.limits.acceleration_max_deg_s2 == (5000.0, 400.0, 1500.0, 400.0, 1500.0, 400.0, 1500.0)
    assert made.hand.identity().firmware == "0.0.2.15"
    assert {axis.state for axis in double.motion.axes} == {sdh.AxisState.DISABLED}  # nothing was moved or switched on


def test_half_a_command_of_another_program_does_no_harm(lab: Make) -> None:
    double = sdh.SdhDouble()
    double.receive(b"p=1,2", 0)
    assert lab(double).hand.about.firmware == "0.0.3.2"


@pytest.mark.parametrize(("firmware", "binary"), [("0.0.2.14", False), ("0.0.2.15", True), ("0.0.3.1", True)])
def test_the_protocol_follows_the_firmware(lab: Make, firmware: str, binary: bool) -> None:
    made = lab(sdh.SdhDouble(firmware=firmware))
    chunks = made.hand.raw()
    made.hand.poll(1.0)
    sent = b"".join(chunk.data for chunk in chunks.take() if chunk.sent)
    assert made.hand.about.binary is binary
    assert (b"\x83" in sent) is binary
    assert (b"pos\r\n" in sent) is not binary


def test_binary_may_be_refused_and_ascii_asked_for(lab: Make) -> None:
    assert not lab(protocol="ascii").hand.about.binary
    with pytest.raises(SettingsRefused, match=r"0\.0\.2\.15"):
        lab(sdh.SdhDouble(firmware="0.0.2.10"), protocol="binary")


def test_a_hand_that_does_not_answer(lab: Make) -> None:
    double = sdh.SdhDouble()
    double.silent = True
    with pytest.raises(NoReply, match=r"ver within 3 x 1 s.*supply"):
        lab(double)


def test_a_firmware_that_is_none(lab: Make) -> None:
    with pytest.raises(ProtocolViolation, match="firmware"):
        lab(sdh.SdhDouble(firmware="nonsense"))


def test_it_needs_exactly_one_way_to_the_hand() -> None:
    for settings in ({}, {"port": "/dev/ttyUSB0", "bus": "virtual:a"}):
        with pytest.raises(NotConnected, match="port or a bus"):
            sdh.Sdh(sdh.SdhConfig(**settings))
    assert sdh.SdhConfig(port="/dev/ttyUSB0").checksummed()
    assert not sdh.SdhConfig(port="socket://192.168.1.1:23").checksummed()
    assert not sdh.SdhConfig(bus="socketcan:can0").checksummed()


@pytest.mark.parametrize("settings", [{"rate_hz": 0.0}, {"rate_hz": math.nan}, {"protocol": "telepathy"}])
def test_settings_that_cannot_be(settings: dict) -> None:
    with pytest.raises(OutOfLimits):
        sdh.SdhConfig(port="x", **settings)


def test_readings_say_where_the_hand_is(lab: Make) -> None:
    double = sdh.SdhDouble()
    double.place((10.0, -20.0, 30.0, -40.0, 50.0, -60.0, 70.0))
    reading = lab(double).hand.next(1.0)
    assert reading.position_deg == pytest.approx([10, -20, 30, -40, 50, -60, 70])
    assert reading.velocity_deg_s == pytest.approx([0] * 7)
    assert reading.state == (sdh.AxisState.DISABLED,) * 7
    assert reading.temperature_c is not None
    assert reading.temperature_c == pytest.approx([24] * 7 + [38, 32])
    with pytest.raises(ValueError):
        reading.position_deg[0] = 1.0


def test_the_rate_is_as_asked_up_to_what_the_line_has_room_for(lab: Make) -> None:
    made = lab(rate_hz=50.0, temperature_period_s=1.0)
    made.run(3.0)
    assert made.hand.health().rate_hz == pytest.approx(50.0, rel=0.02)
    quick = lab(rate_hz=1000.0, temperature_period_s=100.0)
    quick.run(3.0)
    # three requests of 5 bytes and replies of 34 are 117 bytes: 10.2 ms at 11 520 bytes/s
    assert quick.hand.health().rate_hz == pytest.approx(98.0, rel=0.03)


@pytest.mark.parametrize("firmware", ["0.0.3.2", "0.0.2.10", "0.0.2.0"])
def test_a_move_comes_to_its_targets(lab: Make, firmware: str) -> None:
    made = lab(sdh.SdhDouble(firmware=firmware))
    result = made.hand.move(POSE, velocity_deg_s=40.0)
    assert result.outcome is sdh.Outcome.REACHED
    assert result.duration_s == pytest.approx(1.0)  # sin²: 2 * 20 / 40
    assert 1.0 <= result.elapsed_s < 1.2
    assert result.error_deg == pytest.approx(0.0, abs=1e-6)
    assert result.reading.position_deg == pytest.approx(POSE)
    assert made.position_deg() == tuple(POSE)


def test_a_ramp_and_speeds_by_axis(lab: Make) -> None:
    made = lab()
    result = made.hand.move(
        [40.0] + [0.0] * 6,
        velocity_deg_s=[20.0] + [100.0] * 6,
        acceleration_deg_s2=100.0,
        profile=sdh.VelocityProfile.RAMP,
    )
    assert result.duration_s == pytest.approx(40 / 20 + 20 / 100)
    assert result.outcome is sdh.Outcome.REACHED


def test_some_axes_move_and_the_others_stay(lab: Make) -> None:
    double = sdh.SdhDouble()
    double.place((0.0, 90.3, 0.0, -5.0, 0.0, 0.0, 0.0))  # angles are reported up to half a degree beyond the range
    made = lab(double)
    assert made.hand.move({2: 15.0, 6: -15.0}).outcome is sdh.Outcome.REACHED
    assert made.position_deg() == pytest.approx((0, 90.0, 15, -5, 0, 0, -15))


def test_a_blocked_axis_is_reported(lab: Make) -> None:
    made = lab()
    made.double.obstruct(1, low_deg=-8.0)
    made.double.obstruct(2, high_deg=12.0)
    result = made.hand.move(POSE)
    assert result.outcome is sdh.Outcome.BLOCKED
    assert result.blocked == (1, 2)
    assert result.error_deg == pytest.approx(12.0)
    assert result.reading.state[1:3] == (sdh.AxisState.CCW_BLOCKED, sdh.AxisState.CW_BLOCKED)
    assert made.position_deg() == pytest.approx((0, -8, 12, -20, 20, -20, 20))
    made.double.obstruct(1)
    made.double.obstruct(2)
    assert made.hand.move(POSE).outcome is sdh.Outcome.REACHED


def test_idle_is_not_believed_too_soon(lab: Make) -> None:
    made = lab(sdh.SdhDouble(state_lag_s=0.4))
    assert made.hand.move(POSE).elapsed_s >= 1.0
    assert made.position_deg() == tuple(POSE)
    assert 0.5 <= made.hand.move(POSE).elapsed_s < 0.7  # nothing to do: believed after IPA's half second


def test_stop_half_way(lab: Make) -> None:
    made = lab()
    started = made.hand.move([0.0, 80.0, 0, 0, 0, 0, 0], wait=False)
    assert started.outcome is sdh.Outcome.STARTED
    assert started.duration_s == pytest.approx(4.0)
    made.run(2.0)
    made.hand.stop()
    made.run(2.0)
    assert not made.double.motion.moving
    assert made.position_deg()[1] == pytest.approx(40 + 40**2 / 200, abs=2.0)  # slowed down by 100 deg/s²


def test_what_takes_too_long_is_stopped(lab: Make) -> None:
    made = lab()
    result = made.hand.move([0.0, 80.0, 0, 0, 0, 0, 0], timeout_s=2.0)
    assert result.outcome is sdh.Outcome.TIMED_OUT
    assert result.error_deg > 20
    assert not made.double.motion.moving


def test_ctrl_c_stops_the_hand(lab: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    made = lab()

    def interrupted(timeout_s: float) -> None:
        made.run(0.5)
        raise KeyboardInterrupt

    monkeypatch.setattr(made.hand, "next", interrupted)
    with pytest.raises(KeyboardInterrupt):
        made.hand.move({1: 80.0})
    made.run(1.0)
    assert not made.double.motion.moving
    assert made.position_deg()[1] < 20.0


def test_a_slow_rate_is_given_its_time(lab: Make) -> None:
    assert lab(rate_hz=0.5).hand.move(POSE).outcome is sdh.Outcome.REACHED


def test_a_move_that_misses_says_so(lab: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    made = lab()
    read, cut_ns = made.hand.next, made.clock() + 1_000_000_000

    def switched_off(timeout_s: float) -> sdh.HandReading:
        if made.clock() > cut_ns:  # by something else
            made.double.motion.power(1, False)
        return read(timeout_s)

    monkeypatch.setattr(made.hand, "next", switched_off)
    assert made.hand.move({1: 80.0}).disabled == (1,)


def test_a_velocity_goes_on_while_it_is_called_for(lab: Make) -> None:
    made = lab()
    for _ in range(10):
        made.hand.drive([0, 30.0, 0, 0, 0, 0, -10.0], keep_s=0.2)
        made.run(0.1)
    assert made.hand.latest(0.1).velocity_deg_s == pytest.approx([0, 30, 0, 0, 0, 0, -10])
    made.run(0.05)
    assert made.hand.latest(0.1).state[1] is sdh.AxisState.SPEED_MODE
    driven = made.position_deg()
    assert driven[1] == pytest.approx(30 * 1.05, rel=0.08)
    assert driven[6] == pytest.approx(-10 * 1.05, rel=0.08)
    made.run(0.2)
    held = made.position_deg()
    made.run(1.0)
    assert made.position_deg() == held
    assert held[1] - driven[1] < 30 * 0.15
    assert made.hand.latest(0.1).state[1] is sdh.AxisState.IDLE
    assert made.hand.move(POSE).outcome is sdh.Outcome.REACHED  # back to poses


def test_a_velocity_with_ramp_and_stop(lab: Make) -> None:
    made = lab()
    made.hand.drive([0, 40.0, 0, 0, 0, 0, 0], keep_s=1.0, acceleration_deg_s2=80.0)
    made.run(0.4)
    assert made.hand.latest(0.1).velocity_deg_s[1] == pytest.approx(32.0, abs=3.0)
    made.hand.stop()
    made.run(1.0)
    assert made.hand.latest(0.1).velocity_deg_s[1] == 0.0
    assert 5.0 < made.position_deg()[1] < 20.0


def test_velocities_need_a_newer_firmware(lab: Make) -> None:
    with pytest.raises(SettingsRefused, match=r"0\.0\.2\.6"):
        lab(sdh.SdhDouble(firmware="0.0.2.5")).hand.drive([0.0] * 7)


def test_an_axis_driven_to_the_end_of_its_range_says_so(lab: Make) -> None:
    made = lab()
    made.double.place((0, 85.0, 0, 0, 0, 0, 0))
    for _ in range(8):
        made.hand.drive([0, 20.0, 0, 0, 0, 0, 0])
        made.run(0.1)
    assert made.hand.latest(0.1).state[1] is sdh.AxisState.LIMITS_REACHED
    assert made.position_deg()[1] == 90.0


def test_power_and_currents(lab: Make) -> None:
    made = lab()
    made.hand.power([True] + [False] * 6)
    assert made.hand.powered() == (True,) + (False,) * 6
    made.hand.set_current_limits(0.25)
    made.hand.set_current_limits([0.1] * 7, sdh.CurrentMode.HOLD)
    assert made.hand.current_limits_a() == pytest.approx((0.25,) * 7)
    assert made.hand.current_limits_a(sdh.CurrentMode.HOLD) == pytest.approx((0.1,) * 7)
    assert made.hand.current_limits_a(sdh.CurrentMode.GRIP) == pytest.approx((1.0, *[0.5] * 6))


def test_a_velocity_switches_axes_on_again(lab: Make) -> None:
    made = lab()
    made.hand.drive([0, 20.0, 0, 0, 0, 0, 0])
    made.run(0.5)
    made.hand.power(False)
    made.hand.drive([0, 20.0, 0, 0, 0, 0, 0], keep_s=0.5)
    before = made.position_deg()[1]
    made.run(0.4)
    assert made.position_deg()[1] > before + 5.0


@pytest.mark.parametrize(("leave_powered", "expected"), [(False, sdh.AxisState.DISABLED), (True, sdh.AxisState.IDLE)])
def test_closing_switches_off_what_was_switched_on(lab: Make, leave_powered: bool, expected: sdh.AxisState) -> None:
    made = lab(leave_powered=leave_powered)
    made.hand.move({1: 60.0}, wait=False)
    made.run(0.5)
    made.hand.close()
    made.double.position_deg(made.clock() + 5_000_000_000)
    assert made.double.motion.axes[1].state is expected
    assert made.position_deg()[1] < 30.0


def test_closing_leaves_a_hand_alone_that_was_only_watched(lab: Make) -> None:
    made = lab()
    for axis in range(7):
        made.double.motion.power(axis, True)
    made.run(0.2)
    made.hand.close()
    assert all(axis.powered for axis in made.double.motion.axes)


REFUSED = [
    lambda hand: hand.move([0, 91.0, 0, 0, 0, 0, 0]),
    lambda hand: hand.move([-0.1, 0, 0, 0, 0, 0, 0]),
    lambda hand: hand.move([0, math.nan, 0, 0, 0, 0, 0]),
    lambda hand: hand.move([0] * 6),
    lambda hand: hand.move({7: 0.0}),
    lambda hand: hand.move({}),
    lambda hand: hand.move({3: math.inf}),
    lambda hand: hand.move(POSE, velocity_deg_s=100.0),  # axis 0 goes up to 80
    lambda hand: hand.move(POSE, velocity_deg_s=0.0),
    lambda hand: hand.move(POSE, velocity_deg_s=math.nan),
    lambda hand: hand.move(POSE, acceleration_deg_s2=401.0),
    lambda hand: hand.move(POSE, acceleration_deg_s2=-1.0),
    lambda hand: hand.drive([0, 0, 0, 0, 0, 0, -101.0]),
    lambda hand: hand.drive([math.nan] * 7),
    lambda hand: hand.drive([0.0] * 7, keep_s=3.0),
    lambda hand: hand.set_current_limits(1.01),
    lambda hand: hand.set_current_limits([0.1] * 6),
    lambda hand: hand.power([True]),
]


def test_nothing_is_sent_beyond_the_limits(lab: Make) -> None:
    made = lab()
    before = made.double.commands
    for number, refused in enumerate(REFUSED):
        with pytest.raises(OutOfLimits):
            refused(made.hand)
        assert made.double.commands == before, number


def test_every_error_code_has_its_name(lab: Make) -> None:
    made = lab()
    for code, (name, _) in enumerate(ERRORS):
        if code in (0, 10, 33):
            continue
        made.double.refuse_next(code)
        with pytest.raises(CommandRefused, match=f"error {code} ") as caught:
            made.hand.current_limits_a()
        assert (caught.value.code, caught.value.name) == (code, name)
        assert "memory" in str(caught.value)


@pytest.mark.parametrize("code", [10, 33])
def test_what_came_garbled_is_sent_again(lab: Make, code: int) -> None:
    made = lab()
    made.double.refuse_next(code)
    made.double.refuse_next(code)
    assert made.hand.current_limits_a()[0] == 1.0
    assert made.hand.health().extra["retries"] == 2
    for _ in range(3):
        made.double.refuse_next(code)
    with pytest.raises(CommandRefused):
        made.hand.current_limits_a()


def test_a_hand_that_keeps_another_value_is_not_believed(lab: Make) -> None:
    made = lab()
    made.hand.move(POSE)
    made.double.refuse_next(24)
    with pytest.raises(CommandRefused, match="RANGE_ERROR"):
        made.hand.move({1: 0.0})
    assert made.hand.move({1: 0.0}).outcome is sdh.Outcome.REACHED


def test_debug_lines_and_noise_are_overheard(lab: Make) -> None:
    made = lab()
    made.double.say(b"@something to tell\r\n\x00\xffPOS=1,2\r\n", made.clock())
    made.run(0.5)
    health = made.hand.health()
    assert health.received > 30
    assert health.refused == {"count": 1}
    assert health.skipped_bytes >= 9


def test_an_answer_that_makes_no_reading_is_counted_and_the_next_one_comes(lab: Make) -> None:
    made = lab()
    made.run(0.1)
    made.double.refuse_next(6)
    made.run(0.1)
    made.double.motion.axes[2].state = 8  # type: ignore[assignment]
    made.run(0.1)
    refused = made.hand.health().refused
    made.double.motion.axes[2].state = sdh.AxisState.IDLE
    assert refused["error 6 (TIMEOUT)"] == 1
    assert refused["state"] >= 5
    made.hand.next(0.1)


def test_a_velocity_that_the_hand_will_not_end_is_ended_by_stop(lab: Make) -> None:
    made = lab()
    made.hand.drive([0, 20.0, 0, 0, 0, 0, 0], keep_s=0.05)
    while made.clock() < made.hand._drive_until_ns:  # as the driver's thread is about to end it
        made.hand.poll(0.001)
    made.double.refuse_next(24)
    made.run(1.0)
    assert not made.double.motion.moving


def test_readings_over_a_bad_line_are_right_or_asked_again(lab: Make) -> None:
    double = sdh.SdhDouble(paced=False)  # so that a message is one piece
    double.place((10.0, -20.0, 30.0, -40.0, 50.0, -60.0, 70.0))
    faulty = FaultyDouble(double, Faults(noise=0.05, flip=0.05, cut=0.05, split=0.3), seed=3)
    made = lab(double, faulty, temperature_period_s=1000.0)
    expected = np.array([10.0, -20, 30, -40, 50, -60, 70], dtype=np.float32)
    seen = 0
    lost = 0
    for _ in range(300):
        try:
            for reading in made.hand.poll(0.1):
                assert np.array_equal(reading.position_deg, expected)
                seen += 1
        except LinkLost:
            lost += 1
    assert seen > 100
    assert made.hand.health().extra["retries"] > 5
    assert sum(faulty.counts.values()) > 20
    assert lost <= 2


def test_a_lost_link_ends_the_wait_and_the_motion() -> None:
    """On a bus the hand goes on while the link is away; when it is back the hand is stopped."""
    double = sdh.SdhDouble(sdh.Port.CAN)
    ended: list[BaseException | None] = []
    with (
        CanWire(double, "virtual:sdh-lost", receive_id=43, send_id=42),
        sdh.Sdh(config(bus="virtual:sdh-lost")) as hand,
    ):
        events = hand.events()

        def move() -> None:
            try:
                hand.move({1: 80.0}, velocity_deg_s=10.0)  # 16 s
                ended.append(None)
            except DeviceError as error:
                ended.append(error)

        mover = threading.Thread(target=move)
        mover.start()
        wait_until(lambda: hand.next(PATIENCE_S).state[1] is sdh.AxisState.POSITIONING)
        double.silent = True
        assert events.get(PATIENCE_S).link is Link.LOST
        mover.join(PATIENCE_S)
        assert double.motion.moving
        double.silent = False
        assert events.get(PATIENCE_S).link is Link.CONNECTED
        wait_until(lambda: hand.next(PATIENCE_S).state[1] is sdh.AxisState.IDLE)
        assert isinstance(ended[0], LinkLost)
        assert hand.health().extra["stopped_after_reconnect"] == 1
        assert hand.health().reconnects == 1
        assert hand.latest(PATIENCE_S).position_deg[1] < 60.0


def test_stop_from_another_thread_ends_a_move() -> None:
    double = sdh.SdhDouble()
    with PtyWire(double) as wire, sdh.Sdh(config(port=wire.port)) as hand:
        results = []
        mover = threading.Thread(target=lambda: results.append(hand.move({1: 80.0}, velocity_deg_s=10.0)))
        mover.start()
        wait_until(lambda: hand.next(PATIENCE_S).state[1] is sdh.AxisState.POSITIONING)
        hand.stop()
        mover.join(PATIENCE_S)
    assert results[0].outcome is sdh.Outcome.STOPPED
    assert 0.0 < results[0].reading.position_deg[1] < 60.0
