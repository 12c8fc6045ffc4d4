"""The mask of a view is opened, painted and saved, and the next run takes it."""

import numpy as np
import pytest
import torch
from PIL import Image

import arm_blender
from arm_blender.views import load_views
from arm_blender.views.mask_files import read_mask
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.transforms_json import write_transforms

bpy = pytest.importorskip("bpy")
from arm_blender.blender.input import mask_painting  # noqa: E402

from ...pictures import SIZE, a_picture, picture, six_pictures  # noqa: E402

pytestmark = pytest.mark.blender


@pytest.fixture
def panel(empty_file):
    arm_blender.register()
    yield bpy.context.scene.arm
    arm_blender.unregister()


def paint(image) -> None:
    """The left half white, the right half black, as a brush leaves it."""
    width, height = image.size
    pixels = np.ones((height, width, 4), np.float32)
    pixels[:, width // 2 :, :3] = 0.0
    image.pixels.foreach_set(pixels.ravel())
    image.update()


def left_half(alpha) -> bool:
    width = alpha.shape[1]
    return float(alpha[:, : width // 2].min()) > 0.99 and float(alpha[:, width // 2 :].max()) < 0.01


@pytest.mark.parametrize("kind", ["picture", "rig", "posed"])
def test_a_painted_mask_is_what_the_next_run_sees(panel, tmp_path, kind):
    if kind == "picture":
        chosen = edited = a_picture(tmp_path / "cup.png")
    else:
        chosen = six_pictures(tmp_path / "cup")
        edited = chosen / "2.png"
    if kind == "posed":
        write_transforms(chosen / "transforms.json", [f"{i}.png" for i in range(6)], zero123plus_rig(4.0, 30.0, SIZE))
    panel.views_path = str(chosen)
    assert bpy.ops.arm.edit_mask(picture=str(edited)) == {"FINISHED"}
    (mask,) = [image for image in bpy.data.images if mask_painting.is_mask(image)]
    assert tuple(mask.size) == (SIZE, SIZE) and not mask_painting.unsaved()
    torch.testing.assert_close(read_mask(edited.parent / "masks" / edited.name), picture()[3])
    with pytest.raises(RuntimeError, match="No mask was painted"):
        bpy.ops.arm.use_masks()
    paint(mask)
    assert mask_painting.unsaved() == [mask]
    assert bpy.ops.arm.use_masks() == {"FINISHED"}
    assert left_half(read_mask(edited.parent / "masks" / edited.name))
    views = load_views(chosen)
    alpha = views.images[0 if kind == "picture" else 2, 3]
    shown = alpha[:, (alpha > 0.5).any(dim=0)]
    assert kind == "picture" or left_half(alpha)
    assert shown.shape[1] == SIZE // 2 and int((alpha > 0.5).any(dim=1).sum()) == SIZE


def test_opened_again_it_is_the_painted_one(panel, tmp_path):
    cup = a_picture(tmp_path / "cup.png")
    panel.views_path = str(cup)
    bpy.ops.arm.edit_mask(picture=str(cup))
    (mask,) = [image for image in bpy.data.images if mask_painting.is_mask(image)]
    paint(mask)
    bpy.ops.arm.edit_mask(picture=str(cup))  # Whatever begins saves what was painted.
    assert left_half(read_mask(tmp_path / "masks" / "cup.png"))
    assert [image for image in bpy.data.images if mask_painting.is_mask(image)] == [mask]
    assert np.array(mask.pixels[:4]).tolist() == [1.0, 1.0, 1.0, 1.0]


def test_a_mask_that_cannot_be_saved_is_one_line(panel, tmp_path):
    cup = a_picture(tmp_path / "cup.png")
    panel.views_path = str(cup)
    bpy.ops.arm.edit_mask(picture=str(cup))
    (mask,) = [image for image in bpy.data.images if mask_painting.is_mask(image)]
    paint(mask)
    place = tmp_path / "masks" / "cup.png"
    place.unlink()
    place.mkdir()
    with pytest.raises(RuntimeError, match="cup.png: cannot be written"):
        bpy.ops.arm.use_masks()


def test_a_picture_that_cannot_be_read_is_one_line(panel, tmp_path):
    panel.views_path = str(tmp_path)
    with pytest.raises(RuntimeError, match="gone.png"):
        bpy.ops.arm.edit_mask(picture=str(tmp_path / "gone.png"))
    Image.new("RGB", (4, 4)).save(tmp_path / "none.png")
    with pytest.raises(RuntimeError, match="Choose the picture"):
        bpy.ops.arm.edit_mask()
