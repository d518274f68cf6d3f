"""What lies between frames and estimates of `explore` is recorded as it was computed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from deformscope import open_recording
from deformscope.experiments.measured import SetupGeometry
from deformscope.frames import ArmFrame, DepthFrame
from deformscope.recording.items import read_items, read_results, read_series
from deformscope.recording.reader import Replay
from deformscope.stages.map.exploration import SurfaceEstimate, TouchEstimate
from deformscope.stages.map.measured import TouchFrames
from deformscope.stages.map.perception import ForcePose, LookPerception, TouchPerception
from deformscope.stages.see.pixel_labels import PixelLabel
from deformscope_drivers.arm.kinematics import rotation_from_euler_xyz, transform
from tests.cli.recorded import Explore


def of(path: Path, kind: type) -> list[Any]:
    return [row.item for row in read_results(path, (kind,), trust=True)]


@pytest.mark.slow
def test_labels_are_a_partition_of_the_recorded_depth_images(explore: Explore) -> None:
    path = explore().record
    depth = {one.stamp.host_ns: one.depth for one in read_items(path, trust=True, kinds=(DepthFrame,))}
    (look,), (touch,) = of(path, LookPerception), of(path, TouchPerception)
    (surface,) = of(path, SurfaceEstimate)
    for perception in (look, touch):
        masks = perception.masks
        for image, when in enumerate(masks.depth_ns.tolist()):
            label = masks.decode(image)
            np.testing.assert_array_equal(label == PixelLabel.NOTHING_SEEN, depth[when] == 0)
            assert set(np.unique(label)) <= set(PixelLabel)
            assert np.count_nonzero(label == PixelLabel.USED) > 100
    assert look.points == len(surface.points_m)  # none of them was a misfit
    assert any((touch.masks.decode(i) == PixelLabel.ROBOT_CAPSULE).any() for i in range(len(touch.masks.depth_ns)))
    assert of(path, TouchFrames)[0].depth_ns.tolist() == touch.masks.depth_ns.tolist()


def test_force_and_pose_are_the_forces_rows_with_the_arm_between_its_states(explore: Explore) -> None:
    path = explore().record
    (felt,) = read_series(path, ForcePose, trust=True)
    (used,) = of(path, TouchFrames)
    np.testing.assert_array_equal(felt.host_ns, used.wrench_ns)
    table = open_recording(path).table("exploration/force_pose")
    np.testing.assert_array_equal(table.column("host_ns"), felt.host_ns)
    assert table.schema.names[-9:-3] == [
        *(f"force_{axis}_n" for axis in "xyz"),
        *(f"position_{axis}_m" for axis in "xyz"),
    ]
    np.testing.assert_array_equal(np.column_stack(table.columns[-9:]), felt.values)
    placement = SetupGeometry.from_json(Replay(path, trust=True).settings["setup"]).placement
    states = {one.stamp.host_ns: one for one in read_items(path, trust=True, kinds=(ArmFrame,))}
    times = sorted({*used.arm_ns.tolist(), *used.pose_ns.tolist(), used.end_ns})
    poses = []
    for when in times:
        one = states[when]
        T = transform(rotation_from_euler_xyz(*one.rotation_rad.tolist()), one.position_m)
        poses.append(placement.T_surface_center(T))
    T = np.array(poses)
    since = np.clip(felt.host_ns, times[0], times[-1]) - times[0]
    slerp = Slerp(np.array(times) - times[0], Rotation.from_matrix(T[:, :3, :3]))(since)
    assert (Rotation.from_rotvec(felt.values[:, 6:]).inv() * slerp).magnitude().max() < 1e-7
    for axis in range(3):
        expected = np.interp(since, np.array(times) - times[0], T[:, axis, 3])
        np.testing.assert_allclose(felt.values[:, 3 + axis], expected, atol=1e-12)
    assert np.linalg.norm(felt.values[:, :3], axis=1).max() > 2.0


def test_the_error_over_beta_has_the_estimate_among_what_was_tried(explore: Explore) -> None:
    path = explore().record
    (perception,), (touch,) = of(path, TouchPerception), of(path, TouchEstimate)
    assert perception.stiffness.log_stiffness == pytest.approx(np.log(touch.stiffness_n_per_mm), abs=0.2)
    assert perception.estimate == touch.beta
    assert touch.beta in perception.error.parameter
    assert perception.error_m == perception.error.aee[perception.error.parameter == touch.beta]


def test_the_frames_are_one_tree(explore: Explore) -> None:
    parents = {}
    for chunk in Replay(explore().record, trust=True).chunks("/display/perception/frames/**"):
        batch = chunk.to_record_batch()
        frames = (batch.column(f"Transform3D:{end}_frame").to_pylist() for end in ("child", "parent"))
        parents |= {child: parent for (child,), (parent,) in zip(*frames, strict=True)}
    assert parents.keys() == {"world", "surface", "camera", "arm_base", "tool"}
    for name in parents:
        way = [name]
        while way[-1] in parents:
            way.append(parents[way[-1]])
            assert len(way) < 9
        assert way[-1] == "tf#/"
