"""Where things are on a rig: `deformscope calibrate place`, `tip`, `camera`, `force` and `time`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes

from deformscope.config import flags
from deformscope.config.options import RecordedOptions, ViewOptions
from deformscope.errors import InputError
from deformscope.file_io import SAMPLE_SCHEME

MeasuredFlag = Annotated[Path | None, flags.one_word("FILE.npz", Path), flags.unset, flags.ends(".npz"), flags.Reads()]

TapsFlag = Annotated[
    Path | None, flags.one_word("FILE.npz|FILE.rrd", Path), flags.unset, flags.ends(".npz", ".rrd"), flags.Reads()
]


@dataclass(frozen=True, slots=True)
class SetupOptions(RecordedOptions):
    """What these commands share."""

    rig: flags.RigFlag
    """A rig file (.toml): read, and written into."""
    measured: MeasuredFlag = None
    """Solve from arrays measured before, instead of with the devices: T_base_ee (n, 4, 4), and what else the command's
    help names."""
    write: bool = True
    """Write values, date and interval into the rig file; --no-write prints the lines alone."""
    picture: flags.PictureFlag = None
    """Draw how far each measurement is off to a PNG."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)

    def check(self) -> None:
        if self.write and self.rig.startswith(SAMPLE_SCHEME):
            hint = "--no-write, or deformscope doctor --example --doubles > rig.toml"
            raise InputError("a rig file that can be written into", "a sample", hint, self.rig)


@dataclass(frozen=True, slots=True)
class PlaceConfig(SetupOptions):
    """Find where the surface is, its sides and the box around it, from three of its corners: bring the tip onto each by
    the joystick. --measured: T_base_ee and corner (n,), 0 the origin, 1 the end of x, 2 the end of y, 3 the far one."""

    touches: flags.ManyFlag = 2
    """How often each corner is touched."""


@dataclass(frozen=True, slots=True)
class TipConfig(SetupOptions):
    """Find where the tip is on the arm's end: hold its ball in a cone and tilt the stick by the joystick, each way.
    --measured: T_base_ee."""

    poses: Annotated[int, flags.least(4)] = 8
    """How many tilts."""


@dataclass(frozen=True, slots=True)
class CameraConfig(SetupOptions):
    """Find where the camera stands, and its lens, from views of a ChArUco board on the arm's end. --measured: T_base_ee
    with T_camera_board (n, 4, 4), or touched_m (n, 3) [base frame] with seen_m (n, 3) [camera frame]."""

    views: Annotated[int, flags.least(6)] = 14
    """How many views of the board."""
    board: Annotated[tuple[int, int], flags.one_word("COLUMNSxROWS", flags.parse_grid)] = (5, 4)
    """Squares of the board, of OpenCV's 4x4 markers."""
    square: Annotated[float, flags.one_word("NUMBER", flags.positive)] = 0.05
    """Side of a square [m]."""
    lens: bool = False
    """Measure the lens too where the rig file has focal_px and center_px already."""
    print_board: flags.PictureFlag = None
    """Draw the board to print to a PNG, and do nothing else."""


@dataclass(frozen=True, slots=True)
class ForceConfig(SetupOptions):
    """Find how the force sensor sits on the stick, its noise and its drift: push the tip with a finger along the
    table's axes. Wants the tip and the place. --measured: force_n (n, 3) and axis (n, 3), the push of the tip on the
    world in the tip's frame; loaded_n (k, 3), felt under --weight beyond free air."""

    repeats: flags.ManyFlag = 2
    """Rounds of five pushes."""
    weight: Annotated[float | None, flags.one_word("NUMBER", flags.positive), flags.unset] = None
    """Find the sensor's gain too, under this known load [N]: the tip pressed onto a kitchen scale, four times."""
    tilts: Annotated[int, flags.least(0)] = 0
    """Weigh what hangs on the sensor, in so many poses of the stick in free air: four or more."""


@dataclass(frozen=True, slots=True)
class TimeConfig(SetupOptions):
    """Find by how much another device's clock is behind the force sensor's, from taps on the tip. --measured: x_time_s,
    x, y_time_s, y; or a recording in which the tip was tapped, of whatever command."""

    measured: TapsFlag = None
    """Solve from arrays, or from a recording of both devices (two minutes at most), instead of with the devices."""
    device: str = ""
    """The other device: an arm or a camera; default: the arm."""
