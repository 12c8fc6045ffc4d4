"""Distances to outlines in pictures."""

import torch
from scipy.ndimage import distance_transform_edt

from arm_blender.graphics.visual_hull import signed_silhouette_distance


def test_silhouette_distance_equals_scipys():
    alpha = torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(0)).round()
    for ours, mask in zip(signed_silhouette_distance(alpha), alpha.numpy() > 0.5, strict=True):
        inside, outside = distance_transform_edt(mask), distance_transform_edt(~mask)
        truth = torch.from_numpy((inside - 0.5).clip(0) - (outside - 0.5).clip(0)).float()
        assert torch.allclose(ours, truth, atol=1e-4)
