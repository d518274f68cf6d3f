"""An arm in a process of its own: it stands when this program is stopped or dies, and says what is wrong there.

Moments are those of the double's own cycles, not of this machine."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from deformscope_drivers.arm import JointVelocity, MotionStopped
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.errors import LinkLost, NotConnected, SettingsRefused
from deformscope_drivers.health import Link
from deformscope_drivers.kuka import Kuka, KukaConfig, KukaDouble, UdpWire
from deformscope_drivers.kuka.messages import decode_sen
from deformscope_drivers.kuka.port import free_port
from deformscope_drivers.wires import LOOPBACK
from tests.drivers.contract import Bench, DeviceContract
from tests.patience import PATIENCE_S

LONG_S = 60.0
RATES = JointVelocity((4.0, 0.0, 0.0, 0.0, 0.0, 0.0))


class Counting(KukaDouble):
    """Keeps when the last answer came that would move the arm, and when any came [ns]."""

    moved_ns = answered_ns = 0

    def receive(self, data: bytes, now_ns: int) -> None:
        super().receive(data, now_ns)
        self.answered_ns = now_ns
        if any(decode_sen(data).corrections_deg):
            self.moved_ns = now_ns


def until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < limit, "nothing happened"
        time.sleep(0.005)


@pytest.fixture
def double() -> Counting:
    return Counting(again_s=0.1)


@pytest.fixture
def config(double: Counting) -> Iterator[KukaConfig]:
    port = free_port()
    with UdpWire(double, port):
        yield KukaConfig(address=LOOPBACK, port=port, wait_s=PATIENCE_S)


class TestHostedKuka(DeviceContract):
    @pytest.fixture
    def bench(self, config: KukaConfig) -> Bench:
        return Bench(HostedArm(Kuka, config))


def test_it_moves_halts_and_takes_commands_again(config: KukaConfig, double: Counting) -> None:
    with HostedArm(Kuka, config) as arm:
        assert arm.chain.name == "kr6r900sixx"
        assert arm.identity().model == "kr6r900sixx"
        assert arm.urdf.name == "kr6r900sixx.urdf"
        start = double.joints_deg
        arm.set_velocity(RATES, LONG_S)
        until(lambda: bool(double.joints_deg[0] > start[0] + 0.1))
        arm.halt("enough")
        halted_ns = monotonic_ns()
        with pytest.raises(MotionStopped, match="enough"):
            arm.set_velocity(RATES, 1.0)
        until(lambda: double.answered_ns > halted_ns + 50_000_000)
        assert double.moved_ns <= halted_ns
        arm.acknowledge_stop()
        stands = double.joints_deg
        arm.set_velocity(RATES, 0.2)
        until(lambda: bool(double.joints_deg[0] > stands[0]))
        assert arm.health().extra.keys() >= {"commands_expired"} or arm.next(PATIENCE_S)


def test_why_it_was_stopped_there_is_known_here(config: KukaConfig, double: Counting) -> None:
    """An axis that comes to the end of its range is halted by the driver itself."""
    double._joints_deg[1] = double._setpoint_deg[1] = double.chain.upper_deg[1] - 0.3
    with HostedArm(Kuka, config) as arm:
        arm.set_velocity(JointVelocity((0.0, 4.0, 0.0, 0.0, 0.0, 0.0)), LONG_S)
        until(lambda: bool(arm.stopped_because))
        assert "end of its range" in arm.stopped_because


def test_what_is_refused_there_is_raised_here(config: KukaConfig) -> None:
    import dataclasses

    with pytest.raises(SettingsRefused, match="NULLFRAME"):
        HostedArm(Kuka, dataclasses.replace(config, model="kr6r700sixx")).open()
    nobody = HostedArm(Kuka, KukaConfig(address=LOOPBACK, port=free_port(), wait_s=0.1))
    with pytest.raises(NotConnected, match="smartPAD"):
        nobody.open()


def test_a_process_that_dies_is_a_lost_link_that_is_found_again(config: KukaConfig, double: Counting) -> None:
    with HostedArm(Kuka, config) as arm:
        arm.set_velocity(RATES, LONG_S)
        until(lambda: bool(double.moved_ns))
        assert arm.process_id is not None
        os.kill(arm.process_id, signal.SIGKILL)
        until(lambda: arm.health().reconnects == 1 and arm.link is Link.CONNECTED)
        assert "lost" in arm.stopped_because  # nobody goes on as if nothing had been
        with pytest.raises((MotionStopped, LinkLost)):
            arm.set_velocity(RATES, 1.0)


def test_nothing_moves_after_a_process_was_killed_until_an_operator_says_so(
    config: KukaConfig, double: Counting
) -> None:
    """An arm at rest, whose tip may press: not even the test of missing answers."""
    with HostedArm(Kuka, config) as arm:
        until(lambda: double.answered_ns > double.moved_ns + 100_000_000)
        stands, tested_ns = double.joints_deg, double.moved_ns
        assert arm.process_id is not None
        os.kill(arm.process_id, signal.SIGKILL)
        until(lambda: arm.health().reconnects == 1 and bool(arm.stopped_because))
        again_ns = monotonic_ns()
        until(lambda: double.answered_ns > again_ns + 700_000_000)  # the test settles within half a second
        np.testing.assert_array_equal(double.joints_deg, stands)
        assert double.moved_ns == tested_ns
        with pytest.raises(MotionStopped, match="link was lost"):
            arm.set_velocity(RATES, 1.0)
        arm.acknowledge_stop()
        assert double.moved_ns > tested_ns  # now it is tested
        tested_ns = double.moved_ns
        arm.set_velocity(RATES, 0.2)
        until(lambda: double.moved_ns > tested_ns)


def test_a_controller_that_repeats_corrections_is_refused_when_it_is_tested_again(
    config: KukaConfig, double: Counting
) -> None:
    with HostedArm(Kuka, config) as arm:
        assert arm.process_id is not None
        os.kill(arm.process_id, signal.SIGKILL)
        until(lambda: arm.health().reconnects == 1 and bool(arm.stopped_because))
        double._holdon[:] = True
        with pytest.raises(SettingsRefused, match="HOLDON"):
            arm.acknowledge_stop()
        assert arm.stopped_because


PROGRAM = """
import sys, time
from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.kuka import Kuka, KukaConfig
arm = HostedArm(Kuka, KukaConfig(address="127.0.0.1", port=int(sys.argv[1]), wait_s=60.0)).open()
print("moving", flush=True)
while True:
    arm.set_velocity(JointVelocity((4.0, 0.0, 0.0, 0.0, 0.0, 0.0)), {valid_s})
    time.sleep(0.01)
