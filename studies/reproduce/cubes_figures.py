"""Figures 3.10 and 3.11 and table 3.2 of the thesis from this reproduction's cubes, and one cluster compared with
many."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import IntArray
from deformscope.pictures.figures import COLOURS, LINES
from studies.output import figure
from studies.reproduce.pressed_cubes import (
    Cube,
    CubeResult,
    ElementTime,
    ModelTime,
    Spread,
    depth_of,
    depths_of,
    spreads,
)

THESIS_SEM = {
    "all settings": {0.1: "< 0.015", 0.25: "< 0.015"},
    "3 cm": dict.fromkeys((0.1, 0.25, 0.4, 0.49), "< 0.026"),
    "11^3": dict.fromkeys((0.1, 0.25, 0.4, 0.49), "< 0.015"),
}
"""The thesis's SEM: over all nine settings, over resolutions at 3 cm, over depths of the finest cube."""

THESIS_MS = {"6^3": (6.1, 3000.0, 0.5, 3.0), "8^3": (12.6, 58000.0, 0.8, 11.0), "11^3": (28.6, 180000.0, 1.4, 96.0)}
"""Table 3.2 as printed [ms]: MSM a frame, COMSOL, SOFA-CG, SOFA-DS (a 2.86 GHz Core i7)."""


def depth_name(depth: float) -> str:
    """`3 cm`"""
    return f"{100.0 * depth:.3g} cm"


def grouped_spreads(found: Sequence[CubeResult]) -> dict[str, list[Spread]]:
    """Figure 3.10's three groupings: over all settings, over depths, over resolutions."""
    depths = depths_of([one.cube for one in found])
    finer = sorted(found, key=lambda one: len(one.cube.seen.rest))
    deeper = sorted(found, key=lambda one: one.cube.depth)
    return {
        "settings": spreads(found),
        "resolution": spreads(finer, lambda cube: cube.resolution),
        "depth": spreads(deeper, lambda cube: depth_name(depth_of(cube, depths))),
    }


# Figures -------------------------------------------------------------------------------------------------------------


def draw_theta(path: Path, found: Sequence[CubeResult]) -> None:
    """Figure 3.10: theta against Poisson's ratio, mean and SEM over all settings, over depths, over resolutions."""
    groups = grouped_spreads(found)
    titles = (
        ("settings", "(a) over all resolutions and depths"),
        ("resolution", "(b) over depths, by resolution"),
        ("depth", "(c) over resolutions, by depth"),
    )
    with figure(path, 3, share_y=True) as axes:
        for panel, (group, title) in zip(axes[0], titles, strict=True):
            names = list(dict.fromkeys(spread.of for spread in groups[group]))
            for number, name in enumerate(names):
                some = [spread for spread in groups[group] if spread.of == name]
                shift = 0.006 * (number - 0.5 * (len(names) - 1))  # error bars beside each other
                panel.errorbar(
                    [spread.poisson + shift for spread in some],
                    [spread.mean for spread in some],
                    [np.nan_to_num(spread.sem) for spread in some],
                    fmt="o-",
                    markersize=4,
                    capsize=3,
                    linewidth=1.2,
                    color=COLOURS[number % len(COLOURS)],
                    label=name or " to ".join(map(str, sorted({spread.count for spread in some}))) + " cubes a point",
                )
            panel.set(title=title, xlabel="Poisson's ratio", ylim=(-0.05, 1.08))
            panel.legend(title="mean and SEM")
        axes[0, 0].set_ylabel("theta")


