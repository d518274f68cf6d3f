"""`python -m studies reproduce chapter4`: figures 4.4 to 4.7 and table 4.1 by the thesis's own rules.

python -m studies reproduce chapter4
python -m studies reproduce chapter4 --quick --out figures --json -
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from tyro.conf import OmitArgPrefixes

from deformscope.config import flags
from deformscope.pictures.report import Table
from studies.output import dict_table, pictures_of, write_rows
from studies.reproduce.chapter4_figures import draw_betas, draw_clouds, draw_dents, draw_fields
from studies.reproduce.thesis_map import ThesisFlags
from studies.reproduce.thesis_rules import (
    HARDNESSES_N,
    OWN,
    SCENARIOS,
    FoamDent,
    Scenario,
    ScenarioCase,
    TouchedFoam,
    explore_scenario,
    press_foam,
    to_text,
)
from studies.runner import Study, StudyOptions, StudyReport, Trials


@dataclass(frozen=True, slots=True)
class Chapter4Config(StudyOptions):
    """Thesis chapter 4 by its own rules: figure 4.4 (input of the sweep of beta), 4.5 (beta over hardness, by held
    particles and cluster size), 4.6 (dents of foams) and 4.7 (fields of beta, isopleths, variance, truth). Table 4.1
    has the number of touches at Th. It takes about 15 minutes on two cores."""

    out: flags.Folder = Path("runs/chapter4")
    """Folder for the figures (PNG) and tables (CSV); existing files are replaced."""
    seeds: flags.ManyFlag = 3
    """Layouts of each scenario, from seed 0 on; figure 4.7 shows the first."""
    thesis: OmitArgPrefixes[ThesisFlags] = field(default_factory=ThesisFlags)
    quick: bool = False
    """Only one foam and one scenario."""


def trials(options: Chapter4Config) -> list[Trials[Any, Any]]:
    """The foams, and the scenarios of each seed."""
    hardnesses = HARDNESSES_N[1:2] if options.quick else HARDNESSES_N
    scenes = list(SCENARIOS)[:1] if options.quick else list(SCENARIOS)
    own = replace(OWN, thesis=options.thesis)
    seeds = range(1 if options.quick else options.seeds)
    return [
        Trials("foams", press_foam, [TouchedFoam(one, own) for one in hardnesses]),
        Trials(
            "explorations", explore_scenario, [ScenarioCase(scene, seed, own) for seed in seeds for scene in scenes]
        ),
    ]


def report(
    options: Chapter4Config, seconds: float, foams: Sequence[FoamDent], explored: Sequence[Scenario]
) -> StudyReport:
    """Figures and tables."""
    out = options.out
    betas = [
        {
            "hardness_n": foam.hardness_n,
            "depth_m": foam.depth_m,
            "hold": one.hold,
            "cluster_size": one.cluster_size,
            "beta": one.beta,
            "error_m": one.error_m,
        }
        for foam in foams
        for one in foam.betas
    ]
    rows = [
        _row(name, [one for one in explored if one.scene == name])
        for name in dict.fromkeys(one.scene for one in explored)
    ]
    write_rows(out / "figure45.csv", betas)
    write_rows(out / "table41.csv", [{name: _cell(value) for name, value in row.items()} for row in rows])
    draw_clouds(foams[0], out / "figure44.png")
    draw_betas(foams, out / "figure45.png")
    draw_dents(foams, out / "figure46.png")
    draw_fields([one for one in explored if one.seed == 0], out / "figure47.png")
    why = to_text(foams, explored, options.thesis.beta_step)
    summary = {"betas": betas, "table": rows, "why": why, "explorations": [_run(one) for one in explored]}
    drawn = pictures_of(
        {
            "Figure 4.4: input of the sweep of beta": out / "figure44.png",
            "Figure 4.5: beta over hardness": out / "figure45.png",
            "Figure 4.6: dents of the same touch": out / "figure46.png",
            "Figure 4.7: truth, fields of beta, variance and contacts": out / "figure47.png",
        }
    )
    tables = [
        Table(
            [(row["scene"], _format_row(row)) for row in rows],
            caption="Table 4.1 at Th = 0.06, the thesis's in brackets",
        ),
        Table([(line,) for line in why], caption="In words"),
    ]
    return StudyReport(tables, summary, drawn, further=[dict_table(betas, "Figure 4.5")])


def _row(name: str, mine: Sequence[Scenario]) -> dict[str, Any]:
    """touches of each layout; regions and iou of each, by layers and by a single layer"""
    thesis_n, thesis_regions = SCENARIOS[name]
    row: dict[str, Any] = {
        "scene": name,
        "thesis_touches": thesis_n,
        "touches": [len(one.contacts_m) for one in mine],
        "ended": [one.stop_reason for one in mine],
        "thesis_regions": thesis_regions,
    }
    for model in mine[0].fields:
        key = model.replace(" ", "_")
        row[f"{key}_regions"] = [one.fields[model].regions for one in mine]
        row[f"{key}_iou"] = float(np.median([one.fields[model].iou for one in mine]))
    return row


def _format_row(row: dict[str, Any]) -> str:
    parts = [f"n = {_list(row['touches'])} [{row['thesis_touches']}]"]
    for model in ("layers", "single_layer"):
        regions = f"{_list(row[f'{model}_regions'])} [{row['thesis_regions']}]"
        parts.append(f"{model.replace('_', ' ')}: regions {regions}, IoU {row[f'{model}_iou']:.2f}")
    return "; ".join(parts)


def _list(values: Sequence[int]) -> str:
    return ", ".join(map(str, values))


def _cell(value: object) -> object:
    return "; ".join(map(str, value)) if isinstance(value, list) else value


def _run(one: Scenario) -> dict[str, Any]:
    return {
        "scene": one.scene,
        "seed": one.seed,
        "contacts_m": one.contacts_m.tolist(),
        "rigid": one.rigid.tolist(),
        "ended": one.stop_reason,
        "most_variance": float(one.variance.max()),
        "fields": {
            model: {
                "beta": list(found.touches),
                "isopleths": found.isopleths.tolist(),
                "regions": found.regions,
                "iou": found.iou,
            }
            for model, found in one.fields.items()
        },
    }


STUDY = Study(Chapter4Config, trials, report)
