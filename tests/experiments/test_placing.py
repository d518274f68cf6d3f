"""An arm that places the hand, on a simulated clock: its way, its supervisor, and what is told of faults."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import rerun as rr

from deformscope.experiments.placing import Placing, PlacingArm
from deformscope.experiments.squeeze import Squeezed, squeeze
from deformscope.experiments.squeeze_features import SqueezeGeometry
from deformscope.experiments.squeeze_frames import ObservedRecorder
from deformscope.experiments.squeezing_hand import SqueezingHand, observer_of
from deformscope.lab.carried_hand import CarriedHandLab
from deformscope.lab.container_setup import container_lab
from deformscope.log.squeeze.results import prepare_squeeze_results
from deformscope.recording.recorder import Recorder
from deformscope.robot.checks import Preflight
from deformscope.robot.squeeze_plan import RandomGrasp, draw_grasps, grasp_at
from deformscope.rows import differing, from_components, to_components
from deformscope.session import RigExperiment, run

S = 1_000_000_000


class Trial:
    """One squeeze that an arm places. found: what came of it; phases: that began; on_phase: called as they do"""

    def __init__(self, arm: str = "jaco", container: str = "cylinder-03", seed: int = 4) -> None:
        made = container_lab("rice", container, seed=seed, camera_hz=5.0, arm=arm)
        assert isinstance(made.lab, CarriedHandLab)
        self.setup, self.lab, self.seed, self.found = made.setup, made.lab, seed, Squeezed()
        self.phases: list[str] = []
        self.on_phase: Callable[[str], None] = lambda phase: None
        self.preflight: Preflight | None = None

    def permit(self, preflight: Preflight) -> RigExperiment[None]:
        self.preflight = preflight
        yield from ()

    def go(self, grasp: RandomGrasp | None = None) -> Squeezed:
        setup = self.setup
        with setup.open_source() as source:
            observer = observer_of(setup, source)
            self.hand = hand = SqueezingHand(setup, source, observer)
            hand.on_phase = self._began
            hand.arm = arm = PlacingArm(setup, source, hand.begin, hand.cycled)
            geometry = SqueezeGeometry.of(setup)
            placing = Placing(setup, observer.frames, geometry, arm, self.seed, self.found, self.permit, grasp)
            experiment = squeeze(
                setup.clock,
                observer,
                geometry,
                self.found,
                placed=placing.before(),
                withdrawn=placing.after(),
            )
            run(source, experiment, ObservedRecorder(Recorder(None), observer), hand)
            hand.halt("the test is over")
        return self.found

    def at(self, phase: str, action: Callable[[], None], later_s: float = 0.3) -> None:
        """Do something so long after a phase has begun."""

        def began(name: str) -> None:
            if name == phase:
                self.lab.schedule(self.lab.clock() + round(later_s * S), action)

        self.on_phase = began

    def _began(self, phase: str) -> None:
        self.phases.append(phase)
        self.on_phase(phase)


@pytest.fixture(scope="module")
def good() -> Trial:
    trial = Trial()
    trial.go()
    return trial


def test_the_arm_brings_the_hand_squeezes_and_withdraws(good: Trial) -> None:
    found = good.found
    assert found.stop is None
    assert found.withdrawal is None
    assert good.phases[:3] == ["pre-shape", "travel", "approach"]
    assert good.phases[-2:] == ["open", "retreat"]
    assert found.placement is not None
    assert found.placement.reached == "retreat"
    assert found.placement.refused[-1] == ""
    assert all(found.placement.refused[:-1])
    assert [one.change and one.change.kind for one in found.sightings] == [None, "stands", "stands"]
    assert found.features is not None
    assert found.features.features.vision is not None
    assert good.preflight is not None
    assert good.preflight.passed


def test_what_is_found_is_where_it_stands(good: Trial) -> None:
    fit = good.found.sightings[0].fit
    assert fit is not None
    after = good.found.sightings[-1].fit
    assert after is not None
    truth = good.lab.simulated.T_table_container[:3, 3]
    assert (np.abs(after.center_m - truth) < 4.0 * np.append(after.deviation_m[:2], 1e-3)).all()


def test_the_pads_press_where_the_grasp_was_drawn(good: Trial) -> None:
    """By the simulated container, which nobody but the laboratory knows."""
    placed = good.found.placement
    assert placed is not None
    nominal, true = placed.T_hand_container, good.lab.simulated.world.T_hand_container
    np.testing.assert_allclose(true[:3, 3], nominal[:3, 3], atol=0.004)
    assert np.degrees(np.arccos(np.clip(true[:3, 2] @ nominal[:3, 2], -1.0, 1.0))) < 1.0


def test_grasps_are_the_same_for_the_same_seed(good: Trial) -> None:
    placed = good.found.placement
    assert placed is not None
    drawn = draw_grasps(good.setup.container, good.setup.squeeze, good.seed, len(placed.refused))
    np.testing.assert_array_equal(placed.tried, [(one.along_m, one.tilt_deg, one.turn_deg) for one in drawn])
    others = draw_grasps(good.setup.container, good.setup.squeeze, good.seed + 1, len(placed.refused))
    assert others[0].along_m != drawn[0].along_m


def test_something_on_the_way_stops_the_arm_and_it_backs_off() -> None:
    trial = Trial("kuka")
    trial.at("approach", lambda: trial.lab.simulated.injected_n.__setitem__(0, 2.5))
    found = trial.go()
    assert found.stop is not None
    assert found.stop.kind == "force above the soft stop"
    assert found.stop.stands
    assert "back off" in trial.phases
    assert "close" not in trial.phases
    assert found.placement is not None
    assert found.placement.reached == "approach"
    assert found.features is None


def test_a_hard_push_stops_it_where_it_is() -> None:
    trial = Trial("kuka")
    trial.at("travel", lambda: trial.lab.simulated.injected_n.__setitem__(1, 9.0))
    found = trial.go()
    assert found.stop is not None
    assert found.stop.kind == "force above the hard stop"
    assert "back off" not in trial.phases
    before = trial.lab.simulated.T_table_hand
    trial.lab.wait_until(trial.lab.clock() + S)
    np.testing.assert_allclose(trial.lab.simulated.T_table_hand, before, atol=1e-9)


def test_an_arm_whose_controller_holds_the_last_value_is_stopped() -> None:
    trial = Trial("jaco")
    assert trial.lab.functions is not None
    functions = trial.lab.functions
    trial.at("travel", lambda: setattr(functions, "frozen", True))
    found = trial.go()
    assert found.stop is not None
    assert found.stop.kind == "arm frozen"
    assert "close" not in trial.phases


def test_a_person_stops_it_on_the_way() -> None:
    trial = Trial("kuka")
    trial.at("travel", lambda: trial.hand.ask_to_stop("Ctrl-C"))
    found = trial.go()
    assert found.stop is not None
    assert found.stop.kind == "a person asked"
    assert "approach" not in trial.phases


def test_without_a_container_or_an_image_nothing_moves() -> None:
    gone, blind = Trial("kuka"), Trial("kuka")
    gone.lab.simulated.shift(3.0, 0.0)
    blind.lab.simulated.blind = True
    for trial in (gone, blind):
        found = trial.go()
        assert found.stop is not None
        assert found.stop.kind == "container not found"
        assert "nothing that is 4 cm high" in found.stop.reason
        assert "travel" not in trial.phases


def test_out_of_reach_every_grasp_has_its_reason() -> None:
    trial = Trial("kuka")
    trial.lab.simulated.shift(0.3, 0.35)
    found = trial.go()
    assert found.stop is not None
    assert found.stop.kind == "no grasp is reached"
    assert found.placement is not None
    assert len(found.placement.refused) == 40
    assert all(found.placement.refused)
    assert found.placement.reached == ""
    assert "travel" not in trial.phases


@pytest.mark.parametrize("fault", ["shift", "topple"])
@pytest.mark.slow
def test_a_container_that_moved_while_the_hand_came_is_noticed(fault: str) -> None:
    trial = Trial("kuka")
    simulated = trial.lab.simulated
    action = (lambda: simulated.shift(0.012, 0.0)) if fault == "shift" else (lambda: simulated.topple((0.3, 1.0)))
    trial.at("travel", action)
    found = trial.go()
    assert found.stop is not None
    assert found.stop.kind.startswith("container ")
    assert "close" not in trial.phases


def test_a_hand_that_is_led_into_the_container_topples_or_moves_it() -> None:
    trial = Trial("kuka")
    simulated = trial.lab.simulated
    hand = simulated.T_table_hand
    there = simulated.T_table_container.copy()
    there[:3, 3] = hand[:3, 3] + 0.1 * hand[:3, 2] + 0.03 * hand[:3, 0]  # a finger is within
    simulated.place(there)
    simulated.meet()
    assert simulated.toppled


def test_a_grasp_that_a_person_chose_is_taken() -> None:
    trial = Trial("kuka", "box-03", 3)
    chosen = grasp_at(trial.setup.container, trial.setup.squeeze, 0.005, 1.0, 0.0)
    trial.at("travel", lambda: trial.hand.ask_to_stop("enough"))
    found = trial.go(chosen)
    assert found.placement is not None
    assert found.placement.seed == -1
    assert found.placement.along_m == 0.005
    assert found.placement.refused == ("",)


def test_what_is_recorded_is_read_again_as_it_was_and_is_shown(good: Trial) -> None:
    results = [*good.found.sightings, good.found.placement]
    for result in results:
        again = from_components(type(result), to_components(result))
        assert differing(result, again) is None
    rec = rr.RecordingStream("deformscope-test")
    memory = rec.memory_recording()
    prepare_squeeze_results(results, 0, None).send(rec)
    rec.flush(timeout_sec=10.0)
    assert memory.num_msgs() > len(results)
