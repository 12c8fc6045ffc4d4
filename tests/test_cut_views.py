"""An object that pictures cut at their border keeps what only the others show."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender import pipeline
from arm_blender.config import Settings
from arm_blender.structures import ViewSet
from arm_blender.views import load_views
from arm_blender.views.scene_frame import normalise
from arm_blender.views.transforms_json import write_transforms

from .models.balls import ball_views

QUICK = Settings(quality="draft", grid=48)
SIZE = 96
RADIUS = 0.75


def cut(views: ViewSet, share: float) -> ViewSet:
    """Views of which every other one ends at a share of its height; blank pixels make up for the rest."""
    images, height = views.images.clone(), round(share * SIZE)
    known = [(0, 0, SIZE, SIZE)] * len(images)
    for view in range(0, len(images), 2):
        images[view, :, height:] = 0.0
        known[view] = 0, 0, SIZE, height
    return replace(views, images=images, known=tuple(known))


def lowest(views: ViewSet) -> float:
    return float(pipeline.shape(views, QUICK).vertices[:, 2].min())


def test_pictures_that_end_above_its_foot_take_nothing_off_an_object():
    views = ball_views(RADIUS, SIZE)
    ended = cut(views, 0.6)
    assert normalise(ended)[1].is_identity
    assert lowest(ended) == pytest.approx(lowest(views), abs=0.05)
    assert lowest(replace(ended, known=None)) > lowest(views) + 0.2, "the views do carve where they are believed"


def test_what_no_picture_shows_ends_on_the_ground():
    views = cut(ball_views(RADIUS, SIZE), 0.6)
    views = replace(views.only([0, 2, 4]), ground=-0.5)
    mesh = pipeline.shape(views, QUICK)
    assert float(mesh.vertices[:, 2].min()) == pytest.approx(-0.5, abs=0.03)


@pytest.fixture
def folder(tmp_path):
    views = cut(ball_views(RADIUS, SIZE), 0.6)
    names = [f"{index}.png" for index in range(len(views.cameras))]
    for name, image in zip(names, views.images, strict=True):
        Image.fromarray((image.permute(1, 2, 0).numpy() * 255.0).astype(np.uint8)).save(tmp_path / name)
    known = [{"known": list(rectangle)} for rectangle in views.rectangles]
    told = {"fields": known, "ground": -0.8, "varying_exposure": True}
    write_transforms(tmp_path / "transforms.json", names, views.cameras, **told)
    return tmp_path, views


def test_known_pixels_and_the_ground_come_back_from_files(folder):
    path, views = folder
    read = load_views(path)
    assert read.known == views.known and read.ground == pytest.approx(-0.8) and read.varying_exposure


def test_a_single_picture_that_cuts_its_object_says_so_of_its_crop(tmp_path):
    image = ball_views(RADIUS, SIZE, views=1).images[0, :, : SIZE // 2]
    Image.fromarray((image.permute(1, 2, 0).numpy() * 255.0).astype(np.uint8)).save(tmp_path / "half.png")
    views = load_views(tmp_path / "half.png")
    (left, top, right, bottom) = views.rectangles[0]
    opaque = torch.nonzero(views.images[0, 3] > 0.5)[:, 0]
    assert bottom == int(opaque.max()) + 1 < views.images.shape[2], "the picture ends where the object is cut"
    assert 0 <= left < right and 0 <= top < bottom


def test_where_pictures_cropped_around_an_object_frame_nothing_nothing_is():
    views = ball_views(RADIUS, SIZE)
    window = slice(SIZE // 5, SIZE - SIZE // 5)
    images = torch.nn.functional.interpolate(views.images[:, :, window, window], (SIZE, SIZE), mode="bilinear")
    assert float(images[:, 3, [0, -1]].max()) == 0.0 and float(images[:, 3, :, [0, -1]].max()) == 0.0, "it is whole"
    scale, start = SIZE / (window.stop - window.start), torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0] * 3])
    cameras = tuple(
        replace(camera, K=torch.diag(torch.tensor([scale, scale, 1.0])) @ (camera.K - window.start * start))
        for camera in views.cameras
    )
    mesh = pipeline.shape(replace(views, images=images, cameras=cameras), QUICK)
    assert float(mesh.vertices.norm(dim=1).max()) < RADIUS + 0.1
