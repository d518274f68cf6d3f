"""A rig file that says no thickness: it comes from the table beside the foam, or is not known, and says so."""

from dataclasses import replace

import numpy as np
import pytest

from deformscope.experiments.explore.explorer import UnseenSurface
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import AsMeasured
from deformscope.experiments.measured import FrameData, Looked, SetupGeometry
from deformscope.lab.depth_view import DepthView
from deformscope.lab.ray_camera import FOAM
from deformscope.lab.scenes import Scene, built_in
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.robot.placement import Placement
from deformscope.robot.readings import ArmSample
from deformscope.robot.setup import CameraView
from deformscope.stages.map.measured import LookFrames, SurfaceMeasurement
from deformscope.stages.poke.contact import ArmCompliance
from studies.kinect import observed_m
from studies.reproduce.surface_robot import LabRobot
from tests.cases import Patch, slow
from tests.cli.quick_scene import use_coarse_maps

UNSTATED = ExploreOptions(beta_model="none", thickness_stated=False, seed=1000)
AWAY = np.eye(4)
AWAY[2, 3] = 2.0


def seen(scene: Scene, hidden: bool) -> SurfaceMeasurement:
    """Through one depth image; hidden: nothing but foam gives a depth, as where a frame or cloth is around it."""
    view = DepthView(scene)
    exact = view.render()
    depth_m = observed_m(exact, np.random.default_rng(1000))
    if hidden:
        depth_m = depth_m * (exact.seen == FOAM)
    lens = view.intrinsics
    focal, center = (lens.fx_px, lens.fy_px), (lens.cx_px, lens.cy_px)
    camera = CameraView(focal, center, T_surface_camera=view.T_world_camera)
    geometry = SetupGeometry(scene.size_m, Placement(np.eye(4), Tool()), Workspace(), camera, 0.0, 0.0)
    used = LookFrames("depth", np.array([1]), "arm", 1, "placed", focal, center)
    data = FrameData({1: depth_m.astype(np.float32)}, {1: ArmSample(1, AWAY, (), 0)}, {})
    return geometry.surface(Looked(used, data), UNSTATED)


@pytest.mark.parametrize("name", ["homogeneous-60", slow("wedge")])
def test_thickness_is_taken_from_the_table_beside_the_foam(name: str) -> None:
    scene = built_in(name, 1000)
    surface = UnseenSurface(scene.size_m, UNSTATED, ArmCompliance()).look(seen(scene, hidden=False)).surface.estimate
    assert surface.layer_m == pytest.approx(scene.thickness_m, abs=2e-3)
    assert 0.0 < surface.layer_sd_m < 3e-3


@pytest.mark.slow
def test_where_no_table_is_seen_there_is_a_stiffness_but_no_modulus_and_no_beta_of_layers(monkeypatch: Patch) -> None:
    use_coarse_maps(monkeypatch)
    scene = built_in("homogeneous-60", 1000)
    robot = LabRobot(scene, UNSTATED, sees=False)
    explorers = [
        UnseenSurface(scene.size_m, options, robot.arm).look(seen(scene, hidden))
        for options, hidden in ((UNSTATED, False), (replace(UNSTATED, beta_model="volume"), True))
    ]
    made = robot.touch(explorers[0].approached(np.array([0.3, 0.2]), AsMeasured(scene.size_m)))
    after = [explorer.touch(made) for explorer in explorers]
    known, unknown = (estimate for estimate, *_ in after)
    assert known.stiffness_n_per_mm == pytest.approx(unknown.stiffness_n_per_mm)
    assert known.modulus_pa == pytest.approx(scene.pieces[0].modulus_pa, rel=0.15)
    assert known.modulus_interval_pa is not None
    assert (unknown.modulus_pa, unknown.modulus_interval_pa) == (None, None)
    assert unknown.beta is None
    assert "thickness is not known" in unknown.beta_verdict
    assert [maps is not None and maps.level_modulus_pa is None for _, _, maps, _ in after] == [False, True]
