"""A mesh of unknown size and place comes to where the pictures show it."""

from dataclasses import replace

import pytest
import torch
import trimesh

from arm_blender.errors import EmptyMeshError
from arm_blender.graphics.cameras import project
from arm_blender.graphics.raster.rasterize import rasterize
from arm_blender.structures import TriangleMesh, ViewSet
from arm_blender.views.mesh_fit import fit_to_views, outline_fit, up_axis, z_up
from arm_blender.views.rigs import front_camera, zero123plus_rig

from ..colored_box import box_mesh, view_set

SIZE = 128


def slab() -> TriangleMesh:
    """A long box that is seen from its short side in front."""
    box = trimesh.creation.box((0.7, 1.8, 1.0))
    return TriangleMesh(torch.tensor(box.vertices).float(), torch.tensor(box.faces).long())


def views_of(mesh: TriangleMesh, cameras) -> ViewSet:
    masks = torch.stack([rasterize(mesh.vertices, mesh.faces, camera).mask for camera in cameras]).float()
    return ViewSet(masks[:, None].expand(-1, 4, -1, -1).contiguous(), tuple(cameras), torch.ones(len(cameras)), "slab")


def test_a_mesh_elsewhere_of_another_size_comes_to_its_place_under_the_rig():
    mesh = slab()
    views = views_of(mesh, zero123plus_rig(4.0, 30.0, SIZE))
    moved = mesh.moved(lambda points: points * 25.0 + torch.tensor([3.0, -40.0, 7.0]))
    fitted = moved.moved(fit_to_views(moved, views).restore)
    assert torch.allclose(fitted.vertices, mesh.vertices, atol=0.03)


def test_one_picture_is_filled_to_a_pixel():
    mesh, camera = slab(), front_camera(100.0, SIZE)
    views = views_of(mesh.moved(lambda points: points * 0.8 + torch.tensor([0.2, 0.0, -0.1])), [camera])
    moved = mesh.moved(lambda points: points * 3.0 - 5.0)
    pixels, _ = project(moved.moved(fit_to_views(moved, views).restore).vertices, camera)
    shown = torch.nonzero(views.images[0, 3]).flip(1)
    assert (pixels.amin(0) - shown.amin(0)).abs().max() <= 1.0
    assert (pixels.amax(0) - shown.amax(0) - 1).abs().max() <= 1.0


@pytest.mark.parametrize("known", [(0, 0, 128, 80), (0, 0, 90, 128), (40, 0, 90, 128), (0, 40, 128, 90)])
def test_a_picture_that_cuts_an_object_is_filled_where_the_object_ends_in_it(known):
    mesh, camera = slab(), front_camera(100.0, SIZE)
    views = views_of(mesh, [camera])
    left, top, right, bottom = known
    images = torch.zeros_like(views.images)
    images[:, :, top:bottom, left:right] = views.images[:, :, top:bottom, left:right]
    cut = replace(views, images=images, known=(known,))
    frame = fit_to_views(mesh.moved(lambda points: points * 3.0), cut)
    assert frame.scale * 3.0 == pytest.approx(1.0, abs=0.02)
    assert outline_fit(mesh.moved(lambda points: points * 3.0).moved(frame.restore), cut) > 0.97


def test_a_rig_whose_pictures_cut_the_object_says_its_size_and_place():
    mesh, known = slab(), (0, 0, SIZE, 80)
    views = views_of(mesh, zero123plus_rig(4.0, 30.0, SIZE))
    images = views.images.clone()
    images[1::2, :, known[3] :] = 0.0
    cut = replace(views, images=images, known=((0, 0, SIZE, SIZE), known) * 3)
    moved = mesh.moved(lambda points: points * 25.0 + torch.tensor([3.0, -40.0, 7.0]))
    fitted = moved.moved(fit_to_views(moved, cut).restore)
    assert torch.allclose(fitted.vertices, mesh.vertices, atol=0.03)


def test_where_no_picture_shows_an_object_from_end_to_end_its_box_counts():
    views = view_set()
    images, known = torch.zeros_like(views.images), (50, 40, 75, 80)
    images[:, :, known[1] : known[3], known[0] : known[2]] = 1.0
    frame = fit_to_views(box_mesh(), replace(views, images=images, known=(known,) * 6))
    assert 0.0 < frame.scale < 1.0 and bool(frame.center.isfinite().all())


def test_what_is_in_place_stays():
    mesh = slab()
    frame = fit_to_views(mesh, views_of(mesh, zero123plus_rig(4.0, 30.0, 512)))
    assert frame.scale == pytest.approx(1.0, abs=0.01) and float(frame.center.abs().max()) < 0.01


def test_a_mesh_in_one_point_is_refused():
    mesh = slab().moved(torch.zeros_like)
    with pytest.raises(EmptyMeshError, match="one point"):
        fit_to_views(mesh, views_of(slab(), zero123plus_rig(4.0, 30.0, SIZE)))


@pytest.mark.parametrize("axis", ["y", "z"])
def test_the_axis_that_is_up_is_the_one_with_which_the_outlines_fit(axis):
    upright, views = box_mesh(), view_set()
    stored = upright if axis == "z" else upright.moved(lambda p: torch.stack([p[:, 0], p[:, 2], -p[:, 1]], dim=1))
    found, fits = up_axis(stored, views)
    assert found == axis and fits[axis] > 0.97 and min(fits.values()) < 0.7
    if axis == "y":
        torch.testing.assert_close(stored.moved(z_up).vertices, upright.vertices)


def test_what_looks_alike_either_way_stays_as_it_is():
    ball = trimesh.creation.icosphere(subdivisions=3)
    mesh = TriangleMesh(torch.from_numpy(ball.vertices).float(), torch.from_numpy(ball.faces).long())
    assert up_axis(mesh, view_set())[0] == "z"


def test_outlines_are_compared_only_where_a_camera_took_pixels():
    views = view_set()
    images = views.images.clone()
    images[:, :, :, 64:] = 0.0
    half = replace(views, images=images, known=((0, 0, 64, 128),) * 6)
    assert outline_fit(box_mesh(), half) > 0.97 > 0.8 > outline_fit(box_mesh(), replace(half, known=None))
