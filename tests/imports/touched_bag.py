"""A bag of another robot that poked foam, by a contact law of its own: nothing of what is fitted to it is used here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

SIZE_M, THICKNESS_M = (0.24, 0.16), 0.05
CORNER_M = (0.35, -0.1, 0.02)
"""The surface's corner in the robot's base frame; axes are the base's."""
RADIUS_M, LENGTH_M = 0.01, 0.12
COMPLIANCE = 2e-4
"""The tip stays so far behind where the arm says it is [m/N]."""
SET_N = 3.0
HEIGHT_M, FOCAL_PX, PIXELS = 0.55, 120.0, (72, 96)
"""The camera looks straight down from above the middle of the surface."""
WRENCH_HZ, ARM_HZ, DEPTH_HZ = 100, 50, 2
UP_M = 0.015
"""So high the ball crosses the surface."""
TIP = np.diag([1.0, -1.0, -1.0])
"""Axes of the arm's end in the base: its z points down."""
START_NS = 1_700_000_000 * 10**9


def stiffness_n_per_mm(x_m: float) -> float:
    """Force over dent at the set force: two foams, side by side."""
    return 0.6 if x_m < 0.5 * SIZE_M[0] else 1.5


def force_of(dent_m: Any, x_m: float) -> Any:
    """Of a ball in a half-space (Hertz)."""
    at_set = 1e-3 * SET_N / stiffness_n_per_mm(x_m)
    return SET_N * (np.maximum(dent_m, 0.0) / at_set) ** 1.5


@dataclass(frozen=True)
class Moments:
    """t (n,) [s]; place (n, 2), dent (n,) [m] of the ball below the surface, force (n,) [N]."""

    t: Any
    place: Any
    dent: Any
    force: Any

    @classmethod
    def of(cls, places_m: list[tuple[float, float]]) -> Moments:
        """Down at 8 mm/s from above, still for a second, up, across: one place after the other."""
        place, dent, force = [], [], []
        parked = np.full(1000, -UP_M)
        place.append(np.tile((0.0, 0.0), (1000, 1)))  # beside the surface, out of the picture
        dent.append(parked)
        force.append(np.zeros(1000))
        before = np.zeros(2)
        for x, y in places_m:
            fine = np.linspace(0.0, 0.02, 20001)
            reported = fine + COMPLIANCE * force_of(fine, x)
            deep = float(np.interp(1.05 * SET_N, force_of(fine, x), reported))
            down = np.arange(-UP_M, deep, 8e-6)
            way = np.concatenate([np.full(800, -UP_M), down, np.full(1000, deep), down[::-1], np.full(500, -UP_M)])
            true = np.where(way > 0.0, np.interp(way, reported, fine), way)
            place.append(before + np.clip(np.arange(len(way)) / 700, 0.0, 1.0)[:, None] * (np.array([x, y]) - before))
            before = np.array([x, y])
            dent.append(way)
            force.append(force_of(true, x))
        count = sum(map(len, dent))
        return cls(np.arange(count) * 1e-3, np.concatenate(place), np.concatenate(dent), np.concatenate(force))


def depth_image(dent_m: float, place_m: Any, rng: np.random.Generator) -> Any:
    """(rows, columns) uint16 [mm] of the surface on its table, dented by a ball."""
    rows, columns = PIXELS
    v, u = np.mgrid[:rows, :columns]
    ray = np.stack([(u - 0.5 * columns) / FOCAL_PX, (v - 0.5 * rows) / FOCAL_PX])
    top = HEIGHT_M - THICKNESS_M
    x, y = 0.5 * SIZE_M[0] + ray[0] * top, 0.5 * SIZE_M[1] - ray[1] * top
    foam = (x > 0) & (x < SIZE_M[0]) & (y > 0) & (y < SIZE_M[1])
    away = np.hypot(x - place_m[0], y - place_m[1])
    dent = np.maximum(dent_m, 0.0) / (1.0 + (away / RADIUS_M) ** 2)
    depth = np.where(foam, top + dent, HEIGHT_M) + rng.normal(0.0, 5e-4, foam.shape)
    return np.rint(1e3 * depth).astype(np.uint16)


