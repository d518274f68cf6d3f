"""`deformscope calibrate arm`: the compliance of the arm, from touches of something rigid.

deformscope calibrate arm rig.toml --at 0.30,0.20
deformscope calibrate arm lab:homogeneous-rigid --json -
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deformscope.cli.common import quiet_warp, recorder_of, say, show, write_json
from deformscope.config import ArmConfig
from deformscope.errors import InputError
from deformscope.experiments.arm_compliance import (
    SURE_SD,
    CombinedCompliance,
    ComplianceTouch,
    combine_compliance,
    touch_rigid,
)
from deformscope.experiments.explore import ExplorationStopped
from deformscope.experiments.options import ExploreOptions
from deformscope.experiments.robot_geometry import FromFrames
from deformscope.experiments.touching_robot import TouchingRobot, touching_robot
from deformscope.interruption import until_interrupted
from deformscope.log.findings import RigFindings
from deformscope.log.rig_layout import RIG
from deformscope.pictures.compliance import compliance_png
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Figure, Table
from deformscope.runs.opened_devices import LAB, setup_of
from deformscope.runs.rig_calibration import today, write_values
from deformscope.runs.skeleton import leave_arm, open_rig_run, permitted
from deformscope.session import RigExperiment, Step
from deformscope.session import run as run_session
from deformscope.stages.map.exploration import ExplorationStop
from deformscope.stages.poke.contact import ArmCompliance


def run(config: ArmConfig) -> None:
    """Touch a rigid block some times, and write the compliance into the rig file."""
    quiet_warp()
    options = ExploreOptions(budget=config.touches, beta_model="none", seed=config.output.seed)
    opening = setup_of(config.rig, options, config.set_force, trusted=config.trust_rig)
    setup, options = opening.setup, opening.options
    xy_m = np.array(config.at) if config.at is not None else 0.5 * np.array(setup.size_m)
    if not ((xy_m > 0.0) & (xy_m < setup.size_m)).all():
        width, height = setup.size_m
        came = f"{xy_m[0]:g},{xy_m[1]:g}"
        raise InputError(f"--at on the surface: between 0,0 and {width:g},{height:g} m", came)
    made: list[ComplianceTouch] = []
    stop: ExplorationStop | None = None
    with (
        until_interrupted() as asked,
        recorder_of(config, RIG, real_time=setup.runs_itself) as recorder,
        open_rig_run(setup.open_source(), recorder) as opened,
    ):
        watch = opened.watch(asked)

        def found_one(one: ComplianceTouch) -> None:
            made.append(one)
            opened.line("")
            give = 1e3 * one.found.compliance_m_per_n
            say(f"touch {len(made)}: {give:.3f} mm/N, pressed with {one.peak_force_n:.2f} N")

        def touching(robot: TouchingRobot) -> RigExperiment[None]:
            known = {name: there for name, there in setup.calibrated.items() if "compliance" not in name}
            yield from permitted(robot, setup, options, known, asked, yes=config.yes, places_m=xy_m[None])
            yield from touch_rigid(FromFrames(robot.geometry, options), options, xy_m, config.touches, found_one)

        with touching_robot(setup, opened.source, options, watch) as robot, watch.halts(robot):
            try:
                run_session(opened.source, touching(robot), recorder, robot)
            except ExplorationStopped as error:
                stop = error.stop
                recorder.stopped_because(f"{stop.kind}: {stop.reason}")
        found = None if stop is not None else combine_compliance(made)
        if found is not None:
            shown = _findings(found, f"{config.rig} at ({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f}) cm")
            recorder.write(Step((RigFindings(shown, tuple(opened.source.streams)),)))
            show(shown)
    if stop is not None:
        leave_arm(stop, len(made), asked, recorder.summary().path, arm_stopped=watch.arm_stopped)
    if found is not None and config.write and not config.rig.startswith(LAB):
        known = {"compliance_m_per_n": found.compliance_m_per_n, "compliance_sd": found.compliance_sd}
        write_values(Path(config.rig), {"tool": known, "calibrated.arm": {"date": today()}})
    write_json(found, config.output.json)


def _findings(found: CombinedCompliance, where: str) -> Findings:
    rows = [
        ("compliance", f"{1e3 * found.compliance_m_per_n:.3f} mm/N, give or take {1e3 * found.compliance_sd:.3f}"),
        ("camera", f"sees the surface {1e3 * found.off_m:+.1f} mm from where the arm meets it"),
        ("for [tool]", f"compliance_m_per_n = {found.compliance_m_per_n:.3e}"),
        ("", f"compliance_sd = {found.compliance_sd:.1e}"),
    ]
    if found.dome > 0.0:
        dent = f"yields {1e3 * found.dome * 3.0 ** (2.0 / 3.0):.2f} mm itself at 3 N (Hertz), beside the compliance"
        rows.insert(1, ("tip", dent))
    if found.compliance_sd > SURE_SD * found.compliance_m_per_n:
        rows.append(("note", "the touches differ: more of them, or is it not rigid, or not firmly held?"))
    figure = Figure(
        compliance_png(
            [one.found for one in found.touches], ArmCompliance(found.compliance_m_per_n, found.compliance_sd)
        ),
        "Compliance of the arm at each touch",
    )
    return Findings((Table(rows, caption=where),), (figure,))
