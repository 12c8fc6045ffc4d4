"""From the light that reaches a lens to the JPEG that a phone keeps: distortion, exposure, blur, noise, EXIF."""

import math
from pathlib import Path

import numpy as np
import torch
from PIL import ExifTags, Image
from torch import Tensor
from torch.nn.functional import grid_sample

from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.color import LUMINANCE, bytes_from_unit, srgb_from_linear
from arm_blender.machine.files import whole_file
from arm_blender.photographs.capture import Lens

_WANTED = 0.22
"""Mean luminance that a phone exposes for."""

_QUALITY = 93

_FILM_WIDTH_MM = 36.0
"""Of the film that EXIF's focal length refers to."""


def wider_pinhole(c2w: Tensor, lens: Lens) -> Camera:
    """A pinhole of the same focal length that sees whatever the lens does: the same picture for one without k1."""
    focal, cx, cy, k1 = _radial(lens)
    corner = torch.tensor([[[cx / focal, cy / focal]]])
    reach = float((_undistorted(corner, k1) / corner).max())
    # Symmetric about the middle, an even number of pixels more: the principal point stays the middle.
    width, height = (side + 2 * max(0, math.ceil(side / 2 * (reach - 1.0) + 1.0)) for side in (lens.width, lens.height))
    if not k1:
        width, height = lens.width, lens.height
    K = torch.tensor([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
    return Camera(c2w, K, width, height)


def through_lens(image: Tensor, lens: Lens) -> Tensor:
    """(C, H, W) as the lens shows what `wider_pinhole` saw, (C, H', W')."""
    focal, cx, cy, k1 = _radial(lens)
    if not k1:
        return image
    y, x = torch.meshgrid(torch.arange(lens.height) + 0.5, torch.arange(lens.width) + 0.5, indexing="ij")
    ray = _undistorted(torch.stack([(x - cx) / focal, (y - cy) / focal], dim=-1), k1)
    half = torch.tensor([image.shape[2], image.shape[1]]) / 2.0
    grid = (ray * focal / half)[None]  # (1, H, W, 2), -1 and 1 at the outer borders of the pinhole's pixels.
    return grid_sample(image[None], grid, mode="bilinear", padding_mode="border", align_corners=False)[0]


def _radial(lens: Lens) -> tuple[float, float, float, float]:
    """Focal length, centre and k1 of a SIMPLE_PINHOLE or a SIMPLE_RADIAL."""
    focal, cx, cy, *rest = lens.parameters
    return focal, cx, cy, rest[0] if rest else 0.0


def _undistorted(points: Tensor, k1: float) -> Tensor:
    """Where points (..., 2) of the distorted image plane were: x (1 + k1 r^2) = points, by Newton's method on r."""
    far = points.norm(dim=-1, keepdim=True)
    r = far.clone()
    for _ in range(20):
        r = r - (r * (1.0 + k1 * r * r) - far) / (1.0 + 3.0 * k1 * r * r).clamp(min=0.1)
    return points * torch.where(far > 0.0, r / far.clamp(min=1e-12), torch.ones_like(far))


def automatic_exposure(linear: Tensor, rng: np.random.Generator) -> tuple[float, float, float]:
    """What a phone multiplies red, green and blue of a picture (3, H, W) with: brightness and white balance differ."""
    luminance = float((linear * torch.tensor(LUMINANCE)[:, None, None]).sum(dim=0).mean())
    brightness = (_WANTED / max(luminance, 1e-3)) ** 0.8 * math.exp(rng.normal(0.0, 0.1))
    warm = rng.normal(0.0, 0.04)
    return brightness * math.exp(warm), brightness, brightness * math.exp(-warm)


def shaken(linear: Tensor, rng: np.random.Generator) -> Tensor:
    """A picture (3, H, W) of a hand that moved: the mean along a line of 1.2 to 2 % of its width."""
    length, angle = linear.shape[2] * rng.uniform(0.012, 0.02), rng.uniform(0.0, math.pi)
    steps = max(3, round(length))
    total = torch.zeros_like(linear)
    for k in range(steps):
        along = (k / (steps - 1) - 0.5) * length
        total += linear.roll((round(along * math.sin(angle)), round(along * math.cos(angle))), dims=(1, 2))
    return total / steps


def save_photograph(path: Path, linear: Tensor, gain: tuple[float, float, float], lens: Lens, seed: int) -> None:
    """A picture (3, H, W), linear Rec.709 before `gain`, as a phone's JPEG with EXIF, whole or not at all.

    Args:
        seed: of the sensor's noise.
    """
    lit = linear * torch.tensor(gain)[:, None, None]
    noise = torch.randn(lit.shape, generator=torch.Generator().manual_seed(seed))
    srgb = srgb_from_linear(lit) + 0.006 * noise
    exif = Image.Exif()
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = "Simulated", "Phone"
    exif[ExifTags.Base.Orientation] = 1
    detail = exif.get_ifd(ExifTags.IFD.Exif)
    detail[ExifTags.Base.FocalLengthIn35mmFilm] = round(focal_in_35mm(lens))
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = bytes_from_unit(srgb).permute(1, 2, 0).contiguous().numpy()
    with whole_file(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="JPEG", quality=_QUALITY, exif=exif)


def focal_in_35mm(lens: Lens) -> float:
    """Of a lens, millimetres, as EXIF has it: where the picture's longer side is that of the film."""
    return lens.parameters[0] / max(lens.width, lens.height) * _FILM_WIDTH_MM
