"""Augmentation moves views, points, truth and depth together, or it teaches nonsense."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.visual_hull import Outlines
from training.datasets.point_samples import NetworkViews, augmented, batched, depth_loss, drop_views, load_occupancy

SIZE, RADIUS, CENTER = 64, 0.3, (0.3, 0.1, -0.2)


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """A small ball off the centre: six views rendered by intersecting rays with it, and exact distances."""
    cameras = [orbit_camera(10 + 60 * i, 5.0 * i, 4.0, 40, SIZE, SIZE) for i in range(6)]
    center = torch.tensor(CENTER)
    depths, masks = [], []
    for camera in cameras:
        y, x = torch.meshgrid(torch.arange(SIZE) + 0.5, torch.arange(SIZE) + 0.5, indexing="ij")
        focal = camera.K[0, 0]
        rays = torch.stack([(x - SIZE / 2) / focal, (SIZE / 2 - y) / focal, -torch.ones_like(x)], -1)
        rays = rays @ camera.c2w[:3, :3].T
        half = (rays * (camera.center - center)).sum(-1)
        square = (rays * rays).sum(-1)
        root = half**2 - square * ((camera.center - center).square().sum() - RADIUS**2)
        masks.append(root > 0)
        depths.append(torch.where(root > 0, (-half - root.clamp(min=0).sqrt()) / square, math.inf))
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
        depth=torch.stack(depths).half().numpy(),
        c2w=torch.stack([c.c2w for c in cameras]).numpy(),
        K=torch.stack([c.K for c in cameras]).numpy(),
    )
    return load_occupancy(folder / "rig_0.npz")


def hull(views: NetworkViews, points: torch.Tensor) -> torch.Tensor:
    return Outlines(views.silhouette, views.c2w, views.K).hull_distance(points)


@pytest.mark.parametrize("seed", range(6))
def test_augmented_points_keep_their_place_in_the_views(sample, seed):
    batch = augmented(sample, 2000, torch.Generator().manual_seed(seed))
    found, truth = hull(batch.views, batch.points)[0], batch.target[0, :, 0]
    # The hull of six views holds the ball, and hugs it where a view looks along its outline.
    assert bool((found > truth - 0.03).all())
    outside = truth < -0.15
    assert float((found[outside] < 0).float().mean()) > 0.9


@pytest.mark.parametrize("seed", range(4))
def test_augmented_depth_is_the_distance_to_the_moved_ball(sample, seed):
    batch = augmented(sample, 10, torch.Generator().manual_seed(seed))
    scale = float(batch.views.c2w[0, 0, :3, 3].norm()) / 4.0
    # Ball and origin are rigid: the nearest depth beyond the origin's scales with the object.
    nearest = batch.depth.flatten(2).amin(dim=2) / scale
    plain = sample.depth.float().flatten(2).amin(dim=2)
    assert torch.allclose(nearest, plain, atol=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_solid_stays_behind_the_surface_of_features_whose_space_is_stretched(sample, seed):
    surface = torch.where(sample.depth.isfinite(), sample.depth, 9.0).unsqueeze(2)
    features = replace(sample, views=replace(sample.views, images=surface, silhouette=sample.views.silhouette.float()))
    batch = augmented(features, 3000, torch.Generator().manual_seed(seed), pictures=False)
    outlines = Outlines(batch.views.silhouette, batch.views.c2w, batch.views.K)
    seen = outlines.project(batch.points)
    behind = seen.depth - outlines.range.unsqueeze(-1) - seen.sample(batch.views.images.float())[..., 0]
    solid = batch.target[0, :, 0] > 0.03
    # At the outline a pixel mixes the ball with what is behind it.
    assert int(solid.sum()) > 30 and float((behind[0][:, solid] > 0.0).float().mean()) > 0.97
    # And what a view sees past it is not solid.
    passed = ((behind[0] < -0.03) & (seen.framed[0] > 0)).any(dim=0)
    assert float((batch.target[0, passed, 0] < 0.02).float().mean()) > 0.98 and int(passed.sum()) > 500


def test_features_are_shown_in_stretched_space(sample):
    surface = torch.zeros(1, 6, 1, 8, 8)
    features = replace(sample, views=replace(sample.views, images=surface))
    skew = []
    for seed in range(12):
        linear = augmented(features, 8, torch.Generator().manual_seed(seed), pictures=False).views.c2w[0, 0, :3, :3]
        skew.append(float((linear.T @ linear - torch.eye(3)).abs().max()))
    stretched = [value > 1e-3 for value in skew]
    assert any(stretched) and not all(stretched)


def test_dropping_views_keeps_the_depth_of_those_kept(sample):
    single = augmented(sample, 10, torch.Generator().manual_seed(0))
    batch = batched([single, single], torch.tensor([1, 4]))
    assert batch.views.images.shape[:2] == (2, 2) and batch.points.shape[0] == 2
    assert torch.equal(batch.depth[0], single.depth[0, [1, 4]])
    generator = torch.Generator().manual_seed(0)
    counts = {len(drop_views(generator)) for _ in range(300)}
    assert counts == {1, 2, 3, 4, 5, 6}


def test_true_depth_costs_nothing_and_an_offset_costs_itself(sample):
    truth = sample.depth.float()
    perfect = torch.where(truth.isfinite(), truth, 5.0).unsqueeze(2)
    assert float(depth_loss(perfect, truth)) == 0.0
    assert float(depth_loss(perfect + 0.25, truth)) == pytest.approx(0.25, abs=1e-5)
