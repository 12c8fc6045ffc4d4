"""UVs are kept wherever each texel belongs to one point of the surface, and what is not kept is said."""

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.structures import TriangleMesh, UvMesh
from arm_blender.uv.given_mesh import mesh_from_arrays
from arm_blender.uv.mesh_file import read_mesh

from ...colored_box import BODY, COLORS, KNOB, side_errors, split_box, view_set

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], np.float32)


class Heard(list):
    def __call__(self, what: str, why: str) -> None:
        self.append(f"{what}: {why}")


def box(change=lambda uvs: uvs) -> tuple[TriangleMesh | UvMesh, Heard]:
    vertices, uvs, faces = split_box(*BODY)
    heard = Heard()
    return mesh_from_arrays("box", vertices, faces, (change(uvs), faces), left_out=heard), heard


def two_boxes(shift: float) -> tuple[TriangleMesh | UvMesh, Heard]:
    (first, uvs, faces), (second, _, _) = split_box(*BODY), split_box(*KNOB)
    moved = np.concatenate([uvs, uvs + (shift, 0.0)])
    both = np.concatenate([faces, faces + len(first)])
    heard = Heard()
    return mesh_from_arrays("boxes", np.concatenate([first, second]), both, (moved, both), left_out=heard), heard


def test_an_atlas_is_kept_to_the_last_digit():
    mesh, heard = box()
    vertices, uvs, faces = split_box(*BODY)
    assert isinstance(mesh, UvMesh) and heard == []
    assert np.array_equal(mesh.uvs.numpy()[mesh.face_uvs], uvs[faces])


def test_two_parts_that_share_a_layout_are_unwrapped_anew():
    mesh, heard = two_boxes(0.0)
    assert type(mesh) is TriangleMesh and "belong to several places" in heard[0] and "unwrapped anew" in heard[0]


def test_parts_on_tiles_of_their_own_are_kept_and_each_side_has_its_colour():
    mesh, heard = two_boxes(1.0)
    assert isinstance(mesh, UvMesh) and heard == [
        "the place of the mesh's UVs: they were moved from 2 tiles (UDIM) into one; their layout stays"
    ]
    errors, seen = side_errors(mesh, view_set())
    assert set(errors) == set(COLORS) and max(errors.values()) < 3 / 255 and seen > 0.5


def test_every_face_on_the_whole_square_is_no_atlas():
    mesh, heard = box(lambda uvs: np.tile(SQUARE, (6, 1)))
    assert type(mesh) is TriangleMesh and len(heard) == 1


def test_mirrored_halves_are_no_atlas():
    vertices, uvs, faces = split_box(*BODY)
    folded = uvs.copy()
    folded[:4] = folded[4:8][[1, 0, 3, 2]]  # The side at +X where that at -X lies.
    heard = Heard()
    mesh = mesh_from_arrays("box", vertices, faces, (folded, faces), left_out=heard)
    assert type(mesh) is TriangleMesh and len(heard) == 1


def test_one_small_part_over_another_is_no_atlas():
    small = np.array([[0.0, 0.0, 3.0], [0.1, 0.0, 3.0], [0.0, 0.1, 3.0]], np.float32)
    vertices, uvs, faces = split_box(*BODY)
    uvs = np.concatenate([uvs, [[0.1, 0.1], [0.15, 0.1], [0.1, 0.15]]])
    faces = np.concatenate([faces, [[24, 25, 26]]])
    heard = Heard()
    assert (
        type(mesh_from_arrays("box", np.concatenate([vertices, small]), faces, (uvs, faces), left_out=heard))
        is TriangleMesh
    )
    assert len(heard) == 1


def test_both_sides_of_a_leaf_cannot_share_texels_but_a_face_may_be_there_twice():
    vertices = np.concatenate([SQUARE, np.zeros((4, 1))], axis=1).astype(np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    leaf = np.concatenate([faces, faces[:, ::-1]])
    assert type(mesh_from_arrays("leaf", vertices, leaf, (SQUARE, leaf))) is TriangleMesh
    twice = np.concatenate([faces, faces])
    assert isinstance(mesh_from_arrays("leaf", vertices, twice, (SQUARE, twice)), UvMesh)


def test_charts_that_touch_are_an_atlas():
    column, row = np.arange(6) % 3, np.arange(6) // 3
    mesh, heard = box(lambda uvs: ((np.stack([column, row], 1)[:, None] + SQUARE) / (3, 2)).reshape(-1, 2))
    assert isinstance(mesh, UvMesh) and heard == []


@pytest.mark.parametrize(("scale", "shift"), [(1.00001, 0.0), (1.0, -1e-5), (1.0, 3.0), (1.0, -1.0), (2.5, -0.7)])
def test_uvs_beside_the_unit_square_keep_their_layout(scale, shift):
    mesh, heard = box(lambda uvs: uvs / uvs.max() * scale + shift)
    assert isinstance(mesh, UvMesh) and float(mesh.uvs.min()) >= 0.0 and float(mesh.uvs.max()) <= 1.0
    assert len(heard) == (abs(shift) > 0.1), "only what is moved by more than rounding is said"
    own = split_box(*BODY)[1][split_box(*BODY)[2]]
    found = mesh.uvs.numpy()[mesh.face_uvs]
    # Alike but for scale and place: differences within a face stand in one ratio.
    ratio = np.linalg.norm(found[:, 1] - found[:, 0], axis=1) / np.linalg.norm(own[:, 1] - own[:, 0], axis=1)
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-3)


def test_no_numbers_are_said():
    mesh, heard = box(lambda uvs: np.full_like(uvs, np.nan))
    assert type(mesh) is TriangleMesh and "no numbers" in heard[0]


def test_uvs_need_no_material_and_a_part_without_any_is_said(tmp_path):
    import json
    import struct

    vertices, uvs, faces = split_box(*BODY)
    whole = trimesh.Trimesh(vertices, faces, process=False)
    whole.visual = trimesh.visual.TextureVisuals(uv=uvs)
    data = whole.export(file_type="glb")
    length = struct.unpack_from("<I", data, 12)[0]
    gltf = json.loads(data[20 : 20 + length])
    for primitive in gltf["meshes"][0]["primitives"]:
        primitive.pop("material", None)
    gltf.pop("materials", None)
    text = json.dumps(gltf).encode().ljust(length)
    (tmp_path / "bare.glb").write_bytes(data[:20] + text + data[20 + length :])
    assert isinstance(read_mesh(tmp_path / "bare.glb"), UvMesh)
    scene = trimesh.Scene([whole, trimesh.creation.box()])
    scene.export(tmp_path / "half.glb")
    heard = Heard()
    assert type(read_mesh(tmp_path / "half.glb", heard)) is TriangleMesh
    assert heard == ["the UVs of the mesh: 1 of its 2 parts have none; it is unwrapped anew"]
    assert torch.isfinite(read_mesh(tmp_path / "half.glb").vertices).all()
