"""`deformscope reproduce shapes --record msm.rrd`: effect of beta and theta on a body, as a recording with
timelines."""

from __future__ import annotations

from deformscope.cli.common import quiet_warp, recorder_of, say, write_json
from deformscope.config.reproduce import ShapesConfig
from deformscope.reproduce.shapes import all_sweeps
from deformscope.session import Step, with_costs
from deformscope.stages.msm.state_sweep import StateSweeps


def run(config: ShapesConfig) -> None:
    """Solve, record and write."""
    quiet_warp()
    with recorder_of(config) as recorder:
        sweeps, costs = with_costs("states", all_sweeps)
        recorder.write(Step((StateSweeps(sweeps),), costs=tuple(costs)))
    for one in sweeps:
        say(one.to_text())
    write_json(sweeps, config.output.json)