def write_touched_bag(path: Path, places_m: list[tuple[float, float]], seed: int = 0) -> Path:
    """With the sensor's force as what is done to the tip, a bias, noise, and positions that scatter."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    rng, store = np.random.default_rng(seed), get_typestore(Stores.ROS2_HUMBLE)
    types: Any = store.types
    kinds = {
        "/ft/wrench": "geometry_msgs/msg/WrenchStamped",
        "/joint_states": "sensor_msgs/msg/JointState",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/cam/depth": "sensor_msgs/msg/Image",
    }
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    moments = Moments.of(places_m)

    def header(ns: int, frame: str) -> Any:
        return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9), frame)

    def at_end_m(at: int) -> Any:
        x, y = moments.place[at]
        z = THICKNESS_M - moments.dent[at] + LENGTH_M
        return np.array([x, y, z]) + CORNER_M + rng.normal(0.0, 3e-5, 3)

    def messages(at: int) -> Any:
        ns = START_NS + at * 10**6
        if at % (1000 // ARM_HZ) == 0:
            there = types["geometry_msgs/msg/Transform"](vector(*at_end_m(at)), quaternion(1.0, 0.0, 0.0, 0.0))
            link = types["geometry_msgs/msg/TransformStamped"](header(ns, "base"), "tool0", there)
            yield "/tf", types[kinds["/tf"]]([link])
            yield "/joint_states", types[kinds["/joint_states"]](header(ns, ""), ["a"], *([np.zeros(1)] * 3))
        if at % (1000 // WRENCH_HZ) == 0:
            felt = np.array([0.3, -0.2, 1.1 - moments.force[at]]) + rng.normal(0.0, 0.02, 3)
            wrench = types["geometry_msgs/msg/Wrench"](vector(*felt), vector(0.0, 0.0, 0.0))
            yield "/ft/wrench", types[kinds["/ft/wrench"]](header(ns, "ft"), wrench)
        if at % (1000 // DEPTH_HZ) == 0:
            image = depth_image(moments.dent[at], moments.place[at], rng)
            data = image.view(np.uint8).ravel()
            rows, columns = image.shape
            yield (
                "/cam/depth",
                types[kinds["/cam/depth"]](header(ns, "cam"), rows, columns, "16UC1", 0, 2 * columns, data),
            )

    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        topics = {topic: bag.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for at in range(len(moments.t)):
            for topic, message in messages(at):
                bag.write(topics[topic], START_NS + at * 10**6, store.serialize_cdr(message, kinds[topic]))
    return path


GEOMETRY = f"""
[tool]
length_m = {LENGTH_M}
radius_m = {RADIUS_M}
compliance_m_per_n = {COMPLIANCE}
compliance_sd = 2e-5
R_tip_force = [[-1, 0, 0], [0, -1, 0], [0, 0, -1]]

[surface]
size_m = [{SIZE_M[0]}, {SIZE_M[1]}]
thickness_m = {THICKNESS_M}
T_arm_surface = [[1, 0, 0, {CORNER_M[0]}], [0, 1, 0, {CORNER_M[1]}], [0, 0, 1, {CORNER_M[2]}], [0, 0, 0, 1]]

[camera]
focal_px = [{FOCAL_PX}, {FOCAL_PX}]
center_px = [{PIXELS[1] / 2}, {PIXELS[0] / 2}]
T_arm_camera = [
    [1, 0, 0, {CORNER_M[0] + SIZE_M[0] / 2}],
    [0, -1, 0, {CORNER_M[1] + SIZE_M[1] / 2}],
    [0, 0, -1, {CORNER_M[2] + HEIGHT_M}],
    [0, 0, 0, 1],
]
"""
"""What the bag does not say: where things are, and what the robot poked with."""
