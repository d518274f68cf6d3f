"""Geometry and time offsets of a rig: `deformscope calibrate place`, `tip`, `camera`, `force` and `time`."""

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
    """Options that these commands share."""

    rig: flags.RigFlag
    """A rig file (.toml), which is read and updated."""
    measured: MeasuredFlag = None
    """Solve from arrays of an earlier measurement, instead of with the devices: T_base_ee (n, 4, 4), and the arrays
    that the command's help lists."""
    write: bool = True
    """Write values, date and interval into the rig file; --no-write only prints the lines."""
    picture: flags.PictureFlag = None
    """Draw the residual of each measurement to a PNG."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)

    def check(self) -> None:
        if self.write and self.rig.startswith(SAMPLE_SCHEME):
            hint = "--no-write, or deformscope rig new rig.toml --doubles"
            raise InputError("a rig file that can be written into", "a sample", hint, self.rig)


@dataclass(frozen=True, slots=True)
class PlaceConfig(SetupOptions):
    """Find the pose of the surface, its sides and the box around it, from three of its corners: bring the tip onto each
    by the joystick. --measured: T_base_ee and corner (n,), 0 the origin, 1 the end of x, 2 the end of y, 3 the far
    one."""

    touches: flags.ManyFlag = 2
    """Number of touches of each corner."""


@dataclass(frozen=True, slots=True)
class TipConfig(SetupOptions):
    """Find the position of the tip on the arm's end: hold its ball in a cone and tilt the stick by the joystick, each
    way. --measured: T_base_ee."""

    poses: Annotated[int, flags.least(4)] = 8
    """Number of tilts."""


@dataclass(frozen=True, slots=True)
class CameraConfig(SetupOptions):
    """Find the camera's pose and lens from views of a ChArUco board on the arm's end. --measured: T_base_ee with
    T_camera_board (n, 4, 4), or touched_m (n, 3) [base frame] with seen_m (n, 3) [camera frame]."""

    views: Annotated[int, flags.least(6)] = 14
    """Number of views of the board."""
    board: Annotated[tuple[int, int], flags.one_word("COLUMNSxROWS", flags.parse_grid)] = (5, 4)
    """Squares of the board, of OpenCV's 4x4 markers."""
    square: Annotated[float, flags.one_word("NUMBER", flags.positive)] = 0.05
    """Side of a square [m]."""
    lens: bool = False
    """Measure the lens too, even if the rig file has focal_px and center_px."""
    print_board: flags.PictureFlag = None
    """Draw the board for printing to a PNG, and do nothing else."""


@dataclass(frozen=True, slots=True)
class ForceConfig(SetupOptions):
    """Find the orientation of the force sensor on the stick, its noise and its drift: push the tip with a finger along
    the table's axes. It needs the tip and the place. --measured: force_n (n, 3) and axis (n, 3), the push of the tip on
    the world in the tip's frame; loaded_n (k, 3), the force under --weight relative to free air."""

    repeats: flags.ManyFlag = 2
    """Rounds of five pushes."""
    weight: Annotated[float | None, flags.one_word("NUMBER", flags.positive), flags.unset] = None
    """Find the sensor's gain too, under this given load [N]: press the tip onto a kitchen scale, four times."""
    tilts: Annotated[int, flags.least(0)] = 0
    """Weigh the load on the sensor, in this number of poses of the stick in free air: four or more."""


@dataclass(frozen=True, slots=True)
class ToolConfig(SetupOptions):
    """Find the weight of all that the force sensor carries, with six axes its centre of mass too: hold the stick in
    free air, tilted each way. The weight is then taken out of the readings as the arm turns. --measured: T_base_ee,
    force_n and torque_nm (n, 3)."""

    poses: Annotated[int, flags.least(4)] = 8
    """Number of poses."""


@dataclass(frozen=True, slots=True)
class TimeConfig(SetupOptions):
    """Find the delay of another device's clock relative to the force sensor's, from taps on the tip. --measured:
    x_time_s, x, y_time_s, y; or a recording of any command in which the tip was tapped."""

    measured: TapsFlag = None
    """Solve from arrays, or from a recording of both devices (two minutes at most), instead of with the devices."""
    device: str = ""
    """The other device: an arm or a camera; default: the arm."""
