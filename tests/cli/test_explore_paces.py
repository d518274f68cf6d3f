"""`explore` through the real drivers at both paces: the same regions, pressed as hard, in less of the robot's time."""

import json
from pathlib import Path

import pytest

from deformscope.cli import main

TOUCHES = 4


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1000, 1001])
def test_a_quick_pace_finds_the_regions_of_a_careful_one(seed: int, tmp_path: Path) -> None:
    """Through the wires: in `reproduce table41` both paces feel the same by construction, here each presses by itself.
    The places are not compared: the sensors' noise falls otherwise, and the plan follows it."""
    found = {}
    for pace in ("careful", "quick"):
        told = tmp_path / f"{pace}.json"
        arguments = ["explore", "lab:two-60-150", "--seed", str(seed), "--touches", str(TOUCHES), "--pace", pace]
        arguments += ["--beta-model", "none", "--viewer", "none", "--json", str(told)]
        assert main([*arguments, "--record", str(tmp_path / f"{pace}.rrd")]) == 0
        found[pace] = json.loads(told.read_text())
    careful, quick = found["careful"], found["quick"]
    assert len(careful["touches"]) == len(quick["touches"]) == TOUCHES
    assert (quick["verdict"], quick["region_count"]) == (careful["verdict"], careful["region_count"])
    assert quick["region_count"] == quick["truth"]["region_count"] == 2
    for one, other in zip(careful["regions"], quick["regions"], strict=True):
        (low, high), (other_low, other_high) = one["interval"], other["interval"]
        assert low < other_high, "90 % intervals of a region's stiffness overlap"
        assert other_low < high, "90 % intervals of a region's stiffness overlap"
    # the press is the same, the force sensor's noise is not
    assert quick["max_force_n"] == pytest.approx(careful["max_force_n"], abs=0.5)
