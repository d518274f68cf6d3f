"""`deformscope indent`: Young's modulus from force over depth alone."""

from deformscope.cli.common import show, write_file, write_json
from deformscope.config import IndentConfig
from deformscope.runs.indentation import indent


def run(config: IndentConfig) -> None:
    """Fit, print and write."""
    found = indent(config)
    show(found)
    if config.picture is not None:
        write_file(config.picture, found.figures()[0].png)
    if config.report is not None:
        write_file(config.report, found.page().encode())
    write_json(found.to_dict(), config.output.json)
