"""Items that devices, files and recordings give to experiments and recordings: stamped and immutable.

Every frame has its time (`stamp`), its device (`device`, its name in the rig) and its index in that device's stream
(`index`, from 0; a missing index was lost)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from deformscope.arrays import FloatArray, ImageArray, IntArray
from deformscope_drivers.clock import Stamp
from deformscope_drivers.health import Health, LinkEvent
from deformscope_drivers.health import PadLayout as PadLayout
from deformscope_drivers.interface import Kind as Kind

NoteKind = (
    Literal["note", "episode-begin", "episode-end", "tare", "alarm", "alarm-over", "stage", "stage-over"]
    | Literal["discard-episode", "discard-recording"]
)


@dataclass(frozen=True, slots=True)
class ColorFrame:
    """One camera image.

    image: (H, W) grey or (H, W, 3) RGB, uint8 or uint16"""

    stamp: Stamp
    index: int
    image: ImageArray
    device: str = "camera"


@dataclass(frozen=True, slots=True)
class DepthFrame:
    """One image of distances along the camera's axis.

    depth: (H, W) uint16 in units of unit_m [m], 0 = nothing seen; color: (H, W, 3) RGB uint8 at the depth's pixels, or
    None"""

    stamp: Stamp
    index: int
    depth: ImageArray
    unit_m: float
    color: ImageArray | None = None
    device: str = "depth"


@dataclass(frozen=True, slots=True)
class TactileFrame:
    """The pressures on a hand's pads at one moment.

    counts: (texels,) uint16, as the device gave them, all pads one after the other, row by row; pressure_pa: one (rows,
    columns) array for each pad [Pa]"""

    stamp: Stamp
    index: int
    counts: IntArray
    pressure_pa: tuple[FloatArray, ...]
    device: str = "tactile"


@dataclass(frozen=True, slots=True)
class WrenchFrame:
    """Forces, and torques where the sensor measures them, at one moment, in the sensor's own frame.

    counts: (channels * axes,) as the device gave them
    force_n: (channels, 3) [N], NaN where no sensitivity report was given; torque_nm: (channels, 3) [N m] or None
    overload: an axis is beyond its range; usable: the device reports no fault"""

    stamp: Stamp
    index: int
    counts: IntArray
    force_n: FloatArray
    torque_nm: FloatArray | None = None
    overload: bool = False
    usable: bool = True
    device: str = "wrench"


@dataclass(frozen=True, slots=True)
class ArmFrame:
    """Pose of an arm, in its base frame.

    joint_deg, joint_velocity_deg_s, joint_torque_nm: (joints,) [deg], [deg/s], [N m]
    position_m: (3,) end effector [m]; rotation_rad: (3,) its Euler angles as the arm reports them [rad]
    force_n, torque_nm: (3,) at the end effector as the arm estimates them [N], [N m]
    finger: (fingers,) 0 open to 1 closed; queued: points that the arm has not executed yet"""

    stamp: Stamp
    index: int
    joint_deg: FloatArray
    joint_velocity_deg_s: FloatArray
    joint_torque_nm: FloatArray
    position_m: FloatArray
    rotation_rad: FloatArray
    force_n: FloatArray
    torque_nm: FloatArray
    finger: FloatArray
    queued: int = 0
    device: str = "arm"


@dataclass(frozen=True, slots=True)
class HandFrame:
    """The joints of a hand.

    position_deg, velocity_deg_s: (7,) [deg], [deg/s]; temperature_c: (9,) [deg C], NaN before the first reading; state:
    one word for each axis (idle, positioning, blocked...)"""

    stamp: Stamp
    index: int
    position_deg: FloatArray
    velocity_deg_s: FloatArray
    temperature_c: FloatArray
    state: tuple[str, ...]
    device: str = "hand"


Frame = ColorFrame | DepthFrame | TactileFrame | WrenchFrame | ArmFrame | HandFrame
"""Every kind of frame a source can give."""


@dataclass(frozen=True, slots=True)
class RawBytes:
    """Bytes as they went over a device's wire. host_ns: when [ns]; sent: the host sent them to the device"""

    host_ns: int
    data: bytes
    sent: bool
    device: str


@dataclass(frozen=True, slots=True)
class LinkChange:
    """Change of a device's link: it was made, lost, made again or given up."""

    event: LinkEvent
    device: str


@dataclass(frozen=True, slots=True)
class HealthReport:
    """The health of all devices at one time. host_ns: when [ns]; devices: health of each device, by name"""

    host_ns: int
    devices: tuple[tuple[str, Health], ...]


@dataclass(frozen=True, slots=True)
class SessionNote:
    """A person's remark during the recording, or a detected event. host_ns: when [ns]; text: a note in words, an
    episode's label, the name of a tared device, an alarm of a sensor (`deformscope.rig.alarms`), or the reason for a
    stage without results. Also the reason why an episode (the newest that began) or the whole recording is discarded"""

    host_ns: int
    about: NoteKind
    text: str


Item = Frame | RawBytes | LinkChange | HealthReport | SessionNote
"""Content of a rig's recording."""


def host_ns(item: Item) -> int:
    """When an item was taken, on the host's clock [ns]."""
    if isinstance(item, RawBytes | HealthReport | SessionNote):
        return item.host_ns
    if isinstance(item, LinkChange):
        return item.event.host_ns
    return item.stamp.host_ns


@dataclass(frozen=True, slots=True)
class UsedFrames:
    """Frames of a device from which a result was computed: places in its stream, from the first to the last of them"""

    device: str
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class StageResult:
    """A stage's result from the newest frames, during the recording.

    stage: its name; used: its input frames, the frame that it belongs to last
    host_ns: when that frame was taken, on the host's clock [ns]
    skipped: frames of that device since the previous result that were not used, as newer ones came
    late_s: time from taking the frame until the result was there [s]
    result: result of a kind that `deformscope.rows` can record"""

    stage: str
    used: tuple[UsedFrames, ...]
    host_ns: int
    skipped: int
    late_s: float
    result: Any


@dataclass(frozen=True, slots=True)
class StageCost:
    """Cost of a computation, without separately measured stages within it.

    stage: its name; wall_ms: duration by the clock; cpu_ms: CPU time of the thread that computed
    behind_ms: delay of its result relative to the newest frame, None if frames wait for it"""

    stage: str
    wall_ms: float
    cpu_ms: float
    behind_ms: float | None = None


@dataclass(frozen=True, slots=True)
class InputFile:
    """An input that is no frame: a file or a mask. content: the bytes of a file; of a mask, its PNG"""

    name: str
    content: bytes


@dataclass(frozen=True, slots=True)
class Stream:
    """Description of a device before its first frame.

    simulated: it is a double, not a real device; pads: layout of a tactile sensor; urdf: URDF of an arm; serial: as the
    device reports it
    channels: channels of a force sensor; torques: whether it measures them; fastest_hz: the rate to which it was set
    full_scale_pa: pressure of a tactile sensor's largest count [Pa], 0 where that is not known"""

    device: str
    kind: Kind
    driver: str
    simulated: bool = False
    serial: str = ""
    firmware: str = ""
    pads: tuple[PadLayout, ...] = ()
    urdf: Path | None = None
    channels: int = 1
    torques: bool = False
    fastest_hz: float = 0.0
    full_scale_pa: float = 0.0
