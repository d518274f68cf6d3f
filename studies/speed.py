"""`python -m studies speed`: time of the engine and of the surface, compared with NumPy, LAPACK and other engines.

python -m studies speed --quick
python -m studies speed --device cuda --only sweep,cold,memory
python -m studies speed --peers --sizes 216,512,1331,50653 --json speed.json

Contestants take turns on one core, as in `deformscope bench`.
"""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Annotated, Literal, get_args

import numpy as np

from deformscope.bench.bodies import BenchBody, counted, cube
from deformscope.bench.plan import BETA, CLUSTER, MIDDLE, BenchPlan, Note, default_sizes, side_of
from deformscope.bench.report import WIDE_AT, WIDE_CLUSTER, Stepping, check, machine
from deformscope.bench.timing import OURS, Contestant, Timing, TimingRow, clock, compare
from deformscope.config import flags
from deformscope.pictures.report import Table
from deformscope.stages.msm.clusters import single
from deformscope.stages.msm.reduced import OneCluster
from deformscope.stages.msm.solver import Msm, pick_device
from deformscope.terminal import status_line
from studies.engines.memory import memory
from studies.engines.numpy_step import NumpyLattice
from studies.engines.peers import Peer, PeerFailed, require_peers
from studies.engines.starting import cold
from studies.engines.static_states import stepped_at_once, sweep
from studies.engines.surface import surface
from studies.runner import Study, StudyOptions, StudyReport

Part = Literal["step", "sweep", "theta", "surface", "cold", "memory"]
PARTS: tuple[Part, ...] = get_args(Part)
PEER_MOST = 200_000
"""Number of particles up to which pypbd's body is built in seconds and a few GB."""
CONTEXT_AT = 1331
"""Number of particles at which other physics are stepped too."""
THETA_BETA, THETA = 0.99, 0.9
ONE_CLUSTER_SIDES = (6, 11, 32, 64)
ALL_PARTICLES_MOST = 1331
"""Number of particles up to which the single cluster is also relaxed by `Msm`, which computes the position of every
particle."""

NUMPY = "NumPy, batched SVD"
PHYSICS = {
    "mujoco": "other physics: tetrahedra with linear elasticity, explicit",
    "newton": "other physics: tetrahedra under XPBD, 1 iteration, looking for collisions",
    "newton VBD": "other physics: tetrahedra under VBD, 1 iteration, looking for collisions",
}


@dataclass(frozen=True, slots=True)
class SpeedConfig(StudyOptions):
    """Compare the time of a step, of many candidates, of a single cluster and of a surface with those of other
    engines, and of first results."""

    only: Annotated[
        tuple[Part, ...] | None, flags.one_word("CASE,CASE...", flags.some_of(PARTS), flags.joined(",")), flags.unset
    ] = None
    """Measure only these, of step, sweep, theta, surface, cold and memory."""
    peers: bool = False
    """Run other engines too: pypbd, and mujoco and newton if installed (deformscope[peers]); with --device cuda newton
    alone."""
    quick: bool = False
    """Smaller and fewer cases."""
    sizes: flags.SizesFlag = None
    """Particles of the cubes that are stepped; default: 216 to a million."""
    repeats: flags.SomeFlag = None
    """Rounds of every comparison; default: as many as fit into a few seconds, 9 at most."""
    device: flags.Device = "cpu"
    """Where our engine runs; NumPy and the surface always run on the CPU."""


def report(options: SpeedConfig, seconds: float) -> StudyReport:
    """A row for each contestant."""
    device = pick_device(options.device)
    plan = BenchPlan(device, options.sizes or default_sizes("cpu", options.quick), options.repeats, options.quick)
    check(plan)
    if options.peers and plan.cpu:
        require_peers()
    rows: list[TimingRow] = []
    with status_line() as note:
        for part in options.only or PARTS:
            rows += _rows(part, options.peers)(plan, note)
    names = ("case", "what", "by", "median", "unit", "costs", "")
    lines = [
        (row.case, row.what, row.who, _number(row.median), row.unit, _number(row.costs), row.note or row.doubt)
        for row in rows
    ]
    caption = "Medians; costs: median over rounds of a row over its reference row"
    json = {"machine": machine(device), "rows": [row.plain() for row in rows]}
    return StudyReport([Table(lines, names, caption)], json)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _rows(part: Part, peers: bool) -> Callable[[BenchPlan, Note], Iterator[TimingRow]]:
    others: dict[Part, Callable[[BenchPlan, Note], Iterator[TimingRow]]] = {
        "step": partial(_steps, peers=peers),
        "sweep": partial(_sweeps, peers=peers),
        "theta": theta,
        "surface": surface,
        "cold": cold,
        "memory": memory,
    }
    return others[part]


def _steps(plan: BenchPlan, note: Note, *, peers: bool) -> Iterator[TimingRow]:
    for particles in plan.sizes:
        yield from _stepped(plan, note, cube(side_of(particles)), peers)


