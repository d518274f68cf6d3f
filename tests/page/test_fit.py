"""A fit that is set on a page: what it shows is what its command line gives, and the newest change wins."""

import json
import shlex
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

import cv2
import msgspec
import numpy as np
import pytest

from deformscope.cli import main, parse
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.images import ImageOptions
from deformscope.config.options import command_line
from deformscope.errors import InputError
from deformscope.page import fit, fit_process
from deformscope.page.fit import VALUES, PageFit
from deformscope.page.fit_process import FitProcess
from deformscope.page.fit_settings import set_on_a_page
from deformscope.page.fit_source import ImagesSubject, PairSubject, subject_of
from deformscope.page.server.fit_messages import FitSettings, FitState
from deformscope.page.server.messages import FitDrawn, RunFit, SetFit, StopRun, WriteNote
from deformscope.page.server.page_server import PageServer, running_pages
from deformscope.page.server.page_session import PageSession
from deformscope.runs.force_log import push_of
from deformscope.stages.fit.model import Observation
from deformscope.stages.msm import reference
from deformscope.stages.msm.quiet import quiet_warp
from tests.page.pages import page_script
from tests.patience import PATIENCE_S
from tests.stages import reference_states
from tests.stages.bodies import pushed
from tests.stages.see.scenes import Scene, render


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """Beta .6 with 1 mm of noise."""
    rng = np.random.default_rng(1)
    body = pushed((4, 5), rng)
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    deformed, _ = reference_states.relax(spec, body.held_position, beta=0.6)
    deformed[np.setdiff1d(np.arange(len(deformed)), body.held)] += rng.normal(
        0, 1e-3, (len(deformed) - len(body.held), 2)
    )
    path = tmp_path / "pair of mine.npz"
    np.savez(path, rest=body.rest, deformed=deformed, held=body.held)
    return path


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """Three images of a speckled block, stretched upwards a little more in each."""
    folder = tmp_path / "frames"
    folder.mkdir()
    speckle = cv2.GaussianBlur(np.random.default_rng(2).normal(128, 60, (120, 100)).astype(np.float32), (0, 0), 1.3)
    speckle = np.clip(128 + 2.5 * (speckle - 128), 0, 255).astype(np.float32)
    y, x = np.mgrid[:120, :100].astype(np.float32)
    for index in range(3):
        strain = 0.015 * index
        moved = cv2.remap(speckle, x, (y + strain * 110) / (1 + strain), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        cv2.imwrite(str(folder / f"img{index}.png"), moved.clip(0, 255).astype(np.uint8))
    return folder


class Watched:
    """A fit on a page without a page; `until` waits for a state."""

    def __init__(self, config: BetaConfig | ThetaConfig) -> None:
        self.session = PageSession("test")
        self.files: dict[str, bytes] = {}
        self._changed = threading.Event()
        self.session.watch(self._change)
        quiet_warp()
        self.fitting = PageFit(config, subject_of(config, lambda words: None, push_of), self._take)
        self._began = self.fitting.state.settings

    def _take(self, kind: str, *what: Any) -> None:
        if kind == "file":
            name, self.files[name], _ = what
        elif kind == "fit":
            state, commands = what
            self.session.enter("adjusting", commands=commands, fit=state)

    def _change(self) -> None:
        self._changed.set()  # the session is locked here: what waits for it must hold nothing

    def until(self, wanted: Any) -> Any:
        until_s = time.monotonic() + PATIENCE_S
        while True:
            self._changed.clear()
            if wanted(fit := self.session.state.fit):
                return fit
            assert self._changed.wait(max(until_s - time.monotonic(), 0.0))

    def set(self, number: int, **changes: Any) -> None:
        """These settings alone are not as they began."""
        self.fitting.handle(SetFit(0, number, msgspec.structs.replace(self._began, **changes)))

    def fitted(self, number: int, **changes: Any) -> Any:
        """The state with these settings, shown and fitted."""
        self.set(number, **changes)
        self.until(lambda fit: fit.number == number)
        self.fitting.handle(RunFit(0))
        return self.until(lambda fit: fit.found is not None or fit.problem)


AnyWatched = TypeVar("AnyWatched", bound=Watched)


def watched(config: BetaConfig | ThetaConfig) -> AbstractContextManager[Watched]:
    return going_on(Watched(config))


@contextmanager
def going_on(one: AnyWatched) -> Iterator[AnyWatched]:
    """In a thread, until the end of the context, at which it has to finish."""
    thread = threading.Thread(target=one.fitting.run)
    thread.start()
    try:
        yield one
    finally:
        one.fitting.handle(StopRun(0))
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def typed(command: str, capsys: pytest.CaptureFixture[str]) -> Any:
    """The JSON of a command line."""
    name, *words = shlex.split(command)
    assert name == "deformscope"
    assert main([*words, "--viewer", "none", "--json", "-"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def beta_of(source: Path, **more: Any) -> BetaConfig:
    from deformscope.config.calibrate import SearchOptions

    return BetaConfig((str(source),), search=SearchOptions(candidates=12), **more)


def test_a_pair_is_shown_as_its_command_line_gives_it(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with watched(beta_of(pair)) as one:
        shown = one.fitted(1, beta=0.37, theta=0.1, cluster_size=2)
        drawn = one.files["fit.png"]
        one.set(2, beta=0.3, theta=0.1, cluster_size=2)  # the same fit, looked at elsewhere
        assert one.until(lambda fit: fit.number == 2).found == shown.found
        one.set(3, beta=0.3, theta=0.1)
        assert one.until(lambda fit: fit.number == 3).found is None
    assert drawn.startswith(b"\x89PNG")
    assert "pair of mine.npz' " in shown.command
    found = typed(shown.command, capsys)
    at = found["settings"]["at"]
    assert (at["value"], at["aee"], at["aee_free"]) == (0.37, shown.aee, shown.aee_free)
    kept = shown.found
    assert [found["value"], *found["interval"], found["aee_free_m"]] == [kept.value, kept.low, kept.high, kept.aee_free]
    assert found["settings"]["cluster_size"] == 2
    assert found["settings"]["theta"] == 0.1
    assert kept.verdict == found["verdict_text"]


@pytest.mark.slow
def test_images_are_shown_as_their_command_line_gives_them(frames: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with watched(beta_of(frames)) as one:
        began = one.until(lambda fit: fit.number == 0 and fit.aee is not None)
        assert began.held == tuple(
            i for i in range(len(began.rest)) if began.rest[i][1] in (began.rest[0][1], began.rest[-1][1])
        )
        outline = ((8.0, 6.0), (92.0, 6.0), (92.0, 110.0), (30.0, 110.0))
        shown = one.fitted(
            1, roi=(6.0, 5.0, 86.0, 105.0), spacing_px=11.5, outline=outline, held=("top", "border"), beta=0.8
        )
        assert one.files["rest.jpg"] != one.files["frame3.jpg"]
    assert shown.problem == ""
    assert shown.spacing_px == pytest.approx(11.5)
    assert len(shown.rest) < shown.grid[0] * shown.grid[1]  # the outline cuts a corner
    found = typed(shown.command, capsys)
    at = found["settings"]["at"]
    assert (at["aee"], at["aee_free"]) == (shown.aee, shown.aee_free)
    assert found["settings"]["particles"] == len(shown.rest)


@pytest.mark.slow
@pytest.mark.parametrize("log", [False, True], ids=["weight", "log"])
def test_a_force_gives_what_its_command_line_gives(
    frames: Path, tmp_path: Path, log: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    from deformscope.config.calibrate import PushFlags

    force = tmp_path / "scale.csv"
    rows = [f"{0.1 * index:.1f},{200.0 * max(index - 10, 0):.1f}" for index in range(13)]
    force.write_text("\n".join(["time [s],weight [g]", *rows]) + "\n")
    given: dict[str, Any] = {"force": str(force), "force_offset_s": 1.0} if log else {"force": "400g"}
    images = ImageOptions(fps=10.0, scale_from=(10.0, 20.0, 60.0, 20.0, 0.02))
    with watched(beta_of(frames, images=images, push=PushFlags(**given, thickness_m=0.04))) as one:
        began = one.until(lambda fit: fit.rest)
        shown = one.fitted(1, beta=0.8)
    assert began.scale == (10.0, 20.0, 60.0, 20.0, 0.02)
    assert shown.problem == ""
    found = typed(shown.command, capsys)
    assert [found["value"], found["verdict_text"]] == [shown.found.value, shown.found.verdict]
    assert found["force_n"]["value"] == pytest.approx(0.4 * 9.80665, rel=1e-6)
    low, high = (1e-3 * end for end in found["modulus_pa"]["interval"])
    assert f"modulus {found['modulus_verdict']}: " in shown.found.force
    assert f"kPa ({low:.3g} to {high:.3g}) in plane stress" in shown.found.force
    assert ("time of the log" in shown.found.force) == log


class Held(Watched):
    """No frame is followed before `go_on` is set."""

    def __init__(self, config: BetaConfig) -> None:
        self.go_on = threading.Event()
        super().__init__(config)
        subject = self.fitting._subject
        assert isinstance(subject, ImagesSubject)
        follow = subject.follow
        subject.follow = lambda: (self.go_on.wait(PATIENCE_S), follow())[1]  # type: ignore[method-assign]


def test_the_first_frame_is_drawn_on_before_the_second_is_followed(
    frames: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with going_on(Held(beta_of(frames))) as one:
        first = one.until(lambda fit: fit.rest)
        assert first.pictures == ("rest.jpg", "frame1.jpg")
        assert first.size_px == (100.0, 120.0)
        assert (first.aee, first.simulated) == (None, ())
        assert first.busy.startswith("frame 1 of 3")
        one.set(1, roi=(6.0, 5.0, 86.0, 105.0), held=("top", "bottom"), beta=0.8)
        one.fitting.handle(RunFit(0))  # of all frames, once they are there
        one.go_on.set()
        shown = one.until(lambda fit: fit.found is not None)
    assert shown.settings.roi == (6.0, 5.0, 86.0, 105.0)
    assert shown.pictures == ("rest.jpg", "frame3.jpg")
    assert shown.busy == ""
    found = typed(shown.command, capsys)
    assert found["settings"]["frames"] == 3
    assert (found["settings"]["at"]["aee"], found["value"]) == (shown.aee, shown.found.value)


def test_frames_that_came_are_a_result_until_more_come(frames: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "SHOWN_EVERY_S", -1.0)
    states: list[FitState] = []
    one = Watched(beta_of(frames))
    take = one.fitting._send
    one.fitting._send = lambda kind, *what: (states.append(what[0]) if kind == "fit" else None, take(kind, *what))
    with going_on(one):
        one.until(lambda fit: fit.aee is not None and not fit.busy)
    shown = [(state.busy.partition(",")[0], state.pictures[1], state.aee is not None) for state in states if state.rest]
    assert list(dict.fromkeys(shown))[:4] == [
        ("frame 1 of 3", "frame1.jpg", False),
        ("frame 2 of 3", "frame2.jpg", True),
        ("frame 3 of 3", "frame3.jpg", True),
        ("", "frame3.jpg", True),
    ]


@pytest.mark.slow
def test_the_body_that_is_found_is_proposed_and_may_be_changed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = Scene(frames=4)
    for index, image in enumerate(render(scene)):
        cv2.imwrite(str(tmp_path / f"{index}.png"), image)
    with watched(beta_of(tmp_path)) as one:
        began = one.until(lambda fit: fit.aee is not None and not fit.busy)
        assert began.settings.outline
        assert set(began.settings.held) == {"bottom", "contact"}
        left, _, wide, _ = began.settings.contact
        assert (left, wide) == (pytest.approx(scene.tool[0], abs=4), pytest.approx(scene.tool[1], abs=8))
        one.fitting.handle(RunFit(0))
        shown = one.until(lambda fit: fit.found is not None)
        one.set(1, held=("bottom",))  # nothing of what was found
        whole = one.until(lambda fit: fit.number == 1 and not fit.busy)
        one.set(2)  # as the command begins: all of the picture
        plain = one.until(lambda fit: fit.number == 2 and not fit.busy)
    found = typed(shown.command, capsys)
    assert (found["settings"]["at"]["aee"], found["settings"]["held"]) == (shown.aee, len(shown.held))
    assert [found["value"], *found["interval"]] == [shown.found.value, shown.found.low, shown.found.high]
    assert found["verdict_text"] == shown.found.verdict
    for state in (whole, plain):
        assert typed(state.command, capsys)["settings"]["at"]["aee"] == state.aee


def test_one_frame_alone_is_said(frames: Path) -> None:
    with going_on(Held(beta_of(frames))) as one:
        one.until(lambda fit: fit.rest)
        subject = one.fitting._subject
        subject._frames = iter(())  # type: ignore[union-attr]  # the files are damaged from here on
        one.go_on.set()
        assert "at least two frames" in one.until(lambda fit: fit.problem).problem


@pytest.mark.slow
def test_theta_of_one_cluster(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with watched(ThetaConfig((str(pair),))) as one:
        one.set(1, theta=0.3, beta=0.7)
        shown = one.until(lambda fit: fit.number == 1)
    assert (shown.parameter, shown.settings.cluster_size) == ("theta", None)
    found = typed(shown.command + " --candidates 5", capsys)
    assert found["settings"]["at"]["aee"] == shown.aee
    assert found["settings"]["beta"] == 0.7


def test_a_command_line_says_all_that_decides() -> None:
    config = BetaConfig(
        ("a b.mp4",),
        at=0.1 + 0.2,
        cluster_size=5,
        theta=0.1,
        beta_range=(0.2, 0.7),
        images=ImageOptions(roi=(1.5, 2, 3, 4), outline=(1, 2, 3, 4, 5, 6.25), held=("top", "bottom"), grid=(7, 15)),
    )
    words = command_line("calibrate beta", config)
    assert words[:4] == ["deformscope", "calibrate", "beta", "a b.mp4"]
    assert parse(BetaConfig, words[3:], "calibrate beta") == config
    assert command_line("calibrate beta", BetaConfig(("x",))) == ["deformscope", "calibrate", "beta", "x"]


class Counted(PairSubject):
    """Counts how often it was looked at, and holds the first look up."""

    def __init__(self, config: BetaConfig) -> None:
        super().__init__(config)
        self.looks: list[float | None] = []
        self.go_on = threading.Event()

    def observe(self, config: BetaConfig | ThetaConfig) -> Observation:
        self.looks.append(config.at)
        assert self.go_on.wait(PATIENCE_S)
        return super().observe(config)


def test_what_is_set_meanwhile_is_simulated_once(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulated: list[float] = []
    real = fit.simulate
    monkeypatch.setattr(
        fit,
        "simulate",
        lambda seen, model, values, body: (simulated.extend(values), real(seen, model, values, body))[1],
    )
    monkeypatch.setattr(fit, "QUIET_S", PATIENCE_S)
    config = beta_of(pair)
    quiet_warp()
    subject = Counted(config)
    fitting = PageFit(config, subject, lambda *given: None)
    thread = threading.Thread(target=fitting.run)
    thread.start()
    for number in range(1, 41):
        fitting.handle(SetFit(0, number, FitSettings(held=("top",), beta=number / 100)))
    fitting.handle(StopRun(0))
    subject.go_on.set()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert simulated[-1] == 0.4
    assert len(simulated) <= 2
    assert fitting.state.number == 40


def test_a_fit_is_left_when_something_else_is_set(pair: Path) -> None:
    with watched(beta_of(pair)) as one:
        one.until(lambda fit: fit.aee is not None)
        real = one.fitting._note

        def note(what: str, done: int, total: int) -> None:
            one.set(7, beta=0.2)
            real(what, done, total)

        one.fitting._note = note  # type: ignore[method-assign]
        one.fitting.handle(RunFit(0))
        shown = one.until(lambda fit: fit.number == 7)
        one.fitting._note = real  # type: ignore[method-assign]
        assert shown.found is None


def test_a_value_of_the_curve_that_cannot_be_simulated_is_said(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = fit.simulate

    def simulate(seen: Any, model: Any, values: Any, body: Any) -> Any:
        if 0.6 < values[0] < 0.7:
            raise ArithmeticError("a singular cluster")
        return real(seen, model, values, body)

    monkeypatch.setattr(fit, "simulate", simulate)
    with watched(beta_of(pair)) as one:
        shown = one.until(lambda fit: len(fit.values) == VALUES)
        assert shown.problem.startswith("at beta 0.6")
        assert shown.problem.endswith(": a singular cluster")
        assert [0.6 < value < 0.7 for value in shown.values] == [error is None for error in shown.errors]
        one.set(1, beta=0.3)  # it goes on
        assert one.until(lambda fit: fit.number == 1).aee


def test_of_how_long_changes_took_the_newest_are_kept(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit_process, "child_process", in_this_process)
    page, config = PageServer("test"), beta_of(pair)
    page.session.come("a")

    def changed(fit: FitProcess) -> None:
        if fit.goes_on:
            page.session.enter("adjusting", commands=fit.commands, fit=fit.state)

    one = FitProcess(config, push_of, FitState("pair", "beta", FitSettings()), page, changed).start()
    page.session.bind(one)
    came = threading.Event()
    end = page.session.watch(lambda: came.set() if page.session.state.commands else None)
    assert came.wait(PATIENCE_S)
    end()
    assert page.session.command("a", FitDrawn(0, 9, 120.0)).outcome == "done"
    assert list(one.drawn_ms) == [120.0]
    assert page.session.command("a", WriteNote(0, "x")).outcome == "refused"
    for number in range(fit_process.MOST_CHANGES + 5):
        one.handle(FitDrawn(0, number, float(number)))
    assert len(one.drawn_ms) == fit_process.MOST_CHANGES
    assert one.drawn_ms[0] == 5.0
    assert page.session.command("a", StopRun(0)).outcome == "begun"
    assert one.result().sources == config.sources


@contextmanager
def in_this_process(name: str, target: Any) -> Iterator[Connection]:
    """As `processes.child_process`, in a thread."""
    ours, theirs = Pipe()
    thread = threading.Thread(target=target, args=(theirs,))
    thread.start()
    yield ours
    ours.close()
    thread.join(PATIENCE_S)
    theirs.close()
    assert not thread.is_alive()


def test_what_cannot_be_simulated_is_said_and_the_picture_stays(frames: Path) -> None:
    with watched(beta_of(frames)) as one:
        before = one.until(lambda fit: fit.aee is not None)
        for number, wrong in enumerate(
            ({"held": ()}, {"roi": (0.0, 0.0, 500.0, 500.0)}, {"spacing_px": 90.0}, {"held": ("contact",)}), 1
        ):
            one.set(number, **wrong)
            shown = one.until(lambda fit, number=number: fit.number == number)
            assert shown.problem
            assert (shown.simulated, shown.aee) == (before.simulated, before.aee)
        one.set(9)
        assert one.until(lambda fit: fit.number == 9).problem == ""


@pytest.mark.parametrize(
    "wrong",
    [
        {"beta": 1.5},
        {"theta": float("1e400")},
        {"cluster_size": 1},
        {"roi": [0, 0, 1]},
        {"held": ["middle"]},
        {"spacing_px": 0.0},
        {"grid": [1, 5]},
        {"outline": [[0, 0]] * 201},
        {"path": "/etc/passwd"},
    ],
)
def test_settings_are_checked_field_by_field(wrong: dict[str, Any]) -> None:
    right = {"kind": "set-fit", "id": 1, "number": 2, "settings": {"beta": 0.4, "held": ["top"]}}
    assert msgspec.json.decode(json.dumps(right), type=SetFit).settings.beta == 0.4
    with pytest.raises(msgspec.DecodeError):
        msgspec.json.decode(json.dumps(right | {"settings": wrong}), type=SetFit)


@pytest.mark.slow
def test_the_command_waits_for_its_page(pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.json"
    words = ["calibrate", "beta", str(pair), "--candidates", "12", "--viewer", "page", "--json", str(out)]
    status: list[int] = []
    thread = threading.Thread(target=lambda: status.append(main(words)))
    thread.start()
    page = wait_for_page()
    with page_script(page, "a") as session:
        fit = session.until(lambda state: state["fit"] and state["fit"]["aee"] is not None)["fit"]
        settings = fit["settings"] | {"beta": 0.44, "cluster_size": 4}
        assert session.command("set-fit", number=5, settings=settings)[0] == "begun"
        fit = session.until(lambda state: state["fit"]["number"] == 5)["fit"]
        assert session.command("fit-drawn", number=5, after_ms=80.0)[0] == "done"
        assert session.command("stop")[0] == "begun"
        thread.join(PATIENCE_S)
    assert status == [0]
    printed = capsys.readouterr()
    assert f"as set on the page: {fit['command']}" in printed.err
    assert "slider to picture: p50 80 ms, p95 80 ms, 1 changes" in printed.err
    kept = json.loads(out.read_text())["settings"]
    assert (kept["at"]["value"], kept["at"]["aee"], kept["cluster_size"]) == (0.44, fit["aee"], 4)


def wait_for_page() -> PageServer:
    for _ in range(int(PATIENCE_S * 100)):
        if pages := running_pages():
            return pages[0]
        threading.Event().wait(0.01)
    raise AssertionError("no page")


def test_what_is_set_on_a_page(pair: Path) -> None:
    from deformscope.config.calibrate import MotionFlags, PushFlags
    from deformscope.config.options import OutputOptions

    paged = OutputOptions(viewer="page")
    assert not set_on_a_page(beta_of(pair))
    assert set_on_a_page(beta_of(pair, output=paged))
    assert set_on_a_page(BetaConfig(("x.mp4",), push=PushFlags(force="3N", thickness_m=0.1), output=paged))
    assert not set_on_a_page(BetaConfig((str(pair), str(pair)), output=paged))
    assert not set_on_a_page(BetaConfig(("x",), motion=MotionFlags(whole_motion=True), output=paged))
    assert not set_on_a_page(BetaConfig(("x.npz",), push=PushFlags(thickness_m=0.1), output=paged))
    with pytest.raises(InputError, match="deformscope live lab:bench --stage beta"):
        beta_of(Path("lab:bench"), output=paged)
    with pytest.raises(InputError, match="no --at with"):
        BetaConfig(("x",), motion=MotionFlags(whole_motion=True), at=0.5)


def test_bodies_in_space_are_seen_from_the_side(tmp_path: Path) -> None:
    rest = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    path = tmp_path / "cube.npz"
    np.savez(path, rest=rest, deformed=rest + np.array([0.0, 0.0, 0.01]), held=[0, 1, 2, 3])
    subject = PairSubject(BetaConfig((str(path),)))
    drawn = subject.in_picture(rest)
    width, height = subject.size_px
    assert (drawn >= 0).all()
    assert (drawn <= [width, height]).all()
    low, high = drawn[0], drawn[1]  # z upwards in the picture
    assert high[1] < low[1]
    assert high[0] == low[0]