def draw_errors(path: Path, found: Sequence[CubeResult]) -> None:
    """Figure 3.11: error against theta, a panel for each Poisson's ratio above 0. Dots are the estimates, crosses the
    ends of the printed Algorithm 2."""
    cubes = [one.cube for one in found]
    ratios = sorted({cube.poisson for cube in cubes if cube.poisson > 0.0}) or sorted({c.poisson for c in cubes})
    depths, resolutions = depths_of(cubes), list(dict.fromkeys(cube.resolution for cube in cubes))
    columns = min(len(ratios), 2)
    with figure(path, columns, -(-len(ratios) // columns)) as axes:
        for panel, ratio in zip(axes.flat, ratios, strict=False):
            for one in (one for one in found if one.cube.poisson == ratio):
                colour = COLOURS[resolutions.index(one.cube.resolution) % len(COLOURS)]
                line = LINES[depths.index(depth_of(one.cube, depths)) % len(LINES)]
                panel.plot(one.curve.parameter, 100.0 * one.curve.aee, line, color=colour, linewidth=1.2)
                panel.plot([one.value], [100.0 * one.aee], "o", color=colour, markersize=4, clip_on=False)
                for ended in one.searches[-1:]:
                    panel.plot([ended.value], [100.0 * ended.aee_m], "x", color=colour, markersize=6, clip_on=False)
            panel.set(title=f"Poisson's ratio {ratio:g}", xlabel="theta", ylabel="AEE [cm]", xlim=(0.0, 1.0))
            panel.set_ylim(bottom=0.0)
        handles = [_line("-", COLOURS[n % len(COLOURS)], name) for n, name in enumerate(resolutions)]
        handles += [_line(LINES[n % len(LINES)], "0.3", depth_name(depth)) for n, depth in enumerate(depths)]
        handles.append(_line("", "0.3", "estimate", marker="o"))
        handles.append(_line("", "0.3", "Algorithm 2 stops", marker="x"))
        axes.flat[0].legend(handles=handles, fontsize="small", ncols=2)


def draw_resolution(path: Path, found: Sequence[CubeResult]) -> None:
    """Why theta drifts with resolution: with equal masses, and with a constant share of mass of the held particles."""
    depths = depths_of([one.cube for one in found])
    deepest = [one for one in found if depth_of(one.cube, depths) == depths[-1]]
    ratios = sorted({one.cube.poisson for one in deepest})
    with figure(path, 1) as axes:
        (panel,) = axes[0]
        for number, ratio in enumerate(ratios):
            group = sorted(
                (one for one in deepest if one.cube.poisson == ratio), key=lambda one: len(one.cube.seen.rest)
            )
            share = [100.0 * len(one.cube.seen.held) / len(one.cube.seen.rest) for one in group]
            colour = COLOURS[number % len(COLOURS)]
            panel.plot(share, [one.value for one in group], "o-", color=colour, markersize=4)
            panel.plot(share, [one.equal_share_theta for one in group], "s:", color=colour, markersize=4)
            at = share[-1], group[-1].value
            panel.annotate(f"nu = {ratio:g}", at, (4, -11), textcoords="offset points", color=colour)
        panel.set(
            title=f"theta and resolution, pressed {depth_name(depths[-1])}",
            xlabel="share of particles that is held [%]",
            ylabel="theta",
        )
        handles = [
            _line("-", "0.3", "equal masses", marker="o"),
            _line(":", "0.3", "held particles weigh a third", marker="s"),
        ]
        panel.figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize="small")


def draw_clusters(path: Path, found: Sequence[CubeResult], cluster_size: int) -> None:
    """Errors of one cluster and of overlapping ones, and the side of the cube that separates them the most."""
    some = [one for one in found if one.overlapping is not None and one.one_cluster is not None]
    resolutions = list(dict.fromkeys(one.cube.resolution for one in some))
    many = f"clusters of {cluster_size} per side, theta and beta"
    with figure(path, 2) as axes:
        left, right = axes[0]
        for number, name in enumerate(resolutions):
            group = sorted((one for one in some if one.cube.resolution == name), key=lambda one: one.cube.poisson)
            ratio, colour = [one.cube.poisson for one in group], COLOURS[number % len(COLOURS)]
            single = [100.0 * one.aee for one in group]
            both = [100.0 * one.one_cluster.aee for one in group if one.one_cluster]
            clustered = [100.0 * one.overlapping.aee for one in group if one.overlapping]
            left.plot(ratio, single, "o-", color=colour, markersize=4)
            left.plot(ratio, both, ":", color=colour)
            left.plot(ratio, clustered, "s--", color=colour, markersize=4)
        handles = [_line("-", COLOURS[n % len(COLOURS)], name) for n, name in enumerate(resolutions)]
        handles += [
            _line("-", "0.3", "one quadratic cluster, theta", marker="o"),
            _line(":", "0.3", "one quadratic cluster, theta and beta"),
            _line("--", "0.3", many, marker="s"),
        ]
        depths = depths_of([one.cube for one in some])
        at = depth_name(depths[0]) if len(depths) == 1 else f"{depth_name(depths[0])} to {depth_name(depths[-1])}"
        left.set(title=f"Lowest error, pressed {at}", xlabel="Poisson's ratio", ylabel="AEE [cm]")
        left.set_ylim(bottom=0.0)
        left.legend(handles=handles, fontsize="small")
        sided = [one for one in some if one.cube.seen.shape is not None and len(one.cube.seen.shape) == 3]
        if sided:
            _draw_side(right, max(sided, key=lambda one: (one.aee, len(one.cube.seen.rest))), many)


def _draw_side(panel: Any, one: CubeResult, many: str) -> None:
    """The middle line of a side, from plate to plate, as simulated and by both models."""
    assert one.overlapping is not None
    row, along, out = side_line(one.cube)
    rest = one.cube.seen.rest[row]
    for name, position, style, colour in (
        ("rest", rest, ":", "0.6"),
        ("observed", one.cube.seen.deformed[row], "o", "k"),
        ("one quadratic cluster, theta", one.simulated[row], "-", COLOURS[0]),
        (many, one.overlapping.position[row], "--", COLOURS[1]),
    ):
        outward, height = 100.0 * (position[:, out] - rest[:, out].max()), 100.0 * position[:, along]
        panel.plot(outward, height, style, color=colour, label=name, markersize=4)
    panel.set(
        title=f"Middle of a side, Poisson's ratio {one.cube.poisson:g}, {one.cube.resolution}",
        xlabel="bulge [cm]",
        ylabel="height [cm]",
    )
    panel.legend(fontsize="small")


def side_line(cube: Cube) -> tuple[IntArray, int, int]:
    """Particles (n,) along the middle of a lattice's side, the axis of the pressing, and that of the side's normal."""
    shape, cell = cube.seen.shape, cube.seen.cell
    assert shape is not None
    assert cell is not None
    moved = np.abs(cube.seen.deformed - cube.seen.rest)[cube.seen.held].max(axis=0)
    along = int(moved.argmax())
    out, across = (axis for axis in range(3) if axis != along)
    index = np.stack(np.unravel_index(cell, shape), axis=1)
    row = np.flatnonzero((index[:, out] == shape[out] - 1) & (index[:, across] == shape[across] // 2))
    return row[np.argsort(index[row, along])], along, out


def _line(style: Any, colour: str, label: str, marker: str = "") -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle=style or "none", color=colour, label=label, marker=marker, markersize=4)


# Tables --------------------------------------------------------------------------------------------------------------


def cube_rows(found: Sequence[CubeResult]) -> list[dict[str, object]]:
    """One row for each cube."""
    rows = []
    for one in found:
        low, high = one.theta.interval
        row: dict[str, object] = {"poisson": one.cube.poisson, "resolution": one.cube.resolution}
        row |= {"particles": len(one.cube.seen.rest), "depth_m": one.cube.depth, "theta": one.value}
        row |= {"low": low, "high": high, "verdict": one.theta.verdict, "aee_m": one.aee}
        row |= {"grid_theta": one.grid_theta, "grid_aee_m": one.grid_aee, "equal_share_theta": one.equal_share_theta}
        for name, fit in (("one_cluster", one.one_cluster), ("clusters", one.overlapping)):
            values = (None,) * 3 if fit is None else (fit.beta, fit.theta, fit.aee)
            row |= dict(zip((f"{name}_beta", f"{name}_theta", f"{name}_aee_m"), values, strict=True))
        rows.append(row | {"ratio": one.ratio, "source": one.cube.name})
    return rows


def sem_rows(found: Sequence[CubeResult]) -> list[dict[str, object]]:
    """Mean and SEM of theta in each grouping of figure 3.10, with those of the thesis."""
    rows: list[dict[str, object]] = []
    for group, some in grouped_spreads(found).items():
        for spread in some:
            its_own = spread.count == (9 if group == "settings" else 3)
            printed = THESIS_SEM.get(spread.of or "all settings", {}) if its_own else {}
            rows.append(
                {
                    "by": group,
                    "of": spread.of or "all settings",
                    "poisson": spread.poisson,
                    "cubes": spread.count,
                    "theta": spread.mean,
                    "sem": spread.sem,
                    "sem_equal_share": spread.equal_share_sem,
                    "sem_thesis": printed.get(spread.poisson),
                }
            )
    return rows


def search_rows(found: Sequence[CubeResult]) -> list[dict[str, Any]]:
    """One row for each cube and search. theta_off: distance from that of the lowest error"""
    rows = []
    for one in found:
        named = {"poisson": one.cube.poisson, "resolution": one.cube.resolution, "depth_m": one.cube.depth}
        rows += [{**named, **asdict(by), "theta_off": abs(by.value - one.value)} for by in one.searches]
    return rows


def search_summary(rows: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    """Cost of each search over all cubes, and the error of its theta."""
    said = []
    for name in dict.fromkeys(row["search"] for row in rows):
        some = [row for row in rows if row["search"] == name]
        count, off = (np.array([row[of] for row in some]) for of in ("evaluations", "theta_off"))
        words = f"{np.median(count):.0f} static states ({count.max()} at most), theta error {np.median(off):.4f}"
        said.append((name, f"{words} ({off.max():.3f} at most, .05 or more in {(off >= 0.05).sum()} of {len(off)})"))
    return said


def time_rows(ours: Sequence[ModelTime], elements: Sequence[ElementTime]) -> list[dict[str, object]]:
    """Table 3.2 [ms]: times of this machine, and those printed in the thesis for the same resolution."""
    rows: list[dict[str, object]] = []
    for one in ours:
        solved = [each for each in elements if each.resolution == one.resolution]

        def mean(of: Callable[[ElementTime], float], solved: Sequence[ElementTime] = solved) -> float | None:
            return float(np.mean(list(map(of, solved)))) if solved else None

        msm, comsol, cg, direct = THESIS_MS.get(one.resolution, (None,) * 4)
        rows.append(
            {
                "resolution": one.resolution,
                "msm_step_ms": 1e3 * one.step,
                "msm_static_ms": 1e3 * one.static,
                "msm_theta_ms": 1e3 * one.theta,
                "elements_ms": mean(lambda one: 1e3 * (one.assemble_s + one.solve_s)),
                "elements_unknowns": solved[0].unknowns if solved else None,
                "elements_direct_ms": mean(lambda one: 1e3 * one.solve_s),
                "elements_cg25_ms": mean(lambda one: 1e3 * one.cg_s),
                "elements_cg25_left": mean(lambda one: one.cg_left),
                "thesis_msm_frame_ms": msm,
                "thesis_comsol_ms": comsol,
                "thesis_sofa_cg_ms": cg,
                "thesis_sofa_ds_ms": direct,
            }
        )
    return rows
