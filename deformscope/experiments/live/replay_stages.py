"""The results of stages that ran during a recording, computed again from the recorded frames that they name."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from deformscope.errors import InputError
from deformscope.experiments.live.device_stages import LiveOptions, Stage, compute, stages_of
from deformscope.frames import Frame, StageResult
from deformscope.recording.items import read_items, read_stage_results, read_streams
from deformscope.recording.reader import Replay
from deformscope.rows import to_components
from deformscope.stages.map.exploration import StageFailure

Key = tuple[str, int]
"""A device, and a frame's place in its stream."""


@dataclass(frozen=True, slots=True)
class ReplayedStages:
    """Outcome of a replay of stages. results: number of results computed again; failures: recorded failures, which are
    not computed again: whether a stage fails may depend on the machine; different: largest difference of each stage's
    numbers, as a share of the number (0 = equal to the last bit; inf = different words or sizes)"""

    results: int
    failures: tuple[StageFailure, ...]
    different: dict[str, float]


def replay_stages(path: Path, *, trust: bool = False) -> ReplayedStages:
    """Compute every recorded result again from the frames that it names, read from the recording, and compare. trust:
    skip the comparison with the ledger. Raises InputError if frames are missing."""
    replay = Replay(path, trust=trust)
    options = msgspec.convert(replay.settings["stages"], LiveOptions)
    stages: dict[str, Stage] = {stage.name: stage for stage in stages_of(options, read_streams(path, trust=True))}
    recorded = read_stage_results(path, trust=True)
    again = [one for one in recorded if not isinstance(one.result, StageFailure)]
    different = dict.fromkeys((one.stage for one in again), 0.0)
    for one, frames in _with_frames(path, again):
        found = _difference(one.result, _computed(stages[one.stage], frames))
        different[one.stage] = max(different[one.stage], found)
    failures = tuple(one.result for one in recorded if isinstance(one.result, StageFailure))
    return ReplayedStages(len(again), failures, different)


def _computed(stage: Stage, frames: Sequence[Frame]) -> object:
    try:
        return compute(stage, stage.packed(frames))
    except Exception as error:
        return StageFailure.of(stage.name, 0, error)


def _with_frames(path: Path, results: Sequence[StageResult]) -> Iterator[tuple[StageResult, list[Frame]]]:
    """Each result with the frames that it used, in one pass over the recording; a frame is held while it is needed."""
    needed = Counter(key for one in results for key in _keys(one))
    ending: dict[Key, list[StageResult]] = {}
    for one in results:
        ending.setdefault(_keys(one)[-1], []).append(one)
    held: dict[Key, Frame] = {}
    for item in read_items(path, trust=True):
        if not isinstance(item, Frame) or (item.device, item.index) not in needed:
            continue
        key = item.device, item.index
        held[key] = item
        for one in ending.pop(key, ()):
            keys = _keys(one)
            if missing := [key for key in keys if key not in held]:  # of the same moment, as of another device
                ending.setdefault(missing[0], []).append(one)
                continue
            yield one, [held[key] for key in keys]
            needed.subtract(keys)
            for key in [key for key in keys if needed[key] == 0]:
                held.pop(key, None)
    if ending:
        key = next(iter(ending))
        raise InputError("every frame that a result needs", f"no frame {key[1]} of {key[0]}", where=path)


def _keys(one: StageResult) -> list[Key]:
    return [(used.device, index) for used in one.used for index in range(used.first, used.last + 1)]


def _difference(before: object, now: object) -> float:
    """The largest difference of two results' numbers, as a share of the larger one."""
    if type(before) is not type(now):
        return float("inf")
    first, second = to_components(before), to_components(now)
    if first.keys() != second.keys():
        return float("inf")
    worst = 0.0
    for name, one in first.items():
        other, number = second[name], one.dtype.kind == "f"
        if one.shape != other.shape:
            return float("inf")
        if np.array_equal(one, other, equal_nan=number):
            continue
        if not number or not np.array_equal(np.isfinite(one), np.isfinite(other)):
            return float("inf")
        known = np.isfinite(one)
        scale = max(float(np.abs(one[known]).max()), float(np.abs(other[known]).max()))
        worst = max(worst, float(np.abs(one - other)[known].max()) / scale)
    return worst