def _sweeps(plan: BenchPlan, note: Note, *, peers: bool) -> Iterator[TimingRow]:
    yield from sweep(plan, note)
    yield from _at_once(plan, note, peers)


def _stepped(plan: BenchPlan, note: Note, body: BenchBody, peers: bool) -> Iterator[TimingRow]:
    """The engine's row, and those of engines with the same or a similar computation."""
    note(f"step: {counted(body.particles)}")
    with contextlib.ExitStack() as stack:
        contestants: list[Contestant] = []
        for size in (CLUSTER, WIDE_CLUSTER) if body.particles == WIDE_AT and not plan.quick else (CLUSTER,):
            stepping = Stepping(plan.engine(body, size, "float32"), body, plan)
            what = f"{counted(body.particles)}, clusters of {size}^3"
            ours = Contestant(what, OURS, stepping, "ms/step", beside=contestants[0] if contestants else None)
            contestants += [ours, _numpy(plan, body, size, ours)]
        for engine in _peers(plan, body) if peers else ():
            try:
                peer = stack.enter_context(Peer(engine, body.shape[0], plan.device))
            except PeerFailed as error:
                yield TimingRow("step", contestants[0].what, engine, "ms/step", (), note=f"failed: {error}")
                continue
            contestants.append(_peer(plan, peer, contestants[0]))
        yield from compare("step", contestants, plan.rounds_of_steps)


def _peers(plan: BenchPlan, body: BenchBody) -> list[str]:
    installed = [name for name in PHYSICS if find_spec(name.split()[0]) is not None]
    few = body.particles <= PEER_MOST
    if not plan.cpu:
        return [name for name in installed if name.startswith("newton") and few]
    return [*(["pypbd"] if few else []), *(installed if body.particles == CONTEXT_AT else [])]


def _numpy(plan: BenchPlan, body: BenchBody, size: int, ours: Contestant) -> Contestant:
    """The step by NumPy."""
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


def _peer(plan: BenchPlan, peer: Peer, ours: Contestant, unit: str = "ms/step") -> Contestant:
    """A step of another engine in a separate process, on one thread."""
    count = 2 * max(1, int(plan.turn_s / 2 / peer.steps(4).wall_s))
    note = PHYSICS.get(peer.engine, "rigid clusters, Gauss-Seidel, 1 iteration")
    kept, wanted = peer.facts.get("constraints_kept"), peer.facts.get("clusters")
    if kept != wanted:
        note += f"; keeps {kept} of {wanted} constraints"
    name, *solver = peer.engine.split()
    who = " ".join([name, str(peer.facts["version"]), *solver])
    return Contestant(ours.what, who, lambda: peer.steps(count), unit, beside=ours, facts=peer.facts, note=note)


def _at_once(plan: BenchPlan, note: Note, peers: bool) -> Iterator[TimingRow]:
    """Simulation steps a second of many candidates in one launch, compared with one simulation of another engine."""
    for candidates in (100,) if plan.cpu else (100, 1000):
        ours = stepped_at_once(plan, candidates)
        note(f"sweep: {ours.what}")
        with contextlib.ExitStack() as stack:
            contestants = [ours]
            if peers and plan.cpu:
                contestants.append(_peer(plan, stack.enter_context(Peer("pypbd", MIDDLE)), ours, "steps/s"))
            yield from compare("sweep", contestants, plan.rounds_of_steps)


def theta(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """The static state of a single quadratic cluster under eq. 3.17, by its moments and by all its particles."""
    contestants: list[Contestant] = []
    for side in ONE_CLUSTER_SIDES[:2] if plan.quick else ONE_CLUSTER_SIDES:
        body = cube(side)
        what = f"{counted(body.particles)} in one quadratic cluster"
        note(f"theta: {what}")
        one = OneCluster(body.rest, body.held, basis="quadratic", device=plan.device)
        held = one.hold(body.held_position)
        result = one.relax(held, THETA_BETA, THETA)
        facts: dict[str, float] = {
            "iterations_most": int(result.iterations.max()),
            "converged": int(result.converged.sum()),
        }
        facts |= {"hold_ms": 1e3 * clock(partial(one.hold, body.held_position)).wall_s, "candidates": 1}
        smallest = contestants[0] if contestants else None
        turn = plan.turn(partial(one.relax, held, THETA_BETA, THETA))
        contestants.append(Contestant(what, OURS, turn, beside=smallest, facts=facts))
        if body.particles <= ALL_PARTICLES_MOST:
            engine = Msm(body.rest, single(body.particles), body.held, basis="quadratic", device=plan.device)
            turn = plan.turn(partial(engine.relax, body.held_position, THETA_BETA, THETA))
            contestants.append(Contestant(what, f"{OURS}, and where every particle is", turn, beside=contestants[-1]))
    yield from compare("theta", contestants, plan.rounds_of_steps)


STUDY = Study(SpeedConfig, lambda options: [], report)
