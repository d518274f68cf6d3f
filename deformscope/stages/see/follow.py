"""Particles followed through a sequence; a large picture is reduced to the part and the resolution that they need.

On a picture of more than `LARGE_PX`, the flow is worked out around the particles alone. It is found where they are
`COARSE_PX` apart or more, and refined where they are `FINE_PX` apart or more."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.see.flow import FlowField, FlowStep, Image, flow_both_ways, flow_onward, reduced, refined
from deformscope.stages.see.particles import ParticleGrid, Tracked, advance, sample

LARGE_PX = 500_000
"""Pixels of a picture up to which all of it is used, at full resolution."""

FINE_PX, COARSE_PX = 72, 24
"""Distance of the particles at the resolution of the result, at least, where there are that many pixels; distance at
full resolution from which the flow is found at half of this resolution."""

JUMP_PX = 24
"""Motion in one step [px of the result] beyond which the flow is found at the resolution of the result: at less, the
edges of what moves are wider, and the step between its flow and that of its surroundings is too high for this."""

MARGIN, WIDER = 2.0, 3.0
"""Margin around the particles, in units of their distance, and how many times wider it is if it was too narrow."""

NEAR_PX = 16
"""Distance to the edge of that part [px of the coarse image], nearer to which the margin is too narrow."""

LOST_SHARE = 0.05
"""Share of the particles lost in one step from which the margin may have been too narrow."""


@dataclass(frozen=True, slots=True)
class View:
    """Part of a picture in which the flow is worked out, and its resolution.

    x, y, width, height: its place in the picture [px]; fine, coarse: pixels of the picture for one of the result, and
    of the image in which the flow is found"""

    x: int
    y: int
    width: int
    height: int
    fine: int
    coarse: int

    @classmethod
    def around(cls, at: FloatArray, spacing: float, size: tuple[int, int], margin: float) -> "View":
        """The view of points (K, 2) [px]. spacing: their distance; size: height, width of the picture; margin [px]"""
        fine = max(1, int(spacing / FINE_PX))
        coarse = fine * min(max(1, int(spacing / fine / COARSE_PX)), 3)
        limit = np.array([size[1], size[0]]) // coarse
        low = np.clip(np.floor((at.min(axis=0) - margin) / coarse), 0, limit - 1).astype(int)
        high = np.clip(np.ceil((at.max(axis=0) + margin) / coarse), low + 1, limit).astype(int)
        (x, y), (width, height) = low * coarse, (high - low) * coarse
        return cls(int(x), int(y), int(width), int(height), fine, coarse)

    def cut(self, image: Image) -> Image:
        """The part of an image."""
        return image[self.y : self.y + self.height, self.x : self.x + self.width]

    def holds(self, at: FloatArray, size: tuple[int, int]) -> bool:
        """Whether points (K, 2) [px] are inside, and not near an edge of the view alone. size: as in `around`"""
        near = NEAR_PX * self.coarse
        low = [self.x + near if self.x else -np.inf, self.y + near if self.y else -np.inf]
        right, bottom = self.x + self.width, self.y + self.height
        high = [
            right - near if right <= size[1] - self.coarse else np.inf,
            bottom - near if bottom <= size[0] - self.coarse else np.inf,
        ]
        return bool(np.all((at >= low) & (at <= high)))


class Follower:
    """Follows particles from image to image. grid: the particles at rest; size: height and width of the images [px]"""

    def __init__(self, grid: ParticleGrid, size: tuple[int, int]) -> None:
        self.is_large = size[0] * size[1] > LARGE_PX
        self._size, self._spacing = size, float(grid.spacing_px.min())
        self._margin = MARGIN
        self._view: View | None = None
        self._last: FlowStep | None = None
        self._fine: tuple[FlowStep, FlowField] | None = None

    def step(self, before: Image, after: Image, tracked: Tracked) -> tuple[FlowField, Tracked]:
        """Flow from one image to the next, and the particles there. tracked: the particles in `before`"""
        if not self.is_large:
            self._last = flow_onward(before, after, self._last)
            return self._last.forward, advance(tracked, self._last.forward, self._last.backward)
        view = self._view or self._around(tracked)
        while True:
            flow, there = self._in_view(view, before, after, tracked)
            lost = np.count_nonzero(tracked.seen & ~there.seen) > LOST_SHARE * tracked.seen.sum()
            if not lost and view.holds(there.position_px[there.seen], self._size):
                break
            self._margin *= WIDER
            if (wider := self._around(tracked)) == view:
                break
            view, self._last = wider, None
        self._view = view
        return flow, there

    def _around(self, tracked: Tracked) -> View:
        return View.around(tracked.position_px, self._spacing, self._size, self._margin * self._spacing)

    def _in_view(self, view: View, before: Image, after: Image, tracked: Tracked) -> tuple[FlowField, Tracked]:
        a, b = (reduced(view.cut(image), view.fine) for image in (before, after))
        here = tracked.position_px[tracked.seen] - (view.x, view.y) + 0.5
        times = view.coarse // view.fine
        at = here / view.coarse - 0.5
        self._last = step = flow_onward(reduced(a, times), reduced(b, times), self._last, at)
        corner, rough = (view.x, view.y), None
        forward, backward = step.forward, step.backward.placed(corner, view.coarse)
        if times > 1:
            if (np.abs(sample(forward.flow_px, at)) * times > JUMP_PX).any():
                forward, back = flow_both_ways(a, b, here / view.fine - 0.5)
                backward = back.placed(corner, view.fine)
            else:
                rough = forward.placed(corner, view.coarse)
                forward = refined(a, b, step, self._fine if step.steady else None)
        self._fine = step, forward
        forward = forward.placed(corner, view.fine)
        return forward, advance(tracked, forward, backward, rough)
