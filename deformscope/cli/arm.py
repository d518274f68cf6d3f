"""`deformscope arm where|files|home|go|jog`: where an arm is, and moving it without exploring."""

import numpy as np

from deformscope.cli.common import recorder_of, say, show_table, write_json
from deformscope.config import FilesConfig, GoConfig, HomeConfig, JogConfig, WhereConfig
from deformscope.errors import InputError
from deformscope.log.layout import RIG
from deformscope.rig.rig_file import load_rig
from deformscope.robot.setup import only_device
from deformscope.runs import arm_commands


def where(config: WhereConfig) -> None:
    """Print where the arm is."""
    found = arm_commands.where(config)
    joints = [
        f"{angle:.1f} ({left:.0f} to its limit)" if np.isfinite(left) else f"{angle:.1f}"
        for angle, left in zip(found.joints_deg, found.to_limits_deg, strict=True)
    ]
    rows = [
        ("joints [deg]", ", ".join(joints)),
        ("homed", "yes" if found.homed else "no: deformscope arm home"),
        ("end [mm]", _mm(found.T_base_ee[:3, 3]) + " in the base frame"),
        ("tip [mm]", _mm(found.tip_base_m) + " in the base frame"),
    ]
    if found.tip_surface_m is not None:
        rows.append(("", _mm(found.tip_surface_m) + " in the surface frame"))
    show_table(config.rig, rows)
    write_json(found, config.json)


def files(config: FilesConfig) -> None:
    """Write the files for an arm's controller."""
    entry = only_device(load_rig(config.rig, trusted=config.trust_rig), "arm", "to set up")
    if entry.driver.controller_files is None:
        raise InputError("an arm with files for its controller", f"[devices.{entry.name}], whose driver has none")
    config.out.mkdir(parents=True, exist_ok=True)
    for name, text in entry.driver.controller_files(entry.config).items():
        (config.out / name).write_text(text, "utf-8")
    say("no controller has run these files: read the driver's documentation, and try them at reduced speed (T1) first")


def home(config: HomeConfig) -> None:
    """Send the arm home."""
    arm_commands.home(config)
    say("the arm is at home")


def go(config: GoConfig) -> None:
    """Bring the tip over a place."""
    place_m = arm_commands.go(config, config.above, config.height, recorder_of(config, RIG, real_time=True))
    say(f"the tip's centre is at {_mm(place_m)} mm in the surface frame")
    write_json({"center_m": place_m}, config.output.json)


def jog(config: JogConfig) -> None:
    """Move the tip by keys."""
    place_m = arm_commands.jog(config, recorder_of(config, RIG, real_time=True))
    say(f"the tip's centre is at {_mm(place_m)} mm in the surface frame")
    write_json({"center_m": place_m}, config.output.json)


def _mm(place_m: np.ndarray) -> str:
    return ", ".join(f"{1e3 * value:.1f}" for value in place_m)
