"""Faults named on the command line strike once, in their touch, in a phase and at a moment that the seed draws."""

import itertools

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.faults import ARM, CAMERA, FORCE, WITHIN_S, FaultAt, FaultsToCome, Injected
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot.touch import Phase
from deformscope_drivers.depth_camera.synthetic import View
from studies.springy_foam import SpringyFoam

PHASES = (Phase.TRAVEL, Phase.TARE, Phase.APPROACH, Phase.PRESS, Phase.DWELL, Phase.RETREAT)


def lab() -> TouchLab:
    tool = Tool()
    foam = SpringyFoam(60e3, (0.3, 0.2, 0.08), (0.0, 0.0, 1.0), tool)
    return TouchLab(foam, tool=tool, view=lambda _: View(np.full((2, 2), 0.8)))


def struck(fault: FaultAt, seed: int) -> tuple[int, Phase, int]:
    """In which touch and phase, and how long after its begin [ns]; phases of 3 s, three touches."""
    bench = lab()
    faults = FaultsToCome(bench, [fault], seed)
    for touch, phase in itertools.product((1, 2, 3), PHASES):
        began_ns = bench.clock()
        faults.phase_began(phase, touch)
        bench.wait_until(began_ns + 3_000_000_000)
        if faults.struck:
            ((which, at_ns),) = faults.struck
            assert which == fault
            assert faults.waiting == ()
            return touch, phase, at_ns - began_ns
    raise AssertionError("it never struck")


def test_every_fault_has_a_word_and_belongs_to_a_device() -> None:
    assert sorted((*FORCE, *ARM, *CAMERA)) == sorted(Injected)
    assert len({kind.word for kind in Injected}) == len(Injected)
    assert Injected.FORCE_SILENT.word == "force-silent"


def test_a_fault_strikes_once_where_the_seed_says() -> None:
    fault = FaultAt(Injected.FORCE_FROZEN, 2)
    found = [struck(fault, seed) for seed in range(6)]
    assert {touch for touch, _, _ in found} == {2}
    assert len({phase for _, phase, _ in found}) > 2
    assert all(0 <= delay_ns <= 1e9 * WITHIN_S[phase] for _, phase, delay_ns in found)
    assert struck(fault, 3) == found[3]


def test_a_fault_does_what_it_says() -> None:
    bench = lab()
    faults = FaultsToCome(bench, [FaultAt(Injected.FORCE_SILENT, 1), FaultAt(Injected.STORM, 2)], 0)
    for phase in PHASES:
        faults.phase_began(phase, 1)
    bench.wait_until(bench.clock() + 3_000_000_000)
    assert bench.sensor_double.silent
    assert bench.wire.spoiled == 0.0
    assert [fault.injected for fault in faults.waiting] == [Injected.STORM]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("force-silence@1", "force-silent@1"),
        ("volcano@1", "camera-frozen"),
        ("storm", "storm@1"),
        ("storm@0", "from 1 to 4"),
        ("storm@5", "from 1 to 4"),
        ("storm@x", "from 1 to 4"),
        ("", "a fault out of"),
    ],
)
def test_what_is_no_fault_is_refused_with_the_kinds(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        FaultAt.parse(text, 4)


@pytest.mark.parametrize("kind", Injected)
def test_a_fault_is_read(kind: Injected) -> None:
    assert FaultAt.parse(f"{kind.word}@3", 4) == FaultAt(kind, 3)
