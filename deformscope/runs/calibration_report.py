"""Results of a calibration, outside a recording: the numbers as rows, and one HTML page."""

import datetime
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePath

from deformscope.pictures import evidence
from deformscope.pictures.messages import estimate_rows, format_length, reason_rows
from deformscope.pictures.report import Code, Figure, Part, ReportVerdict, Section, Table, cell_text, html_report
from deformscope.plain import plain
from deformscope.recording import provenance
from deformscope.stages.fit.estimate import Estimate
from deformscope.stages.poke.poke_estimate import PokeRow, PokesResult

MOST_SHOWN = 24
"""Largest number of comparisons with pictures in a report."""


def calibration_page(
    results: Sequence[evidence.Result], *, seed: int, settings: Mapping[str, object], pokes: PokesResult | None = None
) -> str:
    """All results, with pictures, settings and provenance, as one HTML page. settings: settings of the command,
    in addition to those of the estimates"""
    return html_report(_title(results), calibration_sections(results, seed=seed, settings=settings, pokes=pokes))


def calibration_sections(
    results: Sequence[evidence.Result], *, seed: int, settings: Mapping[str, object], pokes: PokesResult | None = None
) -> list[Section]:
    """The parts of a report on calibrations: verdicts first, then numbers, pictures, and how it was done."""
    several = len(results) > 1
    sections = [Section("", [part for one in results for part in _verdict(one, named=several)])]
    if several:
        sections.append(Section("All pairs", [_overview(results)]))
    left = MOST_SHOWN
    for one in results:
        if count := min(len(one.comparisons), left):
            of = f" of {_name(one)}" if several else ""
            sections.append(Section(f"Numbers and evidence{of}", _evidence(one)))
            sections.append(Section(f"Error of the model{of}", _pictures(one, count)))
            left -= count
    if missing := sum(len(one.comparisons) for one in results) - (MOST_SHOWN - left):
        sections.append(
            Section(
                "Left out", [(f"{missing} more pictures are left out, because they would make this page too large.")]
            )
        )
    if pokes is not None:
        sections.append(Section("Pokes", list(poke_tables(pokes))))
    return [
        *sections,
        settings_section(results[0].estimate.settings),
        *provenance_sections(seed=seed, settings=settings),
    ]


def settings_section(settings: Mapping[str, object]) -> Section:
    """Settings of a fit."""
    rows = [(name, cell_text(plain(value))) for name, value in settings.items() if value is not None]
    return Section("Settings", [Table(rows, caption="Of the fit")])


def provenance_sections(*, seed: int, settings: Mapping[str, object]) -> list[Section]:
    """The provenance of a result, and the command that reproduces it."""
    rows: list[tuple[str, str]] = [
        ("made", datetime.datetime.now().astimezone().isoformat(sep=" ", timespec="seconds"))
    ]
    sources = settings.get("sources")
    for number, source in enumerate(sources if isinstance(sources, list) else [], start=1):
        rows.append((f"source {number}", str(source)))
    rows.append(("seed", str(seed)))
    rows += [(f"version of {name}", version) for name, version in provenance.versions().items()]
    if git := provenance.git_state():
        rows.append(("git commit", f"{git['commit']}{' with uncommitted changes' if git['dirty'] else ''}"))
    rows.append(("machine", provenance.machine()))
    command = shlex.join(["deformscope", *provenance.command()[1:]])
    again = "The same command on the same sources gives the same numbers, on one machine to the last digit."
    return [Section("Provenance", [Table(rows)]), Section("To reproduce it", [Code(command), again])]


def _verdict(result: evidence.Result, *, named: bool) -> list[Part]:
    found = result.estimate
    name = f"{_name(result)}: " if named else ""
    reasons = [f"{words}." for _, words in reason_rows(found.reasons, besides=found.verdict_text())]
    words = (f"Stiffness: {found.stiffness_text()}.", *reasons, *([] if named else [_explained(found)]))
    return [
        ReportVerdict(
            f"{name}{found.verdict_text()}", (f"{evidence.headline(found)}.", *words), evidence.verdict_color(found)
        )
    ]


