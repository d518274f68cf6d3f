"""What a controller makes of answers that are missing, that opening finds it out, and that zeros are out before the
port is closed."""

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.errors import NotStopped, SettingsRefused
from deformscope_drivers.kuka import Kuka, KukaConfig, KukaDouble, UdpWire
from deformscope_drivers.kuka.messages import SenMessage, decode_rob, decode_sen, encode_sen
from deformscope_drivers.kuka.port import free_port
from deformscope_drivers.wires import LOOPBACK
from tests.drivers.kuka.test_device import Bench
from tests.patience import PATIENCE_S

RATES = JointVelocity((8.0, 0.0, 0.0, 0.0, 0.0, 0.0))
CYCLE_NS = 12_000_000
STEP_DEG = 0.1


def answered_once(double: KukaDouble, correction_deg: float = STEP_DEG, cycles: int = 30) -> FloatArray:
    """(cycles,) how far the first axis is, cycle by cycle, after one answer and none any more [deg]."""
    double.power_up(0)
    start_deg = double.joints_deg
    double.receive(encode_sen(SenMessage((correction_deg,) + (0.0,) * 5, decode_rob(double.due(0)).ipoc)), 1)
    way = []
    for cycle in range(1, cycles + 1):
        double.due(cycle * CYCLE_NS)
        way.append(float(double.joints_deg[0] - start_deg[0]))
    return np.array(way)


def test_holdon_0_moves_an_axis_once() -> None:
    assert answered_once(KukaDouble(holdon=0))[-1] == pytest.approx(STEP_DEG)


def test_holdon_1_repeats_the_last_correction_until_the_timeout() -> None:
    double = KukaDouble(holdon=1)
    way = answered_once(double, cycles=200)
    assert way[20] - way[10] == pytest.approx(10 * STEP_DEG)
    assert "were late" in double.ended
    assert way[-1] == pytest.approx(100 * STEP_DEG, abs=2 * STEP_DEG)
    assert answered_once(KukaDouble(holdon=1, timeout=5))[-1] == pytest.approx(5 * STEP_DEG, abs=2 * STEP_DEG)


def test_holdon_is_of_each_correction() -> None:
    assert answered_once(KukaDouble(holdon=(0, 1, 1, 1, 1, 1)))[-1] == pytest.approx(STEP_DEG)
    assert answered_once(KukaDouble(holdon=(1, 0, 0, 0, 0, 0)))[-1] > 10 * STEP_DEG


def test_absolute_corrections_count_from_where_rsi_began() -> None:
    released, held = (answered_once(KukaDouble(absolute=True, holdon=holdon)) for holdon in (0, 1))
    assert released.max() == pytest.approx(STEP_DEG)
    assert released[-1] == pytest.approx(0.0)
    np.testing.assert_allclose(held[-10:], STEP_DEG)


def test_axes_follow_as_lag_and_acceleration_let_them() -> None:
    at_once, late = answered_once(KukaDouble()), answered_once(KukaDouble(lag_s=0.05, acceleration_deg_s2=100.0))
    assert at_once[1] == pytest.approx(STEP_DEG)
    assert late[1] < 0.5 * STEP_DEG
    rates = np.diff(late) / 0.012
    assert np.abs(np.diff(rates)).max() <= 100.0 * 0.012 + 1e-9
    assert late[-1] == pytest.approx(STEP_DEG, rel=0.05)


def test_axes_that_were_moving_brake_as_rsi_ends() -> None:
    double = KukaDouble(holdon=1, timeout=5, acceleration_deg_s2=100.0)
    way = answered_once(double, cycles=60)
    ended = int(np.argmax(np.diff(way) < np.diff(way)[4] - 1e-6))
    assert double.ended
    assert way[-1] - way[ended] > 2 * STEP_DEG  # v^2 / 2 a
    assert way[-1] == way[-2]
    assert double.next_ns(60 * CYCLE_NS) is None


@pytest.mark.parametrize("cycle_s", [0.004, 0.012])
@pytest.mark.parametrize("lag_s", [0.0, 0.06])
@pytest.mark.parametrize("holdon", [1, *(tuple(np.eye(6, dtype=int)[axis].tolist()) for axis in range(6))])
def test_a_controller_that_holds_any_correction_is_refused_before_motion(
    holdon: int | tuple[int, ...], lag_s: float, cycle_s: float
) -> None:
    double = KukaDouble(holdon=holdon, lag_s=lag_s, cycle_s=cycle_s, acceleration_deg_s2=500.0)
    bench = Bench(KukaConfig(cycle_s=cycle_s), double)
    with pytest.raises(SettingsRefused, match=r'HOLDON="0" for AK\.A1') as refused:
        bench.arm.open(own_thread=False)
    held = [f"A{axis + 1} +0.03" in str(refused.value) for axis in range(6)]
    np.testing.assert_array_equal(held, np.broadcast_to(holdon, 6).astype(bool))
    assert not bench.arm.is_open
    double.due(bench.clock() + 2_000_000_000)
    assert np.abs(double.joints_deg - double.chain.home_deg).max() < 0.035


