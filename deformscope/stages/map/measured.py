"""Measurements of a robot on a surface, and the recorded frames from which they are computed.

A frame is named by its device and the time at which it came, on the host's clock [ns]: no device gives two at once."""

import dataclasses
from dataclasses import dataclass

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.map.perception import ForcePose
from deformscope.stages.poke.layer_seen import TableSeen
from deformscope.stages.see.pixel_labels import SeenPixels


@dataclass(frozen=True, slots=True)
class SurfaceMeasurement:
    """Measurement of the camera. points_m: (n, 3) points of the surface, robot and outliers taken away, surface frame
    [m]; noise_m: (n,) deviation of each height [m]; table: the table around it, None = not visible, or not searched for
    pixels: number of pixels of the points, None = not requested, or no images"""

    points_m: FloatArray
    noise_m: FloatArray
    table: TableSeen | None = None
    pixels: SeenPixels | None = None


@dataclass(frozen=True, slots=True)
class TouchMeasurement:
    """Measurement of a touch.

    xy_m: (2,) planned place; normal: (3,) direction of the touch, outwards; time_s: (n,) rising; position_m: (n, 3)
    middle of the ball as the arm reports; force_n: (n, 3) force on it; surface frame
    after_m: (k, 3) points seen while it pressed, without the robot; reached: the set force was reached
    seen_ns: when they were last seen, on the robot's clock; 0 = never; loading, held: number of samples up to the set
    force, and up to the retract; None without a creep measurement: then all samples are up to the set force
    pixels: pixels from which after_m was computed; force_pose: force and pose at the force's rate; None = not
    requested, or not measured at that rate"""

    xy_m: FloatArray
    normal: FloatArray
    time_s: FloatArray
    position_m: FloatArray
    force_n: FloatArray
    after_m: FloatArray
    reached: bool
    seen_ns: int = 0
    loading: int | None = None
    held: int | None = None
    pixels: SeenPixels | None = None
    force_pose: ForcePose | None = None

    @property
    def approach(self) -> "TouchMeasurement":
        """The measurement without its hold and its way back."""
        if self.loading is None:
            return self
        time_s, position_m, force_n = (one[: self.loading] for one in (self.time_s, self.position_m, self.force_n))
        return dataclasses.replace(self, time_s=time_s, position_m=position_m, force_n=force_n, loading=None, held=None)


@dataclass(frozen=True, slots=True)
class LookFrames:
    """The frames from which a look at the surface is computed.

    camera, depth_ns (k,): depth images; arm, arm_ns: the arm's states in all these frames, and before the first touch
    arm_model: the vendor's name of the arm; focal_px, center_px: (x, y) focal length and centre of the camera"""

    camera: str
    depth_ns: IntArray
    arm: str
    arm_ns: int
    arm_model: str
    focal_px: tuple[float, ...]
    center_px: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class TouchFrames:
    """The frames from which a touch is computed.

    xy_m: (2,) planned place; normal: (3,) direction of the touch, outwards; reached: the set force was reached
    arm, arm_ns (n,): states from the approach until the force was reached
    wrench, wrench_ns, wrench_ticks (m,): usable readings; pose_ns (m,): time of the arm's newest state at each
    tare_n: (3,) reading in free air before the touch [N]
    camera, depth_ns (k,): images of the dent; depth_arm_ns: (k,) the arm's state in each
    seen_ns: last time at which the tip pressed without moving; end_ns: the arm's state after it
    held_ns: (h,) states from the set force until the tip was back, None without a creep measurement"""

    xy_m: FloatArray
    normal: FloatArray
    reached: bool
    arm: str
    arm_ns: IntArray
    wrench: str
    wrench_ns: IntArray
    wrench_ticks: IntArray
    pose_ns: IntArray
    tare_n: FloatArray
    camera: str
    depth_ns: IntArray
    depth_arm_ns: IntArray
    seen_ns: int
    end_ns: int
    held_ns: IntArray | None = None
