"""`deformscope import`: makes a recording from bags and tables that other programs wrote.

deformscope import --inspect bag.mcap > map.toml
deformscope import bag.mcap --map map.toml --record run.rrd
"""

from __future__ import annotations

from deformscope.cli.common import EXIT_LOSSES, say, show, write_file, write_json
from deformscope.config import ImportConfig
from deformscope.recording.losses import named
from deformscope.runs.importing import import_source, import_take, inspect_source


def run(config: ImportConfig) -> int:
    """Import the source, or describe its content. Returns the command's exit status."""
    if config.inspect:
        found = inspect_source(config)
        if config.output.json != "-":
            print(found.toml, end="")
        if config.picture is not None:
            write_file(config.picture, found.picture())
        shown = {"source": config.source, "topics": found.topics, "map": found.toml}
        write_json(shown | {"streams": [one.as_json() for one in found.values]}, config.output.json)
        return 0
    result = import_source(config) if config.pairs is None else import_take(config, config.pairs)
    show(result)
    write_json(result.as_json(), config.output.json)
    if losses := result.losses:
        say(f"deformscope: the recording is complete, with losses: {named(losses)}")
    return EXIT_LOSSES if losses else 0
