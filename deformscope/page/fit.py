"""A fit whose settings are made on a page, in a separate process: changes are simulated immediately, and only the
newest one counts."""

import contextlib
import dataclasses
import shlex
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from operator import itemgetter
from typing import Any

import msgspec
import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.calibrate import PushFlags
from deformscope.config.options import command_line
from deformscope.errors import InputError
from deformscope.experiments.fit.calibration_inputs import fit_options, images_of
from deformscope.experiments.fit.found_body import BODY
from deformscope.page.fit_settings import COMMANDS, IN_PICTURE, images_with, settings_of
from deformscope.page.fit_source import FitSubject, Force, ImagesSubject, subject_of
from deformscope.page.server.fit_messages import FitResult, FitSettings, FitState, Points
from deformscope.page.server.messages import PageCommand, RunFit, SetFit, StopRun
from deformscope.pictures.evidence import Result, results_png
from deformscope.stages.fit.at_value import errors_of, simulate
from deformscope.stages.fit.estimate import Comparison, Estimate
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.stages.msm.solver import Msm
from deformscope.stages.see.particles import ParticleGrid

VALUES, COARSELY = 25, 5
"""Values of the error curve: one after the other while nothing changes, every fifth of them first."""
QUIET_S = 0.3
"""Time without a change after which it begins."""
BUSY_EVERY_S = 0.2
SHOWN_EVERY_S = 0.5
"""Shortest period at which newly followed frames are simulated and shown."""


class _SetAnew(Exception):
    """A setting has changed during a whole fit."""


