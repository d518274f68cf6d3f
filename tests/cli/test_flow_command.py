"""`deformscope flow` from the command line to its files."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from deformscope.cli import main
from deformscope.files.sources import open_source
from tests.cases import one_line
from tests.cli.recorded import assert_shows

MOTION_PX = (2.5, -1.0)
WITHIN_PX = 0.1
"""The texture is smooth and the motion one shift: the flow is far better than this."""


def texture(height: int, width: int, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Smooth noise, moved by `shift` (x, y) [px]."""
    noise = np.random.default_rng(3).normal(size=(height + 40, width + 40)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    move = np.array([[1, 0, shift[0] - 20], [0, 1, shift[1] - 20]], dtype=np.float32)
    moved = cv2.warpAffine(smooth, move, (width, height), flags=cv2.INTER_CUBIC)
    return np.clip(127 + 400 * moved, 0, 255).astype(np.uint8)


@pytest.fixture(autouse=True)
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two images in a folder of their own."""
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("before.png", texture(96, 128))
    cv2.imwrite("after.png", texture(96, 128, MOTION_PX))


def inner(flow_px: np.ndarray) -> np.ndarray:
    """The flow away from the edges, where the motion carries pixels out of the image."""
    return flow_px[16:-16, 16:-16]


def test_the_flow_is_written_in_x_y(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["flow", "before.png", "after.png", "--out", "f.npz"]) == 0
    with np.load("f.npz") as written:
        assert written.files == ["flow_px"]
        flow_px = written["flow_px"]
    assert (flow_px.shape, flow_px.dtype) == ((96, 128, 2), np.float32)
    np.testing.assert_allclose(np.median(inner(flow_px), axis=(0, 1)), MOTION_PX, atol=WITHIN_PX)
    out, err = capsys.readouterr()
    assert err == "written: f.npz\n"
    assert "largest motion" in out


def test_the_way_back_the_picture_and_the_json(capsys: pytest.CaptureFixture[str]) -> None:
    Path("f.npz").write_text("replaced")
    flags = ["--out", "f.npz", "--backward", "--picture", "f.png", "--json", "-", "--record", "f.rrd"]
    assert main(["flow", "before.png", "after.png", *flags]) == 0
    with np.load("f.npz") as written:
        assert written.files == ["flow_px", "backward_px"]
        there, back = np.median(inner(written["flow_px"]), (0, 1)), np.median(inner(written["backward_px"]), (0, 1))
    picture = cv2.imread("f.png")
    told = json.loads(capsys.readouterr().out)
    assert_shows(Path("f.rrd"), says="median motion", beside_particles=True, chart=False)
    with open_source(["f.rrd"]) as recorded:
        np.testing.assert_array_equal([frame.image for frame in recorded][1], cv2.imread("after.png", 0))
    np.testing.assert_allclose(there, -back, atol=WITHIN_PX)
    assert picture is not None
    assert np.ptp(picture) > 200
    assert (told["width"], told["height"], told["out"]) == (128, 96, "f.npz")
    assert told["median_px"] == pytest.approx(np.hypot(*MOTION_PX), abs=WITHIN_PX)
    assert 0 <= told["forward_backward_median_px"] < WITHIN_PX
    assert told["mean_px"] <= told["max_px"]


def test_flow_that_its_own_way_back_contradicts_is_named_with_its_place(capsys: pytest.CaptureFixture[str]) -> None:
    def told(*images: str) -> tuple[float | None, str]:
        assert main(["flow", *images, "--out", "f.npz", "--json", "f.json"]) == 0
        return json.loads(Path("f.json").read_text())["doubtful_share"], capsys.readouterr().out

    share, said = told("before.png", "after.png")
    assert (share or 0.0) < 0.05
    assert "doubtful" not in said
    assert told("before.png", "before.png")[0] is None
    hidden = texture(96, 128, MOTION_PX)
    hidden[60:, 80:] = np.random.default_rng(0).integers(0, 255, (36, 48))
    cv2.imwrite("hidden.png", hidden)
    share, said = told("before.png", "hidden.png")
    assert 0.05 < share < 0.3
    assert f"{share:.0%} of the pixels that move, most of them bottom right" in said
    cv2.imwrite("other.png", np.random.default_rng(1).integers(0, 255, (96, 128)))
    share, said = told("before.png", "other.png")
    assert share > 0.5


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_images_that_do_not_move_are_drawn_too(dtype: type[np.generic]) -> None:
    cv2.imwrite("still.png", np.dstack([texture(40, 64).astype(dtype)] * 3))
    assert main(["flow", "still.png", "still.png", "--out", "f.npz", "--picture", "f.png", "--json", "f.json"]) == 0
    assert json.loads(Path("f.json").read_text())["max_px"] == pytest.approx(0, abs=0.01)
    assert Path("f.png").is_file()


@pytest.mark.parametrize(
    ("after", "says"),
    [
        ("missing.png", "missing.png"),
        ("broken.png", "broken.png"),
        (
            "small.png",
            "expected two images of one size; got 128 x 96 and 64 x 64 px | try: crop both alike | small.png",
        ),
        (".", "expected an image"),
    ],
)
def test_images_that_do_not_go_together_are_refused(after: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("broken.png").write_bytes(b"\x89PNG\r\n\x1a\n but then nothing")
    cv2.imwrite("small.png", texture(64, 64))
    assert main(["flow", "before.png", after, "--out", "f.npz"]) == 2
    assert says in one_line(capsys)
    assert not Path("f.npz").exists()


def test_an_error_below_python_stays_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    """OpenCV complains on stderr by itself."""
    Path("broken.png").write_bytes(b"\x89PNG\r\n\x1a\n but then nothing")
    assert main(["flow", "before.png", "broken.png", "--out", "f.npz"]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
