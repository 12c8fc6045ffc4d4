"""What the paper leaves out is left out, by its reason; what it would keep stays."""

import numpy as np
import pytest
import torch
import trimesh

from training.rendering.asset_filter import groups_apart, inside_share, unwanted_shape, unwanted_views


def arrays(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Centred, the longest side 2."""
    low, high = mesh.bounds
    vertices = (mesh.vertices - (low + high) / 2.0) * 2.0 / (high - low).max()
    return vertices.astype(np.float32), np.asarray(mesh.faces, np.int64)


def box(extents=(1.0, 1.0, 1.0), at=(0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    made = trimesh.creation.box(extents)
    return made.apply_translation(at)


def pieces(side: int, *more: trimesh.Trimesh) -> trimesh.Trimesh:
    """A square of boxes that stand apart."""
    standing = [box((0.5, 0.5, 1.0), (x, y, 0.5)) for x in range(side) for y in range(side)]
    return trimesh.util.concatenate([*standing, *more])


def reason(mesh: trimesh.Trimesh, loose: int = 0, most: int | None = None) -> str | None:
    return unwanted_shape(*arrays(mesh), loose, most)


def test_an_object_stays():
    assert reason(box()) is None
    assert reason(trimesh.creation.torus(1.0, 0.3)) is None
    assert reason(trimesh.creation.box((1.0, 1.0, 1e-4))) is None  # A card has two sides.


def test_parts_that_touch_are_one_object():
    wall = [box((1.0, 1.0, 1.0), (x, y, 0.0)) for x in range(5) for y in range(5)]
    assert groups_apart(*map(torch.from_numpy, arrays(trimesh.util.concatenate(wall)))) == 1


@pytest.mark.parametrize("ground", [[], [box((4.0, 4.0, 0.01), (1.0, 1.0, 0.0))]])
def test_things_that_stand_apart_are_a_scene_with_or_without_ground(ground):
    assert groups_apart(*map(torch.from_numpy, arrays(pieces(3, *ground)))) == 9
    assert "a scene of many objects: 9 groups" in reason(pieces(3, *ground))
    assert reason(pieces(2, *ground)) is None


def test_crumbs_are_no_objects():
    crumbs = [box((0.02, 0.02, 0.02), (x, y, 2.0)) for x in range(5) for y in range(5)]
    assert reason(pieces(2, *crumbs)) is None


def test_vertices_split_at_seams_do_not_part_an_object():
    sphere = trimesh.creation.icosphere(subdivisions=2)
    split = trimesh.Trimesh(sphere.vertices[sphere.faces].reshape(-1, 3), np.arange(960).reshape(-1, 3), process=False)
    assert reason(split) is None


def test_a_room_is_seen_from_behind_its_walls():
    room = box((4.0, 3.0, 2.5))
    room.invert()
    assert inside_share(*map(torch.from_numpy, arrays(room))) == 1.0
    assert inside_share(*map(torch.from_numpy, arrays(box()))) == 0.0
    assert "a scan of a room" in reason(room)


def test_a_point_cloud_and_too_many_triangles_are_left_out():
    assert "a point cloud: 100 points belong to no face, 8 do" in reason(box(), loose=100)
    assert reason(box(), loose=8) is None
    assert "12 triangles" in reason(box(), most=11)
    assert reason(box(), most=12) is None


def test_what_covers_fewer_than_ten_pixels_of_a_view_is_left_out():
    alpha = np.full((3, 8, 8), 255, np.uint8)
    alpha[1] = 127
    alpha[1, 0, : 10 - 2] = 255
    alpha[1, 1, :2] = 128
    assert unwanted_views(alpha) is None
    alpha[1, 1, 0] = 0
    assert unwanted_views(alpha) == "sparse or tiny: 9 pixels in a view"
