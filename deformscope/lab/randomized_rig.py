"""A rig whose doubles are not at the poses of its file: random poses that the calibration has to find.

`[surface] hidden = 7` in a rig file asks for one. `SimulatedHand` carries out the requests of the calibrating commands,
with small errors, as a person at a real rig would.
"""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.ray_camera import looking_at
from deformscope.rig.rig_file import Tool
from deformscope.robot.placement import Placement
from deformscope.robot.setup import T_BASE_SURFACE
from deformscope_drivers.arm.kinematics import transform
from deformscope_drivers.images import Intrinsics
from deformscope_drivers.interface import ArmBody
from deformscope_drivers.jaco import JacoDouble
from deformscope_drivers.manual_arm import StandDouble

UP = np.array([0.0, 0.0, 1.0])
BOARD_SQUARES, BOARD_SQUARE_M = (5, 4), 0.05
"""The board on the arm: as in `deformscope calibrate camera` by default."""
TILT_DEG = 22.0
TOUCH_M, BALL_M = (5e-4, 5e-4, 2e-4), 3e-4
"""How far a person is off a corner along x, y and z, and a ball moves in its cone: deviations."""
PUSH_N, AIM_RAD = 3.0, np.radians(5.0)
LOAD_OFF_N, GAIN_SD = 0.015, 0.03
"""How far a person is off the load that a scale is to show, and of a sensor's gain: deviations."""
TAP_N, TAP_S = 4.0, 0.04


@dataclass(frozen=True, slots=True, eq=False)
class RandomizedRig:
    """True poses of things.

    placement: surface, arm and tip; R_tip_force: (3, 3) forces in the sensor's axes to the tip's; force_gain: the
    sensor's forces over the true forces
    T_surface_camera, T_ee_board: (4, 4) camera to surface frame, board to the arm's end"""

    placement: Placement
    R_tip_force: FloatArray
    T_surface_camera: FloatArray
    T_ee_board: FloatArray
    force_gain: float = 1.0

    @classmethod
    def draw(cls, number: int, tool: Tool, size_m: tuple[float, float], thickness_m: float) -> "RandomizedRig":
        """The rig that belongs to a seed. tool: the tool, whose radii are measured with a caliper and are exact"""
        random = np.random.default_rng([number, 0x81D])
        T = np.array(T_BASE_SURFACE)
        T[:3, :3] = Rotation.from_euler("zyx", random.uniform(-1, 1, 3) * (4.0, 0.7, 0.7), degrees=True).as_matrix()
        T[:3, 3] += random.uniform(-1, 1, 3) * (0.02, 0.02, 0.01)
        tilt = Rotation.from_rotvec(np.radians([*random.uniform(-1.5, 1.5, 2), 0.0]))
        length_m = random.uniform(0.09, 0.12)
        tip = transform(tilt.as_matrix(), tilt.apply([0.0, 0.0, length_m]))
        made = Tool(
            length_m=tool.length_m,
            radius_m=tool.radius_m,
            stick_radius_m=tool.stick_radius_m,
            T_ee_tip=tuple(tuple(map(float, row)) for row in tip),
        )
        turn = Rotation.from_euler("z", random.uniform(-180, 180), degrees=True).as_matrix()
        signs = np.diag([1.0, random.choice([-1.0, 1.0]), random.choice([-1.0, 1.0])])
        middle = np.array([size_m[0] / 2, size_m[1] / 2, thickness_m])
        camera = looking_at(
            middle, random.uniform(0.74, 0.82), random.uniform(42.0, 50.0), random.uniform(-97.0, -83.0)
        )
        camera[:3, :3] = camera[:3, :3] @ Rotation.from_rotvec(random.uniform(-0.04, 0.04, 3)).as_matrix()
        flat = Rotation.from_euler("x", 180, degrees=True) * Rotation.from_rotvec(random.uniform(-0.1, 0.1, 3))
        half = 0.5 * BOARD_SQUARE_M * np.array([*BOARD_SQUARES, 0.0])
        board = transform(flat.as_matrix(), [0.0, 0.0, random.uniform(0.03, 0.05)] - flat.apply(half))
        gain = float(np.exp(GAIN_SD * random.standard_normal()))
        return cls(Placement(T, made), turn @ signs, camera, board, gain)

    def sensed(self, force_n: FloatArray, time_s: float) -> FloatArray:
        """(3,) output of the sensor for a force (3,) in the tip's frame [N]."""
        return np.asarray(self.force_gain * self.R_tip_force.T @ force_n)


