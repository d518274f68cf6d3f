"""The two methods for a static state, over the goals of any body: Newton's steps, and Anderson's acceleration.

Launches are recorded once and replayed: on a CPU too, where a launch from Python costs more than its work."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.msm import newton_functions as k
from deformscope.stages.msm.anderson_kernels import MEMORY, anderson_kernels_for
from deformscope.stages.msm.body import Body, BodyRest, Parameters
from deformscope.stages.msm.layout import Field, upload
from deformscope.stages.msm.multigrid import PATIENCE, Multigrid
from deformscope.stages.msm.newton_kernels import newton_kernels_for

Progress = Callable[[int], None]

THREADS = {"cpu": 1, "cuda": 256}
"""Threads of a block, which take one part of a sum over particles; the parts are added in order."""

PART_BLOCKS, MOST_PARTS = {"cpu": 256, "cuda": 1024}, {"cpu": 256, "cuda": 512}
"""Lanes per part, until this number of parts: on a GPU some blocks for each multiprocessor."""

ROUNDING = {wp.float32: 1e-8, wp.float64: 2e-15}
"""Residual that is only rounding, as a share of the displacements (or of a spacing)."""

STRETCH = 0.05
"""Share of a preconditioned body's longest side that no particle passes in a Newton step, which bends it."""

PREDICTED = 1e-2
"""Share to which the linear equations at rest are solved, for a state to begin from."""

STAY = 256
"""Evaluations of a persistent kernel before it returns for a check."""

REPLAYS = {"cpu": 1, "cuda": 8}
"""Iterations between checks of which candidates still run. On a GPU, each check waits for the device."""

TELL_EVERY_S = 0.2
"""Seconds between calls of `progress`."""


@dataclass(frozen=True, slots=True)
class Ended:
    """How the candidates ended, (B,) each; norm and error in particle spacings.

    smoothed: evaluations in the preconditioner's finest level; unaided: continued without it
    out_of_time: candidates that still ran at the time limit"""

    state: IntArray
    norm: FloatArray
    error: FloatArray
    total: IntArray
    smoothed: IntArray
    unaided: BoolArray
    out_of_time: BoolArray


