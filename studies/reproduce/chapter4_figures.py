"""The figures of Thesis chapter 4: beta over hardness, dents next to each other, and fields of beta with the truth."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.pictures.figures import COLOURS, canvas
from studies.output import figure
from studies.reproduce.thesis_dent import tactile_points
from studies.reproduce.thesis_rules import CLUSTER_SIZES, HOLDS, SCENARIOS, BetaField, FoamDent, Scenario

LINE_WIDTH, DPI = 1.6, 130
TICKS_CM = (-5, 0, 5)
LABEL_CM = 4.0
"""Offset of materials' names above their middle, where the first touch may be."""


def draw_betas(foams: Sequence[FoamDent], path: Path) -> None:
    """Figure 4.5: (a) beta over hardness, a panel for each hold, a line for each cluster size; (b) the error by it."""
    hardness = [one.hardness_n for one in foams]
    with figure(path, 3, 2) as axes:
        for hold, panel in zip(HOLDS, axes.flat, strict=False):
            for size, colour in zip(CLUSTER_SIZES, COLOURS, strict=False):
                mine = [_of(one, hold, size) for one in foams]
                if all(one is None for one in mine):
                    continue
                beta = [np.nan if one is None else one[0] for one in mine]
                panel.plot(hardness, beta, "o-", color=colour, lw=LINE_WIDTH, ms=4, label=_format_size(size))
            panel.set(title=hold, xlabel="hardness [N]", ylabel="beta", xscale="log", ylim=(-0.05, 1.0))
            panel.set_xticks(hardness, [str(one) for one in hardness])
            panel.minorticks_off()
            panel.legend(fontsize=8)
        panel = axes.flat[len(HOLDS)]
        for hold, colour in zip(HOLDS[:-1], COLOURS, strict=False):
            each = [[_of(one, hold, size) for one in foams] for size in CLUSTER_SIZES]
            share = [
                np.mean([1e2 * found[1] / one.depth_m for found, one in zip(row, foams, strict=True) if found])
                for row in each
            ]
            panel.plot(range(len(share)), share, "o-", color=colour, lw=LINE_WIDTH, ms=4, label=hold)
        panel.set(title="error at beta (eq. 4.6)", xlabel="cluster size", ylabel="mean over foams [% of the depth]")
        panel.set_xticks(range(len(CLUSTER_SIZES)), [_format_size(size) for size in CLUSTER_SIZES], fontsize=8)
        panel.set_ylim(0.0)
        panel.legend(fontsize=8)


def _format_size(size: int | None) -> str:
    return "no clusters" if size is None else f"{size} a side"


def _of(foam: FoamDent, hold: str, size: int | None) -> tuple[float, float] | None:
    """beta and its error of one foam; the error is nan where there is none."""
    for one in foam.betas:
        if (one.hold, one.cluster_size) == (hold, size):
            return one.beta, np.nan if one.error_m is None else one.error_m
    return None


def draw_dents(foams: Sequence[FoamDent], path: Path) -> None:
    """Figure 4.6: the surfaces under the same touch, from the Gaussian process, on one scale."""
    from matplotlib import colormaps

    deepest = 1e3 * max(float(one.dent.sunk_m.max()) for one in foams)
    drawn = canvas(3.6 * len(foams), 3.6, layout="constrained")
    for number, one in enumerate(foams, start=1):
        axes: Any = drawn.add_subplot(1, len(foams), number, projection="3d")
        x, y = (1e2 * (values - values.mean()).reshape(one.dent.shape) for values in one.dent.before[:, :2].T)
        height = -1e3 * one.dent.sunk_m.reshape(one.dent.shape)
        axes.plot_surface(
            x,
            y,
            height,
            cmap=colormaps["viridis"],
            vmin=-deepest,
            vmax=0.0,
            rstride=1,
            cstride=1,
            lw=0.2,
            edgecolor="k",
        )
        axes.set(
            zlim=(-deepest, 0.1 * deepest),
            xlabel="x [cm]",
            ylabel="y [cm]",
            zlabel="height [mm]",
            xticks=TICKS_CM,
            yticks=TICKS_CM,
        )
        axes.set_title(f"H = {one.hardness_n:g} N: {1e3 * one.depth_m:.1f} mm")
        axes.set_box_aspect(None, zoom=0.85)
        axes.view_init(elev=22.0, azim=-60.0)
    drawn.savefig(path, dpi=DPI, bbox_inches="tight")


