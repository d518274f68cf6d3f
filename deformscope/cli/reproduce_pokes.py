"""`deformscope reproduce pokes`: predictions of a model fitted to a few pokes of a slab.

deformscope reproduce pokes
deformscope reproduce pokes --quick --out figures --json -
"""

from __future__ import annotations

import numpy as np

from deformscope.cli.common import fit_progress, make_folder, quiet_warp, recorder_of, show, write_file, write_json
from deformscope.config import PokesConfig
from deformscope.pictures.dents import dents_png
from deformscope.pictures.figures import write_rows
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Figure, Table
from deformscope.reproduce.poke_study import Studied, plans, rows, study
from deformscope.session import Step


def run(config: PokesConfig) -> None:
    """Make the slabs, fit, predict, draw, write and print."""
    make_folder(config.out)
    quiet_warp()

    studied = []
    with recorder_of(config) as recorder, fit_progress() as progress:
        for frame, plan in enumerate(plans()[: 1 if config.quick else None]):
            one = study(plan, progress=progress)
            studied.append(one)
            png = dents_png([each.prediction for each in one.unseen], one.unseen)
            caption = f"Pokes of the slab of {plan.name}, predicted and measured: cuts along x"
            found = Findings((_table(one),), (Figure(png, caption),))
            show(found)
            recorder.write(Step((found,), frame=frame))
    every = [one for found in studied for one in found.unseen]
    write_file(config.out / "dents.png", dents_png([one.prediction for one in every], every))
    table = rows(studied)
    write_rows(config.out / "pokes.csv", table)
    fits = [
        {"slab": one.plan.name, "field": one.found.model.field_kind, "pokes": one.found.rows()} | _law(one)
        for one in studied
    ]
    write_json({"fits": fits, "unseen": table}, config.output.json)


def _law(one: Studied) -> dict[str, object]:
    law = one.found.fit.best.law
    return {"cluster_size": law.cluster_size, "beta": law.beta, "theta": law.theta, "spacing_m": one.found.fit.spacing}


def _table(one: Studied) -> Table:
    law = one.found.fit.best.law
    what = f"clusters of {law.cluster_size}, beta {law.beta:.3g}, theta {law.theta:.3g}"
    lines = [(f"fitted to {len(one.plan.fitted)}", what)]
    for press, unseen in zip(one.plan.unseen, one.unseen, strict=True):
        tip = " x ".join(f"{1e3 * side:g}" for side in press.sides)
        for score in unseen.scores:
            force = "no force" if score.force_error is None else f"force {score.force_error:+.1%}"
            group = "" if one.plan.drawn is None else f"{one.plan.drawn.group(np.array(press.at))}, "
            what = f"{group}{tip} mm, {press.force:g} N, {score.method}"
            lines.append((what, f"surface off by {score.surface_error:.1%} of the depth, {force}"))
            if score.method == "MSM" and unseen.prediction.force_interval is not None:
                low, high = unseen.prediction.force_interval
                lines.append(("", f"90 % interval {low:.3g} to {high:.3g} N"))
    return Table(lines, caption=f"Slab of {one.plan.name}")