class PageFit:
    """One thread computes, in `run`; another may `handle` requests of pages.

    config: config of the command, with which it begins; subject: source of the fit
    send: takes ("fit", state, commands that are possible) and ("file", as `PageServer.offer`)"""

    def __init__(self, config: BetaConfig | ThetaConfig, subject: FitSubject, send: Callable[..., None]) -> None:
        self._subject, self._send = subject, send
        self._base, self._images = config, images_of(config)
        self._began = settings_of(config, self._images)
        self._seen: tuple[object, Observation] | None = None
        self._sent: set[str] = set()
        self._newest = SetFit(0, 0, settings_of(config, subject.found or self._images))
        self._each_s = self._shown_s = 0.0
        self._body: tuple[Model, Observation, Msm] | None = None
        self._curve: list[float] = []
        self._found: BetaConfig | ThetaConfig | None = None
        self._news = threading.Condition()
        self._asked: SetFit | None = self._newest
        self._wants_fit = self._finished = False
        self._busy_s = 0.0
        self.config = config
        model = fit_options(config)
        first = self._newest.settings
        self.state = FitState(
            *(subject.kind, model.model.parameter, first, model.bounds, subject.size_px), scale=self._images.scale_from
        )
        self._show()

    def handle(self, command: PageCommand) -> None:
        """Have `run` carry out a request."""
        with self._news:
            match command:
                case StopRun():
                    self._finished = True
                case SetFit():
                    self._asked, self._wants_fit = command, False
                case RunFit():
                    self._wants_fit = True
            self._news.notify()

    def run(self) -> None:
        """Simulate and fit on requests of pages, until one of these stops the run. `config` then has the last
        settings."""
        while True:
            with self._news:
                if self._subject.goes_on:
                    pass
                elif not self._curve:
                    self._news.wait_for(self._is_wanted)
                elif not self.state.values:
                    self._news.wait_for(self._is_wanted, QUIET_S)
                asked, fit, finished = self._asked, self._wants_fit, self._finished
                self._asked = None
                # first what it is to be made of
                self._wants_fit = fit and (asked is not None or self._subject.goes_on)
            if asked is not None:
                self._set(asked)
            elif finished:
                return
            elif isinstance(self._subject, ImagesSubject) and self._subject.goes_on:
                self._follow(self._subject)
            elif fit:
                self._fit()
            elif self._curve:
                self._go_on_with_curve()

    @property
    def command(self) -> str:
        """The command that gives the same numbers at a terminal."""
        return shlex.join(command_line(f"calibrate {self.state.parameter}", self.config))

    def _is_wanted(self) -> bool:
        return self._asked is not None or self._wants_fit or self._finished

    # What is shown ---------------------------------------------------------------------------------------------------

    def _set(self, asked: SetFit) -> None:
        """Simulate the requested settings, and show the result."""
        self._curve, self._newest = [], asked
        try:
            self.config = config = self._config_of(asked.settings)
            if isinstance(self._subject, ImagesSubject):
                grid, held = self._subject.place(config)
                if self._subject.followed < 2:
                    self._show_at_rest(asked, grid, held)
                    return
            seen, body, model = self._prepared(config)
            value = float(asked.settings.beta if model.parameter == "beta" else asked.settings.theta)
            found = simulate(seen, model, np.array([value]), body)[0]
            error = errors_of([seen], value, [found])
            drawn = self._drawn(seen, found)
        except Exception as problem:  # whatever is set on a page, the next change may be better
            shown = {"settings": asked.settings, "number": asked.number, "command": self.command, "busy": ""}
            self._show(**shown, problem=format_error(problem))
            return
        same = self._found == dataclasses.replace(config, at=None)
        spread = np.linspace(*self.state.bounds, VALUES).tolist()
        self._curve = [value for first in range(COARSELY) for value in spread[first::COARSELY]]
        self._show(
            **drawn,
            problem="" if error.converged else "the simulation does not converge with these settings",
            values=(),
            errors=(),
            settings=asked.settings,
            number=asked.number,
            command=self.command,
            aee=error.aee,
            aee_free=error.aee_free,
            busy=self._progress(),
            found=self.state.found if same else None,
            picture=self.state.picture if same else "",
        )

    def _show_at_rest(self, asked: SetFit, grid: ParticleGrid, held: IntArray) -> None:
        """The particles in the first frame, before any was followed."""
        rest = tuple((round(x, 2), round(y, 2)) for x, y in grid.rest_px.tolist())
        self._show(
            grid=grid.shape,
            spacing_px=float(grid.spacing_px[0]),
            rest=rest,
            observed=rest,
            simulated=(),
            seen=(True,) * len(rest),
            held=tuple(held.tolist()),
            unit="px",
            problem="",
            values=(),
            errors=(),
            settings=asked.settings,
            number=asked.number,
            command=self.command,
            aee=None,
            aee_free=None,
            busy=self._progress(),
            found=None,
            picture="",
        )

    def _follow(self, subject: ImagesSubject) -> None:
        """One more frame; what was asked for is shown in it, unless this was done a moment ago."""
        began_s = time.monotonic()
        try:
            subject.follow()
        except Exception as problem:
            self._show(problem=format_error(problem), busy="")
            return
        now_s = time.monotonic()
        self._each_s = 0.7 * (self._each_s or now_s - began_s) + 0.3 * (now_s - began_s)
        if not subject.goes_on or now_s - self._shown_s > SHOWN_EVERY_S:
            self._set(self._newest)
            self._shown_s = time.monotonic()

    def _progress(self) -> str:
        """How far the particles were followed, in words; empty once they were to the last frame."""
        done, count = self._subject.followed, self._subject.count
        if not self._subject.goes_on:
            return ""
        left = f", some {max(1.0, (count - done) * self._each_s):.0f} s left" if self._each_s else ""
        return f"frame {done} of {count}{left}"

    def _pictures(self) -> tuple[str, ...]:
        """Names of the images at rest and deformed, which pages may request by now."""
        if not isinstance(self._subject, ImagesSubject):
            return ()
        frames = {"rest.jpg": 0, f"frame{max(self._subject.followed, 1)}.jpg": max(self._subject.followed - 1, 0)}
        for name, frame in frames.items():
            if name not in self._sent:
                self._send("file", name, self._subject.picture(frame), "image/jpeg")
                self._sent.add(name)
        return tuple(frames)

    def _drawn(self, seen: Observation, found: Comparison) -> dict[str, Any]:
        """Particles as a page draws them."""

        def points(position: FloatArray) -> Points:
            return tuple((round(x, 2), round(y, 2)) for x, y in self._subject.in_picture(position).tolist())

        across = np.unique(seen.rest[:, 0])
        spacing = float(np.diff(across).min()) if self._subject.kind == "images" and len(across) > 1 else None
        shape = None if seen.shape is None or len(seen.shape) != 2 else (seen.shape[0], seen.shape[1])
        return {
            "grid": shape,
            "spacing_px": spacing,
            "rest": points(found.rest),
            "observed": points(found.observed),
            "simulated": points(found.simulated),
            "seen": tuple(found.seen.tolist()),
            "held": tuple(found.held.tolist()),
            "unit": found.unit,
        }

    def _go_on_with_curve(self) -> None:
        """One more value, between two checks for new requests; one that cannot be simulated has no error, and is
        reported."""
        value = self._curve.pop(0)
        error: float | None = None
        try:
            seen, body, model = self._prepared(self.config)
            error = errors_of([seen], value, simulate(seen, model, np.array([value]), body)).aee
        except Exception as problem:
            self._show(problem=f"at {self.state.parameter} {value:.3f}: {format_error(problem)}")
        known = sorted([*zip(self.state.values, self.state.errors, strict=True), (value, error)], key=itemgetter(0))
        values, errors = zip(*known, strict=True)
        self._show(values=values, errors=errors)

    def _fit(self) -> None:
        """The parameter with its interval, as the command finds it; left where something else is set meanwhile."""
        try:
            named = any(getattr(self.config.images, one) is not None for one in BODY)
            doubts = tuple(one for one in self._subject.doubts if not (named and one.code == "body-unsure"))
            options = dataclasses.replace(fit_options(self.config), doubts=doubts)
            found = self._subject.fit(self.config, options, self._note)
            picture = results_png([Result(found.estimate, found.comparisons[-1:], ("",))])
            self._send("file", "fit.png", picture, "image/png")
            self._found = dataclasses.replace(self.config, at=None)
            self._show(found=found_of(found.estimate, self.command), picture="fit.png", busy="")
        except _SetAnew:
            self._show(busy="")
        except Exception as problem:
            self._show(problem=format_error(problem), busy="")

    def _note(self, what: str, done: int, total: int) -> None:
        with self._news:
            if self._asked is not None or self._finished:
                raise _SetAnew
        now_s = time.monotonic()
        if now_s - self._busy_s > BUSY_EVERY_S:
            self._busy_s = now_s
            self._show(busy=f"{what}: {done} of {total}" if total else what)

    def _prepared(self, config: BetaConfig | ThetaConfig) -> tuple[Observation, Msm, Model]:
        """The observed positions, in the model; both are reused until their settings change."""
        key = config.images, config.search.noise_px, self._subject.followed
        if self._seen is None or self._seen[0] != key:
            self._seen = key, self._subject.observe(config)
        _, seen = self._seen
        model = fit_options(config).model
        alike = dataclasses.replace(model, beta=0.0, theta=0.0)  # a body has neither
        if self._body is None or self._body[0] != alike or self._body[1] is not seen:
            self._body = alike, seen, model.body(seen)
        return seen, self._body[2], model

    def _config_of(self, asked: FitSettings) -> BetaConfig | ThetaConfig:
        """The command's options with the settings; unchanged ones are left out. Raises InputError where they do not go
        together."""
        config, began = self._base, self._began
        if any(getattr(asked, name) != getattr(began, name) for name in IN_PICTURE):
            config = dataclasses.replace(config, images=images_with(self._images, asked))
        elif self._subject.found is not None:  # all of the picture: with no option, the command would find the body
            roi = (0.0, 0.0, *self._subject.size_px)
            config = dataclasses.replace(config, images=dataclasses.replace(self._images, roi=roi))
        if asked.cluster_size != began.cluster_size:
            config = dataclasses.replace(config, cluster_size=asked.cluster_size)
        if isinstance(config, BetaConfig):
            theta = config.theta if asked.theta == began.theta else asked.theta
            return dataclasses.replace(config, theta=theta, at=asked.beta)
        return dataclasses.replace(config, beta=asked.beta, at=asked.theta)

    def _show(self, **changes: Any) -> None:
        self.state = msgspec.structs.replace(self.state, pictures=self._pictures(), **changes)
        self._send("fit", self.state, COMMANDS)


