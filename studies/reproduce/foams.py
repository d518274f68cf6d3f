"""`python -m studies reproduce foams`: experiment 3.B of the thesis, with figure 3.14, on five virtual foams.

python -m studies reproduce foams
python -m studies reproduce foams --quick --json -
python -m studies reproduce foams --out runs/foams --json foams.json --seed 1 --keep-images
deformscope calibrate beta runs/foams/images/24-80 --roi 30,50,750,350 --grid 7x15 --contact 330,50,150,50
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.config import flags
from deformscope.pictures.report import Table
from studies.output import pictures_of, write_rows
from studies.reproduce import foams_figures as figures
from studies.reproduce.foam_fits import (
    HELD,
    SOURCES,
    Control,
    FoamCase,
    FoamFit,
    FoamResult,
    FoamSetup,
    Trend,
    controls,
    measure,
    measure_control,
    trend,
)
from studies.reproduce.virtual_foams import Foam
from studies.runner import Study, StudyOptions, StudyReport, Trials

HELD_WORDS = {"one": "one particle held", "clamp": "clamp held"}


@dataclass(frozen=True, slots=True)
class FoamsConfig(StudyOptions):
    """Experiment 3.B: beta of five virtual foams from images of a push, with figure 3.14 and the force. It takes about
    3 minutes on one core."""

    out: flags.Folder = Path("runs/foams")
    """Folder of the figures and of foams.csv; made if missing. Existing files of these names are replaced."""
    quick: bool = False
    """Only the softest and the firmest foam, with fewer images, in about 30 s."""
    keep_images: bool = False
    """Store the images in DIR/images, one folder per foam, in the form that `calibrate beta` reads."""


def setup_of(options: FoamsConfig) -> FoamSetup:
    """The requested setup."""
    setup = FoamSetup()
    if options.quick:
        return FoamSetup(foams=(setup.foams[0], setup.foams[-1]), images=4, element_m=0.007)
    return setup


def trials(options: FoamsConfig) -> list[Trials[Any, Any]]:
    """The foams, and one whose properties are changed one at a time."""
    setup, seed = setup_of(options), options.output.seed
    images = options.out / "images"
    foams = [
        FoamCase(foam, setup, seed, str(images / foam.name.replace("/", "-")) if options.keep_images else "")
        for foam in setup.foams
    ]
    changed = [] if options.quick else controls(setup, seed)
    return [Trials("foams", measure, foams), Trials("one property at a time", measure_control, changed)]


def report(
    options: FoamsConfig, seconds: float, results: Sequence[FoamResult], changed: Sequence[Control]
) -> StudyReport:
    """Figures and tables, from files that are already in the folder."""
    setup = setup_of(options)
    trends = [trend(results, source, held, size) for held in HELD for source in SOURCES for size in setup.cluster_sizes]
    drawn = _draw(options.out, results, trends, changed, min(setup.cluster_sizes))
    table = options.out / "foams.csv"
    write_rows(table, csv_rows(results))
    written = Table([("", str(path)) for path in (*drawn.values(), table)], caption=f"Written in {seconds:.0f} s")
    tables = [*map(_foam_table, results), _trend_table(trends), written]
    summary = as_json(setup, results, trends, changed)
    summary |= {"seed": options.output.seed, "quick": options.quick, "seconds": seconds}
    return StudyReport(tables, summary | {"figures": list(drawn.values()), "table": table}, pictures_of(drawn))


def _draw(
    out: Path, results: Sequence[FoamResult], trends: Sequence[Trend], tried: Sequence[Control], size: int
) -> dict[str, Path]:
    """The pictures by their titles."""
    drawn = {}
    for held in HELD:
        path = out / ("figure-3.14.png" if held == "one" else f"figure-3.14-{held}-held.png")
        figures.figure_3_14(results, trends, held, path)
        drawn[f"beta over hardness (Thesis figure 3.14), {HELD_WORDS[held]}"] = path
    figures.stiffness(results, drawn.setdefault("stiffness and force", out / "stiffness.png"))
    figures.particles(results, "clamp", size, drawn.setdefault("particles", out / "particles.png"))
    if tried:
        figures.one_change(tried, drawn.setdefault("one property changed alone", out / "one-change.png"))
    return drawn


def _foam_table(result: FoamResult) -> Table:
    rows = [
        ("law", _law(result.foam)),
        ("force", f"{result.force_n[-1]:.1f} N at {1e3 * result.depth_m[-1]:g} mm: {result.stiffness:.0f} N/m"),
        ("flow", f"rms error {np.sqrt(np.nanmean(result.error_px**2)):.2f} px; {result.lost} particles lost"),
    ]
    for fit in result.fits:
        one = fit.calibration.estimate
        k = "" if one.stiffness is None else f"; k {one.stiffness[0]:.0f} N/m"
        low, high = one.interval
        warning = "" if one.converged else "; NOT converged"
        rows.append((name(fit), f"{one.value:.3f} ({low:.3f} to {high:.3f}), {one.verdict}{k}{warning}"))
    return Table(rows, caption=f"Foam {result.foam.name}")


def _trend_table(trends: Sequence[Trend]) -> Table:
    rows = [
        (name(one), f"softest - firmest {one.drop:+.2f}; rank correlation {_signed(one.rank_correlation)}; {one.told}")
        for one in trends
    ]
    return Table(rows, caption="Beta against hardness")


def name(one: FoamFit | Trend) -> str:
    """How a fit was made."""
    source = {"flow": "flow", "true": "true positions"}[one.source]
    return f"beta, {HELD_WORDS[one.held]}, {source}, {one.cluster_size}x{one.cluster_size}"


def _law(foam: Foam) -> str:
    young = 1e-3 * foam.law().young
    return f"Young {young:.1f} kPa, Poisson {foam.poisson:g}, plateau exponent {foam.plateau:g}"


def _signed(value: float | None) -> str:
    return "none" if value is None else f"{value:+.2f}"


def as_json(
    setup: FoamSetup, results: Sequence[FoamResult], trends: Sequence[Trend], tried: Sequence[Control]
) -> dict[str, Any]:
    """The results for JSON, without the images."""
    return {
        "setup": setup,
        "foams": [
            {
                "name": result.foam.name,
                "foam": result.foam,
                "law": result.foam.law(),
                "young_pa": result.foam.law().young,
                "depth_m": result.depth_m,
                "force_n": result.force_n,
                "stiffness_n_per_m": result.stiffness,
                "lost": result.lost,
                "error_px": result.error_px,
                "noise_px": result.noise_px,
                "fits": [fit_json(fit) for fit in result.fits],
            }
            for result in results
        ],
        "trends": trends,
        "one_change": [
            {
                "changed": one.changed,
                "foam": one.foam,
                "force_n": one.force_n,
                "moved_mm": one.moved_mm(tried[0]),
                "fits": [fit_json(fit) for fit in one.fits],
            }
            for one in tried
        ],
    }


def fit_json(fit: FoamFit) -> dict[str, Any]:
    """One fit: how it was made, and its estimate."""
    how = {"source": fit.source, "held": fit.held, "cluster_size": fit.cluster_size}
    return how | fit.calibration.estimate.as_json()


def csv_rows(results: Sequence[FoamResult]) -> list[dict[str, object]]:
    """One row for each fit."""
    rows = []
    for result, fit in ((one, fit) for one in results for fit in one.fits):
        foam, one = result.foam, fit.calibration.estimate
        k = (None,) * 3 if one.stiffness is None else (one.stiffness[0], *one.stiffness[1])
        row: dict[str, object] = {"density_kg_m3": foam.density, "hardness_n": foam.hardness}
        row |= {"plateau_exponent": foam.plateau, "poisson": foam.poisson, "force_n": result.force_n[-1]}
        row |= {"source": fit.source, "held": fit.held, "cluster_size": fit.cluster_size, "converged": one.converged}
        row |= {"verdict": one.verdict, "aee_mm": 1e3 * one.aee * (one.metres_per_unit or float("nan"))}
        row |= dict(zip(("beta", "beta_low", "beta_high"), (one.value, *one.interval), strict=True))
        rows.append(row | dict(zip(("k_n_per_m", "k_low", "k_high"), k, strict=True)))
    return rows


STUDY = Study(FoamsConfig, trials, report)
