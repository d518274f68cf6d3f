"""Measurements of `deformscope calibrate tip`, `place`, `camera`, `force` and `time`, and their solutions."""

from collections.abc import Callable
from typing import Any

import numpy as np

from deformscope.config import CameraConfig, ForceConfig, PlaceConfig, TimeConfig, TipConfig, ToolConfig
from deformscope.errors import InputError
from deformscope.experiments.rig import rig_calibration
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame
from deformscope.rig.rig_file import load_rig
from deformscope.robot.setup import only_device
from deformscope.runs import calibration_solvers
from deformscope.runs.rig_calibration import SetupTask, Station
from deformscope.session import RigExperiment
from deformscope.stages.setup.board import CharucoSpec
from deformscope.terminal import say


def _tip(config: TipConfig) -> SetupTask[Any]:
    """Position of the tip on the arm's end."""
    return SetupTask(
        "tip",
        ("arm",),
        lambda at: rig_calibration.tilt_about_tip(at.operator, at.arm, config.poses, say),
        calibration_solvers.tip_arrays,
        calibration_solvers.solve_tip,
    )


def _place(config: PlaceConfig) -> SetupTask[Any]:
    """Pose of the surface."""
    corners = [number for _ in range(config.touches) for number in range(3)]

    def measure(at: Station) -> RigExperiment[calibration_solvers.TouchedCorners]:
        poses = yield from rig_calibration.touch_corners(at.operator, at.arm, corners, say)
        return calibration_solvers.TouchedCorners(poses, np.array(corners))

    return SetupTask("place", ("arm",), measure, calibration_solvers.place_arrays, calibration_solvers.solve_place)


def _camera(config: CameraConfig) -> SetupTask[Any]:
    """The camera's pose and lens."""
    board = CharucoSpec(*config.board, config.square)

    def measure(at: Station) -> RigExperiment[calibration_solvers.MeasuredCamera]:
        views = yield from rig_calibration.view_board(at.operator, at.arm, at.camera, board, config.views, say)
        return calibration_solvers.MeasuredCamera(views)

    return SetupTask(
        "camera",
        ("arm", "depth"),
        measure,
        calibration_solvers.camera_arrays,
        lambda rig, made: calibration_solvers.solve_camera(rig, made, board, measure_lens=config.lens),
    )


def _force(config: ForceConfig) -> SetupTask[Any]:
    """Orientation of the force sensor on the stick."""
    rig = load_rig(config.rig, trusted=config.trust_rig)
    if config.measured is None and rig.surface.T_arm_surface is None:  # before anybody pushes
        raise InputError("a rig file with tip and place", "no place", f"deformscope calibrate place {config.rig} first")
    return SetupTask(
        "force",
        ("arm", "wrench"),
        lambda at: rig_calibration.push_tip(
            at.operator, at.arm, at.wrench, config.repeats, config.tilts, say, config.weight
        ),
        lambda found: calibration_solvers.force_arrays(found, config.weight),
        calibration_solvers.solve_force,
    )


def _tool(config: ToolConfig) -> SetupTask[Any]:
    """Weight and centre of mass of what the force sensor carries."""
    return SetupTask(
        "tool",
        ("arm", "wrench"),
        lambda at: rig_calibration.weigh_tool(at.operator, at.arm, at.wrench, config.poses, say),
        calibration_solvers.tool_arrays,
        calibration_solvers.solve_tool,
    )


def _time(config: TimeConfig) -> SetupTask[Any]:
    """Offset between the clocks of force sensor and another device."""
    rig = load_rig(config.rig, trusted=config.trust_rig)
    kinds = {entry.name: entry.driver.kind for entry in rig.devices}
    name = config.device or next((one for one, kind in kinds.items() if kind == "arm"), "")
    frames: dict[str, type[ArmFrame | DepthFrame | ColorFrame]]
    frames = {"arm": ArmFrame, "depth": DepthFrame, "color": ColorFrame}
    if kinds.get(name) not in frames:
        raise InputError("--device: an arm or a camera of the rig", repr(name), ", ".join(kinds), config.rig)
    kind = frames[kinds[name]]
    wrench = only_device(rig, "wrench", "to measure with").name
    return SetupTask(
        "time",
        ("wrench", kinds[name]),
        lambda at: rig_calibration.tap_tip(at.operator, at.wrench, name, kind),
        calibration_solvers.time_arrays,
        lambda rig, taps: calibration_solvers.solve_time(rig, taps, name, wrench),
        lambda path: calibration_solvers.recorded_taps(path, wrench, name, kind),
    )


TASKS: dict[type, Callable[[Any], SetupTask[Any]]] = {
    TipConfig: _tip,
    PlaceConfig: _place,
    CameraConfig: _camera,
    ForceConfig: _force,
    TimeConfig: _time,
    ToolConfig: _tool,
}
"""By options. Each raises InputError if the rig file lacks a required key."""
