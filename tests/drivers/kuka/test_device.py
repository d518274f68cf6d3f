"""A KUKA through RSI: every cycle answered, corrections clamped and over in time, a controller that is not as it should
be refused."""

from collections.abc import Iterator

import numpy as np
import pytest

from deformscope_drivers.arm import CartesianVelocity, JointVelocity, MotionStopped
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.errors import DeviceError, LinkLost, NotConnected, SettingsRefused
from deformscope_drivers.health import Link
from deformscope_drivers.kuka import Kuka, KukaConfig, KukaDouble
from deformscope_drivers.kuka.double import UNIT_NM
from deformscope_drivers.kuka.messages import SenMessage, decode_sen
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from tests.drivers.arm.test_contract import polled

CYCLE_S = 0.012


class Listening(MemoryTransport):
    """Keeps every answer, with when it was sent."""

    def __init__(self, double: KukaDouble, clock: SimulatedClock) -> None:
        super().__init__(double, clock)
        self.answers: list[tuple[int, SenMessage]] = []
        self._at = clock

    def write(self, data: bytes) -> None:
        self.answers.append((self._at(), decode_sen(data)))
        super().write(data)


class Bench:
    def __init__(self, config: KukaConfig | None = None, double: KukaDouble | None = None) -> None:
        self.clock = SimulatedClock(1_000_000_000)
        self.double = double or KukaDouble()
        self.wire = Listening(self.double, self.clock)
        self.arm = Kuka(config or KukaConfig(), self.wire, clock=self.clock)
        self.advance = polled(self.arm, self.clock)

    def since(self, moment_ns: int) -> FloatArray:
        """(n, 6) corrections that were answered since then [deg]."""
        return np.array([answer.corrections_deg for when, answer in self.wire.answers if when > moment_ns])


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    with made.arm.open(own_thread=False):
        made.advance(0.1)
        yield made


def test_every_cycle_is_answered_with_its_own_ipoc(bench: Bench) -> None:
    bench.wire.answers.clear()
    bench.advance(1.2)
    ipocs = np.array([answer.ipoc for _, answer in bench.wire.answers])
    assert len(ipocs) == pytest.approx(100, abs=1)
    assert np.all(np.diff(ipocs) == 12)
    assert bench.double.missed == 0
    assert not bench.since(0).any()


def test_a_correction_is_velocity_times_cycle(bench: Bench) -> None:
    began = bench.clock()
    bench.arm.set_velocity(JointVelocity((10.0, 0.0, -5.0, 0.0, 0.0, 20.0)), 1.0)
    bench.advance(0.5)
    sent = bench.since(began)
    np.testing.assert_allclose(sent, np.tile([0.12, 0.0, -0.06, 0.0, 0.0, 0.24], (len(sent), 1)), atol=1e-9)


def test_it_is_zero_from_the_first_cycle_after_it_has_expired(bench: Bench) -> None:
    bench.arm.set_velocity(JointVelocity((10.0,) + (0.0,) * 5), 0.1)
    ends = bench.clock() + 100_000_000
    bench.advance(0.5)
    assert not bench.since(ends).any()
    assert bench.arm.health().extra["commands_expired"] == 1


def test_an_axis_is_never_corrected_beyond_its_limit(bench: Bench) -> None:
    """A Cartesian velocity near a singularity wants more of an axis than it may: all are slowed alike."""
    began = bench.clock()
    bench.arm.set_velocity(CartesianVelocity((0.0, 0.0, 0.05), (0.0, 0.0, 0.35)), 2.0)
    bench.advance(1.0)
    assert np.abs(bench.since(began)).max() <= 20.0 * CYCLE_S + 1e-9
    assert np.abs(bench.since(began)).max() > 0.01


def test_an_axis_at_the_end_of_its_range_is_halted_before(bench: Bench) -> None:
    double = bench.double
    for _ in range(2000):
        try:
            bench.arm.set_velocity(JointVelocity((0.0, 20.0, 0.0, 0.0, 0.0, 0.0)), 0.05)
        except MotionStopped:
            break
        bench.advance(0.02)
    assert "end of its range" in bench.arm.stopped_because
    assert double.joints_deg[1] < double.chain.upper_deg[1]
    assert not double.ended