@pytest.mark.parametrize("holdon", [0, 1])
@pytest.mark.parametrize("lag_s", [0.0, 0.06])
def test_absolute_corrections_are_refused(lag_s: float, holdon: int) -> None:
    bench = Bench(KukaConfig(), KukaDouble(absolute=True, holdon=holdon, lag_s=lag_s))
    with pytest.raises(SettingsRefused, match=r"#RELATIVE\) in place of #ABSOLUTE"):
        bench.arm.open(own_thread=False)


class Deaf(KukaDouble):
    """Nothing corrects its axes, as before RSI_MOVECORR."""

    def receive(self, data: bytes, now_ns: int) -> None:
        super().receive(encode_sen(SenMessage((0.0,) * 6, decode_sen(data).ipoc)), now_ns)


def test_axes_that_no_answer_moves_are_refused() -> None:
    with pytest.raises(SettingsRefused, match="RSI_MOVECORR"):
        Bench(KukaConfig(), Deaf()).arm.open(own_thread=False)


class LosesTheFirst(KukaDouble):
    """The network loses the first answers that would move it."""

    def __init__(self, lost: int) -> None:
        super().__init__()
        self._to_lose = lost

    def receive(self, data: bytes, now_ns: int) -> None:
        if any(decode_sen(data).corrections_deg) and self._to_lose:
            self._to_lose -= 1
            return
        super().receive(data, now_ns)


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_a_correction_that_came_too_late_is_tried_again(lost: int) -> None:
    double = LosesTheFirst(lost)
    with Bench(KukaConfig(), double).arm.open(own_thread=False) as arm:
        assert arm.is_open
        assert np.abs(double.joints_deg - double.chain.home_deg).max() < 0.021


def test_opening_leaves_the_arm_where_it_was_and_lifts_the_flange_meanwhile() -> None:
    bench = Bench()
    heights, poses, receive = [], [], bench.double.receive

    def look(data: bytes, now_ns: int) -> None:
        heights.append(float(bench.double.T_base_end_effector[2, 3]))
        poses.append(bench.double.joints_deg)
        receive(data, now_ns)

    bench.double.receive = look  # type: ignore[method-assign]
    with bench.arm.open(own_thread=False):
        bench.advance(0.1)
        np.testing.assert_allclose(bench.double.joints_deg, bench.double.chain.home_deg, atol=1e-9)
    assert np.abs(np.array(poses) - bench.double.chain.home_deg).max() == pytest.approx(0.01)
    assert min(heights) >= heights[0] - 1e-6
    assert 1e-5 < max(heights) - heights[0] < 3e-4


def test_an_axis_at_the_end_of_its_range_is_tried_inwards() -> None:
    chain = KukaDouble().chain
    for start_deg in (chain.upper_deg - 0.005, chain.lower_deg + 0.005):
        double = KukaDouble(start_deg=start_deg)
        with Bench(KukaConfig(), double).arm.open(own_thread=False):
            assert not double.ended


def test_two_answers_are_left_out_and_counted_as_nothing_else() -> None:
    bench = Bench()
    with bench.arm.open(own_thread=False):
        bench.advance(0.1)
        answers = [answer for _, answer in bench.wire.answers]
        first, back = (index for index, answer in enumerate(answers) if any(answer.corrections_deg))
        np.testing.assert_allclose(np.add(answers[first].corrections_deg, answers[back].corrections_deg), 0.0)
        steps = np.diff([answer.ipoc for answer in answers])
        np.testing.assert_array_equal(np.flatnonzero(steps != 12), [first])
        assert steps[first] == 36
        assert bench.arm.health().extra["answers_late"] == 0


def halt_then_close(arm: Kuka) -> None:
    arm.halt("the end")
    arm.close()


def stop_then_close(arm: Kuka) -> None:
    arm.stop()
    arm.close()


@pytest.mark.parametrize("end", [Kuka.close, halt_then_close, stop_then_close])
@pytest.mark.parametrize("phase_s", [0.0, 0.003, 0.007, 0.011])
def test_three_zeros_are_out_before_the_port_is_closed(end: Callable[[Kuka], None], phase_s: float) -> None:
    bench = Bench()
    bench.arm.open(own_thread=False)
    bench.arm.set_velocity(RATES, 10.0)
    bench.advance(0.3 + phase_s)
    assert any(bench.wire.answers[-1][1].corrections_deg)
    end(bench.arm)
    last = [answer for _, answer in bench.wire.answers[-3:]]
    assert not np.any([answer.corrections_deg for answer in last])
    np.testing.assert_array_equal(np.diff([answer.ipoc for answer in last]), 12)
    assert any(bench.wire.answers[-4][1].corrections_deg)  # and not later


