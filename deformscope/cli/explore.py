"""`deformscope explore`: map how soft a surface is, and where, by looking and touching. `deformscope squeeze`: squeeze
a container once, for a data set or to name its content."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import EXIT_LOSSES, say, show, show_table, write_file, write_json
from deformscope.config import ExploreConfig, SqueezeConfig
from deformscope.errors import InputError
from deformscope.version import __version__

if TYPE_CHECKING:
    from deformscope.runs.exploration_result import ExplorationResult
    from deformscope.runs.squeeze_result import SqueezeResult
    from deformscope.stages.map.exploration import MapEstimate


def run(config: ExploreConfig) -> int:
    """Explore a simulated scene, or a rig. Returns the command's exit status."""
    if config.list_scenarios:
        from deformscope.lab.faults import Injected
        from deformscope.lab.scenes import BUILT_IN, BURIED, DRAWN

        print("simulated scenes; other hardnesses in newtons are possible (lab:two-80-200):")
        for name in BUILT_IN | BURIED:
            kind = next((kind for kind in DRAWN if name.startswith(kind)), name)
            drawn = ", ".join(f"{one.what} {one.low:g} to {one.high:g}" for one in DRAWN[kind])
            print(f"  lab:{name:<22} {drawn or 'nothing is drawn'}")
        print("faults that can be injected (--fault KIND@TOUCH):")
        for injected in Injected:
            print(f"  {injected.word:<26} {injected}")
        return 0
    from deformscope.recording.losses import named
    from deformscope.runs.exploration_run import explore_on

    outputs = _Outputs(config)
    explored = explore_on(config, outputs.write)
    if outputs.unwritten:
        raise outputs.unwritten[0]
    losses = explored.losses if explored is not None else {}
    if not losses or config.output.record is None:
        return 0
    say(f"deformscope: the recording is complete, with losses: {named(losses)}")
    return EXIT_LOSSES


def squeeze(config: SqueezeConfig) -> int:
    """Squeeze, store the trial, and report. Returns the command's exit status."""
    from deformscope.runs.squeeze_run import leave, squeeze_on

    def report(result: "SqueezeResult") -> None:
        write_json(result.as_json(), config.output.json)
        show(result)

    squeezed = squeeze_on(config, report)
    leave(squeezed)
    return EXIT_LOSSES if squeezed.result.losses and squeezed.result.recording is not None else 0


class _Outputs:
    """The files and the table of an exploration. unwritten: files that could not be written; the others are"""

    def __init__(self, config: ExploreConfig) -> None:
        self.config = config
        self.unwritten: list[InputError] = []

    def write(self, explored: "ExplorationResult") -> None:
        """Write and print the results."""
        config = self.config
        if (maps := explored.estimate) is not None:
            self._write(config.map, lambda: _map_file(config, maps))
            self._write(config.picture, lambda: explored.png)
        try:
            write_json(explored.as_json(), config.output.json)
        except OSError as error:
            self.unwritten.append(_unwritten(config.output.json or "", error))
        title = f"{config.rig} (simulated)" if explored.simulated else config.rig
        show_table(title, explored.rows())
        for one in self.unwritten:
            say(f"deformscope: not written: {one}")

    def _write(self, path: Path | None, make: Callable[[], bytes]) -> None:
        if path is None:
            return
        try:
            write_file(path, make())
        except Exception as error:
            self.unwritten.append(_unwritten(path, error))


def _unwritten(path: Path | str, error: Exception) -> InputError:
    words = error.strerror if isinstance(error, OSError) and error.strerror else f"{type(error).__name__}: {error}"
    return InputError("a writable output file", " ".join(words.split()).lower(), where=path)


def _map_file(config: ExploreConfig, maps: "MapEstimate") -> bytes:
    made_by: dict[str, Any] = {"scenario": config.rig, "seed": config.output.seed, "version": __version__}
    import numpy as np

    from deformscope.results.render import units_of
    from deformscope.runs.exploration_result import map_arrays

    units = units_of((type(maps),))
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, units=json.dumps(units), **map_arrays(maps), **made_by)
    return file.getvalue()
