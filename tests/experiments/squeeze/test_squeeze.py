"""A squeeze on a simulated clock: its phases, its events, and that whatever goes wrong the hand stands."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from deformscope.experiments.squeeze.features import SqueezeGeometry, trial_features
from deformscope.experiments.squeeze.frames import ObservedRecorder
from deformscope.experiments.squeeze.placing import Squeezed, squeeze
from deformscope.experiments.squeeze.squeezing_hand import SqueezingHand, observer_of
from deformscope.recording.recorder import Recorder
from deformscope.robot.squeeze_robot import SQUEEZE_PERIOD_NS
from deformscope.robot.squeeze_supervisor import SqueezeFault, gap_m
from deformscope.session import run
from tests.cases import each_once, slow
from tests.experiments.toy_squeeze import ToySqueeze, closing, limits, spoil_arrays

BEFORE_A = (1.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)
MS = 1_000_000


class Session:
    """One squeeze. found: what came of it; phases: that began; on_phase, on_cycle: called as they do"""

    def __init__(self, lab: ToySqueeze) -> None:
        self.lab, self.found = lab, Squeezed()
        self.on_phase: Callable[[str], None] = lambda phase: None
        self.on_cycle: Callable[[SqueezingHand], None] = lambda hand: None
        self.phases: list[str] = []

    def go(self) -> Squeezed:
        setup = self.lab.setup
        with setup.open_source() as source:
            observer = observer_of(setup, source)
            self.frames = observer.frames
            hand = SqueezingHand(setup, source, observer, lambda: self.on_cycle(hand))

            def began(phase: str) -> None:
                self.phases.append(phase)
                self.on_phase(phase)

            hand.on_phase = began
            self.geometry = SqueezeGeometry.of(setup)
            run(
                source,
                squeeze(setup.clock, observer, self.geometry, self.found),
                ObservedRecorder(Recorder(None), observer),
                hand,
            )
            self.hand = hand
        return self.found


@pytest.fixture(scope="module")
def good() -> Session:
    session = Session(ToySqueeze(camera=True))
    session.go()
    return session


def test_it_pre_shapes_closes_holds_and_opens(good: Session) -> None:
    assert good.phases == ["pre-shape", "air", "close", "squeeze", "hold", "open"]
    assert good.found.stop is None
    assert limits(good.lab) == BEFORE_A
    angles = [axis.position_deg for axis in good.lab.hand_double.motion.axes]
    np.testing.assert_allclose(angles, good.lab.shape.open_deg, atol=0.01)
    assert angles[3] == -70.0


def test_events_are_within_two_sample_periods_of_the_truth(good: Session) -> None:
    truth, events = good.lab.truth, good.found.features.events
    assert abs(events.first_ns - truth.contact_ns) <= 2e9 * events.tactile_period_s
    assert abs(events.steady_ns - truth.steady_ns) <= 2e9 * max(events.tactile_period_s, events.hand_period_s)
    assert events.first_interval_ns[0] <= truth.contact_ns <= events.first_interval_ns[1]
    assert events.steady_interval_ns[0] <= truth.steady_ns <= events.steady_interval_ns[1]


def test_its_features_are_of_the_steady_state(good: Session) -> None:
    found = good.found.features
    tactile = found.modalities["tactile"]
    assert tactile.shape == (72,)
    frame = next(one for one in good.frames.tactile if one.stamp.host_ns >= found.events.steady_ns)
    np.testing.assert_array_equal(tactile[:36], frame.counts[84 : 84 + 36])
    assert found.modalities["vision"].shape == (3721,)
    assert found.modalities["vision_small"].shape == (121,)
    assert all(one.container.good for one in found.tracked)


def test_the_same_frames_give_the_same_features_to_the_last_bit(good: Session) -> None:
    again, before = trial_features(good.frames, good.geometry), good.found.features
    for name, values in before.modalities.items():
        np.testing.assert_array_equal(again.modalities[name], values)


def test_the_setup_goes_through_json(good: Session) -> None:
    told = good.geometry.as_json()
    assert SqueezeGeometry.from_json(told).as_json() == told


def stopped(session: Session, kind: SqueezeFault) -> None:
    """The hand stands, its limits are as they were, and the reason is known."""
    found = session.found
    assert found.stop.kind == kind
    assert found.features is None
    assert found.stop.stands
    assert found.stop.restored
    assert not closing(session.lab)
    assert limits(session.lab) == BEFORE_A


class Watched(ToySqueeze):
    """Knows when the fingers last closed."""

    closed_ns = 0

    def _look(self) -> None:
        before = getattr(self, "_last", self.angle())
        super()._look()
        self._last = self.angle()
        if self._last > before + 1e-6:
            self.closed_ns = self.clock()


def test_a_saturated_array_ends_it_within_two_periods() -> None:
    lab = Watched(stiffness_pa_deg=10_000.0, gives_deg=8.0)
    session = Session(lab)
    session.go()
    stopped(session, SqueezeFault.SATURATED)
    assert lab.closed_ns - session.found.stop_ns <= 2 * SQUEEZE_PERIOD_NS
    assert lab.angle() == pytest.approx(lab.shape.open_deg[1], abs=0.01)  # and it lets go


def test_over_squeezing_ends_it_within_two_periods() -> None:
    lab = Watched(gives_deg=40.0, stiffness_pa_deg=1.0)
    lab.squeeze = dataclasses.replace(lab.squeeze, over_squeeze_m=0.01, onset_counts=5.0)
    session = Session(lab)
    session.go()
    stopped(session, SqueezeFault.OVER_SQUEEZED)
    assert lab.closed_ns - session.found.stop_ns <= 2 * SQUEEZE_PERIOD_NS


def test_a_person_who_asks_stops_it_within_two_periods_and_it_stays_as_it_is() -> None:
    lab = Watched()
    session = Session(lab)
    asked_ns: list[int] = []

    def cycle(hand: SqueezingHand) -> None:
        if session.phases[-1:] == ["squeeze"]:
            asked_ns.append(lab.clock())
            hand.ask_to_stop("Ctrl-C")

    session.on_cycle = cycle
    session.go()
    stopped(session, SqueezeFault.ASKED)
    assert lab.closed_ns - asked_ns[0] <= 2 * SQUEEZE_PERIOD_NS
    assert lab.angle() > lab.contact_deg  # nothing moves any more


def test_a_hand_that_is_lost_is_stopped_once_it_is_back() -> None:
    """While its cable is out nobody can stop it; it presses with the low current alone."""
    lab = Watched(gives_deg=3.0)
    session = Session(lab)

    def began(phase: str) -> None:
        if phase == "squeeze":
            lab.hand_double.silent = True
            lab.at.append((lab.clock() + 900 * MS, speak))

    def speak() -> None:
        lab.hand_double.silent = False

    session.on_phase = began
    session.go()
    stopped(session, SqueezeFault.HAND_LOST)


def test_a_hand_that_stays_lost_is_reported_as_such() -> None:
    lab = ToySqueeze()
    session = Session(lab)
    session.on_phase = lambda phase: lab.hand_wire.unplug() if phase == "squeeze" else None
    found = session.go()
    assert found.stop.kind == SqueezeFault.HAND_LOST
    assert not found.stop.stands
    assert not found.stop.restored
    assert "may still press" in found.stop.advice


def test_lost_arrays_end_it() -> None:
    lab = Watched()
    session = Session(lab)
    session.on_phase = lambda phase: lab.dsa_wire.unplug() if phase == "squeeze" else None
    session.go()
    stopped(session, SqueezeFault.TACTILE_LOST)
    assert lab.closed_ns - session.found.stop_ns <= 2 * SQUEEZE_PERIOD_NS


def test_nothing_between_the_fingers_is_no_trial() -> None:
    lab = ToySqueeze(gives_deg=60.0, stiffness_pa_deg=0.0)
    lab.squeeze = dataclasses.replace(lab.squeeze, contact_timeout_s=1.0)
    session = Session(lab)
    session.go()
    stopped(session, SqueezeFault.NO_CONTACT)


def test_fingertips_that_are_touched_before_are_refused() -> None:
    lab = ToySqueeze()
    lab.contact_deg = lab.shape.open_deg[1] - 5.0
    session = Session(lab)
    session.go()
    stopped(session, SqueezeFault.TOUCHED_BEFORE)


def test_a_finger_that_cannot_reach_its_pre_shape_is_refused() -> None:
    lab = ToySqueeze()
    lab.hand_double.obstruct(3, low_deg=-65.0)
    session = Session(lab)
    session.go()
    stopped(session, SqueezeFault.PRESHAPE)


DEAD = ["air dead", "close dead", "squeeze dead", "hold dead", "squeeze frozen", "hold frozen"]


@pytest.mark.parametrize(("when", "pads"), each_once(DEAD, [((0, 2), None), ((2,), 11_520.0)]))
def test_a_finger_that_is_held_while_its_array_reads_nothing_or_repeats_itself_is_no_trial(
    when: str, pads: tuple[tuple[int, ...], float | None]
) -> None:
    (phase, fault), (fingers, bytes_per_s) = when.split(), pads
    lab = Watched(bytes_per_s=bytes_per_s)
    lab.squeeze = dataclasses.replace(lab.squeeze, hold_s=0.6)
    session, struck_ns = Session(lab), list[int]()

    def began(now: str) -> None:
        if now == phase:
            spoil_arrays(lab.dsa_double, fault, fingers)
            struck_ns.append(lab.clock())

    session.on_phase = began
    session.go()
    stopped(session, SqueezeFault.CONTRADICTED)
    assert f"finger {fingers[0]}" in session.found.stop.reason
    held_ns = max(lab.truth.steady_ns, struck_ns[0])
    assert session.found.stop_ns - held_ns < 0.8e9  # not after the 12 s in which there may be no contact
    assert lab.angle() == pytest.approx(lab.shape.open_deg[1], abs=0.01)  # and it lets go


def test_the_reason_says_where_which_finger_is_held_and_what_its_array_reads() -> None:
    lab = ToySqueeze()
    session = Session(lab)
    session.on_phase = lambda phase: spoil_arrays(lab.dsa_double, "dead", (2,)) if phase == "close" else None
    found = session.go()
    held = f"finger 2 is driven, but stays at {lab.contact_deg + lab.gives_deg:.1f} deg; its array reads 0 counts"
    assert held in found.stop.reason


def test_fingers_that_meet_each_other_have_nothing_between_them() -> None:
    lab = ToySqueeze(gives_deg=60.0, stiffness_pa_deg=0.0)
    while gap_m(np.array(lab.shape.open_deg) + np.isin(range(7), (1, 5)) * lab.gives_deg, (0, 2)) < 0.0215:
        lab.gives_deg -= 0.1
    lab.obstruct()
    session = Session(lab)
    session.go()
    stopped(session, SqueezeFault.NO_CONTACT)


def test_a_hand_that_a_busy_computer_left_alone_for_a_while_contradicts_nothing() -> None:
    """Its driver sets the speed to 0 where no command comes: fingers in the air that stand then are not held."""
    lab = ToySqueeze()
    session, left = Session(lab), list[int]()

    def cycle(hand: SqueezingHand) -> None:
        if session.phases[-1:] == ["close"] and not left and lab.angle() > lab.shape.open_deg[1] + 4.0:
            left.append(1)
            lab.wait_until(lab.clock() + 600 * MS)

    session.on_cycle = cycle
    found = session.go()
    assert left
    assert found.stop is None
    assert found.features is not None


@pytest.mark.parametrize("speed_deg_s", [slow(0.5), 20.0])
def test_a_container_that_hardly_presses_contradicts_nothing_at_any_speed(speed_deg_s: float) -> None:
    lab = ToySqueeze(stiffness_pa_deg=60.0)
    lab.squeeze = dataclasses.replace(
        lab.squeeze, speed_deg_s=speed_deg_s, contact_timeout_s=60.0, still_timeout_s=60.0, still_deg=0.1
    )
    found = Session(lab).go()
    assert found.stop is None
    assert found.features is not None
