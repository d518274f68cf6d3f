"""A fit that is set on a page: what is changed there is simulated at once, and the newest change wins."""

from __future__ import annotations

import dataclasses
import shlex
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from operator import itemgetter
from typing import Any, Protocol

import msgspec
import numpy as np

from deformscope.arrays import FloatArray
from deformscope.calibration_options import fit_options, images_of
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.command_line import command_line
from deformscope.page.fit_settings import IN_PICTURE, images_with
from deformscope.page.fit_subject import FitSubject, subject_of
from deformscope.page.server.desk import PageRun
from deformscope.page.server.fit_messages import FitFound, FitSettings, FitState, Points
from deformscope.page.server.messages import FitDrawn, Outcome, PageCommand, Phase, RunFit, SetFit, StopRun
from deformscope.page.server.page_server import PageServer
from deformscope.pictures.evidence import Result, results_png
from deformscope.stages.fit.at_value import errors_of, simulate
from deformscope.stages.fit.calibrate import calibrate
from deformscope.stages.fit.estimate import Comparison, Estimate
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.stages.msm.solver import Msm

VALUES, COARSELY = 25, 5
"""Of the error curve: one after the other while nothing changes, every fifth of them first."""
QUIET_S = 0.3
"""It is begun once nothing was changed for so long."""
BUSY_EVERY_S = 0.2
MOST_CHANGES = 1000
"""Of so many, the newest, it is kept how long they took to be seen."""
COMMANDS = ("stop", "set-fit", "run-fit", "fit-drawn")


class _SetAnew(Exception):
    """Something else was set while a whole fit went on."""


class FitDesk(Protocol):
    """What a fit is shown on, and commands for it come from (`deformscope.page.server.desk.Desk`)."""

    def attend(self, run: PageRun) -> None: ...

    def enter(self, phase: Phase, **changes: Any) -> None: ...

    def show(self, **changes: Any) -> None: ...

    def absent(self) -> str: ...


