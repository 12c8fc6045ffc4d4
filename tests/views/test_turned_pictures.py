"""Pictures that EXIF turns, with cameras of what is shown or of what the file stores: each is read as it was meant."""

import json

import numpy as np
import pytest
from PIL import Image

from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.color import bytes_from_unit, srgb_from_linear
from arm_blender.structures import UvMesh
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views import load_views
from arm_blender.views.image_io import as_stored
from arm_blender.views.transforms_json import write_transforms

from ..colored_box import COLORS, box_mesh, cameras, picture, side_errors


def wide(camera: Camera) -> Camera:
    """A camera of the same eye whose picture is wider than high."""
    K = camera.K.clone()
    K[0, 2] = 80.0
    return Camera(camera.c2w, K, 160, camera.height)


def write(folder, views, orientation: int, stored: bool, sizes: bool):
    """Pictures with an EXIF orientation; `views` are cameras of what is stored, or of what is shown."""
    folder.mkdir()
    exif = Image.Exif()
    exif[0x0112] = orientation
    names = [f"{index}.png" for index in range(len(views))]
    for name, camera in zip(names, views, strict=True):
        image = picture(camera)
        image[:3] = srgb_from_linear(image[:3])
        # The file's rows are what the camera of stored pixels sees.
        rows = image if stored else as_stored(image, orientation)
        Image.fromarray(bytes_from_unit(rows).permute(1, 2, 0).numpy().astype(np.uint8)).save(folder / name, exif=exif)
    write_transforms(folder / "transforms.json", names, views)
    if not sizes:
        data = json.loads((folder / "transforms.json").read_text())
        frames = data["frames"]
        (folder / "transforms.json").write_text(
            json.dumps({"camera_angle_x": data["camera_angle_x"], "frames": frames})
        )
    return folder


@pytest.fixture(scope="module")
def mesh() -> UvMesh:
    return unwrap(box_mesh(), UnwrapConfig(256, time_limit=0.0))[0]


@pytest.mark.parametrize("orientation", [3, 6, 8])
@pytest.mark.parametrize("stored", [True, False])
@pytest.mark.parametrize("shape, sizes", [("square", True), ("square", False), ("wide", True)])
def test_cameras_are_of_what_makes_the_views_of_one_object(tmp_path, mesh, orientation, stored, shape, sizes):
    views = cameras() if shape == "square" else tuple(wide(camera) for camera in cameras())
    left = []
    folder = write(tmp_path / "box", views, orientation, stored, sizes)
    read = load_views(folder, left_out=lambda *words: left.append(words))
    errors, seen = side_errors(mesh, read)
    assert set(errors) == set(COLORS) and max(errors.values()) < 3 / 255 and seen > 0.7
    assert len(left) == stored, "what does not count is said"


def test_turning_back_undoes_every_orientation():
    from arm_blender.views.image_io import _upright

    image = picture(wide(cameras()[0]))
    for orientation in range(1, 9):
        rows = as_stored(image, orientation)
        assert np.array_equal(_upright(rows.permute(1, 2, 0).numpy(), orientation), image.permute(1, 2, 0).numpy())
