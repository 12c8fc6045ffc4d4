"""An object that pictures cut at their border keeps what only the others show."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender import pipeline
from arm_blender.config import Settings
from arm_blender.structures import ViewSet
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views import ViewOptions, load_views
from arm_blender.views.doubts import doubts
from arm_blender.views.image_io import write_png
from arm_blender.views.mesh_fit import fit_to_views, outline_fit
from arm_blender.views.rigs import front_camera, zero123plus_rig
from arm_blender.views.scene_frame import normalise
from arm_blender.views.transforms_json import write_transforms

from .colored_box import BODY, KNOB, box_mesh, cameras, picture, pictures, side_errors, write_views
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


def six_of_the_rig(folder, fovy_deg: float) -> ViewSet:
    """The box by the rig's cameras, so near that every picture cuts it."""
    folder.mkdir()
    for index, image in enumerate(pictures(zero123plus_rig(4.0, fovy_deg, 128))):
        write_png(folder / f"{index}.png", image, srgb=True)
    return load_views(folder, ViewOptions(fovy_deg=fovy_deg))


def one_picture(folder) -> ViewSet:
    """The box from its front, without its lower part."""
    image = picture(front_camera(100.0, 128))
    rows = torch.nonzero((image[3] > 0.5).any(dim=1))[:, 0]
    write_png(folder / "one.png", image[:, : int(rows[0]) + 6 * len(rows) // 10], srgb=True)
    return load_views(folder / "one.png")


def posed(folder) -> ViewSet:
    """Two of six pictures cut the box, on opposite sides of it."""
    far, near = cameras(), cameras(fovy_deg=15.5)
    return load_views(write_views(folder / "posed", views=tuple((near if i in (1, 4) else far)[i] for i in range(6))))


WAYS = {
    "posed": (posed, {"+x", "-x", "+y", "-y", "+z", "-z"}),
    "six": (lambda folder: six_of_the_rig(folder / "six", 21.0), {"+x", "-x", "+y", "-y", "+z"}),
    "one": (one_picture, {"-y"}),
}
"""Ways in, and the sides of the box that their pictures show well."""


@pytest.mark.parametrize("way", WAYS)
def test_a_shape_of_pictures_that_cut_the_object_has_its_colours_and_outlines(tmp_path, way):
    make, shown = WAYS[way]
    views = make(tmp_path)
    shape = pipeline.decimate(pipeline.shape(views, QUICK), 4000)
    mesh = unwrap(shape, UnwrapConfig(256, time_limit=0.0))[0]
    errors, _ = side_errors(mesh, views)
    assert max(errors[side] for side in shown) < 0.01
    assert outline_fit(mesh, views) > 0.95
    said = [why for why in doubts(views) if "the border cuts the object" in why]
    if way == "posed":  # The other four show where it ends.
        ends = torch.tensor([BODY[0], (*BODY[1][:2], KNOB[1][2])])
        assert (torch.stack([mesh.vertices.amin(dim=0), mesh.vertices.amax(dim=0)]) - ends).abs().max() < 0.15
        assert said == []
    else:
        assert said, "nobody knows where it ends"


@pytest.mark.parametrize("way", WAYS)
def test_a_given_mesh_has_its_colours_from_pictures_that_cut_the_object(tmp_path, way):
    make, shown = WAYS[way]
    views = make(tmp_path)
    mesh = unwrap(box_mesh(), UnwrapConfig(256, time_limit=0.0))[0]
    if way != "posed":  # Without cameras nothing says how large it is, and where.
        moved = mesh.moved(lambda points: 3.0 * points - 5.0)
        mesh = moved.moved(fit_to_views(moved, views).restore)
    errors, seen = side_errors(mesh, views)
    assert max(errors[side] for side in shown) < 0.02
    assert outline_fit(mesh, views) > 0.96
    if way == "one":
        assert seen < 0.25, "what is below the picture is not taken for seen"
