"""Force and torque of the tip on the world, from a sensor between the arm's end and the tool.

A tool of mass m with its centre of mass at c, and the tip at r, in the sensor's frame, at rest or moving (Newton):

    f = F - w + m a,    t = T + r x F + c x (m a - w),    a = a_end + alpha x d + omega x (omega x d)

with F, T: force and torque of the tip on the world; w: weight; d: from the arm's end to the centre of mass. The tool's
inertia about its own centre of mass is not in it: `calibrate tool` does not measure it."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError

GRAVITY_M_S2 = 9.80665
LEAST_STATES = 5
"""States of the arm in a window; a parabola through fewer has no errors left to average."""


@dataclass(frozen=True, slots=True)
class CarriedTool:
    """T_ee_tip: (4, 4) the tip's frame to the arm's end [m]; sensor_m: (3,) origin of the sensor's frame in the arm's
    end [m]; R_tip_force: (3, 3) the sensor's forces to the tip's, improper where the sensor reports the reaction
    weight_n: (3,) weight in the arm's base [N]; center_m: (3,) its centre in the sensor's frame [m]"""

    T_ee_tip: FloatArray
    sensor_m: FloatArray
    R_tip_force: FloatArray
    weight_n: FloatArray
    center_m: FloatArray

    @property
    def R_ee_sensor(self) -> FloatArray:
        """(3, 3) axes of the sensor in the arm's end."""
        return np.asarray(np.linalg.det(self.R_tip_force) * self.T_ee_tip[:3, :3] @ self.R_tip_force)

    @property
    def tip_m(self) -> FloatArray:
        """(3,) the tip in the sensor's frame [m]."""
        return np.asarray(self.R_ee_sensor.T @ (self.T_ee_tip[:3, 3] - self.sensor_m))


@dataclass(frozen=True, slots=True)
class TipWrench:
    """force_n: (3,) force of the tip on the world [N], torque_nm: (3,) torque about the tip [N m], None from a sensor
    of three axes, both in the tip's frame, since the first quarter of a second; load_n: (3,) what weight and motion of
    the tool were in the sensor, in its frame [N]"""

    force_n: FloatArray
    torque_nm: FloatArray | None
    load_n: FloatArray


@dataclass(frozen=True, slots=True)
class SensorWindow:
    """arm_s: (n,) times of the arm's states relative to the reading [s]; position_m (n, 3), rotation (n, 3, 3): its end
    in the base; force_n: (3,) and torque_nm: (3,) [N m] or None: the reading, or the mean of several"""

    arm_s: FloatArray
    position_m: FloatArray
    rotation: FloatArray
    force_n: FloatArray
    torque_nm: FloatArray | None


def tool_load(window: SensorWindow, tool: CarriedTool) -> tuple[FloatArray, FloatArray]:
    """(3,) force [N] and (3,) torque [N m] of weight and motion of the tool in the sensor, in its frame.

    Velocity and acceleration at the reading are those of parabolas through the positions and the rotation vectors in
    the window (Savitzky and Golay 1964), which has the reading in its middle. Raises InputError for too few states."""
    from scipy.spatial.transform import Rotation  # exports read this class, and need no scipy.spatial

    time_s = window.arm_s
    if len(time_s) < LEAST_STATES:
        raise InputError(f"{LEAST_STATES} states of the arm around a reading of the force", str(len(time_s)))
    middle = window.rotation[int(np.argmin(np.abs(time_s)))]
    turned = Rotation.from_matrix(window.rotation @ middle.T).as_rotvec()
    fitted = np.polynomial.polynomial.polyfit(time_s, np.hstack([window.position_m, turned]), 2)
    R_base_ee = Rotation.from_rotvec(fitted[0, 3:]).as_matrix() @ middle
    linear, angular, omega = 2.0 * fitted[2, :3], 2.0 * fitted[2, 3:], fitted[1, 3:]
    lever = R_base_ee @ (tool.sensor_m + tool.R_ee_sensor @ tool.center_m)
    acceleration = linear + np.cross(angular, lever) + np.cross(omega, np.cross(omega, lever))
    load = np.linalg.norm(tool.weight_n) / GRAVITY_M_S2 * acceleration - tool.weight_n
    load_n = (R_base_ee @ tool.T_ee_tip[:3, :3] @ tool.R_tip_force).T @ load
    return load_n, np.cross(tool.center_m, load_n)


def tip_wrench(free: SensorWindow, now: SensorWindow, tool: CarriedTool, gain: float = 1.0) -> TipWrench:
    """What the tip does to the world since `free`, when it touched nothing, which gives the sensor's zero.

    gain: the sensor's values over true ones. Raises InputError for too few states of the arm."""
    (load_n, load_nm), (free_n, free_nm) = tool_load(now, tool), tool_load(free, tool)
    force_n = now.force_n - load_n - (free.force_n - free_n)
    torque_nm = None
    if now.torque_nm is not None and free.torque_nm is not None:
        torque_nm = now.torque_nm - load_nm - (free.torque_nm - free_nm) - np.cross(tool.tip_m, force_n)
        torque_nm = tool.R_tip_force @ torque_nm / gain
    return TipWrench(tool.R_tip_force @ force_n / gain, torque_nm, load_n)
