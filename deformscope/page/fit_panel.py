"""A fit on the page of a rig that is watched, or explores: of what one of its cameras sees, and without holding it up.

All is computed in a process of its own (`deformscope.page.fit_process`), which asks for the newest picture when it is
ready for one. What reads devices and moves a robot hands over a few a second, and none while nobody looks at the fit.
"""

from __future__ import annotations

import dataclasses
import queue
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import msgspec

from deformscope.arrays import ImageArray
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.images import ImageOptions
from deformscope.file_io import new_recording
from deformscope.frames import Stream
from deformscope.page.devices import picture_of
from deformscope.page.fit_settings import images_with
from deformscope.page.server.fit_messages import FitSettings, FitState
from deformscope.page.server.messages import CloseFit, OpenFit, Outcome, PageCommand, StopRun, TakeRest
from deformscope.page.server.page_server import PageServer
from deformscope.processes import END_S, beside
from deformscope.terminal import say


class FitBeside:
    """`PageRun` of a page, beside that of what goes on. Nothing begins before a page asks for it.

    rig: as a command line names it; folder: where held pictures go; name: theirs begin so
    images: options that a fit begins with; their camera is the one that it begins with, None = the first
    """

    def __init__(self, rig: str, folder: Path, name: str, images: ImageOptions | None = None) -> None:
        self._rig, self._folder, self._name = rig, folder, name
        self._images = images or ImageOptions()
        self._cameras: tuple[str, ...] = ()
        self._fit: FitProcess | None = None

    def attend(self, page: PageServer, streams: Sequence[Stream], found: Callable[[str], None]) -> None:
        """From now on a page can open it, where there is a camera. found: is given each whole fit, in words"""
        self._page, self._found = page, found
        self._cameras = tuple(one.device for kind in ("color", "depth") for one in streams if one.kind == kind)
        if self._cameras:
            page.desk.attend_aside(self)
            page.desk.show_aside(("open-fit",))

    def saw(self, items: Sequence[object]) -> None:
        """What the devices gave. From the thread that takes it, which does not wait."""
        fit = self._fit
        if fit is not None:
            image = next((one for item in reversed(items) if (one := picture_of(item, fit.camera)) is not None), None)
            if image is not None:
                fit.saw(image)

    def obey(self, command: PageCommand) -> tuple[Outcome, str]:
        """As `PageRun.obey`."""
        fit = self._fit
        if isinstance(command, OpenFit):
            return self._open(command)
        if fit is None or not fit.goes_on:
            return "refused", "no fit goes on"
        if isinstance(command, CloseFit):
            fit.show(looked_at=False)
            return "done", "what is set there stays"
        fit.obey(command)
        return "begun", ""

    def close(self) -> None:
        """End it, and say at the terminal what gives its numbers."""
        if self._fit is not None:
            self._fit.end()
            self._fit.thread.join(3 * END_S)

    def _open(self, command: OpenFit) -> tuple[Outcome, str]:
        before = self._fit
        camera = command.camera or (self._images.camera or self._cameras[0] if before is None else before.camera)
        if camera not in self._cameras:
            return "refused", f"expected one of {', '.join(self._cameras)}; got {camera}"
        images = dataclasses.replace(self._images, camera=camera)
        if before is not None:
            if before.goes_on and (before.camera, before.state.parameter) == (camera, command.parameter):
                before.show(looked_at=True)
                return "done", ""
            before.end()
            if before.camera == camera and before.state.number:
                images = images_with(images, before.state.settings)
        sources = (self._rig,)
        config = (BetaConfig if command.parameter == "beta" else ThetaConfig)(sources, images=images)
        began = FitState("images", command.parameter, FitSettings(), camera=camera, following=True)
        busy = f"the fit of {camera} begins, which takes some seconds"
        began = msgspec.structs.replace(began, cameras=self._cameras, busy=busy)
        target = partial(_fit, config, partial(new_recording, self._folder, f"{self._name}-{camera}", ""))
        self._fit = FitProcess(target, began, self._page, self._found)
        return "begun", f"of {camera}"


