"""Triangle meshes from files, read by Open3D in a separate process: damaged bytes can crash its readers.

python -m deformscope.robot.mesh_files whole|coarse FILE...    two arrays of each file (`numpy.save`) on stdout"""

import io
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError

Mesh = tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]

MESH_BYTES = 50_000_000
"""Largest mesh file: a million triangles of a binary STL (50 bytes each). Larger files are refused before they are
read, which bounds the time and memory that a file from anywhere takes."""
TRIANGLES = 2000
"""Most triangles of one mesh: finer ones are made coarser, as they are recorded with every session. An arm's link then
has an error below 1 mm; fewer triangles have a larger one, more make every recording larger."""
MESH_ENDINGS = (".stl", ".obj", ".ply", ".off", ".glb")
FARTHEST = 1e6
"""Largest distance of a vertex from the origin along an axis, in the file's unit: a kilometre in millimetres. Largest
coordinate of a mesh: no robot reaches it, so a file beyond is damaged."""
TIMEOUT_S, MEMORY_BYTES = 120.0, 8 << 30
"""Time and memory of the process that reads: more than any file of the allowed size takes. A hostile file ends it
there, and not the machine's memory or a person's patience."""


def read_meshes(paths: Sequence[Path], *, coarse: bool = True) -> list[Mesh]:
    """Vertices (n, 3), in the file's unit, and triangles (m, 3) of each mesh file. InputError names a wrong one.
    coarse: vertices at one place become one, and at most TRIANGLES are left; else all is as in the file"""
    for path in paths:
        if path.suffix.lower() not in MESH_ENDINGS:
            raise InputError(f"a mesh file: {', '.join(MESH_ENDINGS)}", path.suffix or "no ending", "convert it", path)
        if not path.is_file() or path.stat().st_size > MESH_BYTES:
            came = "a larger one" if path.is_file() else "no file"
            raise InputError(f"a mesh file of up to {MESH_BYTES // 1_000_000} MB", came, where=path)
    if not paths:
        return []
    command = [sys.executable, "-m", __name__, "coarse" if coarse else "whole", *map(str, paths)]
    done = None
    try:
        done = subprocess.run(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=TIMEOUT_S, check=False
        )
        arrays = io.BytesIO(done.stdout)
        ending = signal.Signals(-done.returncode).name if done.returncode < 0 else f"status {done.returncode}"
    except subprocess.TimeoutExpired as error:
        arrays, ending = io.BytesIO(error.stdout or b""), f"{TIMEOUT_S:g} s"
    meshes = []
    for path in paths:
        try:
            vertices, triangles = (np.load(arrays, allow_pickle=False) for _ in range(2))
        except (EOFError, OSError, ValueError) as error:
            came = f"one that ended its reader ({ending})"
            raise InputError("a complete mesh file", came, "export it again", path) from error
        if refused := _refusal(vertices, triangles):
            raise InputError(refused, "none, or others", "export it again", path)
        meshes.append((vertices, triangles))
    return meshes


def _refusal(vertices: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]) -> str:
    """Why an array is no mesh: the expectation; empty if it is one."""
    if not len(triangles) or not 0 <= triangles.min() <= triangles.max() < len(vertices):
        return "a mesh with triangles of its vertices"
    if not np.abs(vertices).max() <= FARTHEST:  # nor where one is no number
        return f"a mesh with vertices within {FARTHEST:g} of the origin"
    return ""


def _write(path: str, out: BinaryIO, *, coarse: bool) -> None:
    import open3d as o3d

    mesh = o3d.io.read_triangle_mesh(Path(path))
    if coarse and not _refusal(np.asarray(mesh.vertices), np.asarray(mesh.triangles)):
        mesh.merge_close_vertices(1e-7)
        if len(mesh.triangles) > TRIANGLES:
            mesh = mesh.simplify_quadric_decimation(TRIANGLES)
    arrays = io.BytesIO()  # `numpy.save` cannot write to a pipe
    for array in (mesh.vertices, mesh.triangles):
        np.save(arrays, np.asarray(array))
    out.write(arrays.getvalue())
    out.flush()


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # nothing is shown here, and the import of its windows takes half of the time
    sys.modules["open3d.visualization"] = ModuleType("open3d.visualization")
    with os.fdopen(os.dup(1), "wb") as stdout:
        os.dup2(2, 1)  # Open3D prints its warnings there
        for file in sys.argv[2:]:
            _write(file, stdout, coarse=sys.argv[1] == "coarse")
