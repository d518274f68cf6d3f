"""`home` of a Jaco in its own process: a halt, a stop and the end of the program come first.

Moments are those of calls to the vendor's library there, on the clock that both processes share."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope_drivers.arm import ArmState, JointVelocity, MotionStopped
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.jaco import Jaco, JacoConfig, JacoDouble
from deformscope_drivers.jaco.chains import J2N6S300
from deformscope_drivers.jaco.device import HOME_PAUSE_S
from deformscope_drivers.kuka import Kuka, KukaConfig
from tests.cases import slow
from tests.patience import PATIENCE_S

PERIOD_S = 0.01
AWAY_DEG = np.array([60.0, 20.0, 0.0, 0.0, 0.0, 0.0])
"""From home: 3 s at the double's 20 deg/s."""
KEPT = ("StopControlAPI", "StartControlAPI", "MoveHome", "EraseAllTrajectories")


class Kept:
    """A double whose calls are kept in a file: name, moment [ns] and angle of joint 1 [deg] a line."""

    where = "a double in the arm's process"

    def __init__(self, double: JacoDouble, path: Path) -> None:
        self._double, self._path = double, path

    def function(self, name: str) -> Callable[..., int]:
        called = self._double.function(name)
        if name not in KEPT:
            return called

        def kept(*arguments: Any) -> int:
            code = called(*arguments)
            with self._path.open("a") as file:
                print(name, monotonic_ns(), self._double.joints_deg[0], file=file)
            return code

        return kept


class Unhomed(Jaco):
    """A Jaco that was just switched on, away from home; `library` names the file of its calls."""

    def __init__(self, config: JacoConfig) -> None:
        double = JacoDouble(cold_boot=True, start_deg=J2N6S300.home_deg + AWAY_DEG)
        super().__init__(config, Kept(double, Path(config.library)))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "calls"
    path.touch()
    return path


@pytest.fixture
def arm(path: Path) -> Iterator[HostedArm]:
    with HostedArm(Unhomed, JacoConfig(library=str(path))) as arm:
        yield arm


def calls(path: Path) -> list[tuple[str, int, float]]:
    return [(name, int(ns), float(deg)) for name, ns, deg in map(str.split, path.read_text().splitlines())]


def until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < limit, "nothing happened"
        time.sleep(0.002)


def moves_home(path: Path) -> int:
    return sum(name == "MoveHome" for name, _, _ in calls(path))


def halted(arm: HostedArm, path: Path, homes: ThreadPoolExecutor) -> float:
    """Halt an arm on its way home: after how long [s] its trajectories were erased."""
    before = moves_home(path)
    going: Future[ArmState] = homes.submit(arm.home)
    until(lambda: moves_home(path) > before)
    asked_ns = monotonic_ns()
    arm.halt("enough")
    with pytest.raises(MotionStopped, match="enough"):
        going.result(PATIENCE_S)
    erased_ns = min(ns for name, ns, _ in calls(path) if name == "EraseAllTrajectories" and ns > asked_ns)
    arm.acknowledge_stop()
    return (erased_ns - asked_ns) / 1e9


def test_an_arm_that_was_switched_on_is_homed_through_its_own_process(arm: HostedArm, path: Path) -> None:
    """Stop, wait, start, MoveHome: as the vendor's driver does it."""
    assert arm.goes_home
    assert not arm.homed
    with pytest.raises(DeviceError, match="deformscope arm home"):
        until(lambda: arm.set_velocity(JointVelocity((5.0, 0.0, 0.0, 0.0, 0.0, 0.0)), 1.0) is not None)
    path.write_text("")
    state = arm.home()
    assert arm.homed
    np.testing.assert_allclose(state.joints_deg, J2N6S300.home_deg, atol=0.1)
    made = [one for one in calls(path) if one[0] != "EraseAllTrajectories"]
    assert [name for name, _, _ in made] == ["StopControlAPI", "StartControlAPI", "MoveHome"]
    assert made[1][1] - made[0][1] >= 0.99e9 * HOME_PAUSE_S
    arm.set_velocity(JointVelocity((5.0, 0.0, 0.0, 0.0, 0.0, 0.0)), 0.2)  # it takes commands


def test_a_halt_does_not_wait_for_the_arm_to_be_home(arm: HostedArm, path: Path) -> None:
    with ThreadPoolExecutor(1) as homes:
        halted(arm, path, homes)
    assert calls(path)[-1][2] - J2N6S300.home_deg[0] > 20.0, "it went on"


@pytest.mark.realtime
def test_a_halt_while_homing_comes_within_two_periods(arm: HostedArm, path: Path) -> None:
    with ThreadPoolExecutor(1) as homes:
        late_ms = [1e3 * halted(arm, path, homes) for _ in range(50)]
    print(f"erased after {np.median(late_ms):.1f} ms in the middle, {max(late_ms):.1f} ms at most")
    assert sum(one <= 2e3 * PERIOD_S for one in late_ms) == 50


@pytest.mark.parametrize("pause", [True, False])
def test_stop_ends_it_wherever_it_is(arm: HostedArm, path: Path, pause: bool) -> None:
    """In the pause before it sets out too: then it never does."""
    path.write_text("")
    with ThreadPoolExecutor(1) as homes:
        going = homes.submit(arm.home)
        until(lambda: any(name == ("StopControlAPI" if pause else "MoveHome") for name, _, _ in calls(path)))
        arm.stop()
        with pytest.raises(MotionStopped, match="home"):
            going.result(PATIENCE_S)
    assert moves_home(path) == (0 if pause else 1)
    assert arm.ask("stop") is None  # it answers
    assert [name for name, _, _ in calls(path)].count("StartControlAPI") == 1, "left without control"


PROGRAM = """
import sys
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.jaco import JacoConfig
from tests.drivers.arm.test_homing import Unhomed
with HostedArm(Unhomed, JacoConfig(library=sys.argv[1])) as arm:
    arm.home()
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP, slow(signal.SIGINT), slow(signal.SIGTERM)])
def test_the_arm_stands_when_the_program_that_sends_it_home_is_gone(number: signal.Signals, path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    root = Path(__file__).parents[3]
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(path)], env=environment, cwd=root, stderr=subprocess.DEVNULL
    )
    try:
        until(lambda: moves_home(path) == 1)
        gone_ns = monotonic_ns()
        program.send_signal(number)
        until(lambda: any(name == "EraseAllTrajectories" and ns > gone_ns for name, ns, _ in calls(path)))
        erased = next(one for one in calls(path) if one[0] == "EraseAllTrajectories" and one[1] > gone_ns)
        assert erased[2] - J2N6S300.home_deg[0] > 1.0, "it was home by then"
    finally:
        program.kill()
        program.wait()


def test_two_threads_do_not_wait_for_one_another(arm: HostedArm, path: Path) -> None:
    """Answers go to who asked, however late the first one is."""
    with ThreadPoolExecutor(1) as homes:
        going = homes.submit(arm.home)
        until(lambda: moves_home(path) == 1)
        states = [arm.next(PATIENCE_S) for _ in range(5)]  # states go on meanwhile
        assert len({state.joints_deg for state in states}) == 5
        asker = threading.Thread(target=arm.acknowledge_stop)
        asker.start()
        asker.join(PATIENCE_S)
        assert not asker.is_alive()
        assert not going.done()
        arm.stop()


def test_an_arm_without_a_home_says_so() -> None:
    assert not HostedArm(Kuka, KukaConfig()).goes_home
