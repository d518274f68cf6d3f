"""A fit that is set on the page of a rig that goes on: in its own process, of pictures that the rig gave."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

pytest.importorskip("rerun")

from deformscope.config import BetaConfig
from deformscope.config.images import ImageOptions
from deformscope.errors import InputError
from deformscope.frames import ColorFrame, DepthFrame, Stream
from deformscope.page import fit as page_fit
from deformscope.page import fit_process
from deformscope.page.fit import run_fit
from deformscope.page.fit_panel import FitPanel
from deformscope.page.server.fit_messages import FitResult, FitSettings, FitState
from deformscope.page.server.messages import CloseFit, HoldPicture, OpenFit, RunFit, StopRun, TakeRest
from deformscope.page.server.page_server import PageServer
from deformscope.runs.recordings import OpenRecording
from deformscope.session import Inline
from deformscope_drivers.clock import Stamp
from tests.page.pages import page_script
from tests.page.test_fit import typed
from tests.page.test_fit_of_camera import folder_camera, rig_of, stretched
from tests.page.test_rig_on_page import WHOLE, started
from tests.patience import PATIENCE_S

TIP = '[devices.tip]\ndriver = "optoforce"\ndouble = true\nrate_hz = 100\n'


STREAMS = (
    Stream("tip", "wrench", "x"),
    Stream("depth", "depth", "x"),
    *(Stream(name, "color", "x") for name in ("side", "top")),
)


class Beside:
    """A fit beside a rig, whose process is this test. pipes: its ends, of each process that was begun"""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.page, self.found = PageServer("bench"), list[str]()
        self.pipes: list[Connection] = []
        self.configs: list[Any] = []
        monkeypatch.setattr(fit_process, "child_process", self._process)
        self.page.session.come("a")
        self.page.session.enter("live", commands=("stop", "tare"))
        self.fit = FitPanel("rig.toml", Path("runs"), "bench")
        self.fit.bind(self.page, STREAMS, self.found.append)

    @contextmanager
    def _process(self, name: str, target: Any, *, makes_others: bool, nice: int) -> Iterator[Connection]:
        ours, theirs = Pipe()
        self.configs.append(target.args[0])
        self.pipes.append(theirs)
        yield ours
        ours.close()

    def ask(self, command: Any) -> tuple[str, str]:
        reply = self.page.session.command("a", command)
        return reply.outcome, reply.words

    def see(self, index: int, camera: str = "side") -> None:
        self.fit.on_items(
            [ColorFrame(Stamp(index), index, np.full((2, 2, 3), index, np.uint8), camera), "another item"]
        )

    def until(self, wanted: Any) -> Any:
        came = threading.Event()
        end = self.page.session.watch(lambda: came.set() if wanted(self.page.session.state) else None)
        assert wanted(self.page.session.state) or came.wait(PATIENCE_S)
        end()
        return self.page.session.state

    def opened(self, parameter: Any = "beta", camera: str | None = None) -> Connection:
        count = len(self.pipes)
        assert self.ask(OpenFit(1, parameter, camera))[0] == "begun"
        for _ in range(int(100 * PATIENCE_S)):
            if len(self.pipes) > count:
                return self.pipes[-1]
            threading.Event().wait(0.01)
        raise AssertionError("no process")

    def ended(self) -> None:
        fit = self.fit._fit
        assert fit is not None
        for pipe in self.pipes:
            pipe.close()
        fit.thread.join(PATIENCE_S)
        assert not fit.thread.is_alive()


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> Beside:
    return Beside(monkeypatch)


def received(pipe: Connection) -> Any:
    assert pipe.poll(PATIENCE_S), "nothing came"
    return pipe.recv()


STATE = FitState("images", "beta", FitSettings(roi=(1, 2, 3, 4)), camera="side", number=3, command="deformscope x")


def test_pictures_go_where_they_are_wanted_and_looked_at(beside: Beside) -> None:
    session = beside.page.session
    assert list(session.state.commands) == ["stop", "tare", "open-fit"]
    assert beside.ask(OpenFit(1, "beta", "tip"))[1] == "expected one of side, top, depth; got tip"
    assert beside.ask(HoldPicture(2))[0] == "refused"
    pipe = beside.opened()
    assert session.state.fit is not None
    assert (session.state.fit.camera, session.state.fit.cameras) == ("side", ("side", "top", "depth"))
    assert "takes some seconds" in session.state.fit.busy
    assert "set-fit" not in session.state.commands

    fit = beside.fit._fit
    assert fit is not None

    def wants() -> None:
        pipe.send(("want",))
        pipe.send(("fit", STATE, ("stop", "set-fit", "hold-picture", "take-rest")))
        beside.until(lambda state: state.fit is not None and state.fit.number == 3)
        while not fit._wanted:
            threading.Event().wait(0.01)

    session.beat("a", visible=True)
    beside.see(1)  # nobody asked for it yet; it begins with what it sees
    assert not pipe.poll(0.05)
    pipe.send(("want",))
    assert received(pipe)[1][0, 0, 0] == 1
    wants()
    assert list(session.state.commands)[2:] == ["open-fit", "close-fit", "set-fit", "hold-picture", "take-rest"]
    session.beat("a", visible=False)
    beside.see(2)  # nobody would look at it
    session.beat("a", visible=True)
    threading.Event().wait(session.state.beat_s + 0.1)
    beside.see(2)  # frozen or gone: not heard of
    session.beat("a", visible=True)
    beside.see(3, "top")  # another camera
    beside.see(4)
    beside.see(5)  # it asked for one
    assert received(pipe)[1][0, 0, 0] == 4
    assert beside.ask(TakeRest(3))[0] == "begun"  # what is seen at that moment
    assert received(pipe)[1][0, 0, 0] == 5
    assert received(pipe) == ("command", TakeRest(3))

    assert beside.ask(CloseFit(4))[0] == "done"
    assert session.state.fit is None
    assert list(session.state.commands) == ["stop", "tare", "open-fit"]
    pipe.send(("want",))
    while not fit._wanted:
        threading.Event().wait(0.01)
    beside.see(6)
    assert beside.ask(OpenFit(5, "beta"))[0] == "done"  # it is as it was left
    assert session.state.fit is not None
    assert session.state.fit.number == 3
    beside.see(7)
    assert received(pipe)[1][0, 0, 0] == 7
    beside.ended()


def test_a_depth_cameras_colour_is_taken(beside: Beside) -> None:
    pipe = beside.opened(camera="depth")
    pipe.send(("want",))
    fit = beside.fit._fit
    assert fit is not None
    while not fit._wanted:
        threading.Event().wait(0.01)
    beside.page.session.beat("a", visible=True)
    colour = np.full((2, 2, 3), 9, np.uint8)
    for image in (None, colour):
        beside.fit.on_items([DepthFrame(Stamp(0), 0, np.zeros((2, 2), np.uint16), 1e-3, image, device="depth")])
    assert (received(pipe)[1] == colour).all()
    beside.ended()


def test_what_was_found_is_said_and_what_ends_it_too(beside: Beside, capsys: pytest.CaptureFixture[str]) -> None:
    pipe = beside.opened()
    pipe.send(("fit", STATE, ("set-fit",)))
    found = FitResult("deformscope x", 0.5, 0.4, 0.6, 0.9, 1.0, "weak")
    for busy in ("a", "b"):
        pipe.send(("fit", msgspec.structs.replace(STATE, found=found, busy=busy), ("set-fit",)))
    beside.until(lambda state: state.fit is not None and state.fit.busy == "b")
    assert beside.found == ["fit of side: beta 0.5000, 0.400 to 0.600 (90%), weak: deformscope x"]

    other = beside.opened("theta")  # with what was drawn on the picture
    assert received(pipe) == ("command", StopRun(0))
    assert "as set on the page: deformscope x" in capsys.readouterr().err
    pipe.close()
    assert [one.images.roi for one in beside.configs] == [None, (1, 2, 3, 4)]
    assert [type(one).__name__ for one in beside.configs] == ["BetaConfig", "ThetaConfig"]

    other.send(("end", InputError("pictures of the camera", "none")))
    other.close()
    state = beside.until(lambda state: state.remarks)
    assert state.remarks[-1].words == "no fit of side any longer: expected pictures of the camera; got none"
    beside.until(lambda state: state.fit is None)
    again = beside.opened("theta")
    again.close()
    beside.ended()


def test_a_result_is_said_once_also_where_another_fit_begins_meanwhile(beside: Beside) -> None:
    found = FitResult("deformscope x", 0.5, 0.4, 0.6, 0.9, 1.0, "weak")
    first = beside.opened()
    first.send(("fit", msgspec.structs.replace(STATE, found=found), ("set-fit",)))
    beside.until(lambda state: state.fit is not None and state.fit.found == found)
    ending = beside.fit._fit
    assert ending is not None
    second = beside.opened(camera="top")
    second.send(("fit", msgspec.structs.replace(STATE, camera="top", busy="new"), ("set-fit",)))
    beside.until(lambda state: state.fit is not None and state.fit.busy == "new")
    first.send(("fit", msgspec.structs.replace(STATE, found=found, busy="ends"), ("set-fit",)))
    first.send(("end", None))
    ending.thread.join(PATIENCE_S)
    assert ending.state.busy == "ends"
    assert len(beside.found) == 1
    beside.ended()


def test_in_its_process_it_is_the_same_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a thread of this process, whose priority stays as it is."""
    changed: list[tuple[int, ...]] = []
    monkeypatch.setattr(os, "setpriority", lambda *given: changed.append(given))
    monkeypatch.setattr(page_fit, "StageProcesses", lambda *given, **also: nullcontext({"flow": Inline()}))
    ours, theirs = Pipe()
    config = BetaConfig(("rig.toml",), images=ImageOptions(camera="side", roi=(6, 5, 88, 105), grid=(5, 4)))
    thread = threading.Thread(target=run_fit, args=(config, lambda: tmp_path, False, theirs))
    thread.start()
    assert received(ours) == ("want",)
    assert not ours.poll(0.05)  # one at a time
    ours.send(("picture", stretched(0)))

    def until(wanted: Any) -> Any:
        while True:
            kind, *what = received(ours)
            if kind == "fit" and wanted(what[0]):
                return what[0]

    until(lambda fit: fit.aee and fit.aee < 1e-3)
    ours.send(("picture", stretched(3)))
    until(lambda fit: fit.aee and fit.aee > 1e-3)
    ours.send(("command", RunFit(0)))
    found = until(lambda fit: fit.found).found
    assert found.command.startswith(f"deformscope calibrate beta {tmp_path}")
    files = sorted(tmp_path.iterdir())
    ours.close()  # nobody reads on
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert sorted(tmp_path.iterdir()) == files  # only what was held is kept
    assert not changed


