"""Where an exploration's stages are computed: in a child process, or in its loop."""

import contextlib
from collections.abc import Iterator
from concurrent.futures import Executor

from deformscope.experiments.explore.explore import Stage, within_loop
from deformscope.experiments.explore.explorer import Computed, ExplorationStages, UnseenSurface
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import FromFrames
from deformscope.experiments.measured import SetupGeometry
from deformscope.processes import computing
from deformscope.robot.setup import Setup, Truth
from deformscope.session import Compute, Inline

_stages: ExplorationStages | None = None


def exploration_stages(geometry: SetupGeometry, options: ExploreOptions, truth: Truth | None) -> ExplorationStages:
    """The stages of a robot whose frames are available here."""
    unseen = UnseenSurface(geometry.size_m, options, geometry.arm, truth, error=geometry.touch_error)
    return ExplorationStages(unseen, FromFrames(geometry, options))


@contextlib.contextmanager
def stage_executor(setup: Setup, options: ExploreOptions) -> Iterator[tuple[Executor, Stage]]:
    """The executor, and a function that computes a stage with it; its state lasts until the end of the context.

    Devices on their own clock must not wait: for them it is a child process, with one thread of BLAS and a low
    priority. On a simulated clock nothing runs in parallel, and stages are computed within the loop."""
    given = SetupGeometry.of(setup), options, setup.truth
    if not setup.runs_itself:
        yield Inline(), within_loop(exploration_stages(*given))
        return
    with computing(_begin, *given) as executor:
        yield executor, lambda name, *inputs: Compute(_compute, (name, *inputs), name)


def _begin(geometry: SetupGeometry, options: ExploreOptions, truth: Truth | None) -> None:
    """In the process, first of all."""
    global _stages
    _stages = exploration_stages(geometry, options, truth)


def _compute(name: str, *inputs: object) -> Computed:
    assert _stages is not None
    try:
        computed: Computed = getattr(_stages, name)(*inputs)
    except Exception as error:  # whatever it is made of travels as words
        raise RuntimeError(f"{type(error).__name__}: {error}") from None
    return computed
