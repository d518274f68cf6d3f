"""Folders of meshes with forces, as PokeFlex has them, become pairs and a motion."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope import cli
from deformscope.files.motions import parse_motion
from deformscope.files.pairs import parse_pair
from studies.__main__ import main

SIZE_MM = np.array([60.0, 50.0, 40.0])
DEPTHS_MM = [0.0, 0.2, 1.5, 3.0, 4.5, 6.0, 6.0, 4.0]
BIAS_N = np.array([0.5, -0.2, 3.0])
N_PER_MM = 0.7


def vertices_mm() -> Any:
    """Of a block, on a grid of its faces."""
    grid = np.stack(np.meshgrid(*(np.linspace(0.0, side, 7) for side in SIZE_MM), indexing="ij"), axis=-1)
    inner = (grid > 0.0).all(axis=-1) & (grid < SIZE_MM).all(axis=-1)
    return grid[~inner]


def deformed_mm(rest: Any, depth_mm: float) -> Any:
    """A flat tool comes down on the middle of the top; the bottom stays."""
    away = np.linalg.norm(rest[:, :2] - SIZE_MM[:2] / 2, axis=1)
    share = np.clip(1.5 - away / 20.0, 0.0, 1.0) * rest[:, 2] / SIZE_MM[2]
    return rest - share[:, None] * [0.0, 0.0, depth_mm]


def write_take(folder: Path) -> Path:
    """Frames from 1 on, the first at rest."""
    (folder / "meshes").mkdir(parents=True)
    rest, data = vertices_mm(), []
    for frame, depth_mm in enumerate(DEPTHS_MM, start=1):
        lines = ["# a mesh", "mtllib a.mtl"]
        lines += ["v {:.6f} {:.6f} {:.6f}".format(*row) for row in deformed_mm(rest, depth_mm)]
        (folder / "meshes" / f"mesh-f{frame:05}.obj").write_text("\n".join([*lines, "vt 0 0", "f 1/1 2/1 3/1"]))
        force = BIAS_N + np.array([0.0, 0.0, N_PER_MM * depth_mm])
        data.append({"frame": frame, "forces": [*force, 0.0, 0.0, 0.0] if frame % 2 else force.tolist()})
    (folder / "robot_data.json").write_text(json.dumps(data))
    for camera, prefix in (("volucam", ""), ("kinect", "color_")):
        (folder / camera).mkdir()
        values = {f"{prefix}intrinsics": np.eye(3).tolist(), f"{prefix}extrinsics": np.eye(4).tolist()}
        (folder / camera / "camera_parameters.json").write_text(json.dumps(values))
    return folder


def test_a_take_becomes_pairs_and_a_motion_that_are_fitted(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    take, out = write_take(tmp_path / "Cube" / "take1"), tmp_path / "out"
    flags = ["--pairs", str(out), "--unseen", "3", "--particles", "150", "--json", str(tmp_path / "found.json")]
    assert main(["takes", "--take", str(take), *flags]) == 0
    assert sorted(json.loads((tmp_path / "found.json").read_text())["cameras"]) == ["kinect", "volucam"]
    names = [f"pair-{frame:05}.npz" for frame in (3, 4, 6, 7)] + [f"unseen-{frame:05}.npz" for frame in (5, 8)]
    assert sorted(one.name for one in out.iterdir()) == sorted([*names, "motion.npz"])
    whole = 1e-3 * vertices_mm()
    for name in names:
        frame = int(name[-9:-4])
        depth_mm = DEPTHS_MM[frame - 1]
        pair = parse_pair((out / name).read_bytes())
        assert len(pair.rest) == 150
        assert np.abs(pair.rest[:, None] - whole).max(axis=2).min(axis=1).max() < 1e-9
        np.testing.assert_allclose(pair.deformed, 1e-3 * deformed_mm(1e3 * pair.rest, depth_mm), atol=2e-9)
        assert pair.force_n is not None
        np.testing.assert_allclose(pair.force_n, N_PER_MM * depth_mm, rtol=1e-9)
        moved_mm = 1e3 * np.linalg.norm(pair.deformed - pair.rest, axis=1)
        assert pair.contact is not None
        assert (moved_mm[pair.contact] > 0.79 * depth_mm).all()
        still = np.setdiff1d(pair.held, pair.contact)
        assert (pair.rest[still, 2] < 0.0021).all()
        assert len(still) > 5
    motion = parse_motion((out / "motion.npz").read_bytes())
    assert motion.position.shape == (7, 150, 3)
    seen = np.isfinite(motion.position).all(axis=2)
    free = ~motion.held
    assert [bool(seen[at][free[at]].any()) for at in range(7)] == [True, True, True, False, True, True, False]
    assert seen[motion.held].all()
    capfd.readouterr()
    model = tmp_path / "model.npz"
    assert cli.main(["calibrate", "beta", str(out / "pair-00006.npz"), "--save", str(model), "--json", "-"]) == 0
    assert json.loads(capfd.readouterr().out)["stiffness_n_per_m"]["value"] > 0.0
    middle = "at=0.03,0.025,0.04 depth=0.003"
    assert cli.main(["predict", str(model), "--poke", middle, "--json", "-"]) == 0
    poke = json.loads(capfd.readouterr().out)["predictions"][0]
    assert 0.3 * N_PER_MM * 3.0 < poke["force_n"] < 3.0 * N_PER_MM * 3.0


TURNS = {"z": (0, 1, 2), "y": (1, 2, 0), "x": (2, 0, 1)}
"""Axis of the file by axis of the block, whose third is up."""
MIRRORED = {"-z": (0, 1, 2), "-y": (1, 2, 0), "-x": (2, 0, 1)}


def turned(take: Path, up: str, order: slice = slice(None), bias_n: Any = 0.0, bulging: float = 0.0) -> Path:
    """The take with another axis up, its frames in another order, and another zero of its sensor."""
    (take / "meshes").mkdir(parents=True)
    axes = (TURNS | MIRRORED)[up]
    sign = np.where(np.arange(3) == axes.index(2), -1.0 if up[0] == "-" else 1.0, 1.0)
    data = []
    for frame, depth_mm in enumerate(DEPTHS_MM[order], start=1):
        block = deformed_mm(vertices_mm(), depth_mm)
        block += bulging * depth_mm * (block / SIZE_MM - 0.5) * [2, 2, 0] * block[:, 2:] / SIZE_MM[2]
        vertices = block[:, axes] * sign
        lines = ["v {:.6f} {:.6f} {:.6f}".format(*row) for row in vertices]
        (take / "meshes" / f"mesh-f{frame:05}.obj").write_text("\n".join(lines))
        force = np.array([0.0, 0.0, N_PER_MM * depth_mm])[list(axes)] * sign + [0.0, 0.0, bias_n]
        data.append({"frame": str(frame), "forces": force.tolist()})
    (take / "robot_data.json").write_text(json.dumps(data))
    return take


def still_of(out: Path) -> tuple[Any, Any]:
    pair = parse_pair(next(out.glob("pair-*.npz")).read_bytes())
    return pair.rest, pair.rest[np.setdiff1d(pair.held, pair.contact)]


@pytest.mark.parametrize("up", [*TURNS, *MIRRORED])
@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1), slice(4, None, -1)], ids=["", "back", "loaded"])
def test_any_axis_may_be_up_and_any_frame_at_rest(up: str, order: slice, tmp_path: Path) -> None:
    """The sides of this block stay, too: the axis of the force tells, or the user is asked."""
    take = turned(tmp_path / "take", up, order)
    flags = ["takes", "--take", str(take), "--particles", "250", "--pairs", str(tmp_path / "out")]
    if main(flags) != 0:
        assert main([*flags, f"--up={up}"]) == 0
    rest, still = still_of(tmp_path / "out")
    axis = "xyz".index(up[-1])
    sign = -1.0 if up[0] == "-" else 1.0
    assert np.allclose(still[:, axis] * sign, (rest[:, axis] * sign).min(), atol=0.003)
    free = [frame for frame, depth_mm in enumerate(DEPTHS_MM[order], start=1) if depth_mm < 0.1]
    names = {int(one.name[-9:-4]) for one in (tmp_path / "out").glob("*-*.npz")}
    assert names == {frame for frame, depth_mm in enumerate(DEPTHS_MM[order], start=1) if depth_mm > 1.0}
    assert not names & set(free)


@pytest.mark.parametrize("up", ["x", "-y", "-z"])
def test_a_face_that_moves_is_not_on_the_table(up: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Its sides bulge: only one face stays, and nothing is asked."""
    take = turned(tmp_path / "take", up, bulging=0.3)
    assert main(["takes", "--take", str(take), "--pairs", str(tmp_path / "out"), "--json", "-"]) == 0
    assert json.loads(capfd.readouterr().out)["up"] == up


