"""A bench without devices, explored in a moment: two foams side by side, and an arm that says whether it stands."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, ClassVar

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.experiments.explore.explore import Look
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import AsMeasured, Touch
from deformscope.experiments.explore.touching_robot import CheckFirst
from deformscope.frames import HealthReport, Item
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.robot.checks import Check, Preflight
from deformscope.robot.placement import Placement
from deformscope.robot.setup import CameraView, Setup
from deformscope.robot.touch import Phase
from deformscope.runs.opened_devices import Opening
from deformscope.session import Inline, Moment, Step
from deformscope.stages.map.exploration import PhaseStart
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement
from deformscope.stages.map.surface import HeightProcess, fit_surface
from tests.cli.quick_scene import CELL_M, use_coarse_maps

SIZE_M = (0.6, 0.4)
THICKNESS_M = 0.05
PERIOD_NS = 10_000_000


class FakeRobot:
    """Looks and touches at once. moving: what the arm does; halts: why it was told to stand"""

    format_forces = "3 N"
    doing = ""
    gaps_s = np.full(9, 0.01)
    largest_force_n = 3.1

    def __init__(self, bench: FakeBench, on_cycle: Callable[[], None]) -> None:
        self._bench, self._on_cycle = bench, on_cycle
        self.moving = False
        self.halts: list[str] = []
        self.on_phase: Callable[[Phase, int], None] = lambda phase, touch: None
        self.stopped: Future[None] = Future()
        self._touches = 0
        self._reports: list[Step] = []

    def carry_out(self, command: object, keep: Callable[[], object]) -> Future[Any]:
        match command:
            case CheckFirst():
                passed = Preflight((Check("arm: still", True, "at rest", "at rest"),))
                return Inline().submit(lambda: passed)
            case Look():
                return Inline().submit(self.look)
            case Touch():
                return Inline().submit(self.touch, command)
        return Inline().submit(self._cycles, 2)

    def reports(self) -> list[Step]:
        taken, self._reports = self._reports, []
        return taken

    def _cycles(self, count: int) -> None:
        for _ in range(count):
            self._bench.now_ns += PERIOD_NS
            self._on_cycle()

    def let_move(self, preflight: Preflight) -> None:
        pass

    def look(self) -> SurfaceMeasurement:
        self._cycles(2)
        x, y = (one.ravel() for one in np.meshgrid(np.linspace(0.01, 0.59, 25), np.linspace(0.01, 0.39, 17)))
        wavy = THICKNESS_M + 1e-4 * np.sin(40.0 * x) * np.cos(50.0 * y)
        return SurfaceMeasurement(np.column_stack([x, y, wavy]), np.full(len(x), 5e-4))

    def touch(self, command: Touch) -> TouchMeasurement:
        xy_m, height_m = command.xy_m, command.height_m
        self.moving = True
        self._touches += 1
        for phase in (Phase.TRAVEL, Phase.PRESS, Phase.RETREAT):
            began = Moment(self._bench.now_ns, self._touches)
            self._reports.append(Step((PhaseStart(str(phase), self._touches - 1),), moment=began))
            self.on_phase(phase, self._touches)
            self._cycles(2)
        self.moving = False
        stiffness = 1.5 if xy_m[0] > 0.3 else 0.6
        force = np.concatenate([np.zeros(30), np.linspace(0.0, 3.0, 60)])
        depth = 3e-3 / stiffness * (force / 3.0) ** (1.0 / 1.5)
        height = height_m + 0.01 + np.concatenate([np.linspace(0.01, 0.0, 30), np.zeros(60)]) - depth
        position = np.column_stack([np.tile(xy_m, (90, 1)), height])
        along = np.column_stack([np.zeros((90, 2)), force])
        up = np.array([0.0, 0.0, 1.0])
        return TouchMeasurement(xy_m, up, np.arange(90) * 0.01, position, along, np.zeros((0, 3)), True)

    def ask_to_stop(self, reason: str) -> None:
        pass

    def halt(self, reason: str) -> bool:
        self.halts.append(reason)
        self.moving = False
        return True


class FakeSource:
    """Devices that give nothing."""

    streams = ()
    start_ns = 0
    failures: ClassVar[dict[str, str]] = {}

    def take(self, wait_s: float) -> list[Item]:
        return []

    def rest(self) -> list[Item]:
        return []

    def look(self) -> HealthReport:
        return HealthReport(0, ())

    def close(self) -> None:
        pass


class FakeBench:
    """A setup's robots. robots: that were opened; now_ns: their clock"""

    def __init__(self) -> None:
        self.now_ns = 0
        self.robots: list[FakeRobot] = []
        self.setup = Setup(
            size_m=SIZE_M,
            placement=Placement(np.eye(4), Tool()),
            workspace=Workspace(),
            camera=CameraView(),
            open_source=self.source,  # type: ignore[arg-type]
            names=("arm", "tip", "camera"),
            simulated=True,
            runs_itself=False,
            true_force_n=lambda: 3.0,
            clock=lambda: self.now_ns,
        )

    @contextlib.contextmanager
    def source(self) -> Iterator[FakeSource]:
        yield FakeSource()

    @contextlib.contextmanager
    def robot(self, setup: Setup, source: object, options: object, on_cycle: Callable[[], None]) -> Iterator[FakeRobot]:
        self.robots.append(FakeRobot(self, on_cycle))
        yield self.robots[-1]


def use_fake_bench(monkeypatch: pytest.MonkeyPatch) -> FakeBench:
    """From now on `explore` explores this, on coarse maps of few particles."""
    bench = FakeBench()

    def setup_of(name: str, options: ExploreOptions, set_force_n: float | None, **flags: Any) -> Opening:
        options = dataclasses.replace(options, cell_m=CELL_M, beta_model="none")
        return Opening(bench.setup, options, {"scene": name})

    monkeypatch.setattr("deformscope.runs.exploration_run.setup_of", setup_of)
    monkeypatch.setattr("deformscope.experiments.explore.touching_robot.touching_robot", bench.robot)
    monkeypatch.setattr(
        "deformscope.experiments.explore.stage_executor.FromFrames", lambda geometry, options: AsMeasured(SIZE_M)
    )
    use_coarse_maps(monkeypatch)
    monkeypatch.setattr("deformscope.experiments.explore.seen_surface.fit_surface", _surface)
    return bench


_surfaces: dict[bytes, HeightProcess] = {}


def _surface(points_m: FloatArray, **options: Any) -> HeightProcess:
    """Fitted once: the table of all these benches is the same."""
    key = points_m.tobytes()
    if key not in _surfaces:
        _surfaces[key] = fit_surface(points_m, **options)
    return _surfaces[key]
