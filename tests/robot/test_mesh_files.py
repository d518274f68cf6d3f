"""Mesh files of others: whatever is in one, the process goes on, with a mesh or with one clear error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from deformscope.errors import InputError
from deformscope.experiments.squeeze_features import container_model
from deformscope.rig.squeeze_sections import ContainerSection
from deformscope.robot import mesh_files
from deformscope.robot.mesh_files import MESH_ENDINGS, Mesh, read_meshes

MUTATIONS = 60
"""Of each kind of file."""


def written(path: Path) -> Path:
    """A cube of 10."""
    cube = o3d.geometry.TriangleMesh.create_box(10.0, 10.0, 10.0).compute_triangle_normals()
    assert o3d.io.write_triangle_mesh(path, cube)
    return path


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


@pytest.mark.parametrize("ending", MESH_ENDINGS)
def test_a_mesh_is_read_as_open3d_reads_it(tmp_path: Path, ending: str) -> None:
    path = written(tmp_path / f"cube{ending}")
    there = o3d.io.read_triangle_mesh(path)
    ((vertices, triangles),) = read_meshes([path], coarse=False)
    np.testing.assert_array_equal(vertices, np.asarray(there.vertices))
    np.testing.assert_array_equal(triangles, np.asarray(there.triangles))
    ((vertices, triangles),) = read_meshes([path])
    assert (len(vertices), len(triangles)) == (8, 12)


def test_a_file_that_ends_the_reader_ends_no_more_and_is_named(tmp_path: Path) -> None:
    """A list of vertex indices in whose place there is one number: Open3D's reader of PLY dies at it."""
    good = written(tmp_path / "good.ply")
    content = good.read_bytes()
    assert b"property list uchar uint vertex_indices" in content
    bad = tmp_path / "bad.ply"
    bad.write_bytes(content.replace(b"property list uchar uint vertex_indices", b"property uint vertex_indices"))
    with pytest.raises(InputError, match=r"a mesh.*export it again \| .*bad\.ply"):
        read_meshes([good, bad])


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
    assert "the reader ended (0.01 s)" in str(read(written(tmp_path / "cube.ply")))


@pytest.mark.parametrize("vertex", ["1e300", "nan", "-inf"])
def test_vertices_out_of_reach_are_refused(tmp_path: Path, vertex: str) -> None:
    path = tmp_path / "cube.off"
    path.write_text(f"OFF\n3 1 0\n0 0 0\n1 0 0\n0 {vertex} 0\n3 0 1 2\n", encoding="ascii")
    assert "expected" in str(read(path))


def test_a_container_s_mesh_is_read_so_too(tmp_path: Path) -> None:
    path = written(tmp_path / "cube.obj")
    made = container_model(ContainerSection(shape="mesh", mesh=str(path)))
    np.testing.assert_allclose(made.size_m, 10.0)
    path.write_bytes(b"\0" * 100)
    with pytest.raises(InputError, match=r"a mesh.*cube\.obj"):
        container_model(ContainerSection(shape="mesh", mesh=str(path)))
