"""A mesh that is inside out is turned, and each side gets its own colour."""

from dataclasses import replace

import pytest
import torch

from arm_blender.structures import TriangleMesh, UvMesh
from arm_blender.uv.given.winding import facing_out
from arm_blender.uv.given_mesh import mesh_from_arrays
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

from ...colored_box import BODY, COLORS, box_mesh, cameras, side_errors, split_box, view_set


def turned(mesh, faces: slice):
    chosen = torch.zeros(len(mesh.faces), dtype=torch.bool)
    chosen[faces] = True
    flip = lambda corners: torch.where(chosen[:, None], corners.flip(1), corners)  # noqa: E731
    changed = {"faces": flip(mesh.faces)}
    if isinstance(mesh, UvMesh):
        changed["face_uvs"] = flip(mesh.face_uvs)
    return replace(mesh, **changed)


def signed_volume(mesh) -> float:
    a, b, c = mesh.vertices[mesh.faces].unbind(dim=1)
    return float((a * torch.linalg.cross(b, c)).sum()) / 6.0


def test_a_mesh_that_looks_outwards_stays_the_very_same():
    mesh = box_mesh()
    assert facing_out(mesh, cameras())[0] is mesh and facing_out(mesh, cameras())[1] == 0.0


@pytest.mark.parametrize("faces", [slice(None), slice(0, 12), slice(3, 4)], ids=["all", "a part", "a face"])
def test_what_is_seen_from_behind_is_turned(faces):
    right = mesh_from_arrays("box", box_mesh().vertices.numpy(), box_mesh().faces.numpy())
    mesh, share = facing_out(turned(right, faces), cameras())
    assert signed_volume(mesh) == pytest.approx(signed_volume(right)) and share > 0.0


def test_an_inside_out_box_has_its_own_colours():
    vertices, uvs, faces = (torch.from_numpy(array) for array in split_box(*BODY))
    mesh, share = facing_out(turned(UvMesh(vertices, faces, uvs, faces, 6), slice(None)), cameras())
    assert share == 1.0
    errors, _ = side_errors(mesh, view_set())
    assert set(errors) == set(COLORS) and max(errors.values()) < 3 / 255
    bare, _ = facing_out(turned(TriangleMesh(vertices, faces), slice(None)), cameras())
    errors, _ = side_errors(unwrap(bare, UnwrapConfig(256, time_limit=0.0))[0], view_set())
    assert set(errors) == set(COLORS) and max(errors.values()) < 3 / 255


def test_a_sheet_without_thickness_is_left_to_its_better_seen_side():
    sheet = TriangleMesh(
        torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), torch.tensor([[0, 1, 2], [0, 2, 3]])
    )
    assert facing_out(sheet, cameras()[::2])[1] == 0.0, "seen from above"
    assert facing_out(sheet, cameras()[1::2])[1] == 1.0, "seen from below"
