"""Processes that compute stages outside the loop that reads devices."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.errors import InputError
from deformscope.experiments.live.device_stages import CELL_M, REFERENCE, LiveOptions, Stage, StageName, compute
from deformscope.experiments.live.live_stages import StageExecutor
from deformscope.processes import LAST_NICE, computing
from deformscope.stages.map.surface import fit_surface
from deformscope.stages.regions.touches import MapGrid


class StageProcesses:
    """A process for every stage; they have loaded their modules when the context begins, before any device is opened.

    Stages have processes, not threads, because threads would compete for Python's lock. On two cores with `lab:bench` a
    fit of beta came 3.6 s after its frame from a thread, 0.6 s from a process. They have the lowest priority by
    default: eight stages of the same priority as the recording left it 6 % of a core, and ended it."""

    def __init__(self, names: Sequence[StageName], start_engine: Callable[[], None], *, nice: int = LAST_NICE) -> None:
        """start_engine: starts the simulation engine, in the process of a stage that needs it"""
        self._warm_ups = {name: partial(warm_up, name, start_engine) for name in names}
        self._nice = nice
        self._processes: dict[str, StageProcess] = {}

    def __enter__(self) -> Mapping[str, StageExecutor]:
        self._processes = {name: StageProcess(warm, self._nice) for name, warm in self._warm_ups.items()}
        for process in self._processes.values():
            process.warm.result()
        return self._processes

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        for process in self._processes.values():
            process.close()


class StageProcess(contextlib.ExitStack):
    """One process; it is replaced if it dies. warm: future that is done when its stage is loaded"""

    def __init__(self, warm_up: Callable[[], None], nice: int) -> None:
        super().__init__()
        self._warm_up, self._nice = warm_up, nice
        self._start()

    def _start(self) -> None:
        self._executor = self.enter_context(computing(bool, nice=self._nice))
        self.warm = self._executor.submit(self._warm_up)

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Compute an input after earlier submissions."""
        try:
            return self._executor.submit(function, *arguments)
        except BrokenProcessPool:
            self.close()
            self._start()
            return self._executor.submit(function, *arguments)


def warm_up(name: StageName, start_engine: Callable[[], None]) -> None:
    """Import modules and compile kernels in advance."""
    if name in ("beta", "theta", "field"):
        start_engine()
    if name in REFERENCE:
        image = np.random.default_rng(0).integers(0, 255, (120, 160), np.uint8)
        before = np.asarray(cv2.GaussianBlur(image, (0, 0), 2.0))
        stage = Stage(name, LiveOptions((name,), color="camera"))
        with contextlib.suppress(InputError):
            compute(stage, (before, np.roll(before, 2, axis=1)))
    elif name == "surface":
        x, y = np.meshgrid(np.linspace(0.0, 0.1, 12), np.linspace(0.0, 0.1, 12))
        points = np.column_stack([x.ravel(), y.ravel(), 1e-3 * np.sin(40.0 * x.ravel())])
        with threadpool_limits(1):
            fit_surface(points).on(MapGrid((0.1, 0.1), CELL_M))
