"""Mesh files of others: whatever is in one, the process goes on, with a mesh or with one clear error."""

import json
import struct
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from deformscope.errors import InputError
from deformscope.experiments.squeeze.tracking import container_model
from deformscope.rig.sections import ContainerSection
from deformscope.robot import mesh_files
from deformscope.robot.mesh_files import MESH_ENDINGS, Mesh, read_meshes
from tests.cases import slow_but

MUTATIONS = 40
"""Of each kind of file."""


def written(path: Path) -> Path:
    """A cube of 10; as `.glb`, which Open3D does not read as it writes it, a triangle."""
    if path.suffix == ".glb":
        path.write_bytes(glb())
        return path
    cube = o3d.geometry.TriangleMesh.create_box(10.0, 10.0, 10.0).compute_triangle_normals()
    assert o3d.io.write_triangle_mesh(path, cube)
    return path


def glb() -> bytes:
    """A triangle of 10, as glTF 2.0 has it in one file."""
    body = np.array([0, 0, 0, 10, 0, 0, 0, 10, 0], "<f4").tobytes() + np.array([0, 1, 2], "<u4").tobytes()
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}]
    points = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [10, 10, 0]}
    corners = {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"}
    scene = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [points, corners],
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    head = json.dumps(scene).encode()
    head += b" " * (-len(head) % 4)
    chunks = [struct.pack("<II", len(data), kind) + data for data, kind in ((head, 0x4E4F534A), (body, 0x004E4942))]
    return struct.pack("<III", 0x46546C67, 2, 12 + sum(map(len, chunks))) + b"".join(chunks)


def mutated(content: bytes, random: np.random.Generator) -> bytes:
    """One to six bytes changed, cut out or doubled, most of them where the header is."""
    found = bytearray(content)
    for _ in range(int(random.integers(1, 7))):
        longest = len(found) if random.random() < 0.5 else min(len(found), 300)
        at = int(random.integers(longest))
        match int(random.integers(4)):
            case 0:
                found[at] ^= 1 << int(random.integers(8))
            case 1:
                found[at] = int(random.integers(256))
            case 2:
                del found[at : at + int(random.integers(1, 20))]
            case _:
                found[at:at] = found[at : at + int(random.integers(1, 20))]
    return bytes(found)


def read(path: Path) -> Mesh | str:
    """A mesh, or why there is none."""
    try:
        (found,) = read_meshes([path])
    except InputError as error:
        return str(error)
    return found


@pytest.mark.parametrize("ending", slow_but([".stl", ".obj"], MESH_ENDINGS))
def test_a_mesh_is_read_as_open3d_reads_it(tmp_path: Path, ending: str) -> None:
    path = written(tmp_path / f"cube{ending}")
    there = o3d.io.read_triangle_mesh(path)
    ((vertices, triangles),) = read_meshes([path], coarse=False)
    np.testing.assert_array_equal(vertices, np.asarray(there.vertices))
    np.testing.assert_array_equal(triangles, np.asarray(there.triangles))
    ((vertices, triangles),) = read_meshes([path])
    assert (len(vertices), len(triangles)) == ((3, 1) if ending == ".glb" else (8, 12))


ONE_TRIANGLE = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
"""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("bad.ply", ONE_TRIANGLE + "7 0 1 2 0 1 2 99999999\n"),
        ("bad.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4 0 1 2 99999999\n"),
    ],
)
def test_a_file_that_ends_the_reader_ends_no_more_and_is_named(tmp_path: Path, name: str, text: str) -> None:
    """A polygon of a vertex that is not there, which Open3D cuts into triangles."""
    good, bad = written(tmp_path / "good.ply"), tmp_path / name
    bad.write_text(text, encoding="ascii")
    with pytest.raises(
        InputError, match=rf"got one that ended its reader \(SIGSEGV\) \| try: export it again \| .*{name}"
    ):
        read_meshes([good, bad])


@pytest.mark.parametrize("coarse", [True, False])
def test_a_triangle_of_a_vertex_that_is_not_there_is_refused(tmp_path: Path, coarse: bool) -> None:
    path = tmp_path / "bad.ply"
    path.write_text(ONE_TRIANGLE + "3 0 1 99999999\n", encoding="ascii")
    with pytest.raises(InputError, match="triangles of its vertices"):
        read_meshes([path], coarse=coarse)


@pytest.mark.slow
def test_no_mutation_ends_this_process(tmp_path: Path) -> None:
    random = np.random.default_rng(30)
    meshes, words = 0, set()
    for ending in MESH_ENDINGS:
        content = written(tmp_path / f"cube{ending}").read_bytes()
        for number in range(MUTATIONS):
            path = tmp_path / f"{number}{ending}"
            path.write_bytes(mutated(content, random))
            found = read(path)
            if isinstance(found, str):
                assert str(path) in found
                words.add(found.replace(str(path), ""))
            else:
                vertices, triangles = found
                assert np.isfinite(vertices).all()
                assert triangles.max() < len(vertices)
                meshes += 1
    assert meshes > 20
    assert any("SIGSEGV" in one for one in words)  # else it proves nothing


def test_a_reader_that_does_not_end_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_files, "TIMEOUT_S", 0.01)
    assert "one that ended its reader (0.01 s)" in str(read(written(tmp_path / "cube.ply")))


@pytest.mark.parametrize("vertex", ["1e300", "nan", "-inf"])
def test_vertices_out_of_reach_are_refused(tmp_path: Path, vertex: str) -> None:
    path = tmp_path / "cube.off"
    path.write_text(f"OFF\n3 1 0\n0 0 0\n1 0 0\n0 {vertex} 0\n3 0 1 2\n", encoding="ascii")
    assert "expected" in str(read(path))


def test_a_container_s_mesh_is_read_so_too(tmp_path: Path) -> None:
    path = written(tmp_path / "cube.obj")
    np.testing.assert_allclose(container_model(ContainerSection(shape="mesh", mesh=str(path))).size_m, 10.0)
    path.write_bytes(b"\0" * 100)
    with pytest.raises(InputError, match=r"a mesh.*cube\.obj"):
        container_model(ContainerSection(shape="mesh", mesh=str(path)))
