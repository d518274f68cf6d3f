"""Recorded images as files: the same bytes, and the same beta."""

import dataclasses
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from deformscope.cli import main
from deformscope.files.sources import open_source
from deformscope.frames import ColorFrame, DepthFrame, Item
from deformscope.images import encode_jpeg
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording.items import read_items
from deformscope.recording.recorder import Recorder
from deformscope_drivers.clock import Stamp
from tests.log import synthetic
from tests.log import synthetic_rig as rig


def rig_recording(path: Path, items: Sequence[Item]) -> Path:
    with Recorder(path, "none", {"rig": ""}, application=RIG) as made:
        streams = tuple(stream for stream in rig.STREAMS if stream.kind in ("color", "depth"))
        made.start(RigLayout(streams), rig.START_NS)
        made.write(items)
    return path


def beta(capfd: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    flags = ["--spacing-px", "40", "--held", "top,bottom", "--cluster-size", "3", "--candidates", "5", "--json", "-"]
    assert main(["calibrate", "beta", *map(str, arguments), *flags]) == 0
    found: dict[str, Any] = json.loads(capfd.readouterr().out)
    return found


@pytest.mark.slow
def test_beta_of_a_cameras_recorded_images_is_that_of_the_exported_ones(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with open_source(["sample:tension"], stride=1) as source:
        images = [one.image for one in itertools.islice(source, 3)]
    frames = [ColorFrame(Stamp(rig.ns(at / 30)), 7 + 2 * at, image, "front") for at, image in enumerate(images)]
    path = rig_recording(tmp_path / "r.rrd", [*frames, *(rig.depth(i, colored=True, size=(24, 32)) for i in range(3))])
    assert main(["export", str(path), "--images", str(tmp_path / "front"), "--camera", "front"]) == 0
    names = sorted(file.name for file in (tmp_path / "front").iterdir() if file.suffix == ".jpg")
    assert names == ["000007.jpg", "000009.jpg", "000011.jpg"]
    for file, frame in zip(names, frames, strict=True):
        assert (tmp_path / "front" / file).read_bytes() == encode_jpeg(frame.image)
    capfd.readouterr()
    recorded, exported = beta(capfd, path, "--camera", "front"), beta(capfd, tmp_path / "front")
    assert recorded == exported
    assert beta(capfd, path) | {"settings": 0} == recorded | {"settings": 0}  # the only one that is no depth camera
    two = rig_recording(tmp_path / "two.rrd", [*frames, *(dataclasses.replace(one, device="side") for one in frames)])
    assert main(["calibrate", "beta", str(two)]) == 2
    assert "got a recording of several: front, side" in capfd.readouterr().err
    assert main(["calibrate", "beta", str(path), "--camera", "left"]) == 2
    assert "'left'" in capfd.readouterr().err
    assert main(["calibrate", "beta", str(tmp_path / "front"), "--camera", "front"]) == 2
    assert "leave out --camera" in capfd.readouterr().err


def test_every_camera_gets_a_folder_and_distances_are_16_bit(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    items: list[Item] = [rig.color(i, size=(24, 32)) for i in range(2)]
    items += [rig.depth(i, "above all/1", colored=True, size=(24, 32)) for i in range(3)]
    path, out = rig_recording(tmp_path / "r.rrd", items), tmp_path / "out"
    assert main(["export", str(path), "--images", str(out), "--json", "-"]) == 0
    told = [(one["device"], one["what"], one["count"]) for one in json.loads(capfd.readouterr().out)["images"]]
    assert told == [("above all/1", "color", 3), ("above all/1", "depth", 3), ("front", "image", 2)]
    written = {folder.name: len(list(folder.iterdir())) for folder in out.iterdir() if folder.is_dir()}
    assert written == {"above_all_1": 3, "above_all_1-color": 3, "front": 2}
    depth = cv2.imread(str(out / "above_all_1" / "000002.png"), cv2.IMREAD_UNCHANGED)
    expected = next(one for one in items if isinstance(one, DepthFrame) and one.index == 2)
    np.testing.assert_array_equal(depth, expected.depth)
    (seen,) = (one for one in read_items(path, kinds=(DepthFrame,)) if one.index == 2)
    np.testing.assert_array_equal(cv2.imread(str(out / "above_all_1-color" / "000002.jpg"))[..., ::-1], seen.color)


def test_nothing_is_written_over(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with Recorder(tmp_path / "r.rrd", settings={"seed": 0}) as made:
        for frame in synthetic.frames(3):
            made.write(frame)
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    assert main(["export", str(tmp_path / "r.rrd"), "--images", str(out)]) == 2
    assert "got one that holds files | try: another one, or --overwrite" in capfd.readouterr().err
    own = ["000000.png", "000001.png", "000002.png"]
    for name in ("000099.png", own[0]):
        (out / name).write_bytes(b"mine")
    asked = ["export", str(tmp_path / "r.rrd"), "--images", str(out), "--overwrite"]
    assert main(asked) == 2
    assert "expected a folder without other images; got 000099.png" in capfd.readouterr().err
    assert (out / own[0]).read_bytes() == b"mine"
    (out / "000099.png").unlink()
    assert main(asked) == 0
    assert {path.name for path in out.iterdir()} == {".export.json", "notes.txt", *own}
    assert main(["export", str(tmp_path / "r.rrd"), "--to", "npz", "--out", str(out), "--overwrite"]) == 0
    assert not {path.name for path in out.iterdir()} & {".export.json", *own}
    (out / "000007.png").write_bytes(b"mine")  # of no export
    assert main(["export", str(tmp_path / "r.rrd"), "--to", "csv", "--out", str(out), "--overwrite"]) == 0
    assert (out / "000007.png").read_bytes() == b"mine"
    assert not list(out.rglob("*.npz"))
    assert main(["export", str(tmp_path / "r.rrd"), "--images", str(tmp_path / "none"), "--camera", "x"]) == 2
    assert "expected images in the recording; got none of 'x' | try: --camera camera" in capfd.readouterr().err
    assert not (tmp_path / "none").exists()
