"""Views that are not of one object are noticed, and the picture to blame is named."""

from dataclasses import replace

import pytest
import torch

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.structures import UvMesh, ViewSet
from arm_blender.views.agreement import AGREE, agreement, disagreement
from arm_blender.views.doubts import doubts, misfit

from ..colored_box import box_mesh, cameras, picture, view_set

NAMES = [f"{index}.png" for index in range(6)]


@pytest.fixture(scope="module")
def views() -> ViewSet:
    return replace(view_set(), pictures=tuple(NAMES))


def test_views_of_one_object_agree_wherever_it_is(views):
    assert float(agreement(views).min()) > 0.98 and disagreement(views, NAMES) is None
    moved = []
    for camera in views.cameras:
        c2w = camera.c2w.clone()
        c2w[:3, 3] = c2w[:3, 3] * 30.0 + torch.tensor([100.0, -50.0, 20.0])
        moved.append(replace(camera, c2w=c2w))
    assert float(agreement(replace(views, cameras=tuple(moved))).min()) > AGREE


@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (1, 5)])
def test_two_pictures_that_were_exchanged_are_named(views, pair):
    order = list(range(6))
    order[pair[0]], order[pair[1]] = order[pair[1]], order[pair[0]]
    why = disagreement(replace(views, images=views.images[order]), NAMES)
    assert why.startswith(f"{pair[0]}.png and {pair[1]}.png do not fit the other pictures")


@pytest.mark.parametrize("view", range(6))
def test_a_wrong_pose_is_named(views, view):
    wrong = list(views.cameras)
    wrong[view] = orbit_camera(20.0 + 60.0 * view + 100.0, 0.0, 5.0, 30.0, 128, 128)
    assert disagreement(replace(views, cameras=tuple(wrong)), NAMES).startswith(f"{view}.png does not fit")


def test_a_wrong_order_of_all_is_said(views):
    why = disagreement(replace(views, images=views.images[[1, 2, 3, 4, 5, 0]]), NAMES)
    assert "do not fit" in why or "do not agree" in why


def test_of_one_view_nothing_is_said(views):
    assert disagreement(views.only([0]), NAMES[:1]) is None and list(doubts(views.only([0]))) == []


def test_views_that_agree_leave_no_doubt_and_one_of_weight_0_none_either(views):
    assert list(doubts(views)) == []
    order = [1, *range(1, 6)]
    wrong = replace(views, images=views.images[order])
    assert list(doubts(wrong))[0].startswith("0.png does not fit")
    assert list(doubts(replace(wrong, weights=torch.tensor([0.0] + [1.0] * 5)))) == []


def test_a_shape_that_does_not_fill_its_masks_is_doubtful(views):
    mesh = box_mesh()
    whole = UvMesh(mesh.vertices, mesh.faces, mesh.vertices[:, :2], mesh.faces, 1)
    assert list(misfit(whole, views)) == []
    small = whole.moved(lambda points: 0.7 * points)
    assert "fits the masks to 0." in next(misfit(small, views))


def test_an_object_that_the_borders_cut_is_doubtful():
    near = cameras(distance=2.6)
    views = ViewSet(torch.stack([picture(camera) for camera in near]), near, torch.ones(6), "box")
    assert [why for why in doubts(views) if "the border cuts the object in" in why and "further away" in why]


def test_two_bodies_are_doubtful(views):
    images = views.images.clone()
    images[:, 3] = 0.0
    images[:, 3, 40:90, 20:50] = images[:, 3, 40:90, 78:108] = 1.0
    assert [why for why in doubts(replace(views, images=images)) if "several parts of about one size" in why]
