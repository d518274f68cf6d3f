"""A fit on the page of a rig that is shown or recorded: of one of its cameras' images, without delaying it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.images import ImageOptions
from deformscope.file_io import new_recording
from deformscope.frames import Stream
from deformscope.page.devices import picture_of
from deformscope.page.fit_process import FitProcess
from deformscope.page.fit_settings import images_with
from deformscope.page.server.fit_messages import FitResult, FitSettings, FitState
from deformscope.page.server.messages import CloseFit, OpenFit, Outcome, PageCommand
from deformscope.page.server.page_server import PageServer


class FitPanel:
    """`PageRun` of a page, besides that of the main session. No fit begins before a page requests it.

    rig: the rig's name on a command line; folder: where held pictures go; name: beginning of the names of its commands
    images: options with which a fit begins; their camera is followed first, None = the first camera
    """

    def __init__(self, rig: str, folder: Path, name: str, images: ImageOptions | None = None) -> None:
        self._rig, self._folder, self._name = rig, folder, name
        self._images = images or ImageOptions()
        self._cameras: tuple[str, ...] = ()
        self._fit: FitProcess | None = None
        self._reported: set[FitResult] = set()

    def bind(self, page: PageServer, streams: Sequence[Stream], found: Callable[[str], None]) -> None:
        """From now on a page can open the panel, if there is a camera. found: called once with each whole fit, in
        words"""
        self._page, self._found = page, found
        self._cameras = tuple(one.device for kind in ("color", "depth") for one in streams if one.kind == kind)
        if self._cameras:
            page.session.bind_secondary(self)
            page.session.show_secondary(("open-fit",))

    def on_items(self, items: Sequence[object]) -> None:
        """The devices' items. Called by the thread that receives the items, which does not wait."""
        fit = self._fit
        if fit is not None:
            camera = fit.state.camera
            image = next((one for item in reversed(items) if (one := picture_of(item, camera)) is not None), None)
            if image is not None:
                fit.on_picture(image)

    def handle(self, command: PageCommand) -> tuple[Outcome, str]:
        """See `PageRun.handle`."""
        fit = self._fit
        if isinstance(command, OpenFit):
            return self._open(command)
        if fit is None or not fit.goes_on:
            return "refused", "no fit is running"
        if isinstance(command, CloseFit):
            self._show(fit, shown=False)
            return "done", "its settings are unchanged"
        return fit.handle(command)

    def close(self) -> None:
        """End the fit, and print the command of its numbers at the terminal."""
        if self._fit is not None:
            self._fit.close()

    def _open(self, command: OpenFit) -> tuple[Outcome, str]:
        before = self._fit
        camera = command.camera or (self._images.camera or self._cameras[0] if before is None else before.state.camera)
        if camera not in self._cameras:
            return "refused", f"expected one of {', '.join(self._cameras)}; got {camera}"
        images = dataclasses.replace(self._images, camera=camera)
        if before is not None:
            if before.goes_on and (before.state.camera, before.state.parameter) == (camera, command.parameter):
                self._show(before, shown=True)
                return "done", ""
            before.end()
            if before.state.camera == camera and before.state.number:
                images = images_with(images, before.state.settings)
        config = (BetaConfig if command.parameter == "beta" else ThetaConfig)((self._rig,), images=images)
        began = FitState(
            "images",
            command.parameter,
            FitSettings(),
            camera=camera,
            following=True,
            cameras=self._cameras,
            busy=f"the fit of {camera} begins, which takes some seconds",
        )
        next_folder = partial(new_recording, self._folder, f"{self._name}-{camera}", "")
        self._fit = FitProcess(config, began, self._page, self._changed, next_folder).start()
        self._show(self._fit, shown=True)
        return "begun", f"of {camera}"

    def _show(self, fit: FitProcess, *, shown: bool) -> None:
        """On the page, or not: then it gets no pictures."""
        fit.is_shown = shown
        commands = ("close-fit", *(one for one in fit.commands if one != "stop")) if shown else ()
        self._page.session.show_secondary(("open-fit", *commands), fit=fit.state if shown else None)

    def _changed(self, fit: FitProcess) -> None:
        if not fit.goes_on:
            if not fit.ending:
                why = " ".join(str(fit.outcome).split())
                self._page.session.remark(f"no fit of {fit.state.camera} any longer: {why}", bad=True)
                self._show(fit, shown=False)
            return
        if fit.is_shown:
            self._show(fit, shown=True)
        found = fit.state.found
        if found is not None and found not in self._reported:  # one that ends may still say so after another began
            self._reported.add(found)
            self._found(_to_text(fit.state, found))


def _to_text(state: FitState, found: FitResult) -> str:
    between = f"{found.low:.3f} to {found.high:.3f} ({found.level:.0%})"
    return f"fit of {state.camera}: {state.parameter} {found.value:.4f}, {between}, {found.verdict}: {found.command}"
