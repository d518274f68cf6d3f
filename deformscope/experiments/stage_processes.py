"""Processes that compute stages beside the loop that reads devices."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.errors import InputError
from deformscope.experiments.device_stages import (
    CELL_M,
    REFERENCE,
    LiveOptions,
    Stage,
    StageName,
    compute,
)
from deformscope.experiments.live_stages import StageExecutor
from deformscope.processes import SPAWN, follow_parent, starting
from deformscope.stages.map.surface import fit_surface
from deformscope.stages.regions.touches import MapGrid


class StageProcesses:
    """A process for every stage; they have loaded what they need when the context begins, before any device is opened.

    A process, no thread: both ask for Python's lock all the time. On two cores with `lab:bench` a fit of beta came
    3.6 s after its frame from a thread, 0.6 s from a process.
    """

    def __init__(self, names: Sequence[StageName], start_engine: Callable[[], None]) -> None:
        """start_engine: starts what simulates, in the process of a stage that does"""
        self._names, self._start_engine = names, start_engine
        self.executors: dict[str, StageProcess] = {}

    def __enter__(self) -> Mapping[str, StageExecutor]:
        self.executors = {name: StageProcess(name, self._start_engine) for name in self._names}
        for process in self.executors.values():
            process.wait()
        return self.executors

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        for process in self.executors.values():
            process.close()


class StageProcess:
    """One process; a new one where it has died."""

    def __init__(self, name: StageName, start_engine: Callable[[], None]) -> None:
        self._name = name
        self._start_engine = start_engine
        self._start()

    def _start(self) -> None:
        with starting():
            self._end, theirs = SPAWN.Pipe()
            self._pool = ProcessPoolExecutor(1, SPAWN, follow_parent, (theirs,))
            self._warm = self._pool.submit(warm_up, self._name, self._start_engine)

    def wait(self) -> None:
        """Return once it has loaded what its stage needs."""
        self._warm.result()

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Have it computed after what was submitted before."""
        try:
            return self._pool.submit(function, *arguments)
        except BrokenProcessPool:
            self._start()
            return self._pool.submit(function, *arguments)

    def close(self) -> None:
        """End it, and give up what it computes now."""
        self._end.close()
        self._pool.shutdown(cancel_futures=True)


def warm_up(name: StageName, start_engine: Callable[[], None]) -> None:
    """Do once what costs time the first time: imports, kernels."""
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
