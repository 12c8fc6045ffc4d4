"""Cameras of the scene and views are two forms of the same: K and pose survive the way there and back."""

import numpy as np
import pytest
import torch
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from arm_blender.errors import CameraError, InputImageError
from arm_blender.graphics.cameras import Camera, project
from arm_blender.views.image_io import write_png
from arm_blender.views.rigs import zero123plus_rig

bpy = pytest.importorskip("bpy")
from arm_blender.blender.input.generation_request import view_of_camera  # noqa: E402
from arm_blender.blender.input.scene_cameras import add_cameras, camera_pictures, cameras_with_pictures  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]

FRAMES = [(1920, 1080), (1080, 1920), (512, 512)]


def pictures(names=None):
    bpy.context.view_layer.update()
    return camera_pictures(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), names)


def frame_size(size: tuple[int, int]) -> None:
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = size


@pytest.fixture
def picture(tmp_path):
    image = torch.zeros(4, 48, 64)
    image[:3], image[3, 10:30, 20:50] = 0.5, 1.0
    image[0, 10:15, 20:50] = 0.1
    write_png(tmp_path / "cup.png", image, srgb=True)
    return tmp_path / "cup.png"


@pytest.fixture
def camera(picture):
    """A camera with a background image that was placed by hand."""
    lens = bpy.data.cameras.new("Cam")
    made = bpy.data.objects.new("Cam", lens)
    bpy.context.scene.collection.objects.link(made)
    made.location, made.rotation_euler = (1.0, -5.0, 2.0), (1.2, 0.1, 0.3)
    lens.background_images.new().image = bpy.data.images.load(str(picture))
    return made


@pytest.mark.parametrize("size", FRAMES)
def test_views_become_cameras_and_the_same_views_again(picture, size):
    frame_size(size)
    rig = zero123plus_rig(3.5, 40.0, 48)
    K = torch.tensor([[70.0, 0.0, 40.0], [0.0, 70.0, 20.0], [0.0, 0.0, 1.0]])  # The principal point is off the centre.
    views = [(f"v{i}", c.c2w.numpy(), K.numpy(), 64, 48, picture) for i, c in enumerate(rig)]
    current = bpy.context.scene.camera
    add_cameras(bpy.context.scene, "rig", views)
    assert bpy.context.scene.camera == current
    found = pictures()
    assert [one.name for one in found] == [f"v{i}" for i in range(6)]
    for one, camera in zip(found, rig, strict=True):
        assert np.allclose(one.c2w, camera.c2w.numpy(), atol=1e-5)
        assert np.allclose(one.K, K.numpy(), atol=1e-3)


@pytest.mark.parametrize("size", FRAMES)
@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
def test_k_says_where_blender_sees_a_point(camera, size, fit):
    """Against Blender's own projection, which knows the frame; an image that is stretched covers it."""
    frame_size(size)
    camera.data.sensor_fit, camera.data.shift_x, camera.data.shift_y = fit, 0.1, -0.05
    camera.data.background_images[0].frame_method = "STRETCH"
    (one,) = pictures()
    seen = Camera(torch.tensor(one.c2w).float(), torch.tensor(one.K).float(), 64, 48)
    for point in ((0.0, 0.0, 0.0), (0.3, 0.5, -0.2)):
        x, y, _ = world_to_camera_view(bpy.context.scene, camera, Vector(point))
        assert project(torch.tensor(point), seen)[0].tolist() == pytest.approx([64 * x, 48 * (1 - y)], abs=1e-2)


@pytest.mark.parametrize("size", FRAMES)
@pytest.mark.parametrize("method", ["FIT", "CROP"])
def test_a_fitted_image_keeps_square_pixels_and_its_middle(camera, size, method):
    frame_size(size)
    camera.data.background_images[0].frame_method = method
    K = pictures()[0].K
    assert K[0, 0] == pytest.approx(K[1, 1]) and K[:2, 2] == pytest.approx([32.0, 24.0], abs=1e-4)
    # Of the frame's diagonal the fitted image takes at most, the cropped one at least, what fits.
    camera.data.background_images[0].frame_method = "STRETCH"
    stretched = pictures()[0].K
    low, high = sorted((stretched[0, 0], stretched[1, 1]))
    assert K[0, 0] == pytest.approx(high if method == "FIT" else low)


def test_pixels_become_linear_with_the_object_where_it_was(camera):
    view = view_of_camera(pictures()[0])
    assert view.image.shape == (4, 48, 64) and view.path.name == "Cam"
    assert view.image[3, 20, 30] == 1.0 and view.image[3, 2, 2] == 0.0
    assert float(view.image[0, 12, 30]) == pytest.approx(0.1, abs=0.01)
    assert float(view.image[1, 12, 30]) == pytest.approx(0.5, abs=0.01)


def test_a_parents_scale_does_not_count_and_a_mirror_is_refused(camera):
    parent = bpy.data.objects.new("Holder", None)
    bpy.context.scene.collection.objects.link(parent)
    camera.parent, parent.scale = parent, (3.0, 3.0, 3.0)
    rotation = pictures()[0].c2w[:3, :3]
    assert np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-5)
    parent.scale = (-1.0, 1.0, 1.0)
    with pytest.raises(CameraError, match="Cam: is mirrored or sheared"):
        pictures()


def flat(camera):
    camera.data.type = "ORTHO"


def turned(camera):
    camera.data.background_images[0].rotation = 0.2


def without_image(camera):
    camera.data.background_images.clear()


@pytest.mark.parametrize(
    ("spoil", "error", "match"),
    [
        (flat, CameraError, "Cam: is no perspective camera"),
        (turned, CameraError, "Cam: its background image is moved"),
        (without_image, CameraError, "No camera of the scene has a background image"),
    ],
)
def test_cameras_that_do_not_do_are_one_line(camera, spoil, error, match):
    spoil(camera)
    with pytest.raises(error, match=match):
        pictures()


def test_a_missing_picture_is_one_line(camera, tmp_path):
    image = camera.data.background_images[0].image
    image.filepath = str(tmp_path / "gone.png")
    image.reload()
    with pytest.raises(InputImageError, match="Cam: its background image cup.png has no pixels"):
        pictures()


def test_named_cameras_come_in_that_order(camera, picture):
    add_cameras(bpy.context.scene, "rig", [("A", np.eye(4), np.diag([50.0, 50.0, 1.0]), 64, 48, picture)])
    assert [item.name for item in cameras_with_pictures(bpy.context.scene)] == ["A", "Cam"]
    assert [one.name for one in pictures(["Cam", "A"])] == ["Cam", "A"]
    with pytest.raises(CameraError, match="B: no such camera"):
        pictures(["B"])
