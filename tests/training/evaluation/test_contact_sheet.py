"""The pictures of an evaluation: normals as colours, and a tile for every view and shape."""

import numpy as np
import torch
import trimesh

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.structures import TriangleMesh, ViewSet
from training.evaluation.tables.contact_sheet import CAPTION, TILE, contact_sheet, normal_picture


def sphere() -> TriangleMesh:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.8)
    return TriangleMesh(torch.tensor(np.asarray(mesh.vertices), dtype=torch.float32), torch.tensor(mesh.faces.copy()))


def test_the_colours_of_a_sphere_are_its_normals():
    camera = orbit_camera(40.0, 10.0, 200.0, 0.6, 64, 64)  # So far away that it sees in parallel.
    picture = normal_picture(sphere(), camera)
    x, y = torch.meshgrid(torch.arange(64) + 0.5, torch.arange(64) + 0.5, indexing="xy")
    pixel = 2.0 * 200.0 * np.tan(np.radians(0.3)) / 64
    normal = torch.stack([(x - 32.0) * pixel, (32.0 - y) * pixel, torch.zeros(64, 64)]) / 0.8
    inside = normal.square().sum(dim=0) < 0.9**2
    normal[2] = (1.0 - normal.square().sum(dim=0)).clamp(min=0.0).sqrt()
    assert (picture - (0.5 + 0.5 * normal))[:, inside].abs().max() < 0.06
    assert (picture[:, 0, 0] == 1.0).all()


def test_a_face_wound_the_wrong_way_shows_without_blue():
    inverted = TriangleMesh(sphere().vertices, sphere().faces.flip(dims=(1,)))
    picture = normal_picture(inverted, orbit_camera(0.0, 0.0, 6.0, 26.0, 32, 32))
    assert picture[2, 16, 16] < 0.05


def test_a_sheet_has_a_tile_for_every_view_and_two_for_every_shape():
    cameras = tuple(orbit_camera(60.0 * k, 0.0, 6.0, 30.0, 40, 40) for k in range(4))
    images = torch.zeros(4, 4, 40, 40)
    images[:, 0], images[:, 3, 10:30, 10:30] = 1.0, 1.0  # A red square on transparent ground.
    sheet = contact_sheet(ViewSet(images, cameras, torch.ones(4), "square"), dict.fromkeys("abc", sphere()))
    assert sheet.size == (6 * TILE, 2 * (TILE + CAPTION))
    assert sheet.getpixel((TILE // 2, CAPTION + TILE // 2)) == (255, 0, 0)
    assert sheet.getpixel((5, CAPTION + 5)) == (255, 255, 255)
    center = sheet.getpixel((5 * TILE + TILE // 2, TILE + 2 * CAPTION + TILE // 2))
    assert center[2] > 200 and center != (255, 255, 255)
