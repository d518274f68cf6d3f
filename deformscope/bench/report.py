"""One run of the bench: its rows as they are measured, and the whole run as JSON.

Cases: time stepping (time of one step, and of a call), and static states of ever larger cubes."""

import gc
import os
import platform
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
import warp as wp

from deformscope.arrays import FloatArray
from deformscope.bench.bodies import BenchBody, counted, cube, poked
from deformscope.bench.plan import BETA, CLUSTER, BenchPlan, Note, side_of
from deformscope.bench.timing import OURS, Contestant, Timing, TimingRow, clock, compare
from deformscope.bench_cases import Case
from deformscope.errors import InputError
from deformscope.stages.msm.lanes import VECTOR_BITS
from deformscope.stages.msm.solver import Msm, Relaxed
from deformscope.version import __version__

WIDE_CLUSTER, WIDE_AT = 9, 50_653
SETUP_MOST_S = 40.0
COPIED_BYTES, COPIES = 1 << 28, 8
CACHES_BYTES = 1 << 27
"""Size of a step's arrays, below which they may stay in a cache and memory's bandwidth bounds nothing."""
READ, LEFT = ("mass", "free", "pull"), ("sums_fast", "sums_middle", "maps", "maps_slow", "maps_middle")
"""Fields of a lattice's passes: of particles, and intermediate results between passes."""