class Iteration:
    """Common parts of both methods: fields of the candidates, their parameters, and sums over particles."""

    def __init__(self, body: Body, rest: BodyRest, size: int, volume: int, *, aided: bool = False) -> None:
        self.body, self.volume = body, volume
        self.layout = body.layout(size, filled=volume != 0)
        self.operator: Any = body.operator(self.layout)
        self.functions = k.newton_functions_for(body.dim, body.scalar, self.layout.width)
        self.kind = "cpu" if self.layout.device.startswith("cpu") else "cuda"
        span = self.functions.Span()
        span.abreast, span.blocks = self.layout.abreast, self.layout.blocks
        self.multigrid = (
            Multigrid(body, rest, self.layout, size, volume) if aided and Multigrid.worth(body, rest) else None
        )
        self.threads = 0 if self.multigrid else self.operator.threads
        parts = min(-(-self.layout.blocks // PART_BLOCKS[self.kind]), MOST_PARTS[self.kind])
        span.parts, span.threads = 1 if self.threads else max(1, parts), THREADS[self.kind]
        span.front, span.group, span.stride = self.layout.front, self.layout.group, self.layout.stride
        span.metric = self.operator.metric
        span.metric_total = float(rest.metric.sum()) or 1.0
        self.span = span
        self.state: Any
        self.copies: Any = None  # of positions, for the body whose spacings these are
        self.pair, self.pair_out = self.layout.field(2 * body.dim), self.layout.field(2 * body.dim)
        self.u, self.direction = halves(self.pair)
        self.residual, self.changed = halves(self.pair_out)
        zero = np.zeros(size)
        self.beta, self.theta = self.layout.each(zero), self.layout.each(zero)
        self.parameters = Parameters(self.beta, self.theta, 0, volume)
        self._every_group = self.all_groups()
        self._graphs: dict[Any, Any] = {}
        groups, on_gpu = self.layout.groups, self.kind != "cpu"
        self._looked = wp.empty(groups, dtype=int, device="cpu", pinned=True) if on_gpu else None
        self._watch()

    def _watch(self, progress: Progress | None = None, until: float = math.inf) -> None:
        """The observer of the next solve, which receives the number of finished candidates, and the solve's time limit,
        by `time.monotonic` [s]."""
        self._progress, self._until, self._told = progress, until, -math.inf

    def _over(self) -> bool:
        """Whether the solve's time is over; reports its progress."""
        now = time.monotonic()
        if now >= self._told + TELL_EVERY_S:
            self._told = now
            self._tell()
        return now >= self._until

    def _tell(self) -> None:
        if self._progress is not None:
            self._progress(int(np.count_nonzero(self.state.state.numpy()[: self.layout.candidates] != k.RUNNING)))

    def put(self, u: FloatArray) -> None:
        """Set the start to displacements (B or 1, K, d); the rounding error of a residual grows with them."""
        self.layout.put(u, self.u)
        set_first(
            self.state.floor,
            ROUNDING[self.layout.scalar] * max(1.0, float(u.max(initial=0.0)), -float(u.min(initial=0.0))),
        )

    def _numbers(self, struct: Any) -> Any:
        """A struct whose arrays have a number for each candidate, 0, of the type that it says."""
        state, zero = struct(), np.zeros(self.layout.candidates)
        for name, field in struct.vars.items():
            dtype = getattr(field.type, "dtype", None)
            if dtype in (wp.int32, wp.float32, wp.float64):
                setattr(state, name, self.layout.each(zero, int if dtype is wp.int32 else dtype))
        return state

    def _any(self, flags: Field) -> bool:
        """Whether any group is marked. On a GPU the look waits for the device, in memory that it writes directly."""
        if self._looked is None:
            return bool(flags.numpy().any())
        wp.copy(self._looked, flags)
        wp.synchronize_stream(wp.get_stream(self.layout.device))
        return bool(self._looked.numpy().any())

    def _ended(self, state: Any, spent: IntArray) -> Ended:
        """How they ended. spent: (B,) evaluations before the state's own"""
        self._tell()
        size = self.layout.candidates
        smoothed, unaided = np.zeros(size, dtype=int), np.zeros(size, dtype=bool)
        if self.multigrid is not None:
            smoothed, unaided = self.multigrid.used(state.outers, spent > 0)
        return Ended(
            state=state.state.numpy()[:size].copy(),
            norm=state.norm.numpy()[:size].copy(),
            error=state.error.numpy()[:size].copy(),
            total=state.total.numpy()[:size] + spent,
            smoothed=smoothed,
            unaided=unaided,
            out_of_time=(state.state.numpy()[:size] == k.RUNNING) & (time.monotonic() >= self._until),
        )

    def parts(self, rows: int) -> Field:
        count = rows * self.layout.groups * self.span.parts * self.layout.width
        return wp.zeros(count, dtype=wp.float64, device=self.layout.device)

    def set(self, beta: FloatArray, theta: FloatArray) -> None:
        """Parameters of the candidates: beta (B,), (B, C) or along each axis (B, C or 1, d); theta (B,)."""
        self.layout.refill(self.theta, theta)
        stride = self.operator.beta_stride if beta.ndim > 1 else 0
        if stride != self.parameters.beta_stride:
            values = self.operator.cluster_values(beta) if stride else self.layout.each(beta)
            self.parameters = Parameters(values, self.theta, stride, self.volume)
            self._parameters_changed()
        elif stride:
            self.parameters.beta.assign(self.operator.cluster_values(beta))
        else:
            self.layout.refill(self.parameters.beta, beta)

    def _parameters_changed(self) -> None:
        """The recorded launches hold other arrays than those in use."""
        self._graphs.clear()

    def replay(self, launches: Callable[..., None], *given: Any) -> None:
        """Launches that are recorded the first time, and replayed afterwards."""
        key = (launches, *given)
        if key in self._graphs:
            wp.capture_launch(self._graphs[key])
            return
        launches(*given)  # loads the kernels, so that the capture records launches only
        with wp.ScopedCapture(device=self.layout.device) as capture:
            launches(*given)
        self._graphs[key] = capture.graph

    def launch(self, kernel: wp.Kernel, over: tuple[int, ...] | int, *inputs: Any) -> None:
        """A kernel of both methods, whose arguments begin with the layout and the stored values of candidates."""
        inputs = (self.span, self.state, *inputs)
        wp.launch(kernel, dim=over, inputs=inputs, device=self.layout.device, block_dim=self.span.threads)

    def launch_sums(self, kernel: wp.Kernel, *inputs: Any, over: tuple[int, ...] = ()) -> None:
        """A kernel that takes sums over particles: every part by the threads of a block."""
        self.launch(kernel, (self.layout.groups, *over, self.span.parts * self.span.threads), *inputs)

    def launch_blocks(self, kernel: wp.Kernel, *inputs: Any) -> None:
        """A kernel over all lanes' worths."""
        self.launch(kernel, (self.layout.groups, self.layout.blocks), *inputs)

    def launch_groups(self, kernel: wp.Kernel, *inputs: Any) -> None:
        """A kernel that joins the parts of sums."""
        self.launch(kernel, (self.layout.groups, self.span.threads), *inputs)

    def all_groups(self) -> Field:
        return wp.full(self.layout.groups, 1, dtype=int, device=self.layout.device)


class Newton(Iteration):
    """Newton's steps on the energy, each solved by conjugate gradients; without eq. 3.17. Large lattices are
    preconditioned (`multigrid`)."""

    def __init__(self, body: Body, rest: BodyRest, size: int, volume: int) -> None:
        super().__init__(body, rest, size, volume, aided=True)
        layout = self.layout
        d = body.dim
        self.kernels = newton_kernels_for(d, body.scalar, layout.width)
        self.step, self.rho = layout.field(d), layout.field(d)
        state = self._numbers(self.functions.NewtonState)
        state.u, state.direction, state.step, state.rho = self.u, self.direction, self.step, self.rho
        state.residual, state.changed, state.parts = self.residual, self.changed, self.parts(2)
        state.groups, state.most = layout.groups, 10 * len(rest.mass) * d + 100
        self._farthest = k.REACH if self.multigrid is None else max(k.REACH, STRETCH * self.multigrid.longest)
        state.farthest.fill_(self._farthest)
        if self.multigrid is not None:
            grid, state.patience = self.multigrid, PATIENCE
            state.z, state.along, state.plain, state.applied = grid.z, grid.along, grid.plain, grid.applied
        state.outer_groups, state.inner_groups = self.all_groups(), self.all_groups()
        self.state = state
        self._held = np.flatnonzero(~rest.free)
        self._kept = self.operator.kept(volume)
        self._stay: Any = None

    def _parameters_changed(self) -> None:
        super()._parameters_changed()
        self._stay = None

    def set(self, beta: FloatArray, theta: FloatArray) -> None:
        super().set(beta, theta)
        if self.multigrid is not None and self.multigrid.set(beta, theta):
            self._parameters_changed()

    def relax(
        self,
        start: FloatArray | None,
        tolerance: float,
        max_iterations: int,
        progress: Progress | None = None,
        until: float = math.inf,
    ) -> Ended:
        """The static states; tolerance and result in particle spacings. start: displacements (B or 1, K, d); None: from
        the present `u`; until: as in `_watch`"""
        state = self.state
        self._watch(progress, until)
        if start is not None:
            self.put(start)
        spent = np.zeros(self.layout.candidates, dtype=int)
        if self.multigrid is not None:
            self.multigrid.reset()
            moved = 0 if start is None else np.count_nonzero(start)
            if start is not None and moved and moved == np.count_nonzero(start[:, self._held]):
                # where all the motion is still between two layers Newton's steps are short: begin at the static state
                # of the equations linearised at rest
                self.replay(self._launch_at_rest)
                self._begin(0.0, PREDICTED, outer=0)
                self.replay(self._launch_aim)
                self._descend(max_iterations - 2)
                self.launch_blocks(self.kernels.add_step)
                spent = np.asarray(self.state.total.numpy()[: self.layout.candidates] + 2)
        self._begin(tolerance, 0.0, outer=1)
        self.step.zero_()
        done = int(spent.max())
        while done < max_iterations:
            if self.threads:
                done += self._stay_for(max_iterations - done)
            else:
                self.replay(self._launch_outer)
                done += 1
            if self._over() or not self._any(state.outer_groups):
                break
            if not self.threads:
                done += self._descend(max_iterations - done)
        return self._ended(state, spent)

    def _launch_at_rest(self) -> None:
        everything, rest = self._every_group, self.step
        rest.zero_()
        self.operator.residual(rest, self.residual, self.parameters, everything, self._kept)
        if self.multigrid is not None:
            self.multigrid.linearise(rest, everything)
        self.operator.change(self.u, self.residual, self.parameters, everything, self._kept)

    def _launch_aim(self) -> None:
        kk, right = self.kernels, self.residual
        self.launch_sums(kk.inner_products, self.state.inner_groups, right, right, right, right)
        self.launch_groups(kk.aim)
        self.launch_blocks(kk.begin)

    def evaluate(self) -> None:
        """The residual at `u`, and with it the values for derivatives there."""
        self.replay(self._launch_evaluate)

    def _launch_evaluate(self) -> None:
        self.operator.residual(self.u, self.residual, self.parameters, self._every_group, self._kept)
        if self.multigrid is not None:
            self.multigrid.linearise(self.u, self._every_group)

    def _descend(self, most: int) -> int:
        done = 0
        flags = self.state.inner_groups
        while self.threads and done < most and self._any(flags) and not self._over():
            done += self._stay_for(most - done)
        inner, replays = self._launch_inner, REPLAYS[self.kind]
        if self.multigrid is not None and self.multigrid.given_up:
            inner = self._launch_plain
        elif self.multigrid is not None:
            replays = 1  # a cycle takes longer than a look
        while done < most and self._any(flags) and not self._over():
            for _ in range(replays):
                self.replay(inner)
                done += 1
        return done

    def _begin(self, tolerance: float, relative: float, *, outer: int) -> None:
        """Every candidate starts again: Newton's steps (`outer`), or a linear solve."""
        layout = self.layout
        set_first(self.state.tolerance, tolerance)
        set_first(self.state.relative, relative)
        count = layout.groups * layout.abreast
        reach = self._farthest if outer else np.inf
        kernels = self.operator.resident if self.threads else self.kernels
        self.launch(kernels.reset, count, wp.float64(reach), outer, 1 - outer)

    def _stay_for(self, most: int) -> int:
        """Up to STAY evaluations in one launch."""
        limit = min(STAY, most)
        if self._stay is None:
            newton, pairs = [self.span, self.state], (self.pair, self.pair_out)
            self._stay = self.operator.stay_relaxing(self.parameters, self._kept, newton, *pairs)
        self._stay.set_param_by_name("limit", limit)
        self._stay.launch()
        return limit

    def _launch_outer(self) -> None:
        kk, running, r = self.kernels, self.state.outer_groups, self.residual
        self.launch_blocks(kk.move)
        self.operator.residual(self.u, r, self.parameters, running, self._kept)
        self.launch_sums(kk.inner_products, running, r, r, r, self.step)
        self.launch_groups(kk.judge)
        if self.multigrid is not None:
            self.multigrid.linearise(self.u, self.state.inner_groups)
        self.launch_blocks(kk.begin)

    def _launch_inner(self) -> None:
        if self.multigrid is None:
            self._launch_plain()
            return
        grid, running, rho = self.multigrid, self.state.inner_groups, self.rho
        grid.cycle(rho, running)
        self.launch_sums(self.kernels.inner_products, running, rho, grid.z, rho, rho)
        self.launch_groups(self.kernels.mix_aided)
        self.launch_blocks(self.kernels.direct_aided)
        self._launch_along()

    def _launch_plain(self) -> None:
        self._launch_along()
        self.launch_blocks(self.kernels.direct)

    def _launch_along(self) -> None:
        """Goes along the direction."""
        kk, running, p = self.kernels, self.state.inner_groups, self.direction
        self.operator.change(p, self.changed, self.parameters, running, self._kept)
        self.launch_sums(kk.inner_products, running, p, self.changed, p, p)
        self.launch_groups(kk.curvature)
        self.launch_sums(kk.descend)
        self.launch_groups(kk.conjugate)


class Anderson(Iteration):
    """Anderson's acceleration of the goal map: for eq. 3.17, which follows no energy."""

    def __init__(self, body: Body, rest: BodyRest, size: int, volume: int) -> None:
        super().__init__(body, rest, size, volume)
        layout = self.layout
        d = body.dim
        self.kernels = anderson_kernels_for(d, body.scalar, layout.width)
        state = self._numbers(self.kernels.AndersonState)
        state.u, state.u_last, state.du = self.u, layout.field(d), layout.field(d * MEMORY)
        state.residual, state.residual_last, state.dr = self.residual, layout.field(d), layout.field(d * MEMORY)
        state.parts, state.sides = self.parts(2 * (MEMORY + 1)), layout.groups
        lanes = layout.groups * layout.abreast + layout.width
        state.gamma = upload(np.zeros((MEMORY, lanes)), layout.scalar, layout.device)
        state.stride = lanes
        history = wp.types.matrix(shape=(MEMORY, MEMORY), dtype=wp.float64)
        state.gram = wp.zeros(lanes, dtype=history, device=layout.device)
        state.groups, state.count = self.all_groups(), self.all_groups()
        self.state = state

    def relax(
        self,
        start: FloatArray,
        tolerance: float,
        max_iterations: int,
        progress: Progress | None = None,
        until: float = math.inf,
    ) -> Ended:
        """The static states from displacements (B or 1, K, d); tolerance and result in particle spacings."""
        self._watch(progress, until)
        self.put(start)
        state = self.state
        set_first(state.tolerance, tolerance)
        for name in ("known", "total", "path", "gram", "count", "du", "dr"):
            getattr(state, name).zero_()
        state.state.fill_(k.RUNNING)
        state.mark.fill_(8)
        state.best.fill_(np.inf)
        state.error.fill_(np.inf)
        state.least.fill_(1.0)
        state.least_before.fill_(1.0)
        state.groups.fill_(1)
        done = 0
        size = self.layout.candidates
        while done < max_iterations and self._any(state.groups):
            for _ in range(min(REPLAYS[self.kind], max_iterations - done)):
                self.replay(self._launch_goals)
                done += 1
            if self._over():
                break
        return self._ended(state, np.zeros(size, dtype=int))

    def evaluate(self) -> None:
        """The residual at `u`."""
        self.operator.residual(self.u, self.residual, self.parameters, self._every_group)

    def _launch_goals(self) -> None:
        self.operator.residual(self.u, self.residual, self.parameters, self.state.groups)
        kk = self.kernels
        self.launch_blocks(kk.remember)
        self.launch_sums(kk.history_products, over=(MEMORY + 1,))
        self.launch_groups(kk.accelerate)
        self.launch_blocks(kk.advance)


def set_first(array: Any, value: float) -> None:
    """Sets the first entry of an array, the only one that is read; on a CPU without a launch."""
    if array.device.is_cpu:
        array.numpy()[0] = value
    else:
        array.fill_(value)


def halves(pair: Field) -> tuple[Field, Field]:
    """The two halves of a field with twice the rows."""
    rows = pair.shape[0] // 2
    return pair[:rows], pair[rows:]
