"""`python -m studies reproduce table41`: maps of simulated tables over seeds (Thesis table 4.1), after some numbers of
touches, for each planner.

python -m studies reproduce table41 --seeds 5
python -m studies reproduce table41 --scenes two-60-150,disc --planners regions,max-variance --touches 12
python -m studies reproduce table41 --resume runs/table41.jsonl
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any, get_args

from tyro.conf import arg

from deformscope.config import flags
from deformscope.config.explore import Pace
from deformscope.errors import InputError
from deformscope.lab.scenes import BUILT_IN, built_in
from deformscope.pictures.report import Table
from studies.output import dict_table, pictures_of, write_rows
from studies.planners import PLANNERS
from studies.reproduce.closed_form_table import run_closed_form
from studies.reproduce.table41_robot import run_table
from studies.reproduce.table41_runs import TableJob, TableRun
from studies.reproduce.table41_summary import LOOKED_AT, PASSED_IOU, compare, curves, summarise
from studies.runner import Study, StudyOptions, StudyReport, Trials


@dataclass(frozen=True, slots=True)
class Table41Config(StudyOptions):
    """Thesis table 4.1 and further scenes: explore simulated tables over seeds, and report the maps' quality over the
    number of touches, for each planner. A touch takes about a second of one core: 20 seeds of all scenes take most of
    an hour."""

    out: flags.Folder = Path("runs/table41")
    """Folder for the table (CSV, PNG); existing files are replaced."""
    scenes: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """Scenes, as `deformscope explore --list-scenarios` lists them; default: all."""
    planners: Annotated[str, arg(metavar="NAME,NAME...")] = "regions"
    """Planners: regions, max-variance, random-above (`studies.planners`). The first is compared with the others."""
    seeds: flags.ManyFlag = 20
    """Layouts of each scene, from seed 0 on."""
    touches: flags.ManyFlag = 12
    """Touches of each exploration."""
    closed_form: bool = False
    """Compute a touch's stiffness in closed form instead of pressing finite elements: no surface, no arm, much
    faster."""
    clean: bool = False
    """Simulate without hidden errors: the arm as calibrated, exact force, foam without scatter."""
    pace: Annotated[str, arg(metavar="NAME,NAME...")] = "careful"
    """Paces of `deformscope explore`: careful, quick; robot seconds are the time of the planned motions, computed step
    by step. The first pace is compared with the others."""


def trials(options: Table41Config) -> list[Trials[TableJob, TableRun]]:
    """Every scene with every planner over the seeds."""
    paces = _named(options.pace, get_args(Pace), "paces")
    if options.closed_form and paces != ["careful"]:
        raise InputError("--pace with simulated touches", "--closed-form, which has no travel", "one of them")
    planners = _named(options.planners, list(PLANNERS), "planners")
    if options.closed_form and planners != ["regions"]:
        raise InputError("--planners with simulated touches", "--closed-form, which has no robot", "one of them")
    jobs = [
        TableJob(
            scene,
            seed,
            planner,
            options.touches,
            go_on=len(planners) * len(paces) > 1,
            closed_form=options.closed_form,
            clean=options.clean,
            pace=pace,
        )
        for seed in range(options.seeds)
        for scene in _scenes(options.scenes)
        for planner in planners
        for pace in paces
    ]
    return [Trials("explorations", explore_table, jobs)]


def explore_table(job: TableJob) -> TableRun:
    """One of them."""
    return run_closed_form(job) if job.closed_form else run_table(job)


def report(options: Table41Config, seconds: float, runs: Sequence[TableRun]) -> StudyReport:
    """The table, as rows and in words."""
    scenes = list(dict.fromkeys(one.job.scene for one in runs))
    planners: list[str] = list(dict.fromkeys(one.job.way for one in runs))
    by = {
        (scene, planner): [one for one in runs if (one.job.scene, one.job.way) == (scene, planner)]
        for scene in scenes
        for planner in planners
    }
    looked_at = [count for count in LOOKED_AT if count < options.touches] + [options.touches]
    rows = [
        {"scene": scene, "planner": planner, **summarise(mine, count)}
        for (scene, planner), mine in by.items()
        for count in looked_at
    ]
    cost = {
        "max_force_n": max(one.max_force_n for one in runs),
        "compute_s": median(after.compute_s for one in runs for after in one.after),
        "slowest_s": max(after.compute_s for one in runs for after in one.after),
    }
    compared = _compared(by, planners)
    write_rows(options.out / "table41.csv", rows)
    write_rows(options.out / "planners.csv", compared)
    curves(runs, options.out / "table41.png")
    summary = {"rows": rows, "planners": compared, **cost, "runs": runs}
    drawn = pictures_of({"IoU of regions after each touch": options.out / "table41.png"})
    tables = _tables(rows, looked_at, compared, cost, options.out)
    return StudyReport(tables, summary, drawn, further=[dict_table(rows, "Every scene after some touches")])


def _compared(by: dict[tuple[str, str], list[TableRun]], planners: Sequence[str]) -> list[dict[str, Any]]:
    """The first planner and pace compared with each of the others, scene by scene and over all scenes with borders."""
    bordered = [scene for (scene, planner), runs in by.items() if planner == planners[0] and runs[0].region_count > 1]
    groups = {scene: [scene] for scene in bordered} | ({"all of these": bordered} if len(bordered) > 1 else {})
    rows = []
    for other in planners[1:]:
        for name, scenes in groups.items():
            ours, theirs = ([one for scene in scenes for one in by[scene, which]] for which in (planners[0], other))
            rows += [{"scene": name} | compare(ours, theirs, iou) for iou in PASSED_IOU]
    return rows


def _scenes(named: str) -> Sequence[str]:
    scenes = [name.strip() for name in named.split(",") if name.strip()] or list(BUILT_IN)
    for scene in scenes:
        built_in(scene)
    return list(dict.fromkeys(scenes))


def _named(given: str, known: Sequence[str], what: str) -> list[Any]:
    names = [name.strip() for name in given.split(",")]
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"{what} out of {', '.join(known)}", ", ".join(map(repr, unknown)))
    return list(dict.fromkeys(names))


# In words ------------------------------------------------------------------------------------------------------------


def _tables(
    rows: Sequence[dict[str, Any]],
    looked_at: Sequence[int],
    compared: Sequence[dict[str, Any]],
    cost: dict[str, float],
    out: Path,
) -> tuple[Table, ...]:
    keys = list(dict.fromkeys((row["scene"], row["planner"]) for row in rows))
    at = {(row["scene"], row["planner"], row["touches"]): row for row in rows}
    counts = ", ".join(map(str, looked_at))
    every = [(f"{scene} {planner}", _ious([at[scene, planner, n] for n in looked_at])) for scene, planner in keys]
    layouts = f"{rows[0]['layouts']} layouts a scene: median [share at 0.85 or more]"
    tables = [Table(every, caption=f"IoU of regions after {counts} touches, {layouts}")]
    for count in [count for count in looked_at if count >= 8] or looked_at[-1:]:
        after = [(f"{scene} {planner}", _format_row(at[scene, planner, count])) for scene, planner in keys]
        tables.append(Table(after, caption=f"After {count} touches at most"))
    if compared:
        ratios = [
            (f"{row['scene']}, IoU {row['iou']:g}: {row['planner']} / {row['against']}", _ratios(row))
            for row in compared
        ]
        caption = "Cost of reaching this quality: ratios of the means (5 to 95 % of the bootstrap over layouts)"
        tables.append(Table(ratios, caption=caption))
    computing = f"{cost['compute_s']:.2f} s, {cost['slowest_s']:.2f} s at most, under the load of this machine"
    force = f"{cost['max_force_n']:.2f} N"
    summary = [
        ("largest true contact force", force),
        ("computing between two touches", computing),
        ("written to", str(out)),
    ]
    return (*tables, Table(summary, caption="All of it"))


def _ious(rows: Sequence[dict[str, Any]]) -> str:
    if rows[0]["iou"] is None:
        return "no regions: field off by " + ", ".join(f"{row['field_rms']:.3f}" for row in rows) + " rms in log"
    return ", ".join(f"{row['iou']:.2f} [{row['good']:.2f}]" for row in rows)


def _format_row(row: dict[str, Any]) -> str:
    named = (("found", "smallest found"), ("rigid_found", "rigid found"), ("ordered", "order right"))
    parts = [f"verdict and number right {row['right']:.2f}"]
    parts += [f"{words} {row[name]:.2f}" for name, words in named if row[name] is not None]
    if row["boundary_m"] is not None:
        parts.append(f"border {1e3 * row['boundary_m']:.0f} mm off")
    parts.append(f"field {row['field_rms']:.3f} rms [{row['field_covered']:.2f} within]")
    if row["levels_covered"] is not None:
        parts.append(f"levels within {row['levels_covered']:.2f} of {row['levels_runs']}")
    if row["wrong"] is not None:
        parts.append(f"wrong labels {row['wrong']:.3f}, {row['wrong_claimed']:.3f} expected")
    if row["unseen"] is not None:
        missed = "" if row["unseen_missed"] is None else f", {row['unseen_missed']:.2f} where one was missed"
        parts.append(f"own end {row['stopped']:.2f}, inclusions unseen {row['unseen']:.2f}{missed}")
    if row["touches_covered"] is not None:
        parts.append(f"touches within {row['touches_covered']:.2f}")
    parts.append(f"discs of up to {1e3 * row['unmet_m']:.0f} mm radius unmet")
    parts.append(f"{row['made']:g} touches, {row['travel_m']:.2f} m, {row['robot_s']:.0f} s")
    return ", ".join(parts)


def _ratios(row: dict[str, Any]) -> str:
    named = (("touches", "touches"), ("travel_m", "travel"), ("robot_s", "seconds"))
    parts = [
        f"{words} {row[f'{name}_ratio']:.2f} ({row[f'{name}_low']:.2f} to {row[f'{name}_high']:.2f})"
        for name, words in named
    ]
    return ", ".join(parts) + f", reached in {row['reached']:.2f} and {row['reached_against']:.2f}"


STUDY = Study(Table41Config, trials, report)