def format_error(problem: Exception) -> str:
    """An error in one line, for the page."""
    return " ".join(str(problem).split()) or type(problem).__name__


def found_of(estimate: Estimate, command: str) -> FitResult:
    """A whole fit for a page. command: command that gives this result"""
    low, high = estimate.interval
    words = estimate.verdict_text(), "" if estimate.force is None else estimate.stiffness_text()
    return FitResult(command, estimate.value, low, high, estimate.level, estimate.aee_free, *words)


# Its process ---------------------------------------------------------------------------------------------------------


def run_fit(config: BetaConfig | ThetaConfig, read_force: Callable[[PushFlags], Force], pipe: Connection) -> None:
    """Run the fit until a `StopRun` comes, or the pipe ends. read_force: see `subject_of`

    The pipe gives commands of a page. It is given the messages of a `PageFit`, ("note", a step before it), and ("end",
    the last options, or an error)."""
    quiet_warp()

    def send(*message: object) -> None:
        pipe.send(message)

    try:
        fit = PageFit(config, subject_of(config, lambda words: send("note", words), read_force), send)
        threading.Thread(target=_dispatch, args=(pipe, fit), daemon=True).start()
        fit.run()
        outcome: BetaConfig | ThetaConfig | Exception = fit.config
    except Exception as error:  # as it can travel
        outcome = error if isinstance(error, InputError | OSError) else RuntimeError(format_error(error))
    with contextlib.suppress(OSError):
        send("end", outcome)


def _dispatch(pipe: Connection, fit: PageFit) -> None:
    """Pass on requests, until the fit is to end."""
    command: Any = None
    while not isinstance(command, StopRun):
        try:
            command = pipe.recv()
        except (EOFError, OSError):
            command = StopRun(0)
        fit.handle(command)
