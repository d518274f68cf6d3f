"""A take of another laboratory's poked object, as pairs and a motion: meshes with forces, in the form of PokeFlex.

robot_data.json: a list of {"frame": 1, "forces": [x, y, z(, torques)]} [N]; meshes/mesh-f00001.obj: one for each frame,
with the same vertices [mm], z up; CAMERA/camera_parameters.json: intrinsics and extrinsics, of a Kinect
color_intrinsics..."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.file_io import read_file

MESH = re.compile(r"mesh-f(\d{1,9})\.obj$")
MM = 1e-3
FARTHEST_MM, MOST_N = 1e6, 1e6
STANDS = 0.05
"""Share of the height, from below, whose particles rest on the table."""
TOUCHED, PRESSED_M = 0.8, 1e-3
"""A tool holds particles that moved by this share of the largest displacement, or more, if that is this large [m]."""


Three: TypeAlias = tuple[float, float, float]
Four: TypeAlias = tuple[float, float, float, float]


class _Reading(msgspec.Struct):
    frame: Annotated[int, msgspec.Meta(ge=-(10**9), le=10**9)]
    forces: list[float]

    def __post_init__(self) -> None:
        if len(self.forces) not in (3, 6) or any(abs(one) > MOST_N for one in self.forces):
            raise ValueError(f"forces {self.forces}")


class _Camera(msgspec.Struct):
    intrinsics: tuple[Three, Three, Three]
    extrinsics: tuple[Four, Four, Four, Four]


class _Kinect(msgspec.Struct, rename=lambda name: f"color_{name}"):
    intrinsics: tuple[Three, Three, Three]
    extrinsics: tuple[Four, Four, Four, Four]


@dataclass(frozen=True, slots=True)
class MeshTake:
    """rest: (K, 3) particles of the first frame, before any load [m]; position: (T, K, 3) positions in each later frame
    frames: (T,) their numbers; force_n: (T, 3) change of the force since the first frame; cameras: intrinsics and
    extrinsics as the files have them, by folder"""

    rest: FloatArray
    position: FloatArray
    frames: IntArray
    force_n: FloatArray
    cameras: Mapping[str, Mapping[str, Any]]

    @property
    def stands(self) -> BoolArray:
        """(K,) particles that rest on the table."""
        z = self.rest[:, 2]
        return np.asarray(z <= z.min() + STANDS * np.ptp(z))

    @property
    def touched(self) -> BoolArray:
        """(T, K) particles that the tool holds in each frame."""
        moved = np.linalg.norm(self.position - self.rest, axis=2)
        least = np.maximum(TOUCHED * moved.max(axis=1, keepdims=True), PRESSED_M)
        return np.asarray((moved >= least) & ~self.stands)

    def pair(self, at: int) -> bytes:
        """A frame as a pair file."""
        held, contact = self.stands | self.touched[at], np.flatnonzero(self.touched[at])
        force = float(np.linalg.norm(self.force_n[at]))
        return _npz(rest=self.rest, deformed=self.position[at], held=held, contact=contact, force_n=force)

    def motion(self, unseen: IntArray) -> bytes:
        """All frames as a motion file. unseen: indices of frames in which only held positions are known"""
        held, motion = self.stands | self.touched, self.position.copy()
        motion[unseen] = np.where(held[unseen, :, None], motion[unseen], np.nan)
        return _npz(rest=self.rest, motion=motion, held=held, frame=self.frames)


def read_take(folder: Path, particles: int) -> MeshTake:
    """Raises InputError for missing or unusual files. particles: at most, spread evenly over the mesh"""
    data = _read(folder / "robot_data.json", {"a list of frame and forces (three or six numbers)": list[_Reading]})
    forces = {one.frame: one.forces[:3] for one in data}
    found = {int(name[1]): one for one in folder.glob("meshes/*.obj") if (name := MESH.match(one.name))}
    frames = np.array(sorted(forces.keys() & found.keys()), np.int64)
    if len(frames) < 2:
        came = f"{len(found)} meshes, {len(forces)} forces, {len(frames)} of them of one frame"
        raise InputError("meshes/mesh-f00001.obj and on, with a force each", came, where=folder)
    rest = _vertices(found[frames[0]])
    # each the farthest from those before (Gonzalez 1985)
    farthest, away = [0], np.linalg.norm(rest - rest[0], axis=1)
    while len(farthest) < particles and away.max() > 0.0:
        farthest.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(rest - rest[farthest[-1]], axis=1))
    chosen = np.array(sorted(farthest), np.int64)
    position = np.empty((len(frames) - 1, len(chosen), 3))
    for at, frame in enumerate(frames[1:]):
        if len(vertices := _vertices(found[frame])) != len(rest):
            came = f"{len(vertices)} where {found[frames[0]].name} has {len(rest)}"
            raise InputError("meshes with the same vertices", came, "register them to one template", found[frame])
        position[at] = vertices[chosen]
    force_n = np.array([forces[frame] for frame in frames])
    kinds = {"intrinsics (3, 3) and extrinsics (4, 4)": _Camera, "color_intrinsics and color_extrinsics": _Kinect}
    cameras = {
        one.parent.name: msgspec.structs.asdict(_read(one, kinds))
        for one in sorted(folder.glob("*/camera_parameters.json"))
    }
    return MeshTake(rest[chosen], position, frames[1:], force_n[1:] - force_n[0], cameras)


def _read(path: Path, kinds: Mapping[str, Any]) -> Any:
    """A JSON file as the first of these kinds that it is; each by its words."""
    raw, came = read_file(path, path.name), ""
    for kind in kinds.values():
        try:
            return msgspec.json.decode(raw, type=kind)
        except (msgspec.DecodeError, RecursionError) as error:
            came = came or " ".join(str(error).split())
    raise InputError(f"{' or '.join(kinds)} in JSON", came, where=path)


def _vertices(path: Path) -> FloatArray:
    """(n, 3) [m]."""
    rows = [line.split()[1:4] for line in read_file(path, "a mesh").splitlines() if line.startswith(b"v ")]
    try:
        found = np.array(rows, dtype=np.float64)
    except ValueError:
        found = np.zeros(0)
    if found.ndim != 2 or found.shape[1] != 3 or not np.abs(found).max(initial=0.0) <= FARTHEST_MM:
        raise InputError("a mesh with vertices (v x y z)", f"none, or not within {FARTHEST_MM:g} mm of 0", where=path)
    return found * MM


def _npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()