def test_halt_is_zero_in_the_next_answer(bench: Bench) -> None:
    bench.arm.set_velocity(JointVelocity((10.0,) + (0.0,) * 5), 10.0)
    bench.advance(0.2)
    bench.arm.halt("enough")
    halted = bench.clock()
    bench.advance(0.3)
    assert not bench.since(halted).any()


def test_a_controller_whose_program_ends_is_reported(bench: Bench) -> None:
    bench.double.running = False
    with pytest.raises(LinkLost, match="smartPAD"):
        bench.advance(1.0)
    assert bench.arm.link is Link.LOST


def test_the_controller_ends_rsi_where_nobody_answers() -> None:
    double = KukaDouble()
    double.power_up(0)
    double.due(2_000_000_000)
    assert "were late" in double.ended
    np.testing.assert_array_equal(double.joints_deg, double.chain.home_deg)


def test_an_answer_with_another_ipoc_counts_as_missing() -> None:
    double = KukaDouble()
    double.power_up(0)
    double.due(0)
    double.receive(b'<Sen Type="ImFree"><AK A1="0.1" A2="0" A3="0" A4="0" A5="0" A6="0"/><IPOC>5</IPOC></Sen>', 1)
    double.due(13_000_000)
    assert double.missed == 2
    assert double.corrections == 0


def test_other_cycles_than_configured_are_refused() -> None:
    bench = Bench(KukaConfig(cycle_s=0.012), KukaDouble(cycle_s=0.004))
    with pytest.raises(SettingsRefused, match="of 4 ms"):
        bench.arm.open(own_thread=False)


@pytest.mark.parametrize(
    ("config", "double"),
    [
        (KukaConfig(model="kr6r900sixx"), KukaDouble("kr6r700sixx")),
        (KukaConfig(), KukaDouble(T_base_tool_offset_m=0.1)),
    ],
)
def test_another_model_or_a_tool_in_the_controller_is_refused(config: KukaConfig, double: KukaDouble) -> None:
    bench = Bench(config, double)
    with pytest.raises(SettingsRefused, match="NULLFRAME"):
        bench.arm.open(own_thread=False)


def test_opening_waits_for_the_program_and_says_so() -> None:
    double = KukaDouble()
    double.running = False
    bench = Bench(KukaConfig(wait_s=0.5), double)
    with pytest.raises(NotConnected, match="smartPAD"):
        bench.arm.open(own_thread=False)


def test_what_is_no_message_is_counted_and_answered_by_nothing(bench: Bench) -> None:
    before = len(bench.wire.answers)
    bench.double._waiting.append(b"<Rob><AIPos/></Rob>")
    with bench.arm.readings():
        bench.arm.poll(0.0)
    assert sum(bench.arm.health().refused.values()) == 1
    assert len(bench.wire.answers) <= before + 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"cycle_s": 0.01},
        {"model": "panda"},
        {"address": "nowhere"},
        {"port": 70000},
        {"sen_type": '"/>'},
        {"joint_limit_deg_s": 0.0},
        {"command_deadline_s": 9.0},
    ],
)
def test_a_configuration_that_makes_no_sense_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises((ValueError, DeviceError)):
        KukaConfig(**wrong)  # type: ignore[arg-type]


def test_motor_currents_are_published_and_hold_gravity_friction_and_load(bench: Bench) -> None:
    def currents(seconds: float = 1.0) -> FloatArray:
        """Means (6,) of what the driver publishes for a while."""
        with bench.arm.readings() as queue:
            bench.advance(seconds)
            return np.array([state.currents for state in queue.take()]).mean(axis=0)

    assert currents().size == 0  # without DEF_MACur there are none
    bench.double.sends_currents = True
    free = currents()
    bench.double.push((0.0, 0.0, 30.0, 0.0, 0.0, 0.0))
    pushed = currents()
    bench.double.push(np.zeros(6))
    bench.arm.set_velocity(JointVelocity((0.0, 2.0, 0.0, 0.0, 0.0, 0.0)), 2.0)
    turning = currents()
    out_m = bench.double.T_base_end_effector[0, 3]
    assert abs(free[1]) > 10.0  # the forearm's weight, beyond the shoulder
    shoulder_m = out_m - 0.025
    assert abs(pushed[1] - free[1]) * UNIT_NM[1] == pytest.approx(30.0 * shoulder_m, abs=1.0)
    assert abs(turning[1] - free[1]) * UNIT_NM[1] == pytest.approx(15.0, abs=3.0)  # friction, at 30 times its turn