def relax(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """The static state of ever larger cubes, from rest."""
    plan.engine(cube(4)).relax(cube(4).held_position, BETA)  # loads the kernels
    for make in (cube, poked):
        last_s, before = 0.0, 1
        for particles in plan.sizes:
            body = make(side_of(particles))
            what = f"{body.named}, clusters of {CLUSTER}^3"
            note(f"relax: {what}")
            # Iterations grow with the side.
            if (expected_s := last_s * (particles / before) ** (4 / 3)) > plan.longest_s:
                yield TimingRow("relax", what, OURS, "ms", (), note=f"left out: it would take some {expected_s:.0f} s")
                continue
            (row,) = compare("relax", [relaxing(plan.engine(body), body, what, BETA)], plan.rounds)
            last_s, before = min(row.samples) / 1e3, particles
            yield row


def relaxing(engine: Msm, body: BenchBody, what: str, beta: FloatArray | float) -> Contestant:
    """The static states of a body at one or several values of beta, in one call."""
    last: list[Relaxed] = []

    def run() -> None:
        last[:] = [engine.relax(body.held_position, beta)]

    def facts() -> dict[str, object]:
        (result,) = last
        numbers: dict[str, object] = {"particles": body.particles, "iterations_most": int(result.iterations.max())}
        if result.smoothed.any():
            numbers["smoothed_most"] = int(result.smoothed.max())
        return numbers | {"converged": int(result.converged.sum()), "candidates": len(result.converged)}

    return Contestant(what, OURS, lambda: clock(run), found=facts)


class Stepping:
    """The engine's step: many in one call on a state that stays on the device, by the device's own clock on a GPU.

    Nothing is subtracted. Setting up a call is part of it; `calls` has it in a row of its own."""

    def __init__(self, engine: Msm, body: BenchBody, plan: BenchPlan, candidates: int = 1) -> None:
        self._engine, self._body, self._cpu = engine, body, plan.cpu
        self._beta = BETA if candidates == 1 else np.linspace(0.0, 0.99, candidates)
        self.state = engine.start(candidates)
        self.call(8)  # loads the kernels
        self.count = 8
        for _ in range(2):  # the first count is a guess: a short call is mostly its setting up
            turn_s = plan.turn_s * (1 if self._cpu else 3)
            self.count = max(8, min(50_000, int(turn_s / self().wall_s)))

    def __call__(self) -> Timing:
        return self.call(self.count).per(self.count)

    def call(self, steps: int) -> Timing:
        """A call of some steps, to the end of the last."""
        run = partial(self._engine.advance, self.state, self._body.held_position, self._beta, steps=steps)
        if self._cpu:
            return clock(run)
        gc.collect()
        began, ended, cpu_s = *(wp.Event(enable_timing=True) for _ in range(2)), time.process_time()
        wp.record_event(began)
        run()
        wp.record_event(ended)
        cpu_s = time.process_time() - cpu_s
        return Timing(wp.get_event_elapsed_time(began, ended) / 1e3, cpu_s)

    def waited(self, steps: int) -> None:
        """The case until the device is done, as its caller waits for it."""
        self._engine.advance(self.state, self._body.held_position, self._beta, steps=steps)
        wp.synchronize_device(self._engine.device)

    def moved_bytes(self) -> int:
        """Bytes of all fields that a step reads, and of those it writes and reads again: the least that must move."""
        state, fields = self.state, self.state.operator.fields
        again = [state.star] * 2 if state.operator.looks_ahead else [state.before]
        arrays = [state.u, state.before, *again, *(getattr(fields, name) for name in (*READ, *LEFT, *LEFT))]
        return sum(int(each.capacity) for each in arrays)


def steps(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """One step of ever larger cubes, and calls of them."""
    setup_s, before = 0.0, 1
    bandwidth = bandwidth_bytes_s(plan.device)
    for particles in plan.sizes:
        what = counted(particles)
        note(f"step: {what}")
        if (expected_s := setup_s * particles / before) > SETUP_MOST_S:
            yield TimingRow(
                "step", what, OURS, "ms/step", (), note=f"left out: setting up would take {expected_s:.0f} s"
            )
            continue
        setup_s, before = (yield from _one_size(plan, note, particles, bandwidth)), particles


def bandwidth_bytes_s(device: str) -> float:
    """Bytes that the device's memory reads and writes in a second, measured by the fastest of some large copies."""
    source, target = (wp.zeros(COPIED_BYTES // 4, dtype=wp.float32, device=device) for _ in range(2))

    def copied() -> None:
        for _ in range(COPIES):
            wp.copy(target, source)
        wp.synchronize_device(device)

    copied()
    return 2 * COPIED_BYTES * COPIES / min(clock(copied).wall_s for _ in range(3))


def _one_size(plan: BenchPlan, note: Note, particles: int, bandwidth: float) -> Generator[TimingRow, None, float]:
    """Rows of one cube, all of whose memory is free again afterwards. Returns the seconds of setting up."""
    what, body = counted(particles), cube(side_of(particles))
    began_s = time.perf_counter()
    engine = plan.engine(body, precision="float32")
    setup_s = time.perf_counter() - began_s
    stepping = Stepping(engine, body, plan)
    if "step" in plan.only:
        moved = stepping.moved_bytes()
        facts = {"particles": particles, "clusters": engine.cluster_count, "setup_s": setup_s, "bits": 32}
        facts |= {"bytes": moved, "bandwidth_bytes_s": bandwidth} if moved > CACHES_BYTES else {}
        named = f"{what}, clusters of {CLUSTER}^3"
        ours = Contestant(named, OURS, stepping, "ms/step", facts=facts)
        contestants = [ours]
        if body.particles == WIDE_AT and not plan.quick:
            wide = named.replace(f"{CLUSTER}^3", f"{WIDE_CLUSTER}^3")
            stepped = Stepping(plan.engine(body, WIDE_CLUSTER, "float32"), body, plan)
            contestants.append(Contestant(wide, OURS, stepped, "ms/step", beside=ours))
        note(f"step: {named}")
        yield from compare("step", contestants, plan.rounds_of_steps)
    if "call" in plan.only:
        yield TimingRow("call", f"{what}, set-up", OURS, "ms", (1e3 * setup_s,), facts={"particles": particles})
        # a call of two steps, and copying the positions to the host
        two = Contestant(f"{what}, a call of 2 steps", OURS, plan.turn(partial(stepping.waited, 2)))
        copy = Contestant(f"{what}, positions copied out", OURS, plan.turn(partial(engine.positions, stepping.state)))
        yield from compare("call", [two, copy], plan.rounds_of_steps)
    return setup_s


# Conditions of a figure besides the code: the machine, and its load


def machine(device: str) -> dict[str, object]:
    """Facts for the JSON. load: mean of the last minute; other processes make every figure larger."""
    gpu = None if device == "cpu" else wp.get_device(device)
    return {
        "cpu": _cpu(),
        "vector_bits": VECTOR_BITS,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "device": device,
        "gpu": None if gpu is None else gpu.name,
        "gpu_memory_bytes": None if gpu is None else gpu.total_memory,
        "system": platform.platform(),
        "python": platform.python_version(),
        "deformscope": __version__,
        "warp": wp.config.version,
        "numpy": np.__version__,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


FORMAT = 1
"""Version of the JSON; a change that breaks readers raises it."""

Rows = Callable[[BenchPlan, Note], Iterator[TimingRow]]

MEASURES: tuple[tuple[frozenset[Case], Rows], ...] = (
    (frozenset({"step", "call"}), steps),
    (frozenset({"relax"}), relax),
)


def check(plan: BenchPlan) -> None:
    """Raises InputError for unsupported cases."""
    odd = [size for size in plan.sizes if side_of(size) < 4]
    if odd:
        raise InputError("sizes that are cubes of 4 or more", ", ".join(map(str, odd)), "--sizes 216,1331")


def measure(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """Each row of the plan as soon as it is known."""
    for cases, rows in MEASURES:
        if cases & set(plan.only):
            yield from (row for row in rows(plan, note) if row.case in plan.only)


@dataclass(frozen=True, slots=True)
class Report:
    """One run, as in its JSON. complete: whether it ran to its end."""

    format: int
    complete: bool
    machine: Mapping[str, object]
    settings: BenchPlan
    rows: tuple[Mapping[str, object], ...]


def run_bench(plan: BenchPlan, note: Note, done: Callable[[Report, Sequence[TimingRow]], None]) -> None:
    """Measure, and pass report and rows to `done` at the end, also after an interruption. Raises InputError for
    unsupported cases, and for samples of 0 or less."""
    check(plan)
    rows: list[TimingRow] = []
    complete = False
    try:
        for row in measure(plan, note):
            rows.append(row)
        complete = True
    finally:  # the machine's load is measured at the end
        plain = tuple(row.plain() for row in rows)
        done(Report(FORMAT, complete, machine(plan.device), plan, plain), rows)
    if failed := [row for row in rows if not row.positive]:
        got = "; ".join(f"{row.what} by {row.who}: {min(row.samples):.3g} {row.unit}" for row in failed)
        raise InputError("times above 0", got, "deformscope bench again on an idle machine")
