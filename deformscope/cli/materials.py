"""`deformscope calibrate both|axes|yield`: beta with theta, a beta along each axis, the strain at which a thing yields.

deformscope calibrate both pair.npz --picture both.png --json -
deformscope calibrate both poke1.npz poke2.npz --joint --record both.rrd
deformscope calibrate axes stretched.npz sheared.npz --turn-deg 30
deformscope calibrate yield press.npz --picture press.png
deformscope calibrate yield press.npz --beta 0.7 --creep fit --json -
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deformscope.api.calibration import pair_recorder, size_notes
from deformscope.cli.common import (
    fit_progress,
    quiet_warp,
    read_file,
    recorder_of,
    say,
    settings_of,
    show,
    write_file,
    write_json,
)
from deformscope.config import AxesConfig, BothConfig, YieldConfig
from deformscope.files.motions import parse_motion
from deformscope.files.pairs import parse_pair
from deformscope.frames import InputFile
from deformscope.pictures.findings import Findings
from deformscope.pictures.material_figures import axes_png, joint_png, yield_png
from deformscope.pictures.report import Figure, Table
from deformscope.pictures.words import reason_rows
from deformscope.session import Step
from deformscope.stages.fit.estimate import Comparison, explained_text
from deformscope.stages.fit.joint import JointEstimate, JointOptions, calibrate_both
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.materials.anisotropy import AxisEstimate, fit_axes
from deformscope.stages.materials.plasticity import YieldOptions, fit_yield
from deformscope.stages.materials.yield_estimate import Parameter, YieldEstimate
from deformscope.stages.msm.materials import AxisBeta
from deformscope.stages.msm.solver import pick_device

CONVERGED = {True: "yes", False: "NO: do not rely on the values"}


def both(config: BothConfig) -> None:
    """`calibrate both`: each pair by itself, or all together."""
    quiet_warp()
    device = pick_device(config.fit.device)
    model = Model(basis=config.mode, cluster_size=config.cluster_size or None, volume="project", device=device)
    options = JointOptions(model, config.beta_range, config.theta_range, config.fit.level, config.output.seed)
    raws, seen = _pairs(config)
    sets = [seen] if config.joint else [[one] for one in seen]
    names = ["all pairs"] if config.joint else list(config.sources)
    every: list[dict[str, object]] = []
    with pair_recorder(seen, raws, settings_of(config), config.output) as recorder:
        for number, (name, some) in enumerate(zip(names, sets, strict=True)):
            with fit_progress() as fitting:
                estimate, comparisons = calibrate_both(some, options, progress=fitting)
            png = joint_png(estimate)
            found = Findings((_both_table(estimate, name),), (Figure(png, "Joint posterior of beta and theta"),))
            show(found)
            for frame, comparison in enumerate(comparisons, start=number):
                recorder.write(Step((comparison, found), frame=frame))
            if not every:
                write_file(config.picture, png)
            every.append(estimate.as_json())
    write_json(every[0] if len(every) == 1 else every, config.output.json)


def axes(config: AxesConfig) -> None:
    """`calibrate axes`: one fit to all pairs."""
    quiet_warp()
    raws, seen = _pairs(config)
    d = seen[0].rest.shape[1]
    turn = np.deg2rad(config.turn_deg)
    directions = np.eye(d)
    directions[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    model = Model(cluster_size=config.cluster_size, device=pick_device(config.fit.device))
    level, seed = config.fit.level, config.output.seed
    with pair_recorder(seen, raws, settings_of(config), config.output) as recorder:
        with fit_progress() as fitting:
            estimate = fit_axes(seen, model, axes=directions, level=level, seed=seed, progress=fitting)
        figure = Figure(axes_png(estimate), "beta along each axis")
        found = Findings((_axes_table(estimate, ", ".join(config.sources)),), (figure,))
        show(found)
        for frame, one in enumerate(seen if recorder.active else ()):
            law = AxisBeta(estimate.value, estimate.axes)
            simulated = model.body(one).relax(one.deformed[one.held], law).position[0]
            compared = Comparison(one.rest, one.deformed, simulated, one.observed, one.held, one.unit)
            recorder.write(Step((compared, found), frame=frame))
    write_json(estimate.as_json(), config.output.json)


def yielding(config: YieldConfig) -> None:
    """`calibrate yield`: one motion."""
    quiet_warp()
    raw = read_file(config.source, "a motion file (.npz)")
    motion = parse_motion(raw, config.source, noise_m=config.fit.noise_m)
    for remark in size_notes([motion.rest]):
        say(remark)
    options = YieldOptions(
        beta=config.beta,
        creep=config.creep,
        maximum=config.maximum or float("inf"),
        cluster_size=config.cluster_size,
        theta=config.theta,
        level=config.fit.level,
        seed=config.output.seed,
        device=pick_device(config.fit.device),
    )
    with recorder_of(config, "pair" if motion.rest.shape[1] == 2 else "pair-3d") as recorder:
        recorder.write(InputFile("motion", raw))
        with fit_progress() as fitting:
            estimate = fit_yield(motion, options, fitting)
        png = yield_png(estimate, motion)
        figure = Figure(png, "Error over the yield strain; distance from observed to simulated in each frame")
        found = Findings((_yield_table(estimate, config),), (figure,))
        show(found)
        for frame, (observed, simulated, held) in enumerate(
            zip(motion.position, estimate.simulated, motion.held, strict=True)
        ):
            seen = np.isfinite(observed).all(axis=1)
            compared = Comparison(motion.rest, observed, simulated, seen, np.flatnonzero(held), "m")
            recorder.write(Step((compared, found) if frame == 0 else (compared,), frame=frame))
    write_file(config.picture, png)
    write_json(estimate.as_json(), config.output.json)


def _pairs(config: BothConfig | AxesConfig) -> tuple[list[tuple[str, bytes]], list[Observation]]:
    """The files, by name and content, and what they hold."""
    raws = [(one, read_file(one, "a pair file (.npz)")) for one in config.sources]
    seen = [parse_pair(raw, name, noise_m=config.fit.noise_m) for name, raw in raws]
    for remark in size_notes([one.rest for one in seen]):
        say(remark)
    return raws, seen


# In words ------------------------------------------------------------------------------------------------------------


def _table(caption: str, rows: Sequence[tuple[str, str]]) -> Table:
    return Table(rows, caption=caption)


def _both_table(found: JointEstimate, name: str) -> Table:
    rows: list[tuple[str, str]] = []
    for one in (found.beta, found.theta):
        low, high = one.interval
        rows.append((one.parameter, f"{one.value:.4g}"))
        rows.append((f"{one.level:.0%} interval", f"{low:.4g} to {high:.4g}"))
        rows.append(("verdict", one.verdict_text()))
        rows += reason_rows(one.reasons, besides=one.verdict_text())
    rows.append(("correlation", f"{found.correlation:+.2f}"))
    rows.append(("stiffness", found.beta.stiffness_text()))
    if found.beta.explained is not None:
        rows.append(("explained", explained_text(found.beta.explained)))
    rows.append(("converged", CONVERGED[found.beta.converged]))
    return _table(f"beta and theta of {name}", rows)


def _axes_table(found: AxisEstimate, name: str) -> Table:
    rows = []
    for k, (low, high) in enumerate(found.interval):
        axis = ", ".join(f"{x:.2g}" for x in found.axes[:, k])
        rows.append((f"beta along ({axis})", f"{found.value[k]:.4g} ({low:.4g} to {high:.4g}): {found.verdict[k]}"))
    rows += reason_rows(tuple(dict.fromkeys(one for some in found.reasons for one in some)))
    differ = "the axes differ" if found.anisotropic else "one beta explains it as well"
    rows += [
        ("anisotropy", f"{differ} (one beta would leave so much error with probability {found.p_isotropic:.2g})"),
        ("one beta", f"{found.beta:.4g}"),
        ("error, axes / one beta", f"{1e3 * found.aee:.3g} mm / {1e3 * found.aee_isotropic:.3g} mm"),
        ("noise of a position", f"{1e3 * found.noise:.3g} mm"),
        ("explained", explained_text(found.explained)),
        ("converged", CONVERGED[found.converged]),
    ]
    return _table(f"beta along the axes of {name} ({found.level:.0%} intervals)", rows)


def _yield_table(found: YieldEstimate, config: YieldConfig) -> Table:
    low, high = found.yield_strain.interval
    strain = f"{found.yield_strain.value:.4g} ({low:.4g} to {high:.4g})" if high is not None else f"above {low:.4g}"
    unsure = "nothing that yielded is sure" if high is None else "it yielded, but where it began is not known"
    lowered = next((one.text for one in found.reasons if one.allows == "unidentified"), unsure)
    meaning = {
        "identified": "the motion determines it well",
        "weak": "the motion determines it roughly",
        "at-bound": "it yields as early as can be seen",
        "unidentified": lowered,
    }
    rows = [
        ("yield strain", strain),
        ("verdict", f"{found.verdict}: {meaning[found.verdict]}"),
        *reason_rows(found.reasons),
        ("largest strain, unyielded", f"{found.largest_strain:.4g}"),
        ("beta", _parameter(found.beta)),
        *([] if found.creep is None else [("creep [1/s]", _parameter(found.creep))]),
        ("permanent set (rms)", f"{1e3 * found.set:.3g} mm"),
        ("error, yielding / elastic", f"{1e3 * found.aee:.3g} mm / {1e3 * found.elastic_aee:.3g} mm"),
        ("explained", explained_text(found.explained)),
        ("converged", CONVERGED[found.converged]),
        *([] if config.picture is None else [("picture", str(config.picture))]),
    ]
    return _table(f"Yielding of {config.source} ({found.level:.0%} intervals)", rows)


def _parameter(parameter: Parameter) -> str:
    low, high = parameter.interval
    return f"{parameter.value:.4g} (given)" if parameter.given else f"{parameter.value:.4g} ({low:.4g} to {high:.4g})"
