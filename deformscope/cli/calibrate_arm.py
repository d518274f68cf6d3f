"""`deformscope calibrate arm`: the compliance of the arm, from touches of something rigid.

deformscope calibrate arm rig.toml --at 0.30,0.20
deformscope calibrate arm lab:homogeneous-rigid --json -
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from deformscope.cli.benches import bench_of
from deformscope.cli.common import quiet_warp, resolve_viewer, say, settings_of, show, status_line, write_json
from deformscope.cli.exploring import Companion, leave, let_move
from deformscope.cli.rigs import until_interrupted
from deformscope.config import ArmConfig
from deformscope.errors import InputError

if TYPE_CHECKING:
    from deformscope.experiments.arm_compliance import ArmGive
    from deformscope.pictures.findings import Findings


def run(config: ArmConfig) -> None:
    """Touch a rigid block some times, and print the lines for the rig file."""
    import numpy as np

    from deformscope.experiments.arm_compliance import arm_give, touch_rigid
    from deformscope.experiments.explore import ExplorationStopped, ExploreOptions
    from deformscope.log.findings import RigFindings
    from deformscope.recording.recorder import Recorder
    from deformscope.session import Step, watching

    quiet_warp()
    options = ExploreOptions(budget=config.touches, beta_model="none", seed=config.output.seed)
    bench, options, _ = bench_of(config.rig, options, config.set_force, trusted=config.trust_rig)
    xy_m = np.array(config.at) if config.at is not None else 0.5 * np.array(bench.size_m)
    if not ((xy_m > 0.0) & (xy_m < bench.size_m)).all():
        width, height = bench.size_m
        came = f"{xy_m[0]:g},{xy_m[1]:g}"
        raise InputError(f"--at on the surface: between 0,0 and {width:g},{height:g} m", came)
    stop, made, output = None, [], config.output
    with (
        until_interrupted() as asked,
        Recorder(
            output.record,
            resolve_viewer(output.viewer),
            settings_of(config),
            layout="rig",
            overwrite=output.overwrite,
            real_time=bench.runs_itself,
        ) as recorder,
        bench.source() as source,
        status_line() as show_line,
    ):
        recorder.start_rig(source.streams, source.start_ns)
        companion = Companion(None if bench.runs_itself else source, recorder, asked, show_line)
        with (
            watching(source, recorder) if bench.runs_itself else contextlib.nullcontext(),
            bench.robot(companion) as robot,
        ):
            companion.follow(robot)
            known = {name: there for name, there in bench.calibrated.items() if "compliance" not in name}
            try:
                with companion.halts(robot):
                    let_move(robot, bench, options, known, asked, yes=config.yes, places_m=xy_m[None])
                    for one in touch_rigid(robot, options, xy_m, config.touches):
                        made.append(one)
                        give = 1e3 * one.found.compliance_m_per_n
                        show_line("")
                        say(f"touch {len(made)}: {give:.3f} mm/N, pressed with {one.peak_force_n:.2f} N")
            except ExplorationStopped as error:
                stop = companion.stopped(error, robot)
        recorder.write_items(source.take(0.0))
        found = arm_give(made) if stop is None else None
        if found is not None:
            shown = _findings(found, f"{config.rig} at ({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f}) cm")
            recorder.write(Step((RigFindings(shown, tuple(source.streams)),)))
            show(shown)
    if found is None:
        leave(stop, len(made), asked.signal_number, recorder.summary().path, arm_told=companion.arm_told)
    if recorder.summary().path is not None:
        say(f"recording: {recorder.summary().path}")
    write_json(found, output.json)


def _findings(found: ArmGive, where: str) -> Findings:
    from deformscope.experiments.arm_compliance import SURE_SD
    from deformscope.pictures.findings import Findings
    from deformscope.pictures.report import Figure, Table
    from deformscope.studies.arm_figure import compliance_png

    rows = [
        ("compliance", f"{1e3 * found.compliance_m_per_n:.3f} mm/N, give or take {1e3 * found.compliance_sd:.3f}"),
        ("camera", f"sees the surface {1e3 * found.off_m:+.1f} mm from where the arm meets it"),
        ("for [tool]", f"compliance_m_per_n = {found.compliance_m_per_n:.3e}"),
        ("", f"compliance_sd = {found.compliance_sd:.1e}"),
    ]
    if found.compliance_sd > SURE_SD * found.compliance_m_per_n:
        rows.append(("note", "the touches differ: more of them, or is it not rigid, or not firmly held?"))
    figure = Figure(compliance_png(found), "Compliance of the arm at each touch")
    return Findings((Table(rows, caption=where),), (figure,))