class PageFitting:
    """`PageRun` of its page. One thread computes, in `until_finished`; the page's server only says what is wanted.

    config: of the command, with which it begins; offer: as `PageServer.offer`
    keeps_last: what is shown in the end is kept
    """

    keeps_last = True

    def __init__(
        self,
        desk: FitDesk,
        config: BetaConfig | ThetaConfig,
        subject: FitSubject,
        offer: Callable[[str, bytes, str], None],
    ) -> None:
        self._desk, self._subject, self._offer = desk, subject, offer
        self._base, self._images = config, images_of(config)
        self._began = _settings_of(config)
        self._seen: tuple[object, Observation, dict[str, object]] | None = None
        self._body: tuple[Model, Observation, Msm] | None = None
        self._curve: list[float] = []
        self._found: BetaConfig | ThetaConfig | None = None
        self._news = threading.Condition()
        self._asked: SetFit | None = SetFit(0, 0, self._began)
        self._shown = self._asked
        self._wants_fit = self._finished = False
        self._busy_s = 0.0
        self.drawn_ms: deque[float] = deque(maxlen=MOST_CHANGES)
        self.config = config
        model = fit_options(config)
        self.state = FitState(subject.kind, model.model.parameter, self._began, model.bounds, subject.size_px)
        self.state = msgspec.structs.replace(self.state, pictures=self._offer_images())
        desk.attend(self)
        desk.enter("adjusting", commands=COMMANDS, fit=self.state)

    def _offer_images(self, of: str = "") -> tuple[str, ...]:
        """The names under which a page finds them."""
        names = tuple(f"{name}{of}.jpg" for name in ("rest", "deformed")[: len(self._subject.images)])
        for name, content in zip(names, self._subject.images, strict=True):
            self._offer(name, content, "image/jpeg")
        return names

    # As `PageRun`, from the server -----------------------------------------------------------------------------------

    def obey(self, command: PageCommand) -> tuple[Outcome, str]:
        """As `PageRun.obey`."""
        with self._news:
            match command:
                case StopRun():
                    self._finished = True
                case SetFit():
                    self._asked, self._wants_fit = command, False
                case RunFit():
                    self._wants_fit = True
                case FitDrawn():
                    self.drawn_ms.append(command.after_ms)
                    return "done", ""
                case _:
                    return "refused", "not while a fit is set"
            self._news.notify()
            return "begun", ""

    # In the command's thread -----------------------------------------------------------------------------------------

    def until_finished(self) -> None:
        """Simulate and fit what pages ask for, until one of them stops it. `config` is then what was set last."""
        while True:
            with self._news:
                self._wait()
                asked, fit, finished = self._asked, self._wants_fit, self._finished
                self._asked = None
                self._wants_fit = fit and asked is not None  # first what it is to be made of
            self._begin_step(whole=fit or (finished and self.keeps_last))
            if asked is not None:
                self._set(asked)
            elif finished:
                return
            elif fit:
                self._fit()
            elif self._curve:
                self._go_on_with_curve()

    def _wait(self) -> None:
        """Until there is something to do."""
        if not self._curve:
            self._news.wait_for(self._is_wanted)
        elif not self.state.values:
            self._news.wait_for(self._is_wanted, QUIET_S)

    def _is_wanted(self) -> bool:
        return self._asked is not None or self._wants_fit or self._finished

    def _begin_step(self, *, whole: bool) -> None:
        """Before what was asked for is done. whole: it is one that is to stay"""

    @property
    def result_config(self) -> BetaConfig | ThetaConfig:
        """The options that were set last, of what can be read again."""
        return self.config

    @property
    def command(self) -> str:
        """What gives the same numbers at a terminal; empty where nothing does yet."""
        return shlex.join(command_line(f"calibrate {self.state.parameter}", self.result_config))

    def show_found(self, estimate: Estimate, shown: Result) -> None:
        """A whole fit, with its picture."""
        self._offer("fit.png", results_png([shown]), "image/png")
        low, high = estimate.interval
        words = estimate.verdict_text()
        found = FitFound(self.command, estimate.value, low, high, estimate.level, estimate.aee_free, words)
        self._found = dataclasses.replace(self.config, at=None)
        self._show(found=found, picture="fit.png", busy="")

    def _set(self, asked: SetFit, pictures: tuple[str, ...] = ()) -> None:
        """Simulate what is asked for, and show it. pictures: that are new"""
        self._curve, self._shown = [], asked
        try:
            self.config = config = self._config_of(asked.settings)
            seen, body, model = self._prepared(config)
            value = float(asked.settings.beta if model.parameter == "beta" else asked.settings.theta)
            found = simulate(seen, model, np.array([value]), body)[0]
            error = errors_of([seen], value, [found])
            drawn = self._drawn(seen, found)
        except Exception as problem:  # whatever is set on a page, the next change may be better
            gone = dict.fromkeys(("rest", "observed", "simulated", "seen", "held", "values", "errors"), ())
            new: dict[str, Any] = {**gone, "pictures": pictures, "aee": None, "aee_free": None} if pictures else {}
            shown = {"settings": asked.settings, "number": asked.number, "command": self.command, "busy": ""}
            self._show(**shown, problem=words_of(problem), **new)
            return
        same = self._found == dataclasses.replace(config, at=None)
        restless = "" if error.converged else "the simulation does not come to rest with these settings"
        changes: dict[str, Any] = {"problem": restless, **drawn, **self._begun_curve(seen, body, model)}
        self._show(
            **changes,
            pictures=pictures or self.state.pictures,
            settings=asked.settings,
            number=asked.number,
            command=self.command,
            aee=error.aee,
            aee_free=error.aee_free,
            busy="",
            found=self.state.found if same else None,
            picture=self.state.picture if same else "",
        )

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

    def _begun_curve(self, seen: Observation, body: Msm, model: Model) -> dict[str, Any]:
        """What is known of it at once."""
        spread = np.linspace(*self.state.bounds, VALUES).tolist()
        self._curve = [value for first in range(COARSELY) for value in spread[first::COARSELY]]
        return {"values": (), "errors": ()}

    def _go_on_with_curve(self) -> None:
        """One more value, between two looks at what is new; one that cannot be simulated has no error, and is said."""
        value = self._curve.pop(0)
        error: float | None = None
        try:
            seen, body, model = self._prepared(self.config)
            error = errors_of([seen], value, simulate(seen, model, np.array([value]), body)).aee
        except Exception as problem:
            self._show(problem=f"at {self.state.parameter} {value:.3f}: {words_of(problem)}")
        known = sorted([*zip(self.state.values, self.state.errors, strict=True), (value, error)], key=itemgetter(0))
        values, errors = zip(*known, strict=True)
        self._show(values=values, errors=errors)

    def _fit(self) -> None:
        """The parameter with its interval, as the command finds it; left where something else is set meanwhile."""
        try:
            seen, _, _ = self._prepared(self.config)
            assert self._seen is not None
            found = calibrate([seen], fit_options(self.config), settings=self._seen[2], progress=self._note)
            self.show_found(found.estimate, Result(found.estimate, found.comparisons[-1:], ("",)))
        except _SetAnew:
            self._show(busy="")
        except Exception as problem:
            self._show(problem=words_of(problem), busy="")

    def _note(self, what: str, done: int, total: int) -> None:
        with self._news:
            if self._asked is not None or self._finished:
                raise _SetAnew
        now_s = time.monotonic()
        if now_s - self._busy_s > BUSY_EVERY_S:
            self._busy_s = now_s
            self._show(busy=f"{what}: {done} of {total}" if total else what)

    def _prepared(self, config: BetaConfig | ThetaConfig) -> tuple[Observation, Msm, Model]:
        """What was seen, in the model; both are kept while nothing changes that they depend on."""
        key = config.images, config.search.noise_px
        if self._seen is None or self._seen[0] != key:
            seen, used = self._subject.observe(config)
            self._seen = key, seen, dict(used)
        _, seen, _ = self._seen
        model = fit_options(config).model
        alike = dataclasses.replace(model, beta=0.0, theta=0.0)  # a body has neither
        if self._body is None or self._body[0] != alike or self._body[1] is not seen:
            self._body = alike, seen, model.body(seen)
        return seen, self._body[2], model

    def _config_of(self, asked: FitSettings) -> BetaConfig | ThetaConfig:
        """The command's options with what was set; those that are as they began stay unsaid. Raises InputError where
        they do not go together."""
        config, began = self._base, self._began
        if any(getattr(asked, name) != getattr(began, name) for name in IN_PICTURE):
            config = dataclasses.replace(config, images=images_with(self._images, asked))
        if asked.cluster_size != began.cluster_size:
            config = dataclasses.replace(config, cluster_size=asked.cluster_size)
        if isinstance(config, BetaConfig):
            theta = config.theta if asked.theta == began.theta else asked.theta
            return dataclasses.replace(config, theta=theta, at=asked.beta)
        return dataclasses.replace(config, beta=asked.beta, at=asked.theta)

    def _show(self, **changes: Any) -> None:
        self.state = msgspec.structs.replace(self.state, **changes)
        self._desk.show(fit=self.state)


