"""`deformscope calibrate axes|yield`: a beta along each axis of a material, and the strain at which it yields.

deformscope calibrate axes pair.npz --json -
deformscope calibrate axes stretched.npz sheared.npz --turn-deg 30
deformscope calibrate yield press.npz --picture press.png
deformscope calibrate yield press.npz --beta 0.7 --creep fit --json -
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deformscope.cli.common import fit_progress, note_sizes, quiet_warp, read_file, replacing, show_table, write_json
from deformscope.config import AxesConfig, YieldConfig

if TYPE_CHECKING:
    from deformscope.arrays import FloatArray
    from deformscope.stages.fit.motion import Motion
    from deformscope.stages.materials.anisotropy import AxisEstimate
    from deformscope.stages.materials.yield_estimate import Parameter, YieldEstimate


def axes(config: AxesConfig) -> None:
    """`calibrate axes`: one fit to all pairs."""
    import numpy as np

    from deformscope.files.pairs import parse_pair
    from deformscope.stages.fit.calibrate import Model
    from deformscope.stages.materials.anisotropy import fit_axes
    from deformscope.stages.msm.solver import pick_device

    quiet_warp()
    seen = [parse_pair(read_file(one, "a pair file (.npz)"), one, noise_m=config.noise_m) for one in config.sources]
    note_sizes(one.rest for one in seen)
    d = seen[0].rest.shape[1]
    turn = np.deg2rad(config.turn_deg)
    directions = np.eye(d)
    directions[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    model = Model(cluster_size=config.cluster_size, device=pick_device(config.device))
    with fit_progress() as fitting:
        found = fit_axes(seen, model, axes=directions, level=config.level, seed=config.seed, progress=fitting)
    _tell_axes(found, ", ".join(config.sources))
    write_json(found.as_json(), config.json)


def yielding(config: YieldConfig) -> None:
    """`calibrate yield`: one motion."""
    from deformscope.files.motions import parse_motion
    from deformscope.stages.materials.plasticity import YieldOptions, fit_yield
    from deformscope.stages.msm.solver import pick_device

    quiet_warp()
    motion = parse_motion(read_file(config.source, "a motion file (.npz)"), config.source, noise_m=config.noise_m)
    note_sizes([motion.rest])
    options = YieldOptions(
        beta=config.beta,
        creep=config.creep,
        maximum=config.maximum or float("inf"),
        cluster_size=config.cluster_size,
        theta=config.theta,
        level=config.level,
        seed=config.seed,
        device=pick_device(config.device),
    )
    with fit_progress() as fitting:
        found = fit_yield(motion, options, fitting)
    if config.picture is not None:
        draw(found, motion, config.picture)
    _tell_yield(found, config)
    write_json(found.as_json(), config.json)


# Telling -------------------------------------------------------------------------------------------------------------


def _tell_axes(found: AxisEstimate, name: str) -> None:
    from deformscope.stages.fit.estimate import explained_text

    rows = []
    for k, (low, high) in enumerate(found.interval):
        axis = ", ".join(f"{x:.2g}" for x in found.axes[:, k])
        rows.append((f"beta along ({axis})", f"{found.value[k]:.4g} ({low:.4g} to {high:.4g}): {found.verdict[k]}"))
    told = "the axes differ" if found.anisotropic else "one beta explains it as well"
    rows += [
        ("anisotropy", f"{told} (one beta would leave so much error with probability {found.p_isotropic:.2g})"),
        ("one beta", f"{found.beta:.4g}"),
        ("error, axes / one beta", f"{1e3 * found.aee:.3g} mm / {1e3 * found.aee_isotropic:.3g} mm"),
        ("noise of a position", f"{1e3 * found.noise:.3g} mm"),
        ("explained", explained_text(found.explained)),
        ("converged", "yes" if found.converged else "NO: do not rely on the values"),
    ]
    show_table(f"beta along the axes of {name} ({found.level:.0%} intervals)", rows)


def _tell_yield(found: YieldEstimate, config: YieldConfig) -> None:
    from deformscope.stages.fit.estimate import EXPLAINED_LEAST, explained_text

    low, high = found.yield_strain.interval
    strain = f"{found.yield_strain.value:.4g} ({low:.4g} to {high:.4g})" if high is not None else f"above {low:.4g}"
    meaning = {
        "identified": "the motion tells it well",
        "weak": "the motion tells it roughly",
        "at-bound": "it yields as early as can be told",
        "unidentified": "nothing that yielded is sure"
        if high is None
        else "it yielded, but where it began is not told",
    }
    if found.explained < EXPLAINED_LEAST:
        meaning["unidentified"] = "the model does not explain the motion"
    rows = [
        ("yield strain", strain),
        ("verdict", f"{found.verdict}: {meaning[found.verdict]}"),
        ("largest strain, unyielded", f"{found.largest_strain:.4g}"),
        ("beta", _parameter(found.beta)),
        *([] if found.creep is None else [("creep [1/s]", _parameter(found.creep))]),
        ("permanent set (rms)", f"{1e3 * found.set:.3g} mm"),
        ("error, yielding / elastic", f"{1e3 * found.aee:.3g} mm / {1e3 * found.elastic_aee:.3g} mm"),
        ("explained", explained_text(found.explained)),
        ("converged", "yes" if found.converged else "NO: do not rely on the value"),
        *([] if config.picture is None else [("picture", str(config.picture))]),
    ]
    show_table(f"Yielding of {config.source} ({found.level:.0%} intervals)", rows)


def _parameter(parameter: Parameter) -> str:
    low, high = parameter.interval
    return f"{parameter.value:.4g} (given)" if parameter.given else f"{parameter.value:.4g} ({low:.4g} to {high:.4g})"


def draw(found: YieldEstimate, motion: Motion, path: Path) -> None:
    """The error over the yield strain with the interval, and the set that grows from frame to frame."""
    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    strain, rms = found.curve
    left.plot(strain, 1e3 * rms, "-", color="tab:blue", label="yielding at this strain")
    left.axhline(1e3 * found.elastic_deviation, color="tab:gray", linestyle="--", label="elastic")
    low, high = found.yield_strain.interval
    left.axvspan(low, high or strain[-1], color="tab:orange", alpha=0.3, label=f"{found.level:.0%} interval")
    if high is not None:
        left.axvline(found.yield_strain.value, color="tab:orange", label=f"{found.yield_strain.value:.3g}")
    left.set(xscale="log", yscale="log", xlabel="yield strain |S - I|", ylabel="residual of a coordinate, rms [mm]")
    left.legend()
    frames = np.flatnonzero(motion.judged.any(axis=1))

    def apart(states: FloatArray) -> FloatArray:
        square = np.where(motion.judged, np.sum((states - motion.position) ** 2, axis=2), np.nan)[frames]
        return np.asarray(1e3 * np.sqrt(np.nanmean(square, axis=1)))

    right.plot(frames, apart(motion.rest[None]), "o-", color="tab:blue", label="observed to rest")
    right.plot(frames, apart(found.elastic), "^--", color="tab:gray", label="observed to elastic")
    right.plot(frames, apart(found.simulated), "s-", color="tab:red", label="observed to yielding")
    right.set(xlabel="frame", ylabel="distance of free particles, rms [mm]", ylim=(0.0, 1.3 * right.get_ylim()[1]))
    right.legend()
    figure.suptitle(f"Yield strain: {found.verdict}")
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=120)
