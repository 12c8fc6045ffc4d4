"""Masks in files of their own: read as alpha, at any size, turned with their pictures."""

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.errors import InputImageError
from arm_blender.views import mask_files
from arm_blender.views.image_io import read_image, read_orientation, write_png
from arm_blender.views.mask_files import mask_to_paint, read_mask, with_mask

from ..pictures import SIZE, picture


def test_a_grey_level_is_the_alpha_that_is_stored(tmp_path):
    Image.fromarray(np.full((20, 30), 128, np.uint8)).save(tmp_path / "grey.png")
    Image.fromarray(np.full((20, 30, 4), (255, 255, 255, 64), np.uint8)).save(tmp_path / "alpha.png")
    torch.testing.assert_close(read_mask(tmp_path / "grey.png"), torch.full((20, 30), 128 / 255), atol=1e-5, rtol=0)
    torch.testing.assert_close(read_mask(tmp_path / "alpha.png"), torch.full((20, 30), 64 / 255))


@pytest.mark.parametrize("orientation", [6, 8])
def test_a_mask_as_the_file_is_stored_is_turned_along(tmp_path, orientation):
    stored = np.zeros((20, 30), np.uint8)
    stored[2:8, 3:20] = 255
    exif = Image.Exif()
    exif[274] = orientation
    Image.fromarray(stored).save(tmp_path / "cup.png", exif=exif)
    Image.fromarray(stored).save(tmp_path / "mask.png")
    image = read_image(tmp_path / "cup.png")
    assert image.shape == (4, 30, 20)
    cut = with_mask(image, tmp_path / "mask.png", read_orientation(tmp_path / "cup.png")[2])
    assert torch.equal(cut[3] > 0.5, image[0] > 0.5)  # The picture is its own mask.


def test_a_mask_of_half_the_size_is_stretched_and_one_of_another_shape_named(tmp_path):
    image = torch.ones(4, 40, 60)
    Image.fromarray(np.repeat([[0, 255]], 20, 0).repeat(15, 1).astype(np.uint8)).save(tmp_path / "half.png")
    alpha = with_mask(image, tmp_path / "half.png")[3]
    assert alpha[:, :28].max() == 0.0 and alpha[:, 32:].min() > 0.999
    Image.fromarray(np.zeros((30, 30), np.uint8)).save(tmp_path / "square.png")
    with pytest.raises(InputImageError, match="square.png: 30x30 pixels for a picture of 60x40"):
        with_mask(image, tmp_path / "square.png")


def test_a_mask_to_paint_on_is_the_alpha_and_one_that_counts_is_taken_again(tmp_path):
    write_png(tmp_path / "cup.png", picture(), srgb=True)
    place = mask_to_paint(tmp_path / "cup.png", tmp_path)
    assert place == tmp_path / "masks" / "cup.png"
    torch.testing.assert_close(read_mask(place), picture()[3])
    other = tmp_path / "cup.mask.png"
    Image.fromarray(np.full((SIZE, SIZE), 255, np.uint8)).save(other)
    assert mask_to_paint(tmp_path / "cup.png", tmp_path) == other, "it would go before the one in masks/"


def test_pictures_of_one_stem_have_masks_of_their_own(tmp_path):
    for name in ("cup.png", "cup.tif"):
        write_png(tmp_path / name, picture(), srgb=True)
    assert [mask_to_paint(tmp_path / f"cup.{suffix}", tmp_path).name for suffix in ("png", "tif")] == [
        "cup.png.png",
        "cup.tif.png",
    ]


def test_where_no_object_is_found_the_mask_is_black(tmp_path, monkeypatch):
    monkeypatch.setattr(mask_files, "foreground", unsure)
    Image.fromarray(np.full((20, 30, 3), 99, np.uint8)).save(tmp_path / "fog.jpg")
    place = mask_to_paint(tmp_path / "fog.jpg", tmp_path)
    assert place.name == "fog.png" and torch.equal(read_mask(place), torch.zeros(20, 30))
    with pytest.raises(InputImageError, match="gone.jpg"):
        mask_to_paint(tmp_path / "gone.jpg", tmp_path)


def unsure(image, path):
    raise InputImageError("no foreground found")