@pytest.mark.slow
def test_a_fit_is_set_while_a_rig_is_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, file = rig_of(tmp_path, TIP, folder_camera(tmp_path)), tmp_path / "mine.rrd"
    with started("record", str(rig), "--record", str(file), folder=tmp_path) as command:
        with page_script(command.page, "a") as one, one.beating():
            one.until(lambda state: "open-fit" in state["commands"])
            assert one.command("set-fit", number=1, settings={})[0] == "refused"
            assert one.command("open-fit", parameter="beta", camera="tip")[0] == "refused"
            assert one.command("open-fit", parameter="beta")[0] == "begun"
            began = one.until(lambda state: state["fit"] and state["fit"]["aee"])
            assert began["fit"]["camera"] == "side"
            assert one.command("hold-picture")[0] == "begun"
            one.until(lambda state: not state["fit"]["following"])
            settings = one.state["fit"]["settings"] | {"beta": 0.37, "roi": [6, 5, 88, 105]}
            assert one.command("set-fit", number=7, settings=settings)[0] == "begun"
            fit = one.until(lambda state: state["fit"]["number"] == 7)["fit"]
            assert one.command("run-fit")[0] == "begun"
            found = one.until(lambda state: state["fit"]["found"])["fit"]["found"]
            assert one.command("close-fit")[0] == "done"
            closed = one.until(lambda state: state["fit"] is None)
            assert closed["phase"] == "recording"
            assert "set-fit" not in closed["commands"]
            assert one.command("open-fit", parameter="beta")[0] == "done"  # as it was left
            assert one.until(lambda state: state["fit"])["fit"]["found"] == found
            assert one.command("open-fit", parameter="theta")[0] == "begun"
            other = one.until(lambda state: state["fit"]["parameter"] == "theta" and state["fit"]["aee"])["fit"]
            assert other["settings"]["roi"] == [6, 5, 88, 105]  # what was drawn stays
            assert one.command("stop")[0] == "done"
        command.ended()
    assert command.status in WHOLE
    assert f"as set on the page: {fit['command']}" in capsys.readouterr().err
    came = typed(fit["command"], capsys)
    at = came["settings"]["at"]
    assert (at["value"], at["aee"], at["aee_free"]) == (0.37, fit["aee"], fit["aee_free"])
    assert [came["value"], *came["interval"]] == [found["value"], found["low"], found["high"]]
    recorded = OpenRecording(file)
    assert any(note.text.endswith(fit["command"]) for note in recorded.notes())
    indices = [item.index for item in recorded.items() if isinstance(item, ColorFrame)]
    assert indices == list(range(indices[-1] + 1))
    assert not [thread for thread in threading.enumerate() if thread.name == "deformscope-fit"]
