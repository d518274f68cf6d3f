"""`deformscope calibrate both`: beta and theta together, as a joint posterior.

deformscope calibrate both pair.npz --picture both.png --json -
deformscope calibrate both poke1.npz poke2.npz --joint
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deformscope.cli.common import fit_progress, note_sizes, quiet_warp, read_file, show_table, write_json
from deformscope.config import BothConfig

if TYPE_CHECKING:
    from deformscope.stages.fit.joint import JointEstimate


def run(config: BothConfig) -> None:
    """Fit each pair, or all together; tell, draw and write what was found."""
    quiet_warp()
    from deformscope.files.pairs import parse_pair
    from deformscope.stages.fit.joint import JointOptions, calibrate_both
    from deformscope.stages.fit.model import Model
    from deformscope.stages.msm.solver import pick_device

    device = pick_device(config.device)
    model = Model(basis=config.mode, cluster_size=config.cluster_size or None, volume="project", device=device)
    options = JointOptions(model, config.beta_range, config.theta_range, config.level, config.seed)
    seen = [
        parse_pair(read_file(source, "a pair file (.npz)"), source, noise_m=config.noise_m) for source in config.sources
    ]
    note_sizes(one.rest for one in seen)
    sets = [seen] if config.joint else [[one] for one in seen]
    names = ["all pairs"] if config.joint else list(config.sources)
    found = []
    for name, some in zip(names, sets, strict=True):
        with fit_progress() as fitting:
            estimate, _ = calibrate_both(some, options, progress=fitting)
        tell(estimate, name)
        found.append(estimate)
    if config.picture is not None:
        draw(found[0], config.picture)
    every = [one.as_json() for one in found]
    write_json(every[0] if len(every) == 1 else every, config.json)


def tell(found: JointEstimate, name: str) -> None:
    """The result as a short table."""
    from deformscope.stages.fit.estimate import explained_text

    rows: list[tuple[str, str]] = []
    for one in (found.beta, found.theta):
        low, high = one.interval
        rows.append((one.parameter, f"{one.value:.4g}"))
        rows.append((f"{one.level:.0%} interval", f"{low:.4g} to {high:.4g}"))
        rows.append(("verdict", one.verdict_text()))
    rows.append(("correlation", f"{found.correlation:+.2f}"))
    rows.append(("stiffness", found.beta.stiffness_text()))
    if found.beta.explained is not None:
        rows.append(("explained", explained_text(found.beta.explained)))
    rows.append(("converged", "yes" if found.beta.converged else "NO: do not rely on the values"))
    show_table(f"beta and theta of {name}", rows)


def draw(found: JointEstimate, path: Path) -> None:
    """The joint posterior as a map, with the values of lowest error."""
    import numpy as np
    from matplotlib.figure import Figure

    assert found.beta.posterior is not None
    assert found.theta.posterior is not None
    beta, theta = found.beta.posterior.parameter, found.theta.posterior.parameter
    figure = Figure(figsize=(5.2, 4.2), layout="constrained")
    axis = figure.subplots()
    shown = axis.pcolormesh(beta, theta, found.density.T, cmap="Blues", shading="gouraud")
    order = np.argsort(-found.density.ravel())
    weight = (found.density * np.gradient(beta)[:, None] * np.gradient(theta)).ravel()[order]
    last = order[min(int(np.searchsorted(np.cumsum(weight) / weight.sum(), found.beta.level)), order.size - 1)]
    edge = float(found.density.ravel()[last])
    axis.contour(beta, theta, found.density.T, levels=[edge], colors="tab:blue")
    axis.plot(found.beta.value, found.theta.value, "x", color="tab:red", label="lowest error")
    axis.plot([], [], color="tab:blue", label=f"{found.beta.level:.0%} set")
    axis.set_xlabel("beta")
    axis.set_ylabel("theta")
    axis.legend()
    figure.colorbar(shown, label="posterior density")
    figure.savefig(path, dpi=130)
