"""View of a depth camera on a container on its table, with its dent, and on the hand that squeezes it.

The world is the hand's frame. The wall is the mesh of the shell's nodes, displaced along its normals; links of the
fingers are capsules with the surface of their pads. The camera sees the side at +x, with the pressing finger, from a
metre away (thesis 5.1), from above and from beyond the fingertips. Not modelled: shadows of the camera's projector
around the fingers, a pixel wide on the wall."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.lab import ray_camera
from deformscope.lab.container_constants import PAD_OFFSET_M
from deformscope.lab.container_shell import ContainerShape
from deformscope.lab.container_world import hand_from_container
from deformscope.solid import Capsule
from deformscope_drivers.sdh.kinematics import FINGERS, finger_points

CAMERA = ray_camera.DepthViewConfig(distance_m=1.0, elevation_deg=20.0, azimuth_deg=-20.0)
"""Pose of the camera relative to the container's axes, in its unturned pose in the hand."""
PALM_RADIUS_M, PALM_BACK_M = 0.045, 0.10
PALM = Capsule(np.array([0.0, 0.0, -PALM_BACK_M]), np.array([0.0, 0.0, -PALM_RADIUS_M]), PALM_RADIUS_M)
TABLE_M = 0.8
AROUND_PX = 3.0
FINER = 3
"""Number of flat facets between two nodes of the shell, on the true form."""


def camera_pose(config: ray_camera.DepthViewConfig = CAMERA) -> FloatArray:
    """(4, 4) camera to hand [m], where a container in a level hand is seen well; the same in every trial."""
    looking = ray_camera.looking_at(np.zeros(3), config.distance_m, config.elevation_deg, config.azimuth_deg)
    return np.asarray(hand_from_container() @ looking)


class ContainerView(ray_camera.RayCamera):
    """A camera in front of a container in the hand.

    shape: shape of the container"""

    def __init__(
        self,
        shape: ContainerShape,
        nodes_m: tuple[FloatArray, FloatArray],
        T_hand_container: FloatArray,
        config: ray_camera.DepthViewConfig = CAMERA,
        T_world_camera: FloatArray | None = None,
    ) -> None:
        """nodes_m: along s and z, at which `render` is given displacements; T_hand_container: (4, 4) container's pose
        before, on its table; the camera is at its `camera_pose` for any container

        T_world_camera: (4, 4) pose of a camera in another frame, in which hand and container then are: an arm moves
        them"""
        super().__init__(config, camera_pose(config) if T_world_camera is None else T_world_camera)
        self.shape = shape
        around_m = np.append(nodes_m[0], nodes_m[0][0] + shape.perimeter_m)
        fine = [_between(nodes, FINER) for nodes in (around_m, nodes_m[1])]
        self._upsample = [
            np.array([np.interp(places, nodes, one) for one in np.eye(len(nodes))]) for places, nodes in fine
        ]
        s_m, z_m = np.meshgrid(fine[0][0][:-1], fine[1][0], indexing="ij")
        self._points, self._normals = (array.reshape(-1, 3) for array in shape.place(s_m, z_m))
        self._rows = s_m.shape[1]
        around = np.arange(s_m.size).reshape(s_m.shape)
        wall = np.vstack([around, around[:1]])
        number = wall.ravel()[ray_camera.grid_triangles(*wall.shape)]
        high = around[:, -1]
        lid = np.column_stack([high, np.roll(high, -1), np.full(len(high), s_m.size)])
        self._triangles = np.concatenate([number, lid]).astype(np.uint32)
        corner = TABLE_M * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
        corner[:, 2] = -shape.half_m[2]
        corners = corner @ T_hand_container[:3, :3].T + T_hand_container[:3, 3]
        whole = (slice(None), slice(None))
        depth, facing, _ = self.hits([(corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))], whole)
        seen = np.where(np.isnan(depth), ray_camera.NOTHING, ray_camera.TABLE).astype(np.uint8)
        if T_world_camera is None:
            self.cover(PALM, depth, seen, facing)
        self._still = ray_camera.Rendered(depth, _colors(seen, facing), seen, facing)

    def mesh(self, inward_m: FloatArray) -> tuple[FloatArray, npt.NDArray[np.uint32]]:
        """Vertices (n, 3) of the container in its own frame, and its triangles. inward_m: (nodes along s, along z)"""
        around = np.concatenate([inward_m, inward_m[:1]])
        finer = (self._upsample[0].T @ around @ self._upsample[1])[:-1]
        wall = self._points - finer.reshape(-1, 1) * self._normals
        high = wall[self._rows - 1 :: self._rows]
        return np.vstack([wall, high.mean(axis=0)]), self._triangles

    def render(
        self,
        inward_m: FloatArray,
        T_hand_container: FloatArray,
        position_deg: npt.NDArray[np.float64],
        robot: Sequence[Capsule] | None = None,
    ) -> ray_camera.Rendered:
        """The exact picture. inward_m: (nodes along s, along z) displacement of the wall; position_deg: (7,) position
        of the hand; robot: visible parts of the robot, None = the fingers of a hand, in the hand's frame"""
        still = self._still
        depth, seen, facing = still.depth_m.copy(), still.seen.copy(), still.facing.copy()
        vertex, triangle = self.mesh(inward_m)
        placed = vertex @ T_hand_container[:3, :3].T + T_hand_container[:3, 3]
        part = self.part(self.pixels(placed), AROUND_PX)
        own, cosine, _ = self.hits([(placed, triangle)], part)
        nearer = own < np.where(np.isnan(depth[part]), np.inf, depth[part])
        for whole, value in (
            (depth, own),
            (seen, np.full(own.shape, ray_camera.CONTAINER, np.uint8)),
            (facing, cosine),
        ):
            whole[part] = np.where(nearer, value, whole[part])
        capsules = finger_capsules(position_deg) if robot is None else robot
        for capsule in capsules:
            self.cover(capsule, depth, seen, facing)
        color = still.color.copy()
        for window in (part, *(self.window(capsule) for capsule in capsules)):
            color[window] = _colors(seen[window], facing[window])
        return ray_camera.Rendered(depth, color, seen, facing)


def _colors(seen: npt.NDArray[np.uint8], facing: FloatArray) -> npt.NDArray[np.uint8]:
    """(..., 3) RGB, lit along the view."""
    return np.rint(ray_camera.COLOR[seen] * (0.35 + 0.65 * np.abs(facing))[..., None]).astype(np.uint8)


def finger_capsules(position_deg: npt.NDArray[np.float64]) -> list[Capsule]:
    """The links of the three fingers in the hand frame [m], as wide as their pads are far from their axes.
    position_deg: (7,) position of the joints"""
    capsules = []
    for finger in range(len(FINGERS)):
        base, middle, tip = finger_points(position_deg, finger)
        end = tip + (middle - tip) * (PAD_OFFSET_M / np.linalg.norm(tip - middle))  # the rounded tip ends where it does
        capsules += [Capsule(base, middle, PAD_OFFSET_M), Capsule(middle, end, PAD_OFFSET_M)]
    return capsules


def _between(nodes_m: FloatArray, parts: int) -> tuple[FloatArray, FloatArray]:
    """Nodes with this number of equal parts between two of them; the nodes."""
    number = np.arange(parts * (len(nodes_m) - 1) + 1) / parts
    return np.interp(number, np.arange(len(nodes_m)), nodes_m), nodes_m
