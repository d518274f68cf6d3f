"""`python -m studies reproduce cubes`: theta of cubes of known Poisson's ratio (Thesis 3.A), with its figures and its
table.

python -m studies reproduce cubes
python -m studies reproduce cubes --quick --out figures --json -
python -m studies reproduce cubes --pairs cube_nu0.25.npz cube_nu0.4.npz
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import arg

from deformscope.config import flags
from deformscope.config.options import either
from deformscope.file_io import read_file
from deformscope.pictures.report import Table
from studies.output import dict_table, pictures_of, write_rows
from studies.reproduce import cubes_figures as figures
from studies.reproduce import pressed_cubes as cubes
from studies.reproduce.cubes_figures import depth_name, sem_rows, time_rows
from studies.reproduce.pressed_cubes import (
    Compare,
    Cube,
    CubeFit,
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
from studies.runner import Study, StudyOptions, StudyReport, Trials


@dataclass(frozen=True, slots=True)
class CubesConfig(StudyOptions):
    """The thesis's experiment 3.A: theta of cubes of known Poisson's ratio, with figures 3.10 and 3.11 and table 3.2,
    and overlapping clusters compared with one cluster."""

    pairs: Annotated[tuple[Path, ...], arg(metavar="FILE...", help_behavior_hint=""), flags.Reads()] = ()
    """Cubes from pair files (.npz) with `nu`, instead of the thesis's 45 from finite elements."""
    out: flags.Folder = Path("runs/cubes")
    """Folder for the figures (PNG) and tables (CSV); existing files are replaced."""
    quick: bool = False
    """The 15 cubes of 6^3 particles alone."""
    method: Literal["sweep", "gradient"] = "sweep"
    """How theta is searched: all values at once (Thesis Algorithm 3), or downhill (Algorithm 2)."""
    cluster_size: flags.ClusterFlag = 2
    """Particles along each side of the overlapping clusters."""
    compare: Compare = "deepest"
    """Cubes for the fit of overlapping clusters: the deepest press of each kind, all, or none."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""

    def check(self) -> None:
        either("--pairs", "--quick", self.pairs, self.quick)


@dataclass(frozen=True, slots=True)
class CubeCase:
    """Cubes of one resolution and one Poisson's ratio. side: particles along a side; pairs: their files, empty = they
    are pressed at every depth by finite elements"""

    fit: CubeFit
    side: int
    poisson: float
    pairs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CubesFitted:
    """cubes: by rising depth; elements: time of the finite elements, None = the cubes were read"""

    cubes: tuple[CubeResult, ...]
    elements: ElementTime | None


def fit_cubes(case: CubeCase) -> CubesFitted:
    """Press or read them, and fit theta to each."""
    elements: list[ElementTime] = []
    if case.pairs:
        made = sorted(map(_read, case.pairs), key=lambda cube: cube.depth)
    else:
        made, elements = thesis_cubes((case.poisson,), (case.side,))
    each = [examine(cube, case.fit, one) for cube, one in zip(made, compared(made, case.fit.compare), strict=True)]
    return CubesFitted(tuple(each), next(iter(elements), None))


def _read(path: Path | str) -> Cube:
    return cube_from_pair(read_file(Path(path), "a pair file (.npz)"), str(path))


def trials(options: CubesConfig) -> list[Trials[CubeCase, CubesFitted]]:
    """The largest ones first, so that none is left alone at the end."""
    fit = CubeFit(options.method, options.cluster_size, options.compare, options.level, options.output.seed)
    if options.pairs:
        groups: dict[tuple[str, int, float], list[str]] = {}
        for path, cube in ((path, _read(path)) for path in options.pairs):
            groups.setdefault((cube.resolution, len(cube.seen.rest), cube.poisson), []).append(str(path))
        cases = [CubeCase(fit, count, poisson, tuple(paths)) for (_, count, poisson), paths in groups.items()]
    else:
        sides = cubes.SIDES[:1] if options.quick else cubes.SIDES
        cases = [CubeCase(fit, side, ratio) for side in sides for ratio in cubes.POISSON]
    return [Trials("sets of cubes", fit_cubes, sorted(cases, key=lambda case: -case.side))]


# Results -------------------------------------------------------------------------------------------------------------


def _draw(
    options: CubesConfig,
    found: Sequence[CubeResult],
    sems: Sequence[dict[str, object]],
    times: Sequence[dict[str, object]],
) -> dict[str, Path]:
    """Draw and write; the pictures by their titles."""
    out = options.out
    theta, errors = out / "figure-3.10.png", out / "figure-3.11.png"
    figures.draw_theta(theta, found)
    figures.draw_errors(errors, found)
    drawn = {"theta over Poisson's ratio (Thesis figure 3.10)": theta, "error (Thesis figure 3.11)": errors}
    if len({one.cube.resolution for one in found}) > 1:
        name = "theta over the resolution, with particle masses as they are and with held particles of equal mass"
        drawn[name] = out / "resolution.png"
        figures.draw_resolution(drawn[name], found)
    if options.compare != "none":
        name = "overlapping clusters compared with one cluster"
        drawn[name] = out / "clusters.png"
        figures.draw_clusters(drawn[name], found, options.cluster_size)
    searches = ("searches.csv", figures.search_rows(found))
    for name, rows in (("cubes.csv", figures.cube_rows(found)), ("sem.csv", sems), ("table-3.2.csv", times), searches):
        write_rows(out / name, rows)
    return drawn


def report(options: CubesConfig, seconds: float, fitted: Sequence[CubesFitted]) -> StudyReport:
    """Figures and tables of all cubes; lengths in metres."""
    found = [one for several in fitted for one in several.cubes]
    found.sort(key=lambda one: (len(one.cube.seen.rest), one.cube.poisson, one.cube.depth))
    times = time_rows(model_times(found), [one.elements for one in fitted if one.elements is not None])
    sems = sem_rows(found)
    drawn = _draw(options, found, sems, times)
    summary = as_json(found, sems, times) | {"seconds": seconds}
    overview = Table(_rows(summary, found, options), caption=f"{len(found)} cubes")
    searched = Table(figures.search_summary(figures.search_rows(found)), caption="Searches for theta, same cubes")
    further = dict_table(sems, "Spread of theta"), dict_table(times, "Table 3.2")
    return StudyReport([overview, searched], summary, pictures_of(drawn), further=further)


def as_json(
    found: Sequence[CubeResult], sems: Sequence[dict[str, object]], times: Sequence[dict[str, object]]
) -> dict[str, Any]:
    """The results for JSON."""

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
        "aee_m_most": max(one.aee for one in found),
        "over_grid_most": max(one.over_grid for one in found),
        "ratio_most": max(
            (one.ratio for one in found if one.ratio is not None and one.cube.poisson >= 0.25), default=None
        ),
        "sem": sems,
        "table_3_2": times,
    }


def _rows(summary: dict[str, Any], found: Sequence[CubeResult], options: CubesConfig) -> list[tuple[str, str]]:
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
        name = f"clusters of {options.cluster_size} a side"
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
    rows.append(("took", f"{summary['seconds']:.1f} s"))
    rows.append(("figures and tables", str(options.out)))
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


STUDY = Study(CubesConfig, trials, report)