"""


@pytest.mark.parametrize(("number", "valid_s"), [(signal.SIGKILL, 60.0), (signal.SIGSTOP, 0.04)])
def test_the_arm_stands_when_the_program_that_moves_it_is_gone(
    number: signal.Signals, valid_s: float, config: KukaConfig, double: Counting, tmp_path: Path
) -> None:
    """Killed: the socket's end halts it, even where its velocity would hold for a minute. Stopped: it expires."""
    script = tmp_path / "program.py"
    script.write_text(PROGRAM.format(valid_s=valid_s))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    program = subprocess.Popen([sys.executable, str(script), str(config.port)], stdout=subprocess.PIPE, env=environment)
    try:
        program.stdout.readline()
        until(lambda: bool(double.moved_ns))
        program.send_signal(number)
        gone_ns = monotonic_ns()
        until(lambda: monotonic_ns() - max(double.moved_ns, gone_ns) > 300_000_000)
        late_ms = (double.moved_ns - gone_ns) / 1e6
        stands = double.joints_deg
        time.sleep(0.1)
        np.testing.assert_array_equal(double.joints_deg, stands)
        print(f"{number.name}: the last answer that moves came {late_ms:.1f} ms after")
        assert late_ms < 1e3 * PATIENCE_S / 10
    finally:
        program.kill()
        program.wait()
        program.stdout.close()
