"""`python -m studies takes`: pairs and a motion of another laboratory's poked object, from meshes with forces.

python -m studies takes --take FoamDice/take1 --pairs dice

In the form of PokeFlex:

robot_data.json: a list of {"frame": 1, "forces": [x, y, z(, torques)]} [N]; meshes/mesh-f00001.obj: one for each frame,
with the same vertices [mm]; CAMERA/camera_parameters.json or CAMERA/NUMBER/...: intrinsics and extrinsics, of a Kinect
color_intrinsics..."""

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.file_io import read_file, refusal
from deformscope.files.motions import parse_motion
from deformscope.files.pairs import parse_pair
from deformscope.pictures.report import Table
from deformscope.plain import plain
from studies.runner import Study, StudyOptions, StudyReport

MESH = re.compile(r"mesh-f(\d{1,9})\.obj$")
MM = 1e-3
FARTHEST_MM, MOST_N = 1e6, 1e6
STANDS = 0.05
"""Share of the height, from below, whose particles rest on the table."""
STILL, ALONG, FREE = 0.1, 0.8, 0.1
"""A face stays that moves by at most this share of the largest displacement; a force is along an axis with this share
of it; a frame is free of load up to this share of the largest change of the force."""
UP = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}
TOUCHED, PRESSED_M = 0.8, 1e-3
"""A tool holds particles that moved by this share of the largest displacement, or more, if that is this large [m]."""


class _Reading(msgspec.Struct):
    frame: Annotated[int, msgspec.Meta(ge=-(10**9), le=10**9)]
    forces: list[float]

    def __post_init__(self) -> None:
        if len(self.forces) not in (3, 6) or any(abs(one) > MOST_N for one in self.forces):
            raise ValueError(f"forces {self.forces}")


@dataclass(frozen=True, slots=True)
class MeshTake:
    """rest: (K, 3) particles of the frame without load [m]; position: (T, K, 3) positions in each other frame
    frames: (T,) their numbers; rest_frame: number of that frame; force_n: (T, 3) change of the force since it; up: key
    of `UP`; cameras: intrinsics and extrinsics as the files have them, by folder"""

    rest: FloatArray
    position: FloatArray
    frames: IntArray
    rest_frame: int
    force_n: FloatArray
    up: str
    cameras: Mapping[str, Mapping[str, Any]]

    @property
    def stands(self) -> BoolArray:
        """(K,) particles that rest on the table."""
        return _lowest(self.rest, self.up)

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


def read_take(folder: Path, particles: int, up: str | None = None, at_rest: int | None = None) -> MeshTake:
    """Raises InputError for missing or unusual files. particles: at most, spread evenly over the mesh
    up, at_rest: a key of `UP` and the number of the frame without load, None = as motion and forces say"""
    data = _read(folder / "robot_data.json", {"a list of frame and forces (three or six numbers)": list[_Reading]})
    forces = {one.frame: one.forces[:3] for one in data}
    found = {int(name[1]): one for one in folder.glob("meshes/*.obj") if (name := MESH.match(one.name))}
    frames = np.array(sorted(forces.keys() & found.keys()), np.int64)
    if len(frames) < 2:
        came = f"{len(found)} meshes, {len(forces)} forces, {len(frames)} of them of one frame"
        raise InputError("meshes/mesh-f00001.obj and on, with a force each", came, where=folder)
    force_n = np.array([forces[frame] for frame in frames])
    still = _without_load(frames, force_n, at_rest, folder)
    rest = _vertices(found[frames[still]])
    # each the farthest from those before (Gonzalez 1985)
    farthest, away = [0], np.linalg.norm(rest - rest[0], axis=1)
    while len(farthest) < particles and away.max() > 0.0:
        farthest.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(rest - rest[farthest[-1]], axis=1))
    chosen = np.array(sorted(farthest), np.int64)
    others = np.delete(np.arange(len(frames)), still)
    position = np.empty((len(others), len(chosen), 3))
    for at, frame in enumerate(frames[others]):
        if len(vertices := _vertices(found[frame])) != len(rest):
            came = f"{len(vertices)} where {found[frames[still]].name} has {len(rest)}"
            raise InputError("meshes with the same vertices", came, "register them to one template", found[frame])
        position[at] = vertices[chosen]
    files = [*folder.glob("*/camera_parameters.json"), *folder.glob("*/*/camera_parameters.json")]
    cameras = {one.parent.relative_to(folder).as_posix(): _camera(one) for one in sorted(files)}
    more_n = force_n[others] - force_n[still]
    up = up or _up(rest[chosen], position, more_n, folder)
    return MeshTake(rest[chosen], position, frames[others], int(frames[still]), more_n, up, cameras)


def _without_load(frames: IntArray, force_n: FloatArray, at_rest: int | None, folder: Path) -> int:
    """Index of the frame without load: the first, if its force (T, 3) is about the least of the take."""
    if at_rest is not None:
        if at_rest not in frames:
            raise InputError(
                "--rest FRAME with a mesh and a force", str(at_rest), f"{frames[0]} to {frames[-1]}", folder
            )
        return int(np.flatnonzero(frames == at_rest)[0])
    size_n = np.linalg.norm(force_n, axis=1)
    least = int(np.argmin(size_n))
    free_n = FREE * float(np.linalg.norm(force_n - force_n[least], axis=1).max())
    if size_n[0] <= size_n[least] + free_n:
        return 0
    if size_n[least] > free_n:
        came = f"{size_n[0]:.3g} N in frame {frames[0]}, and {size_n[least]:.3g} N at least, in frame {frames[least]}"
        raise InputError("a frame without load", came, "--rest FRAME, the frame before any touch", folder)
    return least


