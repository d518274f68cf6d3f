"""`deformscope reproduce pokes`: what a model fitted to a few pokes of a slab says about others.

deformscope reproduce pokes
deformscope reproduce pokes --quick --out figures --json -
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from deformscope.cli.common import console, fit_progress, make_folder, quiet_warp, replacing, show_table, write_json
from deformscope.config import PokesConfig

if TYPE_CHECKING:
    from deformscope.studies.poke_study import Studied


def run(config: PokesConfig) -> None:
    """Make the slabs, fit, predict, draw, write and tell."""
    make_folder(config.out)
    quiet_warp()
    from deformscope.pictures.figures import write_table
    from deformscope.studies.dents_figure import draw_dents
    from deformscope.studies.poke_study import PLANS, rows, study

    studied = []
    with fit_progress() as progress:
        for plan in PLANS[: 1 if config.quick else None]:
            studied.append(study(plan, progress=progress))
    every = [one for found in studied for one in found.unseen]
    with replacing(config.out / "dents.png") as file:
        draw_dents([one.prediction for one in every], every, file)
    names = ("slab", "at_m", "tip_mm", "force_n", "method", "surface_error", "force_error")
    table = rows(studied)
    write_table(config.out / "pokes.csv", names, table)
    for one in studied:
        _tell(one)
    console().print(f"figures and table: {config.out}", markup=False, soft_wrap=True)
    told = [dict(zip(names, row, strict=True)) for row in table]
    fits = [
        {"slab": one.plan.name, "field": one.found.model.field_kind, "pokes": one.found.rows()} | _law(one)
        for one in studied
    ]
    write_json({"fits": fits, "unseen": told}, config.json)


def _law(one: Studied) -> dict[str, object]:
    law = one.found.fit.best.law
    return {"cluster_size": law.cluster_size, "beta": law.beta, "theta": law.theta, "spacing_m": one.found.fit.spacing}


def _tell(one: Studied) -> None:
    law = one.found.fit.best.law
    what = f"clusters of {law.cluster_size}, beta {law.beta:.3g}, theta {law.theta:.3g}"
    told = [(f"fitted to {len(one.plan.fitted)}", what)]
    for press, unseen in zip(one.plan.unseen, one.unseen, strict=True):
        tip = " x ".join(f"{1e3 * side:g}" for side in press.sides)
        for score in unseen.scores:
            force = "no force" if score.force_error is None else f"force {score.force_error:+.1%}"
            what = f"{tip} mm, {press.force:g} N, {score.method}"
            told.append((what, f"surface off by {score.surface_error:.1%} of the depth, {force}"))
    show_table(f"Slab of {one.plan.name}", told)
