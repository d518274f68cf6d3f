"""`deformscope reproduce chapter4`: figures 4.4 to 4.7 and table 4.1 by the thesis's own rules.

deformscope reproduce chapter4
deformscope reproduce chapter4 --quick --out figures --json -
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from deformscope.cli.common import (
    make_folder,
    pictures_of,
    quiet_warp,
    recorder_of,
    show,
    write_json,
)
from deformscope.cli.study import Trials, tried
from deformscope.config import Chapter4Config
from deformscope.pictures.figures import write_rows
from deformscope.pictures.findings import Findings, dict_table
from deformscope.pictures.report import Table
from deformscope.reproduce.chapter4 import (
    HARDNESSES_N,
    OWN,
    SCENARIOS,
    FoamDent,
    Scenario,
    explore_scenario,
    press_foam,
    to_text,
)
from deformscope.reproduce.chapter4_figures import draw_betas, draw_clouds, draw_dents, draw_fields
from deformscope.session import Step


def run(config: Chapter4Config) -> None:
    """Press, explore, draw, write and print."""
    make_folder(config.out)
    quiet_warp()
    hardnesses = HARDNESSES_N[1:2] if config.quick else HARDNESSES_N
    scenes = list(SCENARIOS)[:1] if config.quick else list(SCENARIOS)
    jobs = [(scene, seed) for seed in range(1 if config.quick else config.seeds) for scene in scenes]
    own = replace(OWN, beta_grid_m=config.beta_grid_m, beta_step=config.beta_step, sigma_w_m=config.sigma_w_m)
    with recorder_of(config) as recorder:
        foams = tried(Trials("foams", partial(press_foam, own=own), hardnesses), config.on, config.workers)
        explored = tried(Trials("exploring", partial(explore_scenario, own=own), jobs), config.on, config.workers)
        recorder.write(Step((_write(foams, explored, config),)))


def _write(foams: Sequence[FoamDent], explored: Sequence[Scenario], config: Chapter4Config) -> Findings:
    out = config.out
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
    runs = [_run(one) for one in explored]
    why = to_text(foams, explored, config.beta_step)
    summary = {"betas": betas, "table": rows, "why": why, "explorations": runs}
    write_json(summary, str(out / "chapter4.json"))
    write_json(summary, config.output.json)
    found = Findings(
        (
            Table(
                [(row["scene"], _format_row(row)) for row in rows],
                caption="Table 4.1 at Th = 0.06, the thesis's in brackets",
            ),
            Table([(line,) for line in why], caption="In words"),
        )
    )
    show(found)
    drawn = pictures_of(
        {
            "Figure 4.4: input of the sweep of beta": out / "figure44.png",
            "Figure 4.5: beta over hardness": out / "figure45.png",
            "Figure 4.6: dents of the same touch": out / "figure46.png",
            "Figure 4.7: truth, fields of beta, variance and contacts": out / "figure47.png",
        }
    )
    return Findings((*found.tables, dict_table(betas, "Figure 4.5")), drawn)


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
