"""`deformscope calibrate arm`: touch something rigid, and write the arm's compliance into the rig file."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore.explore import ExplorationStopped
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import FromFrames
from deformscope.experiments.explore.touching_robot import TouchingRobot, touching_robot
from deformscope.experiments.rig.arm_compliance import (
    SURE_SD,
    CombinedCompliance,
    ComplianceTouch,
    combine_compliance,
    touch_rigid,
)
from deformscope.log.findings import RigFindings
from deformscope.pictures.report import Figure
from deformscope.pictures.setup import compliance_png
from deformscope.plain import plain
from deformscope.runs.opened_devices import LAB, Opening, setup_of
from deformscope.runs.rig_calibration import RigCalibrationResult, write_values
from deformscope.runs.skeleton import leave_arm, open_rig_run, permitted
from deformscope.session import RigExperiment, Step
from deformscope.session import run as run_session
from deformscope.stages.map.exploration import ExplorationStop
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.terminal import say, until_interrupted

if TYPE_CHECKING:
    from deformscope.config import ArmConfig, CertifyConfig
    from deformscope.recording.recorder import Recorder


def opening_of(config: "ArmConfig") -> Opening:
    """The devices, not opened, and the options of their touches. Raises the errors of `setup_of`."""
    options = ExploreOptions(budget=config.touches, beta_model="none", seed=config.output.seed)
    return setup_of(config.rig, options, config.set_force, trusted=config.trust_rig)


def calibrate_arm(
    config: "ArmConfig", opening: Opening, recording: "AbstractContextManager[Recorder]"
) -> RigCalibrationResult:
    """Touch a rigid block several times, and write the compliance into the rig file unless --no-write is given."""
    setup, options = opening.setup, opening.options
    xy_m = np.array(config.at) if config.at is not None else 0.5 * np.array(setup.size_m)
    if not ((xy_m > 0.0) & (xy_m < setup.size_m)).all():
        width, height = setup.size_m
        came = f"{xy_m[0]:g},{xy_m[1]:g}"
        raise InputError(f"--at on the surface: between 0,0 and {width:g},{height:g} m", came)
    made: list[ComplianceTouch] = []

    def touching(geometry: FromFrames, line: Callable[[str], None]) -> RigExperiment[None]:
        def found_one(one: ComplianceTouch) -> None:
            made.append(one)
            line("")
            give = 1e3 * one.found.compliance_m_per_n
            say(f"touch {len(made)}: {give:.3f} mm/N, pressed with {one.peak_force_n:.2f} N")

        return touch_rigid(geometry, options, xy_m, config.touches, found_one)

    def result() -> RigCalibrationResult:
        return _result(combine_compliance(made), f"({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f}) cm")

    known = {name: there for name, there in setup.calibrated.items() if "compliance" not in name}
    found = touched_result(config, opening, recording, known, xy_m[None], touching, result)
    if config.write and not config.rig.startswith(LAB):
        write_values(Path(config.rig), found.dated)
    return found


def touched_result(
    config: "ArmConfig | CertifyConfig",
    opening: Opening,
    recording: "AbstractContextManager[Recorder]",
    calibrated: Mapping[str, bool],
    places_m: FloatArray,
    touching: Callable[[FromFrames, Callable[[str], None]], RigExperiment[None]],
    result: Callable[[], RigCalibrationResult],
) -> RigCalibrationResult:
    """Check, ask, and touch places (n, 2) [m]; the result of these touches, recorded. calibrated: as in `permitted`;
    touching: the experiment by the
    robot's geometry and a function that shows a line; result: called after it. Ends the command after a stop."""
    setup, options = opening.setup, opening.options
    stop: ExplorationStop | None = None
    with until_interrupted() as asked, recording as recorder, open_rig_run(setup.open_source(), recorder) as opened:
        watch = opened.watch(asked)

        def permitted_touching(robot: TouchingRobot) -> RigExperiment[None]:
            yield from permitted(robot, setup, options, calibrated, asked, yes=config.yes, places_m=places_m)
            yield from touching(FromFrames(robot.geometry, options), opened.line)

        with touching_robot(setup, opened.source, options, watch) as robot, watch.halts(robot):
            try:
                run_session(opened.source, permitted_touching(robot), recorder, robot)
            except ExplorationStopped as error:
                stop = error.stop
                recorder.stopped_because(f"{stop.kind}: {stop.reason}")
        found = None
        if stop is None:
            found = result()
            recorder.write(Step((RigFindings(found.findings(config.rig), tuple(opened.source.streams)),)))
    if found is None:
        leave_arm(
            stop, 0 if stop is None else stop.touch, asked, recorder.summary().path, arm_stopped=watch.arm_stopped
        )
    return found


def _result(found: CombinedCompliance, place: str) -> RigCalibrationResult:
    rows = [
        ("touched at", place),
        ("compliance", f"{1e3 * found.compliance_m_per_n:.3f} mm/N +- {1e3 * found.compliance_sd:.3f}"),
        ("camera", f"depth camera sees the surface {1e3 * found.off_m:+.1f} mm from the height of contact"),
        ("for [tool]", f"compliance_m_per_n = {found.compliance_m_per_n:.3e}"),
        ("", f"compliance_sd = {found.compliance_sd:.1e}"),
    ]
    if found.dome > 0.0:
        dent = f"dents {1e3 * found.dome * 3.0 ** (2.0 / 3.0):.2f} mm at 3 N (Hertz), in addition to the compliance"
        rows.insert(2, ("tip", dent))
    if found.compliance_sd > SURE_SD * found.compliance_m_per_n:
        rows.append(("note", "the touches differ: make more of them; is it rigid and firmly held?"))
    known = {"compliance_m_per_n": found.compliance_m_per_n, "compliance_sd": found.compliance_sd}
    png = compliance_png([one.found for one in found.touches], ArmCompliance(**known))
    figure = Figure(png, "Compliance of the arm at each touch")
    return RigCalibrationResult("arm", {"tool": {**known}}, tuple(rows), figure, cast("dict[str, Any]", plain(found)))