class FitProcess:
    """A fit that goes on in its process, as seen from here.

    target: of the process; state: as it began, and from then on as it was shown last; found: as `FitBeside.attend`
    thread: in which all comes that the process gives
    """

    def __init__(
        self, target: Callable[[Connection], None], state: FitState, page: PageServer, found: Callable[[str], None]
    ) -> None:
        self._target, self._page, self._found = target, page, found
        self.state, self.camera = state, state.camera
        self.goes_on = self._looked_at = True
        self._wanted = self._ending = False
        self._newest: ImageArray | None = None
        self._commands: tuple[str, ...] = ()
        self._why = "its process has died"
        self._out: queue.SimpleQueue[tuple[str, object] | None] = queue.SimpleQueue()
        self.show(looked_at=True)
        self.thread = threading.Thread(target=self._work, name="deformscope-fit", daemon=True)
        self.thread.start()

    def saw(self, image: ImageArray) -> None:
        """A picture came: it goes to the process where that waits for one, and somebody looks at it."""
        self._newest = image
        if self._wanted and self._looked_at and not self._page.desk.absent():
            self._wanted = False
            self._out.put(("picture", image))

    def obey(self, command: PageCommand) -> None:
        """Pass it on."""
        if isinstance(command, TakeRest) and self._newest is not None:  # what is seen at this moment
            self._out.put(("picture", self._newest))
        self._out.put(("command", command))

    def show(self, *, looked_at: bool) -> None:
        """On the page, or not: then it gets no pictures."""
        self._looked_at = looked_at
        commands = ("close-fit", *(one for one in self._commands if one != "stop")) if looked_at else ()
        self._page.desk.show_aside(("open-fit", *commands), fit=self.state if looked_at else None)

    def end(self) -> None:
        """From any thread, at once; `thread` then comes to its end."""
        if not self._ending:
            self._until_s = time.monotonic() + END_S  # while it begins it cannot heed what follows
            self._ending, self._looked_at = True, False
            self._out.put(("command", StopRun(0)))
            if self.state.command:
                say(f"as set on the page: {self.state.command}")

    def _work(self) -> None:
        try:
            with beside("fit", self._target, makes_others=True) as pipe:
                threading.Thread(target=self._send, args=(pipe,), daemon=True).start()
                while not self._ending or time.monotonic() < self._until_s:
                    if pipe.poll(0.5):
                        self._take(*pipe.recv())
        except (EOFError, OSError):
            pass
        finally:
            self.goes_on = False
            self._out.put(None)
            if not self._ending:
                self._page.desk.remark(f"no fit of {self.camera} any longer: {self._why}", bad=True)
                self.show(looked_at=False)

    def _send(self, pipe: Connection) -> None:
        while (message := self._out.get()) is not None:
            try:
                pipe.send(message)
            except (OSError, ValueError):  # it has ended
                return

    def _take(self, kind: str, *what: Any) -> None:
        """What the process gives."""
        match kind:
            case "want":
                self._wanted = True
            case "file" if not self._ending:  # else it may be one of another fit's by now
                self._page.offer(*what)
            case "ended":
                (self._why,) = what
            case "fit":
                state, commands = what
                before, self.state = self.state, msgspec.structs.replace(state, cameras=self.state.cameras)
                self._commands = commands or self._commands
                if self._looked_at:
                    self.show(looked_at=True)
                if state.found is not None and state.found != before.found:
                    self._found(_in_words(state))


def _in_words(state: FitState) -> str:
    found = state.found
    assert found is not None
    between = f"{found.low:.3f} to {found.high:.3f} ({found.level:.0%})"
    return f"fit of {state.camera}: {state.parameter} {found.value:.4f}, {between}, {found.verdict}: {found.command}"


def _fit(config: BetaConfig | ThetaConfig, next_folder: Callable[[], Path], pipe: Connection) -> None:
    """In the process, which alone loads what simulates."""
    from deformscope.page.fit_process import fit_a_camera

    fit_a_camera(config, next_folder, pipe)
