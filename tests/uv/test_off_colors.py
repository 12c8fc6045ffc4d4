"""Pictures that were exchanged are named by their colours where their outlines are alike."""

from dataclasses import replace

import pytest
import torch

from arm_blender.structures import ViewSet
from arm_blender.uv.backproject import backproject
from arm_blender.uv.blend import blend
from arm_blender.uv.off_colors import off_colors
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

from ..colored_box import box_mesh, cameras, view_set

NAMES = [f"{index}.png" for index in range(12)]


@pytest.fixture(scope="module")
def box():
    return unwrap(box_mesh(), UnwrapConfig(256, time_limit=0.0))[0]


@pytest.fixture(scope="module")
def views() -> ViewSet:
    return view_set((*cameras(), *(camera for camera in cameras(distance=4.5))))


def said(mesh, views: ViewSet) -> list[str]:
    seen = backproject(mesh, texel_map(mesh, 256), views)
    return list(off_colors(seen, blend(seen, views.weights)[0], NAMES))


def test_views_of_one_object_are_not_off_in_any_light(box, views):
    assert said(box, views) == []
    shaded = views.images.clone()
    shaded[:, :3] *= torch.linspace(0.6, 1.0, 12)[:, None, None, None]
    assert said(box, replace(views, images=shaded)) == []


def test_a_picture_in_the_wrong_place_is_named(box, views):
    images = views.images.clone()
    images[2, :3] = images[5, :3].flip(0)
    found = said(box, replace(views, images=images))
    assert len(found) == 1 and found[0].startswith("2.png shows other colours than the rest")
