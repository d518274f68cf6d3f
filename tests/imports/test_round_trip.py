"""An exploration that was exported and imported: its touches are found again, and are what they were."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from deformscope.cli import main
from deformscope.experiments.explore.explore import AtOnce, Exploration, RecordedRobot, explore, within_loop
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.recorded_touches import frame_inputs
from deformscope.experiments.explore.stage_executor import exploration_stages
from deformscope.experiments.measured import SetupGeometry
from deformscope.recording.items import read_results
from deformscope.recording.reader import Replay
from deformscope.rows import differing
from deformscope.session import run
from deformscope.stages.map.exploration import MapEstimate, TouchEstimate
from deformscope.stages.map.measured import LookFrames, TouchFrames
from tests.cli.quick_scene import _Layers, use_coarse_maps
from tests.imports.test_importing import brought_back, inspected

ESTIMATES = (TouchEstimate, MapEstimate)


def results_of(path: Path, *kinds: type) -> list[Any]:
    return [row.item for row in read_results(path, kinds)]


class Kept:
    """A recorder that keeps estimates."""

    def __init__(self) -> None:
        self.results: list[Any] = []

    def write(self, items: object) -> None:
        self.results += [one for one in getattr(items, "results", ()) if isinstance(one, ESTIMATES)]


def sections(setup: dict[str, Any], look: LookFrames, thickness_m: float) -> str:
    """Where all was, as a map has it."""
    tool = {name: value for name, value in setup["tool"].items() if value is not None}
    tool |= {"compliance_m_per_n": setup["compliance_m_per_n"], "compliance_sd": setup["compliance_sd"]}
    T_arm_camera = np.array(setup["T_base_surface"]) @ np.array(setup["camera"]["T_surface_camera"])
    surface = {"size_m": setup["size_m"], "thickness_m": thickness_m, "T_arm_surface": setup["T_base_surface"]}
    camera = {"focal_px": list(look.focal_px), "center_px": list(look.center_px), "T_arm_camera": T_arm_camera.tolist()}
    every = {"tool": tool, "surface": surface, "camera": camera}
    return "".join(
        f"[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in section.items())
        for name, section in every.items()
    )


@pytest.mark.slow
@pytest.mark.parametrize("to", ["parquet", "mcap"])
def test_the_estimator_finds_the_same_touches_in_what_was_exported_and_imported(
    to: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if to == "mcap":
        pytest.importorskip("mcap_ros2")
        pytest.importorskip("rosbags")
    use_coarse_maps(monkeypatch)
    monkeypatch.setattr("deformscope.lab.scene_lab.slab_world", _Layers)
    made = tmp_path / "made.rrd"
    flags = ["--beta-model", "none"]
    assert main(["explore", "lab:two-60-150", "--touches", "2", "--clean", *flags, "--record", str(made)]) == 0
    again = brought_back(made, to, tmp_path)

    settings, named = Replay(made).settings, results_of(made, LookFrames, TouchFrames)
    options = msgspec.convert(settings["explore"], ExploreOptions)
    geometry = SetupGeometry.from_json(settings["setup"])
    kept = Kept()
    stages = within_loop(exploration_stages(geometry, options, None))
    run([], explore(lambda: 0, stages, Exploration()), kept, AtOnce(RecordedRobot(frame_inputs(again, named))))
    before = results_of(made, *ESTIMATES)
    assert len(before) == len(kept.results) == 4
    for one, now in zip(before, kept.results, strict=True):
        assert differing(one, now, ("truth_labels", "iou", "boundary_m")) is None

    map_file = tmp_path / "map.toml"
    source = next((tmp_path / to).glob("*.mcap")) if to == "mcap" else tmp_path / to
    map_file.write_text(inspected(source) + sections(settings["setup"], named[0], options.thickness_m))
    placed, found = tmp_path / "placed.rrd", tmp_path / "found.rrd"
    assert main(["import", str(source), "--map", str(map_file), "--record", str(placed)]) == 0
    assert main(["explore", str(placed), *flags, "--record", str(found)]) == 0
    touches, first = results_of(found, TouchEstimate), results_of(made, TouchEstimate)
    assert len(touches) == len(first)
    for one, now in zip(first, touches, strict=True):
        np.testing.assert_allclose(now.xyz_m, one.xyz_m, atol=1e-4)
        np.testing.assert_allclose(now.stiffness_n_per_mm, one.stiffness_n_per_mm, rtol=0.005)
        np.testing.assert_allclose(now.stiffness_interval, one.stiffness_interval, rtol=0.005)
    assert main(["replay", str(found)]) == 0