def _up(rest: FloatArray, position: FloatArray, force_n: FloatArray, folder: Path) -> str:
    """The axis that is up (a key of `UP`): of the face on the table, which stays, to where the tool presses; z if
    nothing moves. rest: (K, 3); position: (T, K, 3); force_n: (T, 3)"""
    moved = np.linalg.norm(position - rest, axis=2)
    most = int(np.argmax(moved.max(axis=1)))
    if (largest := moved[most].max()) < PRESSED_M:
        return "z"
    middle, way = rest[moved[most] >= TOUCHED * largest].mean(axis=0) - rest.mean(axis=0), force_n[most]
    stay = [up for up in UP if np.quantile(moved[most][_lowest(rest, up)], 0.95) <= STILL * largest]
    along = [
        up for up in stay if abs(way @ UP[up]) >= ALONG * np.linalg.norm(way) > 0.0 and middle @ np.array(UP[up]) > 0.0
    ]
    if len(stay) == 1 or along == ["z"]:
        return stay[0] if len(stay) == 1 else "z"
    came = f"{'faces below along ' + ', '.join(stay) if stay else 'none'} that stay while the tool presses"
    raise InputError("one face that stays, on the table", came, f"--up={' or --up='.join(along or stay or UP)}", folder)


def _lowest(rest: FloatArray, up: str) -> BoolArray:
    """(K,) particles that rest on the table."""
    height = rest @ np.array(UP[up], np.float64)
    return np.asarray(height <= height.min() + STANDS * np.ptp(height))


def _camera(path: Path) -> dict[str, Any]:
    """Intrinsics and extrinsics of a camera's file, of its colour images where it has others too."""
    found = _read(path, {"intrinsics (3, 3) and extrinsics (4, 4), or color_intrinsics and color_extrinsics": dict})
    camera = {}
    for name, shape in (("intrinsics", (3, 3)), ("extrinsics", (4, 4))):
        value = found.get(f"color_{name}", found.get(name))
        value = value[0] if isinstance(value, list) and len(value) == 1 else value
        try:
            whole = np.array(value, np.float64).shape == shape
        except (TypeError, ValueError):
            whole = False
        if not whole:
            came = f"none, but {', '.join(map(repr, found))}" if value is None else "another shape"
            raise InputError(f"{name} {shape} or color_{name}", came, where=path)
        camera[name] = value
    return camera


def _read(path: Path, kinds: Mapping[str, Any]) -> Any:
    """A JSON file as the first of these kinds that it is; each by its words."""
    raw, came = read_file(path, path.name), ""
    for kind in kinds.values():
        try:
            return msgspec.json.decode(raw, type=kind, strict=False)
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


@dataclass(frozen=True, slots=True)
class TakesConfig(StudyOptions):
    """Write a take's frames as pair files and a motion file into a new folder."""

    take: Annotated[Path, flags.one_word("FOLDER", Path)] = Path()
    """Folder of meshes with forces (PokeFlex)."""
    pairs: Annotated[Path, flags.one_word("FOLDER", Path)] = Path("runs/take")
    """New folder for the files."""
    unseen: Annotated[int, flags.least(2)] = 4
    """Every n-th frame is left out of the motion, for tests."""
    particles: Annotated[int, flags.least(8)] = 300
    """Largest number of vertices per mesh, spread evenly."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    """Axis of the meshes that is up; default: from the face that stays to the tool."""
    rest: flags.CountFlag = None
    """Number of the frame before any touch; default: the first, or that of the least force."""


def report(options: TakesConfig, seconds: float) -> StudyReport:
    """The files. Raises InputError for errors of the take; then no file remains."""
    source, folder = options.take, options.pairs
    take = read_take(source, options.particles, options.up, options.rest)
    pressed = np.flatnonzero(take.touched.any(axis=1))
    if not pressed.size:
        came = f"none, with {take.up} up and frame {take.rest_frame} at rest"
        raise InputError("a frame in which a part above the table moved by 1 mm", came, "--up, --rest", source)
    unseen = pressed[options.unseen - 1 :: options.unseen]
    kinds = {int(at): "unseen" if at in unseen else "pair" for at in pressed}
    files = {f"{kind}-{take.frames[at]:05}.npz": take.pair(at) for at, kind in kinds.items()}
    for name, raw in files.items():
        parse_pair(raw, f"{source}, {name}")
    files["motion.npz"] = take.motion(unseen)
    parse_motion(files["motion.npz"], source)
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise InputError("a new folder for --pairs", refusal(error), where=folder) from error
    counts = [f"{len(pressed) - len(unseen)} pairs", f"{len(unseen)} unseen", f"a motion of {len(take.frames)} frames"]
    found = {"source": source, "files": [str(folder / one) for one in files], "cameras": take.cameras}
    found |= {"up": take.up, "rest_frame": take.rest_frame}
    rows = [("written", ", ".join(counts)), ("up, at rest", f"{take.up}, in frame {take.rest_frame}")]
    rows += [("cameras", ", ".join(take.cameras) or "none"), ("folder", str(folder))]
    table = Table(rows, caption=str(source))
    return StudyReport([table], plain(found), files={folder / name: raw for name, raw in files.items()})


STUDY = Study(TakesConfig, lambda options: [], report)
