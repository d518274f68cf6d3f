"""`deformscope reproduce cubes`: the thesis's experiment 3.A, its figures and its table.

deformscope reproduce cubes
deformscope reproduce cubes --quick --out figures --json -
deformscope reproduce cubes --pairs cube_nu0.25.npz cube_nu0.4.npz
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deformscope.cli.common import (
    fit_progress,
    make_folder,
    pictures_of,
    quiet_warp,
    read_file,
    recorder_of,
    show,
    write_json,
)
from deformscope.cli.study import Trials, tried
from deformscope.config import CubesConfig
from deformscope.pictures.figures import write_rows
from deformscope.pictures.findings import Findings, dict_table
from deformscope.pictures.report import Table
from deformscope.reproduce import cubes as study
from deformscope.reproduce import cubes_figures as figures
from deformscope.reproduce.cubes import (
    Cube,
    CubeResult,
    ElementTime,
    compared,
    cube_from_pair,
    depths_of,
    examine,
    model_times,
    rises,
    thesis_cubes,
)
from deformscope.reproduce.cubes_figures import depth_name, sem_rows, time_rows
from deformscope.session import Step


def run(config: CubesConfig) -> None:
    """Make or read the cubes, fit each in one of several processes, then draw, write and print."""
    make_folder(config.out)
    quiet_warp()
    with recorder_of(config) as recorder:
        began = time.perf_counter()
        cubes, elements = _read(config.pairs) if config.pairs else _make(config.quick)
        made = time.perf_counter()
        found = _examine(cubes, config)
        times = time_rows(model_times(found), elements)
        sems = sem_rows(found)
        drawn = _draw(config, found, sems, times)
        seconds = {"cubes": made - began, "fits_and_figures": time.perf_counter() - made}
        summary = report(found, sems, times, seconds)
        overview = Table(_rows(summary, found, config), caption=f"{len(found)} cubes")
        searched = Table(figures.search_summary(figures.search_rows(found)), caption="Searches for theta, same cubes")
        tables = (overview, dict_table(sems, "Spread of theta"), dict_table(times, "Table 3.2"), searched)
        show(Findings((overview, searched)))
        recorder.write(Step((Findings(tables, pictures_of(drawn)),)))
    write_json(summary, str(config.out / "cubes.json"))
    write_json(summary, config.output.json)


# Cubes ---------------------------------------------------------------------------------------------------------------


def _make(quick: bool) -> tuple[list[Cube], list[ElementTime]]:
    with fit_progress() as note:
        sides = study.SIDES[:1] if quick else study.SIDES
        return thesis_cubes(study.POISSON, sides, progress=lambda done, total: note("finite elements", done, total))


def _read(paths: Sequence[Path]) -> tuple[list[Cube], list[ElementTime]]:
    cubes = [cube_from_pair(read_file(path, "a pair file (.npz)"), str(path)) for path in paths]
    return sorted(cubes, key=lambda cube: (len(cube.seen.rest), cube.poisson, cube.depth)), []


def _examine(cubes: Sequence[Cube], config: CubesConfig) -> list[CubeResult]:
    jobs = [(cube, config, one) for cube, one in zip(cubes, compared(cubes, config), strict=True)]
    # the long ones first, so that none is left alone at the end
    order = sorted(range(len(jobs)), key=lambda place: -len(cubes[place].seen.rest))
    found = tried(Trials("cubes", _one, [jobs[place] for place in order]), config.on, config.workers)
    return [one for _, one in sorted(zip(order, found, strict=True), key=lambda pair: pair[0])]


def _one(job: tuple[Cube, CubesConfig, bool]) -> CubeResult:
    return examine(*job)


# Results -------------------------------------------------------------------------------------------------------------


def _draw(
    config: CubesConfig,
    found: Sequence[CubeResult],
    sems: Sequence[dict[str, object]],
    times: Sequence[dict[str, object]],
) -> dict[str, Path]:
    """Draw and write; the pictures by their titles."""
    out = config.out
    theta, errors = out / "figure-3.10.png", out / "figure-3.11.png"
    figures.draw_theta(theta, found)
    figures.draw_errors(errors, found)
    drawn = {"theta over Poisson's ratio (Thesis figure 3.10)": theta, "error (Thesis figure 3.11)": errors}
    if len({one.cube.resolution for one in found}) > 1:
        name = "theta over the resolution, with particle masses as they are and with held particles of equal mass"
        drawn[name] = out / "resolution.png"
        figures.draw_resolution(drawn[name], found)
    if config.compare != "none":
        name = "overlapping clusters compared with one cluster"
        drawn[name] = out / "clusters.png"
        figures.draw_clusters(drawn[name], found, config.cluster_size)
    searches = ("searches.csv", figures.search_rows(found))
    for name, rows in (("cubes.csv", figures.cube_rows(found)), ("sem.csv", sems), ("table-3.2.csv", times), searches):
        write_rows(out / name, rows)
    return drawn


def report(
    found: Sequence[CubeResult],
    sems: Sequence[dict[str, object]],
    times: Sequence[dict[str, object]],
    seconds: dict[str, float],
) -> dict[str, Any]:
    """Content of `cubes.json`; lengths in metres."""

    def both(fit: Any) -> dict[str, object] | None:
        if fit is None:
            return None
        return {"beta": fit.beta, "theta": fit.theta, "aee_m": fit.aee, "converged": fit.converged}

    return {
        "cubes": [
            {
                "poisson": one.cube.poisson,
                "resolution": one.cube.resolution,
                "particles": len(one.cube.seen.rest),
                "depth_m": one.cube.depth,
                "source": one.cube.name,
                "theta": one.theta.as_json(),
                "dense_grid": {"theta": one.grid_theta, "aee_m": one.grid_aee, "over_grid": one.over_grid},
                "equal_share_theta": one.equal_share_theta,
                "one_cluster": both(one.one_cluster),
                "overlapping_clusters": both(one.overlapping),
                "ratio": one.ratio,
                "searches": one.searches,
                "seconds": one.seconds,
            }
            for one in found
        ],
        "theta_rises": rises(found),
        "theta_rises_to_bound": rises(found, to_bound=True),
        "aee_m_most": max(one.theta.aee for one in found),
        "over_grid_most": max(one.over_grid for one in found),
        "ratio_most": max(
            (one.ratio for one in found if one.ratio is not None and one.cube.poisson >= 0.25), default=None
        ),
        "sem": sems,
        "table_3_2": times,
        "seconds": seconds,
    }


def _rows(summary: dict[str, Any], found: Sequence[CubeResult], config: CubesConfig) -> list[tuple[str, str]]:
    rows = [
        (f"theta at nu {row['poisson']:g}", f"{row['theta']:.4f}{_spread(row)}")
        for row in summary["sem"]
        if row["by"] == "settings"
    ]
    rows += _drift(summary["sem"], found)
    everywhere = "at every resolution and depth"
    to_bound = f"{everywhere}, up to the end of its range where it has several minima"
    rises_to_bound = to_bound if summary["theta_rises_to_bound"] else "NOT everywhere"
    rows.append(("theta rises with nu", everywhere if summary["theta_rises"] else rises_to_bound))
    most = 100 * summary["aee_m_most"]
    rows.append(("largest error, one cluster", f"{most:.3f} cm (thesis: at most 0.2 cm for its cubes)"))
    rows.append(("error over a dense grid's lowest", f"{100 * summary['over_grid_most']:+.1e} % at most"))
    verdicts = [one.theta.verdict for one in found]
    rows.append(("verdicts", ", ".join(f"{verdicts.count(name)} {name}" for name in dict.fromkeys(verdicts))))
    if summary["ratio_most"] is not None:
        name = f"clusters of {config.cluster_size} a side"
        rows.append(
            (name, f"at most {summary['ratio_most']:.2f} of one cluster's error at nu >= 0.25, beta fitted too")
        )
    for row in summary["table_3_2"]:
        step = f"step {row['msm_step_ms']:.3g} ms{_beside(row['thesis_msm_frame_ms'], 'thesis')}"
        took = f"{step}, static state {row['msm_static_ms']:.2g} ms"
        if row["elements_ms"] is not None:
            took += f", finite elements {row['elements_ms']:.0f} ms"
            took += _beside(row["thesis_comsol_ms"], "thesis's COMSOL")
            took += f", of which direct solver {row['elements_direct_ms']:.0f} ms"
            took += _beside(row["thesis_sofa_ds_ms"], "thesis's SOFA-DS")
            took += f"; 25 conjugate gradients {row['elements_cg25_ms']:.3g} ms"
            took += _beside(row["thesis_sofa_cg_ms"], "thesis's SOFA-CG")
            took += f", which leave {row['elements_cg25_left']:.0%} of the load"
        rows.append((row["resolution"], took))
    unsettled = [one.cube.name for one in found if not one.theta.converged]
    if unsettled:
        rows.append(("NOT converged", ", ".join(unsettled)))
    seconds = summary["seconds"]
    rows.append(("took", f"{seconds['cubes']:.1f} s for the cubes, {seconds['fits_and_figures']:.1f} s for the rest"))
    rows.append(("figures and tables", str(config.out)))
    return rows


def _spread(row: dict[str, Any]) -> str:
    if row["cubes"] == 1:
        return ""
    return f", SEM {row['sem']:.4f} over {row['cubes']} cubes{_beside(row['sem_thesis'], 'thesis')}"


def _drift(sems: Sequence[dict[str, Any]], found: Sequence[CubeResult]) -> list[tuple[str, str]]:
    """SEM over resolutions at the largest depth, also where the held particles' share of mass is the same."""
    depth = depth_name(depths_of([one.cube for one in found])[-1])
    deepest = [row for row in sems if row["by"] == "depth" and row["of"] == depth and row["cubes"] > 1]
    if not deepest:
        return []
    ratios = ", ".join(f"{row['poisson']:g}" for row in deepest)
    thesis = next((row["sem_thesis"] for row in deepest if row["sem_thesis"]), None)
    as_is, equal = (", ".join(f"{row[name]:.3f}" for row in deepest) for name in ("sem", "sem_equal_share"))
    return [
        (f"SEM over resolutions, {depth}", f"{as_is} at nu {ratios}{_beside(thesis, 'thesis')}"),
        ("  held particles weigh a third", equal),
    ]


def _beside(value: float | str | None, whose: str) -> str:
    if value is None:
        return ""
    return f" ({whose}: {value if isinstance(value, str) else f'{value:g}'})"
