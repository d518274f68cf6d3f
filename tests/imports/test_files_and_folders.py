"""Folders of images and points; and measurements of others, where they are."""

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from deformscope.cli import main
from deformscope.frames import DepthFrame
from tests.imports.test_importing import BENCH, cloud, frames_of, inspected

DATA = Path(os.environ.get("DEFORMSCOPE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def imported(source: Path, text: str, out: Path, status: int = 0) -> Path:
    map_file = out.with_suffix(".toml")
    map_file.write_text(text)
    assert main(["import", str(source), "--map", str(map_file), "--record", str(out)]) == status
    return out


def refused(source: Path, text: str, out: Path, capfd: pytest.CaptureFixture[str]) -> str:
    capfd.readouterr()  # of imports before
    imported(source, text, out, status=2)
    error = capfd.readouterr().err
    assert len(error.strip().splitlines()) == 1
    assert not list(out.parent.glob(f"{out.stem}*.rrd"))
    return error


def test_an_empty_source_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "t.csv").write_text("t,Fx\n")
    text = '[[streams]]\ndevice = "tip"\nkind = "wrench"\ntopics = ["t.csv"]\nrate_hz = 1\n'
    error = refused(tmp_path / "t.csv", text, tmp_path / "r.rrd", capfd)
    assert "frames for the map's streams; got none | try: its topics in the map, which --inspect lists" in error
    (tmp_path / "bus.log").touch()
    assert main(["import", "--inspect", str(tmp_path / "bus.log")]) == 2
    error = capfd.readouterr().err
    assert "expected a bag, tables or images" in error
    assert "got '.log'" in error


def write_depth(folder: Path, count: int = 4) -> None:
    (folder / "depth").mkdir(parents=True)
    for at in range(count):
        cv2.imwrite(str(folder / "depth" / f"{at}.png"), np.full((3, 4), 500 + at, np.uint16))


def test_a_folder_of_depth_images_with_their_times(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "take"
    write_depth(source, 12)
    (source / "times.txt").write_text("# name time\n" + "".join(f"{at}.png {10 * at}\n" for at in range(12)))
    text = inspected(source)
    assert 'topics = ["depth/*.png"]' in text
    assert "expected time of depth in the map" in refused(source, text, tmp_path / "r.rrd", capfd)
    text = text.replace('time = "?"', 'time = "times.txt"')
    assert "expected time_unit of depth in the map" in refused(source, text, tmp_path / "r.rrd", capfd)
    text = text.replace('time_unit = "?"', 'time_unit = "ms"')
    assert "expected unit_m of depth in the map" in refused(source, text, tmp_path / "r.rrd", capfd)
    path = imported(source, f"{text}unit_m = 0.001\n", tmp_path / "r.rrd")
    frames: list[Any] = frames_of(path)["depth"]
    assert [(frame.stamp.host_ns, frame.depth[0, 0]) for frame in frames] == [
        (at * 10**7, 500 + at) for at in range(12)
    ]
    (source / "times.txt").write_text("0\n10\n")
    assert "expected 12 stamps, one a file; got 2" in refused(source, text, tmp_path / "s.rrd", capfd)


def test_sequences_of_points_with_and_without_rows(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    o3d = pytest.importorskip("open3d")
    source = tmp_path / "scans"
    (source / "flat").mkdir(parents=True)
    (source / "rows").mkdir()
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(1e3 * cloud()[:3]))
    o3d.io.write_point_cloud(source / "flat" / "1.ply", points)
    z = [0.5, "nan", 0.6, 0.7, 0.8, 0.9]
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 2\n"
    rows = "".join(f"{at % 3} {at // 3} {value}\n" for at, value in enumerate(z))
    pcd = f"# .PCD v0.7\n{head}VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6\nDATA ascii\n{rows}"
    (source / "rows" / "1.pcd").write_text(pcd)
    text = inspected(source).replace('time = "?"', "rate_hz = 10").replace('time_unit = "?"\n', "")
    assert "expected units.points of" in refused(source, text, tmp_path / "r.rrd", capfd)
    text = text.replace('topics = ["flat/*.ply"]', 'topics = ["flat/*.ply"]\nunits = {points = "mm"}')
    text = text.replace('topics = ["rows/*.pcd"]', 'topics = ["rows/*.pcd"]\nunits = {points = "m"}')
    text = text.replace('units = {"points" = "?"}\n', "")
    assert "expected focal_px of flat in the map" in refused(source, text, tmp_path / "r.rrd", capfd)
    camera = "focal_px = [100, 100]\ncenter_px = [3, 2]\nsize_px = [6, 4]"
    path = imported(source, text.replace('device = "flat"', f'device = "flat"\n{camera}'), tmp_path / "r.rrd")
    own = frames_of(path)
    flat, ordered = own["flat"][0], own["rows"][0]
    assert isinstance(flat, DepthFrame)
    assert isinstance(ordered, DepthFrame)
    expected = np.zeros((4, 6))
    expected[1, 2], expected[2, 3] = 5000, 7000
    np.testing.assert_array_equal(flat.depth, expected)
    np.testing.assert_array_equal(ordered.depth, [[5000, 0, 6000], [7000, 8000, 9000]])


def data(name: str) -> Path:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{path} is not there: measurements of others that are not shipped (DEFORMSCOPE_DATA)")
    return path


def test_the_force_log_of_others(tmp_path: Path) -> None:
    source = data("force_logs/silicone_grip_probe.csv")
    columns = ", ".join(f'"force_{at}_{axis}_n" = "F5-{axis.upper()}{at + 1}"' for at in range(3) for axis in "xyz")
    units = ", ".join(f'"F5-{axis.upper()}{at + 1}" = "mN"' for at in range(3) for axis in "xyz")
    table = f'topics = ["{source.name}"]\ncolumns = {{{columns}}}\nunits = {{{units}}}\n'
    text = f'[[streams]]\ndevice = "f5"\nkind = "wrench"\n{table}time = "Time"\ntime_unit = "s"\n'
    path = imported(source, text, tmp_path / "r.rrd")
    first: Any = frames_of(path)["f5"][0]
    np.testing.assert_allclose(first.force_n, [[0.397, 0.125, 1.129], [-0.233, 0.817, 1.275], [0.163, -0.985, -1.041]])


def test_a_grasp_of_others(tmp_path: Path) -> None:
    lines = data("jaco_optoforce/five_grasps.csv").read_text().splitlines()
    source = tmp_path / "grasp.csv"
    source.write_text("\n".join(lines[2:53]) + "\n")
    columns = ", ".join(f'"force_{at}_{axis}_n" = "opto{at + 1}_{axis}"' for at in range(3) for axis in "xyz")
    units = ", ".join(f'"opto{at + 1}_{axis}" = "N"' for at in range(3) for axis in "xyz")
    table = f'topics = ["grasp.csv"]\ncolumns = {{{columns}}}\nunits = {{{units}}}\nrate_hz = 3.7577\n'
    path = imported(source, f'[[streams]]\ndevice = "tips"\nkind = "wrench"\n{table}', tmp_path / "r.rrd")
    frames: list[Any] = frames_of(path)["tips"]
    assert len(frames) == 50
    np.testing.assert_array_equal(frames[0].force_n[0], [0.021, -0.031, -0.024])


def test_points_of_others(tmp_path: Path) -> None:
    source = tmp_path / "scans"
    source.mkdir()
    (source / "1.pcd").symlink_to(data("pcl/table_scene_mug_stereo_textured.pcd"))
    text = '[[streams]]\ndevice = "camera"\nkind = "depth"\ntopics = ["*.pcd"]\nunits = {points = "m"}\nrate_hz = 1\n'
    frame: Any = frames_of(imported(source, text, tmp_path / "r.rrd"))["camera"][0]
    assert frame.depth.shape == (480, 640)
    assert 0.1 < np.mean(frame.depth > 0) < 1.0


@pytest.mark.slow
def test_images_that_are_imported_are_calibrated_as_their_files_are(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    images = tmp_path / "images"
    assert main(["export", str(BENCH.with_name("tension.rrd")), "--to", "images", "--out", str(images)]) == 0
    text = '[[streams]]\ndevice = "cam"\nkind = "color"\ntopics = ["*.png"]\nrate_hz = 10\n'
    path = imported(images, text, tmp_path / "r.rrd")
    found = []
    for source in ([str(path)], sorted(map(str, images.glob("*.png")))):
        capfd.readouterr()
        assert main(["calibrate", "beta", *source, "--held", "top,bottom", "--grid", "5x4", "--json", "-"]) == 0
        found.append(json.loads(capfd.readouterr().out))
    assert found[0]["value"] == found[1]["value"]
    assert found[0]["curve"] == found[1]["curve"]
