"""`python -m studies reproduce pokes`: predictions of a model fitted to a few pokes of a slab.

python -m studies reproduce pokes
python -m studies reproduce pokes --quick --out figures --json -
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.config import flags
from deformscope.pictures.figures import dents_png
from deformscope.pictures.report import Figure, Table
from deformscope.plain import plain
from deformscope.stages.poke.fitted import PokeComparison
from studies.output import write_rows
from studies.reproduce.poke_study import Studied, plans, rows, study
from studies.runner import Study, StudyOptions, StudyReport, Trials


@dataclass(frozen=True, slots=True)
class PokesConfig(StudyOptions):
    """Predict pokes of finite element slabs that were not fitted, and compare a rigid body, a half-space and linear
    finite elements."""

    out: flags.Folder = Path("runs/pokes")
    """Folder of dents.png and pokes.csv; made if missing. Existing files of these names are replaced."""
    quick: bool = False
    """Only the slab of one modulus."""


@dataclass(frozen=True, slots=True)
class SlabPokes:
    """A slab's pokes. fit: the fitted ones, for JSON; rows, words: the unseen ones"""

    name: str
    fit: dict[str, Any]
    rows: list[dict[str, Any]]
    words: list[tuple[str, str]]
    unseen: tuple[PokeComparison, ...]


def predict_slab(number: int) -> SlabPokes:
    """Fit the slab of this place among `plans`, and predict its unseen pokes."""
    one = study(plans()[number])
    fit = {"slab": one.plan.name, "field": one.found.model.field_kind, "pokes": plain(one.found.rows())} | _law(one)
    return SlabPokes(one.plan.name, fit, rows([one]), _words(one), one.unseen)


def trials(options: PokesConfig) -> list[Trials[int, SlabPokes]]:
    """The slabs."""
    return [Trials("slabs", predict_slab, range(1 if options.quick else len(plans())))]


def report(options: PokesConfig, seconds: float, slabs: Sequence[SlabPokes]) -> StudyReport:
    """Each slab's pokes, predicted and measured."""
    every = [one for slab in slabs for one in slab.unseen]
    png = dents_png([one.prediction for one in every], every)
    unseen = [row for slab in slabs for row in slab.rows]
    write_rows(options.out / "pokes.csv", unseen)
    tables = [Table(slab.words, caption=f"Slab of {slab.name}") for slab in slabs]
    figure = Figure(png, "Pokes of the slabs, predicted and measured: cuts along x")
    json = {"fits": [slab.fit for slab in slabs], "unseen": unseen}
    return StudyReport(tables, json, [figure], {options.out / "dents.png": png})


def _law(one: Studied) -> dict[str, object]:
    law = one.found.fit.best.law
    return {"cluster_size": law.cluster_size, "beta": law.beta, "theta": law.theta, "spacing_m": one.found.fit.spacing}


def _words(one: Studied) -> list[tuple[str, str]]:
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
    return lines


STUDY = Study(PokesConfig, trials, report)
