"""A simulated phone: its lens bends as COLMAP's does, its JPEG says what EXIF says, its exposure is what it is told."""

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image

from arm_blender.graphics.color import bytes_from_unit, srgb_from_linear
from arm_blender.photographs.capture import Lens
from training.rendering.captures import phone

PINHOLE = Lens("SIMPLE_PINHOLE", (60.0, 40.0, 30.0), 80, 60)


def radial(k1: float) -> Lens:
    return Lens("SIMPLE_RADIAL", (*PINHOLE.parameters, k1), 80, 60)


@pytest.mark.parametrize("k1", [-0.1, -0.03, 0.05])
def test_a_point_of_the_scene_lands_where_the_formula_of_the_lens_says(k1):
    """Every pinhole pixel is painted with its own place; the lens must show COLMAP's x (1 + k1 r^2) of it."""
    lens = radial(k1)
    camera = phone.wider_pinhole(torch.eye(4), lens)
    y, x = torch.meshgrid(torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij")
    place = torch.stack([x - camera.K[0, 2], y - camera.K[1, 2]]) / 60.0
    seen = phone.through_lens(place, lens)
    assert seen.shape == (2, 60, 80)
    bent = 60.0 * seen * (1.0 + k1 * seen.square().sum(dim=0)) + torch.tensor([40.0, 30.0])[:, None, None]
    rows, columns = torch.meshgrid(torch.arange(60) + 0.5, torch.arange(80) + 0.5, indexing="ij")
    assert torch.allclose(bent, torch.stack([columns, rows]), atol=0.05)


def test_a_lens_without_distortion_is_the_pinhole_itself():
    camera = phone.wider_pinhole(torch.eye(4), PINHOLE)
    assert (camera.width, camera.height) == (80, 60)
    image = torch.rand(3, 60, 80, generator=torch.Generator().manual_seed(0))
    assert torch.equal(phone.through_lens(image, PINHOLE), image)


def test_the_jpeg_is_upright_tells_the_focal_length_and_has_its_gain(tmp_path):
    linear = torch.full((3, 60, 80), 0.2)
    phone.save_photograph(tmp_path / "IMG_0000.jpg", linear, (0.5, 1.0, 2.0), PINHOLE, seed=0)
    picture = Image.open(tmp_path / "IMG_0000.jpg")
    exif = picture.getexif()
    assert picture.size == (80, 60) and exif[ExifTags.Base.Orientation] == 1
    told = exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm]
    assert told == 27  # 60 pixels of 80, on film of 36 mm.
    means = torch.from_numpy(np.array(picture)).float().mean(dim=(0, 1))
    wanted = bytes_from_unit(srgb_from_linear(0.2 * torch.tensor([0.5, 1.0, 2.0]))).float()
    assert torch.allclose(means, wanted, atol=2.0)


def test_exposure_differs_from_picture_to_picture_and_brings_dark_and_bright_together():
    rng = np.random.default_rng(0)
    means = torch.tensor([[float(light * np.mean(phone.automatic_exposure(torch.full((3, 4, 4), light), rng)))
                           for light in (0.05, 0.2, 1.0)] for _ in range(200)])  # fmt: skip
    assert float(means.std(dim=0).min()) > 0.005
    spread = means.mean(dim=0)
    assert float(spread.max() / spread.min()) < 2.0


def test_a_shaken_picture_keeps_its_light_and_loses_its_grain():
    sharp = torch.rand(3, 300, 400, generator=torch.Generator().manual_seed(0))
    blurred = phone.shaken(sharp, np.random.default_rng(1))
    assert torch.allclose(blurred.mean(), sharp.mean(), atol=1e-4)
    assert float(blurred.std()) < 0.6 * float(sharp.std())
