"""Time stepping: what one step takes, and how much memory, beside NumPy and other engines."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Generator, Iterator
from importlib.util import find_spec

import numpy as np

from deformscope.bench.bodies import BenchBody, counted, cube
from deformscope.bench.memory import Meter
from deformscope.bench.numpy_step import NumpyLattice
from deformscope.bench.peers import Peer, PeerFailed
from deformscope.bench.plan import BETA, CLUSTER, MIDDLE, BenchPlan, Note, side_of
from deformscope.bench.timing import OURS, Contestant, Timing, TimingRow, clock, compare
from deformscope.stages.msm.solver import Msm

WIDE_CLUSTER, WIDE_AT = 9, 50_653
PEER_MOST = 200_000
"""Particles up to which pypbd's body is built in seconds and a few GB."""
CONTEXT_AT = 1331
SETUP_MOST_S = 40.0
MEMORY_LEAST = 10_000
"""Particles below which the process's own memory, which comes in pages and pools, shows nothing."""

NUMPY = "NumPy, batched SVD"
PHYSICS = {
    "mujoco": "other physics: tetrahedra with linear elasticity, explicit",
    "newton": "other physics: tetrahedra under XPBD, 1 iteration, looking for collisions",
}


class Stepping:
    """The engine's step, timed as m + 2 steps in one call less 2, over m: both set up and record the same.

    two_s: what a call of 2 steps takes, nearly all of it setting up, recording and copying the result [s]
    """

    def __init__(self, engine: Msm, body: BenchBody, turn_s: float, candidates: int = 1) -> None:
        self._engine, self._body, self._size = engine, body, candidates
        self._beta = BETA if candidates == 1 else np.linspace(0.0, 0.99, candidates)
        self._call(2)  # loads the kernels
        self.count = 4
        step_s = max(self().wall_s, 1e-7)
        self.count = max(4, min(5000, int(turn_s / step_s)))

    def __call__(self) -> Timing:
        few = self._call(2)
        self.two_s = few.wall_s
        return self._call(2 + self.count).per(self.count, without=few)

    def found(self) -> dict[str, object]:
        return {"call_of_2_steps_ms": 1e3 * self.two_s}

    def _call(self, steps: int) -> Timing:
        state = self._engine.start(self._size)
        return clock(lambda: self._engine.step(state, self._body.held_position, self._beta, steps=steps))


