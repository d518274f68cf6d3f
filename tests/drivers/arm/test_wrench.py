"""The force that an arm itself reports, as a force sensor: against a simulated Jaco that is pushed."""

import dataclasses

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.rig.rig_file import parse_rig
from deformscope.rig.source import RigMember, RigSource
from deformscope_drivers.arm.kinematics import FloatArray, jacobian_of
from deformscope_drivers.arm.wrench import TURN_DEG, ArmWrench, ArmWrenchConfig, pose_terms, reported_n, way_terms
from deformscope_drivers.errors import NotConnected, SettingsRefused
from deformscope_drivers.interface import DRIVERS, Wrench
from deformscope_drivers.jaco import Jaco, JacoConfig, JacoDouble
from deformscope_drivers.kuka import KukaConfig
from deformscope_drivers.memory import SimulatedClock

PUSH_N = np.array([3.0, -1.0, 4.0])
NOISE_NM = 0.05


class Bench:
    """A Jaco whose joints' torques have noise, and its own force."""

    def __init__(self, config: ArmWrenchConfig) -> None:
        self.clock = SimulatedClock(1_000_000_000)
        self.double = JacoDouble("j2n6s300", self.clock)
        self.double.blur_torques(NOISE_NM, 0.0)
        self.arm = Jaco(JacoConfig(state_hz=100.0), self.double, clock=self.clock)
        self.own = ArmWrench(config)
        self.own.attach(self.arm)
        self.arm.open(own_thread=False)
        self.own.open(own_thread=False)
        self.waiting = self.own.readings()

    def readings(self, seconds: float) -> list[Wrench]:
        for _ in range(round(100 * seconds)):
            self.clock.advance_to(self.clock() + 10_000_000)
            self.arm.poll(0.0)
            self.own.poll(0.0)
        return self.waiting.take()


@pytest.fixture
def bench() -> Bench:
    return Bench(ArmWrenchConfig())


def mean_n(readings: list[Wrench]) -> FloatArray:
    return np.asarray(np.mean([one.force_n[0] for one in readings], axis=0))


def test_a_push_is_measured_in_the_frame_of_the_arms_end(bench: Bench) -> None:
    bench.readings(0.5)
    bench.own.zero()
    bench.double.push([*PUSH_N, 0.0, 0.0, 0.0])
    bench.readings(1.0)
    found = bench.readings(3.0)
    R = bench.double.T_base_end_effector[:3, :3]
    np.testing.assert_allclose(mean_n(found), -R.T @ PUSH_N, atol=0.15)
    assert all(one.usable for one in found)
    assert len({one.counts for one in found}) > len(found) / 4, "a frozen arm would be seen"


def test_zero_takes_the_present_load(bench: Bench) -> None:
    bench.double.push([*PUSH_N, 0.0, 0.0, 0.0])
    assert np.linalg.norm(mean_n(bench.readings(2.0)[100:])) > 4.0
    bench.own.zero()
    assert np.linalg.norm(mean_n(bench.readings(2.0))) < 0.3
    bench.double.push([*-PUSH_N, 0.0, 0.0, 0.0])
    bench.readings(2.0)
    for _ in range(2):  # a button that is pressed twice takes the same zero
        bench.own.zero()
        bench.readings(0.1)
    assert np.linalg.norm(mean_n(bench.readings(2.0))) < 0.3


def test_the_low_pass_has_the_noise_and_the_delay_that_it_says(bench: Bench) -> None:
    found = bench.readings(20.0)[100:]
    ahead = 2.0 * np.pi * 8.0 / 100.0
    share = 1.0 - np.exp(-ahead)
    links = bench.double.T_base_links
    raw = np.linalg.pinv(jacobian_of(links).T)[:3]
    one_turn = NOISE_NM * np.sqrt((raw**2).sum(axis=1))  # torques are read in turn, at some of the reports
    sd_n = np.std([bench.double.T_base_end_effector[:3, :3] @ one.force_n[0] for one in found], axis=0)
    assert np.all(sd_n < one_turn)
    assert np.all(sd_n > np.sqrt(share / (2.0 - share)) * one_turn * 0.8)
    assert bench.own.delay_ns == pytest.approx(1e9 / (2.0 * np.pi * 8.0), rel=1e-6)