def words_of(problem: Exception) -> str:
    """In a line, for the page."""
    return " ".join(str(problem).split()) or type(problem).__name__


def _settings_of(config: BetaConfig | ThetaConfig) -> FitSettings:
    """What a page begins with."""
    images = images_of(config)
    corners = images.outline or ()
    beta = config.beta if isinstance(config, ThetaConfig) else 0.5 if config.at is None else config.at
    theta = config.fitted_theta if isinstance(config, BetaConfig) else 0.5 if config.at is None else config.at
    return FitSettings(
        roi=images.roi,
        grid=images.grid,
        spacing_px=images.spacing_px,
        outline=tuple(zip(corners[::2], corners[1::2], strict=True)),
        held=images.held_parts(),
        contact=images.contact,
        cluster_size=config.fitted_cluster_size if isinstance(config, BetaConfig) else config.cluster_size,
        beta=beta,
        theta=theta,
    )


@contextmanager
def _fitting(config: BetaConfig | ThetaConfig, page: PageServer) -> Iterator[PageFitting]:
    """Of files; or of a rig's camera, which is open until the end of the context."""
    if not config.from_rig:
        subject = subject_of(config, lambda words: page.desk.show(reason=words))
        yield PageFitting(page.desk, config, subject, page.offer)
        return
    from deformscope.page.camera_fitting import CameraFitting
    from deformscope.page.fit_camera import camera_of

    with camera_of(config, lambda words, bad: page.desk.remark(words, bad=bad)) as camera:
        yield CameraFitting(page.desk, config, camera, page.offer)


@contextmanager
def set_on_page(
    config: BetaConfig | ThetaConfig, note: Callable[[str], None]
) -> Iterator[tuple[BetaConfig | ThetaConfig, Callable[[Estimate, Result], None]]]:
    """Have a page set a fit, until it is stopped there. Yields the options that were set, and what shows the result.

    The page is served on until the process ends. Raises InputError for what cannot be read.
    """
    quiet_warp()
    config = dataclasses.replace(config, adjust=False, output=dataclasses.replace(config.output, viewer="none"))
    page = PageServer(" ".join(config.sources), adjusting=True)
    page.open()
    note(page.where)
    try:
        with _fitting(config, page) as fitting:
            try:
                fitting.until_finished()
            finally:
                if command := fitting.command:
                    note(f"as set on the page: {command}")
                if fitting.drawn_ms:
                    p50, p95 = np.percentile(fitting.drawn_ms, (50, 95))
                    note(f"slider to picture: p50 {p50:.0f} ms, p95 {p95:.0f} ms, {len(fitting.drawn_ms)} changes")
        page.desk.enter("adjusting", commands=(), reason="the whole fit is made of what is set")

        def show(estimate: Estimate, shown: Result) -> None:
            fitting.show_found(estimate, shown)
            page.desk.enter("stopped", "its command has ended")

        yield fitting.result_config, show
    except BaseException as error:
        page.desk.enter("stopped", " ".join(str(error).split()) or "interrupted")
        page.close()
        raise
