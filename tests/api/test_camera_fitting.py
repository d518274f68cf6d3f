"""A camera that is fitted on a page while it goes on: what was held is what its command line gives."""

from __future__ import annotations

import json
import threading
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rerun")

from deformscope.arrays import ImageArray
from deformscope.cli import main
from deformscope.config import BetaConfig
from deformscope.config.calibrate import MotionFlags
from deformscope.config.images import ImageOptions
from deformscope.errors import InputError
from deformscope.images import read_image
from deformscope.page import camera_fitting, fit_camera
from deformscope.page.camera_fitting import CameraFitting
from deformscope.page.fit_camera import CameraSubject, camera_of
from deformscope.page.server.desk import Desk
from deformscope.page.server.messages import FollowCamera, HoldPicture, RunFit, TakeRest
from deformscope.page.server.page_server import PageServer, running_pages
from deformscope.session import Inline
from deformscope.stages.msm.quiet import quiet_warp
from tests.api.test_page_fitting import Watched, beta_of, going_on, typed
from tests.page.pages import at_desk
from tests.patience import PATIENCE_S


def stretched(index: int) -> ImageArray:
    """(120, 100, 3) a speckled block, stretched upwards a little more with each index."""
    speckle = cv2.GaussianBlur(np.random.default_rng(2).normal(128, 60, (120, 100)).astype(np.float32), (0, 0), 1.3)
    speckle = np.clip(128 + 2.5 * (speckle - 128), 0, 255).astype(np.float32)
    y, x = np.mgrid[:120, :100].astype(np.float32)
    strain = 0.01 * index
    moved = cv2.remap(speckle, x, (y + strain * 110) / (1 + strain), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    grey = moved.clip(0, 255).astype(np.uint8)
    return np.stack([grey, grey // 2, 255 - grey], axis=2)


class Camera(Watched):
    """A fit of pictures that a test gives. Its clock and its page's heartbeat are the test's."""

    def __init__(self, folder: Path, beside: Executor | None = None) -> None:
        self.now_s, self.files, self._changed = 0.0, {}, threading.Condition()
        self.desk = Desk("test", lambda: self.now_s)
        self.desk.watch(self._change)
        self.desk.come("a")
        quiet_warp()
        config = beta_of(Path("rig.toml"), images=ImageOptions(roi=(6, 5, 88, 105), grid=(5, 4)))
        self.subject = CameraSubject("side", "dis", beside or Inline(), lambda: folder)
        self.subject.saw(stretched(0))
        self.subject.begin(lambda: "")
        self.fitting = CameraFitting(self.desk, config, self.subject, self._offer)
        self._began = self.fitting.state.settings

    def see(self, index: int) -> ImageArray:
        image = stretched(index)
        self.subject.saw(image)
        return image

    def look(self) -> Any:
        """Somebody has the page before him, from now on: the next picture that is shown."""
        before = self.desk.state.fit
        assert before is not None
        self.desk.beat("a", visible=True)
        return self.until(lambda fit: fit.pictures != before.pictures)


def camera(folder: Path, beside: Executor | None = None) -> AbstractContextManager[Camera]:
    return going_on(Camera(folder, beside))


def test_what_is_held_is_what_its_command_line_gives(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "kept"
    with camera(kept) as one:
        began = one.until(lambda fit: fit.aee is not None)
        assert (began.camera, began.following, began.command) == ("side", True, "")
        assert not one.fitting.drawn_ms
        newest = one.see(3)
        followed = one.look()
        assert followed.command == ""  # nobody has these pictures
        assert len(followed.values) == len(followed.errors) == 13
        one.set(4, beta=0.37)
        one.until(lambda fit: fit.number == 4)
        one.fitting.obey(HoldPicture(0))
        held = one.until(lambda fit: not fit.following and fit.command)
        one.see(5)  # it goes on, and what is held stays
        assert set(one.desk.state.commands) >= {"follow-camera", "run-fit"}
        assert not {"take-rest", "hold-picture"} & set(one.desk.state.commands)
        one.fitting.obey(RunFit(0))
        found = one.until(lambda fit: fit.found is not None).found
    assert held.pictures == followed.pictures
    assert (read_image(kept / "rest-1.png") == stretched(0)).all()
    assert (read_image(kept / "now-1.png") == newest).all()
    assert sorted(path.name for path in kept.iterdir()) == ["now-1.png", "rest-1.png"]
    came = typed(held.command, capsys)
    at = came["settings"]["at"]
    assert (at["value"], at["aee"], at["aee_free"]) == (0.37, held.aee, held.aee_free)
    assert [came["value"], *came["interval"]] == [found.value, found.low, found.high]


def test_a_whole_fit_and_the_end_hold_what_is_shown(tmp_path: Path) -> None:
    with camera(tmp_path) as one:
        one.until(lambda fit: fit.aee is not None)
        one.see(2)
        one.look()
        one.fitting.obey(RunFit(0))
        assert one.until(lambda fit: fit.found is not None).following is False
        one.fitting.obey(FollowCamera(0))
        one.see(4)
        assert one.look().found is None
    assert one.fitting.result_config.sources == (str(tmp_path / "rest-2.png"), str(tmp_path / "now-2.png"))
    assert (read_image(tmp_path / "now-2.png") == stretched(4)).all()


def test_another_picture_can_be_the_one_at_rest(tmp_path: Path) -> None:
    with camera(tmp_path) as one:
        one.until(lambda fit: fit.aee is not None)
        one.see(4)
        moved = one.look()
        one.fitting.obey(TakeRest(0))
        assert one.until(lambda fit: fit.pictures != moved.pictures).aee < 1e-3 < moved.aee


def test_a_curve_that_cannot_be_simulated_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = camera_fitting.simulate

    def simulate(seen: Any, model: Any, values: Any, body: Any) -> Any:
        raise ArithmeticError("a singular cluster")

    monkeypatch.setattr(camera_fitting, "simulate", simulate)
    with camera(tmp_path) as one:
        fit = one.until(lambda fit: fit.aee is not None)
        assert (fit.problem, fit.values) == ("no error curve: a singular cluster", ())
        monkeypatch.setattr(camera_fitting, "simulate", real)
        one.see(2)
        fit = one.look()
        assert (fit.problem, len(fit.values)) == ("", 13)


class Counting(Inline):
    calls = 0

    def submit(self, *given: Any, **named: Any) -> Future[Any]:
        self.calls += 1
        return super().submit(*given, **named)


def test_nothing_is_computed_for_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    beside = Counting()
    one = Camera(tmp_path, beside)
    monkeypatch.setattr("deformscope.page.camera_fitting.QUIET_S", 0.001)
    assert beside.calls == 1  # to begin with
    one.see(2)
    for visible, calls in ((False, 1), (True, 2), (True, 2)):  # the newest is shown once
        one.desk.beat("a", visible=visible)
        with one.fitting._news:
            one.fitting._wait()
        assert beside.calls == calls
    one.now_s += 1.0  # hidden, frozen or gone: not heard of
    one.fitting._begin_step(whole=False)
    one.see(3)
    with one.fitting._news:
        one.fitting._wait()
    assert beside.calls == 2


def test_what_cannot_be_computed_is_not_asked_for_again_and_again(tmp_path: Path) -> None:
    """A picture of another size, as a camera gives whose mode was changed."""
    beside = Counting()
    one = Camera(tmp_path, beside)
    one.desk.beat("a", visible=True)
    one.subject.saw(np.zeros((60, 60, 3), np.uint8))
    for _ in range(3):
        one.subject.ask(lambda: None)
        one.fitting._begin_step(whole=False)
    assert "60x60 after 100x120" in one.fitting.state.problem
    assert beside.calls == 2
    one.see(3)
    one.subject.ask(lambda: None)
    one.fitting._begin_step(whole=False)
    assert (beside.calls, one.fitting.state.problem) == (3, "")


def test_a_folder_that_could_not_be_made_is_tried_again(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    one = Camera(tmp_path / "file" / "kept")
    with pytest.raises(InputError, match="a folder that can be written to"):
        one.subject.keep()
    (tmp_path / "file").unlink()
    one.subject.keep()
    assert sorted(path.name for path in (tmp_path / "file" / "kept").iterdir()) == ["now-1.png", "rest-1.png"]


def test_pictures_that_cannot_be_kept_are_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with camera(tmp_path / "file") as one:
        one.until(lambda fit: fit.aee is not None)
        one.fitting.obey(HoldPicture(0))
        shown = one.until(lambda fit: fit.problem)
        assert "cannot be kept" in shown.problem
        assert shown.following
    with pytest.raises(InputError, match="that are kept"):
        _ = one.fitting.result_config


def test_a_picture_is_never_shown_with_the_particles_of_another(tmp_path: Path) -> None:
    with camera(tmp_path) as one:
        one.until(lambda fit: fit.aee is not None)
        one.set(1, held=())
        assert one.until(lambda fit: fit.problem).observed
        one.see(2)
        shown = one.look()
        assert shown.problem
        assert (shown.observed, shown.simulated, shown.aee) == ((), (), None)
        one.set(2)
        assert one.until(lambda fit: fit.number == 2).observed
        one.subject.saw(np.zeros((60, 60, 3), np.uint8))
        assert "60x60 after 100x120" in one.until(lambda fit: fit.problem).problem


# Of a rig ------------------------------------------------------------------------------------------------------------


def rig_of(tmp_path: Path, *devices: str) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text("".join(devices) + f'[record]\nfolder = "{tmp_path / "runs"}"\n')
    return path


def folder_camera(tmp_path: Path) -> str:
    frames = tmp_path / "frames"
    frames.mkdir()
    for index in range(4):
        cv2.imwrite(str(frames / f"{index}.png"), stretched(index))
    return f'[devices.side]\ndriver = "image_folder"\npath = "{frames}"\nfps = 20\nloop = true\n'


def test_a_rig_is_refused_where_nothing_can_be_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = str(rig_of(tmp_path, '[devices.tip]\ndriver = "optoforce"\nport = "/dev/none"\n'))
    for words, wrong in (
        ([rig], "expected --viewer page with a rig"),
        ([rig, "a.png", "--viewer", "page"], "expected a rig alone, or files; got both"),
        ([rig, "--viewer", "page", "--stride", "2"], "expected no --stride with a rig"),
        ([rig, "--viewer", "page", "--whole-motion"], "--whole-motion"),
        ([rig, "--viewer", "page"], "expected a rig with a camera; got none"),
        (["lab:bench", "--viewer", "page", "--camera", "x"], "got 'x' | try: camera, depth"),
    ):
        assert main(["calibrate", "beta", *words]) == 2
        assert wrong in capsys.readouterr().err


def test_a_rigs_camera_alone_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Beside(dict[str, Inline]):
        def __init__(self, *given: object) -> None:
            super().__init__(flow=Inline())

        def __enter__(self) -> Beside:
            return self

        def __exit__(self, *raised: object) -> None: ...

    monkeypatch.setattr(fit_camera, "StageProcesses", Beside)
    arm = '[devices.tip]\ndriver = "optoforce"\nport = "/dev/none"\n'  # nothing of it is there
    config = BetaConfig((str(rig_of(tmp_path, arm, folder_camera(tmp_path))),))
    with camera_of(config, lambda words, bad: None) as subject:
        assert (subject.camera, subject.size_px) == ("side", (100.0, 120.0))
    with (
        pytest.raises(InputError, match="leave it out"),
        camera_of(BetaConfig(("lab:bench",), motion=MotionFlags(whole_motion=True)), print),
    ):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["side", "camera", "depth"])
def test_the_command_follows_a_camera(camera: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder in a camera's place, a webcam's double, a depth camera's, whose colour picture is taken."""
    doubles = "".join(
        f'[devices.{name}]\ndriver = "{driver}"\ndouble = true\n'
        for name, driver in (("camera", "webcam"), ("depth", "depth_camera"))
    )
    rig = rig_of(tmp_path, folder_camera(tmp_path), doubles)
    words = ["calibrate", "beta", str(rig), "--camera", camera, "--candidates", "12", "--held", "border"]
    words += ["--viewer", "page", "--json", str(tmp_path / "out.json"), "--record", str(tmp_path / "fit.rrd")]
    status: list[int] = []
    thread = threading.Thread(target=lambda: status.append(main(words)))
    thread.start()
    with at_desk(_page(), "a") as desk, desk.beating():
        desk.until(lambda state: state["fit"] and state["fit"]["aee"])
        assert desk.command("hold-picture")[0] == "begun"
        fit = desk.until(lambda state: not state["fit"]["following"])["fit"]
        assert desk.command("stop")[0] == "begun"
        desk.until(lambda state: state["phase"] == "stopped")
    thread.join(PATIENCE_S)
    assert status == [0], capsys.readouterr().err
    printed = capsys.readouterr()
    assert f"as set on the page: {fit['command']}" in printed.err
    came = json.loads((tmp_path / "out.json").read_text())
    assert came["settings"]["at"]["aee"] == fit["aee"]
    assert typed(fit["command"], capsys)["settings"]["at"]["aee"] == fit["aee"]
    assert main(["replay", str(tmp_path / "fit.rrd")]) == 0


def _page() -> PageServer:
    for _ in range(int(PATIENCE_S * 100)):
        if pages := running_pages():
            return pages[0]
        threading.Event().wait(0.01)
    raise AssertionError("no page")