@pytest.mark.parametrize("stop", [Kuka.stop, lambda arm: arm.halt("enough")])
def test_a_stop_returns_once_zeros_are_out(stop: Callable[[Kuka], None]) -> None:
    bench = Bench()
    with bench.arm.open(own_thread=False) as arm:
        arm.set_velocity(RATES, 10.0)
        bench.advance(0.1)
        stop(arm)
        assert not any(bench.wire.answers[-1][1].corrections_deg)


class Late(KukaDouble):
    """Takes no answer while it is `late`, and says so."""

    late = False

    def receive(self, data: bytes, now_ns: int) -> None:
        if not self.late:
            super().receive(data, now_ns)


def test_zeros_that_came_too_late_do_not_count() -> None:
    double = Late()
    bench = Bench(KukaConfig(), double)
    bench.arm.open(own_thread=False)
    bench.arm.set_velocity(RATES, 10.0)
    bench.advance(0.1)
    double.late = True
    with pytest.raises(NotStopped, match="emergency stop"):
        bench.arm.close()


@pytest.mark.parametrize("moving", [True, False])
def test_a_cable_that_is_out_is_told_at_closing_where_the_arm_was_moving(moving: bool) -> None:
    bench = Bench()
    bench.arm.open(own_thread=False)
    if moving:
        bench.arm.set_velocity(RATES, 10.0)
    bench.advance(0.1)
    bench.wire.unplug()
    if not moving:
        bench.arm.close()
        return
    with pytest.raises(NotStopped, match="emergency stop"):
        bench.arm.close()
    assert not bench.arm.is_open


class Keeping(KukaDouble):
    """Keeps the corrections of all answers it takes."""

    def __init__(self) -> None:
        super().__init__()
        self.taken_deg: list[tuple[float, ...]] = []
        self.moved = threading.Event()

    def receive(self, data: bytes, now_ns: int) -> None:
        super().receive(data, now_ns)
        corrections_deg = decode_sen(data).corrections_deg
        self.taken_deg.append(corrections_deg)
        if corrections_deg[0] > 0.05:
            self.moved.set()

    def ends_with_zeros(self) -> bool:
        return self.moved.is_set() and not np.any(self.taken_deg[-3:])


@pytest.mark.parametrize("halts", [True, False])
@pytest.mark.parametrize("hosted", [True, False])
def test_on_the_hosts_clock_the_last_three_answers_are_zeros(hosted: bool, halts: bool) -> None:
    """The normal end, halt() and then close(), was a race before: the port closed before zeros were out."""
    double, port = Keeping(), free_port()
    config = KukaConfig(address=LOOPBACK, port=port, wait_s=PATIENCE_S)
    with UdpWire(double, port):
        arm = HostedArm(Kuka, config) if hosted else Kuka(config)
        with arm:
            arm.set_velocity(RATES, 30.0)
            assert double.moved.wait(PATIENCE_S)
            if halts:
                arm.halt("the end")
        limit = time.monotonic() + PATIENCE_S
        while not double.ends_with_zeros() and time.monotonic() < limit:
            time.sleep(0.01)
        assert double.ends_with_zeros()


class Unplugged(Keeping):
    """Neither asks nor takes anything once its cable is `out`."""

    out = False

    def receive(self, data: bytes, now_ns: int) -> None:
        if not self.out:
            super().receive(data, now_ns)

    def due(self, now_ns: int) -> bytes:
        sent = super().due(now_ns)
        return b"" if self.out else sent


@pytest.mark.parametrize("moving", [True, False])
def test_a_cable_that_is_out_is_told_by_an_arm_in_its_own_process_too(moving: bool) -> None:
    double, port = Unplugged(), free_port()
    with UdpWire(double, port):
        arm = HostedArm(Kuka, KukaConfig(address=LOOPBACK, port=port, wait_s=PATIENCE_S)).open()
        if moving:
            arm.set_velocity(RATES, 30.0)
            assert double.moved.wait(PATIENCE_S)
        double.out = True
        with pytest.raises(NotStopped, match="emergency stop") if moving else contextlib.nullcontext():
            arm.close()
        assert not arm.is_open


FORGETS = """
import sys, time
from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.kuka import Kuka, KukaConfig
arm = Kuka(KukaConfig(address="127.0.0.1", port=int(sys.argv[1]), wait_s=60.0, own_process=False)).open()
arm.set_velocity(JointVelocity((8.0, 0.0, 0.0, 0.0, 0.0, 0.0)), 30.0)
time.sleep(0.2)
"""


def test_a_program_that_ends_without_closing_sends_zeros_too() -> None:
    double, port = Keeping(), free_port()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with UdpWire(double, port):
        subprocess.run([sys.executable, "-c", FORGETS, str(port)], env=environment, timeout=PATIENCE_S, check=True)
        time.sleep(0.05)
        assert double.ends_with_zeros()