def steps(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """One step of ever larger cubes, and the memory that it takes."""
    setup_s, before = 0.0, 1
    for particles in plan.sizes:
        what = counted(particles)
        note(f"step: {what}")
        if (expected_s := setup_s * particles / before) > SETUP_MOST_S:
            yield TimingRow(
                "step", what, OURS, "ms/step", (), note=f"left out: setting up would take {expected_s:.0f} s"
            )
            continue
        setup_s, before = (yield from _one_size(plan, note, particles)), particles


def _one_size(plan: BenchPlan, note: Note, particles: int) -> Generator[TimingRow, None, float]:
    """Rows of one cube, all of whose memory is free again afterwards. Returns the seconds of setting up."""
    what, body, meter = counted(particles), cube(side_of(particles)), Meter(plan.device)
    began_s = time.perf_counter()
    engine = plan.engine(body, precision="float32")
    setup_s = time.perf_counter() - began_s
    built = meter.peak()
    meter.zero()
    stepping = Stepping(engine, body, plan.turn_s)
    if not plan.cpu or particles >= MEMORY_LEAST:
        where = "process" if plan.cpu else "device"
        for doing, peak in (("set-up", built), ("stepping", meter.peak())):
            if peak is not None:
                yield TimingRow("memory", f"{what}, {doing}", OURS, f"B/particle ({where})", (peak / particles,))
    if "step" in plan.only:
        facts = {"particles": particles, "clusters": engine.cluster_count, "setup_s": setup_s, "bits": 32}
        named = f"{what}, clusters of {CLUSTER}^3"
        ours = Contestant(named, OURS, stepping, "ms/step", facts=facts, found=stepping.found)
        yield from _beside(plan, note, body, ours)
    return setup_s


def _beside(plan: BenchPlan, note: Note, body: BenchBody, ours: Contestant) -> Iterator[TimingRow]:
    """The engine's row, and those of whoever can do the same or something like it."""
    with contextlib.ExitStack() as stack:
        contestants = [ours]
        if plan.cpu:
            contestants.append(numpy_contestant(plan, body, CLUSTER, ours))
        if body.particles == WIDE_AT and not plan.quick:
            note(f"step: {ours.what}, and of {WIDE_CLUSTER}^3")
            engine = plan.engine(body, WIDE_CLUSTER, "float32")
            what = ours.what.replace(f"{CLUSTER}^3", f"{WIDE_CLUSTER}^3")
            wide = Contestant(what, OURS, Stepping(engine, body, plan.turn_s), "ms/step", beside=ours)
            contestants.append(wide)
            if plan.cpu:
                contestants.append(numpy_contestant(plan, body, WIDE_CLUSTER, wide))
        for engine_name in _peers(plan, body):
            note(f"step: {ours.what}, {engine_name}")
            try:
                peer = stack.enter_context(Peer(engine_name, body.shape[0]))
            except PeerFailed as error:
                yield TimingRow("step", ours.what, engine_name, "ms/step", (), note=f"failed: {error}")
                continue
            contestants.append(peer_contestant(plan, peer, ours))
        note(f"step: {ours.what}")
        yield from compare("step", contestants, plan.rounds_of_steps)


def _peers(plan: BenchPlan, body: BenchBody) -> list[str]:
    if not plan.peers or not plan.cpu:
        return []
    context = [name for name in PHYSICS if find_spec(name) is not None] if body.particles == CONTEXT_AT else []
    return [*(["pypbd"] if body.particles <= PEER_MOST else []), *context]


def numpy_contestant(plan: BenchPlan, body: BenchBody, size: int, ours: Contestant) -> Contestant:
    """The same step by NumPy."""
    held = np.zeros(body.shape, dtype=bool)
    held.reshape(-1)[body.held] = True
    lattice, held_position = NumpyLattice.build(size, held), body.held_position.T

    def some(steps: int) -> Timing:
        def run() -> None:
            x, v = lattice.rest, np.zeros_like(lattice.rest)
            for _ in range(steps):
                x, v = lattice.step(x, v, held_position, BETA)

        return clock(run).per(steps)

    count = max(1, int(plan.turn_s / some(2).wall_s))
    return Contestant(ours.what, NUMPY, lambda: some(count), "ms/step", beside=ours, facts={"bits": 64})


def peer_contestant(plan: BenchPlan, peer: Peer, ours: Contestant, unit: str = "ms/step") -> Contestant:
    """A step of another engine in its own process, on one thread."""
    count = 2 * max(1, int(plan.turn_s / 2 / peer.steps(4).wall_s))
    note = PHYSICS.get(peer.engine, "rigid clusters, Gauss-Seidel, 1 iteration")
    kept, wanted = peer.facts.get("constraints_kept"), peer.facts.get("clusters")
    if kept != wanted:
        note += f"; keeps {kept} of {wanted} constraints"
    who = f"{peer.engine} {peer.facts['version']}"
    same = peer.engine not in PHYSICS
    return Contestant(
        ours.what, who, lambda: peer.steps(count), unit, beside=ours, same=same, facts=peer.facts, note=note
    )


def candidates_at_once(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """Simulation steps a second of many candidates in one launch, beside one simulation of another engine."""
    body = cube(MIDDLE)
    engine = plan.engine(body, precision="float32")
    for candidates in (100,) if plan.cpu else (100, 1000):
        what = f"{candidates} candidates of {counted(body.particles)} stepped at once"
        note(f"sweep: {what}")
        stepping = Stepping(engine, body, plan.turn_s, candidates)
        ours = Contestant(what, OURS, stepping, "steps/s", candidates, facts={"bits": 32})
        with contextlib.ExitStack() as stack:
            contestants = [ours]
            if plan.cpu and plan.peers:
                peer = stack.enter_context(Peer("pypbd", MIDDLE))
                contestants.append(peer_contestant(plan, peer, ours, "steps/s"))
            yield from compare("sweep", contestants, plan.rounds_of_steps)
