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


SHAPE = [(-0.8, -0.5), (0.8, -0.5), (0.8, 0.6), (0.4, 0.6), (0.4, 0.1), (-0.8, 0.1)]
"""An L, as the profile of a prism from y = -0.4 to 0.4."""

POLYGONS = [range(6), range(11, 5, -1), *([i, i + 6, (i + 1) % 6 + 6, (i + 1) % 6] for i in range(6))]


def prism(path):
    """An L-shaped prism of two concave hexagons and six quads."""
    points = [(x, y, z) for y in (-0.4, 0.4) for x, z in SHAPE]
    if path.suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in points]
        lines += ["f " + " ".join(str(corner + 1) for corner in polygon) for polygon in POLYGONS[:5]]
        lines += ["f " + " ".join(str(corner - 12) for corner in polygon) for polygon in POLYGONS[5:]]
        path.write_text("\n".join(lines))
        return path
    binary = path.stem == "binary"
    head = ["ply", f"format {'binary_little_endian' if binary else 'ascii'} 1.0", "element vertex 12"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += ["element face 8", "property list uchar int vertex_indices", "property uchar red", "end_header", ""]
    data = "\n".join(head).encode()
    for point in points:
        data += np.array(point, "<f4").tobytes() if binary else (" ".join(map(str, point)) + "\n").encode()
    for polygon in POLYGONS:
        if binary:
            data += bytes([len(polygon)]) + np.array(list(polygon), "<i4").tobytes() + b"\x07"
        else:
            data += (" ".join(map(str, [len(polygon), *polygon, 7])) + "\n").encode()
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("name", ["prism.obj", "binary.ply", "text.ply"])
def test_concave_polygons_and_quads_are_solid(tmp_path, name):
    mesh = read_mesh(prism(tmp_path / name))
    solid = trimesh.Trimesh(mesh.vertices.numpy(), mesh.faces.numpy(), process=False)
    assert solid.is_watertight and len(mesh.faces) == 20
    assert solid.volume == pytest.approx(0.8 * (1.6 * 0.6 + 0.4 * 0.5))
    assert solid.area == pytest.approx(2 * (1.6 * 0.6 + 0.4 * 0.5) + 0.8 * (2 * 1.6 + 2 * 1.1))


def test_polygons_keep_the_uvs_of_their_corners(tmp_path):
    corners = [(0, 0), (2, 1), (0, 2), (1, 1)]  # Concave at the last.
    lines = [f"v {x} {y} 0" for x, y in corners] + [f"vt {x / 2} {y / 2}" for x, y in corners]
    (tmp_path / "arrow.obj").write_text("\n".join([*lines, "usemtl none", "f 1/1 2/2 3/3 4/-1"]))
    mesh = read_mesh(tmp_path / "arrow.obj")
    assert isinstance(mesh, UvMesh)
    torch.testing.assert_close(mesh.uvs[mesh.face_uvs] * 2.0, mesh.vertices[mesh.faces][..., :2])


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
