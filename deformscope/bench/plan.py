"""Cases to measure, and their durations."""

from collections.abc import Callable
from dataclasses import dataclass

from deformscope.bench.bodies import BenchBody
from deformscope.bench.timing import Timing, clock
from deformscope.bench_cases import CASES, Case
from deformscope.stages.msm.solver import Msm, Precision

SIZES = (216, 512, 1331, 50_653, 195_112, 1_000_000)
QUICK_SIZES = (216, 1331)
CUDA_SIZE = 9_938_375
"""A cube of 215^3 particles: by default only a GPU simulates it."""

CLUSTER = 3
"""Default particles per side of a cluster."""
MIDDLE = 11
"""Side of the cube of 1331 particles, at which most is compared."""
BETA = 0.7

Note = Callable[[str], None]
"""Receives the name of the present case."""


@dataclass(frozen=True, slots=True)
class BenchPlan:
    """The cases to measure.

    device: warp's name of the device; sizes: particles of the cubes, each n^3; repeats: number of rounds of every
    comparison, None = as many as fit
    quick: short rounds and less of everything; only: the cases to measure"""

    device: str
    sizes: tuple[int, ...]
    repeats: int | None = None
    quick: bool = False
    only: tuple[Case, ...] = CASES

    @property
    def cpu(self) -> bool:
        return self.device == "cpu"

    @property
    def turn_s(self) -> float:
        """How long one contestant's turn takes where that can be chosen."""
        return 0.02 if self.quick else 0.1

    @property
    def longest_s(self) -> float:
        """Longest expected time of a row; slower cases are left out."""
        return 3.0 if self.quick else 20.0

    def rounds(self, seconds: float, least: int = 1) -> int:
        """Number of repeats of a round with this duration."""
        if self.repeats is not None:
            return self.repeats
        budget_s, most = (0.5, 3) if self.quick else (4.0, 9)
        return max(least, min(most, int(budget_s / max(seconds, 1e-9))))

    def rounds_of_steps(self, seconds: float) -> int:
        """Number of rounds in a case whose rounds are short, so that there are always several."""
        return self.rounds(seconds, 3)

    def engine(self, body: BenchBody, size: int = CLUSTER, precision: Precision = "float64") -> Msm:
        """The body in overlapping clusters on the plan's device."""
        return Msm(body.rest, body.clusters(size), body.held, precision=precision, device=self.device)

    def turn(self, work: Callable[[], object]) -> Callable[[], Timing]:
        """A contestant's turn of a short case: it runs as often as fits, and the time of one run is reported."""
        work()
        count = max(1, min(10_000, int(self.turn_s / clock(work).wall_s)))

        def often() -> None:
            for _ in range(count):
                work()

        return lambda: clock(often).per(count)


def default_sizes(device: str, quick: bool) -> tuple[int, ...]:
    """Sizes that take about 2 minutes in all on 2 cores."""
    if quick:
        return QUICK_SIZES
    return SIZES if device == "cpu" else (*SIZES, CUDA_SIZE)


def side_of(particles: int) -> int:
    """The n of a number n^3; 0 for other numbers."""
    side = round(particles ** (1 / 3))
    return side if side**3 == particles else 0
