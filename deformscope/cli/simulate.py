"""`deformscope simulate`: a measured slab in another simulator."""

from deformscope.cli.common import fit_progress, show, write_json
from deformscope.config import SimulateConfig
from deformscope.runs.simulation import simulate


def run(config: SimulateConfig) -> None:
    """Fit, print and write."""
    with fit_progress() as progress:
        found = simulate(config, progress)
    show(found)
    write_json(found.to_dict(), config.output.json)