def test_what_the_forces_refute_is_asked(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    back = turned(tmp_path / "take", "z", slice(None, None, -1), -9.0)
    flags = ["takes", "--take", str(back), "--pairs", str(tmp_path / "out")]
    assert main([*flags, "--rest", "8", "--json", "-"]) == 0
    assert json.loads(capfd.readouterr().out)["rest_frame"] == 8
    biased = turned(tmp_path / "biased", "z", slice(4, None, -1), 2.0)
    assert main(["takes", "--take", str(biased), "--pairs", str(tmp_path / "b")]) == 2
    assert "got 5.15 N in frame 1, and 2 N at least, in frame 5 | try: --rest FRAME" in capfd.readouterr().err
    assert main(["takes", "--take", str(biased), "--pairs", str(tmp_path / "b"), "--rest", "9"]) == 2
    assert "--rest FRAME with a mesh and a force; got 9 | try: 1 to 5" in capfd.readouterr().err
    assert main(["takes", "--take", str(biased), "--pairs", str(tmp_path / "b"), "--rest", "5", "--up=-z"]) == 2
    assert "a part above the table moved by 1 mm" in capfd.readouterr().err


def test_cameras_two_folders_deep_and_of_other_makers(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    take = write_take(tmp_path / "take")
    for name, said in (
        ("realsense/0", {"color_intrinsics": np.eye(3).tolist(), "extrinsics": [(2 * np.eye(4)).tolist()]}),
        ("realsense/1", {"color_intrinsics": np.eye(3).tolist(), "depth_intrinsics": [], "extrinsics": []}),
    ):
        (take / name).mkdir(parents=True)
        (take / name / "camera_parameters.json").write_text(json.dumps(said))
    flags = ["takes", "--take", str(take), "--pairs", str(tmp_path / "out"), "--json", "-"]
    assert main(flags) == 2
    said = capfd.readouterr().err
    assert "expected extrinsics (4, 4) or color_extrinsics; got another shape" in said
    assert "realsense/1" in said
    (take / "realsense" / "1" / "camera_parameters.json").unlink()
    assert main(flags) == 0
    cameras = json.loads(capfd.readouterr().out)["cameras"]
    assert sorted(cameras) == ["kinect", "realsense/0", "volucam"]
    assert cameras["realsense/0"]["extrinsics"] == (2 * np.eye(4)).tolist()


def without(name: str) -> Callable[[Path], object]:
    return lambda take: (take / name).unlink()


def changed(name: str, *replaced: str) -> Callable[[Path], object]:
    def change(take: Path) -> None:
        text = (take / name).read_text()
        assert replaced[0] in text
        (take / name).write_text(text.replace(*replaced, 1))

    return change


def only_one_mesh(take: Path) -> None:
    for path in sorted((take / "meshes").iterdir())[1:]:
        path.unlink()


MESH = "meshes/mesh-f00004.obj"
CASES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no forces": (without("robot_data.json"), "robot_data.json"),
    "no json": (changed("robot_data.json", "[", "("), "in JSON"),
    "no list": (lambda take: (take / "robot_data.json").write_text("3"), "a list of frame and forces"),
    "other keys": (changed("robot_data.json", '"forces"', '"wrench"'), "forces"),
    "two numbers": (
        lambda take: (take / "robot_data.json").write_text('[{"frame": 1, "forces": [1, 2]}]'),
        "[1.0, 2.0]",
    ),
    "nan": (changed("robot_data.json", "3.0", "NaN"), "in JSON"),
    "one mesh": (only_one_mesh, "got 1 meshes, 8 forces, 1 of them of one frame"),
    "other vertices": (changed(MESH, "vt 0 0", "v 1 2 3"), "meshes with the same vertices"),
    "no numbers": (changed(MESH, "v ", "v x "), "a mesh with vertices"),
    "metres": (
        lambda take: [changed(f"meshes/{one.name}", "v 6", "v 6e9")(take) for one in (take / "meshes").iterdir()],
        "got",
    ),
    "camera": (
        changed("kinect/camera_parameters.json", "color_", "depth_"),
        "expected intrinsics (3, 3) or color_intrinsics; got none, but 'depth_intrinsics'",
    ),
    "matrix": (changed("volucam/camera_parameters.json", "[1.0, 0.0, 0.0, 0.0]", "[1.0]"), "extrinsics"),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_wrong_with_a_take_is_one_line(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    spoil, words = CASES[name]
    take = write_take(tmp_path / "take")
    spoil(take)
    assert main(["takes", "--take", str(take), "--pairs", str(tmp_path / "out")]) == 2
    error = capfd.readouterr().err
    assert words in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
