"""Encodes device items, results of stages during the recording and those of an experiment, for rerun."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from deformscope.frames import DepthFrame, Frame, InputFile, Item, StageResult
from deformscope.log.layout import RecordingLayout
from deformscope.recording.outputs import Encoder, Outputs
from deformscope.recording.portions import Portions, RisingTimes
from deformscope.session import Step
from deformscope.stages.map.exploration import StageFailure

if TYPE_CHECKING:
    from deformscope.log.rig import Place


class DeviceEncoder:
    """An `Encoder` that gathers device items into portions.

    layout: layout of the recording; start_ns: host time at which `session` is 0 [ns]; lossless: devices whose colour
    images are stored without loss; at_frames: number of frames, for inputs and for results without a time
    failed: receives results that could not be shown; gather_s: time over which items are gathered [s]"""

    def __init__(
        self,
        outputs: Outputs,
        layout: RecordingLayout,
        start_ns: int,
        lossless: Collection[str],
        at_frames: Encoder,
        failed: list[StageFailure],
        gather_s: float,
    ) -> None:
        self._outputs, self._layout, self._at_frames, self._failed = outputs, layout, at_frames, failed
        self._start_ns, self._streams, self._lossless = start_ns, layout.streams, frozenset(lossless)
        self._camera = next((stream.device for stream in layout.streams if stream.kind == "depth"), None)
        self._touch = self._newest_ns = 0
        self._pictures_ns = RisingTimes()
        self._portions = Portions(gather_s)
        self._scales: dict[str, tuple[object, int]] = {}
        self._results: list[StageResult] = []
        self._latest: dict[str, StageResult] = {}

    def __len__(self) -> int:
        """How many items wait."""
        return len(self._portions)

    def write_items(self, items: Sequence[Item], size: int) -> None:
        """Show items immediately, and gather them with others of the same touch."""
        self._newest_ns = max([self._newest_ns, *(item.stamp.host_ns for item in items if isinstance(item, Frame))])
        pictures = [item for item in items if isinstance(item, DepthFrame) and item.device == self._camera]
        self._pictures_ns.add([item.stamp.host_ns - self._start_ns for item in pictures])
        place = self._place_of(self._touch)
        self._outputs.show(lambda live: live.add_items(items, self._start_ns, self._streams, place), size)
        if self._outputs.file is not None:
            self._write(self._portions.add(items, self._touch, size))

    def write_step(self, step: Step, size: int) -> None:
        """Write results of stages with device items: a result with a time at that time, others at their frame."""
        if step.moment is not None:
            self._touch = self._layout.touch_after(step.results, step.moment.touch)
            session_ns, place = step.moment.now_ns - self._start_ns, self._place(step.moment.touch)
            if step.moment.seen_ns is not None:
                seen_ns = np.array([step.moment.seen_ns - self._start_ns])
                place = dataclasses.replace(place, frame=int(place.at(seen_ns)[0]))
            batch = self._layout.prepare(step.results, session_ns, place, step.moment.cell_m, self._failed)
            self._outputs.send(batch, size)
            for cost in step.costs:
                behind_ns = max(self._newest_ns - step.moment.now_ns, 0)
                self._outputs.add_cost(step.moment.now_ns - self._start_ns, cost, behind_ns=behind_ns)
            return
        live = [one for one in step.results if isinstance(one, StageResult)]
        if live:
            results = {one.stage: one for one in live}
            for cost in step.costs:
                of = results.get(cost.stage, live[-1])
                self._outputs.add_cost(of.host_ns - self._start_ns, cost, behind_ns=round(of.late_s * 1e9))
            self._outputs.show(lambda view: view.add_results(live, self._start_ns, self._streams), 0)
            self._results += live if self._outputs.file is not None else ()
        if len(step.results) > len(live):
            self._at_frames.write_step(step, size)

    def write_input(self, given: InputFile) -> None:
        self._at_frames.write_input(given)

    def write_overdue(self) -> None:
        self._write(self._portions.overdue())

    def write_rest(self) -> None:
        self._write(self._portions.rest())
        self._write_stage_results()

    def _write(self, portions: Iterable[tuple[list[Item], int]]) -> None:
        from deformscope.log.rig import prepare_items

        for items, touch in portions:
            self._write_stage_results()
            place = self._place_of(touch)
            self._outputs.keep(prepare_items(items, self._start_ns, self._streams, self._lossless, place, self._scales))

    def _write_stage_results(self) -> None:
        from deformscope.log.stages import prepare_stage_results

        if self._results:
            results, self._results = self._results, []
            self._outputs.keep(prepare_stage_results(results, self._start_ns, self._streams, self._latest))

    def _place_of(self, touch: int) -> Place | None:
        return self._place(touch) if self._layout.by_touch else None

    def _place(self, touch: int) -> Place:
        from deformscope.log.rig import Place

        return Place(touch, self._pictures_ns.all, start_ns=self._start_ns)
