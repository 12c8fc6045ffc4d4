"""The user's mesh as it is seen: modifiers, scale and mirroring applied; what does not do is one line."""

from functools import partial

import numpy as np
import pytest

from arm_blender.errors import ArmError
from arm_blender.uv.given_mesh import mesh_from_arrays

bpy = pytest.importorskip("bpy")
from arm_blender.blender.input import own_mesh  # noqa: E402
from arm_blender.blender.input.own_mesh import mesh_of_result, selected_mesh  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]


@pytest.fixture
def cube(empty_file):
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    return bpy.context.object


def signed_volume(own) -> float:
    a, b, c = np.moveaxis(own.vertices[own.faces], 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def test_a_quad_mesh_becomes_triangles_with_uvs_on_their_corners(cube):
    own = selected_mesh(bpy.context)
    assert own.name == "Cube" and own.faces.shape == (12, 3) and own.corner_uvs.shape == (12, 3, 2)
    layer = cube.data.uv_layers[0].uv
    for triangle, uvs in zip(cube.data.loop_triangles, own.corner_uvs, strict=True):
        assert np.allclose([layer[loop].vector for loop in triangle.loops], uvs)


def test_a_non_uniform_scale_and_the_place_are_applied(cube):
    cube.scale, cube.location = (1.0, 2.0, 3.0), (5.0, 0.0, 0.0)
    own = selected_mesh(bpy.context)
    assert own.vertices.min(axis=0) == pytest.approx([4.0, -2.0, -3.0])
    assert own.vertices.max(axis=0) == pytest.approx([6.0, 2.0, 3.0])
    assert signed_volume(own) == pytest.approx(48.0)
    assert tuple(cube.scale) == (1.0, 2.0, 3.0), "the user's object stays as it is"


def test_a_mirrored_object_still_looks_outwards(cube):
    cube.scale = (-1.0, 1.0, 1.0)
    own = selected_mesh(bpy.context)
    assert signed_volume(own) == pytest.approx(8.0)
    cube.scale = (1.0, 1.0, 1.0)
    plain = selected_mesh(bpy.context)
    at = {tuple(np.round(v, 3)) + tuple(np.round(uv, 3)) for v, uv in corners(plain)}
    assert {(-x, y, z, u, v) for x, y, z, u, v in at} == {
        tuple(np.round(p, 3)) + tuple(np.round(uv, 3)) for p, uv in corners(own)
    }


def corners(own):
    return zip(own.vertices[own.faces].reshape(-1, 3) + 0.0, own.corner_uvs.reshape(-1, 2), strict=True)


def test_modifiers_are_applied(cube):
    cube.modifiers.new("Array", "ARRAY").count = 3
    own = selected_mesh(bpy.context)
    assert len(own.faces) == 36 and np.ptp(own.vertices[:, 0]) == pytest.approx(6.0)
    assert len(cube.data.polygons) == 6 and len(cube.modifiers) == 1


def test_a_mesh_that_is_not_manifold_is_taken(cube):
    mesh = bpy.data.meshes.new("fan")
    mesh.from_pydata([(0, 0, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (-1, 0, 0)], [], [(0, 1, 2), (0, 1, 3), (0, 1, 4)])
    cube.data = mesh
    own = selected_mesh(bpy.context)
    assert own.corner_uvs is None
    assert mesh_from_arrays(own.name, own.vertices, own.faces).faces.shape == (3, 3)


def refused(match: str, read=selected_mesh) -> None:
    with pytest.raises(ArmError, match=match) as caught:
        read(bpy.context)
    assert "\n" not in str(caught.value)


def test_no_mesh_is_refused(empty_file):
    refused("No mesh is selected")
    bpy.ops.object.empty_add()
    refused("No mesh is selected")


@pytest.mark.parametrize("mode", ["EDIT", "SCULPT"])
def test_another_mode_is_refused_and_stays(cube, mode):
    bpy.ops.object.mode_set(mode=mode)
    refused("Cube: is being edited; go back to Object Mode")
    assert cube.mode == mode


def test_a_mesh_without_faces_is_refused(cube):
    cube.data = bpy.data.meshes.new("points")
    refused("Cube: has no faces")


def test_a_scale_of_zero_is_refused(cube):
    cube.scale = (1.0, 1.0, 0.0)
    refused("Cube: a scale of 0 makes it flat")


def test_two_million_faces_are_refused_before_they_are_read(cube, monkeypatch):
    side = 1001
    grid = bpy.data.meshes.new("grid")
    grid.vertices.add(1)
    faces = side * side
    grid.loops.add(4 * faces)
    grid.polygons.add(faces)
    grid.polygons.foreach_set("loop_start", np.arange(0, 4 * faces, 4, dtype=np.int32))
    cube.data = grid
    monkeypatch.setattr(own_mesh, "_read", None)
    refused(r"Cube: 2,004,002 triangles; decimate it to at most 1,000,000")


def test_only_a_result_with_its_uvs_can_be_regenerated(cube):
    refused("Cube: was not made by this panel", partial(mesh_of_result, frame=None))
    framed = partial(mesh_of_result, frame=[0.5, 1.0, 2.0, 3.0])
    own = framed(bpy.context)
    assert own.vertices.min(axis=0) == pytest.approx([0.5, 1.5, 2.5])
    assert own.vertices.max(axis=0) == pytest.approx([1.5, 2.5, 3.5])
    cube.data.uv_layers.remove(cube.data.uv_layers[0])
    refused("Cube: its UVs are gone", framed)
