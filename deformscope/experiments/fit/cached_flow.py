"""The stored optical flow of a sequence: particles of any grid follow it in milliseconds."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from deformscope.arrays import BoolArray, ImageArray
from deformscope.errors import InputError
from deformscope.experiments.fit.foam_video import ParticleOptions
from deformscope.frames import ColorFrame
from deformscope.stages.see.flow import FlowField, FlowStep, flow_onward
from deformscope.stages.see.particles import ParticleGrid, Tracked, advance, seed_grid, select_held, start

MOST_BYTES = 2 << 30
"""Memory limit of the stored flow."""


class CachedFlow:
    """first, last: first and last image; `follow` follows particles.

    frames: the frames in order; note: called with the number of frames taken so far.
    Raises InputError for a single frame, and for more frames than may be held in memory."""

    def __init__(self, frames: Iterable[ColorFrame], note: Callable[[int], None]) -> None:
        self._flows: list[tuple[FlowField, FlowField]] = []
        images: list[ImageArray] = []
        held_bytes = 0
        step: FlowStep | None = None
        for done, frame in enumerate(frames, 1):
            if images:
                step = flow_onward(images[-1], frame.image, step)
                forward, backward = step.forward, step.backward
                self._flows.append((forward, FlowField(backward.flow_px)))  # all of them that `advance` looks at
                maps = (forward.flow_px, forward.noise_px, forward.misfit, backward.flow_px)
                held_bytes += sum(one.nbytes for one in maps if one is not None)
                if held_bytes > MOST_BYTES:
                    came = f"more: {done} frames so far"
                    raise InputError(f"flow of at most {MOST_BYTES >> 30} GiB to keep", came, "a larger --stride")
            images = [*images[:1], frame.image]
            note(done)
        if len(images) < 2:
            raise InputError("at least two frames", "fewer", "a longer sequence, or a smaller --stride")
        self.first, self.last = images

    def follow(self, particles: ParticleOptions, mask: BoolArray | None) -> tuple[ParticleGrid, list[Tracked]]:
        """Positions of the particles at rest and at every frame [px], as `foam_video.track` returns them. mask: (H, W)
        mask of the body"""
        grid = seed_grid(self.first.shape[:2], particles.roi_rect, particles.grid, particles.spacing_px, mask)
        select_held(grid, particles.held, particles.contact_rect)
        history = [start(grid)]
        for forward, backward in self._flows:
            history.append(advance(history[-1], forward, backward))
        return grid, history
