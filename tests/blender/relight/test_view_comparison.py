"""A result beside its views, drawn by our rasteriser: Cycles, under the light that the object keeps, shows the same."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import arm_blender
from arm_blender.asset_record import AssetRecord
from arm_blender.blender.input.generation_request import GenerationRequest
from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.graphics.light.spherical_harmonics import COUNT, WHITE
from arm_blender.light_check.drawing import Drawing
from arm_blender.views.image_io import write_png
from arm_blender.views.transforms_json import write_transforms

bpy = pytest.importorskip("bpy")
from mathutils import Euler, Matrix  # noqa: E402

from arm_blender.blender.asset.predicted_light import KEPT, light_file  # noqa: E402
from arm_blender.blender.asset.scene import build_object, replace_maps  # noqa: E402
from arm_blender.blender.relight.operators import PICTURE  # noqa: E402

pytestmark = pytest.mark.blender

SCALE, CENTER = 2.0, (1.0, -2.0, 0.5)
"""Of the cameras' frame."""
SIDE = 64


@pytest.fixture
def lit(make_mesh, make_plain_maps):
    """A grey ring under light from one side, which a mirrored or turned environment would put elsewhere."""
    from arm_blender.structures import RelightableAsset

    light = torch.zeros(COUNT, 3)
    light[0], light[1:4] = 0.6 * WHITE, 1.3 * torch.tensor([0.8, 0.4, -0.45])[:, None]
    maps = replace(make_plain_maps((0.5, 0.5, 0.5), 0.7, 0.0), light=light)
    return RelightableAsset("ring", make_mesh(48, 24), maps)


def seen_from(azimuth: float, elevation: float) -> Camera:
    """In the space of the object; its optical axis is not in the middle of the picture."""
    camera = orbit_camera(azimuth, elevation, 5.0, 32.0, SIDE, SIDE)
    K = camera.K.clone()
    K[:2, 2] += torch.tensor([5.0, -4.0])
    return replace(camera, K=K)


def outside(camera: Camera) -> Camera:
    """The same in the frame of the cameras."""
    c2w = camera.c2w.clone()
    c2w[:3, 3] = c2w[:3, 3] * SCALE + torch.tensor(CENTER)
    return replace(camera, c2w=c2w)


@pytest.fixture
def shown(lit, empty_file, tmp_path):
    """The ring in the open file, moved and turned there, with two views of it on disk."""
    arm_blender.register()
    cameras = [seen_from(20.0, 50.0), seen_from(200.0, 35.0)]
    folder = tmp_path / "views"
    folder.mkdir()
    for index, camera in enumerate(cameras):
        picture = Drawing(lit.mesh, lit.maps).under(lit.maps.light, camera)
        write_png(folder / f"{index}.png", torch.cat([linear_from_srgb(picture[:3]), picture[3:]]), srgb=True)
    write_transforms(folder / "transforms.json", ["0.png", "1.png"], [outside(camera) for camera in cameras])
    record: AssetRecord = GenerationRequest(folder).record((SCALE, *CENTER))
    made = build_object(lit, record.as_json(None))
    made.matrix_world = Matrix.LocRotScale((4.0, 5.0, 6.0), Euler((0.3, 0.2, 1.0)), (1.5, 1.5, 1.5))
    settings = bpy.context.scene.arm_relight
    settings.resolution, settings.samples, settings.output = SIDE, 16, str(tmp_path / "out")
    yield made
    arm_blender.unregister()


def in_file() -> list[str]:
    kinds = (bpy.data.objects, bpy.data.scenes, bpy.data.worlds, bpy.data.cameras, bpy.data.materials, bpy.data.meshes)
    return [item.name for kind in kinds for item in kind]


def sheet(path: Path) -> np.ndarray:
    """(3, SIDE, SIDE, 3) in [0, 255]: view, asset, difference."""
    return np.stack(np.split(np.asarray(Image.open(path)).astype(float), 3, axis=1))


@pytest.mark.parametrize("view", [1, 2])
def test_a_view_and_the_asset_under_the_light_of_the_views_are_the_same(shown, tmp_path, view):
    before = in_file()
    bpy.context.scene.arm_relight.view = view
    assert bpy.ops.arm.compare_view() == {"FINISHED"}
    assert bpy.data.images[PICTURE].size[0] == 3 * SIDE
    picture, asset, difference = sheet(tmp_path / "out" / f"ring_view_00{view}.png")
    there = (picture != picture[0, 0]).any(axis=-1)
    covered = (asset != asset[0, 0]).any(axis=-1)
    assert (there ^ covered).mean() < 0.05 and there.mean() > 0.15, "the camera is the view's"
    inside = there & covered
    for axis in (0, 1):  # Outlines of a render are smooth.
        inside &= np.roll(inside, 1, axis) & np.roll(inside, -1, axis)
    # The ring shades itself, and Cycles sends light around.
    assert difference[inside].mean() < 2 * 10.0
    bright = [image[inside].mean(axis=-1) for image in (picture, asset)]
    assert np.corrcoef(*bright)[0, 1] > 0.7 and bright[0].std() > 9.0
    assert in_file() == before


def test_another_finish_glows(shown, tmp_path):
    bpy.ops.arm.compare_view()
    before = sheet(tmp_path / "out" / "ring_view_001.png")[2].mean()
    surface = next(node for node in shown.active_material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    surface.inputs["Roughness"].default_value, surface.inputs["Metallic"].default_value = 0.2, 1.0
    bpy.ops.arm.compare_view()
    assert sheet(tmp_path / "out" / "ring_view_001.png")[2].mean() > 1.3 * before


def test_what_cannot_be_compared_is_said(shown, tmp_path):
    settings = bpy.context.scene.arm_relight
    settings.view = 3
    with pytest.raises(RuntimeError, match="has no view 3; it was made from 2"):
        bpy.ops.arm.compare_view()
    (tmp_path / "views").rename(tmp_path / "elsewhere")
    with pytest.raises(RuntimeError, match="views: no such"):
        bpy.ops.arm.compare_view()
    kept = json.loads(shown["arm_settings"])
    shown["arm_settings"] = json.dumps(kept | {"length": 0.4})
    with pytest.raises(RuntimeError, match="was made to a length"):
        bpy.ops.arm.compare_view()
    del shown[KEPT]
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.arm.compare_view()
    assert not (tmp_path / "out").exists()


def test_the_light_of_the_views_is_an_environment_and_stays_with_the_file(shown, lit, tmp_path):
    settings = bpy.context.scene.arm_relight
    settings.environment = "VIEWS"
    assert bpy.ops.arm.relight() == {"FINISHED"}
    assert (tmp_path / "out" / "ring_light_000.png").is_file()
    assert bpy.ops.arm.light_scene() == {"FINISHED"}
    nodes = bpy.context.scene.world.node_tree.nodes
    image = next(node for node in nodes if node.type == "TEX_ENVIRONMENT").image
    assert image.packed_file is not None and tuple(image.size) == (128, 64)
    replace_maps(shown, replace(lit.maps, light=None), {})
    assert KEPT not in shown
    with pytest.raises(RuntimeError, match="ring: keeps no light of its views"):
        bpy.ops.arm.light_scene()
    with pytest.raises(RuntimeError, match="ring: keeps no light of its views"):
        bpy.ops.arm.relight()


def test_a_light_that_was_changed_is_refused(shown):
    shown[KEPT] = [1.0, 2.0]
    with pytest.raises(arm_blender.errors.ArmError, match="the light of its views was changed"):
        light_file(shown)
