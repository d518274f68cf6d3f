"""`deformscope calibrate tip|place|camera|force|time`: where things are on a rig, written into its file with intervals.

deformscope calibrate tip rig.toml
deformscope calibrate place rig.toml --touches 3
deformscope calibrate camera rig.toml --board 5x4 --square 0.05
deformscope calibrate force rig.toml
deformscope calibrate time rig.toml
deformscope calibrate time rig.toml --measured taps.rrd
deformscope calibrate tip rig.toml --measured poses.npz --no-write --json -
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np

from deformscope.cli.common import recorder_of, say, show, write_file, write_json
from deformscope.config import CameraConfig, ForceConfig, PlaceConfig, SetupOptions, TimeConfig, TipConfig
from deformscope.errors import InputError
from deformscope.experiments.rig_calibration import (
    push_tip,
    tap_tip,
    tilt_about_tip,
    touch_corners,
    view_board,
)
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame
from deformscope.log.rig_layout import RIG
from deformscope.rig.rig_file import load_rig
from deformscope.robot.setup import only_device
from deformscope.runs.calibration_solvers import (
    MeasuredCamera,
    TouchedCorners,
    camera_arrays,
    force_arrays,
    place_arrays,
    recorded_taps,
    solve_camera,
    solve_force,
    solve_place,
    solve_time,
    solve_tip,
    time_arrays,
    tip_arrays,
)
from deformscope.runs.commissioning import commissioning_steps, next_step
from deformscope.runs.rig_calibration import SetupTask, Station, set_up, written_lines
from deformscope.session import RigExperiment
from deformscope.stages.setup.board import CharucoSpec, board_image

M = TypeVar("M")


def tip(config: TipConfig) -> None:
    """Where the tip is on the arm's end."""
    _done(
        config,
        SetupTask(
            "tip", ("arm",), lambda at: tilt_about_tip(at.operator, at.arm, config.poses, say), tip_arrays, solve_tip
        ),
    )


def place(config: PlaceConfig) -> None:
    """Where the surface is."""
    corners = [number for _ in range(config.touches) for number in range(3)]

    def measure(at: Station) -> RigExperiment[TouchedCorners]:
        poses = yield from touch_corners(at.operator, at.arm, corners, say)
        return TouchedCorners(poses, np.array(corners))

    _done(config, SetupTask("place", ("arm",), measure, place_arrays, solve_place))


def camera(config: CameraConfig) -> None:
    """Where the camera stands, and its lens."""
    board = CharucoSpec(*config.board, config.square)
    if config.print_board is not None:
        write_file(config.print_board, cv2.imencode(".png", board_image(board))[1].tobytes())
        side = 1e3 * config.square
        say(f"board: {config.print_board}; a square's side is {side:g} mm when printed; glue it onto something flat")
        return

    def measure(at: Station) -> RigExperiment[MeasuredCamera]:
        views = yield from view_board(at.operator, at.arm, at.camera, board, config.views, say)
        return MeasuredCamera(views)

    _done(
        config,
        SetupTask(
            "camera",
            ("arm", "depth"),
            measure,
            camera_arrays,
            lambda rig, made: solve_camera(rig, made, board, measure_lens=config.lens),
        ),
    )


def force(config: ForceConfig) -> None:
    """How the force sensor sits on the stick."""
    rig = load_rig(config.rig, trusted=config.trust_rig)
    if config.measured is None and rig.surface.T_arm_surface is None:  # before anybody pushes
        raise InputError("a rig file with tip and place", "no place", f"deformscope calibrate place {config.rig} first")
    _done(
        config,
        SetupTask(
            "force",
            ("arm", "wrench"),
            lambda at: push_tip(at.operator, at.arm, at.wrench, config.repeats, config.tilts, say, config.weight),
            lambda found: force_arrays(found, config.weight),
            solve_force,
        ),
    )


def time(config: TimeConfig) -> None:
    """How the clocks of force sensor and another device differ."""
    rig = load_rig(config.rig, trusted=config.trust_rig)
    kinds = {entry.name: entry.driver.kind for entry in rig.devices}
    name = config.device or next((one for one, kind in kinds.items() if kind == "arm"), "")
    frames: dict[str, type[ArmFrame | DepthFrame | ColorFrame]] = {
        "arm": ArmFrame,
        "depth": DepthFrame,
        "color": ColorFrame,
    }
    if kinds.get(name) not in frames:
        raise InputError("--device: an arm or a camera of the rig", repr(name), ", ".join(kinds), config.rig)
    kind = frames[kinds[name]]
    wrench = only_device(rig, "wrench", "to measure with").name
    _done(
        config,
        SetupTask(
            "time",
            ("wrench", kinds[name]),
            lambda at: tap_tip(at.operator, at.wrench, name, kind),
            time_arrays,
            lambda rig, taps: solve_time(rig, taps, name, wrench),
            lambda path: recorded_taps(path, wrench, name, kind),
        ),
    )


def _done(config: SetupOptions, task: SetupTask[M]) -> None:
    with recorder_of(config, RIG if config.measured is None else None, real_time=True) as recorder:
        found = set_up(config, task, recorder)
    show(found.findings(config.rig))
    if not config.write:
        print(written_lines(found), flush=True)
    if config.picture is not None:
        write_file(config.picture, found.figure.png)
        say(f"picture: {config.picture}")
    if config.write and (
        following := next_step(commissioning_steps(load_rig(config.rig, trusted=config.trust_rig), config.rig))
    ):
        say(f"next: {following.command}")
    write_json({"kind": found.kind, **found.found}, config.output.json)
