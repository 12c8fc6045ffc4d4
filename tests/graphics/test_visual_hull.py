"""Distances to outlines, in pictures and in space; what pictures do not tell, and the ground."""

from dataclasses import replace

import pytest
import torch
from scipy.ndimage import distance_transform_edt

from arm_blender.graphics.visual_hull import signed_silhouette_distance
from arm_blender.models.network_views import network_views
from arm_blender.structures import ViewSet

from ..models.balls import ball_views, points
from ..models.small.test_volume_georm import TINY


def test_silhouette_distance_equals_scipys():
    alpha = torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(0)).round()
    for ours, mask in zip(signed_silhouette_distance(alpha), alpha.numpy() > 0.5, strict=True):
        inside, outside = distance_transform_edt(mask), distance_transform_edt(~mask)
        truth = torch.from_numpy((inside - 0.5).clip(0) - (outside - 0.5).clip(0)).float()
        assert torch.allclose(ours, truth, atol=1e-4)


def test_a_distance_within_reach_is_exact_and_beyond_it_only_more():
    alpha = torch.zeros(1, 60, 50)
    alpha[0, 20:24, 10:30] = 1.0
    exact, near = signed_silhouette_distance(alpha), signed_silhouette_distance(alpha, reach=8)
    within = exact.abs() <= 7.0
    assert torch.equal(near[within], exact[within]) and bool(within.any())
    assert bool((near.abs() >= exact.abs() - 1e-4).all())


def cut(views: ViewSet, keep: slice, width: int, view: int = 0) -> ViewSet:
    """The views with one of them blank outside of some columns, as a frame of another shape leaves it."""
    images = views.images.clone()
    blank = torch.ones(images.shape[-1], dtype=torch.bool)
    blank[keep] = False
    images[view, :, :, blank] = 0.0
    known = [(0, 0, width, width)] * len(images)
    known[view] = (keep.start, 0, keep.stop, width)
    return replace(views, images=images, known=tuple(known))


@pytest.mark.parametrize("keep", [slice(0, 52), slice(44, 96)], ids=["right", "left"])
def test_beyond_the_border_that_cuts_the_object_a_view_carves_nothing(keep):
    whole = ball_views(0.7, size=96)
    p = points(4000)
    carved, truth = (network_views(v, TINY).outlines.hull_distance(p)[0] for v in (cut(whole, keep, 96), whole))
    assert bool(((truth > 0.02) <= (carved > 0.0)).all()), "the object loses nothing"
    blind = replace(cut(whole, keep, 96), known=None)
    assert bool((network_views(blind, TINY).outlines.hull_distance(p)[0] < 0.0)[truth > 0.1].any())


def test_a_view_that_shows_the_whole_object_still_carves_beyond_its_border():
    """Pixels added around a picture that cuts nothing are as empty as its own."""
    views = ball_views(0.5, size=96)
    padded = replace(views, known=((10, 10, 86, 86),) * 6)
    p = points(1000)
    plain, same = (network_views(v, TINY).outlines.hull_distance(p) for v in (views, padded))
    assert torch.equal(plain, same)


def test_nothing_is_below_the_ground():
    outlines = network_views(replace(ball_views(0.7, size=96), ground=-0.3), TINY).outlines
    p = points(4000)
    inside = outlines.hull_distance(p)[0] > 0.0
    assert bool(inside.any()) and float(p[0, inside, 2].min()) > -0.3
