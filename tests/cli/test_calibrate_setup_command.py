"""`calibrate tip|place|camera|force|time` from files: what they find, and what they write into the rig file."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.cli import main
from deformscope.experiments.rig.rig_calibration import ForceReadings, PushedTip
from deformscope.rig.rig_file import load_rig, parse_rig
from deformscope.robot.placement import Placement
from deformscope.runs.calibration_tasks import solve_force
from deformscope.runs.commissioning import commissioning_steps, next_step
from deformscope.stages.setup.transform import rigid
from tests.verified import verify_here

RIG = """# mine
[devices.arm]
driver = "jaco"
[devices.tip]
driver = "optoforce"
port = "/dev/ttyUSB0"
[devices.depth]
driver = "depth_camera"
[tool]
radius_m = 0.01   # by caliper
"""
TIP_M = np.array([0.001, -0.002, 0.1])
DOWN = Rotation.from_euler("x", 180, degrees=True)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


def calibrate(what: str, rig: Path, *more: str, **arrays: object) -> tuple[int, dict[str, object]]:
    file, found = rig.with_suffix(".npz"), rig.with_suffix(".json")
    np.savez(file, **arrays)  # type: ignore[arg-type]
    status = main(["calibrate", what, str(rig), "--measured", str(file), "--json", str(found), *more])
    return status, json.loads(found.read_text()) if status == 0 else {}


def tilts() -> np.ndarray:
    turns = [Rotation.from_euler("zxz", [60 * k, 22, -60 * k], degrees=True) * DOWN for k in range(6)]
    matrices = np.array([turn.as_matrix() for turn in turns])
    random = np.random.default_rng(0)
    return rigid(matrices, np.array([0.0, -0.4, 0.1]) + 2e-4 * random.standard_normal((6, 3)) - matrices @ TIP_M)


def corners(T: np.ndarray) -> np.ndarray:
    touched = np.array([[0, 0, 0.01], [0.6, 0, 0.01], [0, 0.4, 0.01]]) @ T[:3, :3].T + T[:3, 3]
    turns = np.repeat(DOWN.as_matrix()[None], 3, axis=0)
    return rigid(turns, touched - turns @ TIP_M)


def test_tip_then_place_then_force_are_written_with_date_and_interval(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    T = rigid(Rotation.from_euler("z", 5, degrees=True).as_matrix(), [-0.3, -0.55, 0.01])
    assert calibrate("tip", rig, T_base_ee=tilts())[0] == 0
    status, found = calibrate("place", rig, T_base_ee=corners(T), corner=np.arange(3))
    assert status == 0
    axes = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1]], float)
    turned = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    assert calibrate("force", rig, force_n=3.0 * axes @ turned, axis=axes)[0] == 0

    made = load_rig(rig)
    assert (made.tool.force_gain, made.tool.force_gain_sd) == (1.0, None)
    loaded = 5.2 * np.ones((4, 1)) * turned[2]
    pushed = {"force_n": 3.0 * axes @ turned, "axis": axes, "loaded_n": loaded}
    assert calibrate("force", rig, "--weight", "5", **pushed)[0] == 0
    made = load_rig(rig)
    assert made.tool.force_gain == pytest.approx(1.04)
    assert 0.0 < (made.tool.force_gain_sd or 0.0) < made.calibrated.force.half_gain < 0.01
    placement = Placement(np.array(made.surface.T_arm_surface), made.tool)
    under = placement.force_on_tip_n(loaded[0], rigid(DOWN.as_matrix(), np.zeros(3)))
    assert np.linalg.norm(under) == pytest.approx(5.0)  # what the scale showed
    assert placement.T_ee_center[:3, 3] == pytest.approx(TIP_M, abs=6e-4)
    assert placement.T_base_surface == pytest.approx(T, abs=2e-3)
    assert made.surface.size_m == pytest.approx((0.6, 0.4), abs=1e-3)
    assert made.workspace.low_m is not None
    assert np.array(made.tool.R_tip_force) == pytest.approx(turned, abs=1e-6)
    for kept in (made.calibrated.tip, made.calibrated.place, made.calibrated.force):
        assert len(kept.half_deg) == 3
    assert "# by caliper" in rig.read_text()
    assert "T_arm_surface" in found
    assert "written into" in capsys.readouterr().err


def test_camera_from_touches_and_from_poses(rig: Path) -> None:
    random = np.random.default_rng(1)
    X = rigid(Rotation.from_euler("x", 135, degrees=True).as_matrix(), [0.0, -0.9, 0.6])
    places = np.array([0.0, -0.35, 0.05]) + random.uniform(-0.2, 0.2, (8, 3))
    seen = (places - X[:3, 3]) @ X[:3, :3] + 1e-3 * random.standard_normal((8, 3))
    assert calibrate("camera", rig, touched_m=places, seen_m=seen)[0] == 0
    camera = load_rig(rig).camera
    assert np.array(camera.T_arm_camera) == pytest.approx(X, abs=6e-3)
    assert 0.0 < camera.doubt_m < 0.02
    arm = rigid(
        Rotation.from_rotvec(0.4 * random.standard_normal((8, 3))).as_matrix(), random.uniform(-0.1, 0.1, (8, 3))
    )
    board = np.linalg.inv(X) @ arm @ rigid(np.eye(3), np.array([0.0, 0.0, 0.05]))
    assert calibrate("camera", rig, T_base_ee=arm, T_camera_board=board)[0] == 0
    assert np.array(load_rig(rig).camera.T_arm_camera) == pytest.approx(X, abs=1e-6)


def test_time_is_written_and_the_picture_drawn(rig: Path, tmp_path: Path) -> None:
    time_s = np.arange(0.0, 5.0, 1e-3)
    taps = np.exp(-0.5 * ((time_s[:, None] - [1.2, 2.0, 3.4]) / 0.02) ** 2).sum(axis=1)
    noise = 0.01 * np.random.default_rng(2).standard_normal(len(time_s))
    picture = tmp_path / "time.png"
    signals = {"x_time_s": time_s, "x": taps, "y_time_s": time_s[::10] + 0.02, "y": (taps + noise)[::10]}
    recording = tmp_path / "time.rrd"
    assert calibrate("time", rig, "--picture", str(picture), "--record", str(recording), **signals)[0] == 0
    assert verify_here(recording) == 0
    kept = load_rig(rig).calibrated.time
    assert kept.offset_s == pytest.approx(0.02, abs=1e-3)
    late = {entry.name: entry.late_ns for entry in load_rig(rig).devices if entry.late_ns}
    assert late == {kept.device: round(1e9 * kept.offset_s)}, "what every command puts its stamps back by"
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_pushes_along_the_table_s_edges_and_a_weight_in_tilts(rig: Path) -> None:
    """The stick is turned and tilted: what a finger does along the table's edges is taken to the tip's frame."""
    T = rigid(Rotation.from_euler("z", 20, degrees=True).as_matrix(), [-0.3, -0.55, 0.0])
    assert calibrate("tip", rig, T_base_ee=tilts())[0] == 0
    assert calibrate("place", rig, T_base_ee=corners(T), corner=np.arange(3))[0] == 0
    made = load_rig(rig)
    placement = Placement(np.array(made.surface.T_arm_surface), made.tool)
    mounted = Rotation.from_euler("z", 75, degrees=True).as_matrix() @ np.diag([1.0, -1.0, 1.0])
    pose, weight_n = tilts()[0], np.array([0.0, 0.0, -0.4])

    def felt(T_base_ee: np.ndarray, force_n: np.ndarray) -> np.ndarray:
        """What the sensor makes of what the world does to the tip, base frame."""
        return -mounted.T @ (T_base_ee @ placement.T_ee_center)[:3, :3].T @ force_n

    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
    pushed = np.array([felt(pose, 3.0 * placement.to_base(axis)) for axis in axes])
    poses = tilts()[1:]
    hanging = np.array([0.2 + felt(one, weight_n) for one in poses])
    time_s = np.arange(0.0, 8.0, 0.01)
    rest = 0.2 + felt(pose, weight_n) + 0.005 * np.random.default_rng(3).standard_normal((len(time_s), 3))
    found = solve_force(made, PushedTip(pose, ForceReadings(time_s, rest), pushed, axes, poses, hanging))
    assert found.found["R_tip_force"] == pytest.approx(mounted, abs=0.03)
    assert found.found["weight"].weight_n == pytest.approx(0.4, abs=0.02)
    assert found.found["weight"].down == pytest.approx([0.0, 0.0, -1.0], abs=0.06)


def test_what_data_do_not_show_is_not_written(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate("tip", rig, T_base_ee=np.repeat(tilts()[:1], 6, axis=0))[0] == 2
    assert "try: tilt the stick" in capsys.readouterr().err
    assert calibrate("place", rig, "--no-write", T_base_ee=corners(np.eye(4)), corner=np.arange(3))[0] == 0
    assert rig.read_text() == RIG
    assert "[calibrated.place]" in capsys.readouterr().out


def test_views_turned_about_one_axis_alone_are_refused_with_the_next_pose(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    X = rigid(Rotation.from_euler("x", 135, degrees=True).as_matrix(), [0.0, -0.9, 0.6])
    about_y = Rotation.from_rotvec(np.linspace(-0.6, 0.6, 8)[:, None] * [0.0, 1.0, 0.0])
    arm = rigid(about_y.as_matrix(), np.random.default_rng(5).uniform(-0.1, 0.1, (8, 3)))
    board = np.linalg.inv(X) @ arm @ rigid(np.eye(3), np.array([0.0, 0.0, 0.05]))
    assert calibrate("camera", rig, T_base_ee=arm, T_camera_board=board)[0] == 2
    said = capsys.readouterr().err
    assert "expected views turned by 7 degrees or more about two axes" in said
    assert re.search(r"try: .* by [+-]30 degrees about its own [xz] axis", said)
    assert rig.read_text() == RIG


def test_without_a_terminal_nobody_is_asked(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig.write_text(RIG.replace('driver = "jaco"', 'driver = "jaco"\ndouble = true'))
    assert main(["calibrate", "tip", str(rig)]) == 2
    assert "no terminal for questions" in capsys.readouterr().err


def test_the_first_day_in_its_order() -> None:
    steps = commissioning_steps(parse_rig(RIG, "rig.toml"), "rig.toml")
    assert [step.what for step in steps] == ["tip", "place", "camera", "force", "arm", "time", "explore"]
    assert {step.what for step in steps if step.state != "to do"} == {"time"}  # the only one that is optional
    assert next_step(steps).command == "deformscope calibrate tip rig.toml"
    old = RIG + "T_ee_tip = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1]]\n"
    assert commissioning_steps(parse_rig(old, "rig.toml"), "rig.toml")[0].state == "by hand"
    old += "[calibrated.tip]\ndate = 2020-01-01\n"
    assert commissioning_steps(parse_rig(old, "rig.toml"), "rig.toml")[0].state == "old"
    assert commissioning_steps(parse_rig('[devices.a]\ndriver = "webcam"\n', "rig.toml"), "rig.toml") == ()


def test_a_tool_is_weighed_and_its_weight_taken_out_in_any_pose(rig: Path) -> None:
    rig.write_text(rig.read_text() + "R_tip_force = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]\n")
    R, weight_n, center_m = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), np.array([0, 0, -1.5]), np.array([0, 0, 0.05])
    poses = tilts()
    force_n = np.array([-R.T @ pose[:3, :3].T @ weight_n for pose in poses])
    given = {"T_base_ee": poses, "force_n": force_n + 0.3, "torque_nm": np.cross(center_m, force_n) - 0.02}
    status, found = calibrate("tool", rig, **given)
    assert status == 0
    assert found["mass_kg"] == pytest.approx(1.5 / 9.80665)
    made = load_rig(rig)
    assert made.tool.weight_n == pytest.approx((0, 0, -1.5), abs=1e-3)
    assert made.tool.weight_center_m == pytest.approx((0, 0, 0.05), abs=1e-4)
    assert made.calibrated.tool is not None
    assert 0 < made.calibrated.tool.half_weight_n < 0.05
    assert "tool" in made.calibrated.ages()
    other = rigid(Rotation.from_euler("xyz", [150, 30, 80], degrees=True).as_matrix(), (0.1, 0.2, 0.3))
    felt_n = -R.T @ other[:3, :3].T @ weight_n
    np.testing.assert_allclose(Placement(np.eye(4), made.tool).weight_on_sensor_n(other), felt_n, atol=1e-3)
