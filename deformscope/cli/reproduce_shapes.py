"""`deformscope reproduce shapes --record msm.rrd`: what beta and theta do to a body, as a recording to scrub."""

from __future__ import annotations

from deformscope.cli.common import quiet_warp, recorder_of, say, write_json
from deformscope.config.reproduce import ShapesConfig
from deformscope.reproduce.shapes import all_sweeps
from deformscope.session import Step
from deformscope.stages.msm.state_sweep import StateSweeps

GUIDE = """\
### What beta and theta do

Each view is a body whose yellow particles are held; red ones are where they come to rest, green ones where they were.
Scrub the timeline **beta** or **theta** (bottom left chooses it; it counts hundredths: 37 is 0.37). A body moves on the
timeline that its view's title begins with, and stays at rest on the other.

- **one cluster, linear**: at beta 0 the free particles follow the best rigid motion; at .99 they stretch and shear.
- **one cluster, quadratic**: its top is turned, and the body bends.
- **clusters of 3 x 3**: the larger beta, the more of the body goes down with the particle that is pressed.
- **cube**: beta is .99; as theta rises, the pressed body widens, since each cluster keeps more of its volume.
"""


def run(config: ShapesConfig) -> None:
    """Solve, record and write."""
    quiet_warp()
    with recorder_of(config) as recorder:
        sweeps = all_sweeps()
        recorder.write(Step((StateSweeps(sweeps, GUIDE),)))
    for one in sweeps:
        ends = (f"{one.measure[at]:.1f} at {one.over} {one.value[at]:g}" for at in (0, -1))
        say(f"{one.name}: {one.measured}: {', '.join(ends)}")
    write_json(sweeps, config.output.json)