def test_learned_errors_are_taken_out() -> None:
    """Of the second order in the joints, and friction that stays until a joint has turned the other way."""
    home = np.array(JacoDouble("j2n6s300", SimulatedClock(0)).joints_deg)
    terms = pose_terms(home, home - 5.0, np.full(6, 10.0))
    assert terms.shape == (28,)
    np.testing.assert_allclose(terms[:8], [1.0, *[0.5] * 6, 0.25])
    bias_n = np.zeros((28, 3))
    bias_n[0], bias_n[1] = (1.0, 2.0, 3.0), (2.0, 0.0, 0.0)
    learned = ArmWrenchConfig(
        8.0, None, 0.0, tuple(home - 5.0), (10.0,) * 6, tuple(map(tuple, bias_n)), ((0.0, 0.0, 1.0),) * 6
    )
    bench = Bench(learned)
    R = bench.double.T_base_end_effector[:3, :3]
    np.testing.assert_allclose(-R @ mean_n(bench.readings(4.0)[100:]), [-2.0, -2.0, -3.0], atol=0.1)

    way = way_terms(np.zeros(2), [0.5 * TURN_DEG, -9.0])
    np.testing.assert_allclose(way, [0.5, -1.0])
    np.testing.assert_allclose(way_terms(way, [0.0, 0.0]), way, err_msg="it stays at rest")
    np.testing.assert_allclose(way_terms(way, [9.0, 2.0 * TURN_DEG]), [1.0, 1.0])


def test_reports_of_zero_and_poses_near_a_singularity_are_not_used() -> None:
    near = Bench(ArmWrenchConfig(least_singular=0.9))
    assert not any(one.usable for one in near.readings(0.5))
    silent = Bench(ArmWrenchConfig())
    silent.double.blur_torques(0.0, 0.0)
    assert not any(one.usable for one in silent.readings(2.0)[100:]), "exactly zero is no measurement"


def test_an_arm_without_a_force_is_refused() -> None:
    assert DRIVERS["kuka"].in_lab is not None
    clock = SimulatedClock(1_000_000_000)
    made = DRIVERS["kuka"].in_lab(KukaConfig(), None, clock)
    own = ArmWrench()
    with pytest.raises(NotConnected, match="an arm whose force it is"):
        own.open(own_thread=False)
    own.attach(made.arm)
    with made.arm.open(own_thread=False), made.arm.readings() as states:
        while not (seen := states.take()):
            clock.advance_to(clock() + 2_000_000)
            made.arm.poll(0.0)
    with pytest.raises(SettingsRefused, match="its own force, or joint torques; got none from a kr6"):
        reported_n(seen, made.arm.chain)


@pytest.mark.parametrize(
    "wrong", [{"filter_hz": 1.0}, {"middle_deg": (0.0,)}, {"half_deg": (1.0,)}, {"bias_n": ((0.0, 0.0, 0.0),)}]
)
def test_what_it_cannot_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expected"):
        ArmWrenchConfig(**wrong)  # type: ignore[arg-type]


def test_a_rig_gives_it_its_one_arm() -> None:
    text = '[devices.arm]\ndriver = "jaco"\n[devices.tip]\ndriver = "arm"\n'
    rig = parse_rig(text, "rig")
    members = [RigMember(one.name, one.driver, one.driver.make(one.config)) for one in rig.devices]
    source = RigSource(members)
    own = source.device("tip")
    assert isinstance(own, ArmWrench)
    assert own.config == dataclasses.replace(rig.devices[1].config, rate_hz=members[0].device.config.state_hz)
    assert source.latest_ns == own.delay_ns
    with pytest.raises(InputError, match='one arm, for driver = "arm"'):
        RigSource(members[1:])