class BoardPicture:
    """A picture of the printed board, which is inserted into the camera's pictures."""

    def __init__(self) -> None:
        markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        board = cv2.aruco.CharucoBoard(BOARD_SQUARES, BOARD_SQUARE_M, 0.75 * BOARD_SQUARE_M, markers)
        square_px, margin_px = 60, 30
        size = (BOARD_SQUARES[0] * square_px + 2 * margin_px, BOARD_SQUARES[1] * square_px + 2 * margin_px)
        self._flat = np.asarray(board.generateImage(size, marginSize=margin_px, borderBits=1))
        step_m = BOARD_SQUARE_M / square_px
        self._onto_board = np.array(
            [[step_m, 0.0, -margin_px * step_m], [0.0, step_m, -margin_px * step_m], [0.0, 0.0, 1.0]]
        )

    def put_into(self, color: npt.NDArray[np.uint8], lens: Intrinsics, T_camera_board: FloatArray) -> None:
        """Draw the board over a picture (H, W, 3), in front of everything else."""
        if T_camera_board[2, 3] <= 0.1 or T_camera_board[2, 2] <= 0.1:  # behind the camera, or seen from behind
            return
        camera = np.array([[lens.fx_px, 0.0, lens.cx_px], [0.0, lens.fy_px, lens.cy_px], [0.0, 0.0, 1.0]])
        fine = 3  # drawn larger and then reduced, as a lens and its pixels average
        larger = np.diag([fine, fine, 1.0]) + np.array([[0, 0, 0.5 * (fine - 1)], [0, 0, 0.5 * (fine - 1)], [0, 0, 0]])
        onto = larger @ camera @ np.column_stack([T_camera_board[:3, :2], T_camera_board[:3, 3]]) @ self._onto_board
        height, width = color.shape[:2]
        drawn, there = (
            cv2.resize(
                cv2.warpPerspective(one, onto, (fine * width, fine * height), flags=cv2.INTER_LINEAR),
                (width, height),
                interpolation=cv2.INTER_AREA,
            ).astype(np.float64)
            for one in (self._flat, np.full_like(self._flat, 255))
        )
        share = (there / 255.0)[..., None]
        color[:] = np.rint(color * (1.0 - share) + drawn[..., None].clip(0, 255)).clip(0, 255)


class HandledTable(Protocol):
    """A simulated table with a person at it. body: the arm, which the person moves by hand"""

    @property
    def body(self) -> ArmBody: ...

    def push_tip(self, force_n: FloatArray) -> None:
        """From now on a finger pushes the tip, (3,) [N] in the surface frame; zero = not."""

    def show_board(self, there: bool) -> None:
        """Fix the board to the arm's end, or take it off."""