def _explained(found: Estimate) -> str:
    known = found.identifiability
    if known is None:
        return ""
    return (
        f"The model explains {max(known.explained, 0.0):.1%} of the motion (sums of squares). The data "
        f"separate the most likely value from the least likely one by {known.rise:.3g} standard deviations."
    )


def _overview(results: Sequence[evidence.Result]) -> Table:
    rows = []
    for one in results:
        found = one.estimate
        low, high = found.interval
        interval, error = f"{low:.4g} to {high:.4g}", format_length(found, found.aee_free)
        rows.append((_name(one), f"{found.value:.4g}", interval, found.verdict_text(), error))
    first = results[0].estimate
    return Table(rows, ("pair", first.parameter, f"{first.level:.0%} interval", "verdict", "error, free particles"))


def _evidence(result: evidence.Result) -> list[Part]:
    found = result.estimate
    rows = estimate_rows(found)
    rows.insert(-1, ("error, nearest particle", format_length(found, found.nearest)))
    caption = (
        f"Above: mean distance between observed and simulated particles over {found.parameter}, with the estimate. "
        f"Below: the posterior on the same axis; shaded the {found.level:.0%} interval."
    )
    if found.force is not None:
        caption += (
            " Below these: the force over the depth of the contact, while it rose, and the line of its stiffness."
        )
    return [Table(rows), Figure(evidence.evidence_png(found), caption)]


def _pictures(result: evidence.Result, count: int) -> list[Part]:
    parts: list[Part] = []
    for index in range(count):
        name = f"{PurePath(result.names[index]).name}: " if result.names[index] else ""
        parts.append(f"{name}{evidence.where_wrong(result.comparisons[index])}")
        left = Figure(
            evidence.particles_png(result, index), f"{name}Observed particles and the simulated ones, with error lines."
        )
        right = Figure(evidence.errors_png(result, index), f"{name}Distance from observed to simulated over the body.")
        parts.append((left, right))
    return parts


def poke_tables(found: PokesResult) -> tuple[Table, Table]:
    """Each poke, and the cluster sizes that were tried."""
    columns: dict[str, Callable[[PokeRow], str]] = {
        "middle of the touched points x, y [m]": lambda one: ", ".join(f"{v:.3g}" for v in one.xy_m),
        "tip [mm]": lambda one: f"{one.tip.shape} {' x '.join(f'{1e3 * side:.3g}' for side in one.tip.size)}",
        "depth [mm]": lambda one: f"{1e3 * one.depth_m:.3g}",
        "force [N]": lambda one: _number(one.force_n, "{:.3g}"),
        "k [N/m]": lambda one: _number(one.stiffness_n_per_m, "{:.4g}"),
        "apparent E* [kPa]": lambda one: _number(
            None if one.apparent_modulus_pa is None else 1e-3 * one.apparent_modulus_pa.half_space, "{:.3g}"
        ),
        "surface error [of the depth]": lambda one: _number(one.surface_error, "{:.1%}"),
        "the same, of pokes left out of the fit": lambda one: _number(one.surface_error_held_out, "{:.1%}"),
        "force predicted from the others": lambda one: _number(one.left_out_error, "{:+.1%}"),
    }
    rows = [[show(one) for show in columns.values()] for one in found.rows()]
    caption = f"Pokes: stiffness over the surface is {found.model.field_kind}; E* is of a half-space: apparent"
    sizes = [
        (str(one["cluster_size"]), f"{one['error']:.1%}", f"{one['beta']:.3g}", f"{one['theta']:.3g}")
        for one in found.tried_json()
    ]
    return (
        Table(rows, tuple(columns), caption),
        Table(sizes, ("particles a side", "error [of the depth]", "beta", "theta"), "Cluster sizes tried, best first"),
    )


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else form.format(value)


def _title(results: Sequence[evidence.Result]) -> str:
    found = f"Calibration of {results[0].estimate.parameter}"
    if len(results) > 1:
        return f"{found}: {len(results)} pairs"
    return f"{found}: {name}" if (name := _name(results[0])) else found


def _name(result: evidence.Result) -> str:
    """A file's name without its folder, which is among the sources."""
    return PurePath(result.names[0]).name if len(result.names) == 1 else f"{len(result.names)} pairs together"
