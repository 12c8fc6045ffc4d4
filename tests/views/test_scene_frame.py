"""What lies in the box stays exactly where it is; what lies elsewhere comes into the box and goes back."""

from dataclasses import replace

import pytest
import torch

from arm_blender.errors import CameraError
from arm_blender.graphics.cameras import Camera, project
from arm_blender.structures import ViewSet
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.scene_frame import normalise


def silhouette(camera: Camera, half: torch.Tensor, center: torch.Tensor) -> torch.Tensor:
    """(H, W) 0 or 1: the exact silhouette of an axis-aligned block, by intersecting each ray with its slabs."""
    rows, columns = torch.meshgrid(torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij")
    x, y = (columns - camera.K[0, 2]) / camera.K[0, 0], (camera.K[1, 2] - rows) / camera.K[1, 1]
    rays = torch.stack([x, y, -torch.ones_like(x)], dim=-1) @ camera.c2w[:3, :3].T
    limits = torch.stack([(center - half - camera.center) / rays, (center + half - camera.center) / rays])
    return (limits.amin(dim=0).amax(dim=-1) < limits.amax(dim=0).amin(dim=-1)).float()


def block_views(rig, half, center=(0.0, 0.0, 0.0), scale: float = 1.0, views: int = 6) -> ViewSet:
    """Views of a block in a world that is `scale` times as large and moved by `center`."""
    center, half = torch.tensor(center), torch.tensor(half) * scale
    cameras = []
    for camera in rig[:views]:
        c2w = camera.c2w.clone()
        c2w[:3, 3] = c2w[:3, 3] * scale + center
        cameras.append(replace(camera, c2w=c2w))
    masks = torch.stack([silhouette(camera, half, center) for camera in cameras])
    return ViewSet(masks[:, None].expand(-1, 4, -1, -1), tuple(cameras), torch.ones(views), "block")


BLOCKS = {
    "the whole box": (1.0, 1.0, 1.0),
    "plate": (1.0, 1.0, 0.02),
    "pole": (0.03, 0.03, 1.0),
    "knife": (1.0, 0.02, 0.2),
    "small": (0.3, 0.25, 0.3),
}


@pytest.mark.parametrize("rig", [(4.0, 30.0), (6.0, 30.0), (2.5, 60.0), (8.0, 15.0)], ids=str)
@pytest.mark.parametrize("block", BLOCKS)
def test_an_object_in_the_box_stays_exactly_where_it_is(block, rig):
    views = block_views(zero123plus_rig(*rig, size=128), BLOCKS[block])
    same, frame = normalise(views)
    points = torch.rand(5, 3)
    assert same is views and frame.is_identity and frame.restore(points) is points


@pytest.mark.parametrize("views", [1, 2, 3])
def test_few_views_with_a_long_hull_stay_too(views):
    assert normalise(block_views(zero123plus_rig(size=128), (1.0, 0.6, 0.9), views=views))[1].is_identity


@pytest.mark.parametrize(
    ("center", "scale"),
    [((10.0, -3.0, 2.0), 1.0), ((0.0, 0.0, 0.0), 3.0), ((100.0, 200.0, 50.0), 40.0), ((0.0, 0.0, 0.0), 0.05)],
)
def test_an_object_elsewhere_comes_into_the_box_and_goes_back(center, scale):
    half = (0.9, 0.5, 0.7)
    views = block_views(zero123plus_rig(size=128), half, center, scale)
    moved, frame = normalise(views)
    corners = torch.cartesian_prod(*(torch.tensor([-h, h]) * scale + c for h, c in zip(half, center, strict=True)))
    inside = (corners - frame.center) / frame.scale
    assert float(inside.abs().max()) <= 1.0
    assert float((inside.amax(dim=0) - inside.amin(dim=0)).max()) > 1.0  # It fills the box, as far as the hull lets it.
    torch.testing.assert_close(frame.restore(inside), corners)
    for before, after in zip(views.cameras, moved.cameras, strict=True):
        torch.testing.assert_close(project(inside, after)[0], project(corners, before)[0], atol=0.02, rtol=0)
        assert torch.equal(before.c2w[:3, :3], after.c2w[:3, :3]) and torch.equal(before.K, after.K)


def test_normalising_twice_changes_nothing():
    moved, _ = normalise(block_views(zero123plus_rig(size=128), (0.9, 0.5, 0.7), (10.0, -3.0, 2.0), 5.0))
    assert normalise(moved)[1].is_identity


def test_views_that_do_not_meet_are_an_error():
    views = block_views(zero123plus_rig(size=64), (0.4, 0.4, 0.4))
    turned = views.cameras[0].c2w.clone()
    turned[:3, :3] = turned[:3, :3] @ torch.diag(torch.tensor([1.0, -1.0, -1.0]))  # OpenCV's axes, by mistake
    cameras = (replace(views.cameras[0], c2w=turned), *views.cameras[1:])
    with pytest.raises(CameraError, match="do not meet"):
        normalise(replace(views, cameras=cameras))


def test_one_view_past_the_box_cannot_be_helped():
    with pytest.raises(CameraError, match="one view"):
        normalise(block_views(zero123plus_rig(size=64), (0.5, 0.5, 0.5), (30.0, 0.0, 0.0), views=1))
