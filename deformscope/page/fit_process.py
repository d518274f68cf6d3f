"""The process of a fit beside a rig: that of a camera whose page and pictures are at the other end of a pipe."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from deformscope.arrays import ImageArray
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.experiments.live_stages import Beside
from deformscope.experiments.stage_processes import StageProcesses
from deformscope.page.camera_fitting import CameraFitting
from deformscope.page.fit import words_of
from deformscope.page.fit_camera import CameraSubject
from deformscope.page.server.desk import PageRun
from deformscope.page.server.messages import Phase, StopRun
from deformscope.stages.msm.quiet import quiet_warp

NICE = 5
"""What reads devices and moves a robot goes first; what computes the flow comes after it, at nice 10."""


def fit_a_camera(config: BetaConfig | ThetaConfig, next_folder: Callable[[], Path], pipe: Connection) -> None:
    """Go on until a `StopRun` comes, or the pipe ends.

    The pipe gives ("picture", image) after each ("want",), and ("command", of a page). It is given ("fit", state, its
    commands or None), ("file", as `PageServer.offer`), and ("ended", why) where it could not go on.
    """
    os.setpriority(os.PRIO_PROCESS, 0, max(NICE, os.getpriority(os.PRIO_PROCESS, 0)))
    quiet_warp()
    desk, over = AfarDesk(pipe), threading.Event()
    try:
        with StageProcesses(("flow",), quiet_warp) as processes:
            camera = AfarCamera(config, processes["flow"], next_folder, pipe)
            threading.Thread(target=_heed, args=(pipe, camera, desk, over), daemon=True).start()
            camera.begin(lambda: "the fit was ended" if over.is_set() else "")
            fitting = CameraFitting(desk, config, camera, desk.offer)
            fitting.keeps_last = False  # only what somebody held is anybody's
            if not over.is_set():
                fitting.until_finished()
    except Exception as error:
        pipe.send(("ended", words_of(error)))


class AfarDesk:
    """`FitDesk` at the other end of a pipe."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self.run: PageRun | None = None

    def attend(self, run: PageRun) -> None:
        """As `Desk.attend`."""
        self.run = run

    def enter(self, phase: Phase, **changes: Any) -> None:
        """As `Desk.enter`; the phase is that of what goes on there."""
        self.show(**changes)

    def show(self, **changes: Any) -> None:
        """As `Desk.show`, of the fit and its commands."""
        self._pipe.send(("fit", changes["fit"], changes.get("commands")))

    def absent(self) -> str:
        """As `Desk.absent`; who is looking is known there."""
        return ""

    def offer(self, name: str, content: bytes, media_type: str) -> None:
        """As `PageServer.offer`."""
        self._pipe.send(("file", name, content, media_type))


class AfarCamera(CameraSubject):
    """A camera at the other end of a pipe: a picture comes where one is wanted."""

    def __init__(
        self, config: BetaConfig | ThetaConfig, beside: Beside, next_folder: Callable[[], Path], pipe: Connection
    ) -> None:
        super().__init__(config.images.camera or "", config.images.flow, beside, next_folder)
        self._pipe = pipe
        self._wants = False
        self._want()

    def saw(self, image: ImageArray) -> None:
        """As `CameraSubject.saw`."""
        self._wants = False
        super().saw(image)

    def ask(self, call: Callable[[], None]) -> None:
        """As `CameraSubject.ask`; meanwhile the next one comes."""
        self._want()
        super().ask(call)

    def _want(self) -> None:
        if not self._wants:
            self._wants = True
            self._pipe.send(("want",))


def _heed(pipe: Connection, camera: CameraSubject, desk: AfarDesk, over: threading.Event) -> None:
    """Take what comes. over: is set where the end comes before the fit has begun"""
    while True:
        try:
            kind, what = pipe.recv()
        except (EOFError, OSError):
            kind, what = "command", StopRun(0)
        if kind == "picture":
            camera.saw(what)
            continue
        if isinstance(what, StopRun):
            over.set()
        if desk.run is not None:
            desk.run.obey(what)
        if over.is_set():
            return
