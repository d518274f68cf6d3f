"""A fit that is set on a page while a camera goes on: its newest picture is fitted, until somebody holds one."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from deformscope.config import BetaConfig, ThetaConfig
from deformscope.page.fit import COMMANDS, QUIET_S, VALUES, FitDesk, PageFitting, words_of
from deformscope.page.fit_camera import CameraSubject
from deformscope.page.server.messages import FollowCamera, HoldPicture, Outcome, PageCommand, TakeRest
from deformscope.stages.fit.at_value import errors_of, simulate
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.msm.solver import Msm

PICTURE_NAMES = 8
"""So many pictures can still be asked for: a page draws one together with its particles."""
SWIFT_S = 0.15
"""The error curve of a picture is drawn while it does not take longer."""


class CameraFitting(PageFitting):
    """As `PageFitting`, of a camera. What is shown while it is followed is nobody's file: a picture that is held, also
    by a whole fit and at the end, is written together with the one at rest, and the command line names both."""

    def __init__(
        self,
        desk: FitDesk,
        config: BetaConfig | ThetaConfig,
        camera: CameraSubject,
        offer: Callable[[str, bytes, str], None],
    ) -> None:
        self._camera = camera
        self._following = True
        self._command: TakeRest | HoldPicture | FollowCamera | None = None
        self._pictures = time.monotonic_ns() // 10**6  # no page has one of this name from before
        self._curve_s = 0.0
        super().__init__(desk, config, camera, offer)
        self._show_following(True)

    def obey(self, command: PageCommand) -> tuple[Outcome, str]:
        """As `PageRun.obey`."""
        if not isinstance(command, TakeRest | HoldPicture | FollowCamera):
            return super().obey(command)
        with self._news:
            self._command = command
            self._news.notify()
        return "begun", ""

    @property
    def result_config(self) -> BetaConfig | ThetaConfig:
        """As `PageFitting.result_config`. Raises InputError where pictures could not be kept."""
        return self._camera.named(self.config)

    @property
    def command(self) -> str:
        """As `PageFitting.command`."""
        return "" if self._following else super().command

    def _wait(self) -> None:
        if not self._following:
            super()._wait()
            return
        if not self._desk.absent():  # nothing is computed for nobody
            self._camera.ask(self._wake)
        self._news.wait_for(self._is_wanted, QUIET_S)

    def _wake(self) -> None:
        with self._news:
            self._news.notify()

    def _is_wanted(self) -> bool:
        return super()._is_wanted() or self._command is not None or (self._following and self._camera.is_ready)

    def _begin_step(self, *, whole: bool) -> None:
        with self._news:
            command, self._command = self._command, None
        match command:
            case TakeRest():
                self._camera.take_rest()
            case FollowCamera():
                self._show_following(True)
        if self._following and (whole or isinstance(command, HoldPicture)):
            self._hold()
        elif self._following and self._camera.is_ready:
            self._go_on()

    def _go_on(self) -> None:
        """Show the newest picture, and the model of it."""
        try:
            self._camera.go_on()
        except Exception as problem:
            self._show(problem=words_of(problem))
            return
        self._seen = self._found = None
        self._set(self._shown, self._offer_images())

    def _hold(self) -> None:
        """What is shown becomes files."""
        try:
            self._camera.keep()
        except Exception as problem:
            self._show(problem=f"the pictures cannot be kept: {words_of(problem)}")
            return
        self._show_following(False)
        self._set(self._shown)

    def _show_following(self, following: bool) -> None:
        self._following = following
        self.state = msgspec.structs.replace(self.state, camera=self._camera.camera, following=following)
        more = ("take-rest", "hold-picture") if following else ("follow-camera",)
        self._desk.show(commands=(*COMMANDS, *more), fit=self.state)

    def _offer_images(self, of: str = "") -> tuple[str, ...]:
        self._pictures += 1
        names = super()._offer_images(f"-{self._pictures % PICTURE_NAMES}")
        return tuple(f"{name}?{self._pictures}" for name in names)

    def _begun_curve(self, seen: Observation, body: Msm, model: Model) -> dict[str, Any]:
        """While a camera is followed: all of it at once, or none."""
        if not self._following:
            return super()._begun_curve(seen, body, model)
        self._curve = []
        if self._curve_s > SWIFT_S:
            self._curve_s *= 0.9  # with other settings it may be swifter
            return {"values": (), "errors": ()}
        began_s = time.monotonic()
        values = np.linspace(*self.state.bounds, VALUES)[::2]
        try:
            found = simulate(seen, model, values, body)
            errors = [errors_of([seen], value, [one]).aee for value, one in zip(values.tolist(), found, strict=True)]
        except Exception as problem:
            return {"values": (), "errors": (), "problem": f"no error curve: {words_of(problem)}"}
        self._curve_s = time.monotonic() - began_s
        return {"values": tuple(values.tolist()), "errors": tuple(errors)}
