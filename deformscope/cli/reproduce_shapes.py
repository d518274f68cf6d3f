"""`deformscope reproduce shapes`: what beta and theta do to a body, as figures and as a recording to scrub.

deformscope reproduce shapes
deformscope reproduce shapes --record msm.rrd --viewer native
"""

from __future__ import annotations

import dataclasses

from deformscope.cli.common import fit_progress, make_folder, quiet_warp, recorder_of, say, show, write_json
from deformscope.config.reproduce import ShapesConfig
from deformscope.pictures.figures import write_rows
from deformscope.pictures.findings import Findings, dict_table
from deformscope.reproduce.cubes import thesis_cubes
from deformscope.reproduce.searches import compare_searches
from deformscope.reproduce.shapes import BETAS, KNOWN_BETA, NOISE_M, all_sweeps, known_sheet
from deformscope.reproduce.shapes_figures import draw_beta, draw_mesh, draw_push, draw_theta
from deformscope.session import Step
from deformscope.stages.msm.state_sweep import StateSweep, StateSweeps

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
    """Solve, draw, write and print."""
    make_folder(config.out)
    quiet_warp()
    out = config.out
    with recorder_of(config) as recorder, fit_progress() as note:
        sweeps = all_sweeps(lambda done, total: note("static states", done, total))
        linear, quadratic, sheet, cube = sweeps
        seen, model = known_sheet(config.output.seed)
        found = [dataclasses.asdict(one) for one in compare_searches(seen, model, (0.0, float(BETAS[-1])))]
        recorder.write(Step((StateSweeps(sweeps, GUIDE),)))
    draw_beta(out / "figure-3.5.png", linear, quadratic)
    draw_theta(out / "figure-3.7.png", cube)
    draw_mesh(out / "figure-3.8.png", thesis_cubes((0.4,), (6,), (0.03,))[0][0])
    draw_push(out / "figure-3.13.png", sheet)
    write_rows(out / "searches.csv", found)
    states = [row for sweep in sweeps for row in _rows(sweep)]
    write_rows(out / "states.csv", states)
    write_json({"states": states, "searches": found}, config.output.json)
    caption = f"Searches for a beta of {KNOWN_BETA:g}, seen with noise of {1e3 * NOISE_M:g} mm"
    show(Findings((dict_table(found, caption),)))
    say(f"figures and tables: {out}")


def _rows(sweep: StateSweep) -> list[dict[str, object]]:
    """One for each state."""
    other = "theta" if sweep.over == "beta" else "beta"
    return [
        {
            "body": sweep.lattice.name,
            sweep.over: float(value),
            other: sweep.other,
            "converged": bool(settled),
            "moved_m": float(moved),
            "size": float(size),
        }
        for value, settled, moved, size in zip(sweep.value, sweep.converged, sweep.moved_m, sweep.size, strict=True)
    ]