class SimulatedHand:
    """Carries out requests at a table, by their kind (`experiments.rig.rig_calibration`), with small errors.

    Raises InputError if the arm does not reach the requested pose."""

    def __init__(self, rig: RandomizedRig, table: HandledTable, size_m: tuple[float, float], seed: int = 0) -> None:
        self._rig, self._table, self._size_m = rig, table, size_m
        self._random = np.random.default_rng([seed, 0x9E6])
        self._parked = table.body.T_base_end_effector

    def do(self, kind: str, number: int, axis: tuple[float, float, float] | None) -> None:
        """Carry out a request to the operator immediately: a pose of the arm or of the board."""
        self._table.push_tip(np.zeros(3))
        self._table.show_board(kind == "view")
        match kind:
            case "corner":
                shares = ((0, 0), (1, 0), (0, 1), (1, 1))[number]
                center_m = np.append(np.array(shares) * self._size_m, self._rig.placement.tool.radius_m)
                self._stand(center_m + self._off(TOUCH_M), UP)
            case "tilt":
                turn = np.radians(60.0 * number + self._random.uniform(-10, 10))
                tilted = Rotation.from_rotvec(np.radians(TILT_DEG) * np.array([np.cos(turn), np.sin(turn), 0.0]))
                place_m = np.array([0.5 * self._size_m[0], 0.5 * self._size_m[1], 0.2])
                self._stand(place_m + self._off((BALL_M,) * 3), tilted.apply(UP))
            case "view":
                self._show(number)
            case "push":
                self._park()
                assert axis is not None
                wobble = Rotation.from_rotvec(AIM_RAD * self._random.standard_normal(3))
                self._table.push_tip(np.asarray(PUSH_N * self._random.uniform(0.8, 1.5) * wobble.apply(axis)))
            case "load":
                self._park()
                assert axis is not None
                off_n = LOAD_OFF_N * self._random.standard_normal()
                self._table.push_tip(np.add(axis, (0.0, 0.0, off_n)))
            case "tap":
                self._park()
            case _:
                self._park()

    def tap(self) -> None:
        """Begin one tap."""
        self._table.push_tip(np.array([0.0, 0.0, TAP_N * self._random.uniform(0.7, 1.3)]))

    def let_go(self) -> None:
        """And ends."""
        self._table.push_tip(np.zeros(3))

    def leave(self) -> None:
        """Put the arm back at its first place, and take the board off."""
        self._table.show_board(False)
        self._table.push_tip(np.zeros(3))
        self._park()

    def _off(self, sd_m: tuple[float, ...]) -> FloatArray:
        """(3,) a random error with these standard deviations [m]."""
        return np.asarray(np.array(sd_m) * self._random.standard_normal(3))

    def _park(self) -> None:
        self._reach(self._parked)

    def _stand(self, center_m: FloatArray, normal: FloatArray) -> None:
        """The tip's centre there, the stick along -normal, turned about it as the arm can."""
        T = self._rig.placement.T_base_ee(center_m, normal)
        center = T @ self._rig.placement.T_ee_center
        for spin_deg in (0.0, 40.0, -40.0, 80.0, -80.0, 130.0, -130.0, 180.0):
            turned = transform(Rotation.from_euler("z", spin_deg, degrees=True).as_matrix(), (0.0, 0.0, 0.0))
            if self._reach(center @ turned @ np.linalg.inv(center) @ T):
                return
        raise InputError("a place that the arm reaches", f"{center_m.round(3).tolist()} m", "another hidden number")

    def _reach(self, T_base_ee: FloatArray, starts: int = 12) -> bool:
        """Bring the arm's end by hand to a pose (4, 4) in the base frame [m]; whether it can be there."""
        body = self._table.body
        if isinstance(body, StandDouble):
            body.put(T_base_ee)
            return True
        if not isinstance(body, JacoDouble):
            raise TypeError(f"no arm that a person moves: {type(body).__name__}")
        found = body.chain.inverse(np.asarray(T_base_ee, np.float64), body.joints_deg, starts=starts, iterations=40)
        if found.converged:
            body.put(found.joints_deg)
        return found.converged

    def _show(self, number: int) -> None:
        """Hold the board before the camera, turned another way each time."""
        rig = self._rig
        T_base_camera = rig.placement.T_base_surface @ rig.T_surface_camera
        middle = 0.5 * BOARD_SQUARE_M * np.array([*BOARD_SQUARES, 0.0])
        for attempt in range(200):
            wide = 0.5 if attempt < 20 else np.pi  # where the arm cannot tilt it that way, another
            way = np.radians(60.0 * number) + self._random.uniform(-wide, wide)
            tilt = np.radians(self._random.uniform(18.0, 45.0))
            spin = self._random.uniform(-np.pi, np.pi)
            turn = Rotation.from_rotvec(tilt * np.array([np.cos(way), np.sin(way), 0.0])) * Rotation.from_euler(
                "z", spin
            )
            place_m = np.array([*self._random.uniform(-0.06, 0.06, 2), self._random.uniform(0.45, 0.75)])
            T_camera_board = transform(turn.as_matrix(), place_m - turn.apply(middle))
            if self._reach(T_base_camera @ T_camera_board @ np.linalg.inv(rig.T_ee_board), starts=3):
                return
        raise InputError("a view of the board that the arm reaches", "none in 200", "another hidden number")
