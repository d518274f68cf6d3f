"""`deformscope calibrate both|axes|field|yield|viscous`: beta with theta, a beta along each axis, relative stiffness of
each place, yield strain, and relaxing share of the modulus.

deformscope calibrate both pair.npz --picture both.png --json -
deformscope calibrate both poke1.npz poke2.npz --joint --record both.rrd
deformscope calibrate axes stretched.npz sheared.npz --turn-deg 30
deformscope calibrate axes press.mp4 --grid 9x15 --held bottom,contact --contact 200,40,60,20
deformscope calibrate field stretched.npz --picture field.png --record field.rrd
deformscope calibrate yield press.npz --picture press.png
deformscope calibrate yield press.npz --beta 0.7 --creep fit --json -
deformscope calibrate yield press.mp4 --grid 9x15 --held bottom,contact --contact 200,40,60,20 --at 40,95
deformscope calibrate viscous press.mp4 --grid 9x15 --held bottom,contact --contact 200,40,60,20 --record press.rrd
"""

from __future__ import annotations

from deformscope.cli.common import (
    EXIT_LOSSES,
    fit_progress,
    quiet_warp,
    read_file,
    say,
    settings_of,
    show,
    write_file,
    write_json,
)
from deformscope.config import BothConfig, MaterialOptions
from deformscope.files.pairs import parse_pair
from deformscope.pictures.findings import Findings
from deformscope.pictures.material_figures import joint_png
from deformscope.pictures.messages import value_rows
from deformscope.pictures.report import Figure, Table
from deformscope.runs.calibration import pair_recorder, size_notes
from deformscope.runs.materials import calibrate_material, material_page
from deformscope.session import Step
from deformscope.stages.fit.estimate import converged_text, explained_text
from deformscope.stages.fit.joint import JointEstimate, JointOptions, calibrate_both
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.msm.solver import pick_device


def both(config: BothConfig) -> None:
    """`calibrate both`: each pair alone, or all together."""
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


def run(config: MaterialOptions) -> int:
    """`calibrate axes|field|yield|viscous`: images, a recording, or files. Returns the command's exit status."""
    with fit_progress() as progress:
        found = calibrate_material(config, note=say, progress=progress)
    show(found)
    files = config.summary
    if files.picture is not None:
        write_file(files.picture, found.figures()[0].png)
        say(f"picture: {files.picture}")
    if files.report is not None:
        write_file(files.report, material_page(found).encode())
        say(f"report: {files.report}")
    write_json(found.to_dict(), config.output.json)
    if found.problems:
        say(f"deformscope: {config.sources[0]} is damaged: {'; '.join(found.problems)}")
        return EXIT_LOSSES
    return 0


def _pairs(config: BothConfig) -> tuple[list[tuple[str, bytes]], list[Observation]]:
    """The files, by name and content, and their pairs."""
    raws = [(one, read_file(one, "a pair file (.npz)")) for one in config.sources]
    seen = [parse_pair(raw, name, noise_m=config.fit.noise_m) for name, raw in raws]
    for remark in size_notes([one.rest for one in seen]):
        say(remark)
    return raws, seen


# In words ------------------------------------------------------------------------------------------------------------


def _both_table(found: JointEstimate, name: str) -> Table:
    rows = [*value_rows(found.beta), *value_rows(found.theta)]
    rows.append(("correlation", f"{found.correlation:+.2f}"))
    rows.append(("stiffness", found.beta.stiffness_text()))
    if found.beta.explained is not None:
        rows.append(("explained", explained_text(found.beta.explained)))
    rows.append(("converged", converged_text(found.beta)))
    return Table(rows, caption=f"beta and theta of {name}")
