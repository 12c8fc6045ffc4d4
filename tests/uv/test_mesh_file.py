"""A user's mesh comes in as it is."""

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.errors import EmptyMeshError
from arm_blender.structures import TriangleMesh, UvMesh
from arm_blender.uv.mesh_file import read_mesh


def test_a_file_that_splits_vertices_is_welded(tmp_path):
    box = trimesh.creation.box()
    split = trimesh.Trimesh(box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    split.export(tmp_path / "box.ply")
    mesh = read_mesh(tmp_path / "box.ply")
    assert isinstance(mesh, TriangleMesh) and mesh.vertices.shape == (8, 3) and mesh.faces.shape == (12, 3)
    welded = trimesh.Trimesh(mesh.vertices.numpy(), mesh.faces.numpy(), process=False)
    assert welded.is_watertight and welded.volume == pytest.approx(1.0)


def test_uvs_stay_on_their_corners(tmp_path):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    uv = np.array([[0.1, 0.2], [0.9, 0.2], [0.9, 0.8], [0.1, 0.8]])
    quad = trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False)
    quad.visual = trimesh.visual.TextureVisuals(uv=uv)
    quad.export(tmp_path / "quad.glb")
    mesh = read_mesh(tmp_path / "quad.glb")
    assert isinstance(mesh, UvMesh)
    corners, found = mesh.vertices[mesh.faces].reshape(-1, 3), mesh.uvs[mesh.face_uvs].reshape(-1, 2)
    # glTF is Y-up: the file's (x, y, 0) is our (x, 0, y).
    assert torch.allclose(found[:, 0], 0.1 + 0.8 * corners[:, 0], atol=1e-5)
    assert torch.allclose(found[:, 1], 0.2 + 0.6 * corners[:, 2], atol=1e-5)


def test_tiled_uvs_are_no_atlas(tmp_path):
    quad = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2]], process=False)
    quad.visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [3, 0], [3, 3]])
    quad.export(tmp_path / "tiled.glb")
    assert isinstance(read_mesh(tmp_path / "tiled.glb"), TriangleMesh)


def test_uvs_in_one_place_are_no_atlas(tmp_path):
    quad = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2]], process=False)
    quad.visual = trimesh.visual.TextureVisuals(uv=[[0.5, 0.5]] * 3)
    quad.export(tmp_path / "point.glb")
    assert isinstance(read_mesh(tmp_path / "point.glb"), TriangleMesh)


@pytest.mark.parametrize("scale", [1e7, 1e25])
def test_a_mesh_out_of_all_proportion_is_refused(tmp_path, scale):
    trimesh.creation.box((scale, scale, scale)).export(tmp_path / "huge.stl")
    with pytest.raises(EmptyMeshError, match="huge.stl: has coordinates beyond"):
        read_mesh(tmp_path / "huge.stl")


@pytest.mark.parametrize(
    ("name", "content"), [("none.obj", None), ("bad.glb", b"glTF no"), ("empty.obj", b"# nothing")]
)
def test_what_is_no_mesh_is_one_line_with_the_files_name(tmp_path, name, content):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(EmptyMeshError, match=name.replace(".", r"\.")) as error:
        read_mesh(tmp_path / name)
    assert "give a" in str(error.value)
