"""A camera that is fitted on a page while it goes on: what was held is what its command line gives."""

from __future__ import annotations

import json
import threading
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, nullcontext
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
from deformscope.page import fit as page_fit
from deformscope.page import fit_command, fit_process
from deformscope.page.fit import PageFit
from deformscope.page.fit_command import set_on_page
from deformscope.page.fit_source import FollowedCamera, ImagesSubject
from deformscope.page.server.messages import FollowCamera, HoldPicture, RunFit, TakeRest
from deformscope.page.server.page_server import PageServer, end_pages, running_pages
from deformscope.page.server.page_session import PageSession
from deformscope.session import Inline
from deformscope.stages.msm.quiet import quiet_warp
from tests.page.pages import page_script
from tests.page.test_fit import Watched, beta_of, going_on, in_this_process, typed
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
    """A fit of pictures that a test gives. before: what was shown as the last of them came"""

    def __init__(self, folder: Path, beside: Executor | None = None) -> None:
        self.files, self._changed = {}, threading.Event()
        self.session = PageSession("test")
        self.session.watch(self._change)
        quiet_warp()
        config = beta_of(Path("rig.toml"), images=ImageOptions(roi=(6, 5, 88, 105), grid=(5, 4)))
        self.wants = 0
        self.camera = FollowedCamera("side", stretched(0), beside or Inline(), lambda: folder, self._want)
        self.camera.request(lambda: None)
        subject = ImagesSubject(self.camera.motion())
        self.fitting = PageFit(config, subject, self._take, self.camera, keeps_last=True)
        self._began = self.fitting.state.settings

    def _want(self) -> None:
        self.wants += 1

    def see(self, index: int) -> ImageArray:
        shown = self.session.state.fit
        assert shown is not None
        self.before, image = shown.pictures, stretched(index)
        self.camera.on_picture(image)
        return image

    def look(self) -> Any:
        """The state once that picture is shown."""
        return self.until(lambda fit: fit.pictures != self.before)


def camera(folder: Path, beside: Executor | None = None) -> AbstractContextManager[Camera]:
    return going_on(Camera(folder, beside))


