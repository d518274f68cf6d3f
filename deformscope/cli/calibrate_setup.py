"""`deformscope calibrate tip|place|camera|force|time|arm`: measure the geometry of a rig and the compliance of its arm,
and write them into its file with intervals."""

import cv2

from deformscope.cli.common import quiet_warp, recorder_of, say, show, write_file, write_json
from deformscope.config import ArmConfig, CameraConfig, CertifyConfig, SetupOptions, WrenchConfig
from deformscope.log.layout import RIG
from deformscope.rig.rig_edit import lines_of
from deformscope.rig.rig_file import load_rig
from deformscope.runs.arm_calibration import set_up, touch_known, written_lines
from deformscope.runs.calibration_tasks import TASKS
from deformscope.runs.commissioning import commissioning_steps, next_step
from deformscope.stages.setup.board import CharucoSpec, board_image


def run(config: SetupOptions) -> None:
    """Measure, or read a measurement; print and write the result."""
    if isinstance(config, CameraConfig) and config.print_board is not None:
        board = CharucoSpec(*config.board, config.square)
        write_file(config.print_board, cv2.imencode(".png", board_image(board))[1].tobytes())
        side = 1e3 * config.square
        say(f"a square's side is {side:g} mm when printed; glue the board onto something flat")
        return
    task = TASKS[type(config)](config)
    with recorder_of(config, RIG if config.measured is None else None, real_time=True) as recorder:
        found = set_up(config, task, recorder)
    show(found.findings(config.rig))
    if not config.write:
        print(written_lines(found), flush=True)
    if config.picture is not None:
        write_file(config.picture, found.figure.png)
    if config.write and (
        following := next_step(commissioning_steps(load_rig(config.rig, trusted=config.trust_rig), config.rig))
    ):
        say(f"next: {following.command}")
    write_json({"kind": found.kind, **found.found}, config.output.json)


def arm(config: ArmConfig | WrenchConfig | CertifyConfig) -> None:
    """Touch a rigid block, a sample of known modulus, or nothing; print the result, and write it into the rig file."""
    quiet_warp()
    found = touch_known(config)
    show(found.findings(config.rig))
    unwritten = isinstance(config, WrenchConfig) and (not config.write or config.rig.startswith("lab:"))
    if unwritten or (isinstance(config, CertifyConfig) and not config.save):
        print(lines_of(found.values), flush=True)
    write_json({"kind": found.kind, **found.found}, config.output.json)