def draw_clouds(foam: FoamDent, path: Path) -> None:
    """Figure 4.4: the surface before the touch and under it on the sweep's grid, by the Gaussian process. Draw the
    camera's points, the virtual points on the ball, and the held particle."""
    dent, ball, to_cm = foam.dent, foam.ball, np.array([1e2, 1e2, 1e3])
    low, high = 1e3 * dent.after[:, 2].min(), 1e3 * dent.before[:, 2].max()
    middle = np.append(dent.before[:, :2].mean(axis=0), 0.0)
    tactile = np.zeros((0, 3)) if ball is None else tactile_points(ball.lowest_m, ball.radius_m, ball.depth_m)
    drawn = canvas(11.0, 4.8, layout="constrained")
    for number, points in enumerate((dent.before, dent.after)):
        axes: Any = drawn.add_subplot(1, 2, 1 + number, projection="3d", computed_zorder=False)
        x, y, z = ((points - middle) * to_cm).T
        axes.scatter(x, y, z, c=z, cmap="viridis", vmin=low, vmax=high, s=7, label="surface on the grid")
        if number:
            cloud, virtual = ((some - middle) * to_cm for some in (foam.seen_m, tactile))
            axes.scatter(*cloud.T, c="0.4", s=1.0, alpha=0.3, label="points of the camera", zorder=0)
            axes.scatter(*virtual.T, c=COLOURS[1], s=26, label="virtual points on the ball", zorder=3)
            held = [int(np.argmax(dent.sunk_m))]
            axes.scatter(x[held], y[held], z[held], c="red", marker="*", s=110, label="held particle x_h", zorder=4)
        axes.set(zlim=(low - 1.0, high + 1.0), xlabel="x [cm]", ylabel="y [cm]", zlabel="height [mm]")
        axes.set_title(f"{('before: P0', 'under touch: Pt')[number]}, foam of {foam.hardness_n:g} N")
        axes.view_init(elev=18.0, azim=-60.0)
        axes.legend(fontsize=7, loc="upper left")
    drawn.colorbar(drawn.axes[0].collections[0], ax=drawn.axes, shrink=0.6, label="height [mm]")
    drawn.savefig(path, dpi=DPI)


def draw_fields(scenarios: Sequence[Scenario], path: Path) -> None:
    """Figure 4.7, a row for each scenario: the truth; the field of beta by layers and by a single layer, with its
    isopleths. The map of variance shows the contacts: the first as a circle, later ones as triangles."""
    drawn = canvas(16.0, 2.55 * len(scenarios), layout="constrained")
    axes = drawn.subplots(len(scenarios), 4, squeeze=False)
    for row, one in zip(axes, scenarios, strict=True):
        size = 1e2 * one.cell_m * np.array(one.truth.shape[::-1])
        extent = (0.0, float(size[0]), 0.0, float(size[1]))
        row[0].imshow(one.truth, origin="lower", extent=extent, cmap="Pastel1", vmin=0, vmax=8)
        for label, hardness in enumerate(one.hardness):
            y, x = (1e2 * one.cell_m * (np.median(at) + 0.5) for at in np.nonzero(one.truth == label))
            row[0].text(x, y + LABEL_CM, hardness if hardness == "rigid" else f"{hardness} N", ha="center", va="center")
        row[0].set_title(f"{one.scene}: truth")
        for panel, (model, found) in zip(row[1:3], one.fields.items(), strict=True):
            image = panel.imshow(found.mean, origin="lower", extent=extent, cmap="viridis", vmin=0.0, vmax=1.0)
            _isopleths(panel, found, extent)
            regions = "region" if found.regions == 1 else "regions"
            panel.set_title(f"beta, {model}: {found.regions} {regions} of {SCENARIOS.get(one.scene, (0, 0))[1]}")
            drawn.colorbar(image, ax=panel, shrink=0.85)
        image = row[3].imshow(one.variance, origin="lower", extent=extent, cmap="magma", vmin=0.0, vmax=0.12)
        row[3].set_title(f"variance after {len(one.contacts_m)} touches")
        drawn.colorbar(image, ax=row[3], shrink=0.85)
        for panel in (row[0], row[3]):
            _contacts(panel, 1e2 * one.contacts_m, "white" if panel is row[3] else "black")
        row[0].set_ylabel("y [cm]")
        for panel in row:
            panel.set(xlim=extent[:2], ylim=extent[2:])
            panel.tick_params(labelsize=7)
    for panel in axes[-1]:
        panel.set_xlabel("x [cm]")
    drawn.savefig(path, dpi=DPI, bbox_inches="tight")


def _isopleths(axes: Any, found: BetaField, extent: tuple[float, float, float, float]) -> None:
    for level in found.isopleths:
        if found.mean.min() < level < found.mean.max():
            axes.contour(found.mean, levels=[level], colors="red", linewidths=1.5, extent=extent)


def _contacts(axes: Any, at_cm: FloatArray, colour: str) -> None:
    axes.plot(*at_cm[:1].T, "o", ms=9, mfc="none", mec=colour, mew=1.5)
    axes.plot(*at_cm[1:].T, "^", ms=8, mfc="none", mec=colour, mew=1.5)
