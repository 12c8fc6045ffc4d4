"""Samples that validate a shape: views, points and truth belong together."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.visual_hull import Outlines
from training.datasets.point_samples import drop_views, expanded, load_occupancy

SIZE, RADIUS, CENTER = 64, 0.3, (0.3, 0.1, -0.2)


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """A small ball off the centre: six views rendered by intersecting rays with it, and exact distances."""
    cameras = [orbit_camera(10 + 60 * i, 5.0 * i, 4.0, 40, SIZE, SIZE) for i in range(6)]
    center = torch.tensor(CENTER)
    masks = []
    for camera in cameras:
        y, x = torch.meshgrid(torch.arange(SIZE) + 0.5, torch.arange(SIZE) + 0.5, indexing="ij")
        focal = camera.K[0, 0]
        rays = torch.stack([(x - SIZE / 2) / focal, (SIZE / 2 - y) / focal, -torch.ones_like(x)], -1)
        rays = rays @ camera.c2w[:3, :3].T
        half = (rays * (camera.center - center)).sum(-1)
        root = half**2 - (rays * rays).sum(-1) * ((camera.center - center).square().sum() - RADIUS**2)
        masks.append(root > 0)
    rgba = np.zeros((6, SIZE, SIZE, 4), np.uint8)
    rgba[..., :3] = 120
    rgba[..., 3] = torch.stack(masks).numpy() * 255
    points = torch.rand(4000, 3, generator=torch.Generator().manual_seed(0)) * 1.6 - 0.8
    distance = RADIUS - (points - center).norm(dim=1)
    folder = tmp_path_factory.mktemp("ball")
    np.savez(folder / "occupancy.npz", points=points.half().numpy(), distance=distance.half().numpy())
    np.savez(
        folder / "rig_0.npz",
        rgba=rgba,
        c2w=torch.stack([c.c2w for c in cameras]).numpy(),
        K=torch.stack([c.K for c in cameras]).numpy(),
    )
    return load_occupancy(folder / "rig_0.npz")


def test_held_out_views_and_distances_belong_together(sample):
    views = expanded(sample.views)
    found = Outlines(views.silhouette, views.c2w, views.K).hull_distance(sample.points[None].float())[0]
    # The hull of six views holds the ball, and hugs it where a view looks along its outline.
    assert sample.usable and bool((found > sample.distance - 0.03).all())
    outside = sample.distance < -0.15
    assert float((found[outside] < 0).float().mean()) > 0.9


def test_a_sheet_and_an_object_that_no_view_frames_are_of_no_use(sample):
    assert not replace(sample, distance=sample.distance - 1.0).usable
    assert not replace(sample, views=replace(sample.views, silhouette=torch.zeros_like(sample.views.silhouette))).usable


def test_one_to_six_views_are_kept():
    generator = torch.Generator().manual_seed(0)
    counts = {len(drop_views(generator)) for _ in range(300)}
    assert counts == {1, 2, 3, 4, 5, 6}
