"""Every solve of these tests is counted: what converges does so with at most half of the iterations it is allowed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest

from tests.cases import slow

if TYPE_CHECKING:
    from deformscope.stages.msm.solver import Precision

MOST_SHARE = 0.5
"""Of the allowed iterations: a solve that needs more hangs on the rounding of the processor and its libraries."""


@dataclass
class Effort:
    """Shares of the allowed iterations that solves needed in which every candidate converged.

    judged: whether the test rests on their having converged"""

    shares: list[tuple[str, float]]
    judged: bool = True

    def of_no_concern(self) -> None:
        """The test holds whether its solves converge or not."""
        self.judged = False

    @property
    def most(self) -> float:
        return max((share for _, share in self.shares), default=0.0)


@pytest.fixture(params=["float64", slow("float32")])
def precision(request: pytest.FixtureRequest) -> Precision:
    """Single precision is slow, for the time that its kernels take to compile; pokes and statics have a case of it."""
    found: Precision = request.param
    return found


@pytest.fixture(autouse=True)
def effort(monkeypatch: pytest.MonkeyPatch) -> Iterator[Effort]:
    """Counts the solves of a test, and fails it where one that converged was near its limit."""
    pytest.importorskip("warp")
    from deformscope.stages.msm.iteration import Anderson, Newton
    from deformscope.stages.msm.newton_functions import CONVERGED
    from deformscope.stages.msm.reduced import OneCluster

    counted = Effort([])

    def relaxing(plain: Callable[..., Any]) -> Callable[..., Any]:
        def relax(self: Any, start: Any, tolerance: float, most: int, *watched: Any) -> Any:
            ended = plain(self, start, tolerance, most, *watched)
            if (ended.state == CONVERGED).all():
                counted.shares.append((plain.__qualname__, ended.total.max() / most))
            return ended

        return relax

    def relaxing_one(plain: Callable[..., Any]) -> Callable[..., Any]:
        def relax(self: Any, *args: Any, max_iterations: int = 200, **options: Any) -> Any:
            found = plain(self, *args, max_iterations=max_iterations, **options)
            if found.converged.all():
                counted.shares.append((plain.__qualname__, found.iterations.max() / max_iterations))
            return found

        return relax

    for kind in (Newton, Anderson):
        monkeypatch.setattr(kind, "relax", relaxing(kind.relax))
    monkeypatch.setattr(OneCluster, "relax", relaxing_one(OneCluster.relax))
    yield counted
    near = [f"{name}: {share:.0%}" for name, share in counted.shares if counted.judged and share > MOST_SHARE]
    assert not near, f"solves that needed more than {MOST_SHARE:.0%} of the allowed iterations: {', '.join(near)}"