def test_what_is_held_is_what_its_command_line_gives(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "kept"
    with camera(kept) as one:
        began = one.until(lambda fit: fit.aee is not None)
        assert (began.camera, began.following, began.command) == ("side", True, "")
        newest = one.see(3)
        followed = one.look()
        assert followed.command == ""  # nobody has these pictures
        assert len(followed.values) == len(followed.errors) == 13
        one.set(4, beta=0.37)
        one.until(lambda fit: fit.number == 4)
        one.fitting.handle(HoldPicture(0))
        held = one.until(lambda fit: not fit.following and fit.command)
        one.see(5)  # it goes on, and what is held stays
        assert set(one.session.state.commands) >= {"follow-camera", "run-fit"}
        assert not {"take-rest", "hold-picture"} & set(one.session.state.commands)
        one.fitting.handle(RunFit(0))
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
        one.fitting.handle(RunFit(0))
        assert one.until(lambda fit: fit.found is not None).following is False
        one.fitting.handle(FollowCamera(0))
        one.see(4)
        assert one.look().found is None
    assert one.fitting.result_config.sources == (str(tmp_path / "rest-2.png"), str(tmp_path / "now-2.png"))
    assert (read_image(tmp_path / "now-2.png") == stretched(4)).all()


def test_another_picture_can_be_the_one_at_rest(tmp_path: Path) -> None:
    with camera(tmp_path) as one:
        one.until(lambda fit: fit.aee is not None)
        one.see(4)
        moved = one.look()
        one.fitting.handle(TakeRest(0))
        assert one.until(lambda fit: fit.pictures != moved.pictures).aee < 1e-3 < moved.aee


def test_a_curve_that_cannot_be_simulated_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = page_fit.simulate

    def simulate(seen: Any, model: Any, values: Any, body: Any) -> Any:
        if len(values) == 1:  # what is shown
            return real(seen, model, values, body)
        raise ArithmeticError("a singular cluster")

    monkeypatch.setattr(page_fit, "simulate", simulate)
    with camera(tmp_path) as one:
        fit = one.until(lambda fit: fit.aee is not None)
        assert (fit.problem, fit.values) == ("no error curve: a singular cluster", ())
        monkeypatch.setattr(page_fit, "simulate", real)
        one.see(2)
        fit = one.look()
        assert (fit.problem, len(fit.values)) == ("", 13)


class Counting(Inline):
    calls = 0

    def submit(self, *given: Any, **named: Any) -> Future[Any]:
        self.calls += 1
        return super().submit(*given, **named)


def test_a_picture_is_asked_for_and_computed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    beside = Counting()
    one = Camera(tmp_path, beside)
    monkeypatch.setattr(page_fit, "QUIET_S", 0.001)

    def wait() -> tuple[int, int]:
        with one.fitting._news:
            one.fitting._wait()
        one.fitting._follow(one.camera, holds=False)
        return one.wants, beside.calls

    assert (one.wants, beside.calls) == (1, 1)  # to begin with
    assert wait() == (1, 1)  # no picture came
    one.see(2)
    assert wait() == (2, 2)
    assert wait() == (2, 2)
    assert one.fitting._wants_fit is False


def test_what_cannot_be_computed_is_not_asked_for_again_and_again(tmp_path: Path) -> None:
    """A picture of another size, as a camera gives whose mode was changed."""
    beside = Counting()
    one = Camera(tmp_path, beside)
    one.camera.on_picture(np.zeros((60, 60, 3), np.uint8))
    for _ in range(3):
        one.camera.request(lambda: None)
        one.fitting._follow(one.camera, holds=False)
    assert "60x60 after 100x120" in one.fitting.state.problem
    assert beside.calls == 2
    one.see(3)
    one.camera.request(lambda: None)
    one.fitting._follow(one.camera, holds=False)
    assert (beside.calls, one.fitting.state.problem) == (3, "")


def test_a_folder_that_could_not_be_made_is_tried_again(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    one = Camera(tmp_path / "file" / "kept")
    with pytest.raises(InputError, match="a folder that can be written to"):
        one.camera.keep()
    (tmp_path / "file").unlink()
    one.camera.keep()
    assert sorted(path.name for path in (tmp_path / "file" / "kept").iterdir()) == ["now-1.png", "rest-1.png"]


def test_pictures_that_cannot_be_kept_are_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with camera(tmp_path / "file") as one:
        one.until(lambda fit: fit.aee is not None)
        one.fitting.handle(HoldPicture(0))
        shown = one.until(lambda fit: fit.problem)
        assert "cannot be stored" in shown.problem
        assert shown.following
    with pytest.raises(InputError, match="stored pictures"):
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
        one.camera.on_picture(np.zeros((60, 60, 3), np.uint8))
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
    monkeypatch.setattr(fit_process, "child_process", in_this_process)
    monkeypatch.setattr(page_fit, "StageProcesses", lambda *given, **also: nullcontext({"flow": Inline()}))
    arm = '[devices.tip]\ndriver = "optoforce"\nport = "/dev/none"\n'  # nothing of it is there
    config = BetaConfig((str(rig_of(tmp_path, arm, folder_camera(tmp_path))),))

    def finish() -> None:
        with page_script(_page(), "a") as session:
            fit = session.until(lambda state: state["fit"] and state["fit"]["aee"] is not None)["fit"]
            assert (fit["camera"], fit["size_px"]) == ("side", [100.0, 120.0])
            assert session.command("stop")[0] == "begun"

    thread = threading.Thread(target=finish)
    thread.start()
    with set_on_page(config, lambda words: None) as (chosen, _):
        thread.join(PATIENCE_S)
        assert [Path(source).name for source in chosen.sources] == ["rest-1.png", "now-1.png"]
    end_pages()
    with (
        pytest.raises(InputError, match="leave it out"),
        set_on_page(BetaConfig(("lab:bench",), motion=MotionFlags(whole_motion=True)), print),
    ):
        pass


def test_a_camera_that_gives_nothing_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit_process, "child_process", in_this_process)
    monkeypatch.setattr(page_fit, "StageProcesses", lambda *given, **also: nullcontext({"flow": Inline()}))
    monkeypatch.setattr(fit_command, "picture_of", lambda item, camera: None)
    rig = rig_of(tmp_path, folder_camera(tmp_path).replace("loop = true", "loop = false"))
    with pytest.raises(InputError, match="has ended"), set_on_page(BetaConfig((str(rig),)), print):
        pass
    monkeypatch.setattr(page_fit, "FIRST_S", 0.1)
    (tmp_path / "other").mkdir()
    rig = rig_of(tmp_path / "other", folder_camera(tmp_path / "other"))
    with pytest.raises(InputError, match=r"none within 0\.1 s"), set_on_page(BetaConfig((str(rig),)), print):
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
    with page_script(_page(), "a") as session, session.beating():
        session.until(lambda state: state["fit"] and state["fit"]["aee"])
        assert session.command("hold-picture")[0] == "begun"
        fit = session.until(lambda state: not state["fit"]["following"])["fit"]
        assert session.command("stop")[0] == "begun"
        session.until(lambda state: state["phase"] == "stopped")
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
