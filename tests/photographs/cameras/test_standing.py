"""Whatever frame a solution comes in, its object ends upright, standing on the ground, its longest side 2."""

from dataclasses import replace

import pytest
import torch

from arm_blender.photographs.cameras.standing import upright
from arm_blender.photographs.masks.joint_hull import joint_hull

from .solutions import HEIGHT, box, masks_of, pixels, solution, w2c_ring

HALF = (0.9, 0.5, 0.3)


def tilted(found, degrees: float = 70.0):
    """The solution in another frame: turned, moved and three times as large."""
    angle = torch.deg2rad(torch.tensor(degrees)).double()
    turn = torch.eye(3, dtype=torch.float64)
    turn[1:, 1:] = torch.tensor([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]])
    shift = torch.tensor([3.0, -1.0, 2.0]).double()
    w2c = found.w2c.clone()
    w2c[:, :3, :3] = found.w2c[:, :3, :3] @ turn.T
    w2c[:, :3, 3] = 3.0 * found.w2c[:, :3, 3] - (w2c[:, :3, :3] @ shift)
    return replace(found, w2c=w2c, points=3.0 * found.points @ turn.T + shift)


@pytest.fixture
def scene():
    """A box on a ground of 400 points that is slanted to nobody."""
    generator = torch.Generator().manual_seed(0)
    ground = torch.rand(400, 3, generator=generator).double() * 4.0 - 2.0
    ground[:, 2] = -HALF[2] + 0.004 * torch.randn(400, generator=generator)
    around = (ground[:, 0].abs() > 1.2) | (ground[:, 1].abs() > 0.9)
    surface = box(HALF, 6)
    surface = surface[(surface.abs() > torch.tensor(HALF) - 1e-6).any(dim=1)]
    # Cameras that look down on it slanted to one side: their mean up is not the ground's normal.
    w2c = w2c_ring(16, elevation=0.6)[:9]
    return solution(w2c, torch.cat([surface, ground[around]]))


def test_ground_up_and_size_are_found_in_any_frame(scene):
    found = tilted(scene)
    masks = masks_of(scene.w2c, box(HALF))
    hull = joint_hull(found.w2c, found.lenses, masks)
    stand = upright(found, masks, hull, 0)
    assert stand.ground
    moved = stand.moved(found.points)
    own, ground = moved[: len(moved) - 200], moved[-200:]
    assert float(ground[:, 2].std()) < 0.03, "the ground is level"
    object_points = own[: int((scene.points.abs() <= torch.tensor(HALF) + 1e-6).all(dim=1).sum())]
    extent = object_points.amax(dim=0) - object_points.amin(dim=0)
    assert 1.6 <= float(extent.max()) <= 2.05, "a hull of nine cameras on one side is larger than its object"
    assert float(object_points[:, 2].amin()) == pytest.approx(float(ground[:, 2].mean()), abs=0.05)
    assert bool((object_points.abs() <= 1.05).all())
    assert bool((stand.c2w(found.w2c)[:, 2, 3] > 0.5).all()), "all cameras look from above"


def test_cameras_and_points_move_together(scene):
    """Every point is still seen at its pixel."""
    found = tilted(scene)
    stand = upright(found, None, None, 0)
    c2w = stand.c2w(found.w2c)
    torch.testing.assert_close(c2w[:, :3, :3] @ c2w[:, :3, :3].transpose(1, 2), torch.eye(3).double().expand(9, 3, 3))
    opencv = c2w @ torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0])).double()
    for index in range(9):
        own = scene.seen[scene.seen[:, 0] == index]
        at = pixels(torch.linalg.inv(opencv[index]), stand.moved(found.points)[own[:, 1].long()])
        torch.testing.assert_close(at, own[:, 2:], atol=1e-4, rtol=0)


def test_without_a_ground_up_is_the_cameras_own(scene):
    around = w2c_ring(12)
    found = tilted(solution(around, box((0.5, 0.5, 0.5), 3)))
    stand = upright(found, None, None, 0)
    assert not stand.ground
    up = stand.rotation @ torch.tensor([0.0, -torch.sin(torch.deg2rad(torch.tensor(70.0))), 0.342]).double()
    assert float(up[2]) > 0.99


def test_the_first_camera_looks_from_the_front(scene):
    c2w = upright(tilted(scene), None, None, 0).c2w(tilted(scene).w2c)
    assert abs(float(c2w[0, 0, 2])) < 1e-6 and float(c2w[0, 1, 2]) < 0.0


def test_cameras_that_were_turned_about_their_axes_are_above():
    """Portrait, landscape and upside down, from above: what is up in the pictures says nothing."""
    w2c = w2c_ring(12, elevation=0.9)
    for index in range(12):
        angle = torch.tensor(index * 1.7)
        roll = torch.eye(4, dtype=torch.float64)
        roll[:2, :2] = torch.tensor([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]])
        w2c[index] = roll @ w2c[index]
    found = solution(w2c, box(HALF, 4))
    stand = upright(found, None, None, 0)
    assert float(stand.rotation[2, 2]) > 0.95, "Z stays up"


def test_a_ground_is_found_where_bad_masks_take_along_what_lies_on_it(scene):
    """Cards around the box, all that has features there, are in most of the masks."""
    corners = torch.tensor([[x, y, 0.0] for x in (-1.5, 1.5) for y in (-1.2, 1.2)]).double()
    grid = torch.cartesian_prod(*[torch.linspace(-0.1, 0.1, 4).double()] * 2)
    flat = torch.cat([grid, torch.zeros(len(grid), 1).double()], dim=1)
    cards = (corners[:, None] + flat).view(-1, 3) - torch.tensor([0.0, 0.0, HALF[2]]).double()
    w2c = w2c_ring(16, elevation=0.6)[:9]
    surface = box(HALF, 6)
    found = tilted(solution(w2c, torch.cat([surface, cards])))
    # Four of the nine masks take the cards along.
    masks = [
        torch.maximum(own, taken) if index % 2 else own
        for index, (own, taken) in enumerate(zip(masks_of(w2c, box(HALF)), masks_of(w2c, cards), strict=True))
    ]
    stand = upright(found, masks, joint_hull(found.w2c, found.lenses, masks), 0)
    assert stand.ground is not None
    assert float(stand.moved(found.points)[-len(cards) :, 2].std()) < 0.01, "the cards lie level"
    assert float(stand.moved(found.points)[-len(cards) :, 2].mean()) == pytest.approx(stand.ground, abs=0.02)


def test_a_flat_side_of_the_object_is_no_ground():
    """A box of which only the sides have features, a whole row of them along the lower edge; masks are uncertain."""
    w2c = w2c_ring(12, elevation=0.5)
    surface = box(HALF, 14)
    surface = surface[(surface[:, :2].abs() > torch.tensor(HALF[:2]) - 1e-6).any(dim=1)]
    found = solution(w2c, surface)
    masks = masks_of(w2c, box(HALF))
    for mask in masks[1::2]:
        mask[HEIGHT // 2 :] = 0.0  # Half of the masks lack the lower half: its points may be the ground's.
    assert upright(found, masks, joint_hull(w2c, found.lenses, masks), 0).ground is None
